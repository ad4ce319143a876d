"""The upper side: a command that provably exists. Some of its numbers (instants, levels, tail coefficients, the duration) are unknowns;
Krawczyk's test proves that exact values lie near those written, at which the plant comes to rest, and the limits are checked on their balls.

One mechanism serves commands refined to exact switch times and staircases repaired on a grid (docs/theory.md, section 4). A command of n
segments is a list: its duration, n starts, n levels (deviations from the initial rest input), its tail's coefficients in the flat order.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import factorial

from flint import arb, arb_mat, fmpq

from relaxations.checking.balls import Refuted, Root, System, Undecided, Wave, dot, flat, placed, spend
from relaxations.checking.reading import Upper, require

Number = fmpq | arb
"""Exact as written, or the ball of an unknown."""


def as_written(system: System, witness: Upper) -> tuple[list[Number], list[int]]:
    """The command, and the places of its unknowns."""
    starts, levels = ([segment[part] for segment in witness.segments] for part in (0, 1))
    tail, found = placed(system.zeros, witness.tail)
    first, unknowns = {"time": 0, "start": 1, "level": 1 + len(starts)}, []
    for kind, i, k in witness.free:
        if kind in first:
            unknowns.append(first[kind] + i)
            continue
        begin, zero = found[i]
        require(zero.flexible or kind == "re", "the coefficients at a real zero have no imaginary part to solve for")
        unknowns.append(1 + 2 * len(starts) + begin + (1 + zero.flexible) * k + (kind == "im"))
    return [witness.maneuver_time, *starts, *(level - system.task.initial_input for level in levels), *tail], unknowns


def residual(system: System, n: int, command: list[Number]) -> list[arb]:
    """The moments of the command minus where they must be, tail included."""
    total = [-value for value in system.target]
    starts, levels = command[1 : n + 1], command[n + 1 : 2 * n + 1]
    for start, (before, level) in zip(starts, pairwise([fmpq(0), *levels]), strict=True):
        if level != before:
            steps = flat(system.roots, partial(Root.step, s=arb(command[0] - start)))
            total = [value + (level - before) * x for value, x in zip(total, steps, strict=True)]
    for number, column in zip(command[2 * n + 1 :], system.columns, strict=True):
        total = [value - number * x for value, x in zip(total, column, strict=True)]
    return total


def jacobian(system: System, n: int, command: list[Number], unknowns: list[int]) -> arb_mat:
    """Derivatives of the residual by each unknown, over the command's balls."""
    instants, levels = [*command[1 : n + 1], command[0]], command[n + 1 : 2 * n + 1]

    def impulses(i: int) -> list[arb]:
        jump = levels[i] - (levels[i - 1] if i else 0)
        return [jump * b for b in flat(system.roots, partial(Root.impulse, s=arb(command[0] - instants[i])))]

    def column(place: int) -> list[arb]:
        if place == 0:
            return [sum(own, arb(0)) for own in zip(*map(impulses, range(n)), strict=True)]
        if place <= n:
            return [-x for x in impulses(place - 1)]
        if place > 2 * n:
            return [-x for x in system.columns[place - 2 * n - 1]]
        first, last = (flat(system.roots, partial(Root.step, s=arb(command[0] - instants[place - n - k]))) for k in (1, 0))
        return [a - b for a, b in zip(first, last, strict=True)]

    return arb_mat([column(place) for place in unknowns]).transpose()


def solve(system: System, witness: Upper) -> list[Number]:
    """Krawczyk: `K = x - Y F(x) + (I - Y J(X)) (X - x)` inside X proves a solution in K; returns the command with its unknowns in K."""
    (command, unknowns), n, size = as_written(system, witness), len(witness.segments), len(system.target)
    require(len(unknowns) == size, f"{size} equations need {size} unknowns, upper.free names {len(unknowns)}")
    if size == 0:
        return command

    def moved(changes: list[arb]) -> list[Number]:
        result = list(command)
        for place, change in zip(unknowns, changes, strict=True):
            result[place] += change
        return result

    spend(2 * size**3)
    spread = arb(0, arb(witness.radius).upper())
    slopes = jacobian(system, n, moved([spread] * size), unknowns)
    try:
        inverse = arb_mat([[x.mid() for x in row] for row in slopes.tolist()]).inv()
    except ZeroDivisionError:
        raise Undecided("the equations for the unknowns are singular at this precision") from None
    inverse = arb_mat([[x.mid() for x in row] for row in inverse.tolist()])
    identity = arb_mat([[int(i == j) for j in range(size)] for i in range(size)])
    image = (identity - inverse * slopes) * arb_mat([[spread]] * size) - inverse * arb_mat([[x] for x in residual(system, n, command)])
    changes = [image[i, 0] for i in range(size)]
    if all(spread.contains_interior(change) for change in changes):
        return moved(changes)
    if any(not spread.overlaps(change) for change in changes):
        raise Refuted("no command within the radius of the one written brings the plant to rest")
    raise Undecided("Krawczyk's test does not contract at this precision")


def at_most(a: Number, b: Number, what: str) -> None:
    """`a ≤ b`: exactly between fractions, else by their balls."""
    if a > b:
        raise Refuted(f"not so: {what}")
    if not a <= b:
        raise Undecided(f"undecided at this precision: {what}")


def settled(tail: Wave, r: arb, above: fmpq, below: fmpq) -> bool:
    """Whether the tail is within its room from r on: by its envelope, or, with no room on one side, by the sign of its slowest term."""
    rates, powers, parts, coefficients = [zero.value.real for zero in tail.roots], [], [], iter(tail.rows.tolist()[0])
    for zero, rate in zip(tail.roots, rates, strict=True):
        sizes = [abs(next(coefficients)) for _ in range(zero.multiplicity)]
        powers.append(max((k for k, size in enumerate(sizes) if not size.is_zero()), default=0))
        parts.append(dot(sizes, [(rate * r).exp() * r**k / factorial(k) for k in range(zero.multiplicity)]))
    if not all(-rate * r >= power for rate, power in zip(rates, powers, strict=True)):
        return False  # r^k e^{-ar} falls from r = k/a on only
    envelope = sum(parts, arb(0))
    if envelope <= min(above, below):
        return True
    # Each other part over the slowest is r^k e^{-dr}, which falls from r = k/d on: what the slowest outweighs at r, it outweighs for ever.
    slowest = max((i for i, part in enumerate(parts) if not part.is_zero()), key=lambda i: float(rates[i].mid()))
    others = [i for i, part in enumerate(parts) if i != slowest and not part.is_zero()]
    falls = all((rates[slowest] - rates[i]) * r >= powers[i] for i in others) and powers[slowest] == 0 and not tail.roots[slowest].flexible
    first = tail.rows[0, sum(zero.multiplicity for zero in tail.roots[:slowest])].real
    inward = (above == 0 and first < 0) or (below == 0 and first > 0)
    return bool(falls and inward and envelope <= max(above, below) and sum((parts[i] for i in others), arb(0)) < parts[slowest])


def inside(tail: Wave, start: arb, end: arb, room: tuple[fmpq, fmpq], first: fmpq | None) -> None:
    """-below ≤ tail ≤ above on [start, end], by subdivision; a tail that begins at 0 with the exact value `first` may touch a limit there."""
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


def tail_limits(system: System, n: int, command: list[Number]) -> None:
    """The tail within its limits for ever: on [0, far] by subdivision, beyond as `settled` says."""
    if all(number == 0 for number in command[2 * n + 1 :]):
        return
    tail = Wave.of(system.zeros, command[2 * n + 1 :])
    later, far = (system.task.limits[1] or (fmpq(0), None))[0], max((-1 / zero.value.real).upper() for zero in tail.roots)
    for _ in range(100):
        if far >= later and settled(tail, far, *system.room(later)):
            break
        far *= 2
    else:
        raise Undecided("the tail does not settle within the limits: the final rest input may lie on one")
    (data,), first = system.task.plants, None
    if n == 0 and len(data.numerator) == len(data.denominator):
        # A command that is all tail: the output jumps to its target by the feed-through at once, u(0+) = u_0 + Δ/D, exactly.
        first = system.task.displacement / data.numerator[0] - system.rest
    # The tighter limits of a tail length count from its time on; the ball of that instant obeys both.
    if later > 0:
        inside(tail, arb(0), arb(later).upper(), system.room(fmpq(-1)), first)
    inside(tail, arb(later).lower(), far, system.room(later), first)


def prove(system: System, witness: Upper, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists; raises `Refuted` or `Undecided`."""
    command, n = solve(system, witness), len(witness.segments)
    for i, (before, after) in enumerate(pairwise([*command[1 : n + 1], command[0]]), 1):
        at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(command[n + 1 : 2 * n + 1]):
        at_most(system.lower, level, f"level {i} is above its limit")
        at_most(level, system.upper, f"level {i} is below its limit")
    tail_limits(system, n, command)
    at_most(command[0], time, "the command takes no longer than claimed")
