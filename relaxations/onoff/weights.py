"""Fuel and time weighted against each other: `J = ∫_0^T (1 + α |u|) dt = T + α fuel`, T free.

*Check.* By Pontryagin's maximum principle a command that minimises J has a costate with p beyond α, on its side, where it is on, |p| ≤ α
(the dead zone) where it rests, and `|p(T)| - α` times the thrust = 1 at the beginning (the Hamiltonian vanishes). All are linear in (λ, α):
the prices for which they can be met are an interval, or none. `extremal_prices` finds it, on a dense grid of the costate (floating point).

*Warning.* To be extremal is not to be a minimiser. The least time T(U) within a budget is not convex: between the nodes of that curve a
command that is the fastest within its budget is extremal for one price, at which its neighbours on either side cost less. Only the nodes
(and the fastest command) minimise J, and only a bound of all commands says so.

*Bound.* No command that burns U at most is faster than T(U), proven. So with budgets U_0 > U_1 > … such that `T(U_k) + α U_(k+1)` is some
target (the first T that of all commands), until T(U_k) alone is as much, no command costs less than the target: for all that burn more than
U_(k+1), and no more than U_k, `J ≥ T(U_k) + α U_(k+1)`. The certificates are those of minimum times within budgets.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem
from relaxations.onoff.duals import Looks
from relaxations.onoff.spent import least_fuel_at, within
from relaxations.proofs import minimum_time

Reals = NDArray[np.float64]

SAMPLES = 4000  # of the costate
SLACK = 1e-9  # of the prices' scale: how exactly the switches are met
THIN = 1e-5  # of the duration, or the input's range: what is so small is none
CLOSE = 1e-3  # of the cost: how far below that of the best command the target is
SCANNED, ROUNDS = 48, 40  # times at which the least fuel is computed first, and steps of the search around the best of them
LONGEST = 4.0  # times the fastest move: beyond that the scan goes on only while it pays
MOST = 400  # budgets


@dataclass(frozen=True, slots=True)
class Weighted:
    """A bracket of the least `T + α fuel` [s]: `lower` is proven by `bounds`, each a minimum time within a budget (None: it is not proven);
    `upper` is what `command` costs, proven too; `prices` is the interval of α for which it is extremal (None: for none)."""

    price: float
    lower: float | None
    upper: float
    command: Command
    bounds: tuple[tuple[Fraction, Bound], ...]
    prices: tuple[float, float] | None

    def minimises(self, cost: float) -> bool | None:
        """Whether a command of this cost [s] is a minimiser, to within the bracket: False: proven that it is none; None: not decided."""
        if cost > self.upper:
            return False
        return None if self.lower is None else cost <= self.upper

    @property
    def extremal(self) -> bool:
        """Whether the command passes the check of the maximum principle for this price."""
        return self.prices is not None and self.prices[0] * (1.0 - 1e-4) <= self.price <= self.prices[1] * (1.0 + 1e-4)


def extremal_prices(problem: Problem, command: Command) -> tuple[float, float] | None:
    """The least and the largest price α > 0 of fuel for which a command from rest to rest, on or off, is extremal; None: for no price.

    The largest is infinite for a command that no dearer fuel would change.
    """
    end = command.maneuver_time
    looks = Looks.of(problem, end, 1)
    starts, sides = _outline(problem, command)
    if not len(sides) or sides[0] == 0.0:
        return None
    table = looks.table if len(looks.grid) >= SAMPLES else looks.rows(np.linspace(0.0, end, SAMPLES + 1))
    s = looks.grid if len(looks.grid) >= SAMPLES else np.linspace(0.0, end, SAMPLES + 1)
    side = sides[np.clip(np.searchsorted(starts, end - s, side="right") - 1, 0, len(sides) - 1)]
    switches = np.array([end - start for start, (one, other) in zip(starts[1:], pairwise(sides), strict=True) if one != other])
    jumps = np.array([(one, other) for one, other in pairwise(sides) if one != other]).reshape(-1, 2)
    near = np.min(np.abs(s[:, None] - switches[None, :]), axis=1, initial=np.inf) < 1e-9 * end
    table, side = table[:, ~near].T, side[~near]
    n = looks.table.shape[0]
    # Unknown are y and α. On: side p ≥ α; off: |p| ≤ α; at a switch p = α (|v| - |w|)/(v - w), in units of the sides.
    on, off = side != 0.0, side == 0.0
    below = [
        np.column_stack([-side[on, None] * table[on], np.ones(int(on.sum()))]),
        np.column_stack([table[off], -np.ones(int(off.sum()))]),
        np.column_stack([-table[off], -np.ones(int(off.sum()))]),
    ]
    equal, right = [], []
    if len(switches):
        b = looks.rows(switches).T
        shares = (np.abs(jumps[:, 0]) - np.abs(jumps[:, 1])) / (jumps[:, 0] - jumps[:, 1])
        equal.append(np.column_stack([b, -shares]))
        right.append(np.zeros(len(switches)))
    first, thrust = looks.rows(np.array([end])).T, problem.upper if sides[0] > 0 else -problem.lower
    equal.append(np.column_stack([thrust * sides[0] * first, [-thrust]]))
    right.append(np.ones(1))
    # The switches are rounded, and may be more than the equations that determine λ: they are met to within a hair.
    rows, wanted = np.vstack(equal), np.concatenate(right)
    limits = np.vstack([*below, rows, -rows])
    bounds = np.concatenate([np.zeros(sum(len(part) for part in below)), wanted + SLACK, SLACK - wanted])
    found: list[float] = []
    for sign in (1.0, -1.0):
        result = linprog(np.append(np.zeros(n), sign), A_ub=limits, b_ub=bounds, bounds=[*[(None, None)] * n, (0.0, None)], method="highs")
        if result.status == 3:
            found.append(np.inf)
        elif result.status != 0:
            return None
        else:
            found.append(float(result.x[-1]))
    return found[0], found[1]


def _outline(problem: Problem, command: Command) -> tuple[list[float], Reals]:
    """Starts and signs of a command's arcs, without those that are too thin to be any: what rounding leaves at a node."""
    ends = [*(segment.start for segment in command.segments[1:]), command.maneuver_time]
    starts, sides = list[float](), list[float]()
    for segment, end in zip(command.segments, ends, strict=True):
        level = segment.level - problem.rest
        side = 0.0 if abs(level) < THIN * (problem.upper - problem.lower) else float(np.sign(level))
        if end - segment.start > THIN * command.maneuver_time and not (sides and sides[-1] == side):
            starts.append(segment.start)
            sides.append(side)
    return starts, np.array(sides)


def weighted(problem: Problem, price: float, close: float = CLOSE) -> Weighted:
    """Bracket the least `T + α fuel` of moves from rest to state rest, of the form that the problem holds; its own budget does not count.

    `close` is the relative gap that is aimed at. Raises `ManeuverError` for a price that is none.
    """
    if not price > 0.0:
        raise ManeuverError(f"a price of fuel is more than 0, not {price!r}; at 0 it is the minimum time")
    free = minimum_time(within(problem, None))
    if free.upper is None or free.command is None or free.status is not Status.PROVED:
        raise ManeuverError(f"the minimum time is not proven: {free.reason or free.status.value}")
    most = free.command.fuel(problem.rest)
    best, cost = free.command, free.upper + price * most
    fuel = _best_fuel(within(problem, None), price, free.upper, cost)
    if fuel is not None and (found := minimum_time(within(problem, Fraction(fuel * (1.0 + 1e-9))))).status is Status.PROVED:
        spent = (found.upper or np.inf) + price * fuel * (1.0 + 1e-9)
        best, cost = (found.command, spent) if found.command is not None and spent < cost else (best, cost)
    target, time, bounds = cost * (1.0 - close), free.lower, list[tuple[Fraction, Bound]]()
    while time < target and len(bounds) < MOST:
        budget = Fraction(float(np.nextafter((target - time) / price, np.inf)))  # not less than what the target asks for
        if bounds and budget >= bounds[-1][0]:
            break
        bounds.append((budget, found := minimum_time(within(problem, budget))))
        if found.status is Status.IMPOSSIBLE:
            time = np.inf
        elif found.status is Status.PROVED and found.lower >= time:
            time = found.lower
        else:
            break
    lower = target if time >= target else None
    return Weighted(price, lower, cost, best, tuple(bounds), extremal_prices(problem, best))


def _best_fuel(problem: Problem, price: float, fastest: float, cost: float) -> float | None:
    """The fuel at which `T + α U(T)` is least, in floating point."""

    def at(time: float) -> float:
        fuel = least_fuel_at(problem, time)
        return np.inf if fuel is None else time + price * fuel

    times = np.linspace(fastest, max(min(cost, LONGEST * fastest), fastest * 1.01), SCANNED)
    costs = np.array([at(float(time)) for time in times])
    k = int(np.argmin(costs))
    low, high, middle, best = times[max(k - 1, 0)], times[min(k + 1, SCANNED - 1)], float(times[k]), float(costs[k])
    for _ in range(ROUNDS):
        other = float(low + middle) / 2 if middle - low > high - middle else float(middle + high) / 2
        value = at(other)
        if value < best:
            low, high, middle, best = (low, middle, other, value) if other < middle else (middle, high, other, value)
        elif other < middle:
            low = other
        else:
            high = other
    return (best - middle) / price if np.isfinite(best) else None
