"""The fastest command that an actuator with a sample time can give: constant on each [kh, (k+1)h), after a whole number of samples.

The linear program of `relaxations.programs`, on the grid of the samples themselves: who reaches the target in N samples reaches it in N + 1
too (at rest one can wait), so the least N is found by bisection. It rests on floating-point solutions: it is a candidate, not a theorem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from relaxations import programs
from relaxations.bounds import staircase
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ShortHorizonError, SolverError
from relaxations.maneuvers import Problem
from relaxations.repair import SNAP, repair

MOST_SAMPLES = 20_000  # a program of that size takes seconds
MISSED = 1e-9  # of the target: what a command may fall short by where the minimum time is itself a whole number of samples


@dataclass(frozen=True, slots=True)
class Sampled:
    """`command` of `samples` samples of `step` [s] each; `programs` linear programs were solved to find it."""

    command: Command
    step: float
    samples: int
    programs: int


def sampled_minimum(problem: Problem, step: float, least: float = 0.0) -> Sampled:
    """The command of the least number of samples that reaches the target; `least` [s] is a time in which no command does.

    Raises `SolverError` if that would take more than `MOST_SAMPLES`, or a program cannot be solved.
    """
    if problem.tail.columns.shape[1]:
        raise SolverError("an output rest needs an input that decays, not one that is constant over each sample")
    known: dict[int, programs.GridSolution | None] = {}

    def reaches(count: int) -> bool:
        try:
            known[count] = programs.solve(programs.build(problem, np.arange(count + 1, dtype=np.float64) * step))
        except ShortHorizonError:
            known[count] = None
        solution = known[count]
        return solution is not None and solution.fraction >= 1.0 - MISSED and solution.residual <= programs.RESIDUAL

    below = max(math.ceil(least / step * (1.0 - 1e-12)) - 1, 0)  # a whole number of samples may be the minimum itself
    above, stride = below + 1, 1
    while not reaches(above):
        below, stride = above, 2 * stride
        above = below + stride
        if above > MOST_SAMPLES:
            raise SolverError(f"a command of at most {MOST_SAMPLES} samples of {step!r} s each does not reach the target")
    while above - below > 1:
        middle = (below + above) // 2
        below, above = (below, middle) if reaches(middle) else (middle, above)
    solution = known[above]
    assert solution is not None
    return Sampled(_landed(problem, solution), step, above, len(known))


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
