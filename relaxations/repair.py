"""Linear repair: from a grid's staircase to one that provably lands, for every kind of problem (docs/theory.md, section 4).

A little beyond the minimum time the program reaches more than the whole target. Its levels divided by α are strictly inside the limits,
but for those that rest on a limit which is the rest input itself; as many of the others as there are equations become unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from relaxations.maneuvers import Problem
from relaxations.programs import GridSolution

Reals = NDArray[np.float64]

SNAP = 1e-7  # of the range: levels of the solver so close to a limit are meant to be on it
ON_LIMIT = 1e-9  # of the range: a level so close to a limit of 0 stays there exactly


@dataclass(frozen=True, slots=True)
class Repaired:
    """A staircase: duration T [s], starts (n,) [s], absolute levels (n,), and the indices of the levels that are unknowns of the equations."""

    maneuver_time: float
    starts: Reals
    levels: tuple[Fraction, ...]
    free: tuple[int, ...]
    radius: float


def repair(problem: Problem, solution: GridSolution, snap: float = SNAP) -> Repaired | None:
    """The staircase of `solution` (α > 1) with its unknowns solved for in floating point, or None if it has too little room."""
    lower, upper = problem.lower, problem.upper
    reach = upper - lower
    levels = np.clip(solution.levels, lower, upper)
    levels = np.where(levels > upper - snap * reach, upper, np.where(levels < lower + snap * reach, lower, levels)) / solution.fraction
    for limit in (lower, upper):
        if limit == 0.0:
            levels = np.where(np.abs(levels) < ON_LIMIT * reach, 0.0, levels)
    starts = solution.program.instants[:-1]
    keep = np.concatenate([[True], np.diff(levels) != 0.0])
    starts, levels = starts[keep], levels[keep]
    room = np.minimum(upper - levels, levels - lower)
    room[(levels == lower) | (levels == upper)] = 0.0
    instants = np.append(starts, solution.program.maneuver_time)
    integrated = problem.rows(solution.program.maneuver_time - instants, 1)
    table = integrated[:, :-1] - integrated[:, 1:]
    size = problem.size
    if np.count_nonzero(room) < size:
        return None
    # Rows scaled to one, columns weighted by the room they leave: pivoting then prefers unknowns that matter and may move.
    scaled = np.linalg.qr((table * room).T)[0].T
    free = np.sort(qr(scaled, pivoting=True, mode="r")[1][:size])
    rows = np.abs(table).sum(axis=1)
    for _ in range(3):  # iterative refinement: the residual's rounding is all that is left
        residual = problem.target - table @ levels
        levels[free] += np.linalg.lstsq(table[:, free] / rows[:, None], residual / rows, rcond=None)[0]
    left = float(np.min(np.minimum(upper - levels[free], levels[free] - lower)))
    if not left > 0.0:
        return None
    rest = problem.maneuver.rest
    return Repaired(
        solution.program.maneuver_time,
        starts,
        tuple(rest + Fraction(float(level)) for level in levels),
        tuple(int(i) for i in free),
        left / 4,
    )
