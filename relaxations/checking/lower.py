"""The lower side: weak duality (docs/theory.md, equation 2) with the integral of σ(p) bounded from above, its sign changes isolated.

    λᵀ target > ∫_0^T σ(p) ds + Σ μ⁺ above + μ⁻ below   ⇒   no admissible command takes T or less

for σ(p) = max(upper p, lower p), lower ≤ 0 ≤ upper: the right side grows with T. Where the rest input lies *on* a limit, no T may be
enough, and balls cannot decide an equality; two criteria in rationals then speak of costates of one term, without a tail:

face       a double pole at the origin asks for ∫u = 0. If u may leave 0 to one side only, it is 0 almost everywhere: nothing moves.
remainder  a stable real pole a asks for ∫_0^T e^{as} u ds = u_ss ∫_0^∞ e^{as} ds. If u_ss is a limit, the left side is never that large.
"""

from __future__ import annotations

from itertools import groupby, pairwise
from operator import itemgetter
from typing import Any

import flint
from flint import arb, arb_mat, fmpq

from relaxations.checking.balls import Inconclusive, Refuted, System, Undecided, Wave, flat, placed, spend
from relaxations.checking.reading import require


def impossible(system: System, criterion: str) -> None:
    """Prove that no admissible command reaches the target in any time, or raise `Inconclusive`."""
    one_sided = system.lower == 0 or system.upper == 0
    at_limit = system.rest != 0 and system.rest in (system.lower, system.upper)
    decays = any(not root.flexible and root.value.real < 0 for root in system.roots)
    met = {"face": system.rigid >= 2 and one_sided, "remainder": at_limit and decays}
    if system.zeros or not met[criterion]:
        raise Inconclusive(f"the criterion '{criterion}' does not apply to this task")


def costate(system: System, witness: Any) -> arb_mat:
    """λ in balls: the one written, moved (least squares) onto the equalities `λᵀ column_j = -Σ (μ⁺ - μ⁻) shape_j(τ)` of a free tail."""
    numbers, columns = placed(system.roots, witness.costate[0])[0], system.columns
    written = arb_mat(len(numbers), 1, numbers)
    excess = columns.transpose() * written
    for contact in witness.tail:
        excess += flat(system.zeros, lambda zero, at=contact.time: zero.impulse(arb(at))) * arb(contact.upper - contact.lower)
    spend(columns.ncols() ** 2 * columns.nrows())
    try:
        return written - columns * (columns.transpose() * columns).solve(excess)
    except ZeroDivisionError:
        raise Undecided("the tail's equalities cannot be solved for the costate at this precision") from None


def support(p: Wave, horizon: arb, lower: arb, upper: arb, fine: arb) -> arb:
    """A ball around `∫_0^horizon max(upper p, lower p) ds` for an exact horizon and lower ≤ 0 ≤ upper.

    Intervals are bisected until p has a sign, or is monotone: interval Newton then encloses its root. Where the integrand is smaller than
    `fine` it counts as a radius instead. Raises `Undecided` where p is not known that well.
    """
    span, total = upper - lower, arb(0)
    decided, waiting = [], [(arb(0), horizon, 0)]  # [a, b] and the sign of p there, in ascending order; 0: bounded, or not looked at yet
    while waiting:
        a, b, sign = waiting.pop()
        if a == b:
            continue
        if sign:
            decided.append((a, b, sign))
            continue
        c, value, slope, values = p.over(a, b)
        small = (abs(values) * span).upper()
        if values > 0 or values < 0:
            decided.append((a, b, 1 if values > 0 else -1))
        elif small <= fine:
            decided.append((a, b, 0))
            total += arb(0, (small * (b - a)).upper())
        elif not (a < c < b) or not value.rad() * span <= fine:
            raise Undecided("the sign of the costate is undecided at this precision")
        else:
            # Left of the enclosure of c - p(c)/p' the sign of p is that of -p', right of it that of p', whether or not [a, b] holds a root.
            rising, root = (1 if slope > 0 else -1), c - value / slope
            low = root.lower() if a < root.lower() < b else b if root.lower() > b else a
            high = root.upper() if a < root.upper() < b else a if root.upper() < a else b
            isolated = (slope > 0 or slope < 0) and (high - low) * 2 <= b - a
            waiting += [(high, b, rising), (low, high, 0), (a, low, -rising)] if isolated else [(c, b, 0), (a, c, 0)]
    if not (decided[0][0] == 0 and decided[-1][1] == horizon and all(one[1] == next_[0] for one, next_ in pairwise(decided))):
        raise Undecided("the horizon is not covered")
    for sign, cells in groupby(decided, key=itemgetter(2)):
        run = list(cells)
        if sign:
            total += (upper if sign > 0 else lower) * (p.integral(run[-1][1]) - p.integral(run[0][0]))
    return total


def prove(system: System, witness: Any, time: fmpq) -> None:
    """Prove that no admissible command takes `time` seconds or less; raises `Refuted` or `Undecided`."""
    require(bool(system.zeros) or not witness.tail, "multipliers of a tail that the task does not have")
    numbers = costate(system, witness)
    gain = (numbers.transpose() * system.target)[0, 0]
    for contact in witness.tail:
        above, below = system.room(contact.time)
        gain -= arb(contact.upper * above + contact.lower * below)
    if gain <= 0:
        raise Refuted("the lower bound's inequality (2) is false for this costate, whatever the time")
    if not gain > 0:
        raise Undecided("the lower bound's inequality (2) is undecided at this precision")
    p, horizon = Wave.of(system.roots, numbers.entries()), arb(time).upper()
    fine = (gain / horizon * arb(2) ** (-flint.ctx.prec // 2)).lower()
    integral = support(p, horizon, arb(system.lower), arb(system.upper), fine)
    if integral < gain:
        return
    since = abs(p(arb(time).union(horizon))[0]) * arb(system.upper - system.lower) * (horizon - arb(time))
    if integral - since > gain:
        raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality (2) is undecided at this precision")
