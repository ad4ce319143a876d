"""Thrusters: full thrust one way, full thrust the other, or none; every pulse at least so wide, and at most so many.

The set of such commands is not convex. A lower bound comes from the same task without these limits; here commands are looked for that meet
them: for every pattern of pulses (alternating, or one way first and then the other, with coasting between them, which may vanish) the
durations are a small nonlinear program, minimum time under the moment equations, started from several places. The best that is found may
not be the best there is. A hair of width is kept, so that the exact command nearby is admissible too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from relaxations.commands import Command
from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

MORE = 3  # alternating pulses than equations, at most; in other orders one
STRETCHED = (1.05, 1.5, 2.2)  # times the lower bound: where searches begin
HAIR = 1e-8  # relative: what pulses are wider, and fuel less, than they must
VANISHED = 1e-7  # of the duration: a coast so short is none
LANDED = 1e-9  # relative residual of the equations at which a search has come to something
STEPS = 6  # of Newton's method at the end


@dataclass(frozen=True, slots=True)
class Pulsed:
    """Duration T [s], starts (n,) [s] and exact absolute levels (n,)."""

    maneuver_time: float
    starts: Reals
    levels: tuple[Fraction, ...]


def admissible(problem: Problem, command: Command) -> bool:
    """Whether a command's pulses are wide and few enough, as far as doubles tell."""
    limits = problem.maneuver.limits
    starts, full = [segment.start for segment in command.segments], (float(limits.lower), float(limits.upper), problem.rest)
    widths = np.diff([*starts, command.end])
    pulses = [width for segment, width in zip(command.segments, widths, strict=True) if segment.level != problem.rest]
    if any(segment.level not in full or segment.slope for segment in command.segments):
        return False
    wide = limits.pulse_width is None or min(pulses, default=np.inf) >= float(limits.pulse_width)
    return bool(wide) and (limits.pulses is None or len(pulses) <= limits.pulses)


def pulsed_commands(problem: Problem, least: float) -> list[Pulsed]:
    """Admissible commands, the shortest first; `least` [s] is a time that no command is shorter than."""
    tried = (
        _searched(problem, levels, max(least, _shortest(problem, levels)) * stretch)
        for levels in _patterns(problem)
        for stretch in STRETCHED
    )
    return sorted((one for one in tried if one is not None), key=lambda one: one.maneuver_time)


def _patterns(problem: Problem) -> Iterator[tuple[Fraction, ...]]:
    """Deviations of pulses and coasts in turn."""
    limits, rest = problem.maneuver.limits, problem.maneuver.rest
    signs = [level - rest for level in (limits.upper, limits.lower) if level != rest]
    most = min(problem.size + MORE, limits.pulses or problem.size + MORE)
    seen: set[tuple[Fraction, ...]] = set()
    for count in range(1, most + 1):
        orders = [tuple(signs[(i + first) % len(signs)] for i in range(count)) for first in range(len(signs))]
        if len(signs) == 2 and count <= problem.size + 1:
            orders += [(one,) * k + (other,) * (count - k) for one, other in (signs, signs[::-1]) for k in range(1, count)]
        for order in orders:
            pattern = tuple(level for pulse in order for level in (pulse, Fraction(0)))[:-1]
            if len(pattern) >= problem.size and pattern not in seen:
                seen.add(pattern)
                yield pattern


def _least_width(problem: Problem) -> float:
    return float(problem.maneuver.limits.pulse_width or 0) * (1.0 + HAIR)


def _shortest(problem: Problem, levels: tuple[Fraction, ...]) -> float:
    return _least_width(problem) * sum(level != 0 for level in levels)


def _searched(problem: Problem, levels: tuple[Fraction, ...], first: float) -> Pulsed | None:
    """The shortest command of one pattern near a start of so many seconds, or None."""
    deviations, width = np.array([float(level) for level in levels]), _least_width(problem)
    on = deviations != 0.0
    shares = np.where(on, 3.0, 1.0)
    begin = np.maximum(first * shares / shares.sum(), np.where(on, width, 0.0))
    scale = np.abs(problem.rows(np.linspace(0.0, first, 65), 1)).max(axis=1) * np.abs(deviations).max() + 1e-300
    budget = problem.maneuver.limits.fuel

    def missed(x: Reals) -> Reals:
        return _missed(problem, deviations, x * first) / scale

    def slope(x: Reals) -> Reals:
        return _slope(problem, deviations, x * first) * first / scale[:, None]

    constraints: list[dict[str, object]] = [{"type": "eq", "fun": missed, "jac": slope}]
    if budget is not None:
        most, sizes = float(budget) * (1.0 - HAIR) / first, np.abs(deviations)
        constraints.append({"type": "ineq", "fun": lambda x: most - sizes @ x, "jac": lambda x: -sizes})
    bounds = [(width / first if pulse else 0.0, None) for pulse in on]
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
    if not np.all(np.isfinite(result.x)) or np.abs(missed(result.x)).max() > LANDED**0.5:
        return None
    return _landed(problem, levels, np.asarray(result.x) * first, scale)


def _missed(problem: Problem, levels: Reals, durations: Reals) -> Reals:
    to_go = np.append(np.cumsum(durations[::-1])[::-1], 0.0)
    table = problem.rows(to_go, 1)
    return (table[:, :-1] - table[:, 1:]) @ levels - problem.aimed(float(to_go[0]))


def _slope(problem: Problem, levels: Reals, durations: Reals) -> Reals:
    """Derivative of the moments by the durations: a longer piece shifts all jumps before it."""
    to_go = np.cumsum(durations[::-1])[::-1]
    jumps = np.diff(levels, prepend=0.0)
    drift = problem.aim(np.array([to_go[0]]))[1]
    return np.cumsum(problem.rows(to_go) * jumps, axis=1) - drift


def _landed(problem: Problem, levels: tuple[Fraction, ...], durations: Reals, scale: Reals) -> Pulsed | None:
    """The command without coasts that have vanished, its durations corrected until it lands to rounding."""
    kept: list[tuple[Fraction, float]] = []
    for level, duration in zip(levels, durations, strict=True):
        if level == 0 and duration <= VANISHED * durations.sum():
            continue
        if kept and kept[-1][0] == level:
            kept[-1] = level, kept[-1][1] + float(duration)
        else:
            kept.append((level, float(duration)))
    exact, times = tuple(level for level, _ in kept), np.array([duration for _, duration in kept])
    deviations, size = np.array([float(level) for level in exact]), problem.size
    if len(times) < size:
        return None
    width = float(problem.maneuver.limits.pulse_width or 0)
    for _ in range(STEPS):
        residual = _missed(problem, deviations, times) / scale
        change = np.linalg.lstsq(_slope(problem, deviations, times) / scale[:, None], residual, rcond=None)[0]
        times = np.asarray(times - change, dtype=np.float64)
        if not np.all(times > 0.0):
            return None
    tight = np.where(deviations != 0.0, width * (1.0 + HAIR / 4), 0.0)
    if np.abs(_missed(problem, deviations, times) / scale).max() > LANDED**1.3 or np.any(times < tight):
        return None
    starts = np.concatenate([[0.0], np.cumsum(times)[:-1]])
    return Pulsed(float(times.sum()), starts, tuple(problem.maneuver.rest + level for level in exact))
