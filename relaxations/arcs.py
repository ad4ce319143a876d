"""Witnesses of commands of few pieces at given levels: which of their numbers are unknowns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from relaxations import certificates
from relaxations.certificates import Number, Numbers
from relaxations.maneuvers import Problem
from relaxations.repair import pivots
from relaxations.sides import RADII

SMALL = 1e-7
"""The finest of the radii times the equations' condition: the test contracts where that is small."""


def arc_witnesses(
    problem: Problem, levels: Sequence[Fraction], duration: Number, starts: Numbers, tail: Numbers
) -> Iterator[dict[str, Any]]:
    """Witnesses of a command of these absolute levels, one for each radius: as many unknowns as equations, the best conditioned.

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
