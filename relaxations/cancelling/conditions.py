"""What a filter must satisfy so that it cancels a plant's poles and takes the output to the reference: equations linear in its gains.

With G_p = N/D, at each pole p of multiplicity m (further zeros of robustness added) the Taylor coefficients 0 … m-1 of G_f vanish
(Singh 2012, (50), (52)). At the origin, where D has a zero of order r ≥ 0, those below r vanish and that of s^r is D_r/N(0), so that the
output goes to the reference (51). Poles of the filter are the plant's zeros left of the imaginary axis: a block `s^q e^{-sτ}/N_-(s)`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from flint import fmpq_poly
from numpy.typing import ArrayLike, NDArray

from relaxations.errors import PlantError
from relaxations.maneuvers import extra_zeros
from relaxations.plants import LinearPlant, Pole, fraction, taylor
from relaxations.shaping.shapers import ShaperTerm
from relaxations.visibility import visible

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def _told(pole: complex) -> str:
    """A real pole, or a pair."""
    return f"{pole.real:.6g} ± {abs(pole.imag):.6g}j" if pole.imag else f"{pole.real:.6g}"


@dataclass(frozen=True, slots=True)
class Part:
    """What one unknown of a filter multiplies: a step at delay number `delay` (power None), or `s^power/N_-(s)` there."""

    delay: int
    power: int | None = None


@dataclass(frozen=True)
class Conditions:
    """The equations of a plant: `zeros` that the filter's poles cancel, `poles` (multiplicities with further zeros) that its zeros cancel.

    `target`: what the Taylor coefficient of s^r at the origin is, r = `rigid`.
    """

    zeros: tuple[Pole, ...]
    poles: tuple[Pole, ...]
    rigid: int
    target: float

    @staticmethod
    def of(plant: LinearPlant, robustness: int | Mapping[str, int] = 0, zeros: Sequence[complex] | None = None) -> Conditions:
        """Of a stable or marginally stable plant; `zeros` [1/s] (None: all that can be) are those cancelled, as the output sees it.

        With none the whole state comes to rest, modes that the output cannot see as well.

        Raises `PlantError` for an unstable plant, a zero at the origin or one that a filter cannot cancel, `ManeuverError` for hidden modes
        that do not decay and for modes that robustness names and the plant lacks.
        """
        seen = plant if zeros is not None and not len(zeros) else visible(plant)
        if seen.is_unstable:
            growing = ", ".join(_told(pole.value) for pole in seen.poles if pole.value.real >= 0 and not pole.is_rigid)
            raise PlantError(f"a filter in front of a plant does not stabilise it: unstable poles {growing}; close a loop around it first")
        seen.rest_input(fraction(seen.denominator.leading_coefficient()))  # a zero at the origin is refused
        extra = extra_zeros(seen, robustness)
        poles = tuple(Pole(p.value, p.multiplicity + extra.get(p.value, 0)) for p in seen.poles if not p.is_rigid)
        low = seen.denominator.coeffs()[seen.rigid_order] / seen.numerators[seen.output](0)
        return Conditions(_cancelled(seen, zeros), poles, seen.rigid_order, float(fraction(low)))

    @property
    def size(self) -> int:
        """Number of real equations."""
        return self.rigid + 1 + sum(pole.multiplicity * (2 if pole.is_flexible else 1) for pole in self.poles)

    @property
    def order(self) -> int:
        """Degree of N_-."""
        return sum(zero.multiplicity * (2 if zero.is_flexible else 1) for zero in self.zeros)

    @cached_property
    def block(self) -> LinearPlant:
        """1/N_-(s), monic, of the zeros as doubles."""
        values = [
            z for zero in self.zeros for z in [zero.value, zero.value.conjugate()][: 2 if zero.is_flexible else 1] * zero.multiplicity
        ]
        return LinearPlant.from_zeros_poles([], [[z.real, z.imag] for z in values], 1)

    @cached_property
    def places(self) -> tuple[Pole, ...]:
        """The points of the equations: the origin first, then the poles."""
        return (Pole(0j, self.rigid + 1), *self.poles)

    @cached_property
    def _series(self) -> dict[int | None, tuple[tuple[complex, ...], ...]]:
        """Taylor coefficients of what is delayed, at each place, by power (None: of 1)."""
        found: dict[int | None, tuple[tuple[complex, ...], ...]] = {
            None: tuple(tuple(1 + 0j if k == 0 else 0j for k in range(p.multiplicity)) for p in self.places)
        }
        for power in range(max(self.order, 1)):
            numerator = fmpq_poly([0] * power + [1])
            found[power] = tuple(taylor(numerator, self.block.denominator, p.value, p.multiplicity) for p in self.places)
        return found

    def table(self, parts: Sequence[Part], delays: ArrayLike) -> Reals:
        """The equations' left sides for each unit part, (…, size, parts), at delays (…, L+1) [s]; those of a pole p times |e^{pT}|."""
        return self._rows(parts, delays, 0)

    def slopes(self, parts: Sequence[Part], delays: ArrayLike) -> Reals:
        """The derivative of each column by its own delay, in the same scale (which is held)."""
        return self._rows(parts, delays, 1)

    @cached_property
    def chains(self) -> NDArray[np.intp]:
        """Which complex number each row is a part of: numbered, shape (size,)."""
        widths = [2 if place.is_flexible else 1 for place in self.places for _ in range(place.multiplicity)]
        return np.repeat(np.arange(len(widths)), widths)

    def error(self, parts: Sequence[Part], delays: ArrayLike, unknowns: Reals) -> float:
        """How far gains and numerators (parts,) are from satisfying the equations, over the size of what is summed in each."""
        table = self.table(parts, delays)
        off, sizes = table @ unknowns - self.aim, np.abs(table) @ np.abs(unknowns) + np.abs(self.aim)
        whole = np.maximum(np.bincount(self.chains, sizes), np.finfo(float).tiny)
        return float((np.bincount(self.chains, np.abs(off)) / whole).max())

    @cached_property
    def aim(self) -> Reals:
        """The right sides, shape (size,)."""
        aim = np.zeros(self.size)
        aim[self.rigid] = self.target
        return aim

    def _rows(self, parts: Sequence[Part], delays: ArrayLike, derivative: int) -> Reals:
        instants = np.asarray(delays, dtype=float)
        table = np.empty((*instants.shape[:-1], self.size, len(parts)))
        for column, part in enumerate(parts):
            delay, row = instants[..., part.delay], 0
            for place, series in zip(self.places, self._series[part.power], strict=True):
                p, count = place.value, place.multiplicity
                shift = [(-delay) ** i / math.factorial(i) for i in range(count)]
                chain = [sum((shift[i] * series[k - i] for i in range(k + 1)), np.zeros(delay.shape, dtype=complex)) for k in range(count)]
                if derivative:  # of e^{-sτ}: times -s = -(p + ε)
                    chain = [-(p * chain[k] + (chain[k - 1] if k else 0j)) for k in range(count)]
                factor = np.exp((instants[..., -1] - delay) * p.real - 1j * delay * p.imag)
                for value in chain:
                    table[..., row, column] = np.real(value * factor)
                    if place.is_flexible:
                        table[..., row + 1, column] = np.imag(value * factor)
                    row += 2 if place.is_flexible else 1
        return table

    def terms(self, power: int, coefficient: float, delay: float) -> tuple[ShaperTerm, ...]:
        """`coefficient s^power e^{-s delay}/N_-(s)` in partial fractions."""
        partial = LinearPlant(self.block.denominator, {"output": fmpq_poly([0] * power + [1])}).partial()
        return tuple(
            ShaperTerm(delay, pole.value, k, coefficient * residue * (2 if pole.is_flexible else 1) / math.factorial(k))
            for pole, residues in zip(self.block.poles, partial.residues, strict=True)
            for k, residue in enumerate(residues)
            if residue
        )


def _cancelled(plant: LinearPlant, asked: Sequence[complex] | None) -> tuple[Pole, ...]:
    stable = tuple(zero for zero in plant.zeros if zero.value.real < 0)
    if asked is None:
        return stable
    halves: Counter[tuple[complex, bool]] = Counter()
    for value in asked:
        wanted = complex(value.real, abs(value.imag))
        nearest = min(plant.zeros, key=lambda zero: abs(zero.value - wanted), default=None)
        if nearest is None or abs(nearest.value - wanted) > 1e-6 * abs(wanted):
            known = ", ".join(f"{zero.value:.6g}" for zero in plant.zeros) or "none at all"
            raise PlantError(f"the plant has no zero at {value:.6g}; its zeros are {known}")
        if nearest.value.real >= 0:
            where = "on" if nearest.value.real == 0 else "right of"
            raise PlantError(
                f"the zero at {nearest.value:.6g} lies {where} the imaginary axis: what cancels it has a pole there, and its output does "
                "not decay; only zeros left of the axis are cancelled"
            )
        halves[nearest.value, value.imag < 0] += 1
    counts = {zero.value: zero.multiplicity for zero in stable}
    chosen = {value: max(halves[value, False], halves[value, True]) for value, _ in halves}
    for value, count in chosen.items():
        if count > counts[value]:
            raise PlantError(f"the zero at {value:.6g} has multiplicity {counts[value]}, not {count}")
    return tuple(Pole(value, count) for value, count in sorted(chosen.items(), key=lambda one: (abs(one[0]), one[0].imag)))
