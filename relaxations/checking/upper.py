"""The upper side: a command that provably exists. Some of its numbers (instants, levels, tail coefficients, duration) are unknowns:
Krawczyk's test proves that exact values lie near those written, with which the plant comes to rest; the limits are checked on their balls.

One mechanism serves commands refined to exact switch times and staircases repaired on a grid (docs/theory.md, section 4). A command of n
segments is a list: its duration, n starts, n levels (deviations from the initial rest input), its tail's coefficients in the flat order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import factorial
from typing import Any

from flint import acb, arb, arb_mat, fmpq

from relaxations.checking import boxes, changes, costs, courses, mirrored, ramps
from relaxations.checking.balls import Root, System, Wave, flat, placed, spend
from relaxations.checking.reading import Refuted, Undecided, require

Number = fmpq | arb  # exact as written, or the ball of an unknown


def as_written(task: Any, zeros: Sequence[Root], witness: Any) -> tuple[list[Number], list[int]]:
    """The command, and the places of its unknowns."""
    n, (tail, found) = len(witness.segments), placed(zeros, witness.tail)
    places = {("time", 0, 0): 0} if n else {}
    places |= {("start", i, 0): 1 + i for i in range(1, n)} | {("level", i, 0): 1 + n + i for i in range(n)}
    for i, (begin, zero) in enumerate(found):
        parts = [(part, i, k) for k in range(zero.multiplicity) for part in ("re", "im")[: 1 + zero.flexible]]
        places |= {part: 1 + 2 * n + begin + j for j, part in enumerate(parts)}
    for name in witness.free:
        require(name in places, f"upper.free names no unknown: {[*name]!r:.80}")
    require(len(set(witness.free)) == len(witness.free), "upper.free names an unknown twice")
    levels = [segment.level - task.initial_input for segment in witness.segments]
    command = [witness.maneuver_time, *(segment.start for segment in witness.segments), *levels, *tail]
    if task.limits.rate is not None and task.limits.sample_time is None:
        fine = all(kind in ("re", "im") or (kind == "level" and i > 0) for kind, i, _ in witness.free)
        require(fine, "with limits of the slope the unknowns are levels, the first one excepted, and the tail")
    if step := task.limits.sample_time:
        fixed = all((instant / step).q == 1 for instant in command[: n + 1]) and all(kind == "level" for kind, _, _ in witness.free)
        require(fixed, "with a sample time all instants are exact multiples of it, and none is an unknown")
    return command, [places[name] for name in witness.free]


def residual(system: System, n: int, command: list[Number]) -> arb_mat:
    """The moments of the command minus where they must be, tail included."""
    tail = command[2 * n + 1 :]
    total = system.drift(arb(command[0])) - system.target - system.columns * arb_mat(len(tail), 1, tail)
    if system.sloped:
        return total + ramps.moments(system, command, n)
    for start, (before, level) in zip(command[1 : n + 1], pairwise([fmpq(0), *command[n + 1 : 2 * n + 1]]), strict=True):
        if not arb(level - before).is_zero():
            total += flat(system.roots, Root.step, arb(command[0] - start)) * arb(level - before)
    return total


def derivative(system: System, n: int, command: list[Number], place: int) -> arb_mat:
    """Of the residual by the number at `place`, over the command's balls."""
    instants, levels = [*command[1 : n + 1], command[0]], [fmpq(0), *command[n + 1 : 2 * n + 1]]

    def begun(entries: Any, i: int) -> arb_mat:
        return flat(system.roots, entries, arb(command[0] - instants[i]))

    if system.sloped and place <= 2 * n:
        return ramps.derivative(system, command, n, place - n - 1)
    if place == 0:
        return sum((begun(Root.impulse, i) * arb(levels[i + 1] - levels[i]) for i in range(n)), system.drift(arb(command[0]), True))
    if place <= n:
        return begun(Root.impulse, place - 1) * arb(levels[place - 1] - levels[place])
    if place <= 2 * n:
        return begun(Root.step, place - n - 1) - begun(Root.step, place - n)
    unit = [fmpq(j == place - 2 * n - 1) for j in range(system.columns.ncols())]
    moved = (
        ramps.derivative(system, command, n, n) * arb(system.end(unit) - system.rest)
        if system.sloped and n
        else arb_mat(system.target.nrows(), 1)
    )
    return moved - system.columns * arb_mat(len(unit), 1, unit)


def exactly(system: System, n: int, command: list[Any]) -> None:
    """A command of fractions alone, where all equations are those at the origin: they hold, or not."""
    levels = [fmpq(0), *command[n + 1 : 2 * n + 1]]
    for k in range(1, system.target.nrows() + 1):
        terms = ((after - before) * (command[0] - s) ** k for s, (before, after) in zip(command[1 : n + 1], pairwise(levels), strict=True))
        if sum(terms, fmpq(0)) != (factorial(k) * system.highest if k == system.target.nrows() else 0):
            raise Refuted("the command as written, without unknowns, does not bring the plant to rest")


def krawczyk(
    command: list[Number],
    unknowns: list[int],
    size: int,
    radius: fmpq,
    residual: Callable[[list[Number]], arb_mat],
    derivative: Callable[[list[Number], int], arb_mat],
) -> list[Number]:
    """`K = x - Y F(x) + (I - Y J(X)) (X - x)` inside X proves a solution in K; returns the command with its unknowns in K."""
    require(len(unknowns) == size, f"{size} equations need {size} unknowns, upper.free names {len(unknowns)}")

    def moved(changes: list[arb]) -> list[Number]:
        by = dict(zip(unknowns, changes, strict=True))
        return [number + by[place] if place in by else number for place, number in enumerate(command)]

    spend(size**3 / 8)
    spread = arb(0, arb(radius).upper())
    wide = moved([spread] * size)
    slopes = arb_mat(size, size, [x for place in unknowns for x in derivative(wide, place).entries()]).transpose()
    inverse = slopes.mid().inv().mid()
    spreads = arb_mat(size, 1, [spread] * size)
    changes = ((arb_mat(size, size, 1) - inverse * slopes) * spreads - inverse * residual(command)).entries()
    if all(spread.contains_interior(change) for change in changes):
        return moved(changes)
    if any(not spread.overlaps(change) for change in changes):
        raise Refuted("no command within the radius of the one written brings the plant to rest")
    raise Undecided("Krawczyk's test does not contract at this precision")


def solve(system: System, n: int, witness: Any) -> list[Number]:
    """The command with its unknowns in balls that hold a solution."""
    (command, unknowns), size = as_written(system.task, system.zeros, witness), system.target.nrows()
    if witness.mirrored:
        half = mirrored.Half.of(system, n, command, witness.free)
        return half.whole(krawczyk(command, unknowns, len(half.places), witness.radius, half.residual, half.derivative))
    at_origin = all(root.value.is_zero() for root in system.roots)
    if not unknowns and not system.begin and at_origin and not (system.sloped and size):
        exactly(system, n, command)
        return command
    return krawczyk(
        *(command, unknowns, size, witness.radius),
        lambda command: residual(system, n, command),
        lambda command, place: derivative(system, n, command, place),
    )


def at_most(a: Number, b: Number, what: str) -> None:
    """`a ≤ b`: exactly between fractions, else by their balls."""
    if a > b:
        raise Refuted(f"not so: {what}")
    if not a <= b:
        raise Undecided(f"undecided at this precision: {what}")


def settled(tail: Wave, r: arb, above: fmpq, below: fmpq) -> bool:
    """Whether -below ≤ tail ≤ above from r on: by its envelope, the larger room being enough if its slowest term keeps it on that side."""
    places = [(root, k) for root in tail.roots for k in range(root.multiplicity)]
    terms = [(root, k, c) for (root, k), c in zip(places, tail.rows.tolist()[0], strict=True) if not c.is_zero()]

    def envelope(terms: list[tuple[Root, int, acb]], rate: arb) -> arb:
        """`Σ |c| r^k/k! e^{(Re z - rate) r}`, which only falls from r on, or infinity: r^k e^{-ar} falls from r = k/a on."""
        falls = all((rate - root.value.real) * r >= k for root, k, _ in terms)
        parts = (abs(c) * r**k / factorial(k) * ((root.value.real - rate) * r).exp() for root, k, c in terms)
        return sum(parts, arb(0)) if falls else arb("inf")

    whole = envelope(terms, arb(0))
    if whole <= min(above, below):
        return True
    root, k, c = slowest = max(terms, key=lambda term: float(term[0].value.real.mid()))
    outweighs = envelope([term for term in terms if term is not slowest], root.value.real) < abs(c)
    return not root.flexible and k == 0 and outweighs and whole <= (below if c.real < 0 else above)


def inside(tail: Wave, start: arb, end: arb, room: tuple[fmpq, fmpq], first: fmpq | None) -> None:
    """-below ≤ tail ≤ above on [start, end], by bisection; a tail that begins with the exact value `first` may touch a limit at 0."""
    (above, below), waiting = room, [(start, end)]
    while waiting:
        a, b = waiting.pop()
        c, value, slope, values = tail.over(a, b)
        begins = first is not None and a == 0 and -below <= first <= above
        if (values <= above or (begins and slope <= 0)) and (values >= -below or (begins and slope >= 0)):
            continue
        if value > above or value < -below:
            raise Refuted("the tail leaves the limits")
        if not (a < c < b and -below <= value <= above):
            raise Undecided("the tail is not told from a limit at this precision")
        waiting += [(a, c), (c, b)]


def far(tail: Wave, later: fmpq, above: fmpq, below: fmpq) -> arb:
    """An instant from which on a tail is settled."""
    at = max(arb(later).upper(), *((-1 / zero.value.real).upper() for zero in tail.roots))
    for _ in range(100):
        if settled(tail, at, above, below):
            return at
        at *= 2
    raise Undecided("the tail does not settle within the limits: the final rest may lie on one")


def tail_limits(system: System, n: int, command: list[Number]) -> None:
    """The tail within its limits for ever, what it does to its slope and to outputs too: by subdivision until it is `settled`."""
    numbers, length = command[2 * n + 1 :], system.task.limits.tail_length
    if all(number == 0 for number in numbers):
        return
    tail, later = Wave.of(system.zeros, numbers), length.time if length else fmpq(0)
    for output in ([None] if system.task.limits.rate is not None else []) + [*system.task.limits.deflection]:
        answer, above, below = system.after(output)
        rest, chains = iter(numbers), []
        for zero in system.zeros:
            chains += answer([acb(next(rest), next(rest) if zero.flexible else 0) for _ in range(zero.multiplicity)], zero)
        flexible = [zero.flexible for zero in system.zeros for _ in range(zero.multiplicity)]
        course = Wave.of(system.zeros, [part for c, pair in zip(chains, flexible, strict=True) for part in (c.real, c.imag)[: 1 + pair]])
        inside(course, arb(0), far(course, fmpq(0), above, below), (above, below), None)
    beyond = far(tail, later, *system.room(later))
    (plant,), first = system.task.plants, None
    if n == 0 and len(plant.numerator) == len(plant.denominator):
        # A command that is all tail: the output jumps to its target by the feed-through at once, u(0+) = u_0 + Δ/D, exactly.
        first = system.task.displacement / plant.numerator[0] - system.rest
    # The tighter limits of a tail length count from its time on; the ball of that instant obeys both.
    inside(tail, arb(0), arb(later).upper(), system.room(fmpq(-1)), first)
    inside(tail, arb(later).lower(), beyond, system.room(later), first)


def pulsed(task: Any, command: Sequence[Number], n: int, free: Sequence[Any]) -> None:
    """Prove that every piece that is not exactly at the initial input is at a limit, wide enough, and that there are few enough of them."""
    limits = task.limits
    if not (limits.pulse_width or limits.pulses):
        return
    pulses = [i for i in range(n) if not arb(command[n + 1 + i]).is_zero()]
    full = all(command[n + 1 + i] in [side - task.initial_input for side in limits.input] for i in pulses)
    require(full and all(kind != "level" for kind, _, _ in free), "pulses are exactly at a limit of the input")
    for i in pulses if limits.pulse_width else ():
        width = arb([*command[1 : n + 1], command[0]][i + 1]) - arb(command[1 + i])
        at_most(limits.pulse_width, width, f"pulse {i} is wide enough")
    at_most(fmpq(len(pulses)), fmpq(limits.pulses or n), "there are no more pulses than allowed")


def prove(system: System, witness: Any, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists; raises `Refuted` or `Undecided`."""
    at_most(admissible(system, witness)[0], time, "the command takes no longer than claimed")


def cheap(system: System, witness: Any, price: fmpq, cost: fmpq) -> None:
    """Prove that an admissible command exists which costs at most `cost`, its fuel priced; raises `Refuted` or `Undecided`."""
    command = admissible(system, witness)
    at_most(costs.within(system, price, command, len(witness.segments)), cost, "the command costs no more than claimed")


def admissible(system: System, witness: Any) -> list[Number]:
    """The command of a witness, proven to be within all limits; raises `Refuted` or `Undecided`."""
    n = len(witness.segments)
    command = solve(system, n, witness)
    for i, (before, after) in enumerate(pairwise([*command[1 : n + 1], command[0]]), 1):
        at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(command[n + 1 : 2 * n + 1]):
        at_most(system.lower, level, f"level {i} is above its limit")
        at_most(level, system.upper, f"level {i} is below its limit")
    if system.task.limits.fuel is not None:
        instants = [*command[1 : n + 1], command[0]]
        levels = command[n + 1 : 2 * n + 1]
        burnt = (abs(arb(level)) * arb(b - a) for level, (a, b) in zip(levels, pairwise(instants), strict=True))
        at_most(
            ramps.burnt([*levels, system.end(command[2 * n + 1 :])], instants) if system.sloped else sum(burnt, arb(0)),
            system.task.limits.fuel,
            "the move uses no more fuel than there is",
        )
    courses.prove(system, n, command)
    if system.task.limits.rate is not None:
        ramps.prove(system, command, n)
    if system.task.limits.held:
        changes.form(system, command[n + 1 : 2 * n + 1])
    pulsed(system.task, command, n, witness.free)
    tail_limits(system, n, command)
    for places, cap in system.capped:
        at_most(abs(acb(*(arb(command[2 * n + 1 + place]) for place in places))), cap, "the tail is insensitive to a zero's place")
    if system.task.box is not None:
        boxes.prove(system, command, n)
    return command
