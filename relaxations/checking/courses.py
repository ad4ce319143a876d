"""Named outputs in the course of the move: sums of responses to kicks of the input, piece by piece, as exponential polynomials in balls.

An output with transfer function N/D responds to an impulse of the input with `Re Σ c_k s^k/k! e^{ps}`, the inverse transform of N/D; to a
step with that of N/(s D), to a ramp with that of N/(s² D). Between two kicks the output is such a sum, and so is the function p(s) of a
costate from which the multipliers of limits on outputs are taken off (docs/theory.md, section 3). A plant that is not at rest at first adds
what the output does without an input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate, pairwise
from typing import Any

from flint import acb, acb_poly, arb, fmpq, fmpq_poly

from relaxations.checking.balls import Root, System, Wave, isolated, spend
from relaxations.checking.reading import Refuted, Undecided, require

Chains = list[list[acb]]  # coefficients c_k of every root
Kick = tuple[Any, Chains]  # when (a ball, or a fraction), and what is added from then on
Piece = tuple[Any, Any, Chains]  # when it begins, how long it is, and the sum there, in the time since


def common(roots: Sequence[Root], extra: int) -> tuple[Root, ...]:
    """The roots, first the one at the origin, with room for `extra` integrations."""
    rigid = next((root.multiplicity for root in roots if root.value.is_zero()), 0)
    return (Root(acb(0), rigid + extra), *(root for root in roots if not root.value.is_zero()))


def response(system: System, roots: Sequence[Root], name: str, integrals: int) -> Chains:
    """The inverse transform of N/(s^integrals D), N being the output's numerator, as chains over `roots`."""
    (plant,) = system.task.plants
    numerator, denominator = (fmpq_poly(list(written[::-1])) for written in (plant.outputs[name], plant.denominator))
    plain, found = isolated(denominator), []
    if not all(any(pole.value.overlaps(root.value) for root in roots) for pole in plain):
        raise Undecided("an output moves with poles that are not among those looked at")
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


def free(system: System, roots: Sequence[Root], name: str) -> Chains:
    """What an output does without an input: `Σ_k w_k M_k`, w from its impulse response, M the moments of the initial state."""
    begins = accumulate((root.multiplicity for root in system.roots), initial=0)
    moments = [(root.value, system.begin[at : at + root.multiplicity]) for root, at in zip(system.roots, begins, strict=False)]
    found = []
    for root, weights in zip(roots, response(system, roots, name, 0), strict=True):
        own = next((m for value, m in moments if value is root.value or (value.is_zero() and root.value.is_zero())), ())
        sums = [sum((w * m for w, m in zip(weights[i:], own, strict=False)), acb(0)) for i in range(root.multiplicity)]
        found.append(sums)
    return found


def scaled(chains: Chains, factor: arb) -> Chains:
    """The sum times a real number."""
    return [[c * factor for c in chain] for chain in chains]


def given(own: Sequence[Root], roots: Sequence[Root], numbers: Sequence[arb]) -> Chains:
    """The chains over `roots` of coefficients in the flat order of the roots that are their `own`."""
    rest, by_value = iter(numbers), {id(root): [acb(0)] * root.multiplicity for root in roots}
    for one in own:
        root = next(r for r in roots if r is one or (r.value.is_zero() and one.value.is_zero()))
        for k in range(one.multiplicity):
            by_value[id(root)][k] = acb(next(rest), next(rest) if one.flexible else 0)
    return [by_value[id(root)] for root in roots]


def pieces(roots: tuple[Root, ...], start: Chains, kicks: Sequence[Kick], end: Any) -> Iterator[Piece]:
    """From 0 to `end`: the pieces between kicks, which ascend."""
    chains, edges = [list(chain) for chain in start], [end * 0, *(at for at, _ in kicks), end]
    for i, (begin, after) in enumerate(pairwise(edges)):
        if i:
            chains = [[a + b for a, b in zip(chain, added, strict=True)] for chain, added in zip(chains, kicks[i - 1][1], strict=True)]
        length = after - begin
        if length == 0:
            continue
        yield begin, length, chains
        chains = [advanced(root, chain, arb(length)) for root, chain in zip(roots, chains, strict=True)]


def advanced(root: Root, chain: list[acb], distance: arb) -> list[acb]:
    """The chain with its origin moved: c_j becomes `e^{pd} Σ_k c_k d^{k-j}/(k-j)!`."""
    spend(2 * len(chain))
    factors = root.impulse(distance)
    return [sum((c * factors[k] for k, c in enumerate(chain[j:])), acb(0)) for j in range(len(chain))]


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


def value(roots: Sequence[Root], chains: Chains, at: arb) -> arb:
    """The sum at an instant."""
    return sum(
        (c * b for root, chain in zip(roots, chains, strict=True) for c, b in zip(chain, root.impulse(at), strict=True)), acb(0)
    ).real


def wave(roots: tuple[Root, ...], chains: Chains) -> Wave:
    """The sum, to be enclosed over intervals."""
    pairs = ((root, c) for root, chain in zip(roots, chains, strict=True) for c in chain)
    return Wave.of(roots, [part for root, c in pairs for part in (c.real, c.imag)[: 1 + root.flexible]])


def near(system: System, at: fmpq) -> Any:
    """The instant itself where the input is constant over samples, else an exact ball beside it: multipliers may act anywhere."""
    return at if system.task.limits.sample_time else arb(at).mid()


def pressed(
    system: System, roots: tuple[Root, ...], presses: Sequence[Any], horizon: Any, answer: Callable[[str, int], Chains] | None = None
) -> list[Kick]:
    """What multipliers of outputs take off the costate's function up to the horizon, in order of the time to go.

    One over [begin, end] is spread evenly, one at a single time to go takes the impulse's response off. `answer` is the response, of an
    output by so many integrals, of another plant than the task's.
    """
    names, answer = {press.output for press in presses}, answer or (lambda name, integrals: response(system, roots, name, integrals))
    responses = {name: [answer(name, integrals) for integrals in (0, 1)] for name in names}
    kicks: list[Kick] = []
    for press in presses:
        begin, end = (near(system, at) for at in (press.begin, press.end))
        impulse, step = responses[press.output]
        if begin == end:
            kicks.append((begin, scaled(impulse, arb(-press.weight))))
        else:
            rate = arb(press.weight) / arb(end - begin)
            kicks += [(begin, scaled(step, -rate)), (end, scaled(step, rate))]
    return sorted((kick for kick in kicks if kick[0] < horizon), key=lambda kick: kick[0])


def begun(system: System, roots: tuple[Root, ...], presses: Sequence[Any], horizon: Any) -> arb:
    """What the multipliers of outputs add to the left side where the plant is not at rest at first: ν times the output without an input."""
    total = arb(0)
    for name in {press.output for press in presses} if system.begin else ():
        course = free(system, roots, name)
        whole = integrated(roots, course)
        for press in presses:
            begin, end = (near(system, at) for at in (press.begin, press.end))
            if press.output != name or begin >= horizon:
                continue
            if begin == end:
                total += arb(press.weight) * value(roots, course, arb(horizon - begin))
                continue
            first = arb(0) if end >= horizon else value(roots, whole, arb(horizon - end))
            total += arb(press.weight) / arb(end - begin) * (value(roots, whole, arb(horizon - begin)) - first)
    return total


def prove(system: System, n: int, command: Sequence[arb | fmpq]) -> None:
    """Prove that every output whose deflection is limited stays within its limit during the move; raises `Refuted` or `Undecided`.

    After the move it stays where it is then, which is within the limit (`sensible`), but for what a tail does to it. Of a box see
    `excursions`.
    """
    if system.task.box is not None:
        return
    roots = common(system.roots, 2)
    instants, levels = [*command[1 : n + 1], command[0]], [fmpq(0), *command[n + 1 : 2 * n + 1], system.end(command[2 * n + 1 :])]
    if system.sloped:  # straight from level to level: the slope jumps
        slopes = [arb(b - a) / arb(t - s) for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels[1:]), strict=True)]
        jumps = [(arb(at), after - before) for at, (before, after) in zip(instants, pairwise([arb(0), *slopes]), strict=False)]
    else:
        jumps = [(arb(at), arb(after - before)) for at, (before, after) in zip(instants, pairwise(levels), strict=True)][:-1]
    for name, limit in system.task.limits.deflection.items():
        answer = response(system, roots, name, 1 + system.sloped)
        kicks = [(at, scaled(answer, jump)) for at, jump in jumps]
        first, last = beginning(system.task, name), resting(system.task, name)
        parts = list(pieces(roots, free(system, roots, name), kicks, arb(command[0])))
        for i, (begin, length, chains) in enumerate(parts):
            known = first if begin == 0 else (), last if i == len(parts) - 1 else ()
            within(wave(roots, chains), length.upper(), limit, name, *known)


def within(course: Wave, end: arb, limit: fmpq, name: str, first: Sequence[fmpq], last: Sequence[fmpq] = ()) -> None:
    """|course| ≤ limit on [0, end], by bisection; where its value at 0 or at the end is exact, with some derivatives (`first`, `last`), it
    may touch the limit there."""
    waiting = [(arb(0), end)]
    while waiting:
        a, b = waiting.pop()
        c, value, _, values = course.over(a, b)
        span = a.union(b)

        def touches(side: int, a: arb = a, b: arb = b, span: arb = span) -> bool:
            begins = a == 0 and recedes(course, span, limit, [side * x for x in first], side)
            return begins or (b == end and recedes(course, span, limit, [side * x for x in last], side, back=True))

        if all(side * values <= limit or touches(side) for side in (1, -1)):
            continue
        if abs(value) > limit:
            raise Refuted(f"the output {name} leaves its limit")
        if not (a < c < b and abs(value) <= limit and b * 2**60 > end):
            raise Undecided(f"the output {name} is not told from its limit at this precision")
        waiting += [(a, c), (c, b)]


def recedes(course: Wave, span: arb, limit: fmpq, first: Sequence[fmpq], side: int, back: bool = False) -> bool:
    """Whether, by Taylor's formula, a course that may be at its limit at one end of a span does not pass it in there.

    `first` is its value and derivatives at the end where the span begins, or, looking `back`, at the other one.
    """
    if not first or first[0] > limit:
        return False
    turned = -1 if back else 1  # d/d(-t)
    first = [x * turned**k for k, x in enumerate(first)]
    derivatives = [side * turned**k * x for k, x in enumerate(course(span))]
    return any(derivatives[k] <= 0 and all(x <= 0 for x in first[1:k]) for k in range(1, min(len(first) + 1, len(derivatives))))


def beginning(task: Any, name: str) -> list[fmpq]:
    """By how much an output deviates at first, y = N(d/dt) ξ, and all its derivatives that the input has no part in; exactly."""
    (plant,), start = task.plants, task.initial_state or ()
    numerator = plant.outputs[name][::-1]
    return [sum((c * x for c, x in zip(numerator, start[k:], strict=False)), fmpq(0)) for k in range(len(start) - len(numerator) + 1)]


def resting(task: Any, name: str) -> list[fmpq]:
    """What an output deviates by where it comes to rest, and its derivatives that are 0 there, the input having no part in them;
    none where a tail goes on moving it."""
    (plant,) = task.plants
    if task.rest != "state":
        return []
    numerator = plant.outputs[name]
    final = task.displacement * numerator[-1] / plant.numerator[-1]
    return [final, *[fmpq(0)] * (len(plant.denominator) - 1 - len(numerator))]


def sensible(task: Any) -> None:
    """Raise `Malformed` unless the limits on outputs are of outputs that the plant has, and these may begin and rest where they do."""
    (plant,) = task.plants
    require(plant.outputs.keys() == task.limits.deflection.keys(), "the outputs written are those whose deflection is limited")
    for name, limit in task.limits.deflection.items():
        numerator = plant.outputs[name]
        fine = limit > 0 and numerator[0] != 0 and len(numerator) < len(plant.denominator)
        require(fine, f"the limit of the output {name} is more than 0, and it is strictly proper")
        require(abs(task.displacement * numerator[-1] / plant.numerator[-1]) <= limit, f"the output {name} rests beyond its limit")
        require(all(abs(x) <= limit for x in beginning(task, name)[:1]), f"the output {name} begins beyond its limit")
