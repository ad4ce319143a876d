"""Seeded random plants and maneuvers in short decimals, so that a failing one can be written down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant


@dataclass(frozen=True)
class Random:
    """A plant in zeros, poles and gain, and what it has to do; everything printable."""

    seed: int
    zeros: tuple[tuple[Fraction, Fraction], ...]
    poles: tuple[tuple[Fraction, Fraction], ...]
    gain: Fraction
    displacement: Fraction
    limits: tuple[Fraction, Fraction]
    rest: Fraction
    robustness: int | Mapping[str, int] = 0

    @property
    def plant(self) -> LinearPlant:
        return LinearPlant.from_zeros_poles(self.zeros, self.poles, self.gain)

    def problem(self) -> Problem:
        return problem([self.plant], Maneuver(self.displacement, Limits.of(*self.limits), self.rest, self.robustness))


def random_maneuver(seed: int) -> Random:
    """0 to 2 integrators, 0 to 2 flexible modes (undamped, light or heavy), 0 to 2 real poles, 0 or 1 zero; limits around both rests."""
    rng = np.random.default_rng([2024, seed])

    def decimal(low: float, high: float) -> Fraction:
        return Fraction(round(rng.uniform(low, high), 3)).limit_denominator(1000)

    def pair(natural: Fraction, damping: Fraction) -> list[tuple[Fraction, Fraction]]:
        return [(-damping * natural, natural), (-damping * natural, -natural)]

    zero = Fraction(0)
    poles = [(zero, zero)] * int(rng.integers(0, 3))
    for _ in range(int(rng.integers(0, 3))):
        poles += pair(decimal(0.5, 5.0), [zero, decimal(0.001, 0.1), decimal(0.2, 0.7)][int(rng.integers(0, 3))])
    for _ in range(int(rng.integers(0 if poles else 1, 3))):
        poles.append((-decimal(0.1, 4.0), zero))
    zeros = [(decimal(-3.0, 3.0) or Fraction(1), zero)] if len(poles) > 1 and rng.random() < 0.4 else []
    gain = decimal(0.5, 2.0) * (1 if rng.random() < 0.8 else -1)
    limits = (-decimal(0.2, 2.0), decimal(0.2, 2.0))
    rest = (limits[0] + limits[1]) / 2 if rng.random() < 0.3 else zero
    plant = LinearPlant.from_zeros_poles(zeros, poles, gain)
    forward = rng.random() < 0.7
    if plant.rigid_order:  # about as far as the rigid body comes in 1 to 12 s
        reach = plant.partial().residues[0][-1].real * float(limits[1] if forward else limits[0])
        displacement = Fraction(f"{reach * (float(decimal(1.0, 12.0)) / plant.rigid_order) ** plant.rigid_order:.3g}")
    else:  # the final rest input is at most nine tenths of the way to a limit
        hold = decimal(0.05, 0.9) * ((limits[1] if forward else limits[0]) - rest)
        displacement = hold / plant.rest_input(Fraction(1))
    robustness = int(rng.random() < 0.2)
    return Random(seed, tuple(zeros), tuple(poles), gain, displacement, limits, rest, robustness)
