"""Seeded random tasks for the prover: 2 to 12 poles, with and without zeros on either side, with and without a tail; short decimals."""

from __future__ import annotations

import random
from dataclasses import dataclass
from fractions import Fraction

from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant

Root = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class RandomTask:
    """A plant in roots and what it has to do."""

    seed: int
    zeros: tuple[Root, ...]
    poles: tuple[Root, ...]
    displacement: Fraction
    limits: tuple[Fraction, Fraction]
    robustness: int
    tail: bool

    @property
    def plant(self) -> LinearPlant:
        return LinearPlant.from_zeros_poles(self.zeros, self.poles, 1)

    def problem(self) -> Problem:
        return problem([self.plant], Maneuver(self.displacement, Limits(*self.limits), robustness=self.robustness, tail=self.tail))


def random_task(seed: int) -> RandomTask:
    """Limits contain both rests with room to spare, or have the initial rest input on one."""
    rng = random.Random(seed)

    def decimal(low: float, high: float) -> Fraction:
        return Fraction(round(rng.uniform(low, high) * 100), 100)

    order = rng.randint(2, 12)
    poles: list[Root] = [(Fraction(0), Fraction(0))] * min(rng.choice([0, 0, 1, 2]), order)
    while len(poles) < order:
        if order - len(poles) >= 2 and rng.random() < 0.6:
            natural, damping = decimal(0.5, 6), rng.choice([Fraction(0), Fraction(1, 100), Fraction(5, 100), Fraction(2, 10)])
            damped = Fraction(round(float(natural) * (1 - float(damping) ** 2) ** 0.5 * 1000), 1000)
            poles += [(-damping * natural, damped), (-damping * natural, -damped)]
        else:
            poles.append((-decimal(0.2, 5), Fraction(0)))
    zeros: list[Root] = []
    if rng.random() < 0.5:
        wanted = rng.randint(1, max(1, order // 2))
        while len(zeros) < wanted:
            side = rng.choice([-1, -1, -1, 1])
            if wanted - len(zeros) >= 2 and rng.random() < 0.4:
                real, imaginary = side * decimal(0.1, 3), decimal(0.3, 4)
                zeros += [(real, imaginary), (real, -imaginary)]
            else:
                zeros.append((side * decimal(0.2, 5), Fraction(0)))
    tail = bool(zeros) and rng.random() < 0.6
    plant = LinearPlant.from_zeros_poles(zeros, poles, 1)
    sign, size = rng.choice([-1, 1]), Fraction(round(10 ** rng.uniform(-1, 1) * 100), 100)
    displacement = sign * size
    if plant.rigid_order:
        reach = abs(plant.partial().residues[0][-1].real) * rng.uniform(0.5, 12) ** plant.rigid_order
        displacement = sign * Fraction(max(round(reach * 1e6), 1), 10**6)
    hold = abs(float(plant.rest_input(displacement)))
    lower, upper = (Fraction(round((hold * rng.uniform(1.05, 4) + 0.1) * 1000), 1000) for _ in range(2))
    one_sided = rng.random() < 0.2 and plant.rest_input(displacement) > 0
    robustness = rng.choice([0, 0, 0, 1])
    return RandomTask(seed, tuple(zeros), tuple(poles), displacement, (Fraction(0) if one_sided else -lower, upper), robustness, tail)
