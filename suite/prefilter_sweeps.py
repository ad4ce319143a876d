"""`slewcert prefilter --sweep`: switch times and gains of the filter against a root's place or a delay."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling
from relaxations.cancelling.sweeps import Swept, sweep
from relaxations.errors import RelaxationsError
from relaxations.plants import LinearPlant
from relaxations.robust.moved import axis, moved, nominal
from reports.files import write_atomically
from suite.cancelled import request_of
from suite.errors import SuiteError
from suite.prefilters import Asked, requested
from suite.study import Study

MOST_VALUES = 1000
DELAY = re.compile(r"delay\[([1-9]\d?)\]")


@dataclass(frozen=True, slots=True)
class Range:
    """A parameter and its values, equally spaced, both ends included."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PrefilterSweep:
    """The filters of a study's plant against one parameter."""

    study: Study
    request: Request
    range: Range
    found: tuple[Swept, ...]

    @property
    def delays(self) -> int:
        """The most delays that a filter has, the one at 0 among them."""
        return max((len(one.prefilter.delays) for one in self.found if one.prefilter is not None), default=0)

    @property
    def header(self) -> list[str]:
        """Of the table."""
        parts = [f"{what}[{k}]" for k in range(self.delays) for what in ("delay", "step", "poles")]
        return [self.range.name, "duration", *parts]

    def rows(self) -> Iterator[list[float | None]]:
        """Value, duration [s]; of each delay its instant [s], its step and its poles' share of the static gain. None: there is none."""
        for one in self.found:
            made, cells = one.prefilter, list[float]()
            for k in range(self.delays):
                cells += [made.delays[k] if made is not None and k < len(made.delays) else math.nan, one.step(k), one.term(k)]
            yield [one.value, *(cell if math.isfinite(cell) else None for cell in (one.duration, *cells))]

    def to_dict(self) -> dict[str, Any]:
        """The object of `prefilter --sweep --json` (docs/schemas.md)."""
        points = [
            {
                "value": one.value,
                "duration": None if one.prefilter is None else one.duration,
                "prefilter": None if one.prefilter is None else one.prefilter.to_dict(),
                "reason": one.reason,
            }
            for one in self.found
        ]
        return {"study": str(self.study.file), "form": self.request.form, "parameter": self.range.name, "points": points}


def parsed(text: str) -> Range:
    """`NAME=FROM:TO:N`; raises `ValueError`."""
    name, _, numbers = text.partition("=")
    try:
        low, high, count = numbers.split(":")
        first, last, many = float(low), float(high), int(count)
    except ValueError:
        raise ValueError("must be NAME=FROM:TO:N, such as zero[1]=0.5:2:31") from None
    if not (math.isfinite(first) and math.isfinite(last) and first < last and 2 <= many <= MOST_VALUES):
        raise ValueError(f"must be NAME=FROM:TO:N with FROM < TO and N from 2 to {MOST_VALUES}")
    return Range(name, tuple(np.linspace(first, last, many).tolist()))


def swept(file: Path, asked: Asked, over: Range) -> PrefilterSweep:
    """The filters over a range; raises `SuiteError` for a parameter that the plant does not have."""
    study, plant, request = requested(file, asked)
    if match := DELAY.fullmatch(over.name):
        place = int(match[1])
        given = request.instants or ((0.0,) if request.delays == 1 else None)
        if place > request.delays:
            raise SuiteError(f"--sweep {over.name}: the filter has {request.delays} delay(s)")
        if given is None:
            raise SuiteError(f"--sweep {over.name}: where its other delays are, --instants has to say")
        return PrefilterSweep(study, request, over, sweep(lambda value: _delayed(plant, request, given, place, value), over.values))
    try:
        usual = nominal(plant, over.name)
        axis(plant, over.name, usual, usual)
    except (RelaxationsError, KeyError) as problem:
        raise SuiteError(f"--sweep {over.name}: {problem}; or delay[k]") from None
    chosen = study.command.cancelling
    assert chosen is not None
    return PrefilterSweep(study, request, over, sweep(lambda value: _moved(study, plant, request, chosen, over.name, value), over.values))


def _delayed(plant: LinearPlant, request: Request, given: tuple[float, ...], place: int, value: float) -> Prefilter:
    instants = (*given[: place - 1], value, *given[place:])
    return cancelling(plant, replace(request, instants=instants, sample_time=None))


def _moved(study: Study, plant: LinearPlant, request: Request, chosen: Any, name: str, value: float) -> Prefilter:
    """The filter of the plant whose root is elsewhere, and of its zeros there, where some are chosen."""
    usual, exact = nominal(plant, name), Fraction(repr(value))
    other = moved(plant, [axis(plant, name, min(usual, exact), max(usual, exact))]).member((exact,))
    return cancelling(other, replace(request, zeros=request_of(study, chosen, other).zeros))


def write(done: PrefilterSweep, path: Path) -> None:
    """The rows as a table of comma-separated values."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(done.header)
    writer.writerows(["" if cell is None else repr(cell) for cell in row] for row in done.rows())
    write_atomically(path, text.getvalue().encode())


def draw(done: PrefilterSweep, path: Path) -> None:
    """Delays and shares against the parameter, as an SVG file."""
    from reports.prefilter_charts import families

    values, shown = list(done.range.values), range(done.delays)
    across = done.range.name if DELAY.fullmatch(done.range.name) is None else f"{done.range.name} [s]"
    times = {f"delay {k}": (values, [_at(one, k) for one in done.found]) for k in shown if k}
    steps = {f"step {k}": (values, [one.step(k) for one in done.found]) for k in shown}
    poles = {f"poles on delay {k}": (values, [one.term(k) for one in done.found]) for k in shown}
    gains = {label: curve for label, curve in (steps | poles).items() if np.any(np.nan_to_num(curve[1]))}
    title = f"{done.study.title or done.study.file.stem}: form {done.request.form} against {done.range.name}"
    svg = families(title, (across, "delays [s]", times), (across, "share of the static gain", gains))
    write_atomically(path, svg.encode())


def _at(one: Swept, k: int) -> float:
    return math.nan if one.prefilter is None or k >= len(one.prefilter.delays) else one.prefilter.delays[k]
