"""Weak duality in continuous time, evaluated in floating point: what a costate says about the minimum time.

For any λ and `p(s) = λᵀ b(s)`, a command that reaches the target in time T satisfies (../docs/theory.md, equation 2)

    λᵀ target ≤ ∫_0^T σ(p(s)) ds,     σ(p) = max(upper p, lower p).

Where that is violated no admissible command is as short as T. A budget of fuel adds its `price` μ times the budget on the right, and then
σ(p) = max(0, upper (p - μ)) + max(0, lower (p + μ)). Here the integral is a float; the theorem needs ball arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relaxations.maneuvers import Problem
from relaxations.presses import over
from relaxations.presses import sampled as sampled_costate
from relaxations.prices import NONE, Prices
from relaxations.ramps import bound as ramped
from relaxations.ramps import slid as slid_ramps
from relaxations.varying_courses import driven, gained

Reals = NDArray[np.float64]

SAMPLES_PER_PERIOD = 64  # of each pole, as long as its motion lasts; between two samples p has no more than one extremum then
MOST_SAMPLES = 200_000  # of one pole
MOST_STEPS = 120  # of the search for one root: halving alone takes about 60
POINTS, BEYOND = 20_001, 1.02  # of the grid on which multipliers of courses are integrated, and how far it goes, in times of a guess
MOST_CELLS = 200_000  # of a sample time: their integrals one by one
LASTING = 50.0  # time constants after which (or, right of the axis, before which) a mode's share of the costate is rounding


def _samples(problem: Problem, horizon: float) -> Reals:
    """Times to go at which to look at the costate: each mode at its own pace while it is alive, so that no boundary layer is missed."""
    parts = [np.linspace(0.0, horizon, 513)]
    for pole in {pole.value for target in problem.sets for pole in target.basis.poles if pole.value}:
        alive = min(LASTING / abs(pole.real), horizon) if pole.real else horizon
        count = int(min(SAMPLES_PER_PERIOD * alive * abs(pole) / (2 * np.pi), MOST_SAMPLES)) + 2
        parts.append(np.linspace(0.0, alive, count) if pole.real <= 0.0 else np.linspace(horizon - alive, horizon, count))
    return np.unique(np.concatenate(parts))


def costate_roots(problem: Problem, costate: Reals, horizon: float, level: float = 0.0) -> Reals:
    """Times to go in (0, horizon) at which `p = λᵀ b` crosses `level`, ascending [s].

    Two roots between neighbouring samples enclose an extremum of p, so the extrema on the near side of zero are samples too: a pair that is
    missed would make the lower bound too long.
    """
    if problem.transition is not None:
        return problem.transition.crossings(costate, horizon, level)
    grid = _samples(problem, horizon)
    table, change = problem.rows(grid), problem.derivative(costate)
    values, slopes = costate @ table - level, change @ table
    same = values[:-1] * values[1:] > 0
    turning = np.flatnonzero(same & (slopes[:-1] * values[:-1] < 0) & (slopes[1:] * values[1:] > 0))
    if len(turning):
        # With one extremum between two samples |p| is convex there: above the point where its tangents meet.
        left, right = turning, turning + 1
        width, fall = grid[right] - grid[left], slopes[left] - slopes[right]
        meeting = values[left] + slopes[left] * (values[right] - values[left] - slopes[right] * width) / fall
        turning = turning[meeting * values[left] <= 0]
    if len(turning):
        extrema = _roots(problem, change, grid[turning], grid[turning + 1])
        grid = np.insert(grid, turning + 1, extrema)
        values = np.insert(values, turning + 1, costate @ problem.rows(extrema) - level)
    values[values == 0.0] = np.finfo(float).tiny  # a grid point that hits a root belongs to its right-hand neighbour's side
    inner = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    return _roots(problem, costate, grid[inner], grid[inner + 1], level)


def _roots(problem: Problem, costate: Reals, left: Reals, right: Reals, level: float = 0.0) -> Reals:
    """The root of `λᵀ b - level` in each bracket: Newton's method, which halves it wherever it would leave it or hardly gains."""
    if not len(left):
        return np.zeros(0)
    change, rising = problem.derivative(costate), costate @ problem.rows(left) < level
    low, high, x, last, eps = left, right, (left + right) / 2, 2 * (right - left), float(np.finfo(float).eps)
    for _ in range(MOST_STEPS):
        table = problem.rows(x)
        value, slope = costate @ table - level, change @ table
        above = (value > 0) == rising
        low, high = np.where(above, low, x), np.where(above, x, high)
        step = np.divide(-value, slope, out=np.full_like(x, np.inf), where=slope != 0.0)
        inside = np.clip(x + step, low, high)
        good = (np.abs(inside - x - step) <= (high - low) / 16) & (np.abs(step) <= last / 2)  # a root may lie at the end of its bracket
        found = (np.abs(value) <= 4 * eps * (np.abs(costate) @ np.abs(table) + abs(level))) | (
            last <= 2 * eps * x
        )  # what is left is rounding
        following = np.where(found, x, np.where(good, inside, (low + high) / 2))
        last, x = np.abs(following - x), following
        if np.all(found):
            break
    return x


@dataclass(frozen=True, slots=True)
class Support:
    """`∫_0^T σ(p)` split at the costate's roots."""

    horizon: float
    roots: Reals
    integral: float
    rounding: float  # a generous estimate of the floating-point error of `integral`
    final: float  # σ(p(T)), the integrand where the horizon ends


Known = dict[float, tuple[float, Reals]]
"""For each level the longest horizon that was looked at and the roots within it: they are times to go, and serve all shorter ones."""


def support(problem: Problem, costate: Reals, horizon: float, price: float = 0.0, known: Known | None = None) -> Support:
    """Evaluate `∫_0^horizon σ(p(s)) ds` through the antiderivative of b; `price` is that of the fuel, `known` of this costate."""
    known = {} if known is None else known
    if not price:
        return _support(problem, costate, horizon, 0.0, problem.lower, problem.upper, known)
    above = _support(problem, costate, horizon, price, 0.0, problem.upper, known)
    below = _support(problem, costate, horizon, -price, problem.lower, 0.0, known)
    roots = np.union1d(above.roots, below.roots)
    return Support(horizon, roots, above.integral + below.integral, above.rounding + below.rounding, above.final + below.final)


def _support(problem: Problem, costate: Reals, horizon: float, level: float, lower: float, upper: float, known: Known) -> Support:
    """The same of `max(upper (p - level), lower (p - level))`."""
    if level not in known or known[level][0] < horizon:
        known[level] = horizon, costate_roots(problem, costate, horizon, level)
    roots = known[level][1][known[level][1] < horizon]
    edges = np.concatenate([[0.0], roots, [horizon]])
    table = problem.rows(edges, 1)
    pieces = costate @ np.diff(table, axis=1) - level * np.diff(edges)
    chosen = np.where(pieces > 0, upper, lower)
    size = np.abs(costate) @ np.abs(table) + abs(level) * edges
    rounding = 8 * np.finfo(float).eps * float(np.sum(size) * max(abs(lower), abs(upper)))
    end = float(costate @ problem.rows([horizon])[:, 0]) - level
    return Support(horizon, roots, float(chosen @ pieces), rounding, max(upper * end, lower * end))


@dataclass(frozen=True, slots=True)
class Costate:
    """A costate (size,) of `problem` by itself, to refute commands of up to `maneuver_time` [s]; nothing after the move has a price."""

    problem: Problem
    costate: Reals
    maneuver_time: float
    prices: Prices = NONE

    @property
    def tail_multipliers(self) -> tuple[tuple[float, float, float], ...]:
        """None."""
        return ()

    def price(self, problem: Problem) -> float:
        """Nothing."""
        del problem
        return 0.0


def lower_bound(
    problem: Problem,
    costate: Reals,
    near: float,
    price: float = 0.0,
    prices: Prices = NONE,
) -> float:
    """The largest T_λ near `near` [s] at which (2) is violated beyond rounding, or 0: `λᵀ target - price = ∫_0^T σ(p)` by guarded Newton.

    `price` is what the multipliers of all limits but the input's add on the right of (2), `prices` are those of the fuel, outputs, slopes.
    With a sample time T_λ is a whole number of samples.
    """
    if problem.transition is not None and (prices.pressed or prices.ramps):
        return _varying(problem, costate, near, price, prices)
    if problem.maneuver.sample_time is not None:
        return _sampled(problem, costate, near, price, prices)
    if prices.pressed or (prices.ramps and problem.rate is not None):
        return _followed(problem, costate, near, price, prices)
    if problem.begin is None and float(costate @ problem.target) <= price:
        return 0.0
    fuel = float(prices.fuel)
    low, high = 0.0, np.inf
    time, best = near, 0.0
    known: Known = {}
    for _ in range(60):
        value = support(problem, costate, time, fuel, known)
        aim, drift = (float(costate @ part[:, 0]) for part in problem.aim(np.array([time])))
        wanted = aim - price
        if value.integral + value.rounding < wanted:
            low, best = time, max(best, time)
            if wanted - value.integral <= 4 * value.rounding:
                break
        else:
            high = time
        # A slope of zero says nothing about where the root is: bisect (or double) then.
        rise = value.final - drift
        step = (wanted - value.integral - 2 * value.rounding) / rise if rise > 0 else np.inf
        following = time + step
        if not low < following < high:
            following = (low + high) / 2 if np.isfinite(high) else 2 * time
        close = 4 * np.finfo(float).eps
        if abs(following - time) <= close * time or high - low <= close * high:
            if best > 0.0:
                break
            following = (1.0 - close) * time  # rounding alone keeps (2) from being violated: it does not so a little earlier
        time = following
    return best


def _followed(problem: Problem, costate: Reals, near: float, price: float, prices: Prices) -> float:
    """The same where multipliers of outputs or slopes are in p, from its values on a fine grid: Simpson's rule, triangles where p changes
    sign; with ramps the trapezoidal rule."""
    modal = np.array([float(value) for value in problem.modal(costate)])
    bases = [own.basis for own in problem.sets]
    parts = np.split(modal, np.cumsum([basis.size for basis in bases])[:-1])
    edges = _with_ends(prices, BEYOND * near, POINTS)
    points = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    p, first = sampled_costate(bases, parts, prices.pressed, points), 0.0
    if prices.ramps and problem.rate is not None:
        limits, edges = (problem.lower, problem.upper), points
        total, first = ramped(p, points, limits, problem.rate, float(prices.fuel), prices.ramps, *prices.steps)
    else:
        total = np.concatenate([[0.0], np.cumsum(_cells(problem, p, np.diff(edges), float(prices.fuel)))])
    left = _wanted(problem, costate, edges, price - first * problem.hold, prices) - total
    refuted = np.flatnonzero(left > 0.0)
    if not len(refuted):
        return 0.0
    at = int(refuted[-1])
    if at == len(edges) - 1:
        return float(edges[-1])
    return float(edges[at] + (edges[at + 1] - edges[at]) * left[at] / (left[at] - left[at + 1]))


def _with_ends(prices: Prices, end: float, count: int) -> Reals:
    """Times to go up to an end [s], so many and those at which multipliers begin and end."""
    known = [edge for press in prices.pressed for edge in (press.begin, press.end)] + [edge for ramp in prices.ramps for edge in ramp.edges]
    edges = np.union1d(np.linspace(0.0, end, count), known)
    return edges[edges <= end]


def _varying(problem: Problem, costate: Reals, near: float, price: float, prices: Prices) -> float:
    """`_followed` of a plant that varies, or `_sampled` with multipliers of its outputs."""
    step, first = problem.maneuver.sample_time, 0.0
    if step is not None:
        edges = problem.samples(round(near / float(step)) + 2)
        points = edges
    else:
        edges = _with_ends(prices, BEYOND * near, POINTS // 4 if prices.pressed else POINTS)
        points = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    away = problem.target
    if prices.pressed:
        begin, p, integral = driven(costate, prices.pressed, points)
        gain = float(begin @ away) + gained(prices.pressed)
    else:
        p, integral, gain = costate @ problem.rows(points), costate @ problem.rows(points, 1), float(costate @ away)
    fuel = float(prices.fuel)
    if step is not None:
        q = np.zeros(len(edges))
        q[: len(prices.steps)] = prices.steps[: len(edges)]
        first, pieces = float(q[0]), np.diff(integral) - np.diff(q)
        pieces -= np.clip(pieces, -fuel * np.diff(edges), fuel * np.diff(edges))
        total = np.concatenate([[0.0], np.cumsum(np.maximum(problem.upper * pieces, problem.lower * pieces))])
        if problem.rate is not None:
            total += np.cumsum(np.maximum(problem.rate[1] * q, problem.rate[0] * q)) * float(step)
    elif prices.ramps and problem.rate is not None:
        total, first = ramped(p, points, (problem.lower, problem.upper), problem.rate, fuel, prices.ramps, *prices.steps)
        edges = points
    else:
        total = np.concatenate([[0.0], np.cumsum(_cells(problem, p, np.diff(edges), fuel))])
    left = gain - price + first * problem.hold - total
    refuted = np.flatnonzero(left > 0.0)
    if not len(refuted):
        return 0.0
    at = int(refuted[-1])
    if step is not None or at == len(edges) - 1:
        return float(edges[min(at + 1, len(edges) - 1)])
    return float(edges[at] + (edges[at + 1] - edges[at]) * left[at] / (left[at] - left[at + 1]))


def _varying_costate(problem: Problem, costate: Reals, prices: Prices) -> tuple[Callable[[Reals], Reals], Callable[[Reals], Reals]]:
    """p at any instants of a plant that varies, and 0 and its integrals between ascending ones."""

    def p(points: Reals) -> Reals:
        if not prices.pressed:
            return costate @ problem.rows(points)
        ordered, place = np.unique(points, return_inverse=True)
        return driven(costate, prices.pressed, ordered)[1][place]

    def whole(edges: Reals) -> Reals:
        if not prices.pressed:
            return np.concatenate([[0.0], np.diff(costate @ problem.rows(edges, 1))])
        return np.concatenate([[0.0], np.diff(driven(costate, prices.pressed, edges)[2])])

    return p, whole


def slid(problem: Problem, costate: Reals, horizon: float, prices: Prices, most: float) -> Prices:
    """The multipliers of the slope with their ramps moved by at most `most` [s], as `ramps.slid` has it."""
    if problem.transition is not None:
        return replace(prices, ramps=slid_ramps(prices.ramps, *_varying_costate(problem, costate, prices), horizon, most))
    modal = np.array([float(value) for value in problem.modal(costate)])
    bases = [own.basis for own in problem.sets]
    parts = np.split(modal, np.cumsum([basis.size for basis in bases])[:-1])

    def p(points: Reals) -> Reals:
        return sampled_costate(bases, parts, prices.pressed, points)

    def whole(edges: Reals) -> Reals:
        return np.concatenate([[0.0], np.diff(costate @ problem.rows(edges, 1)) - over(prices.pressed, edges)])

    return replace(prices, ramps=slid_ramps(prices.ramps, p, whole, horizon, most))


def _wanted(problem: Problem, costate: Reals, times: Reals, price: float, prices: Prices) -> Reals:
    """The left side of (2) less the `price`, for moves of these durations [s]."""
    if problem.begin is None:
        return np.full(len(times), float(costate @ problem.target) - price)
    return costate @ problem.aim(times)[0] - price + sum((press.freely(times) for press in prices.pressed), np.zeros(len(times)))


def _cells(problem: Problem, p: Reals, widths: Reals, fuel: float) -> Reals:
    """The integral of σ(p) over each cell, of p at both ends and in the middle."""
    total = np.zeros(len(widths))
    for level, limit in ((fuel, problem.upper), (-fuel, problem.lower)):
        q = limit * (p - level)
        a, m, b = q[:-2:2], q[1:-1:2], q[2::2]
        simpson = np.maximum(a + 4 * m + b, 0.0) / 6
        with np.errstate(divide="ignore", invalid="ignore"):
            triangle = np.nan_to_num(np.maximum(a, b) ** 2 / (2 * np.abs(a - b)))
        total += widths * np.where(a * b < 0, triangle, simpson)
    return total


def _sampled(problem: Problem, costate: Reals, near: float, price: float, prices: Prices) -> float:
    """The least number of samples that is not refuted, in seconds: `∫σ(p)` is `Σ_k σ(∫_cell p)` for an input that is constant over cells.

    Limits of its steps have multipliers q_k: `∫_cell p - q_k + q_{k-1}` stands for the integral then, and what q_k allows is added.
    Commands of up to two samples more than `near` [s] are looked at.
    """
    step = problem.maneuver.sample_time
    assert step is not None
    count, fuel = round(near / float(step)) + 2, float(prices.fuel)
    if count > MOST_CELLS:  # so many samples do hardly less than all inputs, whose bound is one of theirs too
        free = replace(problem, maneuver=replace(problem.maneuver, sample_time=None))
        return 0.0 if prices.steps or prices.pressed else lower_bound(free, costate, near, price, prices)
    edges = problem.samples(count)
    table = problem.rows(edges, 1)
    pieces = costate @ np.diff(table, axis=1) - over(prices.pressed, edges)
    q = np.zeros(len(edges))
    q[: len(prices.steps)] = prices.steps[: len(edges)]
    pieces -= np.diff(q)
    pieces -= np.clip(pieces, -fuel * np.diff(edges), fuel * np.diff(edges))
    total = np.cumsum(np.maximum(problem.upper * pieces, problem.lower * pieces))
    if problem.rate is not None:
        allowed = np.cumsum(np.maximum(problem.rate[1] * q, problem.rate[0] * q)) * float(step)
        total += allowed[1:]
    size = np.cumsum(np.abs(costate) @ np.abs(table))[1:] + 4 * np.cumsum(np.abs(q))[1:]
    rounding = 8 * np.finfo(float).eps * size * max(abs(problem.lower), abs(problem.upper))
    wanted = _wanted(problem, costate, edges[1:], price - float(q[0]) * problem.hold, prices)
    refuted = np.flatnonzero(total + rounding < wanted)  # and all that are shorter: what is at rest stays there
    return float(edges[min(int(refuted[-1]) + 2, len(edges) - 1)]) if len(refuted) else (float(edges[1]) if problem.begin is None else 0.0)
