"""Limits of the slope: the input is continuous, in the witness straight from level to level, and between 0 and the final rest at both ends.

For any absolutely continuous q of the time to go, `∫ p u = ∫ (p - q') u + ∫ q u' - q(0) u_ss`, since u is 0 at the beginning of the move.
The witness gives ramps, disjoint intervals of s on which p - q' is constant in pieces and q is 0 at both ends; elsewhere q is 0. So

    ∫ p u ≤ ∫_rest σ(p) + Σ lengths σ(levels) + ∫ rate(q) - q(0) u_ss,     rate(q) = max(upper slope q, lower slope q)

whatever the ramps are. The levels of a ramp are shifted by one constant so that q ends at 0; but a ramp from s = 0 on ends there with q(0)
as it comes unless it is given (`steps`), and where the move begins within a ramp nothing is asked of q (docs/theory.md, section 3).
An input that is constant over samples changes by at most h times the limits from one to the next: q is then a number for each step, q'
its differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

from flint import acb, arb, arb_mat, fmpq

from relaxations.checking.balls import Root, System, Wave, flat
from relaxations.checking.courses import Chains, Kick, Piece, integrated, value, wave
from relaxations.checking.reading import Refuted, Undecided, require

Number = fmpq | arb
Support = Callable[[Wave, arb, arb, arb], arb]  # of a wave over a length, with lower and upper weight
Part = tuple[Wave, arb, arb]


def edges(ramps: Sequence[Any], nothing: Chains, horizon: arb) -> list[Kick]:
    """Where ramps begin and end, at exact instants near those written: kicks of nothing, so that pieces end there."""
    found = [arb(edge).mid() for ramp in ramps for edge in ramp.edges]
    return [(edge, nothing) for edge in found if edge < horizon]


def most(
    task: Any,
    roots: tuple[Root, ...],
    whole: Sequence[Piece],
    ramps: Sequence[Any],
    q0: arb | None,
    support: Support,
    parts: Callable[[Wave], list[Part]],
) -> tuple[arb, arb]:
    """The right side of the inequality up to an exact horizon, but for its last term, by the pieces of p; and q(0), if it is not given."""
    total, first, at = arb(0), arb(0), 0
    for ramp in (*ramps, None):
        begin, end = (arb("inf"), arb("inf")) if ramp is None else (arb(ramp.edges[0]).mid(), arb(ramp.edges[-1]).mid())
        while at < len(whole) and whole[at][0] < begin:
            _, length, chains = whole[at]
            total, at = total + sum((support(q, exact(length), a, b) for q, a, b in parts(wave(roots, chains))), arb(0)), at + 1
        after = at
        while after < len(whole) and whole[after][0] < end:
            after += 1
        if ramp is not None and after > at:
            given, open_end = q0 if begin == 0 else None, after == len(whole)
            cost, q = ramped(task, roots, whole[at:after], ramp, given, open_end, support, parts)
            total, first = total + cost, q if begin == 0 else first
        at = after
    return total, first


def ramped(
    task: Any,
    roots: tuple[Root, ...],
    own: Sequence[Piece],
    ramp: Any,
    given: arb | None,
    open_end: bool,
    support: Support,
    parts: Callable[[Wave], list[Part]],
) -> tuple[arb, arb]:
    """What a ramp costs, over its own pieces of p, and q where it begins."""
    constant = wave(roots, [[acb(0)] * root.multiplicity for root in roots])
    levels, (low, high) = [level_at(ramp, begin) for begin, _, _ in own], (arb(side) for side in task.limits.rate)
    gains = [
        value(roots, integrated(roots, chains), length) - level * length for (_, length, chains), level in zip(own, levels, strict=True)
    ]
    starts = bool(own[0][0] == 0)
    first = given if given is not None else -sum(gains, arb(0)) if starts else arb(0)
    shift = arb(0) if open_end else (first + sum(gains, arb(0))) / sum((length for _, length, _ in own), arb(0))
    total, q = arb(0), first
    for (_, length, chains), level, gained in zip(own, levels, gains, strict=True):
        for part, a, b in parts(constant.raised(level + shift)):
            held = part(arb(0))[0]
            total += (b * held).max(a * held) * length
        course = integrated(roots, chains)
        course[0][0] += q
        course[0][1] -= level + shift
        total += support(wave(roots, course), exact(length), low, high)
        q += gained - shift * length
    return total, first


def level_at(ramp: Any, at: arb) -> arb:
    """What p - q' is there, but for the shift."""
    return arb(next(level for (_, b), level in zip(pairwise(ramp.edges), ramp.levels, strict=True) if at < arb(b).mid()))


def exact(length: Any) -> arb:
    """The length of a piece, which must be an exact number; raises `Undecided`."""
    if not arb(length).is_exact():
        raise Undecided("instants of multipliers are no exact numbers at this precision")
    return arb(length)


def stepped(system: System, cells: Sequence[arb], witness: Any) -> tuple[arb, arb]:
    """`Σ_k σ(∫_cell p - q_k + q_{k-1}) + h Σ_k rate(q_k)` for an input that is constant over cells of h, counted in time to go; and q_0."""
    step, rate, lower, upper = system.task.limits.sample_time, system.task.limits.rate, system.lower, system.upper
    fuel = arb(witness.fuel * step)
    q = [arb(x) for x in witness.steps[: len(cells) + 1]]
    q += [arb(0)] * (len(cells) + 1 - len(q))
    total = arb(0)
    for gained, before, after in zip(cells, q, q[1:], strict=False):
        kept = gained - after + before
        total += (upper * (kept - fuel)).max(lower * (kept + fuel)).max(arb(0)) if witness.fuel else (upper * kept).max(lower * kept)
    return total + sum(((x * rate[1] * step).max(x * rate[0] * step) for x in q if rate), arb(0)), q[0]


def moments(system: System, command: Sequence[Number], n: int) -> arb_mat:
    """The moments of the command that goes straight from level to level."""
    instants, levels = [*command[1 : n + 1], command[0]], [*command[n + 1 : 2 * n + 1], system.end(command[2 * n + 1 :])]
    slopes = [arb(b - a) / arb(t - s) for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels), strict=True)]
    total = arb_mat(system.target.nrows(), 1)
    for at, (before, after) in zip(instants, pairwise([arb(0), *slopes]), strict=False):
        change = after - before
        if not change.is_zero():
            total += flat(system.roots, Root.ramp, arb(command[0] - at)) * change
    return total


def derivative(system: System, command: Sequence[Number], n: int, i: int) -> arb_mat:
    """Of these by level i, which is not the first; level n is where the tail begins."""
    instants = [*command[1 : n + 1], command[0]]
    if i == n:
        return flat(system.roots, Root.ramp, arb(command[0] - instants[n - 1])) / arb(command[0] - instants[n - 1])
    before, at, after = (flat(system.roots, Root.ramp, arb(command[0] - instants[j])) for j in (i - 1, i, i + 1))
    return (before - at) / arb(instants[i] - instants[i - 1]) - (at - after) / arb(instants[i + 1] - instants[i])


def prove(system: System, command: Sequence[Number], n: int) -> None:
    """Prove that the command begins at 0 and that its slopes, or steps, are within their limits; raises `Refuted` or `Undecided`."""
    instants, step = [*command[1 : n + 1], command[0]], system.task.limits.sample_time
    levels = [*command[n + 1 : 2 * n + 1], system.end(command[2 * n + 1 :])]
    if not step and levels[0] != 0:
        raise Refuted("the input jumps at the beginning of the move")
    if not step and not levels[0] == 0:  # where the tail is all there is
        raise Undecided("the input is not known to begin where it rests")
    if step:
        lasting(instants)
    low, high = system.task.limits.rate
    spans = [arb(t - s) for s, t in pairwise(instants)] if not step else [arb(step)] * (n + 1)
    for span, (a, b) in zip(spans, pairwise(levels if not step else [fmpq(0), *levels]), strict=True):
        slope = arb(b - a) / span
        if slope > high or slope < low:
            raise Refuted("the slope of the input leaves its limits")
        if not low <= slope <= high:
            raise Undecided("the slope of the input is not told from its limits at this precision")


def lasting(instants: Sequence[Any]) -> None:
    """Every level lasts a sample at least: else two steps would be one. The instants are exact."""
    if any(after <= before for before, after in pairwise(instants)):
        raise Refuted("a level lasts no sample, so that two steps of the input are one")


def burnt(levels: Sequence[Number], instants: Sequence[Number]) -> arb:
    """At least the fuel between two levels each: that of two triangles where the input surely changes its sign."""
    total = arb(0)
    for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels), strict=True):
        size = abs(arb(a)) + abs(arb(b))
        crossed = bool(arb(a) * arb(b) < 0)
        total += arb(t - s) / 2 * ((arb(a) * arb(a) + arb(b) * arb(b)) / size if crossed else size)
    return total


def sensible(task: Any, lower: Any) -> None:
    """Raise `Malformed` unless limits of the slope make sense, and ramps come with them, in order."""
    rate, step, ramps, steps = task.limits.rate, task.limits.sample_time, lower.ramps if lower else (), lower.steps if lower else ()
    require(not ramps or (rate is not None and step is None), "ramps belong to limits of the slope")
    require(not steps or rate is not None, "multipliers of steps belong to limits of the slope")
    begins = len(steps) == 1 and bool(ramps) and ramps[0].edges[0] == 0
    require(step is not None or not steps or begins, "q(0) is one number, and belongs to a ramp that begins there")
    if rate is None:
        return
    fine = task.limits.pulse_width is None and task.limits.pulses is None
    require(fine, "limits of the slope do not belong to pulses")
    require(rate[0] < 0 < rate[1], "limits of the slope have room on either side of 0")
    at = fmpq(0)
    for ramp in ramps:
        rising = all(a < b for a, b in pairwise(ramp.edges))
        require(rising and at <= ramp.edges[0] and len(ramp.levels) == len(ramp.edges) - 1, "ramps are disjoint, and ascend")
        at = ramp.edges[-1]
