"""`slewcert prefilter --compare`: the filter beside those that leave the zeros alone, concurrent and in cascade."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.cancelling.answers import output, tail_length
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling, cascaded, staged
from relaxations.errors import RelaxationsError, ShaperError
from relaxations.plants import LinearPlant
from relaxations.robust.moved import axis, moved, named
from reports.files import write_atomically
from suite.prefilters import SETTLED, Designed

AROUND = tuple(Fraction(k, 100) for k in range(80, 121, 2))  # factors of a root's place
TOLD = (Fraction(9, 10), Fraction(11, 10))  # those whose worst is in the table
LONG, LOOKS, LASTING = 20.0, 2001, 200.0  # time constants or periods after the filter, instants, and at most so many durations
MOST_DELAYS = 6  # of the filter of steps alone


@dataclass(frozen=True, slots=True)
class Alternative:
    """A filter for the plant, what it is called, and what is left of a unit move if a root is elsewhere: by name, one for each of `AROUND`.

    `prefilter` is None where there is none, `reason` says why.
    """

    name: str
    prefilter: Prefilter | None
    reason: str | None = None
    left: dict[str, tuple[float, ...]] | None = None
    tail: float | None = None

    def levels(self) -> tuple[float, float]:
        """The least and the largest input for a unit step, its rest taken off."""
        made = self.prefilter
        assert made is not None
        slowest = min((-rate.real for rate in made.poles), default=math.inf)
        since = np.linspace(0.0, LONG / slowest if made.poles else 0.0, LOOKS)
        times = np.union1d(np.concatenate([delay + since for delay in made.delays]), np.nextafter(made.delays[1:], -np.inf))
        values = made.reference(times)
        return min(0.0, float(values.min())), max(0.0, float(values.max()))


@dataclass(frozen=True, slots=True)
class Compared:
    """The filter that was asked for, and others beside it."""

    done: Designed
    found: tuple[Alternative, ...]

    def to_dict(self) -> dict[str, Any]:
        """The object of `prefilter --compare --json` (docs/schemas.md)."""
        return {
            "study": str(self.done.study.file),
            "factors": [float(factor) for factor in AROUND],
            "minimum_time": {"lower": self.done.bound.lower, "upper": self.done.bound.upper},
            "designs": [self._record(one) for one in self.found],
        }

    def _record(self, one: Alternative) -> dict[str, Any]:
        made = one.prefilter
        if made is None:
            return {"name": one.name, "prefilter": None, "reason": one.reason}
        rest, move = float(self.done.study.plant.initial_input), self.done.displacement
        return {
            "name": one.name,
            "prefilter": made.to_dict(),
            "duration": made.duration,
            "input": sorted(rest + move * level for level in one.levels()),
            "tail_length": one.tail,
            "left": {name: list(values) for name, values in (one.left or {}).items()},
        }

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Cells of a table: `headings` and a row for each design."""
        for record in self.to_dict()["designs"]:
            if record["prefilter"] is None:
                yield (record["name"], "–", "–", "–", "–", *("–" for _ in self.names))
                continue
            low, high = record["input"]
            cells = [str(len(record["prefilter"]["delays"]) - 1), f"{record['duration']:.6f}", f"{low:.4g} to {high:.4g}"]
            cells.append(f"{record['tail_length']:.4g}")
            places = [AROUND.index(factor) for factor in TOLD]
            worst = (max(record["left"][name][place] for place in places) for name in self.names)
            yield (record["name"], *cells, *(f"{100 * value:.3g} %" for value in worst))

    @property
    def names(self) -> tuple[str, ...]:
        """The roots that may be elsewhere."""
        return tuple(named(self.done.plant))

    @property
    def headings(self) -> tuple[str, ...]:
        """Of the table."""
        plant = self.done.study.plant
        fixed = ("design", "delays", "duration [s]", f"input [{plant.input_unit or '–'}]", f"tail within {SETTLED:.0%} [s]")
        return (*fixed, *(f"left, {name} ± 10 %" for name in self.names))


def compared(done: Designed) -> Compared:
    """The designs beside a filter: steps alone for all poles at once (concurrent), and for one pole after the other (cascade)."""
    plant = done.plant
    asked = Alternative(f"asked for, {done.request.form}", done.prefilter)
    concurrent = _tried("steps alone, concurrent", lambda: _concurrent(plant, done.request))
    cascade = _tried("steps alone, cascade", lambda: _cascade(plant, concurrent.prefilter))
    return Compared(done, tuple(_measured(plant, one) for one in (asked, concurrent, cascade)))


def _tried(name: str, design: Callable[[], Prefilter]) -> Alternative:
    try:
        return Alternative(name, design())
    except RelaxationsError as refused:
        return Alternative(name, None, str(refused))


def _concurrent(plant: LinearPlant, request: Request) -> Prefilter:
    """The filter of the fewest steps within the same limits that leaves the zeros alone; raises `RelaxationsError`."""
    refused: RelaxationsError | None = None
    for delays in range(1, MOST_DELAYS + 1):
        try:
            return cancelling(plant, replace(request, delays=delays, form="last", zeros=(), instants=None, sample_time=None))
        except RelaxationsError as problem:
            refused = problem
    assert refused is not None
    raise refused


def _cascade(plant: LinearPlant, beside: Prefilter | None) -> Prefilter:
    """Two steps for each pole: half a period for a mode; of real poles, which leave it open, what the concurrent filter takes beyond the
    modes, in equal parts, or a time constant each. Raises `RelaxationsError`."""
    if plant.rigid_order:
        raise ShaperError("a cascade has a static gain for each of its filters, and a rigid body has none")
    modes = [(f"mode[{i}]", None) for i in range(1, len(plant.flexible) + 1)]
    first = staged(plant, modes)
    spare = 0.0 if beside is None else beside.duration - sum(one.duration for one in first)
    delays = [spare / len(plant.real) if spare > 0.0 else 1.0 / abs(pole.value) for pole in plant.real]
    others = staged(plant, [(f"real[{i}]", delay) for i, delay in enumerate(delays, 1)])
    return cascaded((*first, *others)).scaled(float(plant.rest_input(Fraction(1))))


def _measured(plant: LinearPlant, one: Alternative) -> Alternative:
    """With what is left of a unit move where a root is elsewhere: the largest deviation from the target after the last delay."""
    made = one.prefilter
    if made is None:
        return one
    left = {}
    for name in named(plant):
        values, where = [], name if name.startswith("zero") else f"{name}.frequency"
        for factor in AROUND:
            other = moved(plant, [axis(plant, where, min(Fraction(1), factor), max(Fraction(1), factor))]).member((factor,))
            roots = (*other.poles, *other.zeros)
            slowest = max((1.0 / abs(root.value.real or root.value) for root in roots if root.value), default=1.0)
            since = np.linspace(0.0, min(LONG * slowest, LASTING * max(made.duration, 1e-300)), LOOKS)
            values.append(float(np.abs(output(other, made, made.duration + since) - 1.0).max()))
        left[name] = tuple(values)
    return replace(one, left=left, tail=tail_length(made, SETTLED))


def draw(done: Compared, path: Path) -> None:
    """What each design leaves against the place of each root, as an SVG file."""
    from reports.prefilter_charts import families

    factors = [float(factor) for factor in AROUND]
    parts = []
    for name in done.names:
        curves = {one.name: (factors, [100.0 * x for x in one.left[name]]) for one in done.found if one.left is not None}
        parts.append((f"{name}, times its place", "left [% of the move]", curves))
    title = f"{done.done.study.title or done.done.study.file.stem}: what filters leave if a root is elsewhere"
    write_atomically(path, families(title, *parts).encode())
