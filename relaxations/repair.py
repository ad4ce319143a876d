"""Linear repair: from a grid's staircase to one that provably lands, for every kind of problem (docs/theory.md, section 4).

A little beyond the minimum time the program reaches more than the whole target. Its levels divided by α are strictly inside the limits,
but for those that rest on a limit which is the rest input itself; as many of the others as there are equations become unknowns.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from relaxations.maneuvers import Problem
from relaxations.plants import fraction
from relaxations.programs import GridSolution

Reals = NDArray[np.float64]

SNAP = 1e-7  # of the range: levels of the solver so close to a limit are meant to be on it
ON_CHOICE = 1e-4  # of the range: how far the solver's levels may be off where the command is to be all on limits
CLEAR, PARTS = 1e-5, 6  # of the range: levels so close together are one; into how many parts a cell is cut where they are not
BEND = 0.02  # of the range of slopes: what is no change of slope but a bend along a limit of an output
ON_LIMIT = 1e-9  # of the range: a level so close to a limit of 0 stays there exactly


@dataclass(frozen=True, slots=True)
class Repaired:
    """A staircase: duration T [s], starts (n,) [s], absolute levels (n,) and tail coefficients, and which of these are unknowns."""

    maneuver_time: float
    starts: Reals
    levels: tuple[Fraction, ...]
    tail: Reals
    free_levels: tuple[int, ...]
    free_tail: tuple[int, ...]
    radius: float


def zoomed(solution: GridSolution) -> Reals:
    """The grid with every cell cut into `PARTS` at which the command changes, or in which it is neither on a limit nor at rest; where the
    command is continuous, with those beside a change of its slope."""
    problem, levels, grid = solution.problem, solution.levels, solution.program.instants
    if problem.rate is not None and problem.sloped:
        slopes = np.diff(levels, prepend=0.0) / np.diff(grid)
        bends = np.concatenate([[False], np.abs(np.diff(slopes)) > BEND * (problem.rate[1] - problem.rate[0]), [False]])
        return _cut(grid, np.flatnonzero(bends[:-1] | bends[1:]))
    slack = CLEAR * (problem.upper - problem.lower)
    still = np.minimum.reduce([np.abs(levels - level) for level in (problem.lower, problem.upper, 0.0)]) <= slack
    jumps = np.concatenate([[False], np.abs(np.diff(levels)) > slack, [False]])
    return _cut(grid, np.flatnonzero(~still | jumps[:-1] | jumps[1:]))


def _cut(grid: Reals, cells: NDArray[np.intp]) -> Reals:
    return np.unique(np.concatenate([grid, *(np.linspace(grid[i], grid[i + 1], PARTS + 1) for i in cells)]))


def pivots(matrix: Reals) -> NDArray[np.intp]:
    """The columns in the order in which pivoted QR takes them: the first ones are the most independent."""
    return np.asarray(cast("tuple[Any, Any]", qr(matrix, pivoting=True, mode="r"))[1])


def exact(solution: GridSolution) -> Repaired | None:
    """The staircase with all levels on limits or at 0, if its equations are those at the origin and hold in fractions; else None.

    A minimum time that is a whole number of samples leaves repair no room: every level is on a limit.
    """
    problem = solution.problem
    maneuver, (plant, *others) = problem.maneuver, problem.plants
    if others or problem.begin is not None or problem.size != plant.rigid_order or problem.tail.size:
        return None
    choices = [maneuver.limits.lower - maneuver.rest, maneuver.limits.upper - maneuver.rest, Fraction(0)]
    floats = np.array([float(choice) for choice in choices])
    nearest = np.argmin(np.abs(solution.levels[:, None] - floats), axis=1)
    if np.abs(solution.levels - floats[nearest]).max() > ON_CHOICE * (problem.upper - problem.lower):
        return None
    keep = np.flatnonzero(np.concatenate([[True], np.diff(nearest) != 0]))
    end, starts = problem.on_grid(solution.maneuver_time), [problem.on_grid(float(start)) for start in solution.program.instants[keep]]
    levels = [choices[nearest[i]] for i in keep]
    jumps = [after - before for before, after in itertools.pairwise([Fraction(0), *levels])]
    highest = maneuver.displacement * fraction(plant.denominator[plant.rigid_order] / plant.numerators[plant.output][0])
    for k in range(1, problem.size + 1):
        moment = sum((jump * (end - start) ** k for jump, start in zip(jumps, starts, strict=True)), Fraction(0)) / math.factorial(k)
        if moment != (highest if k == problem.size else 0):
            return None
    absolute = tuple(maneuver.rest + level for level in levels)
    return Repaired(solution.maneuver_time, np.array([float(start) for start in starts]), absolute, np.zeros(0), (), (), 1.0)


def repair(solution: GridSolution, snap: float = SNAP) -> Repaired | None:
    """The staircase of `solution` (α > 1) with its unknowns solved for in floating point, or None if it has too little room."""
    problem = solution.problem
    lower, upper = problem.lower, problem.upper
    reach = upper - lower
    levels = np.clip(solution.levels, lower, upper)
    levels = np.where(levels > upper - snap * reach, upper, np.where(levels < lower + snap * reach, lower, levels)) / solution.fraction
    if problem.sloped:
        return _ramped(solution, levels)
    if problem.fuel is not None:  # where the fuel is not worth its price the input rests
        levels = np.where(np.abs(levels) < snap * reach, 0.0, levels)
    for limit in (lower, upper):
        if limit == 0.0:
            levels = np.where(np.abs(levels) < ON_LIMIT * reach, 0.0, levels)
    starts = solution.program.instants[:-1]
    keep = np.concatenate([[True], np.diff(levels) != 0.0])
    starts, levels = starts[keep], levels[keep]
    room = np.minimum(upper - levels, levels - lower)
    room[(levels == lower) | (levels == upper)] = 0.0
    room = np.minimum(room, _spare(problem, levels))
    instants = np.append(starts, solution.maneuver_time)
    integrated = problem.rows(solution.maneuver_time - instants, 1)
    table = integrated[:, :-1] - integrated[:, 1:]
    size, tail = problem.size, solution.tail_coefficients[: problem.tail.size].copy()
    # Rows scaled to one, columns weighted by the room they leave: pivoting then prefers unknowns that matter and may move. A tail
    # coefficient may move as far as the tail's own room, and its cap, let it.
    looks = problem.tail.looks().instants
    course, (above, below) = problem.tail.rows(looks), problem.tail.room(looks)
    slack = np.minimum(above - course @ tail, below + course @ tail) if len(tail) else np.zeros(1)
    play = np.maximum(slack.min(), 0.0) / np.abs(course).max(axis=0) / max(len(tail), 1) if len(tail) else np.zeros(0)
    for one in problem.tail.aspects:
        further = course @ one.turned
        room_left = np.minimum(one.above - further @ tail, one.below + further @ tail).min()
        play = np.minimum(play, max(room_left, 0.0) / np.abs(further).max(axis=0) / max(len(tail), 1))
    for cap, modulus in zip(problem.tail.caps, problem.tail.sizes(tail), strict=True):
        play[list(cap.at)] = np.minimum(play[list(cap.at)], max(cap.bound - modulus, 0.0) / 2)
    columns, weights = np.hstack([table, -problem.tail.columns]), np.concatenate([room, play])
    if not size and not len(tail):  # nothing has to be reached exactly: the levels are what they are
        return Repaired(solution.maneuver_time, starts, _absolute(problem, levels), tail, (), (), SNAP * reach)
    if np.count_nonzero(weights) < size:
        return None
    scaled = np.linalg.qr((columns * weights).T)[0].T
    free = np.sort(pivots(scaled)[:size])
    values = np.concatenate([levels, tail])
    rows = np.abs(columns * np.where(values == 0.0, 1.0, np.abs(values))).sum(axis=1)
    for _ in range(3):  # iterative refinement: the residual's rounding is all that is left
        residual = problem.aimed(solution.maneuver_time) - columns @ values
        values[free] += np.linalg.lstsq(columns[:, free] / rows[:, None], residual / rows, rcond=None)[0]
    levels, tail = values[: len(levels)], values[len(levels) :]
    chosen = free[free < len(levels)]
    left = np.minimum(np.minimum(upper - levels[chosen], levels[chosen] - lower), _spare(problem, levels)[chosen])
    if len(chosen) and not left.min() > 0.0:
        return None
    return Repaired(
        solution.maneuver_time,
        starts,
        _absolute(problem, levels),
        tail,
        tuple(int(i) for i in chosen),
        tuple(int(i) - len(levels) for i in free if i >= len(levels)),
        float(min(left.min(initial=np.inf), play.min(initial=np.inf) if len(free) > len(chosen) else np.inf)) / 4,
    )


def _spare(problem: Problem, levels: Reals) -> Reals:
    """How far each level may move until a step from sample to sample is beyond its limit."""
    step = problem.maneuver.sample_time
    if problem.rate is None or step is None:
        return np.full(len(levels), np.inf)
    steps = np.diff(np.concatenate([[0.0], levels, [problem.hold]]))
    spare = np.minimum(problem.rate[1] * float(step) - steps, steps - problem.rate[0] * float(step))
    return np.maximum(np.minimum(spare[:-1], spare[1:]), 0.0)


def _absolute(problem: Problem, levels: Reals) -> tuple[Fraction, ...]:
    return tuple(problem.maneuver.rest + Fraction(float(level)) for level in levels)


def _ramped(solution: GridSolution, levels: Reals) -> Repaired | None:
    """The same of node values: a node has as much room as its own limits and the slopes on either side leave it."""
    problem = solution.problem
    assert problem.rate is not None
    tail = solution.tail_coefficients[: problem.tail.size].copy()  # it stays as it is: nodes have room enough
    end = problem.hold + float((problem.tail.rows(np.zeros(1)) @ tail)[0])
    instants, values = solution.program.instants, np.append(levels[:-1], end)
    nodes = np.concatenate([[0.0], values])
    keep = np.ones(len(nodes), dtype=bool)
    keep[1:-1] = (nodes[1:-1] != nodes[:-2]) | (nodes[1:-1] != nodes[2:])  # in the middle of what is level
    between = np.array([np.interp(instants[1:], instants[keep], unit) for unit in np.eye(int(keep.sum()))])[1:]
    table, size = problem.table(instants) @ between.T, problem.size
    instants, values = instants[keep], values[keep[1:]]
    free, room = np.zeros(0, dtype=np.intp), np.zeros(len(values))
    for turn in range(4):
        slopes = np.diff(np.concatenate([[0.0], values])) / np.diff(instants)
        spare = np.minimum(problem.rate[1] - slopes, slopes - problem.rate[0]) * np.diff(instants)
        room = np.minimum(problem.upper - values, values - problem.lower)
        room[:-1] = np.minimum(room[:-1], np.minimum(spare[:-1], spare[1:]))
        room[-1] = 0.0
        if turn == 0:
            weights = np.maximum(room, 0.0)
            if not size:  # nothing has to be reached exactly
                break
            if np.count_nonzero(weights) < size:
                return None
            free = np.sort(pivots(np.linalg.qr((table * weights).T)[0].T)[:size])
        if turn == 3:
            break
        residual = problem.aimed(solution.maneuver_time) + problem.tail.columns @ tail - table @ values
        rows = np.abs(table * np.where(values == 0.0, 1.0, np.abs(values))).sum(axis=1)
        values = values.copy()
        values[free] += np.linalg.lstsq(table[:, free] / rows[:, None], residual / rows, rcond=None)[0]
    left = float(room[free].min()) if size else SNAP * (problem.upper - problem.lower)
    if not left > 0.0:
        return None
    starts = np.concatenate([[0.0], values[:-1]])
    absolute = tuple(problem.maneuver.rest + Fraction(float(level)) for level in starts)
    return Repaired(solution.maneuver_time, instants[:-1], absolute, tail, tuple(int(i) + 1 for i in free), (), float(left) / 4)
