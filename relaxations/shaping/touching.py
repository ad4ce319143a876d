"""Least durations where a mode decays by more than programs in doubles tell: from where the function of the multipliers touches 0.

Of the shortest positive shaper with zeros at modes the function `f = Re Σ y_ij* z_ij` vanishes at its impulses, with its slope at the inner
ones. Where these are as many linear equations as coefficients, one that stays a little above 0 there, by ε in units of what the impulse
counts for, refutes a duration that is shorter by a few ε. Of more impulses than that the coefficients vary between -1 and 1 times their own
size, for a duration a little shorter: those of the largest margin, of f by the sum of the sizes of its terms, are a linear program on
instants that lie close about the impulses. Both are solved in as many digits as the decay of the modes takes, and f is proven positive in
balls (relaxations.checking.durations).

Of partial sums S = 1 - x up to 1 with dips x the same is asked of f' in place of f, and f > 0 at the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from math import comb, perm

import flint
from flint import acb, arb, arb_mat

from relaxations.checking.durations import Condition, none_as_short, none_of_dips, none_of_sums_up_to_one
from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import Vector
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.simplex import cheapest

ABOVE = (1e-9, 1e-7)  # ε
BELOW = (4.0, 64.0)  # times ε, for each impulse: how much shorter is tried
BITS = 192
MOST_FOLDS = 2000.0  # of decay: more cells than a proof takes
SHORTER = (1e-6, 1e-5, 1e-4, 1e-3)  # relative: how much shorter is tried where there are more impulses
CLOSELY = (4e-16, 1e-13, 1e-10, 1e-8)  # of edges in as many digits as it takes
COARSE, PER_TURN = 60, 16  # instants at which f is looked at, and for each damped period of the fastest mode
CLOSEST, GROWING, STEPS = 1e-6, 1.5, 22  # of the duration: about each impulse
Terms = Sequence[tuple[Mode, int]]


Places = Sequence[tuple[arb, arb]]
"""Instants [s] before the end, the last of them 0, with what is there."""


def least_of_positive(zeros: Sequence[Mode], shaper: Shaper, derivatives: int = 0) -> float | None:
    """The least duration [s], *proven*, of positive shapers with these zeros, and so many derivatives, from the shortest; None if it is not
    that or not proven.
    """
    times, amplitudes = shaper.times, shaper.amplitudes
    if len(times) <= len(zeros) * (derivatives + 1) or min(amplitudes) <= 0.0:
        return None
    terms = [(zero, power) for zero in zeros for power in range(derivatives + 1)]
    with precision(bits := _bits(zeros, shaper.duration)):
        end = arb(times[-1])
        (first, size), *later = [(arb(t) - end, arb(a)) for t, a in zip(times, amplitudes, strict=True)]
        scaled = _scaled(row(terms, first, 1), size * end), arb(1)
        return _least(terms, later, end, scaled, bits, dips=False)


def least_up_to_one_of(zeros: Sequence[Mode], dips: Sequence[tuple[arb, arb]], derivatives: int = 0) -> float | None:
    """The same of partial sums up to 1, from dips of one depth at (begin, end) [s] that leave nothing of the zeros."""
    if len(dips) < len(zeros) * (derivatives + 1):
        return None
    terms = [(zero, power) for zero in zeros for power in range(derivatives + 1)]
    with precision(bits := max(_bits(zeros, float(dips[-1][1])), flint.ctx.prec)):
        end = (dips[-1][0] + dips[-1][1]) / 2
        places = [((begin + until) / 2 - end, until - begin) for begin, until in dips]
        scaled = _scaled(row(terms, places[-1][0], 2), places[-1][1] * end), arb(-1)
        return _least(terms, places, end, scaled, bits, dips=True)


def least_of_dips(zeros: Sequence[Mode], dips: Sequence[tuple[arb, arb]], derivatives: int, lower: Fraction) -> float | None:
    """The same of partial sums in [lower, 1], of dips whose edges are those of the shortest: there f' is 0, but for the last one."""
    terms = [(zero, power) for zero in zeros for power in range(derivatives + 1)]
    if len(dips) < len(terms):
        return None
    folds = max(zero.damping * zero.frequency for zero in zeros) * float(dips[-1][1])
    with precision(bits := max(BITS + math.ceil(2.0 * min(folds, MOST_FOLDS) / math.log(2.0)), flint.ctx.prec)):
        end = dips[-1][1]
        edges = [*(begin for begin, _ in dips), *(until for _, until in dips[:-1])][: 2 * len(terms) - 1]
        rows = [row(terms, edge - end, 1) for edge in edges]
        found = solution([*rows, row(terms, -end, 0)], [arb(0)] * len(rows) + [arb(1)])
        for less in CLOSELY if found else ():
            claimed = float(end) * (1.0 - less)
            if none_of_dips(Fraction(claimed), conditions_of(terms, found), lower, bits):
                return claimed
    return None


def _least(terms: Terms, places: Places, end: arb, scaled: tuple[Vector, arb], bits: int, dips: bool) -> float | None:
    """f, or of dips f', has its zeros at these places; `scaled`: the equation that tells how large it is."""
    order = int(dips)
    proof = none_of_sums_up_to_one if dips else none_as_short
    touched = [_scaled(row(terms, place, order), weight) for place, weight in places]
    level = [_scaled(row(terms, place, order + 1), weight) for place, weight in places[:-1]]
    if len(touched) == len(terms):
        for above in ABOVE:
            right = [arb(above)] * len(touched) + [arb(0)] * len(level) + [scaled[1]]
            found = solution([*touched, *level, scaled[0]], right)
            for less in BELOW:
                claimed = float(end) * (1.0 - less * (len(places) + 1) * above)
                if found and proof(Fraction(claimed), conditions_of(terms, found), bits=bits):
                    return claimed
        return None
    count = 2 * len(terms) - 1 - len(touched)
    own = solution([*touched, *level[:count], scaled[0]], [arb(0)] * (len(touched) + count) + [scaled[1]])
    for less in SHORTER if own and 0 <= count <= len(level) else ():
        claimed = float(end) * (1.0 - less)
        found = _widest(terms, [float(place) for place, _ in places], own, claimed, order)
        if found and proof(Fraction(claimed), conditions_of(terms, found), bits=bits):
            return claimed
    return None


def _widest(terms: Terms, places: Sequence[float], own: Vector, duration: float, order: int) -> Vector:
    """Coefficients, none larger than its `own`, of the function that lies farthest above 0; none where that is nowhere."""
    fastest = max(math.pi / zero.half_period for zero, _ in terms)
    looks = COARSE + math.ceil(PER_TURN * duration * fastest / (2.0 * math.pi))
    instants = {-duration * k / looks for k in range(looks + 1)}
    for place in places:
        for side in (-1.0, 1.0):
            instants |= {place + side * duration * CLOSEST * GROWING**k for k in range(STEPS)} | {place}
    since = sorted(t for t in instants if -duration <= t <= 0.0)
    columns = [row(terms, arb(t), order) for t in since]
    if order:  # f itself at the beginning
        columns.append(row(terms, arb(-duration), 0))
    columns = [[c * entry for c, entry in zip(own, column, strict=True)] for column in columns]
    sums = [sum(map(abs, column), arb(0)) for column in columns]
    m = len(own)
    table = [[column[i] / whole for column, whole in zip(columns, sums, strict=True)] for i in range(m)]
    sides = [[arb(side * (i == k)) for k in range(m) for side in (-1, 1)] for i in range(m)]
    table = [[*row, *more] for row, more in zip(table, sides, strict=True)] + [[arb(1)] * len(columns) + [arb(0)] * 2 * m]
    aim = arb_mat([[arb(int(i == m))] for i in range(m + 1)])
    try:
        vertex = cheapest(arb_mat(table).mid(), aim, [0] * len(columns) + [1] * 2 * m)
    except SolverError:
        return []
    if vertex is None or not vertex.multipliers[-1] > 0:
        return []
    return [-c * price for c, price in zip(own, vertex.multipliers[:-1], strict=True)]


def _bits(zeros: Sequence[Mode], duration: float) -> int:
    rates = [zero.damping * zero.frequency for zero in zeros]
    return BITS + math.ceil(2.0 * min((max(rates) - min(rates)) * duration, MOST_FOLDS) / math.log(2.0))


def row(terms: Terms, since: arb, order: int) -> Vector:
    """What each coefficient adds to derivative `order` of f: (ωs)^j e^{κωs}."""
    found: Vector = []
    for zero, power in terms:
        zeta, omega = arb(zero.damping), arb(zero.frequency)
        kappa, x = acb(zeta, (1 - zeta * zeta).sqrt()), omega * since
        parts = (comb(order, k) * perm(power, k) * x ** (power - k) * kappa ** (order - k) for k in range(min(order, power) + 1))
        value = omega**order * (kappa * x).exp() * sum(parts, acb(0))
        found += [value.real, value.imag]
    return found


def _scaled(row: Sequence[arb], by: arb) -> Vector:
    return [by * entry for entry in row]


def solution(rows: Sequence[Sequence[arb]], right: Sequence[arb]) -> Vector:
    """Of as many equations as unknowns; nothing where they do not tell."""
    if len(rows) != len(rows[0]):
        return []
    try:
        found = arb_mat([[entry.mid() for entry in row] for row in rows]).solve(arb_mat([[value] for value in right]))
    except ZeroDivisionError:
        return []
    return [found[k, 0].mid() for k in range(len(right))]


def conditions_of(terms: Terms, coefficients: Sequence[arb]) -> list[Condition]:
    """What the checker reads: coefficients (2 for each term) as weights."""
    numbers = list(map(_fraction, coefficients))
    return [
        Condition(Fraction(zero.frequency), Fraction(zero.damping), Fraction(0), power, (numbers[2 * k], numbers[2 * k + 1]))
        for k, (zero, power) in enumerate(terms)
    ]


def _fraction(number: arb) -> Fraction:
    man, exp = number.mid().man_exp()
    return Fraction(int(man)) * Fraction(2) ** int(exp)
