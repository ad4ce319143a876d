"""Specified insensitivity: the shortest positive impulses whose residual vibration stays within a tolerance over bands of frequency.

On a grid of instants and of frequencies the least excess over the tolerances is a second-order cone program; the duration is the root of
that excess. Where the residual between frequencies, or the multipliers' function between instants, shows that a point is missing, it is
added (an exchange in both directions); Newton's method then gives exact instants (relaxations.shaping.polishing).

    F_i(A) = Σ A_k z_i(t_k),   z_i(t) = ((t - T)/τ)^j e^{κ_i ω_i (t - T)},   |F_i| ≤ V_i

with j = 0 for a tolerance, and V = 0, j = 0 … n at modes where n derivatives are to vanish exactly, in a unit τ of time. The multipliers
prove in balls that none is shorter (relaxations.checking.durations).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.checking.durations import Condition, none_as_short
from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bands import Band, exceeded, peaks, sampled_demands, touched, vertex
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.modes import Mode
from relaxations.shaping.polishing import FAINT, Demand, Extremal, apart, polished, rows, vanishing
from relaxations.shaping.sampled import few
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import VANISHED, left

Reals = NDArray[np.float64]

CELLS, PER_PERIOD = 160, 14  # instants of the first grid, at least, and for each period of the fastest frequency
MOST_BAND, WELL_DAMPED = 12.0, 0.3  # ends of a band: of wider ones with less damping programs take minutes
MOST_PERIODS = 100.0  # of the fastest mode in the slowest one's half period: more than the grid can tell apart
ROUNDS = 12  # of exchange
PROGRAMS = 40  # cone programs for one duration, at most
CLOSE = 1e-8  # excess at which a duration counts as found
MISSED = 1e-6  # relative excess between samples that calls for another one
SHORTER = (1e-8, 1e-6, 1e-4, 1e-3, 1e-2)  # relative: how far below the shortest duration the proof that none is shorter is tried
NOTHING = 1e-10  # what is left of a vibration of size 1 where it is to vanish
PLAIN = 20.0  # times the largest tolerance is what a program counts in, where that is less than 1
LONGER = 1e-6  # relative: by how much a grid's shaper is longer at first, and then twice as much
FEW = (1e-3, 1e-5, 0.0)  # weights on a grid that make an impulse, tried in turn
NEARLY_NONE = 1e-12  # amplitude of an impulse that does not matter
FINER = 400.0  # times finer than the slowest mode's own shaper are samples on which the last resort is looked for
ROUGH = 1e-5  # relative accuracy of a duration from which Newton's method goes on


@dataclass(frozen=True, slots=True)
class Shortest:
    """The shaper found, and `lower` [s]: no positive one that meets the demands is as short, *proven*; None if nothing was proven.

    `note`: what is to be known of it, where it is not the shortest.
    """

    shaper: Shaper
    lower: float | None
    note: str = ""


def specified(bands: Sequence[Band], zeros: Sequence[tuple[Mode, int]] = ()) -> Shortest:
    """The shortest positive shaper for `bands` and exact `zeros` (mode, derivatives), with the proof that none is shorter.

    Raises `ShaperError` without any demand, `SolverError` where the numerics fail.
    """
    if not bands and not zeros:
        raise ShaperError("nothing is asked of the shaper: name at least one band or mode")
    if len(zeros) > 1 and not bands and (serving := _serves_all(zeros)):
        return specified([], [serving])
    slowest = max([band.half_period for band in bands] + [mode.half_period * (count + 1) for mode, count in zeros])
    fastest = max([band.mode.frequency * band.high for band in bands] + [mode.frequency for mode, _ in zeros])
    if slowest * fastest > 2.0 * math.pi * MOST_PERIODS and not zeros:
        slowest = max(min(band.half_period, band.decayed) for band in bands)
    if slowest * fastest > 2.0 * math.pi * MOST_PERIODS:
        raise SolverError(
            f"the shaper would last {slowest * fastest / (2.0 * math.pi):.4g} periods of {fastest:.6g} rad/s, the fastest mode or band; "
            f"one solution is searched up to {MOST_PERIODS:g}; slow and fast modes apart are convolved"
        )
    if wide := [band for band in bands if band.high > MOST_BAND * band.low and band.damped[0] < WELL_DAMPED]:
        raise SolverError(
            f"a band from {wide[0].low:g} to {wide[0].high:g} is wider than is searched at dampings below {WELL_DAMPED:g}: ends that "
            f"differ by a factor of up to {MOST_BAND:g} are possible"
        )
    cells = max(CELLS, math.ceil(PER_PERIOD * slowest * fastest / (2.0 * math.pi)))
    demands = _vanishing(zeros, slowest)
    demands += sampled_demands(bands)
    search, exact = _Search(demands, tuple(bands), slowest, cells), None
    for _ in range(ROUNDS):
        search.find()
        exact = search.exact()
        if exact is not None or not search.exchange():
            break
    shaper = _shaper(exact.times, exact.amplitudes) if exact else search.coarse() if bands else None
    if shaper is None or not (bands or _vanishes(shaper, zeros)):
        shaper = _few(search, zeros, slowest / FINER)
    return Shortest(shaper, search.proven(exact))


def _vanishes(shaper: Shaper, zeros: Sequence[tuple[Mode, int]]) -> bool:
    return all(left(shaper, mode, count) <= VANISHED for mode, count in zeros)


def _few(search: _Search, zeros: Sequence[tuple[Mode, int]], step: float) -> Shaper:
    """Where Newton's method fails: the grid's shaper, or, where that leaves something or spreads, one on multiples of `step` [s].

    That one has no more impulses than equations, which are solved to rounding in units that modes of very different decay share.
    """
    try:
        spread = search.coarse()
    except SolverError:
        return few(zeros, step)[0]
    if len(spread.times) <= 2 * len(search.demands) + 1 and _vanishes(spread, zeros):
        return spread
    try:
        return few(zeros, step)[0]
    except SolverError:
        return spread


def _vanishing(zeros: Sequence[tuple[Mode, int]], unit: float) -> list[Demand]:
    return [Demand(mode.frequency, mode.damping, 0.0, power, unit) for mode, count in zeros for power in range(count + 1)]


def _serves_all(zeros: Sequence[tuple[Mode, int]]) -> tuple[Mode, int] | None:
    """The mode whose own shaper leaves nothing of the others either (ω and 3ω undamped): no search would find them independent."""
    for mode, count in zeros:
        shaper = derivative_shaper(mode, count)
        if _vanishes(shaper, zeros):
            return mode, count
    return None


def _shaper(times: Reals, amplitudes: Reals) -> Shaper:
    return Shaper(tuple(map(float, times)), tuple(map(float, amplitudes / amplitudes.sum())))


@dataclass
class _Search:
    """The state of the exchange: demands, bands, duration [s], instants beside the grid (fractions of the duration), the last solution."""

    demands: list[Demand]
    bands: tuple[Band, ...]
    duration: float
    cells: int = CELLS
    extra: list[float] = field(default_factory=list)
    solution: programs.ConeSolution | None = None

    def instants(self, duration: float) -> Reals:
        return duration * np.union1d(np.linspace(0.0, 1.0, self.cells + 1), self.extra)

    def solve(self, duration: float) -> programs.ConeSolution:
        return self.solve_on(self.instants(duration), duration)

    def solve_on(self, instants: Reals, duration: float) -> programs.ConeSolution:
        """In units in which small tolerances are not lost in the solver's own; the excess is in these units, too."""
        columns, radii = rows(self.demands, instants, duration), np.array([d.tolerance for d in self.demands])
        turned, unit = apart(self.demands, columns), min(1.0, PLAIN * float(radii.max())) if self.loose else 1.0
        found = programs.closest(turned @ columns / unit, radii / unit)
        return replace(found, sum=found.sum * unit, multipliers=turned.conj().T @ found.multipliers)

    @property
    def loose(self) -> bool:
        """Whether every demand has a tolerance; if not, the excess is never below 0."""
        return all(d.tolerance for d in self.demands)

    def find(self) -> None:
        """The duration at which the least excess becomes 0: secants, kept in a bracket; Newton's method will do the rest."""
        low, high, last = 0.0, math.inf, None
        for program in range(PROGRAMS):
            self.solution = self.solve(self.duration)
            excess = self.solution.excess
            low, high = (self.duration, high) if excess > CLOSE else (low, self.duration)
            if (self.loose and abs(excess) <= CLOSE) or high - low <= ROUGH * self.duration:
                self.duration = self.duration if self.loose else high
                return
            following = self.duration * (1.3 if excess > CLOSE else 0.8)
            if last is not None and last[1] != excess and (self.loose or min(excess, last[1]) > CLOSE):
                following = self.duration - excess * (self.duration - last[0]) / (excess - last[1])
                following += 0.0 if self.loose else 0.5 * ROUGH * following  # a hair beyond the root closes the bracket
            if math.isfinite(high) and (program > PROGRAMS // 3 or not low < following < high):
                following = (low + high) / 2
            last, self.duration = (self.duration, excess), following if following > low else 1.5 * self.duration
        raise SolverError(f"the shortest duration was not found in {PROGRAMS} programs; the last was {self.duration!r} s")

    def exchange(self) -> bool:
        """Add frequencies at which the residual exceeds its tolerance and instants at which the multipliers' function is too low."""
        assert self.solution is not None
        instants = self.instants(self.duration)
        over = exceeded(instants, self.solution.weights, self.bands, 1.0 + MISSED)
        fine = np.linspace(0.0, self.duration, 16 * self.cells + 1)
        course = (self.solution.multipliers.conj() @ rows(self.demands, fine, self.duration)).real
        dips = peaks(-course)
        low = [float(fine[i]) for i in dips if course[i] < self.solution.sum - MISSED]
        known = [t for t in low if np.abs(instants - t).min() > 1e-9 * self.duration]
        self.demands += over
        self.extra += [t / self.duration for t in known]
        return bool(over or known)

    def exact(self) -> Extremal | None:
        """What Newton's method makes of the grid's solution, if that holds for every instant and frequency."""
        assert self.solution is not None
        # A hair below the root the multipliers are unique also where there is no tolerance to tell them by.
        solution = self.solution if self.loose else self.solve(self.duration * (1.0 - 10.0 * ROUGH))
        times, amplitudes = self._impulses(solution)
        if len(times) < 2:
            return None
        demands, multipliers = self._touched(solution)
        found = polished(Extremal(times, amplitudes, tuple(demands), multipliers, 0.0)) if demands else None
        if found is not None and found.amplitudes.min() < FAINT:
            kept = found.amplitudes >= FAINT
            if kept[0] and kept[-1] and kept.sum() > 1:
                fewer = Extremal(found.times[kept], found.amplitudes[kept], found.demands, found.multipliers, 0.0)
                found = polished(fewer) or found
        return found if found is not None and found.amplitudes.min() > 0.0 and self._holds(found) else None

    def _impulses(self, solution: programs.ConeSolution) -> tuple[Reals, Reals]:
        """The weights of the grid belong to the minima of the multipliers' function; there are the impulses."""
        fine = np.linspace(0.0, self.duration, 16 * self.cells + 1)
        course = (solution.multipliers.conj() @ rows(self.demands, fine, self.duration)).real
        places = np.array([0.0, *(t for i in peaks(-course) if 0.0 < (t := vertex(fine, -course, int(i))) < self.duration), self.duration])
        nearest = np.abs(np.subtract.outer(self.instants(self.duration), places)).argmin(axis=1)
        sums = np.bincount(nearest, weights=solution.weights[: len(nearest)], minlength=len(places))
        kept = (sums > FAINT) | (np.arange(len(sums)) % (len(sums) - 1) == 0)
        return places[kept], np.maximum(sums[kept], FAINT)

    def _touched(self, solution: programs.ConeSolution) -> tuple[list[Demand], NDArray[np.complex128]]:
        """The demands with multipliers; those of a band belong to the maxima of the residual there, which move unless they are its ends."""
        chosen = [(d, y) for d, y in zip(self.demands, solution.multipliers, strict=True) if not d.tolerance]
        instants = self.instants(self.duration)
        chosen += touched(instants, solution.weights, self.bands, self.demands, solution.multipliers)
        multipliers = np.array([y for _, y in chosen], dtype=np.complex128)
        return [d for d, _ in chosen], (multipliers / max(float(np.abs(multipliers).sum()), 1e-300)).astype(np.complex128)

    def _holds(self, found: Extremal) -> bool:
        over = exceeded(found.times, found.amplitudes, self.bands, 1.0)
        everywhere = np.abs(rows(self.demands, found.times, float(found.times[-1])) @ found.amplitudes)
        return not over and all(size <= NOTHING for size, d in zip(everywhere, self.demands, strict=True) if not d.tolerance)

    def coarse(self) -> Shaper:
        """The grid's own solution, for where Newton's method fails: a hair longer, and exact zeros restored by least squares.

        With much damping the mode's own decay does more than a last impulse would: there its amplitude is next to nothing, and it says no
        more than when the residual is looked at.
        """
        for attempt in range(2 * ROUNDS):
            duration = self.duration * (1.0 + LONGER * 2.0**attempt)
            for _ in range(ROUNDS):
                times, weights = self._few(duration)
                over = [] if times is None else exceeded(times, weights, self.bands, 1.0)
                if times is not None and not over:
                    return _shaper(times, weights)
                if not over:
                    break
                self.demands += over
        raise SolverError("the grid's shaper does not hold between its instants and frequencies")

    def _few(self, duration: float) -> tuple[Reals | None, Reals]:
        """Instants, first and last among them, and weights of a grid's solution, on as few as it takes; no instants if it does not hold."""
        instants = self.instants(duration)
        solution = self.solve(duration)
        for least in FEW:
            kept = solution.weights >= least
            kept[[0, -1]] = True
            try:
                fewer = self.solve_on(instants[kept], duration) if least else solution
            except SolverError:
                continue
            if fewer.excess <= (0.0 if self.loose else CLOSE):
                weights = np.maximum(fewer.weights, NEARLY_NONE)
                exact = [d for d in self.demands if not d.tolerance]
                table = rows(exact, instants[kept], duration) if exact else np.zeros((0, len(weights)), dtype=np.complex128)
                equations = np.vstack([np.ones(len(weights)), table.real, table.imag])
                aim = np.eye(len(equations))[0]
                weights = weights + np.linalg.lstsq(equations, aim - equations @ weights, rcond=None)[0]
                if weights.min() > 0.0 and np.abs(equations @ weights - aim).max() <= 1e-11:
                    return instants[kept], weights
        return None, solution.weights

    def proven(self, exact: Extremal | None) -> float | None:
        """The longest duration [s] for which it is proven that no shaper is as short."""
        for shorter in SHORTER:
            duration = self.duration * (1.0 - shorter) if exact is None else float(exact.times[-1]) * (1.0 - shorter)
            found = polished(exact, duration) if exact else None
            if found is not None:
                demands, multipliers = found.demands, found.multipliers
            else:
                solution = self.solve(duration)
                demands, multipliers = tuple(self.demands), solution.multipliers
            pairs = [(d, complex(y)) for d, y in zip(demands, multipliers, strict=True)]
            conditions = [implied(self.bands, d, y) if d.tolerance else vanishing(d, y) for d, y in pairs]
            if none_as_short(Fraction(duration), conditions):
                return duration
        return None


def implied(bands: Sequence[Band], demand: Demand, weight: complex) -> Condition:
    """The demand as the bands imply it: a frequency and a damping within its own, and the whole tolerance."""
    band = bands[demand.band]
    where, damping = (min(max(at, low), high) for at, (low, high) in ((demand.frequency, band.ends), (demand.damping, band.damped)))
    tolerance = Fraction(repr(band.tolerance))
    return Condition(Fraction(where), Fraction(damping), tolerance, 0, (Fraction(weight.real), Fraction(weight.imag)))
