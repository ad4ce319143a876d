"""Pulses one way, then the other: the sign of the input changes once. For a fixed instant of the change the commands are a convex set.

What instant is the best is a search in one dimension, and what refutes all of them is a costate λ(r) for every time to go r of the change.
Between two nodes a < b of r, λ and the price μ are interpolated linearly. Outside of [a, b] the integrand of Φ (`relaxations.onoff.duals`)
is convex in λ, so what it comes to is largest at a node; inside it is E ∫_r^b max(0, e p - μ) + L ∫_a^r max(0, -e p - μ). The smallest of

    one way     E w/4 (max e p_b - min e p_a)    if -e p ≤ μ on [a, b] at both nodes: thrust against it would not pay; parts beyond μ
                                                 alone count (and mirrored: L w/4 (max of node a - min of node b))
    falling     max(E, L) V²/2m    if μ = 0 and e p falls at least as steeply as m at both nodes, and |p_r(r)| ≤ V = max(|p_a(a)|,
                                   |p_b(b)|) + w/4 |p_a'(a) - p_b'(b)| + w²/8 max |p''|, w = b - a
    any         w (E max(0, max e p - μ) + L max(0, max -e p - μ))    of the node where it is larger

is by how much Φ at any r between may exceed the larger one of the two nodes, so that no command of the family takes T or less if
everywhere `λᵀ target - μ fuel - Φ` of the nodes is more. That excess is of the order w² at least, of w⁴ where the change may be
anywhere in a coast, and 0 where the fuel's price makes a dead zone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import ShortHorizonError, SolverError
from relaxations.maneuvers import Problem
from relaxations.onoff.duals import Dual, Looks, Windows, evaluated, largest_fraction, settled

Reals = NDArray[np.float64]

SCANNED = 13  # times to go of the change at which a search begins
CLOSE = 1e-9  # of the duration: how well the best change is searched
TOLERANCE = 2e-14  # of α at which the duration is found
ROUNDS, LONGER = 60, 1.5
LONGEST = 1e4  # times the duration of the fastest command of all: a family that cannot do it until then is said to have no command
SHARE = 0.4  # of the slack that the windows between nodes may use up
FIRST, GROWN, LEAST = 1 / 16, 2.0, 1e-6  # widths between nodes, of the duration
MOST_NODES = 1200
KNOWN = 3e-13  # of 1: what is less than that is rounding
SAMPLES = 7  # of a costate between two nodes


@dataclass(frozen=True, slots=True)
class Node:
    """λ (size,) of the moments and the fuel's price μ where the change is at time to go `at` [s]."""

    at: float
    costate: Reals
    price: float


@dataclass(frozen=True, slots=True)
class Fastest:
    """The shortest command that was found of a family: its looks, and the dual of its change."""

    looks: Looks
    dual: Dual

    @property
    def maneuver_time(self) -> float:
        """T [s]."""
        return self.looks.maneuver_time


def fastest(problem: Problem, along: int, near: float) -> Fastest | None:
    """The shortest command whose first pulses are along ±1, searched from a time [s] that none is shorter than; None if there is none."""
    time, low, high = near, 0.0, np.inf
    best: Dual | None = None
    looks: Looks | None = None
    for round_ in range(ROUNDS):
        try:
            looks = Looks.of(problem, time, along)
        except ShortHorizonError:
            low, time = time, LONGER * time
            continue
        best = _best(looks, best if round_ and np.isfinite(high) else None)
        off = best.value - 1.0
        if abs(off) <= TOLERANCE:
            break
        low, high = (low, time) if off > 0.0 else (time, high)
        end = along * float(best.costate @ looks.rows(np.array([time]))[:, 0]) - best.price
        slope = looks.strong * max(end, 0.0)
        following = time - off / slope if slope > 0.0 else LONGER * time
        following = min(following, LONGER * time)
        if not low < following < high:
            following = (low + high) / 2
        if following == time or (np.isfinite(high) and high - low <= 4e-16 * high):
            break
        if following > LONGEST * near:
            return None
        time = following
    return None if best is None or looks is None else Fastest(looks, best)


def _best(looks: Looks, known: Dual | None) -> Dual:
    """The dual of the change at which the largest fraction is reached: near a known one, or by a scan."""
    problem, end = looks.problem, looks.maneuver_time

    def at(place: float, start: Dual | None) -> Dual:
        return largest_fraction(looks, Windows(place, place), problem.fuel, start)

    if known is not None:
        low, high, best = *_around(known.windows.early, end), at(known.windows.early, known)
    else:
        places = np.linspace(0.0, end, SCANNED + 2)[1:-1]
        duals: list[Dual] = []
        for place in places:
            duals.append(at(float(place), duals[-1] if duals else None))
        k = int(np.argmax([dual.value for dual in duals]))
        best, low, high = duals[k], float(np.append(places, end)[k + 1]), float(np.append(0.0, places)[k])
        low, high = high, low
    # dα/dr = L max(0, -e p(r) - μ) - E max(0, e p(r) - μ): its sign brackets the best change.
    for _ in range(ROUNDS):
        place = best.windows.early
        p = looks.along * float(best.costate @ looks.rows(np.array([place]))[:, 0])
        rise = looks.weak * max(-p - best.price, 0.0) - looks.strong * max(p - best.price, 0.0)
        if rise == 0.0 or high - low <= CLOSE * end:
            break
        low, high = (place, high) if rise > 0.0 else (low, place)
        other = at((low + high) / 2, best)
        if other.value < best.value and abs(rise) * (high - low) <= KNOWN:
            break
        best = other
    return best


def _around(place: float, end: float) -> tuple[float, float]:
    return max(place - end / SCANNED, 0.0), min(place + end / SCANNED, end)


def cover(looks: Looks, best: Dual | None = None) -> list[Node] | Dual:
    """Nodes that refute every command of the family of at most this duration; or the dual of a change that reaches the whole target."""
    problem, end = looks.problem, looks.maneuver_time

    def solved(place: float, start: Dual | None) -> Dual:
        return largest_fraction(looks, Windows(place, place), problem.fuel, start)

    one = solved(0.0, None)
    if one.value >= 1.0 - KNOWN:
        return one
    nodes, width = [one], FIRST * end
    while one.windows.early < end:
        place = min(one.windows.early + width, end)
        other = solved(place, one)
        if other.value >= 1.0 - KNOWN and settled(looks, other, problem.fuel):
            return other
        # Where the best costate jumps, at the edge of a coast, that of either node serves for both.
        later, sooner = _moved(looks, other, one.windows), _moved(looks, one, other.windows)
        steps = next((way for way in ([one, other], [one, later, other], [one, sooner]) if _all_refuted(looks, way)), None)
        if steps is not None:
            nodes += steps[1:]
            one, width = steps[-1], min(GROWN * width, FIRST * end)
            continue
        width /= 2
        if width < LEAST * end or len(nodes) > MOST_NODES:
            raise SolverError("the windows between changes of sign cannot be closed")
    return [Node(dual.windows.early, looks.modal(dual.costate), dual.price) for dual in nodes]


def _moved(looks: Looks, dual: Dual, windows: Windows) -> Dual:
    """The same costate for another change of sign."""
    return evaluated(looks, windows, dual.costate, dual.price, looks.problem.fuel or 0.0)


def _all_refuted(looks: Looks, duals: list[Dual]) -> bool:
    return all(_refuted(looks, one, other) for one, other in pairwise(duals) if other.windows.early > one.windows.early) and (
        duals[-1].value < 1.0 - KNOWN
    )


def _refuted(looks: Looks, one: Dual, other: Dual) -> bool:
    """Whether two nodes refute all changes between them, in floating point."""
    least = 1.0 - max(one.value, other.value)
    if least <= KNOWN:
        return False
    a, b, e = one.windows.early, other.windows.early, looks.along
    table = looks.rows(np.linspace(a, b, SAMPLES))
    p = [e * (dual.costate @ table) for dual in (one, other)]
    over, under = ([np.maximum(side * values - dual.price, 0.0) for values, dual in zip(p, (one, other), strict=True)] for side in (1, -1))
    w, excess = b - a, np.inf
    if not np.any(under):
        excess = looks.strong * w / 4 * max(float(over[1].max() - over[0].min()), 0.0)
    elif not np.any(over):
        excess = looks.weak * w / 4 * max(float(under[0].max() - under[1].min()), 0.0)
    elif one.price == other.price == 0.0:
        powers = looks.slope, looks.slope @ looks.slope
        slopes, bends = ([e * (power @ dual.costate @ table) for dual in (one, other)] for power in powers)
        steep = -max(float(slope.max()) for slope in slopes)
        if steep > 0.0:
            off = max(abs(float(p[0][0])), abs(float(p[1][-1]))) + w / 4 * abs(float(slopes[0][0] - slopes[1][-1]))
            off += w * w / 8 * max(float(np.abs(bend).max()) for bend in bends)
            excess = max(looks.strong, looks.weak) * off * off / (2 * steep)
    mixed = max(looks.strong * float(above.max()) + looks.weak * float(below.max()) for above, below in zip(over, under, strict=True)) * w
    return min(excess, mixed) <= SHARE * least
