"""Commands that are their own mirror image about the middle of the move: half as many equations for half as many durations.

Where no mode of a plant decays and it rests without input, a command `u(T - t) = e u(t)`, `e = (-1)^(r-1)` for r poles at the origin, meets
half of the moment equations by itself (`relaxations.checking.mirrored`). The other half, about the middle, is a task of its own, of the
first half of the command alone: the same functions of time to go, those of the right parity, and half the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relaxations.maneuvers import Problem, TargetSet
from relaxations.moments import Basis

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HalfBasis(Basis):
    """The rows of a basis whose functions have one parity (n,)."""

    chosen: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Number of real rows."""
        return len(self.chosen)

    def rows(self, s: Sequence[float] | Reals, integrals: int = 0) -> Reals:
        """As of a basis: shape (size, len(s))."""
        return Basis.rows(self, s, integrals)[list(self.chosen)]


def parity(problem: Problem) -> int:
    """e, or 0 where no command is known to meet half of the equations by being its own image."""
    maneuver, poles = problem.maneuver, problem.sets[0].basis.poles if problem.sets else ()
    other = problem.residuals or problem.courses or problem.transition or problem.begin is not None or problem.rate or maneuver.tail
    rigid = sum(pole.multiplicity for pole in poles if pole.is_rigid)
    if other or maneuver.sample_time is not None or len(problem.sets) != 1 or not rigid or any(pole.value.real for pole in poles):
        return 0
    return (-1) ** (rigid - 1)


def half(problem: Problem) -> Problem:
    """The task of the first half of a command: time to go counts from the middle, durations and fuel are half as much."""
    (whole,), e, parities = problem.sets, parity(problem), []
    for pole in whole.basis.poles:
        for k in range(pole.multiplicity):
            parities += [(-1) ** k * side for side in (1, -1)[: 2 if pole.is_flexible else 1]]
    chosen = tuple(i for i, one in enumerate(parities) if one == e)
    limits = replace(problem.maneuver.limits, fuel=None if problem.maneuver.limits.fuel is None else problem.maneuver.limits.fuel / 2)
    own = TargetSet(HalfBasis(whole.basis.poles, chosen), whole.target[list(chosen)] / 2.0)
    fuel = None if problem.fuel is None else problem.fuel / 2.0
    return replace(problem, sets=(own,), frame=None, fuel=fuel, maneuver=replace(problem.maneuver, limits=limits))
