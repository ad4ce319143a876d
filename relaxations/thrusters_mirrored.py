"""Thrusters whose pulses are their own mirror image about the middle of the move: fewer instants than equations may do then.

Two pulses one period of an undamped mode apart are the plainest: three instants, four equations. For every order of the pulses of the first
half its durations are the small program of `relaxations.thrusters` with the equations of `relaxations.mirrored`.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations import certificates
from relaxations.maneuvers import Problem
from relaxations.mirrored import half, parity
from relaxations.repair import pivots
from relaxations.sides import RADII
from relaxations.thrusters import HAIR, MORE, STRETCHED, VANISHED, Pulsed, landed, minimized, off, without_coasts
from relaxations.watching import Watch

Reals = NDArray[np.float64]

TINY = 1e-300
MANY = 6  # pulses in the first half, at most: their orders are 2^6


def mirrored_commands(problem: Problem, least: float) -> list[Pulsed]:
    """Admissible commands that are their own image, the shortest first; `least` [s] is a time that no command is shorter than."""
    if not (e := parity(problem)) or problem.maneuver.limits.held:
        return []
    own, found = half(problem), list[Pulsed]()
    for levels in _halves(problem, e):
        for stretch in STRETCHED:
            if (one := _searched(problem, own, levels, least / 2.0 * stretch)) is not None:
                exact, times = one
                whole = np.concatenate([times[:-1], [2.0 * times[-1]], times[-2::-1]])
                image = [problem.maneuver.rest + e * (level - problem.maneuver.rest) for level in exact[-2::-1]]
                starts = np.concatenate([[0.0], np.cumsum(whole)[:-1]])
                found.append(Pulsed(float(whole.sum()), starts, (*exact, *image), mirrored=True))
    return sorted(found, key=lambda one: one.maneuver_time)


def _searched(problem: Problem, own: Problem, levels: tuple[Fraction, ...], duration: float) -> tuple[tuple[Fraction, ...], Reals] | None:
    """Levels and durations of a first half, up to the middle, near this `duration` [s]; coasts that vanish are left out."""
    width, begin = float(problem.maneuver.limits.pulse_width or 0), np.zeros(0)
    while True:
        values = np.array([float(level - problem.maneuver.rest) for level in levels])
        wide = np.where(values != 0.0, width, 0.0) * (1.0 + HAIR)
        wide[-1] /= 2.0  # the first half of the piece in the middle
        if not len(begin):
            shares = np.where(values != 0.0, 3.0, 1.0)
            shares[-1] /= 2.0
            begin = max(duration, float(wide.sum())) * shares / shares.sum()
        durations = minimized(own, Watch.of(own), values, values != 0.0, np.maximum(begin, wide), wide)
        if durations is None or durations[-1] <= VANISHED * durations.sum():
            return None
        fewer = without_coasts(problem, levels, durations)
        if len(fewer[0]) == len(levels):
            times = landed(own, levels, durations, wide / (1.0 + HAIR))
            return None if times is None else (levels, times)
        levels, begin = fewer


def mirrored_witnesses(problem: Problem, found: Pulsed) -> Iterator[dict[str, Any]]:
    """Witnesses of such a command, one for each radius: as many of its duration and the starts of its first half as there are equations."""
    own, n = half(problem), len(found.starts)
    starts = found.starts[: n // 2 + 1]
    to_go, jumps = (
        found.maneuver_time / 2.0 - starts,
        np.diff([float(x - problem.maneuver.rest) for x in found.levels[: len(starts)]], prepend=0.0),
    )
    kicks = own.rows(to_go) * jumps
    columns = np.hstack([kicks.sum(axis=1, keepdims=True) / 2.0, -kicks[:, 1:]])
    names: list[list[Any]] = [["time", 0, 0], *(["start", i, 0] for i in range(1, len(starts)))]
    columns /= np.abs(columns).max(axis=1, keepdims=True) + TINY
    free = [names[i] for i in np.sort(pivots(columns)[: own.size])]
    for radius in RADII[2:]:
        length = found.maneuver_time
        yield certificates.command_witness(length, found.starts, found.levels, [], free, radius * length, mirrored=True)


def _halves(problem: Problem, e: int) -> Iterator[tuple[Fraction, ...]]:
    """Levels of the first half, up to the piece in the middle: a coast, or a pulse that is its own image."""
    limits, coast = problem.maneuver.limits, off(problem)
    if e < 0 and limits.upper - coast != coast - limits.lower:
        return
    size = half(problem).size
    signs = [level for level in (limits.upper, limits.lower) if level != coast]
    for count in range(size, size + MORE + 1):
        pulses = (count + 1) // 2
        total = 2 * pulses - count % 2
        if total > (limits.pulses or total) or pulses > MANY or (e < 0 and count % 2):
            continue
        for order in product(signs, repeat=pulses):
            yield tuple(level for pulse in order for level in (pulse, coast))[:count]
