"""The least time for a whole box: samples of it share one program, and the worst places of its command become samples in their turn.

At one time after the other the program is solved, instants and places at which its command exceeds the tolerance are added to it, and
Newton's method goes on with what is left. The lower side may look where it likes; the upper side is proven over the whole box by the
checker, so a command that is tried keeps a hair of margin between the samples.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from relaxations import posing, programs
from relaxations.bounds import Settings, exceeded, exponent_of, first_looks, grid_minimum, instants
from relaxations.courses import moved
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem, problem
from relaxations.programs import GridSolution
from relaxations.repair import Repaired
from relaxations.robust.boxes import Box, Family, Listed, Place
from relaxations.robust.excursions import Excursions
from relaxations.robust.residuals import PERIODS
from relaxations.robust.scans import Scan, Staircase
from relaxations.tails import Looks

Reals = NDArray[np.float64]

FIRST = {1: 7, 2: 4}  # samples of each parameter at first, by their number; 2 of more
FINE = {1: 401, 2: 41, 3: 15}  # places of each parameter at which a command is tried, by their number; 5 of more
NEARER = {1: 9, 2: 5}  # values of each parameter around a local maximum, in a round that looks for its top; 3 of more
ZOOMS, SHRUNK = 8, 3.0  # such rounds, and by what its neighbourhood shrinks in each
EXCESS = 1e-4, 1e-6  # relative, first and last: a tolerance that is exceeded by less is left to the hair that the proof keeps inside
ROUGH = 1e-3  # of α, before the first places are sought
TOLERANCE = 1e-7  # of α: closer to the root is closer than the grid
NEAR = 100  # times that: so close to the root worst places are sought
SEEN = 1e-6  # of the tolerance: what a staircase stays below it
ROUNDS = 60
TIGHTER, MOST_INSIDE = 3.0, 0.01  # how a program's limits are tightened whose samples keep theirs at instants only, and how far
STILL = 6  # programs with the same conditions: then the last one that reaches the target is the root, as far as the solver tells
STALLS, BESIDE = 4, 1.0003  # how often the solver may give no answer, and how much longer a move is tried then
NEARLY = {1: 0.99, 2: 0.99, 3: 0.9}  # of the tolerance: a local maximum of the grid so close to it is looked at more closely; 0.8 of more
ALSO = {3: 0.998}  # of the tolerance: places of a coarse grid that are looked at too, with a higher one beside them; 0.995 of more
TOPS = {1: 12, 2: 12}  # places of the grid that are looked at in one round, local maxima first, then the worst; 48 of more parameters
APART = 0.01  # of the range: tops that are closer together are one


@dataclass(frozen=True, slots=True)
class Sampled:
    """The problem with the samples that its box needs, where its residuals are limited, and the program's solution (None: no command).

    `shares` are the instants of the grid as fractions of the move; None: as the settings ask for.
    """

    problem: Problem
    looks: Looks
    solution: GridSolution | None
    below: GridSolution | None
    programs: int
    shares: Reals | None = None


def at_rest_at_once(posed: Problem) -> bool:
    """Whether the final input itself, from the first instant on, leaves no more than the tolerance."""
    if posed.size or posed.residuals is None or posed.rate is not None or posed.courses:
        return False
    box, none = posed.maneuver.box, (np.zeros(1), np.zeros(0))
    assert box is not None
    return not worst_places(posed, *none, 1.0)


def minimum(posed: Problem, settings: Settings, near: Sampled | None = None, guess: float | None = None) -> Sampled:
    """The root of α(T) = 1 with as many samples and instants as its command needs not to exceed the tolerance anywhere.

    `near` is what was found of this problem, or one like it, before, on its grid if it has one of its own, `guess` a guess at its time [s].
    Raises `SolverError`.
    """
    box, count, shares = posed.maneuver.box, 0, near.shares if near else None
    assert box is not None
    if near is None:
        posed = _with_samples(posed, [*box.samples, box.nominal, *box.places(FIRST.get(len(box.axes), 2))])
        looks = first_looks(posed)
        first = grid_minimum(posed, replace(settings, tolerance=ROUGH), guess, looks)
        count = first.count
        if first.above is None:
            return Sampled(posed, looks, None, first.below, count)
        horizon = first.above.maneuver_time
    else:
        posed = _with_samples(posed, near.problem.maneuver.box.samples if near.problem.maneuver.box else ())
        looks, horizon = near.looks, near.solution.maneuver_time if near.solution else 1.0
    low, high, below = 0.0, math.inf, None
    solution: GridSolution | None = None
    tolerance = max(settings.tolerance, TOLERANCE)
    stalls = stage = still = 0
    reached: GridSolution | None = None  # the shortest, with the same conditions
    for _ in range(ROUNDS):
        count += 1
        try:
            solution = programs.solve(posing.build(posed, _instants(posed, horizon, settings, shares), looks))
        except SolverError:  # that stalls at one time seldom does so beside it
            stalls += 1
            if stalls > STALLS:
                raise
            horizon, looks = horizon * BESIDE, replace(looks, moving=np.zeros((0, 2)))  # and tops of courses are found again
            continue
        if solution.fraction < 1.0:
            low, below = horizon, solution
        else:
            high = min(high, horizon)
        while True:
            wider, more, off = posed, looks | exceeded(posed, solution, 1.0 + EXCESS[stage]), abs(math.log(max(solution.fraction, 1e-300)))
            near_root = off <= max(NEAR * tolerance, EXCESS[stage])
            if more.count == looks.count and near_root:
                worst = worst_places(posed, solution.program.instants, solution.levels / solution.fraction, 1.0 + EXCESS[stage])
                wider = _with_samples(posed, [*_samples(posed), *worst])
                more = looks | _looks_of(posed, wider)
            if more.count > looks.count or not near_root or stage == len(EXCESS) - 1:
                break
            stage += 1
        if more.count > looks.count:
            posed, looks, high = wider, more, math.inf  # with more conditions a time may be too short that was not before
            reached, still = None, 0
        elif stage == len(EXCESS) - 1:
            still += 1
            if solution.reaches and (reached is None or solution.maneuver_time < reached.maneuver_time):
                reached = solution
            if reached is not None and (reached.fraction <= 1.0 + tolerance or still >= STILL):
                solution = reached
                break
        horizon = _following(solution, tolerance, low, high)
    assert solution is not None
    return Sampled(posed, looks, solution, below, count, shares)


def within(found: Sampled, beyond: float, settings: Settings) -> tuple[Sampled, bool]:
    """The program's solution a little `beyond` the minimum time (relative), its limits tightened in turn: nowhere is it over them.

    Whether that is so is the second answer: where the margin is too small it is not.
    """
    posed, looks, inside, hair = found.problem, found.looks, beyond / 4.0, beyond / 8.0
    assert found.solution is not None
    horizon, solution = found.solution.maneuver_time * (1.0 + beyond), found.solution
    for count in range(ROUNDS // 2):
        solution = programs.solve(posing.build(posed, _instants(posed, horizon, settings, found.shares), looks, inside))
        if not solution.reaches:
            return Sampled(posed, looks, solution, found.below, count + 1, found.shares), False
        if (more_looks := looks | exceeded(posed, solution, 1.0 - inside / 2)).count > looks.count:
            looks = more_looks
            continue
        worst = worst_places(posed, solution.program.instants, solution.levels / solution.fraction, 1.0 - hair)
        more = _with_samples(posed, [*_samples(posed), *worst])
        if len(_samples(more)) > len(_samples(posed)):
            posed, looks = more, looks | _looks_of(posed, more)
        elif not worst or inside > MOST_INSIDE:
            return Sampled(posed, looks, solution, found.below, count + 1, found.shares), not worst
        else:  # several modes that last add up to more than they do at the instants that were found
            inside *= TIGHTER
    return Sampled(posed, looks, solution, found.below, ROUNDS // 2, found.shares), False


def further(posed: Problem, solution: GridSolution, inside: float) -> Problem | None:
    """The problem with samples at the places where a solution whose limits are tightened by `inside` is not; None if there are none."""
    worst = worst_places(posed, solution.program.instants, solution.levels / solution.fraction, 1.0 - inside / 2)
    more = _with_samples(posed, [*_samples(posed), *worst])
    return None if len(_samples(more)) == len(_samples(posed)) else more


def keeps(posed: Problem, fixed: Repaired) -> bool:
    """Whether a staircase keeps the tolerance in all of the box, as far as can be seen."""
    levels = np.array([float(level - posed.maneuver.rest) for level in fixed.levels])
    if posed.sloped:
        levels = np.append(levels[1:], posed.hold)
    return not worst_places(posed, np.append(fixed.starts, fixed.maneuver_time), levels, 1.0 - SEEN)


def _instants(posed: Problem, horizon: float, settings: Settings, shares: Reals | None) -> Reals:
    return instants(posed, horizon, settings) if shares is None else horizon * shares


def _following(solution: GridSolution, tolerance: float, low: float, high: float) -> float:
    """The next time to try: a hair beyond the root that the slope points at."""
    time, off, exponent = solution.maneuver_time, -math.log(max(solution.fraction, 1e-300)), exponent_of(solution)
    ratio = math.exp(min(max((math.log1p(tolerance / 2) + off) / exponent, -1.0), 1.0)) if exponent > 1e-6 else (1.5 if off > 0 else 0.75)
    following = time * ratio
    if low < following < high:
        return following
    return (low + high) / 2 if math.isfinite(high) else max(low * (1.0 + tolerance), following)


def _samples(posed: Problem) -> tuple[Place, ...]:
    assert posed.maneuver.box is not None
    return posed.maneuver.box.samples


def _with_samples(posed: Problem, places: list[Place] | tuple[Place, ...]) -> Problem:
    box = posed.maneuver.box
    assert box is not None
    return problem(posed.plants, replace(posed.maneuver, box=replace(box, samples=tuple(dict.fromkeys(places)))))


def _looks_of(posed: Problem, more: Problem) -> Looks:
    """Where the residuals of those samples are limited at first that a problem has more than another."""
    assert posed.residuals is not None
    assert more.residuals is not None
    known = len(posed.residuals.samples)
    new = zip(more.residuals.begins[known:], more.residuals.samples[known:], strict=True)
    return Looks(np.concatenate([np.zeros(0), *(begin + sample.looks() for begin, sample in new)]), np.zeros(0))


def worst_places(posed: Problem, instants: Reals, levels: Reals, factor: float) -> list[Place]:
    """The local maxima over the box, of the residual and of limited outputs, that exceed `factor` times what is allowed, the worst ones."""
    box, residuals = posed.maneuver.box, posed.residuals
    assert box is not None
    assert residuals is not None
    if isinstance(box.family, Listed):
        return _worst_listed(posed, box.family, instants, levels, factor)
    command, found = Staircase.of(instants, levels, posed.hold, posed.sloped), []
    for measure in _measures(box, posed, command, factor):
        sides = [np.linspace(float(a.low), float(a.high), _fine(box)) if a.high > a.low else np.array([float(a.low)]) for a in box.axes]
        sizes = measure(np.array(list(itertools.product(*sides)))).reshape([len(side) for side in sides])
        high = np.argwhere(sizes > NEARLY.get(len(box.axes), 0.8) * factor)
        tops = {at: bool(sizes[at] >= _around(sizes, at).max()) for at in map(tuple, high)}
        also = ALSO.get(len(box.axes), 0.995) * factor if len(box.axes) > 2 else np.inf
        near = sorted((at for at, top in tops.items() if top or sizes[at] > also), key=lambda at: (not tops[at], -sizes[at]))
        starts = [[side[i] for side, i in zip(sides, at, strict=True)] for at in near[: TOPS.get(len(box.axes), 48)]]
        found += _tops(box, measure, np.array(starts), factor)
    return found


def _worst_listed(posed: Problem, family: Listed, instants: Reals, levels: Reals, factor: float) -> list[Place]:
    """The plants of a list in which something exceeds `factor` times what is allowed."""
    box = posed.maneuver.box
    assert box is not None
    whole = problem(posed.plants, replace(posed.maneuver, box=replace(box, samples=family.places)))
    assert whole.residuals is not None
    over = {
        sample.place
        for sample in whole.residuals.samples
        if sample.peaks(sample.table(instants, posed.sloped) @ levels - sample.rest, factor)[1].max() > factor
    }
    for course in whole.courses:
        if course.place is not None and len(course.exceeded(instants, levels, factor * course.limit, posed.sloped)):
            over.add(course.place)
    return [place for place in family.places if place in over]


def _measures(box: Box, posed: Problem, command: Staircase, factor: float) -> list[Callable[[Reals], Reals]]:
    """What is limited, as multiples of its limits at places (k, parameters): the residual, and each output."""
    residuals, limits = posed.residuals, posed.maneuver.limits.deflection
    assert residuals is not None
    allowed, moment = residuals.allowed, float(moved(posed.plants[0], posed.maneuver.displacement))

    family = box.family
    assert not isinstance(family, Listed)

    def left(places: Reals) -> Reals:
        return _scan(box, family, posed.size, places).sizes(command, PERIODS, allowed * factor) / allowed

    def gone(name: str, limit: float) -> Callable[[Reals], Reals]:
        return lambda places: Excursions.of(family, posed.size, places, name).sizes(command, PERIODS, moment) / limit

    return [left, *(gone(name, float(limit)) for name, limit in limits.items())]


def _fine(box: Box) -> int:
    return FINE.get(len(box.axes), 5)


@lru_cache(maxsize=4)
def _scanned(family: Family, rigid: int, places: bytes, parameters: int) -> Scan:
    return Scan.of(family, rigid, np.frombuffer(places).reshape(-1, parameters))


def _scan(box: Box, family: Family, rigid: int, places: Reals) -> Scan:
    grid = len(places) == np.prod([_fine(box) if a.high > a.low else 1 for a in box.axes])
    return _scanned(family, rigid, places.tobytes(), places.shape[1]) if grid else Scan.of(family, rigid, places)


def _around(sizes: Reals, at: tuple[int, ...]) -> Reals:
    return sizes[tuple(slice(max(i - 1, 0), i + 2) for i in at)]


def _tops(box: Box, measure: Callable[[Reals], Reals], starts: Reals, factor: float) -> list[Place]:
    """The local maxima of a measure near some places that exceed a factor, by grids that shrink around the best place of each so far."""
    if not len(starts):
        return []
    low, high = (np.array([float(side) for side in sides]) for sides in zip(*((a.low, a.high) for a in box.axes), strict=True))
    count, width, best, sizes = NEARER.get(len(box.axes), 3), (high - low) / (_fine(box) - 1), starts, np.zeros(len(starts))
    rows = np.arange(len(starts))
    shares = [np.linspace(-1.0, 1.0, count) if w > 0 else np.zeros(1) for w in width]
    around = np.array([*itertools.product(*shares), np.zeros(len(width))])
    for _ in range(ZOOMS):
        places = np.clip(best[:, None, :] + around * width, low, high)
        values = measure(places.reshape(-1, len(width))).reshape(len(starts), -1)
        at = values.argmax(axis=1)
        best, sizes = places[rows, at], values[rows, at]
        width = width / SHRUNK
    kept: list[Reals] = []
    for top in best[np.argsort(-sizes, kind="stable")][: np.count_nonzero(sizes > factor)]:
        share = (top - low) / np.where(high > low, high - low, 1.0)
        if all(np.abs(share - other).max() > APART for other in kept):
            kept.append(share)
    parts = [[Fraction(min(max(round(float(s) * 2**24), 0), 2**24), 2**24) for s in share] for share in kept]
    return [tuple(axis.low + (axis.high - axis.low) * part for part, axis in zip(place, box.axes, strict=True)) for place in parts]
