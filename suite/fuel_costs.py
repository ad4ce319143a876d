"""`slewcert fuel --alpha`: the move whose time and weighted fuel together are least, `∫ (1 + α|u|) dt`, bracketed by one certificate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from pathlib import Path
from typing import Any

from relaxations.onoff.weights import Weighted
from reports.files import write_atomically
from suite import weighing
from suite.design import pose
from suite.errors import Mistake, StudyError
from suite.fuel_plans import FuelError
from suite.fuel_times import plain
from suite.plants import nominal_plant
from suite.study import Study


@dataclass(frozen=True, slots=True)
class FuelCost:
    """The bracket of the least `T + α fuel` [s] of the study's move, and the certificate that was written."""

    study: Study
    found: Weighted
    rest: float
    file: Path | None = None

    @property
    def unit(self) -> str:
        """Of fuel."""
        return f"{self.study.plant.input_unit or 'input'}·s"

    def to_dict(self) -> dict[str, Any]:
        """The object of `fuel --alpha --json` (docs/schemas.md)."""
        own = {"study": str(self.study.file), "fuel_unit": self.unit}
        return own | weighing.record(self.found, self.rest, None if self.file is None else str(self.file))

    def lines(self) -> Iterator[str]:
        """The same in words."""
        yield from weighing.lines(self.found, self.rest, self.unit)
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
    found = weighing.weighed(study, posed, alpha)
    file = None
    if certificates is not None and found.certificate is not None:
        file = certificates / f"{study.file.stem}.alpha-{float(alpha):g}.certificate.json"
        write_atomically(file, found.certificate)
    return FuelCost(study, found, posed.rest, file)
