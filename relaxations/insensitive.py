"""Specified insensitivity: the shortest positive impulses whose residual vibration stays within a tolerance over bands of frequency.

On a grid of instants and of frequencies the least excess over the tolerances is a second-order cone program; the duration is the root of
that excess. Where the residual between frequencies, or the multipliers' function between instants, shows that a point is missing, it is
added (an exchange in both directions), and the instants are then refined as a nonlinear program in the few impulses that are left.

    F_i(A) = Σ A_k z_i(t_k),   z_i(t) = (ω_i(t - T))^j e^{κ_i ω_i (t - T)},   |F_i| ≤ V_i

with j = 0 for a tolerance, and V = 0, j = 0 … n at modes where n derivatives are to vanish exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from relaxations import programs
from relaxations.errors import ShaperError, SolverError
from relaxations.sensitivity import residual
from relaxations.shaper_modes import Mode
from relaxations.shapers import Shaper

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

CELLS = 160  # instants of the first grid
SAMPLES = 9  # frequencies of a band at first
ROUNDS = 12  # of exchange
PROGRAMS = 40  # cone programs for one duration, at most
CLOSE = 1e-9  # excess at which a duration counts as found
INSIDE = 1e-9  # of a tolerance: how far below it a shaper is designed, so that its claim can be proven
MISSED = 1e-6  # relative excess between samples that calls for another one
SHORTER = 1e-6  # relative: how far below the shortest duration the proof that none is shorter is made


@dataclass(frozen=True, slots=True)
class Band:
    """Natural frequencies from `low` to `high` times that of `mode`, at its damping, on which the residual is at most `tolerance`."""

    mode: Mode
    low: float
    high: float
    tolerance: float

    def __post_init__(self) -> None:
        wrong = []
        if not 0.0 < self.low <= self.high < math.inf:
            wrong.append(f"a band goes from a factor above 0 to one that is no smaller, not from {self.low!r} to {self.high!r}")
        if not 0.0 < self.tolerance < 1.0:
            wrong.append(f"a tolerance is a fraction of the unshaped vibration between 0 and 1, not {self.tolerance!r}")
        if wrong:
            raise ShaperError("; ".join(wrong))


@dataclass(frozen=True, slots=True)
class Demand:
    """One condition: at natural `frequency` [rad/s] and `damping` derivative number `power` is at most `tolerance` (0: vanishes)."""

    frequency: float
    damping: float
    tolerance: float
    power: int = 0


@dataclass(frozen=True, slots=True)
class Multipliers:
    """Why no shaper is as short as `duration` [s]: complex weights of `demands`, to be proven (`relaxations.checking.durations`)."""

    duration: float
    demands: tuple[Demand, ...]
    weights: tuple[complex, ...]


def specified(bands: Sequence[Band], zeros: Sequence[tuple[Mode, int]] = ()) -> tuple[Shaper, Multipliers]:
    """The shortest positive shaper for `bands` and exact `zeros` (mode, derivatives), and what its least duration rests on.

    Raises `ShaperError` without any demand, `SolverError` where the numerics fail.
    """
    if not bands and not zeros:
        raise ShaperError("nothing is asked of the shaper: name at least one band or mode")
    demands = [Demand(mode.frequency, mode.damping, 0.0, power) for mode, count in zeros for power in range(count + 1)]
    for band in bands:
        at = np.cos(np.linspace(np.pi, 0.0, SAMPLES)) * (band.high - band.low) / 2 + (band.high + band.low) / 2
        inside = band.tolerance * (1.0 - INSIDE)
        demands += [Demand(float(f) * band.mode.frequency, band.mode.damping, inside) for f in np.unique(at)]
    search = _Search(list(demands), [], _guess(bands, zeros))
    for _ in range(ROUNDS):
        search.find()
        if not search.exchange(bands):
            break
    shaper = search.refined(bands)
    return shaper, search.multipliers()


def _guess(bands: Sequence[Band], zeros: Sequence[tuple[Mode, int]]) -> float:
    """Half a period of the slowest demand [s]: a first duration of the right order."""
    slowest = [band.mode.half_period / band.low for band in bands] + [mode.half_period for mode, _ in zeros]
    return max(slowest)


def rows(demands: Sequence[Demand], instants: Reals, duration: float) -> Complexes:
    """z_i(t): shape (demands, instants)."""
    omega = np.array([d.frequency for d in demands])
    kappa = np.array([complex(d.damping, math.sqrt(1.0 - d.damping**2)) for d in demands])
    power = np.array([d.power for d in demands])[:, None]
    since = np.multiply.outer(omega, instants - duration)
    return (since**power * np.exp(kappa[:, None] * since)).astype(np.complex128)


@dataclass
class _Search:
    """The state of the exchange: demands, instants beside the grid (fractions of the duration), duration [s], the last solution."""

    demands: list[Demand]
    extra: list[float]
    duration: float
    solution: programs.ConeSolution | None = None

    def instants(self, duration: float) -> Reals:
        return duration * np.union1d(np.linspace(0.0, 1.0, CELLS + 1), self.extra)

    def solve(self, duration: float) -> programs.ConeSolution:
        return programs.closest(rows(self.demands, self.instants(duration), duration), np.array([d.tolerance for d in self.demands]))

    def find(self) -> None:
        """The duration at which the least excess becomes 0: secants, kept in a bracket."""
        low, high, last = 0.0, math.inf, None
        for _ in range(PROGRAMS):
            self.solution = self.solve(self.duration)
            excess = self.solution.excess
            low, high = (self.duration, high) if excess > 0.0 else (low, self.duration)
            if abs(excess) <= CLOSE or high - low <= 1e-10 * self.duration:
                return
            step = 1.3 if math.isinf(high) else 0.9
            following = self.duration * (step if excess > 0.0 else 0.8)
            if last is not None and last[1] != excess:
                following = self.duration - excess * (self.duration - last[0]) / (excess - last[1])
            if not low < following < high:
                following = (low + high) / 2 if math.isfinite(high) else 1.5 * self.duration
            last, self.duration = (self.duration, excess), following
        raise SolverError(f"the shortest duration was not found in {PROGRAMS} programs; the last was {self.duration!r} s")

    def exchange(self, bands: Sequence[Band]) -> bool:
        """Add frequencies at which the residual exceeds its tolerance and instants at which the multipliers' function is too low."""
        assert self.solution is not None
        instants = self.instants(self.duration)
        over = exceeded(instants, self.solution.weights, bands, 1.0 + MISSED)
        fine = np.linspace(0.0, self.duration, 16 * CELLS + 1)
        course = (self.solution.multipliers.conj() @ rows(self.demands, fine, self.duration)).real
        dips = _peaks(-course)
        low = [float(fine[i]) for i in dips if course[i] < self.solution.sum - MISSED]
        self.demands += over
        self.extra += [t / self.duration for t in low if np.abs(instants - t).min() > 1e-9 * self.duration]
        return bool(over or low)

    def multipliers(self) -> Multipliers:
        """What proves, a hair below the duration found, that none is shorter."""
        duration = self.duration * (1.0 - SHORTER)
        solution = self.solve(duration)
        return Multipliers(duration, tuple(self.demands), tuple(complex(y) for y in solution.multipliers))

    def refined(self, bands: Sequence[Band]) -> Shaper:
        """The few impulses that are left, their instants and amplitudes as a nonlinear program: least duration, same demands."""
        assert self.solution is not None
        times, amplitudes = _merged(self.instants(self.duration), self.solution.weights, 2.5 * self.duration / CELLS)
        demands = list(self.demands)
        for _ in range(ROUNDS):
            found = _shortest(times, amplitudes, demands)
            if found is None:
                raise SolverError("the instants of the shortest shaper could not be refined from the grid")
            times, amplitudes = found
            over = exceeded(times, amplitudes, bands, 1.0)
            if not over:
                break
            demands += over
        amplitudes = amplitudes / amplitudes.sum()
        return Shaper(tuple(map(float, times)), tuple(map(float, amplitudes)))


def exceeded(times: Reals, amplitudes: Reals, bands: Sequence[Band], factor: float) -> list[Demand]:
    """Where in the bands the residual has a local maximum above `factor` times the tolerance."""
    found = []
    for band in bands:
        periods = float(np.ptp(times)) * band.mode.frequency * (band.high - band.low) / (2 * np.pi)
        omega = band.mode.frequency * np.linspace(band.low, band.high, 200 + int(100 * periods))
        course = residual(times, amplitudes, omega, band.mode.damping)
        at = [i for i in _peaks(course) if course[i] > factor * band.tolerance]
        for i in at:
            place = _vertex(omega, course, int(i))
            found.append(Demand(place, band.mode.damping, band.tolerance * (1.0 - INSIDE)))
    return found


def _peaks(course: Reals) -> NDArray[np.intp]:
    """Local maxima, the ends included."""
    padded = np.concatenate([[-np.inf], course, [-np.inf]])
    return np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))


def _vertex(x: Reals, y: Reals, i: int) -> float:
    """The top of the parabola through a sample and its neighbours (an end is its own)."""
    if i in (0, len(x) - 1):
        return float(x[i])
    rise, fall = y[i] - y[i - 1], y[i] - y[i + 1]
    return float(x[i] + (x[i + 1] - x[i]) * (rise - fall) / (2.0 * (rise + fall))) if rise + fall > 0.0 else float(x[i])


def _merged(instants: Reals, weights: Reals, near: float) -> tuple[Reals, Reals]:
    """Neighbouring instants of the grid with weight are one impulse at their centre."""
    kept = np.flatnonzero(weights > 1e-6)
    groups = np.split(kept, np.flatnonzero(np.diff(instants[kept]) > near) + 1)
    sums = np.array([weights[group].sum() for group in groups])
    centres = np.array([instants[group] @ weights[group] for group in groups]) / sums
    return centres - centres[0], sums


def _shortest(times: Reals, amplitudes: Reals, demands: Sequence[Demand]) -> tuple[Reals, Reals] | None:
    """Sequential quadratic programming in times (but the first, 0) and amplitudes, from a start near the optimum."""
    n, unit = len(times), float(times[-1])
    exact, loose = [d for d in demands if d.tolerance == 0.0], [d for d in demands if d.tolerance > 0.0]
    limits = np.array([d.tolerance for d in loose])

    def values(x: Reals, chosen: Sequence[Demand]) -> Complexes:
        instants = unit * np.concatenate([[0.0], x[: n - 1]])
        return rows(chosen, instants, float(instants[-1])) @ x[n - 1 :]

    def vanish(x: Reals) -> Reals:
        left = values(x, exact) if exact else np.zeros(0, dtype=complex)
        return np.concatenate([[x[n - 1 :].sum() - 1.0], left.real, left.imag])

    def room(x: Reals) -> Reals:
        left = values(x, loose) if loose else np.zeros(0, dtype=complex)
        return np.concatenate([1.0 - np.abs(left) ** 2 / limits**2 if loose else [], np.diff(np.concatenate([[0.0], x[: n - 1]]))])

    found = minimize(
        lambda x: x[n - 2],
        np.concatenate([times[1:] / unit, amplitudes]),
        method="SLSQP",
        bounds=[(0.0, None)] * (2 * n - 1),
        constraints=[{"type": "eq", "fun": vanish}, {"type": "ineq", "fun": room}],
        options={"maxiter": 200, "ftol": 1e-15},
    )
    x = np.asarray(found.x)
    if np.abs(vanish(x)).max() > 1e-9 or room(x).min(initial=0.0) < -1e-9:
        return None
    return unit * np.concatenate([[0.0], x[: n - 1]]), x[n - 1 :]
