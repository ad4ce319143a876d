"""From the grid to exact switch times: Newton's method in closed form.

The extremal command is bang-bang, its switches are the roots of the costate. Unknown are the switch times to go s_1 < … < s_m, the
maneuver time T and the costate λ; the equations are the moments (1), `p(s_i) = λᵀ b(s_i) = 0` and `λᵀ target = 1`. With as many unknown
instants as moments the costate decouples, with more the roots determine it, with fewer (degenerate optima) the equations are consistent
and solved in the least-squares sense.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command, Segment, Tail
from relaxations.duality import costate_roots
from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

ITERATIONS = 40
ROUNDING = 1e-11  # relative residual of the moments below which Newton may stop, as soon as it gains nothing more


@dataclass(frozen=True, slots=True)
class Extremal:
    """A bang-bang command that meets the moments: duration T [s], times to go of the switches (ascending), first level and costate."""

    maneuver_time: float
    switches_to_go: Reals
    last_level: float
    costate: Reals
    residual: float  # relative residual of the moment equations
    iterations: int

    def levels(self, problem: Problem) -> Reals:
        """Deviation of the input on each arc, in order of time to go."""
        return _levels(problem, self.last_level, len(self.switches_to_go))

    def command(self, problem: Problem) -> Command:
        """The command in absolute input, its switches in order of time."""
        starts = [0.0, *(self.maneuver_time - self.switches_to_go[::-1])]
        arcs = self.levels(problem)[::-1]
        segments = tuple(Segment(float(s), float(level) + problem.rest) for s, level in zip(starts, arcs, strict=True))
        return Command(self.maneuver_time, segments, Tail(problem.rest + problem.hold))


@dataclass(frozen=True, slots=True)
class Failure:
    """Why no extremal command came of a start."""

    reason: str


def _levels(problem: Problem, last: float, switches: int) -> Reals:
    other = problem.lower if last == problem.upper else problem.upper
    return np.array([last if k % 2 == 0 else other for k in range(switches + 1)])


def moment_residual(problem: Problem, levels: Reals, to_go: Reals) -> tuple[Reals, float]:
    """`∫ b u - target` for arcs of constant `levels` between the instants `to_go` (0 … T), and the size of the terms that cancel in it."""
    table = problem.rows(to_go, 1)
    pieces = np.diff(table, axis=1) * levels
    return pieces.sum(axis=1) - problem.target, np.maximum(np.abs(pieces).sum(axis=1), np.abs(problem.target))


def refine(problem: Problem, costate: Reals, maneuver_time: float) -> Extremal | Failure:
    """Newton's method from a costate and a maneuver time [s] of the grid.

    Returns the extremal command, or the reason why there is none: arcs that vanish or change order, no convergence, or a costate whose
    signs are not the command's (the pattern is then wrong).
    """
    switches = costate_roots(problem, costate, maneuver_time)
    final = float(costate @ problem.rows([switches[0] / 2 if len(switches) else maneuver_time / 2])[:, 0])
    last = problem.upper if final > 0 else problem.lower
    levels = _levels(problem, last, len(switches))
    s, time, multiplier = switches, maneuver_time, costate / (costate @ problem.target)
    count, size = len(s), problem.size
    best = np.inf
    for iteration in range(ITERATIONS):
        edges = np.concatenate([[0.0], s, [time]])
        residual, terms = moment_residual(problem, levels, edges)
        scale = np.where(terms > 0, terms, 1.0)
        relative = float(np.abs(residual / scale).max())
        at_roots = problem.rows(s) if count else np.zeros((size, 0))
        end = problem.rows([time])[:, 0]
        slopes = problem.derivative(multiplier) @ at_roots if count else np.zeros(0)
        # Row blocks: moments, p(s_i) = 0, λᵀ target = 1. Column blocks: s, T, λ. Every row is divided by the size of its terms.
        width = count + 1 + size
        matrix = np.zeros((size + count + 1, width))
        matrix[:size, :count] = at_roots * (levels[:-1] - levels[1:]) / scale[:, None]
        matrix[:size, count] = levels[-1] * end / scale
        root_scale = np.maximum(np.abs(multiplier) @ np.abs(at_roots), np.finfo(float).tiny) if count else np.zeros(0)
        matrix[size : size + count, :count] = np.diag(slopes / root_scale) if count else 0.0
        matrix[size : size + count, count + 1 :] = (at_roots / root_scale).T if count else 0.0
        target_scale = float(np.abs(multiplier) @ np.abs(problem.target))
        matrix[-1, count + 1 :] = problem.target / target_scale
        values = np.concatenate([residual / scale, (multiplier @ at_roots) / root_scale, [(multiplier @ problem.target - 1.0) / target_scale]])
        # A component of the costate is as large as its share in p: rows that grow or decay fast would hide the others from least squares.
        reach = np.abs(problem.rows(edges)).max(axis=1)
        reach[reach == 0.0] = 1.0
        share = np.abs(multiplier) * reach
        unit = np.concatenate([np.full(count + 1, time), np.maximum(share, share.max() * 1e-8) / reach])
        step = -unit * np.linalg.lstsq(matrix * unit, values, rcond=None)[0]
        moved = float(np.abs(step[: count + 1]).max() / time)
        if relative <= ROUNDING and (moved <= 1e-14 or relative >= best / 2):
            break
        best = min(best, relative)
        # A step that would reorder the arcs is shortened: the start is only as good as the grid.
        fraction = 1.0
        while fraction > 1e-3 and not _ordered(s + fraction * step[:count], time + fraction * step[count]):
            fraction /= 2
        s, time, multiplier = s + fraction * step[:count], time + fraction * step[count], multiplier + fraction * step[count + 1 :]
        if not _ordered(s, time):
            return Failure(f"{count} switches: an arc vanishes in Newton's method after {iteration + 1} steps")
    else:
        return Failure(f"{count} switches: Newton's method did not converge in {ITERATIONS} steps (relative residual {relative:.1e})")
    found = costate_roots(problem, multiplier, time)
    if len(found) != count or (count and np.abs(found - s).max() > 1e-6 * time):
        return Failure(f"{count} switches: the refined costate has {len(found)} sign changes elsewhere, so the pattern is not extremal")
    return Extremal(float(time), s, float(last), multiplier, relative, iteration)


def _ordered(s: Reals, time: float) -> bool:
    return bool(np.all(np.diff(np.concatenate([[0.0], s, [time]])) > 0))
