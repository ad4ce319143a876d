"""Least durations where a mode decays by more than programs in doubles tell: from where the function of the multipliers touches 0.

Of the shortest positive shaper with zeros at N modes the function `f = Re Σ y_i* e^{κ_iω_i(t - T)}` vanishes at its N + 1 impulses, with
its slope at the inner ones: as many linear equations as coefficients. One that stays a little above 0 there, by ε in units of what the
impulse counts for, refutes a duration that is shorter by a few ε. It is solved in as many digits as the decay of the modes takes, and
proven positive in balls (relaxations.checking.durations).

Of partial sums S = 1 - x up to 1 with dips x at N places the same is asked of f' in place of f, and f > 0 at the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from flint import acb, arb, arb_mat

from relaxations.checking.durations import Condition, none_as_short, none_of_sums_up_to_one
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper

ABOVE = (1e-9, 1e-7)  # ε
BELOW = (4.0, 64.0)  # times ε, for each impulse: how much shorter is tried
BITS = 192
MOST_FOLDS = 2000.0  # of decay: more cells than a proof takes


def least_of_positive(zeros: Sequence[Mode], shaper: Shaper) -> float | None:
    """The least duration [s], *proven*, of positive shapers with these zeros, from the shortest; None if it is not that or not proven."""
    times, amplitudes = shaper.times, shaper.amplitudes
    if len(times) != len(zeros) + 1 or min(amplitudes) <= 0.0:
        return None
    with precision(bits := _bits(zeros, shaper.duration)):
        end = arb(times[-1])
        places = [(arb(t) - end, arb(a)) for t, a in zip(times, amplitudes, strict=True)]
        (first, size), later = places[0], places[1:]
        rows = [_scaled(_row(zeros, place, 0), weight) for place, weight in later]
        rows += [_scaled(_row(zeros, place, 1), weight) for place, weight in later[:-1]]
        rows.append(_scaled(_row(zeros, first, 1), size * end))
        for above in ABOVE:
            right = [arb(above)] * len(later) + [arb(0)] * (len(later) - 1) + [arb(1)]
            conditions = _solved(zeros, rows, right)
            for less in BELOW:
                claimed = shaper.duration * (1.0 - less * len(times) * above)
                if conditions and none_as_short(Fraction(claimed), conditions, bits=bits):
                    return claimed
    return None


def least_up_to_one_of(zeros: Sequence[Mode], dips: Sequence[tuple[arb, arb]]) -> float | None:
    """The same of partial sums up to 1, from dips of one depth at (begin, end) [s] that leave nothing of the zeros."""
    if len(dips) != len(zeros):
        return None
    duration = float(dips[-1][1])
    with precision(bits := _bits(zeros, duration)):
        end = (dips[-1][0] + dips[-1][1]) / 2
        places = [((begin + until) / 2 - end, until - begin) for begin, until in dips]
        rows = [_scaled(_row(zeros, place, 1), weight) for place, weight in places]
        rows += [_scaled(_row(zeros, place, 2), weight) for place, weight in places[:-1]]
        rows.append(_scaled(_row(zeros, places[-1][0], 2), places[-1][1] * end))
        for above in ABOVE:
            right = [arb(above)] * len(places) + [arb(0)] * (len(places) - 1) + [arb(-1)]
            conditions = _solved(zeros, rows, right)
            for less in BELOW:
                claimed = float(end) * (1.0 - less * (len(places) + 1) * above)
                if conditions and none_of_sums_up_to_one(Fraction(claimed), conditions, bits=bits):
                    return claimed
    return None


def _bits(zeros: Sequence[Mode], duration: float) -> int:
    rates = [zero.damping * zero.frequency for zero in zeros]
    return BITS + math.ceil(2.0 * min((max(rates) - min(rates)) * duration, MOST_FOLDS) / math.log(2.0))


def _row(zeros: Sequence[Mode], since: arb, order: int) -> list[arb]:
    """What each coefficient adds to derivative `order` of f."""
    found: list[arb] = []
    for zero in zeros:
        zeta = arb(zero.damping)
        rate = arb(zero.frequency) * acb(zeta, (1 - zeta * zeta).sqrt())
        value = rate**order * (rate * since).exp()
        found += [value.real, value.imag]
    return found


def _scaled(row: Sequence[arb], by: arb) -> list[arb]:
    return [by * entry for entry in row]


def _solved(zeros: Sequence[Mode], rows: Sequence[Sequence[arb]], right: Sequence[arb]) -> list[Condition]:
    try:
        found = arb_mat([[entry.mid() for entry in row] for row in rows]).solve(arb_mat([[value] for value in right]))
    except ZeroDivisionError:
        return []
    numbers = [_fraction(found[k, 0]) for k in range(len(right))]
    return [
        Condition(Fraction(zero.frequency), Fraction(zero.damping), Fraction(0), 0, (numbers[2 * k], numbers[2 * k + 1]))
        for k, zero in enumerate(zeros)
    ]


def _fraction(number: arb) -> Fraction:
    man, exp = number.mid().man_exp()
    return Fraction(int(man)) * Fraction(2) ** int(exp)
