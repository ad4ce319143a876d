"""Limits of the slope: the input is continuous, in the witness straight from level to level, and between 0 and the final rest at both ends.

For any absolutely continuous q of the time to go, `∫ p u = ∫ (p - q') u + ∫ q u' - q(0) u_ss`, since u is 0 at the beginning of the move.
The witness gives ramps, disjoint intervals of s on which p - q' is constant in pieces and q is 0 at both ends; elsewhere q is 0. So

    ∫ p u ≤ ∫_rest σ(p) + Σ lengths σ(levels) + ∫ rate(q) - q(0) u_ss,     rate(q) = max(upper slope q, lower slope q)

whatever the ramps are. The levels of a ramp are shifted by one constant so that q ends at 0; but a ramp from s = 0 on ends there with q(0)
as it comes, and where the move begins within a ramp nothing is asked of q (docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

from flint import acb, arb, arb_mat, fmpq

from relaxations.checking.balls import Root, System, Wave, flat
from relaxations.checking.courses import Chains, advanced, common, given
from relaxations.checking.reading import Refuted, Undecided, require

Number = fmpq | arb


def integrated(roots: Sequence[Root], chains: Chains) -> Chains:
    """The integral from 0 of a sum without the highest power at the origin: `S_k = (b_k - S_{k-1}) / p`, at the origin b_{k+1}."""
    found, constant = [], acb(0)
    for root, chain in zip(roots, chains, strict=True):
        if root.value.is_zero():
            found.append([acb(0), *chain[:-1]])
            continue
        carried, out = acb(0), []
        for c in reversed(chain):
            carried = (c - carried) / root.value
            out.append(carried)
        constant -= carried
        found.append(out[::-1])
    found[0][0] += acb(constant.real)
    return found


def wave(roots: tuple[Root, ...], chains: Chains) -> Wave:
    """The sum of chains, the first root being the one at the origin."""
    pairs = ((root, c) for root, chain in zip(roots, chains, strict=True) for c in chain)
    return Wave.of(roots, [part for root, c in pairs for part in (c.real, c.imag)[: 1 + root.flexible]])


Support = Callable[[Wave, arb, arb, arb], arb]  # of a wave over a length, with lower and upper weight
Part = tuple[Wave, arb, arb]


def most(
    system: System, numbers: Sequence[arb], witness: Any, horizon: arb, support: Support, parts: Callable[[Wave], list[Part]]
) -> tuple[arb, arb]:
    """The right side of the inequality up to an exact horizon, but for its last term; and q(0)."""
    roots = common(system, 2)
    whole, at, total, first = given(system, roots, numbers), arb(0), arb(0), arb(0)
    low, high = (arb(side) for side in system.task.limits.rate)

    def local(begin: arb) -> Chains:
        return [advanced(root, chain, begin) for root, chain in zip(roots, whole, strict=True)]

    def level(value: arb) -> arb:
        constant = wave(roots, [[acb(0)] * root.multiplicity for root in roots]).raised(value)
        return sum((weight(q) for q in parts(constant)), arb(0))

    def weight(part: Part) -> arb:
        value = part[0](arb(0))[0]  # of a constant
        return (part[2] * value).max(part[1] * value)

    def between(begin: arb, end: arb) -> arb:
        length = end - begin
        if not length.is_exact():
            raise Undecided("the edges of ramps are no exact numbers at this precision")
        return sum((support(q, length, a, b) for q, a, b in parts(wave(roots, local(begin)))), arb(0)) if length > 0 else arb(0)

    for ramp in witness.ramps:
        edges = [arb(edge).mid() for edge in ramp.edges]
        if not edges[0] < horizon:
            break
        total += between(at, edges[0])
        sums = [
            (wave(roots, integrated(roots, local(a)))(b - a)[0] - arb(m) * (b - a))
            for (a, b), m in zip(pairwise(edges), ramp.levels, strict=True)
        ]
        open_end = bool(edges[-1] >= horizon)
        shift = arb(0) if edges[0] == 0 or open_end else sum(sums, arb(0)) / (edges[-1] - edges[0])
        value = -sum(sums, arb(0)) if edges[0] == 0 else arb(0)
        first = value if edges[0] == 0 else first
        for (a, b), m, gained in zip(pairwise(edges), ramp.levels, sums, strict=True):
            if not a < horizon:
                break
            length, constant = b.min(horizon) - a, arb(m) + shift
            if not length.is_exact():
                raise Undecided("the edges of ramps are no exact numbers at this precision")
            total += level(constant) * length
            chains = integrated(roots, local(a))
            chains[0][0] += value
            chains[0][1] -= constant
            total += support(wave(roots, chains), length, low, high)
            value += gained - shift * (b - a)
        at = edges[-1].min(horizon)
    return total + between(at, horizon), first


def moments(system: System, command: Sequence[Number], n: int) -> arb_mat:
    """The moments of the command that goes straight from level to level."""
    instants, levels = [*command[1 : n + 1], command[0]], [*command[n + 1 : 2 * n + 1], system.rest]
    slopes = [arb(b - a) / arb(t - s) for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels), strict=True)]
    total = arb_mat(system.target.nrows(), 1)
    for at, (before, after) in zip(instants, pairwise([arb(0), *slopes]), strict=False):
        change = after - before
        if not change.is_zero():
            total += flat(system.roots, Root.ramp, arb(command[0] - at)) * change
    return total


def derivative(system: System, command: Sequence[Number], n: int, i: int) -> arb_mat:
    """Of these by level i, which is not the first."""
    instants = [*command[1 : n + 1], command[0]]
    before, at, after = (flat(system.roots, Root.ramp, arb(command[0] - instants[j])) for j in (i - 1, i, i + 1))
    return (before - at) / arb(instants[i] - instants[i - 1]) - (at - after) / arb(instants[i + 1] - instants[i])


def prove(system: System, command: Sequence[Number], n: int) -> None:
    """Prove that the command begins at 0 and that its slopes are within their limits; raises `Refuted` or `Undecided`."""
    instants, levels = [*command[1 : n + 1], command[0]], [*command[n + 1 : 2 * n + 1], system.rest]
    if levels[0] != 0:
        raise Refuted("the input jumps at the beginning of the move")
    low, high = system.task.limits.rate
    for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels), strict=True):
        slope = arb(b - a) / arb(t - s)
        if slope > high or slope < low:
            raise Refuted("the slope of the input leaves its limits")
        if not low <= slope <= high:
            raise Undecided("the slope of the input is not told from its limits at this precision")


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
    rate, ramps = task.limits.rate, lower.ramps if lower else ()
    require(rate is not None or not ramps, "ramps belong to limits of the slope")
    if rate is None:
        return
    fine = task.rest == "state" and task.box is None and task.limits.sample_time is None and task.initial_state is None
    fine = fine and not (task.limits.deflection or task.limits.pulse_width or task.limits.pulses)
    require(fine, "limits of the slope belong to a rest of the state, and to no other limits but fuel")
    require(rate[0] < 0 < rate[1], "limits of the slope have room on either side of 0")
    at = fmpq(0)
    for ramp in ramps:
        rising = all(a < b for a, b in pairwise(ramp.edges))
        require(rising and at <= ramp.edges[0] and len(ramp.levels) == len(ramp.edges) - 1, "ramps are disjoint, and ascend")
        at = ramp.edges[-1]
