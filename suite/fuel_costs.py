"""`slewcert fuel --alpha`: the move whose time and weighted fuel together are least, `∫ (1 + α|u|) dt`, bracketed by one certificate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal, InvalidOperation
from fractions import Fraction
from pathlib import Path
from typing import Any

from relaxations.errors import ManeuverError
from relaxations.onoff.weights import Weighted, weighted
from reports.files import write_atomically
from suite.design import pose
from suite.errors import ABSENT, Mistake, StudyError
from suite.fuel_plans import FuelError
from suite.fuel_times import plain
from suite.plants import nominal_plant
from suite.rounding import outward
from suite.study import Study


@dataclass(frozen=True, slots=True)
class FuelCost:
    """The bracket of the least `T + α fuel` [s] of the study's move, and the certificate that was written."""

    study: Study
    found: Weighted
    rest: float
    file: Path | None = None

    @property
    def status(self) -> str:
        """`proved`: both sides are; `bracketed`: one is missing."""
        return "bracketed" if self.found.lower is None or self.found.upper is None else "proved"

    @property
    def unit(self) -> str:
        """Of fuel."""
        return f"{self.study.plant.input_unit or 'input'}·s"

    def to_dict(self) -> dict[str, Any]:
        """The object of `fuel --alpha --json` (docs/schemas.md)."""
        found = self.found
        prices = found.prices and [found.prices[0], found.prices[1] if math.isfinite(found.prices[1]) else None]
        return {
            "study": str(self.study.file),
            "status": self.status,
            "alpha": float(found.price),
            "fuel_unit": self.unit,
            "cost": {"lower": found.lower, "upper": found.upper},
            "maneuver_time": found.command.maneuver_time,
            "fuel": found.command.fuel(self.rest),
            "switch_times": [segment.start for segment in found.command.segments[1:]],
            "extremal": found.extremal,
            "extremal_prices": prices,
            "command": found.command.to_dict(),
            "certificate": None if self.file is None else str(self.file),
        }

    def lines(self) -> Iterator[str]:
        """The same in words."""
        found, alpha = self.found, f"{float(self.found.price):g}"
        low = "–" if found.lower is None else outward(found.lower, ROUND_FLOOR)
        high = "–" if found.upper is None else outward(found.upper, ROUND_CEILING)
        yield f"least cost ∫(1 + {alpha}·|u|) dt: [{low}, {high}] s: {self.status}"
        if self.status != "proved":
            yield f"a side without a number is not proven; the command costs {found.computed:.12g} s in floating point"
        yield f"maneuver time {found.command.maneuver_time:.12g} s, fuel {found.command.fuel(self.rest):.12g} {self.unit}"
        if found.prices is None:
            yield "dead-zone check (maximum principle): for no α is this command extremal"
        else:
            low, high = (f"{one:.6g}" if math.isfinite(one) else "∞" for one in found.prices)
            verdict = "passed" if found.extremal else "failed"
            yield f"dead-zone check (maximum principle): {verdict}; the command is extremal for α from {low} to {high} s per {self.unit}"
        if self.file is not None:
            yield f"certificate: {self.file}"


def price(option: str, text: str) -> Fraction:
    """A price of fuel [s per input unit · s], more than 0; raises `FuelError`."""
    try:
        value = Fraction(Decimal(text.strip()))
    except (InvalidOperation, ValueError, OverflowError):
        raise FuelError(f"{option} is a price of fuel such as 0.5 (seconds per input unit · second), not {text!r}") from None
    if value <= 0:
        raise FuelError(f"{option} {text}: a price of fuel is more than 0; without one the cost is the time, see `slewcert bound`")
    return value


def least_cost_of(study: Study, alpha: Fraction, certificates: Path | None = None) -> FuelCost:
    """Bracket the least `T + α fuel` of the study's move; the proof is written to the folder `certificates`.

    The study's own budget does not count; its further zeros do. Raises `StudyError` for a study with other limits than those of the input,
    or a form that is held.
    """
    plain(study, "fuel beside time")
    if study.command.type == 1:
        raise StudyError(str(study.file), [Mistake("command.type", 1, "fuel is weighed against the time of all commands, of any form")])
    posed = pose(replace(study, limits=replace(study.limits, fuel=None)), nominal_plant(study))
    try:
        found = weighted(posed, alpha)
    except ManeuverError as refused:
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, f"has no least cost: {refused}")]) from None
    file = None
    if certificates is not None and found.certificate is not None:
        file = certificates / f"{study.file.stem}.alpha-{float(alpha):g}.certificate.json"
        write_atomically(file, found.certificate)
    return FuelCost(study, found, posed.rest, file)
