"""`slewcert fmus export`: a command, shaper or filter file becomes an FMU, or with a plant an SSP, that any importer runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from fmus.archives import Fmu, open_archive
from fmus.blocks import HISTORY, Block, Signal, command_block, model_name, shaper_block
from fmus.build import is_shipped, locate, shipped
from fmus.compiling import FmiVersion, has_zig
from fmus.descriptions import Variable
from fmus.exporting import Exported, export, targets
from fmus.packing import write
from fmus.systems import plant_input, signal_for, system
from relaxations.cancelling.prefilters import Prefilter
from relaxations.commands import Command
from relaxations.shaping.shapers import Shaper
from suite.errors import SuiteError
from suite.sources import NAMES, read_any
from suite.suggestions import did_you_mean
from suite.units import UnitError, convert, named, of_fmu

VALID_UNITS = 'valid are units as FMI writes them or as usual: N, N.m, kN, m/s2, rad/s, deg, V, mA, K, %, 1 for a pure number, "" for none'


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the user asked for beside the file; None and () leave it to the file and to what is installed."""

    fmi: str | None = None
    out: Path | None = None
    name: str | None = None
    output: str | None = None
    unit: str | None = None
    rest: float | None = None
    linear: bool = False
    history: int | None = None
    platforms: tuple[str, ...] = ()
    plant: str | None = None
    input: str | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class Taken:
    """What was written: "command", "shaper" or "filter", the model's name, and of each file its path, FMI version and platforms."""

    kind: str
    name: str
    files: tuple[tuple[Path, Exported], ...]
    note: str | None

    def to_dict(self) -> dict[str, Any]:
        """The record of `fmus export --json`."""
        files = [{"path": str(path), "fmi": made.fmi_version, "platforms": list(made.platforms)} for path, made in self.files]
        return {"kind": self.kind, "name": self.name, "files": files, "note": self.note}


def take_away(source: Path, wanted: Wanted) -> Taken:
    """Write what is in `source` as `wanted`; nothing is written before all of it is made.

    Raises `SuiteError`, `FmuError` or `RelaxationsError`: the file is none of these, a path exists, no compiler …
    """
    content = read_any(source)
    kind = NAMES[content.to_dict()["format"]]
    if kind == "command" and (wanted.linear or wanted.history is not None):
        option = "--linear" if wanted.linear else "--history"
        raise SuiteError(f"{option} is for shapers, which read a reference; {source} is a command, which reads nothing")
    name = wanted.name or model_name(source.stem.removesuffix(".command").removesuffix(".shaper").removesuffix(".filter"))
    plant = open_archive(plant_path(wanted.plant, wanted.fmi)) if wanted.plant else None
    versions = _versions(wanted.fmi, plant)
    paths = _paths(wanted.out, name, versions, "ssp" if plant else "fmu")
    if there := [str(path) for path in paths if path.exists() and not wanted.force]:
        raise SuiteError(f"{', '.join(there)} {'exists' if len(there) == 1 else 'exist'} already; --force replaces")
    driven = plant_input(plant.description, wanted.input) if plant else None
    block = _block(content, name, wanted, plant, driven)
    chosen = targets(wanted.platforms)
    files: list[tuple[Path, Exported, bytes]] = []
    for path, version in zip(paths, versions, strict=True):
        made = export(block, version, chosen)
        files.append((path, made, system(name, block, made.content, plant, driven) if plant and driven else made.content))
    for path, _, archive in files:
        write(path, archive)
    note = None
    if not wanted.platforms and not has_zig():
        note = "built for this machine only; with the Python package ziglang ('pip install ziglang') for Linux, Windows and macOS at once"
    return Taken(kind, name, tuple((path, made) for path, made, _ in files), note)


def plant_path(name: str, fmi: str | None = None) -> Path:
    """The file of an FMU: a path, or a plant shipped here, which is built if it has to be; `SuiteError` for neither."""
    plants = shipped()
    if "." not in name and is_shipped(name):
        return locate(name if fmi is None else f"{name}.fmi{fmi}")
    if is_shipped(name) and not Path(name).exists():
        return locate(name)
    if not Path(name).exists():
        raise SuiteError(f"{name} is no file, and the plants shipped here are {', '.join(plants)}{did_you_mean(name, plants)}")
    return Path(name)


def _versions(fmi: str | None, plant: Fmu | None) -> tuple[FmiVersion, ...]:
    if plant is None:
        both: tuple[FmiVersion, ...] = ("2.0", "3.0")
        return tuple(version for version in both if fmi in (None, "both", version[0]))
    major = str(plant.description.major)
    if fmi not in (None, major):
        raise SuiteError(
            f"{plant.path.name} is of FMI {major}.0, and what drives it in an SSP is of the same; --fmi {fmi} asks for another"
        )
    return ("2.0",) if major == "2" else ("3.0",)


def _paths(out: Path | None, name: str, versions: Sequence[FmiVersion], kind: str) -> list[Path]:
    if out is not None and out.suffix == f".{kind}":
        if len(versions) > 1:
            raise SuiteError(f"{out} is one file, and there is one for each FMI version: choose with --fmi 2 or --fmi 3, or name a folder")
        return [out]
    if out is not None and out.suffix in (".fmu", ".ssp"):
        why = "--ssp was given" if kind == "ssp" else "for an .ssp name the plant with --ssp"
        raise SuiteError(f"{out}: an .{kind} is written here ({why})")
    folder = out or Path()
    if folder.is_file():
        raise SuiteError(f"{folder} is a file, but neither called .{kind} nor a folder")
    return [folder / (f"{name}.ssp" if kind == "ssp" else f"{name}.fmi{version[0]}.fmu") for version in versions]


def _block(content: Command | Shaper | Prefilter, name: str, wanted: Wanted, plant: Fmu | None, driven: Variable | None) -> Block:
    default = "u" if isinstance(content, Command) else "shaped"
    fitting = signal_for(plant.description, driven, default) if plant and driven else Signal(default)
    signal = replace(fitting, name=wanted.output or default, rest=fitting.rest if wanted.rest is None else wanted.rest)
    if wanted.unit not in (None, fitting.unit):
        signal = replace(signal, unit=wanted.unit, exponents=_unit(wanted.unit, plant, driven))
    if isinstance(content, Command):
        return command_block(content, name, signal)
    return shaper_block(content, name, signal, linear=wanted.linear, history=HISTORY if wanted.history is None else wanted.history)


def _unit(text: str, plant: Fmu | None, driven: Variable | None) -> dict[str, float] | None:
    """Exponents of the SI base units, factor and offset of a unit; None if there is none.

    Raises `SuiteError` unless FMI can define it, and the plant's input, where there is one, is of the same kind.
    """
    if not text:
        return None
    try:
        scale = named(text)
        if plant and driven:
            own = next((of_fmu(unit) for unit in plant.description.units if unit.name == driven.unit), None)
            if own is not None:
                convert(Decimal(1), scale, own, difference=True)
    except UnitError as problem:
        raise SuiteError(f"--unit: {problem}; {VALID_UNITS}") from None
    if text != text.strip() or any(power.denominator != 1 for _, power in scale.exponents):
        raise SuiteError(f"--unit: {text!r} cannot be defined in an FMU, where exponents are whole numbers; {VALID_UNITS}")
    numbers = {symbol: float(power) for symbol, power in scale.exponents}
    more = {"factor": float(scale.factor), "offset": float(scale.offset)}
    return numbers | {name: value for name, value in more.items() if value != (name == "factor")}
