"""Inputs that are never on one side of the first rest until some instant of the move, and never on the other side from then on.

Let r be the time to go at which that is, e = ±1 the first direction, E the limit along it and L the one against it. For a costate λ and a
price μ ≥ 0 of the fuel, p = λᵀ b,

    λᵀ target ≤ μ fuel + Φ_r,    Φ_r(λ, μ) = E ∫_r^T max(0, e p - μ) ds + L ∫_0^r max(0, -e p - μ) ds

for every such command of at most T. The witness gives λ and μ at nodes r_0 = 0 < r_1 < … up to T at least; between two, a < b, w = b - a,
take the mixture (1 - θ, θ) of theirs at r = a + θ w. Φ_r is convex in (λ, μ), and so at most the mixture of Φ_r at either node, which
differ from Φ_a and Φ_b by what is between: Φ_r ≤ (1 - θ) Φ_a + θ Φ_b + W with any of

    one way    E w/4 max(0, max q_b - min q_a), q = max(0, e p - μ) on [a, b], if -e p ≤ μ there at both nodes;
               L w/4 max(0, max q_a - min q_b), q = max(0, -e p - μ), if e p ≤ μ there
    falling    max(E, L) V²/2m if μ = 0 and e p' ≤ -m < 0 on [a, b] at both: the mixture's p then changes its sign once at most, from e, and
               |p(r)| ≤ V = max(|p_a(a)|, |p_b(b)|) + w/4 |p_a'(a) - p_b'(b)| + w²/8 max |p''| by Taylor's formula from a and b
    any        w (E max q + L max q) of the node where that is more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import flint
from flint import arb, fmpq

from relaxations.checking.balls import System, Wave, placed
from relaxations.checking.reading import Refuted, Undecided, require

ORDER = {"positive, then negative": 1, "negative, then positive": -1}
PARTS = 4  # of what lies between two nodes, for the range of a costate there
Range = tuple[arb, arb]  # lower and upper end
Support = Callable[[Wave, arb, arb, arb, arb, arb], arb]


def sensible(task: Any, lower: Any) -> None:
    """Raise `Malformed` unless a form goes with a task that it suits, and nodes with a form, in order."""
    limits, nodes = task.limits, lower.changes if lower else ()
    require(limits.held is not None or not nodes, "changes of sign belong to a form that is held")
    plain = task.rest == "state" and task.box is None and task.schedule is None and task.initial_state is None
    free = limits.rate is None and limits.sample_time is None and not limits.deflection
    require(limits.held is None or (plain and free), "a form is held from rest to state rest, without samples, slopes, outputs or a box")
    ascending = all(a.at <= b.at for a, b in pairwise(nodes)) and (not nodes or nodes[0].at == 0)
    require(ascending, "changes of sign begin at time to go 0, and do not descend")
    fine = all(node.fuel == 0 or (limits.fuel is not None and node.fuel > 0) for node in nodes)
    require(fine, "the multiplier of the fuel is not negative, and belongs to a budget")


def prove(system: System, nodes: Sequence[Any], time: fmpq, support: Support) -> None:
    """Prove that no command of the form takes less than `time` seconds; raises `Refuted` or `Undecided`. `support` is that of `lower`."""
    at_rest(system)
    along, horizon = ORDER[system.task.limits.held], arb(time).upper()
    if not nodes or not nodes[-1].at >= time:
        raise Undecided("the changes of sign do not cover the time that is claimed")
    strong, weak = (arb(side) for side in ((system.upper, -system.lower) if along > 0 else (-system.lower, system.upper)))
    waves: list[Wave] = []
    gains: list[arb] = []
    for node in nodes:
        numbers, fuel = placed(system.roots, node.costate[0])[0], system.task.limits.fuel or fmpq(0)
        p = Wave.of(system.roots, [along * number for number in numbers])
        gain = sum((arb(a) * b for a, b in zip(numbers, system.target.entries(), strict=True)), arb(0)) - arb(node.fuel * fuel)
        fine = (abs(gain) / horizon * arb(2) ** (-flint.ctx.prec // 2)).lower()
        at = arb(min(node.at, time))
        # Where the instant is no exact number both directions are admitted in its ball.
        spent = pay(p, node.fuel, strong, (at.lower(), horizon), support, fine)
        spent += pay(p.reversed(), node.fuel, weak, (arb(0), at.upper()), support, fine)
        waves.append(p)
        gains.append(gain - spent)
    for i, (one, other) in enumerate(pairwise(nodes)):
        if one.at >= min(other.at, time):
            continue
        a, b = arb(one.at), arb(min(other.at, time))
        excess = between(waves[i : i + 2], (one.fuel, other.fuel), a, b, strong, weak)
        for gain in gains[i : i + 2]:
            if gain < 0:
                raise Refuted(f"the costate of change of sign {i} or the next does not refute it at the time that is claimed")
            if not gain > excess:
                raise Undecided(f"commands whose sign changes between {i} and {i + 1} are not refuted at this precision")


def at_rest(system: System) -> None:
    """Raise `Undecided` where an input that is never on the other side again would hold the plant at its target for ever."""
    if system.rest != 0:
        raise Undecided("a form is held by moves that end without input")


def pay(p: Wave, price: fmpq, limit: arb, span: tuple[arb, arb], support: Support, fine: arb) -> arb:
    """`limit ∫_low^high max(0, p - price) ds` between exact numbers."""
    raised, (low, high) = p.raised(-arb(price)), span
    return support(raised, high, arb(0), limit, fine, low) if high > low else arb(0)


def between(waves: list[Wave], prices: tuple[fmpq, fmpq], a: arb, b: arb, strong: arb, weak: arb) -> arb:
    """W: by how much Φ at a change between a and b may exceed the mixture of the nodes'; an upper bound."""
    over, under = ([beyond(wave, sign, price, a, b) for wave, price in zip(waves, prices, strict=True)] for sign in (1, -1))
    w, found = b - a, []
    if all(high <= 0 for _, high in under):
        found.append(strong * w / 4 * (over[1][1].max(0) - over[0][0].max(0)).max(0))
    if all(high <= 0 for _, high in over):
        found.append(weak * w / 4 * (under[0][1].max(0) - under[1][0].max(0)).max(0))
    if prices == (0, 0):
        found += falling(waves, a, b, strong.max(weak))
    found.append(w * max_of([strong * high.max(0) + weak * other.max(0) for (_, high), (_, other) in zip(over, under, strict=True)]))
    return min_of(found)


def beyond(wave: Wave, sign: int, price: fmpq, a: arb, b: arb) -> Range:
    """The range of `sign p - price` on [a, b]."""
    ranges = [sign * values - arb(price) for _, _, _, values in pieces(wave, a, b)]
    return -max_of([-values for values in ranges]), max_of(ranges)


def pieces(wave: Wave, a: arb, b: arb) -> list[tuple[arb, arb, arb, arb]]:
    """What `Wave.over` says of parts of [a, b]."""
    edges = [a, *(a + (b - a) * k / PARTS for k in range(1, PARTS)), b]
    return [wave.over(low, high) for low, high in pairwise(edges)]


def falling(waves: list[Wave], a: arb, b: arb, limit: arb) -> list[arb]:
    """The bound for a sign that changes once, if both nodes' p surely falls."""
    slopes = [piece for wave in waves for piece in pieces(wave.derivative(), a, b)]
    steep = -max_of([values for _, _, _, values in slopes])
    if not steep > 0:
        return []
    bend = max_of([abs(slope).upper() for _, _, slope, _ in slopes])
    (first, before, *_), (last, after, *_) = waves[0](a), waves[1](b)
    w = b - a
    off = abs(first).max(abs(last)) + w / 4 * abs(before - after) + w * w / 8 * bend
    return [limit * off * off / (2 * steep)]


def max_of(numbers: list[arb]) -> arb:
    """At least as large as all of them."""
    found = numbers[0].upper()
    for number in numbers[1:]:
        found = found.max(number.upper())
    return found


def min_of(numbers: list[arb]) -> arb:
    """At least as large as the smallest of them."""
    found = numbers[0].upper()
    for number in numbers[1:]:
        found = found.min(number.upper())
    return found


def form(system: System, levels: list[Any]) -> None:
    """Prove that levels (deviations, in order of time) are of the form; raises `Refuted` or `Undecided`."""
    at_rest(system)
    along, changed = ORDER[system.task.limits.held], False
    for i, level in enumerate(levels):
        value = along * arb(level)
        if value.is_zero() or (value >= 0 and not changed):
            continue
        changed = changed or not value >= 0  # the level may be anywhere in its ball
        if value > 0:
            raise Refuted(f"level {i} is along the first direction after the sign has changed")
        if not value <= 0:
            raise Undecided(f"the sign of level {i} is undecided at this precision")
