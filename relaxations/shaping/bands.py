"""Boxes of a mode's frequency and damping over which a residual stays within a tolerance, and where in them it is largest.

`F = Σ A_i e^{p(t_i - T)}` is an entire function of p = κω = ω(ζ + j√(1 - ζ²)), in polar coordinates a box of frequency and damping. By the
maximum principle |F| is largest on its boundary: to keep a tolerance on the edges is to keep it in the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import ShaperError
from relaxations.shaping.modes import Mode
from relaxations.shaping.polishing import DAMPING, FREQUENCY, Demand, rows

Reals = NDArray[np.float64]

BROADEST = 1000.0  # ends of a band: the shaper lasts half a period of the lower one
SAMPLES = 9  # places on an edge at first
LOOKS, PER_PERIOD = 200, 100  # places on an edge that are looked at, and more for each period of phase along it
TOP_LOOKS = 2001
NEAR, CLOSER = 0.99, 201  # of a tolerance; places between the neighbours of a maximum so near it
INSIDE = 1e-9  # of a tolerance: how far below it a shaper is designed, so that its claim can be proven
TOUCHING = 1e-6  # of the sum of the multipliers: a demand with less does not count


@dataclass(frozen=True, slots=True)
class Band:
    """Natural frequencies from `low` to `high` times that of `mode`, on which the residual is at most `tolerance`; at the mode's damping,
    or over the `dampings` given.
    """

    mode: Mode
    low: float
    high: float
    tolerance: float
    dampings: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        wrong = []
        if not 0.0 < self.low <= self.high < math.inf:
            wrong.append(f"a band goes from a factor above 0 to one that is no smaller, not from {self.low!r} to {self.high!r}")
        elif self.high > BROADEST * self.low:
            wrong.append(f"a band's ends differ by a factor of at most {BROADEST:g}, not from {self.low!r} to {self.high!r}")
        if not 0.0 < self.tolerance < 1.0:
            wrong.append(f"a tolerance is a fraction of the unshaped vibration between 0 and 1, not {self.tolerance!r}")
        if self.dampings and not 0.0 <= self.dampings[0] <= self.dampings[1] < 1.0:
            wrong.append(f"damping ratios go from at least 0 to less than 1, not from {self.dampings[0]!r} to {self.dampings[1]!r}")
        if wrong:
            raise ShaperError("; ".join(wrong))

    @property
    def ends(self) -> tuple[float, float]:
        """The lowest and the highest frequency [rad/s], no farther out than the exact products."""
        low, high = (Fraction(repr(factor)) * Fraction(repr(self.mode.frequency)) for factor in (self.low, self.high))
        return _inward(low, high)

    @property
    def damped(self) -> tuple[float, float]:
        """The least and the largest damping ratio, no farther out than the decimals."""
        if self.dampings is None:
            return self.mode.damping, self.mode.damping
        low, high = self.dampings
        return _inward(Fraction(repr(low)), Fraction(repr(high)))

    @property
    def half_period(self) -> float:
        """That of the lowest frequency at the least damping, damped [s]."""
        return math.pi / (self.ends[0] * math.sqrt(1.0 - self.damped[0] ** 2))

    @property
    def decayed(self) -> float:
        """When the slowest decay has done what the tolerance asks for, and one impulse is enough [s]; infinite without damping."""
        rate = self.damped[0] * self.ends[0]
        return -math.log(self.tolerance) / rate if rate else math.inf

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The boundary of the box."""
        (low, high), (least, most) = self.ends, self.damped
        along = [Edge(FREQUENCY, damping, low, high) for damping in sorted({least, most})]
        across = [Edge(DAMPING, frequency, least, most) for frequency in sorted({low, high})] if least < most else []
        return tuple(across if low == high and across else [*along, *across])


def _inward(low: Fraction, high: Fraction) -> tuple[float, float]:
    first, last = float(low), float(high)
    last = last if Fraction(last) <= high else math.nextafter(last, 0.0)
    return min(first if Fraction(first) >= low else math.nextafter(first, math.inf), last), last


@dataclass(frozen=True, slots=True)
class Edge:
    """Along `frequency` [rad/s] or `damping` from `low` to `high`, the other of both being `fixed`."""

    along: str
    fixed: float
    low: float
    high: float

    def demand(self, at: float, tolerance: float, band: int) -> Demand:
        """That of one place."""
        place = min(max(at, self.low), self.high)
        frequency, damping = (place, self.fixed) if self.along == FREQUENCY else (self.fixed, place)
        return Demand(frequency, damping, tolerance, band=band, inner=self.along if self.low < place < self.high else "")

    def holds(self, demand: Demand) -> bool:
        """Whether a demand is on it."""
        fixed, at = (demand.damping, demand.frequency) if self.along == FREQUENCY else (demand.frequency, demand.damping)
        return fixed == self.fixed and self.low <= at <= self.high

    def place(self, demand: Demand) -> float:
        """Where it is."""
        return demand.frequency if self.along == FREQUENCY else demand.damping

    def course(self, times: Reals, amplitudes: Reals, looks: int) -> tuple[Reals, Reals]:
        """Places, and the residual there."""
        places = np.linspace(self.low, self.high, looks) if self.high > self.low else np.array([self.low])
        demands = [self.demand(float(place), 1.0, 0) for place in places]
        kept = np.asarray(amplitudes) != 0.0
        return places, np.abs(rows(demands, times[kept], float(times[-1])) @ amplitudes[kept])

    def looks(self, duration: float) -> int:
        """How many places tell all of its maxima."""
        turned = self.high - self.low if self.along == FREQUENCY else self.fixed * (math.acos(self.low) - math.acos(self.high))
        return LOOKS + int(PER_PERIOD * duration * turned / (2 * math.pi))


def sampled_demands(bands: Sequence[Band]) -> list[Demand]:
    """The first places that are looked at: Chebyshev's on each edge, its ends among them."""
    found: dict[Demand, None] = {}
    for number, band in enumerate(bands):
        for edge in band.edges:
            at = np.cos(np.linspace(np.pi, 0.0, SAMPLES)) * (edge.high - edge.low) / 2 + (edge.high + edge.low) / 2
            for place in np.unique(at):
                demand = edge.demand(float(place), band.tolerance * (1.0 - INSIDE), number)
                found[replace(demand, inner="")] = None
    return list(found)


def exceeded(times: Reals, amplitudes: Reals, bands: Sequence[Band], factor: float) -> list[Demand]:
    """Where on the edges the residual has a local maximum above `factor` times the tolerance.

    About every maximum of the places that is near it there is a closer look: between two places it may be higher.
    """
    found: dict[Demand, None] = {}
    for number, band in enumerate(bands):
        level = factor * band.tolerance
        for edge in band.edges:
            places, course = edge.course(times, amplitudes, edge.looks(float(np.ptp(times))))
            for i in peaks(course):
                if course[i] > NEAR * level:
                    around = replace(edge, low=float(places[max(i - 1, 0)]), high=float(places[min(i + 1, len(places) - 1)]))
                    closely, heights = around.course(times, amplitudes, CLOSER)
                    if heights.max() > level:
                        place = float(closely[heights.argmax()])
                        found[replace(edge.demand(place, band.tolerance * (1.0 - INSIDE), number), inner="")] = None
    return list(found)


def touched(
    times: Reals, amplitudes: Reals, bands: Sequence[Band], demands: Sequence[Demand], multipliers: NDArray[np.complex128]
) -> list[tuple[Demand, complex]]:
    """The maxima of the residual on the edges that multipliers belong to, with their sums; maxima inside an edge move."""
    chosen: dict[Demand, complex] = {}
    for number, band in enumerate(bands):
        own = [(d, y) for d, y in zip(demands, multipliers, strict=True) if d.band == number]
        for edge in band.edges:
            mine = [(d, y) for d, y in own if edge.holds(d)]
            own = [(d, y) for d, y in own if not edge.holds(d)]  # a corner is counted once
            places, course = edge.course(times, amplitudes, TOP_LOOKS)
            tops = np.array([min(max(vertex(places, course, int(i)), edge.low), edge.high) for i in peaks(course)])
            nearest = [int(np.abs(tops - edge.place(d)).argmin()) for d, _ in mine]
            for place, top in enumerate(tops):
                weight = sum((y for (_, y), near in zip(mine, nearest, strict=True) if near == place), 0j)
                if abs(weight) > TOUCHING:
                    demand = edge.demand(float(top), mine[0][0].tolerance, number)
                    chosen[demand] = chosen.get(demand, 0j) + weight
    return list(chosen.items())


def peaks(course: Reals) -> NDArray[np.intp]:
    """Local maxima, the ends included."""
    padded = np.concatenate([[-np.inf], course, [-np.inf]])
    return np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))


def vertex(x: Reals, y: Reals, i: int) -> float:
    """The top of the parabola through a sample and its neighbours (an end is its own)."""
    if i in (0, len(x) - 1):
        return float(x[i])
    rise, fall = y[i] - y[i - 1], y[i] - y[i + 1]
    return float(x[i] + (x[i + 1] - x[i]) * (rise - fall) / (2.0 * (rise + fall))) if rise + fall > 0.0 else float(x[i])
