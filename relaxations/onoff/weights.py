"""Fuel and time weighted against each other: `J = ∫_0^T (1 + α |u|) dt = T + α fuel`, T free.

*Check.* By Pontryagin's maximum principle a command that minimises J has a costate with p beyond α, on its side, where it is on, |p| ≤ α
(the dead zone) where it rests, and `|p(T)| - α` times the thrust = 1 at the beginning (the Hamiltonian vanishes). All are linear in (λ, α):
the prices for which they can be met are an interval, or none. `extremal_prices` finds it, on a dense grid of the costate (floating point).

*Warning.* To be extremal is not to be a minimiser. The least time T(U) within a budget is not convex: between the nodes of that curve a
command that is the fastest within its budget is extremal for one price, at which its neighbours on either side cost less. Only the nodes
(and the fastest command) minimise J, and only a bound of all commands says so.

*Bound.* At a given T the least fuel is a linear program, whose costate bounds the cost of all commands that take about as long: costates
for all times up to the cost (`relaxations.onoff.covers`) refute every command that is cheaper. They and the command are one certificate,
about the cost itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations import certificates
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem
from relaxations.onoff.covers import cover, least_at, saved
from relaxations.onoff.duals import Looks
from relaxations.onoff.spent import within
from relaxations.proofs import minimum_time
from relaxations.sides import rounded

Reals = NDArray[np.float64]
Pieces = list[tuple[Fraction, Fraction, dict[str, Any]]]  # begin and end of maneuver times [s], and a costate's witness

SAMPLES = 4000  # of the costate
SLACK = 1e-9  # of the prices' scale: how exactly the switches are met
THIN = 1e-5  # of the duration, or the input's range: what is so small is none
CLOSE = (1e-15, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9)  # beyond what a command costs in floating point, where that is claimed (relative)
MARGINS = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)  # … and beneath the least cost that was found
BEYOND = (0.0, 1e-10, 1e-9, 1e-8)  # how far beyond the cheapest fuel a budget is (relative)
SCANNED, ROUNDS = 16, 36  # times at which the least fuel is computed first, and steps of the search around the best of them
EACH_PERIOD, MOST_SCANNED = 5, 160  # times for each period of the slowest mode: every node may be a valley of its own
BESIDE = (1e-6, 1e-5, 1e-4, 1e-3)  # … and times beside the fastest move (relative), for small prices
SETTLED = 1e-10  # of the time: bounds of the best one that are closer are as good as one
STRIDE, STEPS, MET = 1e-5, 6, 1e-7  # of the budget, and of the secant for the one whose price is asked for; SLACK tells no closer
ALIKE = 1e-14  # relative: costs that differ by less are equal


@dataclass(frozen=True, slots=True)
class Weighted:
    """A bracket of the least `T + α fuel` [s] for a `price` α.

    `lower` and `upper` are proven by `certificate`; None is a side that is not, of `upper` then `computed` is what the command costs in
    floating point. `prices` is the interval of α for which the command is extremal (None: for none).
    """

    price: Fraction
    lower: float | None
    upper: float | None
    computed: float
    command: Command
    prices: tuple[float, float] | None
    certificate: bytes | None

    @property
    def gap(self) -> float | None:
        """`upper/lower - 1`; None if a side is missing."""
        return None if self.lower is None or self.upper is None else self.upper / self.lower - 1.0

    def minimises(self, cost: float) -> bool | None:
        """Whether a command of this cost [s] is a minimiser, to within the bracket: False: proven that it is none; None: not decided."""
        if self.upper is not None and cost > self.upper:
            return False
        return None if self.lower is None or self.upper is None else True

    @property
    def extremal(self) -> bool:
        """Whether the command passes the check of the maximum principle for this price."""
        price = float(self.price)
        return self.prices is not None and self.prices[0] * (1.0 - 1e-4) <= price <= self.prices[1] * (1.0 + 1e-4)


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


def weighted(problem: Problem, price: Fraction) -> Weighted:
    """Bracket the least `T + α fuel` of moves from rest to state rest, within limits of the input alone; its own budget does not count.

    Raises `ManeuverError` for a price that is none, for another task, and where no fastest command is proven.
    """
    if not price > 0:
        raise ManeuverError(f"a price of fuel is more than 0, not {float(price)!r}; at 0 it is the minimum time")
    _require(problem)
    posed, alpha = within(problem, None), float(price)
    free = minimum_time(posed)
    if free.upper is None or free.command is None or free.status is not Status.PROVED or free.certificate is None:
        raise ManeuverError(f"the minimum time is not proven: {free.reason or free.status.value}")
    cheapest, fuel = _best(posed, alpha, free.upper, free.upper + alpha * free.command.fuel(posed.rest))
    bounds = [free, *([] if fuel is None else _bounds(posed, alpha, cheapest, fuel))]

    def costs(bound: Bound) -> float:
        return np.inf if bound.command is None or bound.upper is None else bound.upper + alpha * bound.command.fuel(posed.rest)

    best = min(bounds, key=costs)
    if costs(beside := _priced(posed, alpha, best)) <= costs(best) * (1.0 + ALIKE):
        best = beside
    task, cost = certificates.task(posed), costs(best)
    assert best.command is not None
    upper, witness = _above(task, price, best, cost)
    lower, pieces = _below(posed, task, price, min(cheapest, cost))
    claim = {"lower": lower and certificates.text(lower), "upper": upper and certificates.text(upper)}
    content = certificates.cost_certificate(task, price, claim, pieces, witness) if lower or upper else None
    below, above = None if lower is None else rounded(lower, -np.inf), None if upper is None else rounded(upper, np.inf)
    return Weighted(price, below, above, float(cost), best.command, extremal_prices(posed, best.command), content)


def _bounds(problem: Problem, price: float, cheapest: float, fuel: float) -> list[Bound]:
    """Proven minimum times within about the cheapest fuel, until one costs hardly more: just enough of it has few commands."""
    found: list[Bound] = []
    for more in BEYOND:
        bound = minimum_time(within(problem, Fraction(fuel * (1.0 + more))), near=cheapest - price * fuel)
        if bound.status is Status.PROVED and bound.command is not None and bound.upper is not None:
            found.append(bound)
            if bound.upper + price * fuel <= cheapest * (1.0 + MARGINS[0]):
                break
    return found


def _priced(problem: Problem, price: float, found: Bound) -> Bound:
    """The fastest command beside one whose price is nearest to the one asked for, by a secant for its budget: between nodes the price
    changes smoothly with it."""
    best, known = found, list[tuple[float, float]]()  # budgets, and how far their prices are off
    for _ in range(STEPS):
        prices = None if found.command is None else extremal_prices(problem, found.command)
        if found.status is not Status.PROVED or found.command is None or prices is None:
            break
        known.append((found.command.fuel(problem.rest), float(np.clip(price, *prices)) / price - 1.0))
        (a, f), (b, g) = (known[-2:] * 2)[:2]
        if len(known) > 1 and not abs(g) < abs(f):
            break
        best = found
        if abs(g) <= MET:
            break
        budget = b * (1.0 + np.copysign(STRIDE, g)) if len(known) == 1 else b - g * (b - a) / (g - f)
        found = minimum_time(within(problem, Fraction(budget)), near=found.upper)
    return best


def _require(problem: Problem) -> None:
    limits = problem.maneuver.limits
    limited = problem.courses or problem.rate is not None or limits.pulsed or limits.held or problem.maneuver.sample_time is not None
    if limited or problem.tail.size or problem.residuals is not None or problem.begin is not None or problem.transition is not None:
        raise ManeuverError("fuel is weighted against time for moves from rest to state rest, within limits of the input alone")
    if problem.hold:
        raise ManeuverError("a plant that its input holds at the target burns fuel for ever: no price of it makes sense")


def _above(task: dict[str, Any], price: Fraction, bound: Bound, cost: float) -> tuple[Fraction | None, dict[str, Any] | None]:
    """The least cost that the checker accepts of a command, and its witness; None if it accepts none."""
    witness = json.loads(bound.certificate or b"null")["upper"]
    for margin in CLOSE:
        claimed = Fraction(cost * (1.0 + margin))
        content = certificates.cost_certificate(task, price, {"lower": None, "upper": certificates.text(claimed)}, None, witness)
        if check(content).outcome is Outcome.PROVED:
            return claimed, witness
    return None, None


def _below(problem: Problem, task: dict[str, Any], price: Fraction, cost: float) -> tuple[Fraction | None, Pieces | None]:
    """The largest cost of which the checker accepts that no command costs less, and its witness; None if there is none."""
    for margin in MARGINS:
        claimed = Fraction(cost * (1.0 - margin))
        found = cover(problem, float(price), float(claimed) * (1.0 + margin / 4.0))
        if found is None:
            continue
        ends = [Fraction(piece.end) for piece in found]
        begins = [Fraction(0), *ends[:-1]]
        witnesses = [certificates.costate_witness(problem, piece.costate) for piece in found]
        pieces = list(zip(begins, ends, witnesses, strict=True))
        content = certificates.cost_certificate(task, price, {"lower": certificates.text(claimed), "upper": None}, pieces, None)
        if check(content).outcome is Outcome.PROVED:
            return claimed, pieces
    return None, None


def _best(problem: Problem, price: float, fastest: float, cost: float) -> tuple[float, float | None]:
    """The least `T + α U(T)` in floating point, U the least fuel, and that fuel; of the fastest command, what it `cost`s, and None.

    The slope `1 - σ(p(T))` of it is known with it: where the tangents on both sides of the least value meet, and where their slope
    vanishes, is looked first; near a node, where the costate is not found closely, the halves.
    """

    def at(time: float) -> tuple[float, float, float]:
        found = least_at(problem, time)
        if found is None:
            return time, np.inf, -np.inf
        looks, dual = found
        return time, time + price * dual.value, 1.0 - price * float(saved(looks, dual.costate, np.array([time]))[0])

    times = np.geomspace(fastest, max(cost, fastest * 1.01), SCANNED)  # who takes longer than the best so far costs, costs more
    looked = [at(float(time)) for time in (*times, *(fastest * (1.0 + share) for share in BESIDE))]
    end = max(min(cost, *(value for _, value, _ in looked)), fastest * 1.01)
    slowest = max((2.0 * np.pi / abs(pole) for pole in problem.poles if pole.imag), default=np.inf)
    count = int(np.clip(EACH_PERIOD * (end - fastest) / slowest, SCANNED, MOST_SCANNED))
    looked += [at(float(time)) for time in np.linspace(fastest, end, count + 1)[1:]]
    for turn in range(ROUNDS):
        looked.sort()
        k = min(range(len(looked)), key=lambda i: looked[i][1])
        (a, f, slope), (b, g, rise) = looked[max(k - 1, 0)], looked[min(k + 1, len(looked) - 1)]
        middle, least, _ = looked[k]
        bent = np.isfinite(f) and slope < 0.0 < rise
        guesses = [(f - g + rise * b - slope * a) / (rise - slope), a - slope * (b - a) / (rise - slope)] if bent else []
        guesses.append((a + middle) / 2 if middle - a > b - middle else (middle + b) / 2)
        time = guesses[turn % len(guesses)]
        if b - a <= SETTLED * b or not min(abs(time - one) for one in (a, middle, b)) > SETTLED * b:
            if turn % len(guesses) == len(guesses) - 1:
                break
            continue
        looked.append(at(float(time)))
    middle, least, _ = min(looked, key=lambda one: one[1])
    return (least, (least - middle) / price) if least < cost else (cost, None)
