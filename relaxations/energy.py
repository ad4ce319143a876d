"""Where to look first for the minimum time: what a rigid body needs, what a pole takes, and what the command's energy alone allows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.maneuvers import Problem

CLOSE, ENERGIES = 1.05, 60  # ratio of the two times that the energy's estimate ends with, and how many it may look at
ASIDE = 1.02  # how far to one side of the root it looks
LONGER = 1.1  # than what the energy alone needs: where the first program is solved


def energy_time(problem: Problem, grid: Callable[[float], NDArray[np.float64]], guess: float, farthest: float) -> float:
    """A time [s] that is too short for the command's energy alone, close to the longest such; 0 if there is none. No program is solved."""
    low, high, horizon = 0.0, math.inf, guess
    seen: dict[float, float] = {}  # log α there
    for count in range(ENERGIES):
        most = programs.energy_bound(problem, grid(horizon))
        low, high = (horizon, high) if most < 1.0 else (low, horizon)
        if math.isinf(most) or high <= CLOSE * low or low >= farthest:
            break
        seen[horizon] = math.log(max(most, 1e-300))
        if not low:
            horizon = high / 2.0
        elif len(seen) == 1:
            horizon = min(1.5 * low, farthest)
        else:
            # On logarithms α is nearly straight: to either side of its root in turn, and halfway now and then.
            one, other = (low, high) if math.isfinite(high) else sorted(seen)[-2:]
            rise = (seen[other] - seen[one]) / math.log(other / one)
            root = low * math.exp(min(-seen[low] / rise, 1.0)) if rise > 0.0 else math.inf
            horizon = root / ASIDE if low < root / CLOSE and math.isfinite(high) else root * ASIDE
            if math.isinf(high):
                horizon = min(horizon, 2.0 * low, farthest)
            elif count % 4 == 3 or not low < horizon < high:
                horizon = math.sqrt(low * high)
    return low


def first_guess(problem: Problem) -> float:
    """A time [s] of the right order: what the rigid body alone needs, or the fastest pole's time constant, whichever is longer."""
    strongest = max(abs(problem.lower), abs(problem.upper))
    guess = 0.0
    for target in problem.sets:
        at = 0
        for pole in target.basis.poles:
            m = pole.multiplicity
            if pole.is_rigid:
                asked = [0.0] * (m - 1) + [abs(target.target[at + m - 1])]
                begun = [0.0] * m if problem.begin is None else np.abs(problem.begin[at : at + m])
                for k in range(m):
                    guess = max(guess, (math.factorial(k + 1) * (asked[k] + begun[k]) / strongest) ** (1 / (k + 1)))
            else:
                guess = max(guess, 1.0 / abs(pole.value))
            at += m * (2 if pole.is_flexible else 1)
    return max([guess, *(1.0 / abs(pole) for pole in problem.poles if pole)])
