"""No pulses do: every order of them, and every place that their edges may have, is refuted.

Pulse i of n lasts from x_i to y_i ≥ x_i + w in time to go, y_i ≤ x_{i+1}, and is at U_i, the upper or the lower limit. In a box
a_i ≤ x_i ≤ b_i, c_i ≤ y_i ≤ d_i, let pulse i be *admitted* on [a_i, d_i], and *certain* on [b_i, c_i], where no other is admitted and u is
not 0. For any costate λ, p = λᵀ b, prices ν_i ≥ 0 of the widths and μ ≥ 0 of the fuel, commands of that box satisfy

    λᵀ target + w Σ ν_i ≤ μ fuel + ∫_0^T max over what is admitted (0, U_i p - μ |U_i| + ν_i) ds

since `w ≤ ∫ (u is in pulse i) ds`. The witness is a list of trees, for n = 0, 1, 2 … pulses up to as many as there may be, or without a
width for that many alone (some last no time). Nodes stand in the order of their first visit: one that splits has two halves, of an edge's
range, or of a pulse's sign (the upper limit first); one that does not refutes what is left. Shorter moves begin with a wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import flint
from flint import arb, fmpq

from relaxations.checking.balls import System, Wave, placed, spend
from relaxations.checking.reading import Undecided, require

MOST = 200  # pulses
LOOKS = 7  # of a costate, which say how large it is
Line = tuple[fmpq, fmpq]  # slope and intercept, of p
Support = Callable[..., arb]


@dataclass(frozen=True, slots=True)
class Range:
    """Where one pulse may begin and end in time to go [s], and its sign: 1, -1, or 0 for either."""

    begin: tuple[fmpq, fmpq]
    end: tuple[fmpq, fmpq]
    sign: int = 0


Box = tuple[Range, ...]


def whole(n: int, time: fmpq, system: System) -> Box:
    """Any n pulses within a move of `time` [s]."""
    sign = 1 if system.lower == 0 else -1 if system.upper == 0 else 0
    return (Range((fmpq(0), time), (fmpq(0), time), sign),) * n


def tight(box: Box, width: fmpq) -> Box | None:
    """The box without what order and width of the pulses exclude; None if nothing is left."""
    ranges, last = list(box), fmpq(0)
    for i, one in enumerate(ranges):
        begin = max(one.begin[0], last)
        last = max(one.end[0], begin + width)
        ranges[i] = replace(one, begin=(begin, one.begin[1]), end=(last, one.end[1]))
    first: fmpq | None = None
    for i, one in reversed([*enumerate(ranges)]):
        end = one.end[1] if first is None else min(one.end[1], first)
        first = min(one.begin[1], end - width)
        ranges[i] = replace(one, begin=(one.begin[0], first), end=(one.end[0], end))
    return tuple(ranges) if all(one.begin[0] <= one.begin[1] and one.end[0] <= one.end[1] for one in ranges) else None


def halves(box: Box, split: Any) -> tuple[Box, Box]:
    """Both parts of a box; raises `Malformed` for a pulse that it does not have."""
    require(split.pulse < len(box), f"a tree of {len(box)} pulses splits number {split.pulse}")
    one, at = box[split.pulse], split.at
    require(split.edge != "sign" or one.sign == 0, "a tree of pulses splits a sign that is known")
    if split.edge == "sign":
        parts = replace(one, sign=1), replace(one, sign=-1)
    elif split.edge == "begin":
        parts = replace(one, begin=(one.begin[0], min(one.begin[1], at))), replace(one, begin=(max(one.begin[0], at), one.begin[1]))
    else:
        parts = replace(one, end=(one.end[0], min(one.end[1], at))), replace(one, end=(max(one.end[0], at), one.end[1]))
    first, second = ((*box[: split.pulse], part, *box[split.pulse + 1 :]) for part in parts)
    return first, second


def sensible(task: Any, lower: Any) -> None:
    """Raise `Malformed` unless trees go with limits of pulses, of a plant that begins at rest."""
    if not (lower and lower.pulses):
        return
    limits, leaves = task.limits, [node.leaf for node in lower.pulses if node.leaf]
    plain = (limits.pulse_width or limits.pulses) and not (task.box or task.initial_state or task.schedule)
    require(bool(plain), "trees of pulses belong to limits of pulses, of one plant that begins at rest")
    require(all((node.leaf is None) != (node.split is None) for node in lower.pulses), "a node of a tree of pulses splits, or refutes")
    require(all(price >= 0 for leaf in leaves for price in (*leaf.widths, leaf.fuel)), "prices of widths and of fuel are not negative")
    require(limits.fuel is not None or all(leaf.fuel == 0 for leaf in leaves), "a price of fuel belongs to a budget")


def prove(system: System, nodes: Sequence[Any], time: fmpq, support: Support) -> None:
    """Prove that no such pulses take less than `time` seconds; raises `Undecided`. `support` is that of `lower`."""
    width, most = system.task.limits.pulse_width or fmpq(0), system.task.limits.pulses
    if width:
        fit = int((time / width).floor())
        most = fit if most is None else min(most, fit)
    require(most <= MOST, f"trees are of at most {MOST} pulses")
    left = iter(nodes)
    for n in range(0 if width else most, most + 1):
        waiting = [tight(whole(n, time, system), width)]
        while waiting:
            box, node = waiting.pop(), next(left, None)
            spend(10 * (1 + n))
            if node is None:
                raise Undecided("the trees of pulses end too early")
            if node.split:
                parts = (None, None) if box is None else halves(box, node.split)
                waiting += [part and tight(part, width) for part in parts[::-1]]
            elif not (box is None or refuted(system, box, node.leaf, time, support)):
                raise Undecided(f"an order of {n} pulses is not refuted at this precision, their edges in some range")
    require(next(left, None) is None, "there are more trees than numbers of pulses")


def refuted(system: System, box: Box, leaf: Any, time: fmpq, support: Support) -> bool:
    """Whether the inequality above is proven false for a box, at this precision."""
    require(len(leaf.widths) == len(box), f"{len(leaf.widths)} prices of the widths of {len(box)} pulses")
    limits, numbers = system.task.limits, placed(system.roots, leaf.costate[0])[0]
    gain = sum((arb(a) * b for a, b in zip(numbers, system.target.entries(), strict=True)), arb(0))
    gain += arb(sum(leaf.widths, fmpq(0)) * (limits.pulse_width or 0) - leaf.fuel * (limits.fuel or 0))
    p, horizon, total = Wave.of(system.roots, numbers), arb(time).upper(), arb(0)
    size = abs(gain) / horizon + sum((abs(p(horizon * k / LOOKS)[0]) for k in range(LOOKS)), arb(0)) * arb(system.upper - system.lower)
    fine = (size * arb(2) ** (-flint.ctx.prec // 2)).lower()
    for begin, end, lines in pieces(system, box, leaf, horizon.fmpq()):
        (slope, level), *_ = hull = envelope(lines)
        total += arb(slope) * (p.integral(end) - p.integral(begin)) + arb(level) * (end - begin)
        for (low, above), (high, below) in pairwise(hull):
            turn = p.raised(arb((below - above) / (high - low)))
            total += support(turn, end, arb(0), arb(high - low), fine, begin)
    return bool(total < gain)


def pieces(system: System, box: Box, leaf: Any, horizon: fmpq) -> Iterator[tuple[arb, arb, frozenset[Line]]]:
    """Parts of [0, horizon], their ends exact, with the lines whose maximum is the integrand there, but for those where it is 0."""
    lines = [
        frozenset((u, price - leaf.fuel * abs(u)) for u in (system.upper, system.lower) if one.sign * u >= 0 and u)
        for one, price in zip(box, leaf.widths, strict=True)
    ]
    # the ball of an instant counts outwards where a pulse is admitted, inwards where it is certain
    admitted = [(arb(one.begin[0]).lower().fmpq(), min(arb(one.end[1]).upper().fmpq(), horizon)) for one in box]
    certain = [(arb(one.begin[1]).upper().fmpq(), arb(one.end[0]).lower().fmpq()) for one in box]
    edges = sorted({edge for begin, end in (*admitted, *certain) if begin < end for edge in (begin, end)})
    spend(3 * len(edges) * len(box))
    found: list[tuple[fmpq, fmpq, frozenset[Line]]] = []
    for begin, end in pairwise(edges):
        sure = next((own for own, (low, high) in zip(lines, certain, strict=True) if low <= begin and end <= high), None)
        may = (own for own, (low, high) in zip(lines, admitted, strict=True) if low <= begin and end <= high)
        own = frozenset({(fmpq(0), fmpq(0))}).union(*may) if sure is None else sure
        if found and found[-1][1:] == (begin, own):
            found[-1] = found[-1][0], end, own
        else:
            found.append((begin, end, own))
    return ((arb(begin), arb(end), own) for begin, end, own in found if len(own) > 1 or own != {(fmpq(0), fmpq(0))})


def envelope(lines: Iterable[Line]) -> list[Line]:
    """Those of the lines that are the largest anywhere, by ascending slope."""
    highest: dict[fmpq, fmpq] = {}
    for slope, level in lines:
        highest[slope] = max(level, highest.get(slope, level))
    hull: list[Line] = []
    for slope, level in sorted(highest.items()):
        while len(hull) > 1 and (level - hull[-2][1]) * (hull[-1][0] - hull[-2][0]) >= (hull[-1][1] - hull[-2][1]) * (slope - hull[-2][0]):
            hull.pop()
        hull.append((slope, level))
    return hull
