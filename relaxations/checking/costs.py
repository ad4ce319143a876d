"""Fuel and time weighted: no command costs less than J = T + α ∫ |u| dt, and one costs no more (docs/theory.md, section 3).

A command that moves the plant from rest to state rest in exactly T seconds has, for every λ, with p(s) = λᵀ b(s) and s the time to go,

    T + α ∫ |u| dt ≥ D(T) = T + λᵀ target - ∫_0^T σ(p) ds,     σ(p) = max(0, upper p - α upper, lower p + α lower)

So D ≥ J on [begin, end] refutes cheaper commands of these times, D' = 1 - σ(p(T)); those of J and more cost J by their time alone. Each
of the pieces, which cover all times from 0 to J, has a costate of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import flint
from flint import arb, fmpq

from relaxations.checking.balls import System, Wave, placed
from relaxations.checking.reading import Refuted, Undecided, require

SHARE = 1000  # of what a bound is above the cost no more than one part is lost where a costate crosses its price
Support = Callable[[Wave, arb, arb, arb, arb], arb]


def sensible(certificate: Any) -> None:
    """Raise `Malformed` unless the task is one of limits of the input alone, from rest to state rest, and the pieces are in order."""
    task, limits, claim = certificate.task, certificate.task.limits, certificate.claim
    require(certificate.price > 0, "a price of fuel is more than 0")
    require(len(task.plants) == 1, "a cost is that of one plant")
    plain = task.rest == "state" and task.box is None and task.schedule is None and task.initial_state is None
    others = (limits.fuel, limits.rate, limits.pulse_width, limits.pulses, limits.held, limits.sample_time)
    free = not limits.deflection and all(limit is None for limit in others)
    require(plain and free, "a cost is that of moves from rest to state rest, within limits of the input alone")
    given = [side for side in (claim.lower, claim.upper) if side is not None]
    require(bool(given) and all(side >= 0 for side in given), "a claim has sides, and a cost is not negative")
    require(claim.lower is None or certificate.lower is not None, "a side that is claimed has no witness")
    require(claim.upper is None or certificate.upper is not None, "a side that is claimed has no witness")
    require(all(piece.begin < piece.end for piece in certificate.lower or ()), "a piece ends after it begins")
    joined = all(one.end == other.begin for one, other in pairwise(certificate.lower or ()))
    require(joined and (not certificate.lower or certificate.lower[0].begin == 0), "pieces begin at time 0, each where the one before ends")


def at_rest(system: System) -> None:
    """Raise `Malformed` if the plant needs an input at its target: holding it would burn fuel for ever."""
    require(system.rest == 0, "a price of fuel belongs to a plant that rests without input")


def prove(system: System, price: fmpq, pieces: Any, cost: fmpq, support: Support) -> None:
    """Prove that no admissible command costs less than `cost`; raises `Refuted` or `Undecided`. `support` is that of `lower`."""
    at_rest(system)
    if cost > 0 and not (pieces and pieces[-1].end >= cost):
        raise Undecided("the pieces do not cover all times less than the cost")
    for piece in pieces if cost > 0 else ():
        least(system, price, piece, cost, support)


def least(system: System, price: fmpq, piece: Any, cost: fmpq, support: Support) -> None:
    """D ≥ cost on one piece: D at its end, and from there towards its begin, by halves where σ is not known well enough."""
    numbers, alpha = placed(system.roots, piece.costate[0])[0], arb(price)
    p, end, begin = Wave.of(system.roots, numbers), arb(piece.end).upper(), arb(piece.begin).lower()
    terms = [a * b for a, b in zip(numbers, system.target.entries(), strict=True)]
    size = sum((abs(term) for term in terms), arb(cost))
    fine = (size / end * arb(2) ** (-flint.ctx.prec // 2)).lower()
    lower, upper = arb(system.lower), arb(system.upper)
    saved = support(p.raised(-alpha), end, arb(0), upper, fine) + support(p.raised(alpha), end, lower, arb(0), fine)
    value = end + sum(terms, arb(0)) - saved
    if value < cost:
        raise Refuted("a costate's bound is less than the cost that is claimed")
    if not value >= cost:
        raise Undecided("a costate's bound is not told from the cost at this precision")
    waiting = [(begin, end)]
    while waiting:
        a, b = waiting.pop()
        c, _, _, values = p.over(a, b)
        up, down = upper * (values - alpha), lower * (values + alpha)  # at most one of them is positive
        sigma, most = arb(0).max(up.lower()).max(down.lower()), arb(0).max(up.upper()).max(down.upper())
        passed = value - (b - a) * (1 - sigma)  # not more than D at a
        if up > 0 or down > 0:
            part, level = (upper, -alpha) if up > 0 else (lower, alpha)
            passed = value - (b - a) + part * (p.integral(b) - p.integral(a) + level * (b - a))
        rough = not (up > 0 or down > 0 or most <= 0) and not (b - a) * (most - sigma) * SHARE <= value - cost
        floor = value - (b - a) * (1 - sigma) if sigma < 1 else value  # not more than D on all of [a, b]
        if not rough and ((sigma.is_finite() and floor >= cost) or (most <= 1 and passed >= cost)):
            value = passed
            continue
        if not a < c < b:
            raise Undecided("a costate's bound is not told from the cost at this precision")
        waiting += [(a, c), (c, b)]


def within(system: System, price: fmpq, command: list[Any], n: int) -> arb:
    """What a command of n segments costs."""
    at_rest(system)
    instants = [*command[1 : n + 1], command[0]]
    burnt = (abs(arb(level)) * arb(b - a) for level, (a, b) in zip(command[n + 1 : 2 * n + 1], pairwise(instants), strict=True))
    return arb(command[0]) + arb(price) * sum(burnt, arb(0))
