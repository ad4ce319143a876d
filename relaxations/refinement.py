"""From the grid to exact switch times: Newton's method in closed form.

The extremal command is bang-bang, its switches are the roots of the costate. Unknown are the switch times to go s_1 < … < s_m, the
maneuver time T and the costate λ; the equations are the moments (1), `p(s_i) = λᵀ b(s_i) = 0` and `λᵀ target = 1`. With as many unknown
instants as moments the costate decouples, with more the roots determine it, with fewer (degenerate optima) the equations are consistent
and solved in the least-squares sense.

A budget of fuel is one more moment, `∫ -|u| = -fuel`, its multiplier μ one more component of the costate. The command then is on a limit
where p is beyond μ on that side, and rests in between: at a switch from level v to level w `p = μ (|v| - |w|)/(v - w)`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command, Segment, Tail
from relaxations.duality import costate_roots
from relaxations.maneuvers import Problem
from relaxations.prices import Prices
from relaxations.tails import NO_TAIL, Contact, TailStart

Reals = NDArray[np.float64]

ITERATIONS = 40
PATTERNS = 6  # restarts with another sign pattern; two were the most that was seen to help
MOST_SWITCHES = 1500  # the dense system for them still fits the memory, and takes seconds
ROUNDING = 1e-11  # relative residual of the moments below which Newton may stop, as soon as it gains nothing more


EXCESS = 1e-10  # of the input's range, or a cap: a tail so far beyond a limit is beyond it, and not by rounding
INSIDE = 2e-13  # of the input's range, or a cap: how far a tail that touches a limit is kept inside it, so that balls can prove it there


@dataclass(frozen=True, slots=True)
class Extremal:
    """A command of full input, either way, and of rest where fuel has a price, that meets the moments: duration T [s], times to go of the
    switches (m, ascending), deviations of the input on the arcs between them (m + 1, in order of time to go), costate, tail, fuel's price.

    `problem` is the one in whose coordinates the costate is written.
    """

    problem: Problem
    maneuver_time: float
    switches_to_go: Reals
    levels: Reals
    costate: Reals
    residual: float  # relative residual of the moment equations
    iterations: int
    tail: TailStart = NO_TAIL
    fuel: float = 0.0

    def command(self, problem: Problem) -> Command:
        """The command in absolute input, its switches in order of time."""
        starts = [0.0, *(self.maneuver_time - self.switches_to_go[::-1])]
        arcs = {float(start): problem.absolute(float(level)) for start, level in zip(starts, self.levels[::-1], strict=True)}
        segments = tuple(Segment(start, level) for start, level in arcs.items())  # of arcs that a double cannot tell apart the last
        return Command(self.maneuver_time, segments, Tail(problem.absolute(problem.hold), problem.tail.terms(self.tail.coefficients)))

    @property
    def prices(self) -> Prices:
        """That of the fuel: an extremal has no other further limits."""
        return Prices(self.fuel)

    @property
    def exact_levels(self) -> list[Fraction]:
        """The input itself on the arcs, in order of time to go: a limit, or the one at rest."""
        maneuver = self.problem.maneuver
        named = {self.problem.upper: maneuver.limits.upper, self.problem.lower: maneuver.limits.lower}
        return [named.get(float(level), maneuver.rest) for level in self.levels]

    @property
    def tail_coefficients(self) -> Reals:
        """Coefficients of the tail."""
        return self.tail.coefficients

    @property
    def tail_multipliers(self) -> tuple[tuple[float, float, float], ...]:
        """(instant after the move [s], μ⁺, μ⁻) of every contact with a limit of the input."""
        on = [c for c in self.tail.contacts if c.cap is None]
        return tuple((c.place, c.multiplier, 0.0) if c.side > 0 else (c.place, 0.0, c.multiplier) for c in on)

    def price(self, problem: Problem) -> float:
        """What the contacts, and the fuel, take off the costate's target: `Σ μ room`."""
        contacts = np.array([contact.multiplier for contact in self.tail.contacts]) @ problem.tail.allowance(self.tail.contacts)
        return float(contacts) + self.fuel * (problem.fuel or 0.0)


@dataclass(frozen=True, slots=True)
class Failure:
    """Why no extremal command came of a start; `restart` is a better one, if there is any: a costate and a time [s] by whose signs to
    begin, a tail, and a price of fuel."""

    reason: str
    restart: tuple[Reals, float, TailStart, float] | None = None


def _arcs(problem: Problem, costate: Reals, maneuver_time: float, price: float) -> tuple[Reals, Reals]:
    """Times to go at which the command changes that a costate and a price of fuel ask for, and its levels in order of time to go."""
    if price == 0.0:
        switches = costate_roots(problem, costate, maneuver_time)
        final = float(costate @ problem.rows([switches[0] / 2 if len(switches) else maneuver_time / 2])[:, 0])
        one, other = (problem.upper, problem.lower) if final > 0 else (problem.lower, problem.upper)
        return switches, np.array([other if k % 2 else one for k in range(len(switches) + 1)])
    sides = [level for level, limit in ((price, problem.upper), (-price, problem.lower)) if limit]
    switches = np.sort(np.concatenate([costate_roots(problem, costate, maneuver_time, level) for level in sides]))
    edges = np.concatenate([[0.0], switches, [maneuver_time]])
    p = costate @ problem.rows((edges[1:] + edges[:-1]) / 2)
    levels = np.where(p > price, problem.upper, np.where(p < -price, problem.lower, 0.0))
    changed = np.diff(levels) != 0.0
    return switches[changed], levels[np.concatenate([[True], changed])]


def moment_residual(problem: Problem, levels: Reals, to_go: Reals) -> tuple[Reals, Reals]:
    """`∫ b u - aim(T)` for arcs of constant `levels` between the instants `to_go` (0 … T), and the size of the terms that cancel in it."""
    table = problem.rows(to_go, 1)
    sizes = (np.abs(table[:, 1:]) + np.abs(table[:, :-1])) @ np.abs(levels)  # a single arc's integral may vanish as a difference
    aim = problem.aimed(float(to_go[-1]))
    return np.diff(table, axis=1) @ levels - aim, np.maximum(sizes, np.abs(aim))


def refine(problem: Problem, costate: Reals, maneuver_time: float, tail: TailStart = NO_TAIL, fuel: float = 0.0) -> Extremal | Failure:
    """Newton's method from a costate, a maneuver time [s], a tail and a price of fuel of the grid.

    Returns the extremal command, or the reason why there is none: arcs that vanish or change order, no convergence, or multipliers whose
    signs are not the command's. The pattern is then wrong, and the costate that Newton's method came to may have a better one: only trying
    tells a costate that nearly touches zero from one that crosses it. The same goes for the tail: a contact whose price is negative is let
    go, and where the tail is beyond a limit it has another one.
    """
    found = _newton(problem, costate, maneuver_time, tail, fuel)
    for _ in range(PATTERNS):
        if isinstance(found, Extremal) or found.restart is None:
            break
        found = _newton(problem, *found.restart)
    return found


def outline(problem: Problem, costate: Reals, maneuver_time: float, tail: TailStart = NO_TAIL, fuel: float = 0.0) -> Extremal:
    """The command that a costate's signs ask for, nothing solved yet: where Newton's method starts."""
    return Extremal(problem, maneuver_time, *_arcs(problem, costate, maneuver_time, fuel), costate, np.inf, 0, tail, fuel)


def _newton(problem: Problem, costate: Reals, maneuver_time: float, tail: TailStart, fuel: float) -> Extremal | Failure:
    """Newton's method with the switches that the costate's signs ask for."""
    switches, levels = _arcs(problem, costate, maneuver_time, fuel)
    if len(switches) > MOST_SWITCHES:
        return Failure(f"{len(switches)} switches are more than Newton's method is tried for ({MOST_SWITCHES})")
    state = _State(problem, levels, tail.contacts)
    moving, price = [c.place for c in tail.contacts if c.moving], [fuel] if state.budget else []
    x = np.concatenate([switches, [maneuver_time], costate, price, tail.coefficients, [c.multiplier for c in tail.contacts], moving])
    count, best, relative = len(switches), np.inf, np.inf
    for iteration in range(ITERATIONS):
        values, matrix, relative = state.linearise(x)
        unit = state.units(x)
        step = -unit * np.linalg.lstsq(matrix * unit, values, rcond=None)[0]
        moved = float(np.abs(step[: count + 1]).max() / x[count])
        if relative <= ROUNDING and (moved <= 1e-14 or relative >= best / 2):
            break
        best = min(best, relative)
        # A step that would reorder the arcs is shortened: the start is only as good as the grid.
        share = 1.0
        while share > 1e-3 and not _ordered(x[: count + 1] + share * step[: count + 1]):
            share /= 2
        if not _ordered(x[: count + 1] + share * step[: count + 1]):
            _, time, multiplier, *_ = state.split(x)
            restart = multiplier[: problem.size], time, tail, max(float(multiplier[-1]), 0.0) if state.budget else 0.0
            return Failure(f"{count} switches: an arc vanishes in Newton's method after {iteration + 1} steps", restart)
        x = x + share * step
    else:
        return Failure(f"{count} switches: Newton's method did not converge in {ITERATIONS} steps (relative residual {relative:.1e})")
    s, time, multiplier, coefficients, prices, _ = state.split(x)
    contacts, price = state.touched(x), float(multiplier[-1]) if state.budget else 0.0
    multiplier = multiplier[: problem.size]
    if price < 0.0:
        return Failure(f"{count} switches: the fuel's multiplier is negative, so a command that uses it up is not extremal")
    found, asked = _arcs(problem, multiplier, time, price)
    if not np.array_equal(asked, levels) or (count and np.abs(found - s).max() > 1e-6 * time):
        reason = f"{count} switches: the refined costate has {len(found)} sign changes elsewhere, so the pattern is not extremal"
        return Failure(reason, (multiplier, time, TailStart(coefficients, contacts), price))
    if np.any(prices < 0.0):
        kept = tuple(c for k, c in enumerate(contacts) if k != np.argmin(prices))
        reason = f"{count} switches: a multiplier of the tail's limits is negative, so its contacts are not extremal"
        return Failure(reason, (multiplier, time, TailStart(coefficients, kept), price))
    if others := _beyond(problem, coefficients):
        reason = f"{count} switches: the tail is beyond its limits"
        return Failure(reason, (multiplier, time, TailStart(coefficients, (*contacts, *others)), price))
    return Extremal(problem, time, s, levels, multiplier, relative, iteration, TailStart(coefficients, contacts), price)


@dataclass(frozen=True, slots=True)
class _State:
    """The square system of an extremal: unknown are s (m), T, λ (size, and one for a budget), tail coefficients c (n), contact multipliers
    μ (a) and the places τ (k) of the contacts that move.

    Rows: moments `∫ b u = target + G c`; `p(s_i) = 0`; `λᵀ G + Σ μ e = 0`; `λᵀ target - Σ μ allowance = 1`; `e(τ) c = allowance` at the
    contacts, and `e'(τ) c = 0` at those that move. With a budget b is written with the fuel's row, which counts nothing in the targets.
    """

    problem: Problem
    levels: Reals
    contacts: tuple[Contact, ...]

    @property
    def budget(self) -> bool:
        """Whether fuel is limited."""
        return self.problem.fuel is not None

    @property
    def _ends(self) -> list[int]:
        """Where s, T, λ, c, μ and τ end in the list of unknowns."""
        a, k = len(self.contacts), sum(c.moving for c in self.contacts)
        return list(np.cumsum([len(self.levels) - 1, 1, self.problem.size + self.budget, self.problem.tail.size, a, k]))

    def split(self, x: Reals) -> tuple[Reals, float, Reals, Reals, Reals, Reals]:
        """The unknowns by name."""
        s, time, costate, coefficients, prices, instants = np.split(x, self._ends[:-1])
        return s, float(time[0]), costate, coefficients, prices, instants

    def touched(self, x: Reals) -> tuple[Contact, ...]:
        """The contacts with their multipliers and places."""
        *_, prices, places = self.split(x)
        moved, priced = iter(places), zip(self.contacts, prices, strict=True)
        return tuple(replace(c, place=float(next(moved)) if c.moving else c.place, multiplier=float(mu)) for c, mu in priced)

    def linearise(self, x: Reals) -> tuple[Reals, Reals, float]:
        """Residuals and their Jacobian, every row divided by the size of its terms, and the relative residual of moments and contacts."""
        problem, at = self.problem, slice
        m, _, end_lam, end_c, end_mu, width = self._ends
        lam, tail, mu = at(m + 1, end_lam), at(end_lam, end_c), at(end_c, end_mu)
        size, n, a = problem.size + self.budget, problem.tail.size, len(self.contacts)
        moments, roots, tails, scale = at(0, size), at(size, size + m), at(size + m, size + m + n), size + m + n
        touching, still = at(scale + 1, scale + 1 + a), at(scale + 1 + a, width)
        s, time, costate, coefficients, prices, _ = self.split(x)
        contacts, columns = self.touched(x), self._with_fuel(problem.tail.columns, 0.0)
        moving = [k for k, c in enumerate(contacts) if c.moving]
        shapes, slopes, bends = (problem.tail.touching(contacts, derivative) for derivative in range(3))
        room = problem.tail.allowance(contacts)
        inside = room - INSIDE * np.where([c.cap is None for c in contacts], problem.upper - problem.lower, room)
        matrix, values, sizes = np.zeros((width, width)), np.zeros(width), np.ones(width)
        missed, terms = moment_residual(problem, self.levels, np.concatenate([[0.0], s, [time]]))
        if self.budget:
            burnt = np.abs(self.levels) @ np.diff(np.concatenate([[0.0], s, [time]]))
            missed, terms = np.append(missed, (problem.fuel or 0.0) * (1.0 - INSIDE) - burnt), np.append(terms, burnt)
        jumps = np.append(self.levels[:-1] - self.levels[1:], self.levels[-1])
        shares = -np.append(np.abs(self.levels[:-1]) - np.abs(self.levels[1:]), np.abs(self.levels[-1]))
        shares = np.divide(shares, jumps, out=np.zeros(m + 1), where=jumps != 0.0)
        whole = problem.rows(np.append(s, time))
        b, end = self._with_fuel(whole[:, :-1], shares[:-1]), self._with_fuel(whole[:, -1:], shares[-1:])[:, 0]
        values[moments], sizes[moments] = missed - columns @ coefficients, terms + np.abs(columns) @ np.abs(coefficients)
        matrix[moments, :m], matrix[moments, m] = b * jumps[:-1], end * jumps[-1]
        matrix[moments, tail] = -columns
        values[roots], sizes[roots] = costate @ b, np.abs(costate) @ np.abs(b)
        matrix[roots, :m], matrix[roots, lam] = np.diag(self._turning(costate[: problem.size], s, whole[:, :-1])), b.T
        values[tails] = costate @ columns + prices @ shapes
        sizes[tails] = np.abs(costate) @ np.abs(columns) + np.abs(prices) @ np.abs(shapes)
        matrix[tails, lam], matrix[tails, mu], matrix[tails, end_mu:] = columns.T, shapes.T, (prices[:, None] * slopes)[moving].T
        aim, drift = (self._with_fuel(part, 0.0)[:, 0] for part in problem.aim(np.array([time])))
        matrix[moments, m] -= drift
        values[scale] = costate @ aim - prices @ room - 1.0
        sizes[scale] = np.abs(costate) @ np.abs(aim) + np.abs(prices) @ np.abs(room)
        matrix[scale, m], matrix[scale, lam], matrix[scale, mu] = costate @ drift, aim, -room
        values[touching], sizes[touching] = shapes @ coefficients - inside, np.abs(shapes) @ np.abs(coefficients) + np.abs(inside)
        matrix[touching, tail] = shapes
        matrix[[scale + 1 + k for k in moving], range(end_mu, width)] = (slopes @ coefficients)[moving]
        values[still], sizes[still] = (slopes @ coefficients)[moving], (np.abs(slopes) @ np.abs(coefficients))[moving]
        matrix[still, tail], matrix[still, end_mu:] = slopes[moving], np.diag((bends @ coefficients)[moving])
        sizes[sizes == 0.0] = 1.0
        values /= sizes
        return values, matrix / sizes[:, None], float(np.abs(np.concatenate([values[moments], values[touching]])).max())

    def _turning(self, costate: Reals, s: Reals, rows: Reals) -> Reals:
        """p' at the switches, where b has these rows."""
        transition = self.problem.transition
        return self.problem.derivative(costate) @ rows if transition is None else costate @ transition.slopes(s)

    def _with_fuel(self, rows: Reals, share: float | Reals) -> Reals:
        """Rows of the moments, and the one of the fuel if there is a budget."""
        return np.vstack([rows, np.broadcast_to(share, rows.shape[1:])]) if self.budget else rows

    def units(self, x: Reals) -> Reals:
        """The size of each unknown: a component of the costate is as large as its share in p, else fast rows would hide the others."""
        s, time, costate, coefficients, prices, places = self.split(x)
        reach = np.abs(self._with_fuel(self.problem.rows(np.concatenate([[0.0], s, [time]])), 1.0)).max(axis=1)
        reach[reach == 0.0] = 1.0
        share = np.abs(costate) * reach
        largest = max(float(np.abs(coefficients).max(initial=0.0)), 1e-8 * (self.problem.upper - self.problem.lower))
        tails, contacts = np.full(len(coefficients), largest), np.full(len(prices), max(prices, default=1.0) or 1.0)
        costates = np.maximum(share, share.max() * 1e-8) / reach
        moving = [c for c in self.contacts if c.moving]
        turns = [1.0 if c.cap is not None else max(place, 1e-8 * time) for c, place in zip(moving, places, strict=True)]
        return np.concatenate([np.full(len(s) + 1, time), costates, tails, contacts, turns])


def _beyond(problem: Problem, coefficients: Reals) -> tuple[Contact, ...]:
    """New contacts where a tail is beyond its limits by more than rounding: a cap, the input's in its course or at an instant known."""
    tail = problem.tail
    for k, (cap, size) in enumerate(zip(tail.caps, tail.sizes(coefficients), strict=True)):
        if size > cap.bound * (1.0 + EXCESS):
            return (tail.capped(k, coefficients, 0.0),)
    known = tail.known
    instants = np.concatenate([known, tail.exceeded(coefficients).instants])
    course, (above, below) = tail.rows(instants) @ coefficients, tail.room(instants)
    over = np.maximum(course - above, -course - below)
    if not np.any(over > EXCESS * (problem.upper - problem.lower)):
        return ()
    worst = int(np.argmax(over))
    return (Contact(float(instants[worst]), 1 if course[worst] > 0.0 else -1, 0.0, worst >= len(known)),)


def _ordered(instants: Reals) -> bool:
    """Whether the switches' times to go and the duration after them ascend from 0."""
    return bool(np.all(np.diff(np.concatenate([[0.0], instants])) > 0))
