"""Robust tasks: one command for every plant in a box of parameters, its residual vibration within a tolerance in all of them.

The moments at the origin are the same functions in every plant, so all of them rest together there, exactly. Beside it each plant of the
box may move: its output about its final value is bounded, instant by instant, by rows of the program (../docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from relaxations.errors import ManeuverError
from relaxations.moments import Basis
from relaxations.plants import LinearPlant

Reals = NDArray[np.float64]
Polynomial = tuple[tuple[Fraction, tuple[int, ...]], ...]  # terms: coefficient, power of each parameter

PERIODS = 8.0  # of the slowest mode: how long after the command a residual is looked at
LOOKS = 12  # instants in a period of the fastest mode at first
MISSED = 1e-7  # relative excess between two instants that calls for another one


@dataclass(frozen=True, slots=True)
class Axis:
    """One parameter of a box: exact nominal value and range, in the parameter's own unit."""

    name: str
    nominal: Fraction
    low: Fraction
    high: Fraction


@dataclass(frozen=True, slots=True)
class Family:
    """A transfer function whose coefficients (highest power of s first) are polynomials in the parameters of a box."""

    numerator: tuple[Polynomial, ...]
    denominator: tuple[Polynomial, ...]

    def member(self, place: Sequence[Fraction]) -> LinearPlant:
        """The plant at one place."""
        return LinearPlant.from_transfer(*([_value(terms, place) for terms in which] for which in (self.numerator, self.denominator)))


def _value(terms: Polynomial, place: Sequence[Fraction]) -> Fraction:
    total = Fraction(0)
    for coefficient, powers in terms:
        for value, power in zip(place, powers, strict=True):
            coefficient *= value**power
        total += coefficient
    return total


@dataclass(frozen=True, slots=True)
class Box:
    """Every plant of `family` over `axes` may keep a residual of `tolerance` |Δ|; `samples` are the places that the program looks at."""

    axes: tuple[Axis, ...]
    family: Family
    tolerance: Fraction
    samples: tuple[tuple[Fraction, ...], ...] = ()

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

    @property
    def nominal(self) -> tuple[Fraction, ...]:
        """The nominal place."""
        return tuple(axis.nominal for axis in self.axes)


@dataclass(frozen=True, slots=True)
class Sample:
    """One plant of the box at `place`: poles beside the origin, the weights of their moments in the output, their moments at rest."""

    place: tuple[Fraction, ...]
    basis: Basis
    weights: Reals
    rest: Reals
    lasts: float  # how long its residual is looked at [s]

    @staticmethod
    def of(place: tuple[Fraction, ...], plant: LinearPlant, hold: float) -> Sample:
        """Raises `ManeuverError` for an unstable plant (it is nowhere at rest after a command) and for repeated poles."""
        for pole in plant.poles:
            where = f"at {', '.join(f'{float(x):.6g}' for x in place)} in the box the plant"
            if pole.value.real > 1e-12 * abs(pole.value):
                raise ManeuverError(f"{where} is unstable: pole {pole.value:.6g}")
            if not pole.is_rigid and pole.multiplicity > 1:
                raise ManeuverError(f"{where} has the repeated pole {pole.value:.6g}: only the one at the origin may be repeated")
        rigid = plant.rigid_order
        basis = Basis(tuple(pole for pole in plant.poles if not pole.is_rigid))
        weights = Basis(tuple(plant.poles)).weights(plant.partial())[rigid:]
        slowest = min((abs(pole.value) for pole in basis.poles), default=1.0)
        return Sample(place, basis, weights, basis.hold(hold), 2 * np.pi * PERIODS / slowest)

    @property
    def fastest(self) -> float:
        """The largest |p| [1/s]."""
        return max((abs(pole.value) for pole in self.basis.poles), default=1.0)

    def rows(self, since: Reals) -> Reals:
        """The output about its final value at `since` [s] after the command, for each unit moment about the rest: (len(since), n)."""
        units = [self.weights @ self.basis.free(unit, since) for unit in np.eye(self.basis.size)]
        return np.array(units).T if units else np.zeros((len(since), 0))

    def table(self, instants: Reals) -> Reals:
        """The moments at the end of the grid of a unit level in each cell: (n, cells)."""
        integrated = self.basis.rows(instants[-1] - instants, 1)
        return integrated[:, :-1] - integrated[:, 1:]

    def looks(self) -> Reals:
        """Instants at which the residual is limited at first: a period of the fastest mode."""
        return np.linspace(0.0, min(2 * np.pi / self.fastest, self.lasts), LOOKS, endpoint=False)

    def peaks(self, moments: Reals) -> tuple[Reals, Reals]:
        """Instants of the local extremes (and the first instant) of the residual that moments about the rest leave; its size there."""
        fine = np.linspace(0.0, self.lasts, int(24 * self.lasts * self.fastest / (2 * np.pi)) + 3)
        course = self.rows(fine) @ moments
        turns = np.flatnonzero((course[1:-1] - course[:-2]) * (course[2:] - course[1:-1]) <= 0.0) + 1
        y0, y1, y2 = course[turns - 1], course[turns], course[turns + 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = np.nan_to_num((y0 - y2) / (2 * (y0 - 2 * y1 + y2)), posinf=0.0, neginf=0.0)
        found = np.concatenate([[0.0], fine[turns] + np.clip(shift, -1, 1) * (fine[1] - fine[0])])
        return found, np.abs(self.rows(found) @ moments)


@dataclass(frozen=True, slots=True)
class Residuals:
    """What the samples of a box leave after the command: `|r| ≤ allowed` (output units) at instants of each.

    Instants count on one axis: those of sample k from `begins[k]` on, which is after all of the sample before.
    """

    samples: tuple[Sample, ...]
    allowed: float

    @property
    def begins(self) -> Reals:
        """Where the instants of each sample begin."""
        return np.concatenate([[0.0], np.cumsum([2.0 * sample.lasts for sample in self.samples])])[:-1]

    def owner(self, looks: Reals) -> NDArray[np.intp]:
        """The sample that each instant on the one axis belongs to."""
        return np.searchsorted(self.begins, looks, side="right") - 1

    def split(self, looks: Reals) -> list[Reals]:
        """Instants [s] after the command, sample by sample, of instants on the one axis."""
        owner = self.owner(looks)
        return [looks[owner == k] - begin for k, begin in enumerate(self.begins)]

    def looks(self) -> Reals:
        """Instants at which the residuals are limited at first."""
        return np.concatenate([begin + sample.looks() for begin, sample in zip(self.begins, self.samples, strict=True)])

    def table(self, instants: Reals) -> Reals:
        """The moments of all samples at the end of the grid of a unit level in each cell: (n, cells)."""
        return np.vstack([sample.table(instants) for sample in self.samples])

    def rows(self, looks: Reals) -> tuple[Reals, Reals]:
        """`R` (looks, n) and `e` (looks,): the residuals R M - α e of the moments M of all samples."""
        parts = [(sample.rows(since), sample.rest) for sample, since in zip(self.samples, self.split(looks), strict=True)]
        return np.asarray(block_diag(*(rows for rows, _ in parts))), np.concatenate([rows @ rest for rows, rest in parts])

    def exceeded(self, instants: Reals, levels: Reals) -> Reals:
        """Instants of local extremes beyond the tolerance, of levels that reach the target."""
        found = []
        for begin, sample in zip(self.begins, self.samples, strict=True):
            peaks, sizes = sample.peaks(sample.table(instants) @ levels - sample.rest)
            found.append(begin + peaks[sizes > self.allowed * (1.0 + MISSED)])
        return np.concatenate(found)

    def costates(self, multipliers: Sequence[tuple[float, float, float]]) -> list[Reals]:
        """What multipliers (instant on the one axis, μ⁺, μ⁻) add to the costate of each sample's moments."""
        looks = np.array([look for look, _, _ in multipliers])
        forces = np.array([above - below for _, above, below in multipliers])
        owner = self.owner(looks)
        return [
            forces[owner == k] @ sample.rows(since) for k, (sample, since) in enumerate(zip(self.samples, self.split(looks), strict=True))
        ]


def family_of(numerator: Sequence[Mapping[tuple[int, ...], Fraction]], denominator: Sequence[Mapping[tuple[int, ...], Fraction]]) -> Family:
    """From polynomials as mappings of powers to coefficients."""

    def frozen(which: Sequence[Mapping[tuple[int, ...], Fraction]]) -> tuple[Polynomial, ...]:
        return tuple(tuple((Fraction(c), tuple(powers)) for powers, c in sorted(terms.items()) if c) for terms in which)

    return Family(frozen(numerator), frozen(denominator))
