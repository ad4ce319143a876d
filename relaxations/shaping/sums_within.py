"""The shortest sequence whose partial sums stay within two bounds and whose residual stays within a tolerance over bands.

The partial sums S(t) are a command between the bounds: with z_i(t) = e^{κω(t - T)} at a place i of a band

    F_i = z_i(T) - ∫ S dz_i,     |F_i| ≤ V_i     (Re e^{-jθ} F_i ≤ V_i for every θ)

On a grid, with cuts (ω, ζ, θ) that are added where the residual is largest, the least excess over the tolerances is a linear program, and
the duration its root. Its multipliers μ make p = Re Σ μ_c e^{-jθ_c} z_c, and

    p(T) - ∫ max(l p', u p') > Σ μ_c V_c

which relaxations.checking.durations proves, refutes a duration and all shorter ones. The switches of the grid's command begin sequential
quadratic programs for exact instants.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from relaxations.checking.durations import Condition, none_within_sums
from relaxations.errors import SolverError
from relaxations.shaping.bands import Band, exceeded, sampled_demands
from relaxations.shaping.insensitive import implied
from relaxations.shaping.polishing import Demand, rows
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

CELLS, PER_PERIOD = 240, 30  # of the grid, at least, and for each period of the fastest frequency
MOST_CELLS = 1500
ROUNDS = 40  # of cuts
MISSED = 1e-7  # of an excess: cuts that gain less end the search
BRACKET = 1e-5  # relative width of the bracket on the grid
SHORTER = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # relative: how far below the duration the proof that none is shorter is tried
LEVEL = 1e-6  # of the distance between the bounds: a level so near to one is it
HAIR = 1e-7  # of a tolerance: by how much exact instants are designed inside it
TOGETHER = 1e-13  # of the duration: what lies no farther apart is one impulse
FAINT = 1e-9  # a multiplier that is none, of a sum of 1
ATTEMPTS = 8
TWICE = 2  # looks in a row on one side of the root, after which the bracket is halved
MOST = 6.0  # half periods of the slowest frequency that are searched


@dataclass(frozen=True, slots=True)
class Found:
    """A shaper, and the least duration [s] that is proven of any in its family; None if none was."""

    shaper: Shaper
    lower: float | None


def within_sums_and_bands(bands: Sequence[Band], lower: float, upper: float) -> Found:
    """The shortest such sequence: impulses `u, l - u, u - l, …, 1 - l`. Raises `SolverError`."""
    search = Search(tuple(bands), lower, upper)
    slowest = max(band.half_period for band in bands)
    below, above, levels, duration, turns = (0.0, 1.0), None, np.zeros(0), min(slowest, _decayed(bands)), 0
    while above is None or above[0] - below[0] > BRACKET * above[0]:
        excess, found, _ = search.solved(duration)
        turns = max(turns, 0) + 1 if excess > 0.0 else min(turns, 0) - 1
        if excess > 0.0:
            below = duration, excess
        else:
            above, levels = (duration, excess), found
        if above is None:
            duration *= 1.3
            if duration > MOST * slowest:
                raise SolverError(_lost())
            continue
        # False position a hair beyond the root closes the bracket; where it does not, and twice on one side, halving does.
        share = below[1] / (below[1] - above[1]) if above[1] < below[1] else 0.5
        aim = below[0] + share * (above[0] - below[0]) + 0.3 * BRACKET * above[0]
        near = min(max(aim, below[0] + 0.05 * (above[0] - below[0])), above[0] - 0.05 * (above[0] - below[0]))
        duration = near if abs(turns) < TWICE and (excess <= 0.0 or near > duration) else (below[0] + above[0]) / 2.0
    high = above[0]
    shaper = search.exact(high, levels)
    return Found(shaper, search.proven(high))


def _decayed(bands: Sequence[Band]) -> float:
    """When one impulse has decayed to every tolerance [s], a hair later: no more is ever taken."""
    rates = [band.damped[0] * band.ends[0] for band in bands]
    if min(rates) <= 0.0:
        return math.inf
    return max(-math.log(band.tolerance) / rate for band, rate in zip(bands, rates, strict=True)) * (1.0 + BRACKET)


def _lost() -> str:
    return "no sequence within these bounds was found that keeps every band; a convolution of one for each mode, and ei, are possible"


def _of_instants(times: Reals, sizes: Reals) -> Shaper:
    """Impulses whose instants are the same but for rounding are one: arcs of no length are none. The last one stays, whatever its size."""
    kept = np.flatnonzero(sizes)
    instants = np.maximum.accumulate(times[kept] - times[kept][0])
    begins = np.append(True, np.diff(instants) > TOGETHER * instants[-1])
    whole = np.bincount(begins.cumsum() - 1, weights=sizes[kept])
    own = np.flatnonzero((whole != 0.0) | (np.arange(len(whole)) == len(whole) - 1))
    return Shaper(tuple(map(float, instants[begins][own])), tuple(map(float, whole[own])))


@dataclass
class Search:
    """The program on a grid, with the cuts that were added so far."""

    bands: tuple[Band, ...]
    lower: float
    upper: float
    cuts: list[tuple[Demand, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        corners = [2.0 * math.pi * k / 8.0 for k in range(8)]
        self.cuts = [(demand, theta) for demand in sampled_demands(self.bands) for theta in corners]

    def cells(self, duration: float) -> int:
        fastest = max(band.ends[1] for band in self.bands)
        return min(max(CELLS, math.ceil(PER_PERIOD * duration * fastest / (2.0 * math.pi))), MOST_CELLS)

    def solved(self, duration: float, cells: int | None = None) -> tuple[float, Reals, Reals]:
        """The least excess, levels of the cells, of which there may be so many, and multipliers of the cuts."""
        instants = np.linspace(0.0, duration, (cells or self.cells(duration)) + 1)
        excess, levels, prices = 0.0, np.zeros(0), np.zeros(0)
        for _ in range(ROUNDS):
            demands = [demand for demand, _ in self.cuts]
            turns = np.exp(-1j * np.array([theta for _, theta in self.cuts]))[:, None]
            z = turns * rows(demands, instants, duration)
            steps = np.diff(z.real, axis=1)
            radii = np.array([demand.tolerance for demand in demands])
            # Re e^{-jθ} F - r ≤ V with F = z(T) - Σ S_k Δz_k
            found = linprog(
                np.append(np.zeros(steps.shape[1]), 1.0),
                A_ub=np.hstack([-steps, -np.ones((len(steps), 1))]),
                b_ub=radii - z.real[:, -1],
                bounds=[(self.lower, self.upper)] * steps.shape[1] + [(-1.0, None)],
                method="highs",
            )
            if found.status != 0:
                raise SolverError(_lost())
            levels, excess, prices = found.x[:-1], float(found.x[-1]), -found.ineqlin.marginals
            jumps = np.diff(levels, prepend=0.0, append=1.0)
            over = self._above(instants, jumps, max(excess, 0.0) + MISSED)
            if not over:
                break
            self.cuts += over
        return excess, levels, prices

    def _above(self, times: Reals, jumps: Reals, excess: float) -> list[tuple[Demand, float]]:
        kept = np.flatnonzero(np.abs(jumps) > 1e-12)
        kept = kept if kept[-1] == len(times) - 1 else np.append(kept, len(times) - 1)
        places = exceeded(times[kept], jumps[kept], self.bands, 1.0)
        found = []
        for demand in places:
            value = complex((rows([demand], times[kept], float(times[-1])) @ jumps[kept])[0])
            if abs(value) > demand.tolerance + excess:
                found.append((demand, float(np.angle(value))))
        return found

    def exact(self, duration: float, levels: Reals) -> Shaper:
        """Switches only, at exact instants."""
        instants = np.linspace(0.0, duration, len(levels) + 1)
        times = self._switches(instants, levels)
        n = len(times)
        sizes = np.array([self.upper, *((self.upper - self.lower) * (1.0 if k % 2 else -1.0) for k in range(n - 2)), 1.0 - self.lower])
        demands = list(dict.fromkeys(demand for demand, _ in self.cuts))
        for _ in range(ATTEMPTS):
            times = self._minimised(times, sizes, demands)
            over = exceeded(times, sizes, self.bands, 1.0)
            if not over:
                return _of_instants(times, sizes)
            demands += over
        raise SolverError(_lost())

    def _switches(self, instants: Reals, levels: Reals) -> Reals:
        """Between arcs on a bound the integral of what lies between them is kept."""
        reach = self.upper - self.lower
        side = np.where(levels >= self.upper - LEVEL * reach, 1, np.where(levels <= self.lower + LEVEL * reach, -1, 0))
        times, at, current = [0.0], 0, 1
        while at < len(levels):
            if side[at] == current:
                at += 1
                continue
            end = at
            while end < len(levels) and side[end] == 0:
                end += 1
            following = side[end] if end < len(levels) else -current
            area = float(((levels[at:end] - self.lower) / reach * np.diff(instants)[at:end]).sum())
            if following != current:
                times.append(float(instants[at] + area) if current > 0 else float(instants[end] - area))
                current = following
            elif current > 0:  # a dip that does not come to the other bound
                width = float(instants[end] - instants[at]) - area
                middle = float(instants[at] + instants[end]) / 2.0
                times += [middle - width / 2.0, middle + width / 2.0]
            else:
                middle = float(instants[at] + instants[end]) / 2.0
                times += [middle - area / 2.0, middle + area / 2.0]
            at = max(end, at + 1)
        if current > 0:
            times.append(float(instants[-1]))  # it ends on the upper bound: a dip of no width
        return np.array([*times, float(instants[-1])])

    def _minimised(self, times: Reals, sizes: Reals, demands: Sequence[Demand]) -> Reals:
        unit, n = float(times[-1]), len(times)
        rates = np.array([complex(d.damping, math.sqrt(1.0 - d.damping**2)) * d.frequency for d in demands])[:, None]
        limits = np.array([d.tolerance * (1.0 - HAIR) for d in demands])

        def parts(x: Reals) -> tuple[Reals, Complexes]:
            t = np.concatenate([[0.0], x * unit])
            return t, np.exp(rates * (t - t[-1]))

        def room(x: Reals) -> Reals:
            _, z = parts(x)
            return 1.0 - np.abs(z @ sizes) ** 2 / limits**2

        def slopes(x: Reals) -> Reals:
            _, z = parts(x)
            value = (z @ sizes)[:, None]
            by = rates * z * sizes
            by[:, -1] -= (rates * z * sizes).sum(axis=1)
            return -2.0 * (value.conj() * by).real[:, 1:] * unit / limits[:, None] ** 2

        order = np.eye(n - 1) - np.eye(n - 1, k=-1)
        found = minimize(
            lambda x: x[-1],
            times[1:] / unit,
            jac=lambda x: np.eye(n - 1)[-1],
            method="SLSQP",
            constraints=[
                {"type": "ineq", "fun": room, "jac": slopes},
                {"type": "ineq", "fun": lambda x: order @ x, "jac": lambda x: order},
            ],
            options={"maxiter": 300, "ftol": 1e-13},
        )
        return np.concatenate([[0.0], found.x * unit])

    def conditions(self, multipliers: Reals) -> list[Condition]:
        """What multipliers of the cuts say."""
        return [
            implied(self.bands, demand, mu * complex(math.cos(theta), math.sin(theta)))
            for (demand, theta), mu in zip(self.cuts, multipliers, strict=False)  # cuts that came last have no multiplier
            if mu > FAINT
        ]

    def proven(self, duration: float) -> float | None:
        """The longest duration for which it is proven that none is as short."""
        for shorter in SHORTER:
            claimed = duration * (1.0 - shorter)
            excess, _, multipliers = self.solved(claimed)
            if excess <= 0.0:
                continue
            if none_within_sums(Fraction(claimed), self.conditions(multipliers), Fraction(self.lower), Fraction(self.upper)):
                return claimed
        return None
