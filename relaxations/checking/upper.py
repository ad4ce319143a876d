"""The upper side: a command that provably exists. Some of its numbers (instants, levels, tail coefficients, duration) are unknowns:
Krawczyk's test proves that exact values lie near those written, with which the plant comes to rest; the limits are checked on their balls.

One mechanism serves commands refined to exact switch times and staircases repaired on a grid (docs/theory.md, section 4). A command of n
segments is a list: its duration, n starts, n levels (deviations from the initial rest input), its tail's coefficients in the flat order.
"""

from __future__ import annotations

from itertools import pairwise
from math import factorial
from typing import Any

from flint import arb, arb_mat, fmpq

from relaxations.checking.balls import Refuted, System, Undecided, Wave, placed, spend
from relaxations.checking.reading import require

Number = fmpq | arb
"""Exact as written, or the ball of an unknown."""


def as_written(system: System, witness: Any) -> tuple[list[Number], list[int]]:
    """The command, and the places of its unknowns."""
    segments, (tail, found) = witness.segments, placed(system.zeros, witness.tail)
    first, unknowns = {"time": 0, "start": 1, "level": 1 + len(segments)}, []
    for kind, i, k in witness.free:
        begin, zero = found[i] if kind not in first else (0, None)
        require(zero is None or zero.flexible or kind == "re", "the coefficients at a real zero have no imaginary part to solve for")
        place = first[kind] + i if zero is None else 1 + 2 * len(segments) + begin + (1 + zero.flexible) * k + (kind == "im")
        unknowns.append(place)
    levels = [segment.level - system.task.initial_input for segment in segments]
    return [witness.maneuver_time, *(segment.start for segment in segments), *levels, *tail], unknowns


def residual(system: System, n: int, command: list[Number]) -> arb_mat:
    """The moments of the command minus where they must be, tail included."""
    tail = command[2 * n + 1 :]
    total = -system.target - system.columns * arb_mat(len(tail), 1, tail)
    for start, (before, level) in zip(command[1 : n + 1], pairwise([fmpq(0), *command[n + 1 : 2 * n + 1]]), strict=True):
        if not arb(level - before).is_zero():
            total += system.steps(command[0] - start) * arb(level - before)
    return total


def derivative(system: System, n: int, command: list[Number], place: int) -> arb_mat:
    """Of the residual by the number at `place`, over the command's balls."""
    time, instants, levels = command[0], [*command[1 : n + 1], command[0]], [fmpq(0), *command[n + 1 : 2 * n + 1]]
    if place == 0:
        jumps = (system.impulses(time - instants[i]) * arb(levels[i + 1] - levels[i]) for i in range(n))
        return sum(jumps, arb_mat(system.target.nrows(), 1))
    if place <= n:
        return system.impulses(time - instants[place - 1]) * arb(levels[place - 1] - levels[place])
    if place <= 2 * n:
        return system.steps(time - instants[place - n - 1]) - system.steps(time - instants[place - n])
    return -system.columns * arb_mat(system.columns.ncols(), 1, [int(j == place - 2 * n - 1) for j in range(system.columns.ncols())])


def solve(system: System, n: int, witness: Any) -> list[Number]:
    """Krawczyk: `K = x - Y F(x) + (I - Y J(X)) (X - x)` inside X proves a solution in K; returns the command with its unknowns in K."""
    (command, unknowns), size = as_written(system, witness), system.target.nrows()
    require(len(unknowns) == size, f"{size} equations need {size} unknowns, upper.free names {len(unknowns)}")

    def moved(changes: list[arb]) -> list[Number]:
        by = dict(zip(unknowns, changes, strict=True))
        return [number + by[place] if place in by else number for place, number in enumerate(command)]

    spend(2 * size**3)
    spread = arb(0, arb(witness.radius).upper())
    wide = moved([spread] * size)
    slopes = arb_mat(size, size, [x for place in unknowns for x in derivative(system, n, wide, place).entries()]).transpose()
    try:
        inverse = slopes.mid().inv().mid()
    except ZeroDivisionError:
        raise Undecided("the equations for the unknowns are singular at this precision") from None
    spreads = arb_mat(size, 1, [spread] * size)
    changes = ((arb_mat(size, size, 1) - inverse * slopes) * spreads - inverse * residual(system, n, command)).entries()
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
        parts.append(sum((size * (rate * r).exp() * r**k / factorial(k) for k, size in enumerate(sizes)), arb(0)))
    if not all(-rate * r >= power for rate, power in zip(rates, powers, strict=True)):
        return False  # r^k e^{-ar} falls from r = k/a on only
    envelope = sum(parts, arb(0))
    if envelope <= min(above, below):
        return True
    # Another part over the slowest is r^k e^{-dr}, which falls from r = k/d on: what the slowest outweighs then, it outweighs for ever.
    slowest = max((i for i, part in enumerate(parts) if not part.is_zero()), key=lambda i: float(rates[i].mid()))
    others = [i for i, part in enumerate(parts) if i != slowest and not part.is_zero()]
    steady = powers[slowest] == 0 and not tail.roots[slowest].flexible
    falls = steady and all((rates[slowest] - rates[i]) * r >= powers[i] for i in others)
    first = tail.rows[0, sum(zero.multiplicity for zero in tail.roots[:slowest])].real
    inward = (above == 0 and first < 0) or (below == 0 and first > 0)
    return bool(falls and inward and envelope <= max(above, below) and sum((parts[i] for i in others), arb(0)) < parts[slowest])


def inside(tail: Wave, start: arb, end: arb, room: tuple[fmpq, fmpq], first: fmpq | None) -> None:
    """-below ≤ tail ≤ above on [start, end], by subdivision; a tail that begins with the exact value `first` may touch a limit at 0."""
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
    length = system.task.limits.tail_length
    later, far = length.time if length else fmpq(0), max((-1 / zero.value.real).upper() for zero in tail.roots)
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


def prove(system: System, witness: Any, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists; raises `Refuted` or `Undecided`."""
    n = len(witness.segments)
    command = solve(system, n, witness)
    for i, (before, after) in enumerate(pairwise([*command[1 : n + 1], command[0]]), 1):
        at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(command[n + 1 : 2 * n + 1]):
        at_most(system.lower, level, f"level {i} is above its limit")
        at_most(level, system.upper, f"level {i} is below its limit")
    tail_limits(system, n, command)
    at_most(command[0], time, "the command takes no longer than claimed")
