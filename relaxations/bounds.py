"""The minimum time of a maneuver, bracketed from both sides: `bracket` looks for it in floating point, `relaxations.proofs` proves it.

    problem ──► α(T) = 1 on the grid (a handful of LPs) ──► costate roots ──► Newton on the switch times ──► [lower, upper]

`lower` rests on a costate (weak duality), `upper` on a command. In floating point neither is a theorem: the status says so.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from relaxations import posing, programs
from relaxations.commands import Command, Segment, Tail
from relaxations.courses import exceeded_places
from relaxations.duality import Costate, lower_bound
from relaxations.energy import LONGER, energy_time, first_guess
from relaxations.errors import ShortHorizonError, SolverError
from relaxations.grids import grid
from relaxations.maneuvers import Problem, TargetSet
from relaxations.refinement import Extremal, Failure, refine
from relaxations.rising import rise
from relaxations.robust.residuals import MISSED
from relaxations.tails import Contact, Looks, TailStart

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

    def finer(self, factor: int) -> Settings:
        """The same on a grid of `factor` times as many intervals."""
        return replace(
            self,
            cells_per_equation=factor * self.cells_per_equation,
            least_cells=factor * self.least_cells,
            cells_per_period=factor * self.cells_per_period,
        )


@dataclass(frozen=True, slots=True)
class Bound:
    """A bracket of the minimum time T* [s]: `lower` rests on `costate`, `upper` on `command`; `reason` says what is missing to a proof.

    `tail` holds the coefficients of the command's tail, `dual` what costate and command came from (`above` the command, where it is
    that of another program: on the grid of a sample time). `certificate` holds what was proven, in a form that `relaxations.checking`
    verifies.
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
    tail: Reals = field(default_factory=lambda: np.zeros(0))
    dual: programs.GridSolution | Extremal | Costate | None = None
    above: programs.GridSolution | None = None
    certificate: bytes | None = None
    free: tuple[float, float | None] | None = None  # of a form that is held: the bracket of all commands

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
    settled: bool = False  # the search ended early: what came of the last solution is all that was wanted


TOUCHING = 1e-6  # price times the size of the tail's terms, of a target's 1: smaller ones are what an interior-point method leaves anywhere
CAPPED = 1e-6  # of the terms of the costate's equation at a coefficient: if more is left of them, its cap holds it
COURSE = 1e-6  # of a limit of an output in a box: what is beyond it by less is left to the hair that the proof keeps inside
CUTS = 6  # rounds of cutting planes for the tail's limits
FLAT = 1e-3  # d log α/d log T below which α says nothing about the time
NEAR, EARLY = 0.05, 2  # of log α: Newton's method on the switches is tried from there on, so often
STALLS = 3  # times that the solver may give no answer, in one search
FARTHEST = 1e6  # times the plant's own time scale: a target that is out of reach until then is called so
LARGEST_EXPONENT = 600.0  # of e^{pT} for an unstable pole p: a double ends at e^709
NOISE = 1e-7  # of log α: what the solver leaves open
VISIBLE = 1e-6  # smaller fractions are known to few digits: the time is then doubled

STATELESS = "the plant has no states: it is at rest as soon as its input is"
NOT_PROVEN = "both sides were evaluated in floating point"


def bracket(problem: Problem, settings: Settings | None = None, near: float | None = None) -> Bound:
    """Bracket the least maneuver time of `problem`; `near` is a guess at it [s].

    Raises `SolverError` if a program could not be solved. A task whose target stays out of reach at every time that was tried comes back
    `BRACKETED` with `upper` None.
    """
    chosen = settings or Settings()
    begun = time.perf_counter()
    if not problem.poles:  # a plant without states follows its input
        command = Command(0.0, (), Tail(problem.absolute(problem.hold)))
        return Bound(Status.BRACKETED, 0.0, 0.0, np.zeros(0), command, 0, STATELESS, 0, time.perf_counter() - begun)
    if (instant := _tail_only(problem)) is not None:
        command = Command(0.0, (), Tail(problem.absolute(problem.hold), problem.tail.terms(instant)))
        return Bound(Status.BRACKETED, 0.0, 0.0, np.zeros(problem.size), command, 0, NOT_PROVEN, 0, time.perf_counter() - begun, instant)
    early: list[Extremal | Failure] = []

    def settled(solution: programs.GridSolution) -> bool:
        """Whether an extremal near a solution follows from it already."""
        off = abs(math.log(max(solution.fraction, 1e-300)))
        if len(early) == EARLY or off > NEAR or exponent_of(solution) <= FLAT:
            return False
        early.append(found := _refined(solution))
        return isinstance(found, Extremal) and abs(math.log(found.maneuver_time / solution.maneuver_time)) <= 2 * NEAR

    grid = _cut_minimum(problem, chosen, near, settled)

    def bound(dual: programs.GridSolution | Extremal, command: Command | None, switches: int | None, reason: str) -> Bound:
        upper = None if command is None else command.maneuver_time
        price = dual.price(problem)
        near = dual.maneuver_time if upper is None or problem.begin is not None else upper
        lower = float(lower_bound(*extended(dual.problem, dual.costate, dual.tail_multipliers), near, price, dual.prices))
        if upper is not None:
            lower = min(lower, upper)
        costate = np.array(dual.problem.modal(dual.costate), dtype=float)
        seconds, tail = time.perf_counter() - begun, dual.tail_coefficients
        return Bound(Status.BRACKETED, lower, upper, costate, command, switches, reason, grid.count, seconds, tail, dual)

    if grid.settled and isinstance(found := early[-1], Extremal):
        return bound(found, found.command(problem), len(found.switches_to_go), NOT_PROVEN)
    if grid.above is None:
        assert grid.below is not None
        reach = grid.below.fraction
        reason = f"no command was found: at T = {grid.below.program.maneuver_time:.6g} s the grid reaches {reach:.3g} of the target"
        return bound(grid.below, None, None, reason)
    tried: list[str] = []
    for start in (grid.above, grid.below):
        if start is None:
            continue
        found = _refined(start)
        if isinstance(found, Failure):
            tried.append(found.reason)
            continue
        return bound(found, found.command(problem), len(found.switches_to_go), NOT_PROVEN)
    command = staircase(problem, grid.above)
    reason = f"{NOT_PROVEN}; the command is the grid's staircase, since its switch times could not be refined ({'; '.join(tried)})"
    # Of a plant that begins elsewhere than at rest a costate may refute times near its own only.
    dual = grid.below if problem.begin is not None and grid.below is not None else grid.above
    return bound(dual, command, None, reason)


def _tail_only(problem: Problem) -> Reals | None:
    """The tail that does the whole maneuver in no time, if there is one: as many stable zeros as poles, and room for it."""
    tail = problem.tail
    if tail.size < problem.size or problem.residuals is not None or problem.rate is not None:
        return None
    coefficients: Reals = np.linalg.solve(tail.columns, -problem.aimed(0.0)).astype(np.float64)
    looks = tail.looks().instants
    course, (above, below) = tail.rows(looks) @ coefficients, tail.room(looks)
    slack = 1e-12 * (problem.upper - problem.lower)  # a tail may begin on a limit exactly; the proof decides
    over = [*(course - above - slack), *(-course - below - slack)]
    for one in tail.aspects:
        further = tail.rows(looks) @ one.turned @ coefficients
        over += [*(further - one.above * (1.0 + 1e-12)), *(-further - one.below * (1.0 + 1e-12))]
    over += [size - cap.bound * (1.0 + 1e-12) for cap, size in zip(tail.caps, tail.sizes(coefficients), strict=True)]
    return coefficients if max(over) <= 0.0 else None


def extended(problem: Problem, costate: Reals, multipliers: Sequence[tuple[float, float, float]]) -> tuple[Problem, Reals]:
    """The problem with the samples of a box as target sets, and the costate with what the residuals' multipliers say of these."""
    residuals = problem.residuals
    if residuals is None:
        return problem, costate
    sets = (*problem.sets, *(TargetSet(sample.basis, np.zeros(sample.basis.size)) for sample in residuals.samples))
    return replace(problem, sets=sets, residuals=None), np.concatenate([costate, *(-part for part in residuals.costates(multipliers))])


def first_looks(problem: Problem) -> Looks:
    """Where limits after the move are imposed at first."""
    return problem.tail.looks() if problem.residuals is None else Looks(problem.residuals.looks(), np.zeros(0))


def exceeded(problem: Problem, solution: programs.GridSolution, factor: float = 1.0 + MISSED) -> Looks:
    """Where a solution is beyond a limit that was not imposed there: a residual beyond `factor` times its own."""
    levels, grid = solution.levels / solution.fraction, solution.program.instants
    if problem.residuals is not None:
        found = Looks(problem.residuals.exceeded(grid, levels, factor, problem.sloped), np.zeros(0))
    else:
        found = problem.tail.exceeded(solution.tail_coefficients, solution.pull)
    if not problem.courses:
        return found
    share = 1.0 - solution.program.inside / 2.0 if solution.program.inside or problem.residuals is None else 1.0 + COURSE
    return replace(found, moving=exceeded_places(problem.courses, grid, levels, share, problem.sloped))


def cut(problem: Problem, grid: Reals, inside: float) -> programs.GridSolution:
    """The program's solution with the tail's limits imposed where its tail has extremes too: cutting planes, until they hold there.

    The limits are tightened by the fraction `inside`, which is what the last cut may be off by.
    """
    looks = first_looks(problem)
    solution = programs.solve(posing.build(problem, grid, looks, inside))
    for _ in range(CUTS):
        if not (over := exceeded(problem, solution)):
            break
        looks |= over
        solution = programs.solve(posing.build(problem, grid, looks, inside))
    return solution


def _refined(start: programs.GridSolution) -> Extremal | Failure:
    problem = start.problem  # in the coordinates that the program chose
    if not problem.switched:
        return Failure("a command with further limits is repaired on the grid, not refined")
    return refine(problem, start.costate, start.maneuver_time, contacts(problem, start), start.fuel)


def contacts(problem: Problem, solution: programs.GridSolution) -> TailStart:
    """The tail of a grid's solution and where it touches its limits: at an instant that is known, or at a local extreme in its course."""
    tail, coefficients = problem.tail, solution.tail_coefficients
    known, peaks = tail.known, tail.peaks(coefficients)
    upward = tail.rows(peaks, 2) @ coefficients < 0.0
    found: dict[tuple[float, int], float] = {}
    for t, above, below in solution.tail_multipliers:
        side, multiplier = (1, above) if above > below else (-1, below)
        if multiplier * float((np.abs(tail.rows(np.array([t]))) @ np.abs(coefficients))[0]) <= TOUCHING:
            continue
        places = np.concatenate([known, peaks[upward == (side > 0)]])
        near = float(places[np.argmin(np.abs(places - t))])
        found[near, side] = found.get((near, side), 0.0) + multiplier
    touching = [Contact(t, side, mu, t not in known) for (t, side), mu in found.items()]
    pulls, terms = tail.sizes(solution.pull), np.abs(solution.costate) @ np.abs(tail.columns)
    pulled = [k for k, cap in enumerate(tail.caps) if pulls[k] > CAPPED * terms[list(cap.at)].max()]
    touching += [tail.capped(k, -solution.pull, float(pulls[k])) for k in pulled]
    return TailStart(coefficients, tuple(touching))


def instants(problem: Problem, horizon: float, settings: Settings) -> Reals:
    """The grid [s] that these settings ask for."""
    least = max(settings.least_cells, settings.cells_per_equation * problem.size)
    return grid(problem, horizon, least, settings.cells_per_period, settings.most_cells)


def _cut_minimum(problem: Problem, settings: Settings, near: float | None, settled: Callable[[programs.GridSolution], bool]) -> GridMinimum:
    """`grid_minimum` with cutting planes: the tail's limits are imposed at the extremes too at which the last tail exceeded them."""
    looks = first_looks(problem)
    grid = grid_minimum(problem, settings, near, looks, settled)
    count = grid.count
    for _ in range(CUTS):
        if grid.settled or grid.above is None or not (over := exceeded(problem, grid.above)):
            break
        looks |= over
        grid = grid_minimum(problem, settings, grid.above.maneuver_time, looks, settled)
        count += grid.count
    return replace(grid, count=count)


def grid_minimum(
    problem: Problem,
    settings: Settings,
    near: float | None = None,
    looks: Looks | None = None,
    settled: Callable[[programs.GridSolution], bool] = lambda solution: False,
) -> GridMinimum:
    """The root of α(T) = 1 by Newton's method on log α against log T, safeguarded by the bracket found so far.

    With the costate scaled to `λᵀ target = 1`, `dα/dT = σ(p(T))`. On logarithms a rigid body (α ~ T^m) is solved in one step, and no unit
    of time or amplitude matters. The search ends early with the first solution that is `settled`.
    """
    growth = max((pole.real for pole in problem.poles), default=0.0)
    horizon = first = first_guess(problem) if growth <= 0.0 else min(first_guess(problem), 1.0 / growth)
    farthest = FARTHEST * first if growth <= 0.0 else LARGEST_EXPONENT / growth
    short = 0.0 if near else energy_time(problem, lambda time: instants(problem, time, settings), horizon, farthest)
    horizon = near or min(LONGER * short, farthest) or horizon
    below: programs.GridSolution | None = None
    above: programs.GridSolution | None = None
    count, stalled = 0, 0
    last: tuple[float, float] | None = None  # time and -log α before
    while count < settings.programs:
        count += 1
        try:
            solution = programs.solve(posing.build(problem, instants(problem, horizon, settings), looks))
        except ShortHorizonError:
            short = max(short, horizon)
            horizon = math.sqrt(horizon * above.maneuver_time) if above else 1.5 * horizon
            if count >= settings.programs or horizon >= farthest:
                raise
            continue
        except SolverError:
            # A solver that stalls at one horizon seldom does so beside it.
            stalled += 1
            if stalled > STALLS:
                raise
            horizon *= 1.001
            continue
        fraction, problem = solution.fraction, solution.problem  # in the coordinates that suit it
        if solution.reaches:
            above = solution
        else:
            below = solution
        if settled(solution):
            return GridMinimum(below, above, count, True)
        if solution.reaches and fraction <= 1.0 + settings.tolerance:
            break
        if above is None and horizon >= farthest:
            break
        if above and below and above.program.maneuver_time / below.program.maneuver_time - 1.0 <= settings.tolerance:
            break
        off = -math.log(max(fraction, 1e-300))
        exponent = exponent_of(solution)
        if exponent and last and max(abs(last[1]) / 8, NOISE) < abs(off) and last[1] < -math.log(VISIBLE):
            # The costate's slope is that of continuous time: where the grid cannot follow short arcs, the slope seen is the better one.
            exponent = (last[1] - off) / math.log(horizon / last[0])
        last = horizon, off
        if exponent > FLAT:
            # Aim a hair beyond the root, so that the last program lies on the feasible side.
            ratio = math.exp(min(max((math.log1p(settings.tolerance / 2) + off) / exponent, -3.0), 3.0))
        else:
            ratio = 2.0
        following = min(horizon * ratio, farthest)
        low = max(below.program.maneuver_time if below else 0.0, short)
        high = above.program.maneuver_time if above else math.inf
        if not low < following < high:
            following = (
                math.sqrt(low * high) if low > 0.0 and math.isfinite(high) else (min(2 * low, farthest) if math.isinf(high) else high / 4)
            )
        horizon = following
    return GridMinimum(below, above, count)


def exponent_of(solution: programs.GridSolution) -> float:
    """`d log α/d log T`, which the multipliers know; 0 where α is known to too few digits."""
    whole, fraction = extended(solution.problem, solution.costate, solution.tail_multipliers), solution.fraction
    return (
        solution.maneuver_time * rise(*whole, solution.prices, solution.maneuver_time, fraction) / fraction if fraction > VISIBLE else 0.0
    )


def ramped(problem: Problem, instants: Reals, values: Reals, tail: Reals) -> Command:
    """The command that goes straight from value to value (deviations) at all nodes but the last, where it is at its final rest, or where
    its tail begins."""
    end = problem.hold + float((problem.tail.rows(np.zeros(1)) @ tail)[0])
    slopes = np.diff(np.append(values, end)) / np.diff(instants)
    pieces = zip(instants[:-1], values, slopes, strict=True)
    segments = tuple(Segment(float(s), problem.absolute(float(v)), float(slope)) for s, v, slope in pieces)
    return Command(float(instants[-1]), segments, Tail(problem.absolute(problem.hold), problem.tail.terms(tail)))


def staircase(problem: Problem, solution: programs.GridSolution) -> Command:
    """The grid's own command, divided by α ≥ 1 so that it reaches the target itself; equal neighbours are one segment."""
    levels, tail = solution.levels / solution.fraction, solution.tail_coefficients[: problem.tail.size]
    if problem.sloped:
        return ramped(problem, solution.program.instants, np.concatenate([[0.0], levels[:-1]]), tail)
    horizon, starts = solution.program.maneuver_time, solution.program.instants[:-1]
    keep = np.concatenate([[True], np.diff(levels) != 0.0])
    segments = tuple(Segment(float(s), problem.absolute(float(u))) for s, u in zip(starts[keep], levels[keep], strict=True))
    return Command(horizon, segments, Tail(problem.absolute(problem.hold), problem.tail.terms(tail)))
