"""Named outputs in the course of the move: sums of responses to kicks of the input, piece by piece, as exponential polynomials in balls.

An output with transfer function N/D responds to an impulse of the input with `Re Σ c_k s^k/k! e^{ps}`, the inverse transform of N/D; to a
step with that of N/(s D), to a ramp with that of N/(s² D). Between two kicks the output is such a sum, and so is the function p(s) of a
costate from which the multipliers of limits on outputs are taken off (docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from flint import acb, acb_poly, arb, fmpq, fmpq_poly

from relaxations.checking.balls import Root, System, Wave, isolated, spend
from relaxations.checking.reading import Refuted, Undecided, require

Chains = list[list[acb]]  # coefficients c_k of every root
Kick = tuple[arb, Chains]  # when, and what is added from then on


def common(system: System, extra: int) -> tuple[Root, ...]:
    """The roots of the task, the one at the origin with room for `extra` integrations."""
    rigid = next((root.multiplicity for root in system.roots if root.value.is_zero()), 0)
    return (Root(acb(0), rigid + extra), *(root for root in system.roots if not root.value.is_zero()))


def response(system: System, roots: Sequence[Root], name: str, integrals: int) -> Chains:
    """The inverse transform of N/(s^integrals D), N being the output's numerator, as chains over `roots`."""
    (plant,) = system.task.plants
    numerator, denominator = (fmpq_poly(list(written[::-1])) for written in (plant.outputs[name], plant.denominator))
    plain, found = isolated(denominator), []
    for root in roots:
        same = [other for other in plain if other.value.overlaps(root.value)]
        multiplicity = (same[0].multiplicity if same else 0) + (integrals if root.value.is_zero() else 0)
        below = denominator * fmpq_poly([0] * integrals + [1])
        shift = acb_poly([root.value, 1])
        above, lower = ([*acb_poly(p)(shift).coeffs(), *[acb(0)] * multiplicity] for p in (numerator, below))
        lower = lower[multiplicity:]
        series: list[acb] = []
        for k in range(multiplicity):
            series.append((above[k] - sum((series[i] * lower[k - i] for i in range(k)), acb(0))) / lower[0])
        chain = [(1 + root.flexible) * c for c in reversed(series)]
        found.append(chain + [acb(0)] * (root.multiplicity - multiplicity))
    return found


def scaled(chains: Chains, factor: arb) -> Chains:
    """The sum times a real number."""
    return [[c * factor for c in chain] for chain in chains]


def given(system: System, roots: Sequence[Root], numbers: Sequence[arb]) -> Chains:
    """The chains of coefficients in the flat order of the task's roots."""
    rest, by_value = iter(numbers), {id(root): [acb(0)] * root.multiplicity for root in roots}
    for own in system.roots:
        root = next(r for r in roots if r is own or (r.value.is_zero() and own.value.is_zero()))
        for k in range(own.multiplicity):
            by_value[id(root)][k] = acb(next(rest), next(rest) if own.flexible else 0)
    return [by_value[id(root)] for root in roots]


def pieces(roots: tuple[Root, ...], start: Chains, kicks: Sequence[Kick], end: arb) -> Iterator[tuple[arb, Wave]]:
    """From 0 to `end`: the length of every piece between two kicks, which ascend, and the sum there, in the time since the piece began."""
    chains, edges = [list(chain) for chain in start], [arb(0), *(at for at, _ in kicks), end]
    for i, (begin, after) in enumerate(pairwise(edges)):
        if i:
            chains = [[a + b for a, b in zip(chain, added, strict=True)] for chain, added in zip(chains, kicks[i - 1][1], strict=True)]
        length = after - begin
        if length.is_zero():
            continue
        yield (
            length,
            Wave.of(
                roots,
                [part for root, chain in zip(roots, chains, strict=True) for c in chain for part in (c.real, c.imag)[: 1 + root.flexible]],
            ),
        )
        chains = [advanced(root, chain, length) for root, chain in zip(roots, chains, strict=True)]


def advanced(root: Root, chain: list[acb], distance: arb) -> list[acb]:
    """The chain with its origin moved: c_j becomes `e^{pd} Σ_k c_k d^{k-j}/(k-j)!`."""
    spend(2 * len(chain))
    factors = root.impulse(distance)
    return [sum((c * factors[k] for k, c in enumerate(chain[j:])), acb(0)) for j in range(len(chain))]


def pressed(system: System, numbers: Sequence[arb], presses: Sequence[Any], horizon: arb) -> Iterator[tuple[arb, Wave]]:
    """The pieces of p(s) up to an exact horizon: the costate's function less that of the multipliers, at exact instants near those written.

    A multiplier over [begin, end] is spread evenly, one at a single time to go takes the impulse's response off.
    """
    roots = common(system, 1)
    steps = {name: [response(system, roots, name, integrals) for integrals in (0, 1)] for name in {press.output for press in presses}}
    kicks: list[Kick] = []
    for press in presses:
        begin, end = (arb(at).mid() for at in (press.begin, press.end))
        impulse, step = steps[press.output]
        if begin == end:
            kicks.append((begin, scaled(impulse, arb(-press.weight))))
        else:
            rate = arb(press.weight) / (end - begin)
            kicks += [(begin, scaled(step, -rate)), (end, scaled(step, rate))]
    kicks = sorted((kick for kick in kicks if kick[0] < horizon), key=lambda kick: float(kick[0]))
    for (before, _), (after, _) in pairwise(kicks):
        if not before <= after:
            raise Undecided("instants of multipliers are closer together than floats tell")
    for length, wave in pieces(roots, given(system, roots, numbers), kicks, horizon):
        if not length.is_exact():
            raise Undecided("the instants of multipliers are no exact numbers at this precision")
        yield length, wave


def prove(system: System, n: int, command: Sequence[arb | fmpq]) -> None:
    """Prove that every output whose deflection is limited stays within its limit during the move; raises `Refuted` or `Undecided`.

    After the move it stays where it is then, which is within the limit (`sensible`).
    """
    roots = common(system, 1)
    instants, levels = [*command[1 : n + 1], command[0]], [fmpq(0), *command[n + 1 : 2 * n + 1]]
    jumps = [(arb(at), arb(after - before)) for at, (before, after) in zip(instants, pairwise(levels), strict=False)]
    for name, limit in system.task.limits.deflection.items():
        step = response(system, roots, name, 1)
        kicks = [(at, scaled(step, jump)) for at, jump in jumps]
        nothing = [[acb(0)] * root.multiplicity for root in roots]
        for length, wave in pieces(roots, nothing, kicks, arb(command[0])):
            within(wave, length.upper(), arb(limit), name)


def within(wave: Wave, end: arb, limit: arb, name: str) -> None:
    """|wave| ≤ limit on [0, end], by bisection."""
    waiting = [(arb(0), end)]
    while waiting:
        a, b = waiting.pop()
        c, value, _, values = wave.over(a, b)
        if abs(values) <= limit:
            continue
        if abs(value) > limit:
            raise Refuted(f"the output {name} leaves its limit")
        if not (a < c < b and abs(value) <= limit):
            raise Undecided(f"the output {name} is not told from its limit at this precision")
        waiting += [(a, c), (c, b)]


def sensible(task: Any) -> None:
    """Raise `Malformed` unless the limits on outputs are of outputs that the plant has, and these may rest where they come to rest."""
    (plant,) = task.plants
    require(plant.outputs.keys() == task.limits.deflection.keys(), "the outputs written are those whose deflection is limited")
    for name, limit in task.limits.deflection.items():
        numerator = plant.outputs[name]
        fine = task.rest == "state" and task.box is None and task.limits.sample_time is None and task.initial_state is None
        require(fine, "limits on outputs belong to a state rest, without a box, a sample time or an initial state")
        fine = limit > 0 and numerator[0] != 0 and len(numerator) < len(plant.denominator)
        require(fine, f"the limit of the output {name} is more than 0, and it is strictly proper")
        require(abs(task.displacement * numerator[-1] / plant.numerator[-1]) <= limit, f"the output {name} rests beyond its limit")
