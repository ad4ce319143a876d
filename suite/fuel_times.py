"""`slewcert fuel --time`: the least fuel of a move in a given time, bracketed by two certificates of minimum times within budgets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from pathlib import Path
from typing import Any

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.onoff.spent import FuelBound, fuel_at
from relaxations.proofs import minimum_time
from suite.design import pose
from suite.errors import ABSENT, Mistake, StudyError
from suite.fuel_plans import FuelError
from suite.plants import nominal_plant
from suite.rounding import outward
from suite.study import Study
from suite.sweeps import kept


@dataclass(frozen=True, slots=True)
class FuelAtTime:
    """The bracket of the least fuel [input units · s] of moves of at most `time` [s]; `found` is None where no fuel is enough.

    `fastest` brackets the minimum time without a budget. `files` are the certificates that were written: that of the lower side, that of
    the upper one; of a time that is too short that of `fastest` alone.
    """

    study: Study
    time: float
    fastest: Bound
    found: FuelBound | None
    rest: float
    files: tuple[Path | None, ...] = ()

    @property
    def status(self) -> str:
        """`proved`: both sides are; `bracketed`: one is missing; `impossible`: the time is proven to be too short."""
        if self.found is None:
            return "impossible"
        return "proved" if self.found.lower is not None and self.found.upper is not None else "bracketed"

    @property
    def unit(self) -> str:
        """Of fuel."""
        return f"{self.study.plant.input_unit or 'input'}·s"

    def to_dict(self) -> dict[str, Any]:
        """The object of `fuel --time --json` (docs/schemas.md)."""
        found = self.found
        lower, upper = (None, None) if found is None else (found.lower, found.upper)
        command = None if found is None else found.command
        return {
            "study": str(self.study.file),
            "status": self.status,
            "time": self.time,
            "fuel_unit": self.unit,
            "least_fuel": None
            if found is None
            else {
                "lower": None if lower is None else math.nextafter(float(lower), -math.inf),
                "upper": None if upper is None else math.nextafter(float(upper), math.inf),
            },
            "minimum_time": {"lower": self.fastest.lower, "upper": self.fastest.upper},
            "command": None if command is None else command.to_dict(),
            "fuel": None if command is None else command.fuel(self.rest),
            "certificates": [str(file) for file in self.files if file is not None],
        }

    def lines(self) -> Iterator[str]:
        """The same in words."""
        fastest, found = self.fastest, self.found
        if found is None:
            least = outward(fastest.lower, ROUND_FLOOR)
            yield f"impossible: no command takes {self.time!r} s or less, whatever the fuel: the minimum time is at least {least} s, proven"
        else:
            low = "–" if found.lower is None else outward(math.nextafter(float(found.lower), -math.inf), ROUND_FLOOR)
            high = "–" if found.upper is None else outward(math.nextafter(float(found.upper), math.inf), ROUND_CEILING)
            yield f"least fuel of a move of at most {self.time!r} s: [{low}, {high}] {self.unit}: {self.status}"
            if self.status != "proved":
                yield f"a side without a number is not proven; computed in floating point: {found.computed:.12g} {self.unit}"
        for file in self.files:
            if file is not None:
                yield f"certificate: {file}"


def least_fuel_of(study: Study, time: float, certificates: Path | None = None) -> FuelAtTime:
    """Bracket the least fuel of the study's move in at most `time` [s]; proofs are written to the folder `certificates`.

    The study's own budget does not count; its form (`command.type`) and further zeros do. Raises `FuelError` for a time that is none, or
    of which nothing is known, `StudyError` for a study with other limits than those of the input.
    """
    if not 0.0 < time < math.inf:
        raise FuelError(f"--time {time!r}: a time in seconds, more than 0 and finite, such as 8.5")
    plain(study)
    posed = pose(replace(study, limits=replace(study.limits, fuel=None)), nominal_plant(study))
    fastest, stem = minimum_time(posed), f"{study.file.stem}.{time!r}"
    proven = fastest.status is Status.PROVED
    if proven and fastest.lower > time:
        return FuelAtTime(study, time, fastest, None, posed.rest, (kept(certificates, f"{study.file.stem}.fastest", fastest),))
    try:
        found = fuel_at(posed, time)
    except ManeuverError as refused:
        if proven and fastest.upper is not None and fastest.upper >= time:
            raise FuelError(f"--time {time!r}: too close to the minimum time, {fastest.upper!r} s; a little more is needed") from None
        raise StudyError(str(study.file), [Mistake("limits.fuel", ABSENT, f"has no least value: {refused}")]) from None
    files = (kept(certificates, f"{stem}.lower", found.below), kept(certificates, f"{stem}.upper", found.above))
    return FuelAtTime(study, time, fastest, found, posed.rest, files)


def plain(study: Study, what: str = "the least fuel at a time") -> None:
    """Raise `StudyError` unless the study moves from rest to state rest by a fastest command within limits of the input alone."""
    mistakes, limits, why = [], study.limits, f"{what} is that of limits of the input alone"
    if study.command.kind != "time-optimal":
        mistakes.append(Mistake("command.kind", study.command.kind, f'{what} is that of "time-optimal" commands'))
    if study.command.robustness == "box":
        mistakes.append(Mistake("command.robustness", "box", f"{what} is that of one plant; further zeros are possible"))
    if study.command.tail:
        mistakes.append(Mistake("command.tail", True, "the fuel of a tail does not count"))
    if study.plant.schedule is not None:
        mistakes.append(Mistake("plant.schedule", ABSENT, f"{what} is that of plants that do not vary"))
    if study.maneuver.initial_state is not None:
        mistakes.append(Mistake("maneuver.initial_state", ABSENT, f"{what} is that of a move from rest"))
    limited = [key for key in ("rate", "pulse_width", "pulses", "sample_time") if getattr(limits, key) is not None]
    mistakes += [Mistake(f"limits.{key}", ABSENT, why) for key in limited]
    if mistakes:
        raise StudyError(str(study.file), mistakes)
