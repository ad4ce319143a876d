"""Where to look first for the minimum time: what a rigid body needs, what a pole takes, and what the command's energy alone allows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

CLOSE, ENERGIES = 1.05, 60  # ratio of the two times that the energy's estimate ends with, and how many it may look at
ASIDE = 1.02  # how far to one side of the root it looks
NEGLIGIBLE = 1e-10  # of a row: combinations of rows that are as small as that are not looked at
LONGER = 1.1  # than what the energy alone needs: where the first program is solved


def energy_bound(problem: Problem, instants: Reals) -> float:
    """What α cannot exceed on the grid of `instants` [s], for the command's energy alone: no program is solved.

    For every y with `yᵀ target = 1` that is orthogonal to the tail's columns, `α = yᵀ A u ≤ |Aᵀ y| |u|`; the best y is a least-squares
    problem. That holds for the rounded one too, so that dependent rows do no harm.
    """
    widths = np.sqrt(np.diff(instants))
    integrated = problem.rows(instants[-1] - instants, 1)
    change = np.linalg.qr(((integrated[:, :-1] - integrated[:, 1:]) / widths).T, mode="r")
    lengths = np.linalg.norm(change, axis=0)
    left, sizes, _ = np.linalg.svd((change / lengths).T)
    sizes = np.append(sizes, np.zeros(len(left) - len(sizes)))
    damped = np.hypot(sizes, NEGLIGIBLE)
    wanted, free = (
        left.T @ (column.T / lengths).T / damped[:, None] for column in (problem.aimed(float(instants[-1]))[:, None], problem.tail.columns)
    )
    best = (wanted - free @ np.linalg.lstsq(free, wanted, rcond=None)[0])[:, 0]
    energy = max(abs(problem.lower), abs(problem.upper)) * np.sqrt(instants[-1])
    least = float(np.linalg.norm(best))
    reached = least <= NEGLIGIBLE * float(np.linalg.norm(wanted))  # by the tail, which may be as large as it likes here
    return np.inf if reached else float(energy * np.linalg.norm(sizes / damped * best)) / least / least


def energy_time(problem: Problem, grid: Callable[[float], NDArray[np.float64]], guess: float, farthest: float) -> float:
    """A time [s] that is too short for the command's energy alone, close to the longest such; 0 if there is none. No program is solved."""
    low, high, horizon = 0.0, math.inf, guess
    seen: dict[float, float] = {}  # log α there
    for count in range(ENERGIES):
        most = energy_bound(problem, grid(horizon))
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
    """A time [s] of the right order: what the rigid body alone needs, or the fastest pole's time constant, whichever is longer.

    Of a plant that varies as long as it does so.
    """
    if problem.transition is not None:
        plant = problem.transition.plant
        return max(float(plant.instants[-1]), 1.0 / plant.pace if plant.pace else 0.0) or 1.0
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
