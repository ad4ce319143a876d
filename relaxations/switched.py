"""Commands of given levels and of switch times that are unknown: what is proposed to the checker of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from relaxations import certificates
from relaxations.certificates import Number, Numbers
from relaxations.commands import Command, Segment, Tail
from relaxations.maneuvers import Problem
from relaxations.repair import pivots
from relaxations.sides import RADII, Proof, Side, accepted, rounded
from relaxations.thrusters import Pulsed

SMALL = 1e-7
"""The finest of the radii times the equations' condition: the test contracts where that is small."""


def thrust(problem: Problem, task: dict[str, Any], found: Pulsed) -> Proof | None:
    """The upper side of a command of pulses."""
    for witness in witnesses(problem, found.levels, found.maneuver_time, found.starts, np.zeros(0)):
        for margin in (1e-14, 1e-13, 1e-12):
            side = Side(Fraction(found.maneuver_time * (1.0 + margin)), witness)
            if accepted(task, upper=side):
                segments = tuple(Segment(float(start), float(level)) for start, level in zip(found.starts, found.levels, strict=True))
                command = Command(rounded(side.claim, np.inf), segments, Tail(problem.absolute(problem.hold)))
                return Proof(None, side, command, len(segments) - 1)
    return None


def witnesses(problem: Problem, levels: Sequence[Fraction], duration: Number, starts: Numbers, tail: Numbers) -> Iterator[dict[str, Any]]:
    """Witnesses of a command of these absolute levels, one for each radius: as many unknowns as equations, the best conditioned ones.

    At an extremal the switches alone are singular, so the duration is one of them, or a tail coefficient where the tail touches a limit.
    """
    count, size = len(starts), problem.size
    if count + problem.tail.size < size:
        return  # a degenerate optimum: fewer unknowns than equations
    names: list[list[Any]] = [["time", 0, 0], *(["start", i, 0] for i in range(1, count)), *certificates.tail_unknowns(problem)]
    jumps = np.diff([float(level - problem.maneuver.rest) for level in levels], prepend=0.0)
    to_go = np.array([float(duration) - float(start) for start in starts])
    slopes = float(duration) * problem.rows(to_go) * jumps
    largest = max((abs(float(c)) for c in tail), default=0.0) or 1.0
    drift = float(duration) * problem.aim(np.array([float(duration)]))[1]
    columns = np.hstack([slopes.sum(axis=1, keepdims=True) - drift, slopes[:, 1:], -problem.tail.columns * largest])
    sizes = np.abs(columns).max(axis=1)
    if not (sizes > 0).all() or not np.isfinite(sizes).all():
        return  # moments beyond what doubles hold: e^{ps} of a fast pole is 0 where it would count
    columns /= sizes[:, None]
    free = [names[i] for i in np.sort(pivots(columns)[:size])]
    finest = min(RADII[0], SMALL / problem.frame.condition) if problem.frame else RADII[0]
    for radius in (finest, *RADII[1:]) if isinstance(duration, Fraction) else RADII[2:]:
        chains = certificates.tail_chains(problem, tail)
        yield certificates.command_witness(duration, starts, levels, chains, free, radius * float(duration))
