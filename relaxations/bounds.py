"""The minimum time of a maneuver, bracketed from both sides: `bracket` looks for it in floating point, `relaxations.proofs` proves it.

    problem ──► α(T) = 1 on the grid (a handful of LPs) ──► costate roots ──► Newton on the switch times ──► [lower, upper]

`lower` rests on a costate (weak duality), `upper` on a command. In floating point neither is a theorem: the status says so.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.commands import Command, Segment, Tail
from relaxations.duality import lower_bound
from relaxations.grids import grid
from relaxations.maneuvers import Problem
from relaxations.refinement import Failure, refine

Reals = NDArray[np.float64]


class Status(Enum):
    """What is known of a bracket; the value is the sentence for people."""

    PROVED = "both sides are proven"
    BRACKETED = "two sides, at least one of them not proven"
    IMPOSSIBLE = "no admissible command reaches the target in any time"


@dataclass(frozen=True, slots=True)
class Settings:
    """How hard to look.

    Grid intervals: for each real equation, at least, for each period of a mode while it is alive, at most. Programs to solve at most, and
    |α - 1| at which to stop.
    """

    cells_per_equation: int = 25
    least_cells: int = 200
    cells_per_period: int = 12
    most_cells: int = 20_000
    programs: int = 30
    tolerance: float = 1e-9


@dataclass(frozen=True, slots=True)
class Bound:
    """A bracket of the minimum time T* [s]: `lower` rests on `costate`, `upper` on `command`; `reason` says what is missing to a proof.

    `certificate` holds what was proven, in a form that `relaxations.checking` verifies.
    """

    status: Status
    lower: float
    upper: float | None
    costate: Reals
    command: Command | None
    switches: int | None
    reason: str | None
    programs: int
    seconds: float
    certificate: bytes | None = None

    @property
    def gap(self) -> float | None:
        """`upper/lower - 1`; 0 if both sides are 0, None if one side is missing or only the lower is 0."""
        if self.upper is None:
            return None
        if self.lower == 0.0:
            return 0.0 if self.upper == 0.0 else None
        return self.upper / self.lower - 1.0


@dataclass(frozen=True, slots=True)
class GridMinimum:
    """The root of α(T) = 1 on a grid: the last solution below and the first above that were found, and how many programs it took."""

    below: programs.GridSolution | None
    above: programs.GridSolution | None
    count: int


FARTHEST = 1e6  # times the plant's own time scale: a target that is out of reach until then is called so
LARGEST_EXPONENT = 600.0  # of e^{pT} for an unstable pole p: a double ends at e^709

NOT_PROVEN = "both sides were evaluated in floating point"


def bracket(problem: Problem, settings: Settings | None = None) -> Bound:
    """Bracket the least maneuver time of `problem`.

    Raises `SolverError` if a program could not be solved. A task whose target stays out of reach at every time that was tried comes back
    `BRACKETED` with `upper` None.
    """
    chosen = settings or Settings()
    begun = time.perf_counter()
    grid = grid_minimum(problem, chosen)

    def bound(upper: float | None, costate: Reals, command: Command | None, switches: int | None, reason: str) -> Bound:
        near = grid.below.program.maneuver_time if upper is None and grid.below else (upper or 0.0)
        lower = float(lower_bound(problem, costate, near))
        if upper is not None:
            lower = min(lower, upper)
        return Bound(Status.BRACKETED, lower, upper, costate, command, switches, reason, grid.count, time.perf_counter() - begun)

    if grid.above is None:
        assert grid.below is not None
        reach = grid.below.fraction
        reason = f"no command was found: at T = {grid.below.program.maneuver_time:.6g} s the grid reaches {reach:.3g} of the target"
        return bound(None, grid.below.costate, None, None, reason)
    tried: list[str] = []
    for start in (grid.above, grid.below):
        if start is None:
            continue
        found = refine(problem, start.costate, start.program.maneuver_time)
        if isinstance(found, Failure):
            tried.append(found.reason)
            continue
        return bound(found.maneuver_time, found.costate, found.command(problem), len(found.switches_to_go), NOT_PROVEN)
    command = staircase(problem, grid.above)
    reason = f"{NOT_PROVEN}; the command is the grid's staircase, since its switch times could not be refined ({'; '.join(tried)})"
    return bound(command.maneuver_time, grid.above.costate, command, None, reason)


def instants(problem: Problem, horizon: float, settings: Settings) -> Reals:
    """The grid [s] that these settings ask for."""
    least = max(settings.least_cells, settings.cells_per_equation * problem.size)
    return grid(problem, horizon, least, settings.cells_per_period, settings.most_cells)


def grid_minimum(problem: Problem, settings: Settings) -> GridMinimum:
    """The root of α(T) = 1 by Newton's method on log α against log T, safeguarded by the bracket found so far.

    With the costate scaled to `λᵀ target = 1`, `dα/dT = σ(p(T))`. On logarithms a rigid body (α ~ T^m) is solved in one step, and no unit
    of time or amplitude matters.
    """
    growth = max((pole.value.real for target in problem.sets for pole in target.basis.poles), default=0.0)
    horizon = first = _first_guess(problem) if growth <= 0.0 else min(_first_guess(problem), 1.0 / growth)
    farthest = FARTHEST * first if growth <= 0.0 else LARGEST_EXPONENT / growth
    below: programs.GridSolution | None = None
    above: programs.GridSolution | None = None
    count, distance, stretch = 0, math.inf, 1.0
    while count < settings.programs:
        count += 1
        solution = programs.solve(programs.build(problem, instants(problem, horizon, settings)))
        fraction = solution.fraction
        if solution.reaches:
            above = solution
        else:
            below = solution
        if solution.reaches and fraction <= 1.0 + settings.tolerance:
            break
        if above is None and horizon >= farthest:
            break
        if above and below and above.program.maneuver_time / below.program.maneuver_time - 1.0 <= settings.tolerance:
            break
        # The costate's slope is that of continuous time: where the grid cannot follow short arcs, Newton's steps are too short.
        off = -math.log(max(fraction, 1e-300))
        slow, distance = abs(off) > distance / 4, abs(off)
        stretch = 4.0 * stretch if slow else 1.0
        end = float(solution.costate @ problem.rows([horizon])[:, 0])
        slope = max(problem.upper * end, problem.lower * end)
        exponent = horizon * slope / fraction if fraction > 1e-9 else 0.0
        if slow and below and above and below.fraction > 0.0:
            ratio = _secant(below, above) / horizon
        elif exponent > 1e-3:
            # Aim a hair beyond the root, so that the last program lies on the feasible side.
            aim = (math.log1p(settings.tolerance / 2) + off) / exponent
            ratio = math.exp(min(max(aim * (stretch if above is None else 1.0), -1.0), 1.0))
        else:
            ratio = 2.0
        following = min(horizon * ratio, farthest)
        low = below.program.maneuver_time if below else 0.0
        high = above.program.maneuver_time if above else math.inf
        if not low < following < high:
            following = math.sqrt(low * high) if low > 0.0 and math.isfinite(high) else (min(2 * low, farthest) if math.isinf(high) else high / 4)
        horizon = following
    return GridMinimum(below, above, count)


def _secant(below: programs.GridSolution, above: programs.GridSolution) -> float:
    """Where α = 1 on the straight line through two solutions in log α against log T [s]."""
    start, stop = math.log(below.program.maneuver_time), math.log(above.program.maneuver_time)
    rise = math.log(above.fraction) - math.log(below.fraction)
    return math.exp(start - math.log(below.fraction) * (stop - start) / rise) if rise > 0.0 else math.exp((start + stop) / 2)


def _first_guess(problem: Problem) -> float:
    """A time [s] of the right order: what the rigid body alone needs, or the fastest pole's time constant, whichever is longer."""
    strongest = max(abs(problem.lower), abs(problem.upper))
    guess = 0.0
    for target in problem.sets:
        at = 0
        for pole in target.basis.poles:
            m = pole.multiplicity
            if pole.is_rigid:
                guess = max(guess, (math.factorial(m) * abs(target.target[at + m - 1]) / strongest) ** (1 / m))
            else:
                guess = max(guess, 1.0 / abs(pole.value))
            at += m * (2 if pole.is_flexible else 1)
    return guess


def staircase(problem: Problem, solution: programs.GridSolution) -> Command:
    """The grid's own command, divided by α ≥ 1 so that it reaches the target itself; equal neighbours are one segment."""
    levels = solution.levels / solution.fraction
    horizon, starts = solution.program.maneuver_time, solution.program.instants[:-1]
    keep = np.concatenate([[True], np.diff(levels) != 0.0])
    segments = tuple(Segment(float(s), float(u) + problem.rest) for s, u in zip(starts[keep], levels[keep], strict=True))
    return Command(horizon, segments, Tail(problem.rest + problem.hold))
