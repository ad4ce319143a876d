"""Thrusters: full thrust one way, full thrust the other, or none; every pulse at least so wide, and at most so many.

The set of such commands is not convex. A lower bound comes from the same task without these limits; here commands are looked for that meet
them: for every pattern of pulses (that of the fastest command without these limits; alternating; one way first and then the other; with
coasting between them, which may vanish) the durations are a small nonlinear program, minimum time under the moment equations, started from
several places. What holds at every instant, in every plant of a box, is watched at some, and at more where a command exceeds it
(`relaxations.watching`). The best that is found may not be the best there is. A hair of everything is kept, so that the exact command
nearby is admissible too.

Of a plant that varies t stands where time to go does elsewhere; durations and levels are in the order of time here all the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from relaxations.commands import Command
from relaxations.errors import SolverError
from relaxations.limits import Limits
from relaxations.maneuvers import Problem
from relaxations.watching import Watch

Reals = NDArray[np.float64]

MORE = 3  # alternating pulses than equations, at most; in other orders one
STRETCHED = (1.05, 1.5, 2.2)  # times the lower bound: where searches begin
HAIR = 1e-8  # relative: what pulses are wider, and fuel less, than they must
ROOM = 4e-6  # of a limit that holds at every instant: what is kept of it
VANISHED = 1e-6  # of the duration: a coast so short is none, and the others are looked for again without it
LANDED = 1e-9  # relative residual of the equations at which a search has come to something
STEPS = 6  # of Newton's method at the end
CUTS = 12  # rounds of cutting planes of one pattern
MANY = 8  # pulses of an outline beside as many as there are equations, at most
FLICKER = 1e-3  # of the duration: pieces of a grid's command that are shorter, all neighbours together, are none
NEAR = 1e-3  # relative: as close to the lower bound no further pattern is tried where each takes long


@dataclass(frozen=True, slots=True)
class Pulsed:
    """Duration T [s], starts (n,) [s] and exact absolute levels (n,); whether it is meant to be its own image about the middle."""

    maneuver_time: float
    starts: Reals
    levels: tuple[Fraction, ...]
    mirrored: bool = False


def off(problem: Problem) -> Fraction:
    """The input at the initial rest, absolute: what thrusters are at that are off."""
    transition, maneuver = problem.transition, problem.maneuver
    return maneuver.rest - (transition.plant.rest(maneuver.displacement)[1] if transition else 0)


def admissible(problem: Problem, command: Command) -> bool:
    """Whether a command's pulses are wide and few enough, as far as doubles tell."""
    limits, rest = problem.maneuver.limits, float(off(problem))
    starts, full = [segment.start for segment in command.segments], (float(limits.lower), float(limits.upper), rest)
    widths = np.diff([*starts, command.end])
    pulses = [width for segment, width in zip(command.segments, widths, strict=True) if segment.level != rest]
    if any(segment.level not in full or segment.slope for segment in command.segments):
        return False
    wide = limits.pulse_width is None or min(pulses, default=np.inf) >= float(limits.pulse_width)
    return bool(wide) and (limits.pulses is None or len(pulses) <= limits.pulses)


def pulsed_commands(problem: Problem, least: float, free: Command | None = None) -> list[Pulsed]:
    """Admissible commands, the shortest first; `least` [s] is a time that no command is shorter than, `free` the one found without limits
    of pulses."""
    watch, found = Watch.of(problem), list[Pulsed]()
    if free is not None and (outline := _outlined(problem, free)) is not None:
        levels, durations = outline
        found += [one for one in (searched(problem, watch, levels, durations),) if one is not None]
    slow = problem.residuals is not None
    for levels in _patterns(problem):
        if found and min(one.maneuver_time for one in found) <= least * (1.0 + (NEAR if slow else 0.0)):
            break
        for stretch in STRETCHED[: 1 if slow else None]:
            begin = _shares(problem, levels, max(least, _shortest(problem, levels)) * stretch)
            best = min((one.maneuver_time for one in found), default=np.inf) if slow else np.inf
            if (one := searched(problem, watch, levels, begin, best)) is not None:
                found.append(one)
    return sorted(found, key=lambda one: one.maneuver_time)


def _outlined(problem: Problem, free: Command) -> tuple[tuple[Fraction, ...], Reals] | None:
    """The pattern of pulses that a command without their limits is nearest to: what it is between two levels is shared among these."""
    limits, coast = problem.maneuver.limits, off(problem)
    most = MANY + (problem.plants[0].order if problem.residuals is not None else problem.size)
    choices = sorted({limits.lower, coast, limits.upper})
    pieces: list[tuple[Fraction, float]] = []
    ends = [*(segment.start for segment in free.segments[1:]), free.end]
    for segment, end in zip(free.segments, ends, strict=True):
        width = end - segment.start
        level = segment.level + segment.slope * width / 2.0
        above = next((i for i, choice in enumerate(choices) if level <= float(choice)), len(choices) - 1)
        high, low = choices[above], choices[max(above - 1, 0)]
        share = (level - float(low)) / float(high - low) if high > low else 1.0
        parts = [(high, share * width), (low, (1.0 - share) * width)]
        if pieces and pieces[-1][0] == low:
            parts.reverse()
        for one, part in parts:
            if part <= 0.0:
                continue
            if pieces and pieces[-1][0] == one:
                pieces[-1] = one, pieces[-1][1] + part
            else:
                pieces.append((one, part))
    kept: list[tuple[Fraction, float]] = []
    for one, part in pieces:
        if part < FLICKER * free.end and not (kept and kept[-1][0] == one):
            continue
        if kept and kept[-1][0] == one:
            kept[-1] = one, kept[-1][1] + part
        else:
            kept.append((one, part))
    pulses = [level for level, _ in kept if level != coast]
    if len(pulses) > most:
        kept = _modulated(problem, free, choices)
        pulses = [level for level, _ in kept if level != coast]
    if not pulses or len(pulses) > (limits.pulses or 2 * most) or not _of_form(limits, pulses):
        return None
    whole: list[tuple[Fraction, float]] = []
    for one, part in kept:
        if whole and one != coast != whole[-1][0]:
            whole.append((coast, 0.0))
        whole.append((one, part))
    return tuple(one for one, _ in whole), np.array([part for _, part in whole])


def _modulated(problem: Problem, free: Command, choices: Sequence[Fraction]) -> list[tuple[Fraction, float]]:
    """Pulses of the least width, or longer, whose integral follows that of a command (sigma-delta modulation)."""
    coast, width = off(problem), max(_least_width(problem), free.end / 50.0)
    parts = max(4 * round(free.end / width), 200)
    step, owed, held = free.end / parts, 0.0, 0.0
    wanted = free((np.arange(parts) + 0.5) * step) - float(coast)
    found: list[tuple[Fraction, float]] = []
    level = coast
    for u in wanted:
        owed += float(u) * step
        if level == coast or held >= width:
            due = [
                one
                for one in choices
                if one != coast and owed * float(one - coast) > 0 and abs(owed) >= width / 2 * abs(float(one - coast))
            ]
            following = due[0] if due else level if level != coast and owed * float(level - coast) > 0 else coast
            held = held if following == level else 0.0
            level = following
        owed -= float(level - coast) * step
        held += step
        if found and found[-1][0] == level:
            found[-1] = level, found[-1][1] + step
        else:
            found.append((level, step))
    return found


def _patterns(problem: Problem) -> Iterator[tuple[Fraction, ...]]:
    """Levels of pulses and coasts in turn. Pulses of one sign alone bring to rest what is held elsewhere, or moves at first.

    Last come those that begin or end with a coast: a start that moves, or a plant that varies, may be worth waiting for, and what another
    input holds at rest comes there by itself.
    """
    limits, coast, seen = problem.maneuver.limits, off(problem), set[tuple[Fraction, ...]]()
    signs = [level for level in (limits.upper, limits.lower) if level != coast]
    size = problem.size if problem.residuals is None else max(problem.size, problem.plants[0].order)
    most, held = min(size + MORE, limits.pulses or size + MORE), bool(problem.hold) or problem.begin is not None
    waits = problem.begin is not None or problem.transition is not None
    comes = bool(problem.hold) or coast != problem.maneuver.rest
    for before, after in [(False, False), *([(False, True)] if comes else []), *([(True, False), (True, comes)] if waits else [])]:
        for count in range(1, (min(most, size) if before or after else most) + 1):
            orders = [tuple(signs[(i + first) % len(signs)] for i in range(count)) for first in range(len(signs))]
            if len(signs) == 2 and count <= size + 1 and not (before or after):
                orders += [(one,) * k + (other,) * (count - k) for one, other in (signs, signs[::-1]) for k in range(1, count)]
            orders += [(one,) * count for one in signs if held or comes]
            for order in orders:
                if not _of_form(limits, order):
                    continue
                pattern = tuple(level for pulse in order for level in (pulse, coast))[:-1]
                pattern = (coast,) * before + pattern + (coast,) * after
                if len(pattern) >= problem.size and pattern not in seen:
                    seen.add(pattern)
                    yield pattern


def _of_form(limits: Limits, pulses: Sequence[Fraction]) -> bool:
    """Whether pulses have the form that is held, if one is: of one sign first, then of the other."""
    first = limits.upper if limits.held > 0 else limits.lower
    return not limits.held or not any(after == first != before for before, after in pairwise(pulses))


def _least_width(problem: Problem) -> float:
    return float(problem.maneuver.limits.pulse_width or 0) * (1.0 + HAIR)


def _shortest(problem: Problem, levels: tuple[Fraction, ...]) -> float:
    return _least_width(problem) * sum(level != off(problem) for level in levels)


def _shares(problem: Problem, levels: tuple[Fraction, ...], duration: float) -> Reals:
    """So many seconds, most of them of pulses."""
    shares = np.array([1.0 if level == off(problem) else 3.0 for level in levels])
    return np.asarray(duration * shares / shares.sum(), dtype=np.float64)


def searched(problem: Problem, watch: Watch, levels: tuple[Fraction, ...], begin: Reals, best: float = np.inf) -> Pulsed | None:
    """The shortest command of one pattern near these durations, or None, or if it does not beat the `best` [s]."""
    least, durations = _least_width(problem), begin
    for turn in range(CUTS):
        if turn:
            levels, durations = without_coasts(problem, levels, durations)
        values = np.array([float(level - problem.maneuver.rest) for level in levels])
        on = np.array([level != off(problem) for level in levels])
        wide = np.where(on, least, 0.0)
        found = minimized(problem, watch, values, on, np.maximum(durations, wide), wide)
        if found is None or found.sum() >= best:  # what is watched more closely takes no less
            return None
        durations = found
        if len(without_coasts(problem, levels, durations)[0]) < len(levels):
            continue
        more = watch.further(values, durations, 1.0 - ROOM / 2)
        if more is None:
            return _landed(problem, levels, durations)
        watch = more
    return None


def without_coasts(problem: Problem, levels: tuple[Fraction, ...], durations: Reals) -> tuple[tuple[Fraction, ...], Reals]:
    """A command without coasts that have vanished, equal neighbours as one pulse."""
    kept: list[tuple[Fraction, float]] = []
    for level, duration in zip(levels, durations.tolist(), strict=True):
        if level == off(problem) and duration <= VANISHED * durations.sum():
            continue
        if kept and kept[-1][0] == level:
            kept[-1] = level, kept[-1][1] + duration
        else:
            kept.append((level, duration))
    return tuple(level for level, _ in kept), np.array([duration for _, duration in kept])


def _scale(problem: Problem, values: Reals, duration: float) -> Reals:
    return np.abs(problem.rows(np.linspace(0.0, duration, 65), 1)).max(axis=1) * np.abs(values).max() + 1e-300


def minimized(problem: Problem, watch: Watch, values: Reals, on: NDArray[np.bool_], begin: Reals, least: Reals) -> Reals | None:
    """Durations, each its least one or longer, of a local minimum under the moment equations, the budget of fuel and what is watched.

    None if the search fails.
    """
    first, budget = float(begin.sum()), problem.maneuver.limits.fuel
    scale = _scale(problem, values, first)

    def missed(x: Reals) -> Reals:
        return _missed(problem, values, x * first) / scale

    def slope(x: Reals) -> Reals:
        return _slope(problem, values, x * first) * first / scale[:, None]

    constraints: list[dict[str, object]] = [{"type": "eq", "fun": missed, "jac": slope}] if problem.size else []
    if budget is not None:
        most, sizes = float(budget) * (1.0 - HAIR) / first, np.where(on, np.abs(values - float(off(problem) - problem.maneuver.rest)), 0.0)
        constraints.append({"type": "ineq", "fun": lambda x: most - sizes @ x, "jac": lambda x: -sizes})
    if len(watch.rooms(values, begin)[0]):
        last: dict[bytes, tuple[Reals, Reals]] = {}  # value and slope are asked for one after the other

        def rooms(x: Reals) -> tuple[Reals, Reals]:
            if (key := x.tobytes()) not in last:
                last.clear()
                last[key] = watch.rooms(values, x * first)
            return last[key]

        constraints.append({"type": "ineq", "fun": lambda x: rooms(x)[0] - ROOM, "jac": lambda x: rooms(x)[1] * first})
    bounds = [(width / first, None) for width in least]
    try:
        with np.errstate(all="ignore"):
            result = minimize(
                lambda x: float(x.sum()),
                begin / first,
                jac=lambda x: np.ones(len(x)),
                bounds=bounds,
                constraints=constraints,
                method="SLSQP",
                options={"maxiter": 80, "ftol": 1e-11},
            )
    except SolverError:  # it strayed to times to which a plant that varies is not followed
        return None
    x = np.asarray(result.x, dtype=np.float64)
    if not np.all(np.isfinite(x)) or not x.sum() > 0.0 or np.abs(missed(x)).max(initial=0.0) > LANDED**0.5:
        return None
    kept = watch.rooms(values, x * first)[0].min(initial=np.inf)
    return x * first if kept > 0.0 else None


def _missed(problem: Problem, values: Reals, durations: Reals) -> Reals:
    if problem.transition is not None:
        table = problem.rows(np.concatenate([[0.0], np.cumsum(durations)]), 1)
        return np.diff(table, axis=1) @ values - problem.target
    to_go = np.append(np.cumsum(durations[::-1])[::-1], 0.0)
    table = problem.rows(to_go, 1)
    return (table[:, :-1] - table[:, 1:]) @ values - problem.aimed(float(to_go[0]))


def _slope(problem: Problem, values: Reals, durations: Reals) -> Reals:
    """Derivative of the moments by the durations: a longer piece shifts all jumps before it, or of a plant that varies all after it."""
    if problem.transition is not None:
        kicks = problem.rows(np.cumsum(durations)) * -np.diff(values, append=0.0)
        return np.cumsum(kicks[:, ::-1], axis=1)[:, ::-1]
    to_go = np.cumsum(durations[::-1])[::-1]
    jumps = np.diff(values, prepend=0.0)
    drift = problem.aim(np.array([to_go[0]]))[1]
    return np.cumsum(problem.rows(to_go) * jumps, axis=1) - drift


def _landed(problem: Problem, levels: Sequence[Fraction], durations: Reals) -> Pulsed | None:
    """The command, its durations corrected until it lands to rounding."""
    width = float(problem.maneuver.limits.pulse_width or 0)
    times = landed(problem, levels, durations, np.array([0.0 if level == off(problem) else width for level in levels]))
    if times is None:
        return None
    starts = np.concatenate([[0.0], np.cumsum(times)[:-1]])
    return Pulsed(float(times.sum()), starts, tuple(levels))


def landed(problem: Problem, levels: Sequence[Fraction], durations: Reals, least: Reals) -> Reals | None:
    """Durations (n,) [s] corrected until the command lands to rounding; None where they are too few or become less than the `least`."""
    values, size, times = np.array([float(level - problem.maneuver.rest) for level in levels]), problem.size, durations
    if len(times) < size:
        return None
    scale = _scale(problem, values, float(times.sum()))
    for _ in range(STEPS if size else 0):
        residual = _missed(problem, values, times) / scale
        change = np.linalg.lstsq(_slope(problem, values, times) / scale[:, None], residual, rcond=None)[0]
        times = np.asarray(times - change, dtype=np.float64)
        if not np.all(times > 0.0):
            return None
    missed = np.abs(_missed(problem, values, times) / scale).max(initial=0.0)
    return None if missed > LANDED**1.3 or np.any(times < least * (1.0 + HAIR / 4)) else times
