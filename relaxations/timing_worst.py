"""The worst that errors of at most δ in every instant of a move can leave, in ball arithmetic.

What is left, z = Σ_i a_i H(T - t_i - d_i), has one term for each instant (`relaxations.timing`). In a direction φ of the complex plane its
extent over |d_i| ≤ δ is therefore a sum of one-dimensional maxima,

    W(φ) = Σ_i max_{|d| ≤ δ} Re e^{-jφ} a_i H(T - t_i - d),

each enclosed by branch and bound: where the slope over a cell of d is proven not to change sign an end of the cell is best, elsewhere the
mean value theorem bounds it. Two directions suffice for a real motion. For a flexible one |z| ≤ max(W(φ), W(φ'))/cos((φ' - φ)/2) wherever
its phase lies between φ and φ', and sectors are halved until that is within `TIGHT` of what one choice of errors attains.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import acb, arb
from numpy.typing import NDArray

from relaxations.plants import precision
from relaxations.timing import Event, Motion, left

Reals = NDArray[np.float64]

BITS = 128
TIGHT = 1e-4  # relative distance of the bound from what is attained
FINE = 1e-7  # of an event's largest effect: how far its own maximum is enclosed
SECTORS, MOST_DIRECTIONS, MOST_CELLS = 8, 1024, 200


@dataclass(frozen=True, slots=True)
class Worst:
    """`attained` ≤ the worst ≤ `bound` (output units, as `Motion.size`, by magnitude), and the errors (n,) [s] that attain.

    The bound is proven for the linear plant and the instants as they are written; what is attained is computed in doubles.
    """

    attained: float
    bound: float
    errors: Reals


def worst(motion: Motion, happening: Sequence[Event], end: float, within: float) -> Worst:
    """The worst over |d_i| ≤ `within` [s]; `happening`, `end` as in `relaxations.timing.left`."""
    with precision(BITS):
        each = _Events(motion, happening, end, within)
        if not motion.flexible:
            sides = [each.extent(acb(sign)) for sign in (1, -1)]
            sizes = [(_size(motion, happening, end, errors), i) for i, (_, errors) in enumerate(sides)]
            attained, best = max(sizes)
            bound = max(_up(side) for side, _ in sides)
            return Worst(min(attained, bound), max(bound, 0.0), sides[best][1])
        return _turning(each, motion, happening, end)


def _turning(each: _Events, motion: Motion, happening: Sequence[Event], end: float) -> Worst:
    """Branch and bound over directions."""
    attained, errors, asked = -1.0, np.zeros(len(happening)), 0

    def look(angle: float) -> float:
        nonlocal attained, errors, asked
        asked += 1
        extent, found = each.extent(acb(0, -angle).exp())
        size = _size(motion, happening, end, found)
        if size > attained:
            attained, errors = size, found
        return max(_up(extent), 0.0)

    angles = [2.0 * math.pi * k / SECTORS for k in range(SECTORS + 1)]
    extents = [look(angle) for angle in angles[:-1]]
    extents.append(extents[0])
    queue = [_sector(*angles[k : k + 2], *extents[k : k + 2]) for k in range(SECTORS)]
    heapq.heapify(queue)
    while -queue[0][0] * motion.factor > attained * (1.0 + TIGHT) and asked < MOST_DIRECTIONS:
        _, low, high, left_extent, right_extent = heapq.heappop(queue)
        middle = (low + high) / 2
        extent = look(middle)
        heapq.heappush(queue, _sector(low, middle, left_extent, extent))
        heapq.heappush(queue, _sector(middle, high, extent, right_extent))
    bound = math.nextafter(-queue[0][0] * motion.factor, math.inf)
    return Worst(min(attained, bound), bound, errors)


def _sector(low: float, high: float, one: float, other: float) -> tuple[float, float, float, float, float]:
    """A sector with minus its bound first; the angles are exact as written, and the last one is the first turned by a hair less than 2π."""
    half = arb(high - low) / 2 + arb(0, 1e-14)
    return -_up(arb(max(one, other)) / half.cos()), low, high, one, other


def _up(ball: arb) -> float:
    """A double that is no less than any number of the ball."""
    return math.nextafter(float(ball.upper()), math.inf)


def _size(motion: Motion, happening: Sequence[Event], end: float, errors: Reals) -> float:
    return abs(float(motion.size(left(motion, happening, end, errors[None]))[0]))


class _Events:
    """The terms of z as balls."""

    def __init__(self, motion: Motion, happening: Sequence[Event], end: float, within: float) -> None:
        self.pole, self.chain = motion.balls
        self.offset, self.within = arb(motion.offset), within
        self.jumps = [arb(event.jump) for event in happening]
        self.to_go = [arb(end) - arb(event.instant) for event in happening]
        count = len(self.chain)
        self.slopes = tuple(self.pole * self.chain[k] + ((k + 1) * self.chain[k + 1] if k + 1 < count else 0) for k in range(count))
        self.fine = [  # against the steepest slope that the term has at all: at the end of the move that of a rigid body's place vanishes
            FINE * within * float(abs(jump * self._along(acb(1), self.slopes, to_go + arb(0, within), modulus=True)).upper())
            for jump, to_go in zip(self.jumps, self.to_go, strict=True)
        ]

    def extent(self, turn: acb) -> tuple[arb, Reals]:
        """W in the direction whose conjugate unit number is `turn`, and the errors that nearly reach it."""
        total = -(turn * self.offset).real
        errors = np.zeros(len(self.jumps))
        for i, (jump, to_go, fine) in enumerate(zip(self.jumps, self.to_go, self.fine, strict=True)):
            value, errors[i] = self._largest(turn * jump, to_go, fine)
            total += value
        return total, errors

    def _along(self, turn: acb, coefficients: Sequence[acb], to_go: arb, *, modulus: bool = False) -> arb:
        total = acb(0)
        for coefficient in reversed(coefficients):
            total = total * to_go + coefficient
        value = turn * total * (self.pole * to_go).exp()
        return abs(value) if modulus else value.real

    def _largest(self, turn: acb, to_go: arb, fine: float) -> tuple[arb, float]:
        """An upper bound of the maximum of Re turn H(to_go - d) over |d| ≤ within, and a d near it."""
        ends = {d: self._along(turn, self.chain, to_go - arb(d)) for d in (-self.within, self.within)}
        best, at = max((float(value.mid()), d) for d, value in ends.items())
        top = ends[-self.within].max(ends[self.within])  # of what is settled
        cells, looked = [(-self.within, self.within)], 0
        while cells:
            low, high = cells.pop()
            middle = (low + high) / 2
            half = max(high - middle, middle - low)
            slope = self._along(turn, self.slopes, to_go - arb(middle, half))
            looked += 1
            if not slope.contains(0):  # the best of the cell is at one of its ends, which neighbours or the table hold
                for d in (low, high):
                    if d not in ends:
                        ends[d] = self._along(turn, self.chain, to_go - arb(d))
                        top = top.max(ends[d])
                        best, at = max((best, at), (float(ends[d].mid()), d))
                continue
            value = self._along(turn, self.chain, to_go - arb(middle))
            best, at = max((best, at), (float(value.mid()), middle))
            bound = value + abs(slope) * arb(half)
            if float(bound.upper()) <= best + fine or looked >= MOST_CELLS:
                top = top.max(bound)
            else:
                cells += [(low, middle), (middle, high)]
        return top, at
