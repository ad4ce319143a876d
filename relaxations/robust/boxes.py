"""A box of plants: one transfer function over ranges of its parameters, or a list of plants where no such function is known.

Every one of them may keep a residual vibration after the command, within a tolerance (../docs/theory.md, section 3). Where they come to
rest is no matter of the command: the moments at the origin are the same functions in every plant, and one final rest input holds all.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_poly
from numpy.typing import NDArray

from relaxations.errors import ManeuverError
from relaxations.plants import LinearPlant, fraction

Reals = NDArray[np.float64]
Place = tuple[Fraction, ...]
Polynomial = tuple[tuple[Fraction, tuple[int, ...]], ...]  # terms: coefficient, power of each parameter

LOOKED = {1: 257, 2: 17, 3: 5}  # values of each parameter, by their number, at which the final error is looked at


@dataclass(frozen=True, slots=True)
class Axis:
    """One parameter of a box: exact nominal value and range, in the parameter's own unit."""

    name: str
    nominal: Fraction
    low: Fraction
    high: Fraction


@dataclass(frozen=True, slots=True)
class Family:
    """A transfer function whose coefficients (highest power of s first) are polynomials in the parameters of a box; and the numerators of
    other `outputs`, by their names, over the same denominator. The controlled output has the `name`."""

    numerator: tuple[Polynomial, ...]
    denominator: tuple[Polynomial, ...]
    outputs: tuple[tuple[str, tuple[Polynomial, ...]], ...] = ()
    name: str = "output"

    def member(self, place: Sequence[Fraction]) -> LinearPlant:
        """The plant at one place."""
        plant = LinearPlant.from_transfer(*self.written(place))
        if not self.outputs and self.name == plant.output:
            return plant
        lead = _value(self.denominator[0], place)
        numerators = {self.name if key == plant.output else key: numerator for key, numerator in plant.numerators.items()}
        for name, numerator in self.outputs:
            values = [_value(terms, place) / lead for terms in reversed(numerator)]
            numerators[name] = fmpq_poly([fmpq(x.numerator, x.denominator) for x in values])
        return LinearPlant(plant.denominator, numerators, self.name)

    def above(self, name: str) -> tuple[Polynomial, ...]:
        """The numerator of an output: one of those, or the controlled one or its rate."""
        return dict(((self.name, self.numerator), ("output_rate", (*self.numerator, ())), *self.outputs))[name]

    def written(self, place: Sequence[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
        """Its numerator and denominator."""
        upper, lower = ([_value(terms, place) for terms in which] for which in (self.numerator, self.denominator))
        return upper, lower

    def coefficients(self, places: Reals, name: str | None = None) -> tuple[Reals, Reals]:
        """Numerators, of the controlled output or a named one, and denominators at `places` (k, parameters), highest power first."""
        found = []
        for which in (self.above(name or self.name), self.denominator):
            table = np.zeros((len(places), len(which)))
            for column, terms in enumerate(which):
                for coefficient, powers in terms:
                    table[:, column] += float(coefficient) * np.prod(places ** np.array(powers), axis=1)
            found.append(table)
        return found[0], found[1]


@dataclass(frozen=True, slots=True)
class Listed:
    """Plants known at some places of a box only: nothing is said of those between them."""

    plants: tuple[tuple[Place, LinearPlant], ...]

    @property
    def places(self) -> tuple[Place, ...]:
        """Where a plant is known."""
        return tuple(place for place, _ in self.plants)

    def member(self, place: Sequence[Fraction]) -> LinearPlant:
        """The plant at one of the places."""
        return next(plant for known, plant in self.plants if known == tuple(place))

    def written(self, place: Sequence[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
        """Its numerator and denominator."""
        plant = self.member(place)
        upper, lower = ([fraction(c) for c in reversed(p.coeffs())] for p in (plant.numerators[plant.output], plant.denominator))
        return upper, lower


def at(place: Sequence[Fraction]) -> str:
    """A place in words."""
    return f"at ({', '.join(f'{float(x):.6g}' for x in place)})"


def _value(terms: Polynomial, place: Sequence[Fraction]) -> Fraction:
    total = Fraction(0)
    for coefficient, powers in terms:
        for value, power in zip(place, powers, strict=True):
            coefficient *= value**power
        total += coefficient
    return total


@dataclass(frozen=True, slots=True)
class Box:
    """Every plant of `family` over `axes` may keep a residual of `tolerance` |Δ|, and rest up to `final_tolerance` |Δ| from the target.

    `samples` are the places that the program looks at. Without a `final_tolerance` it does not matter where other plants than the nominal
    one come to rest.
    """

    axes: tuple[Axis, ...]
    family: Family | Listed
    tolerance: Fraction
    samples: tuple[Place, ...] = ()
    final_tolerance: Fraction | None = None

    def __post_init__(self) -> None:
        wrong = [
            f"{axis.name}: {float(axis.nominal)!r} is not in [{float(axis.low)!r}, {float(axis.high)!r}]"
            for axis in self.axes
            if not axis.low <= axis.nominal <= axis.high
        ]
        if wrong:
            raise ManeuverError(f"a parameter's nominal value lies in its range; {'; '.join(wrong)}")
        if not self.tolerance > 0:
            raise ManeuverError(
                f"no command leaves no residual at all in a whole box: a tolerance is more than 0, not {float(self.tolerance)!r}"
            )
        if self.final_tolerance is not None and self.final_tolerance < 0:
            raise ManeuverError(f"a final tolerance is 0 or more, not {float(self.final_tolerance)!r}")
        if isinstance(self.family, Listed) and self.nominal not in self.family.places:
            raise ManeuverError("the nominal plant is one of a list of plants")

    @property
    def nominal(self) -> Place:
        """The nominal place."""
        return tuple(axis.nominal for axis in self.axes)

    @property
    def looked(self) -> tuple[Place, ...]:
        """The places that the program looks at: samples, or else the nominal one and the corners."""
        return self.samples or tuple(dict.fromkeys((self.nominal, *self.places(2))))

    def places(self, count: int) -> list[Place]:
        """Places evenly over the box, its corners among them: `count` values of each parameter; of a list all there are."""
        if isinstance(self.family, Listed):
            return list(self.family.places)
        sides = [sorted({a.low + (a.high - a.low) * Fraction(i, count - 1) for i in range(count)}) for a in self.axes]
        return list(itertools.product(*sides))

    @property
    def rigid(self) -> int:
        """How many poles at the origin the nominal plant has."""
        return next(k for k, c in enumerate(reversed(self.family.written(self.nominal)[1])) if c)

    def gain(self, place: Sequence[Fraction]) -> Fraction:
        """`N(0) / (D/s^r)(0)` of the plant at a place, r poles at the origin; raises `ManeuverError` where it has more of them."""
        (*_, last), denominator = self.family.written(place)
        lowest = denominator[-1 - self.rigid]
        if not lowest or any(denominator[len(denominator) - self.rigid :]):
            raise ManeuverError(f"the plant {at(place)} in the box has more poles at the origin than the nominal one")
        return last / lowest

    def final_error(self, place: Sequence[Fraction]) -> Fraction:
        """`|y(∞) - target| / |Δ|` of the plant at a place, whatever the command: `|gain / nominal gain - 1|`.

        The command's one moment that moves a body at rest for good, or the one input that holds, is what the nominal plant needs.
        """
        return abs(self.gain(place) / self.gain(self.nominal) - 1)

    def beyond(self) -> Place | None:
        """A place whose plant comes to rest too far from the target, found among places evenly over the box; None if none is."""
        if self.final_tolerance is None:
            return None
        tried = self.places(LOOKED.get(len(self.axes), 3))
        worst = max(tried, key=self.final_error)
        return worst if self.final_error(worst) > self.final_tolerance else None
