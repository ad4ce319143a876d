"""Commands and shapers as FMUs, driven through FMPy: what the tests of `fmus export` share."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from raw_fmus import RawFmu

from fmus.blocks import Block, Signal, command_block, shaper_block
from fmus.compiling import FmiVersion, host
from fmus.exporting import export
from relaxations.commands import Command
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]
VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")


def write_block(folder: Path, block: Block, version: FmiVersion) -> Path:
    path = folder / f"{block.plant.name}{version[0]}.fmu"
    path.write_bytes(export(block, version, [host()]).content)
    return path


def write_command(folder: Path, command: Command, version: FmiVersion, signal: Signal | None = None) -> Path:
    return write_block(folder, command_block(command, "command", signal or Signal("u", "N")), version)


def write_shaper(folder: Path, shaper: Shaper, version: FmiVersion, **options: object) -> Path:
    return write_block(folder, shaper_block(shaper, "shaper", Signal("shaped", "N"), **options), version)  # type: ignore[arg-type]


def set_boolean(fmu: RawFmu, name: str, value: bool) -> None:
    """FMI 2.0 has Booleans of the size of an int, FMI 3.0 of the size of a char."""
    reference = [fmu.references[name]]
    if fmu.is_fmi2:
        fmu.fmu.setBoolean(reference, [value])
    else:
        fmu.fmu.fmi3SetBoolean(fmu.fmu.component, (ctypes.c_uint * 1)(*reference), 1, (ctypes.c_bool * 1)(value), 1)


def drive(fmu: RawFmu, times: Sequence[float], values: Sequence[float], output: str = "shaped") -> list[float]:
    """Step from time to time, each value given for the step that begins there; the output after each step."""
    outputs = []
    for (now, until), value in zip(itertools.pairwise(times), values, strict=False):
        fmu.set({"reference": value})
        fmu.step(now, until - now)
        outputs += fmu.get([output])
    return outputs


def held(times: Sequence[float], values: Sequence[float], rest: float = 0.0) -> Callable[[Reals], Reals]:
    """The reference as it is held: each value up to the end of its step, end included (what is read there is what was before)."""
    starts, table = np.array(times), np.array([rest, *values])

    def reference(t: Reals) -> Reals:
        # strictly before, but for rounding: a sum of times that ends on a start is that start
        return table[np.searchsorted(starts, np.asarray(t) - 1e-12, side="right")]

    return reference


def lines(times: Sequence[float], values: Sequence[float], rest: float = 0.0) -> Callable[[Reals], Reals]:
    """The reference as a line over each step, which reaches the step's value at its end."""
    return lambda t: np.interp(t, times, [rest, *values])
