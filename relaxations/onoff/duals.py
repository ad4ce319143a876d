"""The best costate of an on-off task at a fixed maneuver time, in continuous time: a smooth convex problem in a handful of unknowns.

Let thrust against the first direction be admitted until `late` and thrust along it from `early` on, both in time to go (`early = 0`,
`late = T`: all commands; `early = late`: pulses one way, then the other; `early < late`: the sign changes in between). For
limits E along and L against the first direction e = ±1, and a price μ ≥ 0 of the fuel

    Φ(λ, μ) = E ∫_early^T max(0, e p - μ) ds + L ∫_0^late max(0, -e p - μ) ds,     p = λᵀ b

and every such command has `λᵀ target ≤ Φ + μ fuel` (../../docs/theory.md, section 3). The largest reachable fraction of the target is the
minimum of `Φ + μ fuel` over λᵀ target = 1, μ ≥ 0; the least fuel the maximum of `λᵀ target - Φ(λ, 1)`. The gradient of Φ is what the
command does that λ asks for, its Hessian `Σ b bᵀ/|p'|` over the switches: Newton's method with a line search.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.errors import ShortHorizonError, SolverError
from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

SAMPLES_PER_PERIOD, LEAST_SAMPLES, MOST_SAMPLES = 48, 240, 40_000  # of the grid on which a costate's signs are looked at
METHODS = ("highs", "highs-ds", "highs-ipm")  # tried in turn: one may stall where another does not
COARSE, MOST_COARSE = 160, 1200  # cells of the linear program that a search begins with
ITERATIONS, HALVINGS = 40, 14
GAIN = 2e-15  # of the value: a step that gains less is none
DAMPING = 1e-9  # of the Hessian's trace, where it is singular
FAR = 0.5  # a fraction that is as good as none
ROUNDS, SETTLED, TIGHT = 7, 3e-7, 1e-10  # of linear programs; the command's relative residual, the gap at which a search has come to an end
STEPS, TURNS = 40, 4  # of a root's bracket, of one sample, and of Newton's method for an extremum
CLOSE = 1e-11  # of the duration: the last step of Newton's method for a root, quadratic down to arcs of a millionth
NEARLY = 0.25  # of second differences: so close to the price a parabola through samples does not say on which side an extremum is


@dataclass(frozen=True, slots=True)
class Windows:
    """Times to go [s]: from `early` on thrust along the first direction is admitted, until `late` thrust against it."""

    early: float
    late: float


@dataclass(frozen=True, slots=True)
class Looks:
    """A problem at a maneuver time T [s]: moments `b̂ = W b`, in which those of the grid are orthonormal and the target has length 1.

    `along` is the first direction e, ±1; `strong` and `weak` are the limits along and against it.
    """

    problem: Problem
    maneuver_time: float
    along: int
    strong: float
    weak: float
    turned: Reals  # W
    target: Reals
    grid: Reals
    table: Reals
    slope: Reals  # y of the derivative: `p' = (slope y)ᵀ b̂`

    @staticmethod
    def of(problem: Problem, maneuver_time: float, along: int) -> Looks:
        """Raises `ShortHorizonError` where the moments cannot be told apart in so short a time."""
        fastest = max((abs(pole) for pole in problem.poles), default=0.0)
        count = int(np.clip(SAMPLES_PER_PERIOD * fastest * maneuver_time / (2 * np.pi), LEAST_SAMPLES, MOST_SAMPLES))
        grid = np.linspace(0.0, maneuver_time, count + 1)
        rows = problem.rows(grid)
        change = np.linalg.qr(rows.T / np.sqrt(count))[1]
        share = np.abs(np.diag(change)) / np.linalg.norm(change, axis=0)
        if not share.min(initial=1.0) > count * np.finfo(float).eps:
            raise ShortHorizonError(f"the moment equations are dependent over {float(maneuver_time)!r} s")
        turned = np.linalg.inv(change.T)
        turned = turned / np.linalg.norm(turned @ problem.target)
        strong, weak = (problem.upper, -problem.lower) if along > 0 else (-problem.lower, problem.upper)
        modal = np.array([problem.derivative(unit) for unit in turned])  # of each λ = Wᵀ y
        slope: Reals = np.linalg.solve(turned.T, modal.T).astype(np.float64)
        return Looks(problem, maneuver_time, along, strong, weak, turned, turned @ problem.target, grid, turned @ rows, slope)

    def rows(self, s: Reals, integrals: int = 0) -> Reals:
        """b̂(s), or its integral from 0: (n, len(s))."""
        return self.turned @ self.problem.rows(s, integrals)

    def modal(self, costate: Reals) -> Reals:
        """λ of y, with `λᵀ b = yᵀ b̂`."""
        return self.turned.T @ costate

    def crossings(self, costate: Reals, side: int, price: float) -> Reals:
        """Times to go in (0, T) at which `side p` crosses `price`, ascending; arcs between two samples are seen by their extremum."""
        values = side * (costate @ self.table) - price
        at = np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0))
        s = self.grid[at] + (self.grid[at + 1] - self.grid[at]) * np.clip(values[at] / (values[at] - values[at + 1]), 0.0, 1.0)
        change = self.slope @ costate
        found = np.array([self.grid[at], self.grid[at + 1], s, (values[at] < 0.0).astype(float)])
        low, high, s, rises = np.hstack([found, self._between(values, costate, change, side, price)])
        for _ in range(STEPS if len(s) else 0):
            table = self.rows(s)
            off, slope = side * (costate @ table) - price, side * (change @ table)
            before = (off < 0.0) == (rises > 0.0)
            low, high = np.where(before, s, low), np.where(before, high, s)
            nearer = s - np.divide(off, slope, out=np.full_like(s, np.inf), where=slope != 0.0)
            nearer = np.where((nearer >= low) & (nearer <= high), nearer, (low + high) / 2)  # Newton's method, or halves
            moved, s = np.abs(nearer - s).max(), nearer
            if moved <= CLOSE * self.maneuver_time:  # the next one is closer than a double tells
                break
        return np.sort(s)

    def _between(self, values: Reals, costate: Reals, change: Reals, side: int, price: float) -> Reals:
        """Pairs of crossings between samples of one sign: their brackets, where a parabola has them, whether it rises: (4, 2 k)."""
        before, here, after = values[:-2], values[1:-1], values[2:]
        bend = before - 2.0 * here + after
        off = here < 0.0
        turns = np.where(off, (here >= before) & (here > after) & (bend < 0.0), (here <= before) & (here < after) & (bend > 0.0))
        at = np.flatnonzero(turns & ((before < 0.0) == off) & ((after < 0.0) == off))
        peak = here[at] - (before[at] - after[at]) ** 2 / (8.0 * bend[at])
        most = np.abs(bend[np.clip(at + np.array([[-1], [0], [1]]), 0, len(bend) - 1)]).max(axis=0, initial=0.0)
        at = at[((peak < 0.0) != off[at]) | (np.abs(peak) <= NEARLY * most)]
        if not len(at):
            return np.zeros((4, 0))
        first, last = self.grid[at], self.grid[at + 2]
        top = (first + last) / 2 + (before[at] - after[at]) / (2.0 * bend[at]) * (last - first) / 2
        turn = self.slope @ change
        for _ in range(TURNS):
            table = self.rows(top)
            curved = turn @ table
            top = np.clip(top - np.divide(change @ table, curved, out=np.zeros_like(top), where=curved != 0.0), first, last)
        table = self.rows(top)
        height, curved = side * (costate @ table) - price, np.abs(turn @ table)
        seen = ((height < 0.0) != off[at]) & (curved > 0.0)
        top, first, last, rises = top[seen], first[seen], last[seen], off[at][seen]
        apart = np.sqrt(2.0 * np.abs(height[seen]) / curved[seen])
        guesses = np.append(np.maximum(top - apart, first), np.minimum(top + apart, last))
        return np.array([np.append(first, top), np.append(top, last), guesses, np.append(rises, ~rises).astype(float)])


@dataclass(frozen=True, slots=True)
class Dual:
    """A costate y, the fuel's price μ, and `Φ + μ fuel`; of the command that they ask for its moments (n,), its fuel, and its arcs.

    `arcs` are (times to go of its edges, levels in between), in order of time to go; `curvature` is the Hessian by (y, μ).
    """

    windows: Windows
    costate: Reals
    price: float
    value: float
    moments: Reals
    burnt: float
    edges: Reals
    levels: Reals
    curvature: Reals


def evaluated(looks: Looks, windows: Windows, costate: Reals, price: float, fuel: float) -> Dual:
    """Φ with its derivatives, for a costate y and a price."""
    e, end = looks.along, looks.maneuver_time
    parts = ((e, looks.strong, windows.early, end), (-e, looks.weak, 0.0, windows.late))
    n = len(costate)
    value, moments, burnt, curvature = price * fuel, np.zeros(n), 0.0, np.zeros((n + 1, n + 1))
    on: list[tuple[float, float, float]] = []
    change = looks.slope @ costate
    for side, limit, low, high in parts:
        if not (limit > 0.0 and high > low):
            continue
        roots = looks.crossings(costate, side, price)
        roots = roots[(roots > low) & (roots < high)]
        edges = np.concatenate([[low], roots, [high]])
        pieces, lengths = np.diff(looks.rows(edges, 1), axis=1), np.diff(edges)
        gains = side * (costate @ pieces) - price * lengths
        active = gains > 0.0
        value += limit * float(gains[active].sum())
        moments += side * limit * pieces[:, active].sum(axis=1)
        burnt += limit * float(lengths[active].sum())
        on += [(float(a), float(b), side * limit) for a, b, is_on in zip(edges[:-1], edges[1:], active, strict=True) if is_on]
        if len(roots):
            table = looks.rows(roots)
            slopes = np.abs(change @ table)
            columns = np.vstack([side * table, -np.ones(len(roots))]) * np.sqrt(limit / np.maximum(slopes, 1e-12 * np.abs(costate).max()))
            curvature += columns @ columns.T
    edges, levels = _arcs(sorted(on), end)
    return Dual(windows, costate, price, value, moments, burnt, edges, levels, curvature)


def _arcs(on: list[tuple[float, float, float]], end: float) -> tuple[Reals, Reals]:
    """Edges and levels of a command that is on over these times to go and at rest else; two pieces that are alike and meet are one."""
    edges, levels = [0.0], []
    for a, b, level in on:
        if a > edges[-1]:
            edges.append(a)
            levels.append(0.0)
        if levels and levels[-1] == level:
            edges[-1] = b
        elif b > edges[-1]:
            edges.append(b)
            levels.append(level)
    if edges[-1] < end:
        edges.append(end)
        levels.append(0.0)
    return np.array(edges), np.array(levels)


def largest_fraction(looks: Looks, windows: Windows, fuel: float | None, start: Dual | None = None) -> Dual:
    """The dual of the largest reachable fraction α, which is its value; the costate is scaled to λᵀ target = 1. `start`: a dual nearby.

    Fractions of less than `FAR` are known to be less, no more. Newton's method begins at the start, then at a linear program's costate,
    on grids that have the last costate's switches among their instants, until it has come to an end.
    """
    best: Dual | None = None
    reached, instants = 0.0, np.array([windows.early, windows.late])
    for turn in range(ROUNDS):
        if turn or start is None:
            costate, price, fraction = _coarse(looks, windows, fuel, instants)
            reached = max(reached, fraction)
        else:
            costate, price = start.costate, start.price
        found = _minimised(looks, windows, fuel, costate, price)
        best = found if best is None or found.value < best.value else best
        if best.value <= FAR or settled(looks, best, fuel) or best.value - reached <= TIGHT:
            break
        instants = np.unique(np.concatenate([instants, best.edges, found.edges]))
    assert best is not None
    return best


def settled(looks: Looks, dual: Dual, fuel: float | None) -> bool:
    """Whether the command that a dual asks for reaches the fraction that it promises, and burns what is priced."""
    missed = np.linalg.norm(dual.moments - dual.value * looks.target)
    return bool(missed <= SETTLED) and (not dual.price or abs(dual.burnt - (fuel or 0.0)) <= SETTLED * (fuel or 0.0))


def _minimised(looks: Looks, windows: Windows, fuel: float | None, costate: Reals, price: float) -> Dual:
    """Newton's method for the largest fraction from a costate and a price."""
    budget = 0.0 if fuel is None else fuel
    scale = float(costate @ looks.target)
    costate, price = costate / scale, price / scale
    n, free = len(costate), fuel is not None and price > 0.0
    now = evaluated(looks, windows, costate, price if fuel is not None else 0.0, budget)
    for _ in range(ITERATIONS):
        gradient = np.append(now.moments, budget - now.burnt)
        if fuel is not None and not free and gradient[n] < 0.0:
            free = True  # a price of fuel would pay
        size = n + free
        step = _step(now.curvature[:size, :size], gradient[:size], np.append(looks.target, 0.0)[:size])
        if free and now.price + step[n] <= 0.0 < -step[n]:
            share = now.price / -step[n]
            if share <= 1e-9:
                free = False
                continue
            step = step * share
        step = np.append(step, np.zeros(n + 1 - size))
        if -float(gradient @ step) <= GAIN * abs(now.value):
            break
        gained = _gone(looks, windows, now, step, float(gradient @ step), budget, None)
        if gained is None:
            break
        done = now.value - gained.value <= GAIN * abs(now.value)
        now = gained
        if done or now.value <= FAR:
            break
    return now


def least_fuel(looks: Looks, windows: Windows) -> Dual | None:
    """The dual of the least fuel: `value` is what every such command burns; None if there is no command in so short a time."""
    instants, best = np.array([windows.early, windows.late]), None
    for _ in range(ROUNDS):
        costate = _coarse_fuel(looks, windows, instants)
        if costate is None:
            return best
        found = _most(looks, windows, costate)
        best = found if best is None or found.value > best.value else best
        if np.linalg.norm(best.moments - looks.target) <= SETTLED:
            break
        instants = np.unique(np.concatenate([instants, best.edges, found.edges]))
    return best


def _most(looks: Looks, windows: Windows, costate: Reals) -> Dual:
    """Newton's method for the largest `λᵀ target - Φ(λ, 1)` from a costate."""
    n = len(costate)
    now = _negated(evaluated(looks, windows, costate, 1.0, 0.0), looks)
    for _ in range(ITERATIONS):
        gradient = now.moments - looks.target
        step = np.append(_step(now.curvature[:n, :n], gradient, None), 0.0)
        if -float(gradient @ step[:n]) <= GAIN * abs(now.value):
            break
        gained = _gone(looks, windows, now, step, float(gradient @ step[:n]), 0.0, looks)
        if gained is None:
            break
        done = gained.value - now.value <= GAIN * abs(now.value)
        now = gained
        if done:
            break
    return now


def _negated(dual: Dual, looks: Looks) -> Dual:
    """With `λᵀ target - Φ` for a value."""
    return replace(dual, value=float(dual.costate @ looks.target) - dual.value)


def _step(curvature: Reals, gradient: Reals, constraint: Reals | None) -> Reals:
    """Newton's step; with a constraint along which nothing may change."""
    size = len(gradient)
    damped = curvature + DAMPING * (np.trace(curvature) + 1e-300) * np.eye(size)
    if constraint is None:
        return np.linalg.lstsq(damped, -gradient, rcond=None)[0]
    matrix = np.block([[damped, constraint[:, None]], [constraint[None, :], np.zeros((1, 1))]])
    return np.linalg.lstsq(matrix, np.append(-gradient, 0.0), rcond=None)[0][:size]


def _gone(looks: Looks, windows: Windows, now: Dual, step: Reals, slope: float, budget: float, target: Looks | None) -> Dual | None:
    """The first point along a step, of its length or shorter, that is better than where it begins; None if there is none."""
    share, n, sign = 1.0, len(now.costate), 1.0 if target is None else -1.0
    for _ in range(HALVINGS):
        costate, price = now.costate + share * step[:n], max(now.price + share * step[n], 0.0)
        there = evaluated(looks, windows, costate, price, budget)
        there = there if target is None else _negated(there, looks)
        if sign * (there.value - now.value) <= 1e-4 * share * min(slope, 0.0):
            return there
        share /= 2
    return None


def _coarse_fuel(looks: Looks, windows: Windows, instants: Reals) -> Reals | None:
    """A costate from the least fuel of a command on a coarse grid and further instants (HiGHS); None if none reaches the target."""
    table, widths, bounds = _columns(looks, windows, instants)
    result = linprog(widths, A_eq=table, b_eq=looks.target, bounds=bounds, method="highs")
    return np.asarray(result.eqlin.marginals) if result.status == 0 else None


def _columns(looks: Looks, windows: Windows, instants: Reals) -> tuple[Reals, Reals, list[tuple[float, float | None]]]:
    """What thrust along the first direction and against it does in the cells where it is admitted: moments, widths, limits."""
    count = int(min(max(COARSE, len(looks.grid) // 3), MOST_COARSE))
    edges = np.unique(np.concatenate([np.linspace(0.0, looks.maneuver_time, count + 1), instants]))
    edges = edges[edges <= looks.maneuver_time]
    table, widths, middles = np.diff(looks.rows(edges, 1), axis=1), np.diff(edges), (edges[1:] + edges[:-1]) / 2
    first, second = middles > windows.early, middles < windows.late
    columns = np.hstack([looks.along * table[:, first], -looks.along * table[:, second]])
    bounds: list[tuple[float, float | None]] = [(0.0, looks.strong)] * int(first.sum())
    bounds += [(0.0, looks.weak)] * int(second.sum())
    return columns, np.concatenate([widths[first], widths[second]]), bounds


def _coarse(looks: Looks, windows: Windows, fuel: float | None, instants: Reals) -> tuple[Reals, float, float]:
    """Costate, price and fraction from a linear program on a coarse grid and further instants (HiGHS): maximise α of the target."""
    table, widths, bounds = _columns(looks, windows, instants)
    columns, burnt = np.hstack([table, -looks.target[:, None]]), np.append(widths, 0.0)
    bounds = [*bounds, (0.0, None)]
    cost = np.append(np.zeros(len(widths)), -1.0)
    result = None
    for method in METHODS:
        result = linprog(
            cost,
            A_eq=columns,
            b_eq=np.zeros(len(columns)),
            A_ub=None if fuel is None else burnt[None, :],
            b_ub=None if fuel is None else [fuel],
            bounds=bounds,
            method=method,
        )
        if result.status == 0:
            break
    if result is None or result.status != 0:
        raise SolverError(f"the linear program at T = {float(looks.maneuver_time)!r} s has no answer that was found")
    costate = np.asarray(result.eqlin.marginals)
    price = 0.0 if fuel is None else max(-float(result.ineqlin.marginals[0]), 0.0)
    scale = float(costate @ looks.target)
    if not abs(scale) > 0.0:
        raise SolverError(f"the multipliers at T = {looks.maneuver_time!r} s vanish on the target")
    return costate / scale, abs(price / scale), -float(result.fun)
