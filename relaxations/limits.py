"""Limits of the input and of named outputs: exact numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from relaxations.errors import ManeuverError
from relaxations.plants import Exact, exact


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits `lower ≤ u(t) ≤ upper`, absolute, input units, exact; where given, `∫_0^T |u - u_0| dt ≤ fuel` (input units · s), and by how
    much each of these named outputs may leave its first rest value, ever (output units). With a `rate` the input is continuous, its slope
    within these two (input units per second). `held` = ±1 holds a form: on this side of the rest (or at it) until some instant of the move,
    on the other side (or at it) from then on."""

    lower: Fraction
    upper: Fraction
    fuel: Fraction | None = None
    pulse_width: Fraction | None = None
    pulses: int | None = None
    deflection: Mapping[str, Fraction] = field(default_factory=dict)
    rate: tuple[Fraction, Fraction] | None = None
    held: int = 0

    @property
    def pulsed(self) -> bool:
        """Whether pulses have a least width or a largest number: pieces of constant input, other than the one at rest."""
        return self.pulse_width is not None or self.pulses is not None

    @staticmethod
    def of(
        lower: Exact,
        upper: Exact,
        fuel: Exact | None = None,
        deflection: Mapping[str, Exact] | None = None,
        rate: tuple[Exact, Exact] | None = None,
    ) -> Limits:
        """From numbers as written; raises `ManeuverError` if they are not ascending."""
        deflections = {name: exact(limit) for name, limit in (deflection or {}).items()}
        slope = rate and (exact(rate[0]), exact(rate[1]))
        limits = Limits(exact(lower), exact(upper), None if fuel is None else exact(fuel), deflection=deflections, rate=slope)
        if not limits.lower < limits.upper:
            raise ManeuverError(f"limits ascend: [{float(limits.lower)!r}, {float(limits.upper)!r}] leaves the input no room")
        return limits
