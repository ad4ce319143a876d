"""Newton's method on an extremal once more, in arithmetic of many digits: for long chains of modes double precision ends (condition 10⁶ at
40 poles), and a command written with 40 digits makes both sides of a bracket agree to the last bit of a double.

The same square system as in `relaxations.refinement`; python-flint's balls serve as long floats here, nothing is proven.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import comb, factorial

from flint import acb, arb, arb_mat, fmpq

from relaxations.maneuvers import Problem
from relaxations.plants import Pole, precision
from relaxations.refinement import Extremal
from relaxations.tails import Contact, cap_bound

BITS, BITS_PER_EQUATION = 192, 4  # the condition of a chain's equations grows with every mode
ITERATIONS = 30
MOST_EQUATIONS = 250  # the dense system of so many is solved in seconds
SHARES = (1, 0.5, 0.25, 0.125, 2.0**-4, 2.0**-6, 2.0**-8)
DIGITS = 45  # of the numbers handed on
INSIDE = Fraction(1, 10**30)  # of the input's range, or a cap: how far a tail that touches a limit is kept inside it


@dataclass(frozen=True, slots=True)
class Polished:
    """An extremal in exact decimals of many digits: duration T [s], starts [s], costate rows, tail coefficients and contact multipliers."""

    maneuver_time: Fraction
    starts: tuple[Fraction, ...]
    costate: tuple[Fraction, ...]
    tail: tuple[Fraction, ...]
    multipliers: tuple[tuple[Fraction, Fraction, Fraction], ...]  # (instant after the move [s], μ⁺, μ⁻)


@dataclass(frozen=True, slots=True)
class _Exact:
    """The problem with its roots to full precision: rows as in `relaxations.moments.Basis`."""

    roots: tuple[tuple[acb, int, bool], ...]
    target: list[arb]
    zeros: tuple[tuple[acb, int, bool], ...]
    columns: list[list[arb]]  # columns[j][row]

    def rows(self, s: arb, integrated: bool) -> list[arb]:
        """b(s), or its integral from 0, as real rows."""
        out: list[arb] = []
        for root, multiplicity, flexible in self.roots:
            below = acb(1)
            growth = (root * s).exp()
            for k in range(multiplicity):
                value = growth * s**k / factorial(k)
                if integrated:
                    below = acb(s ** (k + 1) / factorial(k + 1)) if root.is_zero() else (value - below) / root
                    value = below
                out += [value.real, value.imag] if flexible else [value.real]
        return out

    def derivative(self, costate: Sequence[arb]) -> list[arb]:
        """The costate of `d/ds λᵀb`."""
        out, at = [], 0
        for root, multiplicity, flexible in self.roots:
            width = 2 if flexible else 1
            chain = [acb(costate[at + width * k], -costate[at + width * k + 1] if flexible else 0) for k in range(multiplicity)]
            at += width * multiplicity
            for k in range(multiplicity):
                changed = chain[k] * root + (chain[k + 1] if k + 1 < multiplicity else 0)
                out += [changed.real, -changed.imag] if flexible else [changed.real]
        return out

    def shape(self, r: arb, derivative: int) -> list[arb]:
        """The tail's `derivative` by time at r [s] for each unit coefficient."""
        out: list[arb] = []
        for zero, multiplicity, flexible in self.zeros:
            decay = (zero * r).exp()
            chain = [decay * r**power / factorial(power) for power in range(multiplicity)]
            for power in range(multiplicity):
                lower = range(min(derivative, power) + 1)
                value = sum((comb(derivative, i) * zero ** (derivative - i) * chain[power - i] for i in lower), acb(0))
                out += [value.real, -value.imag] if flexible else [value.real]
        return out

    def touching(self, problem: Problem, contact: Contact, place: arb, derivative: int) -> list[arb]:
        """`TailSpace.touching` of one contact."""
        if contact.cap is None:
            return [contact.side * value for value in self.shape(place, derivative)]
        row, turned = [arb(0)] * len(self.columns), place + derivative * arb.pi() / 2
        for j, value in zip(problem.tail.caps[contact.cap].at, (turned.cos(), turned.sin()), strict=False):
            row[j] = contact.side * value
        return row

    def allowance(self, problem: Problem, contact: Contact) -> arb:
        """`TailSpace.allowance` of one contact."""
        if contact.cap is None:
            return arb(_q(_exact_room(problem, contact.place, contact.side)))
        (plant,), cap = problem.plants, problem.tail.caps[contact.cap]
        zero, multiplicity, _ = self.zeros[cap.zero]
        return cap_bound(plant, zero, multiplicity, cap.sensitivity, problem.maneuver.displacement).mid()


def _q(value: Fraction) -> fmpq:
    return fmpq(value.numerator, value.denominator)


def _roots(wanted: Sequence[Pole], polynomials: Sequence) -> tuple[tuple[acb, int, bool], ...]:
    found = [ball for polynomial in polynomials if polynomial.degree() > 0 for ball, _ in polynomial.complex_roots()]
    chosen = []
    for pole in wanted:
        near = min(found, key=lambda ball: abs(complex(float(ball.real.mid()), float(ball.imag.mid())) - pole.value))
        chosen.append((acb(near.real.mid(), near.imag.mid()), pole.multiplicity, pole.is_flexible))
    return tuple(chosen)


def _exact(problem: Problem) -> _Exact:
    (plant,) = problem.plants
    maneuver = problem.maneuver
    roots = _roots(problem.sets[0].basis.poles, [plant.denominator])
    zeros = _roots(problem.tail.zeros, [plant.numerators[plant.output]])
    hold = _q(plant.rest_input(maneuver.displacement))
    target: list[arb] = []
    for root, multiplicity, flexible in roots:
        for k in range(multiplicity):
            if root.is_zero():
                lowest, static = plant.denominator.coeffs()[multiplicity], plant.numerators[plant.output](fmpq(0))
                value = acb(_q(maneuver.displacement) * lowest / static) if k == multiplicity - 1 else acb(0)
            else:
                value = acb(hold) / (-root) ** (k + 1)
            target += [value.real, value.imag] if flexible else [value.real]
    columns = []
    for zero, powers, pair in zeros:
        for power in range(powers):
            for unit in (acb(1), acb(0, 1)) if pair else (acb(1),):
                column: list[arb] = []
                for root, multiplicity, flexible in roots:
                    for k in range(multiplicity):
                        factor = comb(k + power, power) * (-1) ** power
                        one, other = (factor / (z - root) ** (k + power + 1) for z in (zero, zero.conjugate()))
                        value = (unit * one + unit.conjugate() * other) / 2
                        column += [value.real, value.imag] if flexible else [value.real]
                columns.append(column)
    return _Exact(roots, target, zeros, columns)


def polish(problem: Problem, extremal: Extremal, bits: int | None = None) -> Polished | None:
    """The extremal to some 45 digits, or None if Newton's method leaves it (degenerate optima have no square system).

    It may also start from a mere outline (`relaxations.refinement.outline`), where double precision has failed.
    """
    if len(problem.plants) != 1 or problem.size + len(extremal.switches_to_go) > MOST_EQUATIONS:
        return None
    bits = bits or BITS + BITS_PER_EQUATION * problem.size
    with precision(bits):
        try:
            return _polish(problem, extremal, _exact(problem), bits)
        except ZeroDivisionError:
            return None


def _polish(problem: Problem, extremal: Extremal, exact: _Exact, bits: int) -> Polished | None:
    contacts = extremal.tail.contacts
    m, size, n, a = len(extremal.switches_to_go), problem.size, problem.tail.size, len(contacts)
    moving = [k for k, contact in enumerate(contacts) if contact.moving]
    if m + 1 + n < size + a:
        return None
    levels = [arb(_q(_level(problem, level))) for level in extremal.levels(problem)]
    x = [
        *extremal.switches_to_go,
        extremal.maneuver_time,
        *extremal.costate,
        *extremal.tail.coefficients,
        *(c.multiplier for c in contacts),
        *(contacts[k].place for k in moving),
    ]
    x = [arb(float(value)) for value in x]
    room = [exact.allowance(problem, c) for c in contacts]
    reach = arb(_q(problem.maneuver.limits.upper - problem.maneuver.limits.lower))
    inside = [r - arb(_q(INSIDE)) * (reach if c.cap is None else r) for c, r in zip(contacts, room, strict=True)]
    lam, tail, mu, tau = m + 1, m + 1 + size, m + 1 + size + n, m + 1 + size + n + a
    width = tau + len(moving)
    distance = None
    for _ in range(ITERATIONS):
        s, time, costate, c, prices = x[:m], x[m], x[lam:tail], x[tail:mu], x[mu:tau]
        places = [arb(contact.place) for contact in contacts]
        for place, k in enumerate(moving, tau):
            places[k] = x[place]
        shapes, slopes, bends = ([exact.touching(problem, c, r, d) for c, r in zip(contacts, places, strict=True)] for d in range(3))
        matrix = [[arb(0)] * width for _ in range(width)]
        values = [arb(0)] * width
        table = [exact.rows(at, True) for at in (*s, time)]
        at_roots, end = [exact.rows(at, False) for at in s], exact.rows(time, False)
        slope = exact.derivative(costate)
        for row in range(size):
            total, before = -exact.target[row], arb(0)
            for i in range(m + 1):
                total += levels[i] * (table[i][row] - before)
                before = table[i][row]
            values[row] = total - sum((exact.columns[j][row] * c[j] for j in range(n)), arb(0))
            for i in range(m):
                matrix[row][i] = at_roots[i][row] * (levels[i] - levels[i + 1])
                matrix[size + i][lam + row] = at_roots[i][row]
            matrix[row][m] = levels[m] * end[row]
            for j in range(n):
                matrix[row][tail + j] = -exact.columns[j][row]
                matrix[size + m + j][lam + row] = exact.columns[j][row]
            matrix[size + m + n][lam + row] = exact.target[row]
        for i in range(m):
            values[size + i] = sum((p * q for p, q in zip(costate, at_roots[i], strict=True)), arb(0))
            matrix[size + i][i] = sum((p * q for p, q in zip(slope, at_roots[i], strict=True)), arb(0))
        for j in range(n):
            pulled = sum((p * q for p, q in zip(costate, exact.columns[j], strict=True)), arb(0))
            values[size + m + j] = pulled + sum((prices[k] * shapes[k][j] for k in range(a)), arb(0))
            for k in range(a):
                matrix[size + m + j][mu + k] = shapes[k][j]
            for place, k in enumerate(moving, tau):
                matrix[size + m + j][place] = prices[k] * slopes[k][j]
        scaled = sum((p * q for p, q in zip(costate, exact.target, strict=True)), arb(0))
        values[size + m + n] = scaled - sum((p * r for p, r in zip(prices, room, strict=True)), arb(0)) - 1
        for k in range(a):
            matrix[size + m + n][mu + k] = -room[k]
            values[size + m + n + 1 + k] = sum((shapes[k][j] * c[j] for j in range(n)), arb(0)) - inside[k]
            for j in range(n):
                matrix[size + m + n + 1 + k][tail + j] = shapes[k][j]
        for place, k in enumerate(moving, tau):
            slope, bend = (sum((line[j] * c[j] for j in range(n)), arb(0)) for line in (slopes[k], bends[k]))
            values[place - tau + size + m + n + 1 + a] = slope
            matrix[size + m + n + 1 + k][place] = slope
            matrix[place - tau + size + m + n + 1 + a][place] = bend
            for j in range(n):
                matrix[place - tau + size + m + n + 1 + a][tail + j] = slopes[k][j]
        step = arb_mat([[v.mid() for v in row] for row in matrix]).solve(arb_mat([[v.mid()] for v in values]))
        # A step that would reorder the arcs is shortened: a start may be no better than the grid.
        share = next((share for share in SHARES if _ordered([x[i] - share * step[i, 0] for i in range(m + 1)])), None)
        if share is None:
            return None
        x = [(value - share * step[i, 0]).mid() for i, value in enumerate(x)]
        moved = max(float(abs(step[i, 0]).mid()) for i in range(m + 1)) / float(x[m].mid())
        if not moved < 1e3 or (distance is not None and distance < 1e-6 and moved > distance):
            return None
        if moved < 2.0 ** (-bits // 2):
            break
        distance = moved
    else:
        return None
    numbers = [_decimal(value) for value in x]
    time = numbers[m]
    starts = (Fraction(0), *(time - value for value in reversed(numbers[:m])))
    if any(after <= before for before, after in zip(starts, (*starts[1:], time), strict=True)):
        return None
    prices = [max(value, Fraction(0)) for value in numbers[mu:tau]]
    at = [Fraction(contact.place) for contact in contacts]
    for place, k in enumerate(moving, tau):
        at[k] = max(numbers[place], Fraction(0))
    triples = [(c.side, r, price) for c, r, price in zip(contacts, at, prices, strict=True) if c.cap is None]
    pairs = tuple((r, price, Fraction(0)) if side > 0 else (r, Fraction(0), price) for side, r, price in triples)
    return Polished(time, starts, tuple(numbers[lam:tail]), tuple(numbers[tail:mu]), pairs)


def _ordered(instants: list[arb]) -> bool:
    """Whether times to go and the duration after them ascend from 0."""
    return all(before < after for before, after in itertools.pairwise([arb(0), *instants]))


def _level(problem: Problem, deviation: float) -> Fraction:
    limits, rest = problem.maneuver.limits, problem.maneuver.rest
    return (limits.upper if deviation == problem.upper else limits.lower) - rest


def _exact_room(problem: Problem, since: float, side: int) -> Fraction:
    """How far a tail may be from its rest value, above or below."""
    maneuver = problem.maneuver
    final = maneuver.rest + problem.plants[0].rest_input(maneuver.displacement)
    above, below = maneuver.limits.upper - final, final - maneuver.limits.lower
    if maneuver.tail_length is not None and since >= float(maneuver.tail_length[0]):
        tight = maneuver.tail_length[1] * min(above, below)
        above, below = min(above, tight), min(below, tight)
    return above if side > 0 else below


def _decimal(value: arb) -> Fraction:
    return Fraction(value.str(DIGITS, radius=False, more=True))
