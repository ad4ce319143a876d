"""The fastest command of a controller with a sample time: constant on each [kh, (k+1)h), after a whole number of samples.

The linear program of `relaxations.programs`, on the grid of the samples themselves: who reaches the target in N samples reaches it in N + 1
too (at rest one can wait), so the least N is found by bisection, from the bound of all commands upwards. The costate of the program with
one sample less refutes all that are shorter (../docs/theory.md, section 3), and repair proves the command; both in `relaxations.proofs`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.bounds import NOT_PROVEN, Bound, Settings, Status, bracket, cut, extended, staircase
from relaxations.commands import Command, Segment, Tail
from relaxations.duality import Costate, lower_bound
from relaxations.errors import ShortHorizonError, SolverError
from relaxations.maneuvers import Problem
from relaxations.repair import SNAP, repair

Reals = NDArray[np.float64]

MOST_SAMPLES = (
    10_000  # of a program, which then takes a second; a shorter sample time is bracketed by commands on every second sample, or …
)
MISSED = 1e-9  # of the target: what a command may fall short by where the minimum time is itself a whole number of samples


def sampled_bracket(problem: Problem, settings: Settings | None = None, near: float | None = None) -> Bound:
    """Bracket the least number of samples that reaches the target, in seconds; `near` [s] is a guess at it.

    Where no program of up to `MOST_SAMPLES` reaches the target the bound has no upper side. Raises `SolverError` as `bracket` does.
    """
    begun = time.perf_counter()
    maneuver = problem.maneuver
    assert maneuver.sample_time is not None
    step = float(maneuver.sample_time)
    free = bracket(replace(problem, maneuver=replace(maneuver, sample_time=None), courses=(), rate=None), settings, near)
    if free.upper == 0.0:
        return free
    least = max(math.ceil(free.lower / step * (1.0 - 1e-12)), 1)  # a whole number of samples may be the minimum itself
    stride = math.ceil(2 * least / MOST_SAMPLES)
    known: dict[int, programs.GridSolution | None] = {}

    def reaches(count: int) -> bool:
        try:
            known[count] = cut(problem, problem.samples(count, stride), 0.0)
        except ShortHorizonError:
            known[count] = None
        solution = known[count]
        return solution is not None and solution.fraction >= 1.0 - MISSED and solution.residual <= programs.RESIDUAL

    count = None if free.upper is None else _least(reaches, math.ceil(least / stride))
    solution = known.get(count or max(known, default=0))
    duals = [_refuting(problem, known, stride, max(known, default=2) if count is None else count), free.dual]
    lower, dual = max(((_refuted(problem, dual, step), dual) for dual in duals if dual is not None), key=lambda pair: pair[0])
    command = _landed(problem, solution) if solution and count else None
    upper = None if command is None else command.maneuver_time
    reason = NOT_PROVEN
    if command is None:
        reached = "" if solution is None else f", where the target's fraction {solution.fraction:.3g} is in reach"
        reason = f"no command was found of up to {max(known, default=0) * stride} samples{reached}"
    return Bound(
        Status.BRACKETED,
        lower if upper is None else min(lower, upper),
        upper,
        np.array(dual.problem.modal(dual.costate), dtype=float),
        command,
        None,
        reason,
        free.programs + len(known),
        time.perf_counter() - begun,
        dual=dual,
        above=solution if command else None,
    )


def _least(reaches: Callable[[int], bool], first: int) -> int | None:
    """The least count from `first` on that reaches, by doubling strides and bisection; None if none of up to `MOST_SAMPLES` does."""
    below, above, stride = first - 1, first, 1
    while not reaches(above):
        below, stride = above, 2 * stride
        above = min(below + stride, MOST_SAMPLES)
        if above == below:
            return None
    while above - below > 1:
        middle = (below + above) // 2
        below, above = (below, middle) if reaches(middle) else (middle, above)
    return above


def _refuting(
    problem: Problem, known: dict[int, programs.GridSolution | None], stride: int, count: int
) -> programs.GridSolution | Costate | None:
    """The multipliers of the program with one sample less than `count`: no shorter command reaches the target."""
    if count <= 1:
        return None
    instants = problem.samples(count - 1, stride)
    if count - 1 not in known:
        try:
            known[count - 1] = cut(problem, instants, 0.0)
        except SolverError:
            known[count - 1] = None
    solution = known[count - 1]
    if solution is not None or problem.residuals is not None:
        return solution
    # Fewer samples than equations, or dependent ones: the costate to whose cells the input matters least.
    integrated = problem.rows(instants[-1] - instants, 1)
    table = integrated[:, :-1] - integrated[:, 1:]
    aim = problem.aimed(float(instants[-1]))
    sizes = np.abs(table).max(axis=1) + np.abs(aim)
    left, singular, _ = np.linalg.svd(table / sizes[:, None])
    singular = np.concatenate([singular, np.zeros(len(left) - len(singular))])
    target = left.T @ (aim / sizes)
    weights = target / np.maximum(singular, np.finfo(float).eps * singular[0]) ** 2
    costate = left @ weights / sizes
    return Costate(problem, costate / float(costate @ aim), float(instants[-1]))


def _refuted(problem: Problem, dual: programs.GridSolution | Costate, step: float) -> float:
    """The least number of samples that a dual leaves, in seconds."""
    posed = replace(dual.problem, maneuver=problem.maneuver)
    near = dual.maneuver_time + 2 * step
    return lower_bound(*extended(posed, dual.costate, dual.tail_multipliers), near, dual.price(posed), dual.prices)


def _landed(problem: Problem, solution: programs.GridSolution) -> Command:
    """The program's levels, corrected where they have room so that they land to rounding and not only to the solver's tolerance."""
    repaired = repair(solution) if solution.fraction > 1.0 else None
    if repaired is None:
        lower, upper = problem.lower, problem.upper
        near = SNAP * (upper - lower)
        levels = np.where(solution.levels > upper - near, upper, np.where(solution.levels < lower + near, lower, solution.levels))
        return staircase(problem, replace(solution, levels=levels, fraction=max(solution.fraction, 1.0)))
    segments = (Segment(float(start), float(level)) for start, level in zip(repaired.starts, repaired.levels, strict=True))
    return Command(repaired.maneuver_time, tuple(segments), Tail(problem.absolute(problem.hold)))
