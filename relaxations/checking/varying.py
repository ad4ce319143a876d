"""A plant that varies: x' = A(t) x + B(t) u, y = C(t) x + D(t) u, every matrix linear between the instants of a schedule, then constant.

Deviations v = u - u_ss from the final rest (x_ss, u_ss), a rest at every instant, satisfy `∫_0^T g v dt = x_ss - x_0` where a move of T
seconds from x_0 ends, with g = Φ(0, t) B(t) and the transition Φ (docs/theory.md, section 3). The upper side is a command that does so.
The lower side is any row π with `π' = -π A + ρ c` for densities ρ(t) of multipliers of outputs c x: p = π B, and

    π(0) (x_ss - x_0) + ∫ ρ c x_ss dt = ∫_0^T p v dt + ∫ ρ c x dt ≤ ∫_0^T σ(p) dt + Σ limit ∫ |ρ| dt

The limits of the slope are those of `ramps`, seen from the beginning of the move: there v is that of the initial rest, at the end it is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import flint
from flint import arb, arb_mat, arb_poly, fmpq, fmpq_mat

from relaxations.checking import lower, ramps, upper, varying_courses
from relaxations.checking.balls import spend
from relaxations.checking.reading import Refuted, Undecided, require
from relaxations.checking.transitions import Series, added, largest, steps


@dataclass(frozen=True, slots=True)
class Varying:
    """The task: where the plant must come to rest and how far it is from there at first, and the limits of v, exact."""

    task: Any
    state: list[fmpq]
    away: list[fmpq]
    final: fmpq  # the input at the final rest
    lower: fmpq
    upper: fmpq

    @property
    def first(self) -> fmpq:
        """v at the initial rest."""
        return self.task.initial_input - self.final

    @property
    def rate(self) -> tuple[fmpq, fmpq]:
        """The limits of the slope, seen backwards."""
        low, high = self.task.limits.rate
        return -high, -low


def posed(task: Any) -> Varying:
    """The task's equations; raises `Malformed` if it is no task: no rest that lasts, or none within the limits."""
    schedule, n = task.schedule, len(task.schedule.B[0])
    rows = [[*row, b] for row, b in zip((*schedule.A[-1], schedule.C[-1]), (*schedule.B[-1], schedule.D[-1]), strict=True)]
    longest = max(int(x.p).bit_length() + int(x.q).bit_length() for row in rows for x in row)
    spend((n + 1) ** 4 * longest / 200)
    try:
        found = fmpq_mat(rows).solve(fmpq_mat([*([fmpq(0)] for _ in range(n)), [task.displacement]])).entries()
    except ZeroDivisionError:
        require(False, "after its schedule the plant has no rest at the target, or more than one")
        raise
    state, held = found[:n], found[n]
    for A, b, C, d in zip(schedule.A, schedule.B, schedule.C, schedule.D, strict=True):
        rates = [sum((x * s for x, s in zip(row, state, strict=True)), held * e) for row, e in zip(A, b, strict=True)]
        seen = sum((x * s for x, s in zip(C, state, strict=True)), held * d)
        require(not any(rates) and seen == task.displacement, "the final rest is none at an instant of the schedule")
    final = task.initial_input + held
    low, high = task.limits.input
    require(low <= min(task.initial_input, final) and max(task.initial_input, final) <= high, "the limits exclude the input at a rest")
    require(task.limits.fuel is None or held == 0, "a budget of fuel belongs to a plant that rests without input")
    away = [s - x for s, x in zip(state, task.initial_state or [fmpq(0)] * n, strict=True)]
    require(any(away), "the plant is at its final rest already")
    varying_courses.sensible(task, state)
    return Varying(task, state, away, final, low - final, high - final)


def lower_side(task: Varying, witness: Any, time: fmpq) -> None:
    """Prove that no admissible command takes less than `time`, by `π(0) (x_ss - x_0) + … > …` above; or raise."""
    chains, limits = witness.costate[0], task.task.limits
    fine = not (witness.tail or witness.after or witness.samples) and len(chains) == 1
    require(
        fine and len(chains[0].coefficients) == len(task.state), "the costate of a plant that varies is one chain, a number for each state"
    )
    numbers = [re for re, _ in chains[0].coefficients]
    require(not any(im for _, im in chains[0].coefficients), "the costate of a plant that varies is real")
    given = sum((a * b for a, b in zip(numbers, task.away, strict=True)), fmpq(0)) - witness.fuel * (limits.fuel or 0)
    gain = arb(given) + varying_courses.gained(task.task, task.state, witness.deflection)
    h = limits.sample_time
    count = int((time / h).ceil()) - 1 if h else 0
    sampled = bool(h) and count <= lower.MOST_CELLS
    if h and not sampled and (witness.deflection or witness.steps):
        raise Undecided("more samples than a check may look at with multipliers of outputs or of steps")
    end = count * h if h else time
    if gain <= 0 and not (witness.ramps or witness.steps):
        raise Refuted("the lower bound's inequality (2) is false for this costate, whatever the input")
    size = abs(gain) + arb(abs(given)) + sum((arb(abs(press.weight)) for press in witness.deflection), arb(0))
    fine_enough = (size / arb(end or 1) * arb(2) ** (-flint.ctx.prec // 2)).lower()
    schedule, start, kicks = varying_courses.driven(task.task, numbers, witness.deflection)
    edges = [(edge, added(arb_mat(1, start.ncols()))) for ramp in witness.ramps for edge in ramp.edges]
    motion = [] if end == 0 else list(steps(schedule, start, arb(end), sorted([*kicks, *edges], key=lambda kick: kick[0])))
    pieces = [(step.begin, step.length if step.begin + step.length <= end else end - step.begin, step.costate) for step in motion]

    def parts(p: Series) -> list[tuple[Series, arb, arb]]:
        low, high, price = arb(task.lower), arb(task.upper), arb(witness.fuel)
        return [(p, low, high)] if limits.fuel is None else [(p.raised(-price), arb(0), high), (p.raised(price), low, arb(0))]

    def support(p: Series, length: fmpq, low: arb, high: arb) -> arb:
        return lower.support(p, arb(length).upper(), low, high, fine_enough)  # rather a hair too far: σ is not negative

    if sampled:
        backwards = SimpleNamespace(sample_time=h, rate=None if limits.rate is None else task.rate)
        seen = SimpleNamespace(task=SimpleNamespace(limits=backwards), lower=task.lower, upper=task.upper)
        total, first = ramps.stepped(seen, cells(pieces, count, h), witness)  # type: ignore[arg-type]
    else:
        total, first = sloped(task, pieces, witness, parts, support)
    gain += first * arb(task.first)
    if total < gain:
        return
    if total > gain + fine_enough * arb(end):
        raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality (2) is undecided at this precision")


Piece = tuple[fmpq, fmpq, Series]  # when it begins, how long it is, and the sum there, in the time since
Parts = Callable[[Series], list[tuple[Series, arb, arb]]]
Support = Callable[[Series, fmpq, arb, arb], arb]


def cells(pieces: Sequence[Piece], count: int, step: fmpq) -> list[arb]:
    """The integrals of p over cells of `step`."""
    found, before, done = [], arb(0), arb(0)
    for begin, length, p in pieces:
        while len(found) < count and (len(found) + 1) * step - begin <= length:
            after = done + p.integral(arb((len(found) + 1) * step - begin))
            found.append(after - before)
            before = after
        done += p.integral(arb(length))
    return found


def sloped(task: Varying, pieces: Sequence[Piece], witness: Any, parts: Parts, support: Support) -> tuple[arb, arb]:
    """`∫ σ(p - q') + ∫ rate(q)` by pieces that end where ramps do, and q(0): levels of a ramp are shifted so that q ends at 0."""
    total, first, rest = arb(0), arb(0), list(pieces)
    for ramp in witness.ramps:
        own = [piece for piece in rest if ramp.edges[0] <= piece[0] < ramp.edges[-1]]
        rest = [piece for piece in rest if not ramp.edges[0] <= piece[0] < ramp.edges[-1]]
        if not own:
            continue
        levels = [arb(next(x for end, x in zip(ramp.edges[1:], ramp.levels, strict=True) if begin < end)) for begin, _, _ in own]
        gains = [p.integral(arb(length)) - level * arb(length) for (_, length, p), level in zip(own, levels, strict=True)]
        begins, ends = own[0][0] == 0, own[-1] is not pieces[-1]
        q = -sum(gains, arb(0)) if begins else arb(0)
        if begins:
            q = arb(witness.steps[0]) if witness.steps else q
            first = q
        shift = (q + sum(gains, arb(0))) / arb(sum((length for _, length, _ in own), fmpq(0))) if ends else arb(0)
        low, high = (arb(side) for side in task.rate)
        for (_, length, p), level, gained in zip(own, levels, gains, strict=True):
            for held, a, b in parts(Series(arb_poly([level + shift]), arb(0), arb(0))):
                total += (b * held.polynomial(arb(0))).max(a * held.polynomial(arb(0))) * arb(length)
            total += support(p.raised(-level - shift).integrated(q, arb(length)), length, low, high)
            q += gained - shift * arb(length)
    return total + sum((support(q, length, a, b) for _, length, p in rest for q, a, b in parts(p)), arb(0)), first


def upper_side(task: Varying, witness: Any, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists, by Krawczyk's test on `∫ g v = x_ss - x_0`; or raise."""
    n, size, limits = len(witness.segments), len(task.state), task.task.limits
    require(n > 0 and not witness.tail, "the command of a plant that varies has segments, and no tail")
    command, unknowns = upper.as_written(task.task, (), witness)
    last = largest([arb(x) for x in command[: n + 1]]) + 2 * arb(witness.radius).upper()
    motion = list(steps(task.task.schedule, arb_mat(size, size, 1), last))
    followed, straight = arb(motion[-1].begin + motion[-1].length), limits.rate is not None and limits.sample_time is None
    begun = [(arb_mat(size, 1), arb_mat(size, 1))]  # the integral of g until each step begins, and the integral of that
    for step in motion:
        (whole, twice), length = begun[-1], arb(step.length)
        begun.append((whole + step.step(length), twice + whole * length + step.ramp(length)))

    def seen(instant: arb | fmpq, integrals: int) -> arb_mat:
        """g or its integrals from 0 at an instant: over its ball, of all steps that it meets."""
        at, found = arb(instant), None
        spend(len(motion) / 4)
        if not 0 <= at <= followed:
            raise Undecided("an instant of the command is outside the time that was followed")
        for i, step in enumerate(motion):
            tau = at - arb(step.begin)
            if tau < 0 or tau > arb(step.length):
                continue
            spend(len(step.rows) * (2 + size * size / 8))
            tau, (whole, twice) = inside(tau, arb(step.length)), begun[i]
            value = (
                step.impulse(tau) if integrals == 0 else whole + step.step(tau) if integrals == 1 else twice + whole * tau + step.ramp(tau)
            )
            found = (
                value if found is None else arb_mat(size, 1, [a.union(b) for a, b in zip(found.entries(), value.entries(), strict=True)])
            )
        assert found is not None
        return found

    def values(command: Sequence[fmpq | arb]) -> tuple[list[fmpq | arb], list[arb]]:
        """The instants from 0 to the duration, and v between them; of an input that goes straight from level to level, v at them."""
        v = [arb(level + task.first) for level in command[n + 1 : 2 * n + 1]]
        return [*command[1 : n + 1], command[0]], [*v, arb(0)] if straight else v

    def slopes(instants: Sequence[fmpq | arb], v: Sequence[arb]) -> list[arb]:
        return [(b - a) / arb(t - s) for (s, t), (a, b) in zip(pairwise(instants), pairwise(v), strict=True)]

    def residual(command: Sequence[fmpq | arb]) -> arb_mat:
        instants, v = values(command)
        integrals = [seen(instant, 1 + straight) for instant in instants]
        if straight:  # by parts: v is 0 at the end, the integral at the beginning
            v = [-slope for slope in slopes(instants, v)]
        return sum(((b - a) * level for (a, b), level in zip(pairwise(integrals), v, strict=True)), -arb_mat(size, 1, task.away))

    def derivative(command: Sequence[fmpq | arb], place: int) -> arb_mat:
        instants, v = values(command)
        if straight:
            i = place - n - 1
            before, at, after = (seen(instants[j], 2) for j in (i - 1, i, i + 1))
            return (after - at) / arb(instants[i + 1] - instants[i]) - (at - before) / arb(instants[i] - instants[i - 1])
        if place == 0:
            return seen(command[0], 0) * v[-1]
        if place <= n:
            return seen(instants[place - 1], 0) * (v[place - 2] - v[place - 1])
        return seen(instants[place - n], 1) - seen(instants[place - n - 1], 1)

    command = upper.krawczyk(command, unknowns, size, witness.radius, residual, derivative)
    instants, v = values(command)
    for i, (before, after) in enumerate(pairwise(instants), 1):
        upper.at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(command[n + 1 : 2 * n + 1]):
        upper.at_most(limits.input[0], level + task.task.initial_input, f"level {i} is above its limit")
        upper.at_most(level + task.task.initial_input, limits.input[1], f"level {i} is below its limit")
    upper.pulsed(task.task, command, n, witness.free)
    if limits.fuel is not None:
        burnt = sum((abs(level) * arb(b - a) for level, (a, b) in zip(v, pairwise(instants), strict=False)), arb(0))
        upper.at_most(ramps.burnt(v, instants) if straight else burnt, limits.fuel, "the move uses no more fuel than there is")
    if limits.rate is not None:
        levels = [*command[n + 1 : 2 * n + 1], -task.first]
        if straight:
            require(levels[0] == 0, "the input is continuous, so it begins where it rests")
            steepness = slopes(instants, [arb(level) for level in levels])
        else:
            ramps.lasting(instants)
            steepness = [arb(b - a) / arb(limits.sample_time) for a, b in pairwise([fmpq(0), *levels])]
        for i, slope in enumerate(steepness):
            upper.at_most(arb(limits.rate[0]), slope, f"slope {i} is above its limit")
            upper.at_most(slope, arb(limits.rate[1]), f"slope {i} is below its limit")
    varying_courses.prove(task.task, instants, [arb(level) for level in command[n + 1 : 2 * n + 1]], -task.first if straight else None)
    upper.at_most(command[0], time, "the command takes no longer than claimed")


def inside(tau: arb, length: arb) -> arb:
    """The part of a ball of times that is within a step."""
    return tau.lower().max(arb(0)).union(tau.upper().min(length))


def prove(certificate: Any) -> None:
    """Prove every side that is claimed; raises `Refuted`, `Undecided` or `Malformed`."""
    ramps.sensible(certificate.task, certificate.lower)
    task, claimed = posed(certificate.task), certificate.claim
    if claimed.impossible is not None:
        raise Undecided("the criteria of impossibility speak of plants that do not vary")
    if claimed.lower:
        lower_side(task, certificate.lower, claimed.lower)
    if claimed.upper is not None:
        upper_side(task, certificate.upper, claimed.upper)


def sensible(task: Any) -> None:
    """Raise `Malformed` unless a schedule is complete, and goes with the limits that it may have."""
    require((task.schedule is None) == (len(task.plants) == 1), "a task has one plant, or one that varies")
    if task.schedule is None:
        return
    schedule, limits, n = task.schedule, task.limits, len(task.schedule.B[0])
    A, B, C = schedule.A, schedule.B, schedule.C
    rising = schedule.instants[0] == 0 and all(a < b for a, b in pairwise(schedule.instants))
    require(rising, "the instants of a schedule ascend from 0")
    same = all(len(x) == len(schedule.instants) for x in (A, B, C, schedule.D))
    square = all(len(a) == n and all(len(row) == n for row in a) for a in A) and all(len(b) == n for b in (*B, *C))
    require(same and square, "a schedule has A, B, C, D for every instant: A is n×n, B and C have n numbers")
    require((task.box is None) == (not schedule.members), "the plants of a box that vary are members of the schedule")
    fine = task.rest == "state" and not (limits.held or limits.tail_length or limits.zero_sensitivity)
    require(fine, "a plant that varies comes to a rest of its state: without a form or what belongs to a tail")
    require(task.initial_state is None or len(task.initial_state) == n, "a plant that varies begins at as many numbers as it has states")


def described(task: Any) -> list[str]:
    """The plant in words and numbers as written."""
    schedule = task["schedule"]
    lines = ["Plant: x' = A(t) x + B(t) u, y = C(t) x + D(t) u, every matrix linear in t between these instants, constant after the last."]
    for instant, A, b, C, d in zip(*(schedule[name] for name in ("instants", "A", "B", "C", "D")), strict=True):
        rows = ", ".join(f"[{', '.join(row)}]" for row in A)
        lines.append(f"  t = {instant} s: A = [{rows}], B = [{', '.join(b)}], C = [{', '.join(C)}], D = {d}")
    for name, rows in schedule["outputs"].items():
        shown = ", ".join(f"[{', '.join(row)}]" for row in rows)
        lines.append(f"  the output {name!r} is at these instants the row {shown} times x")
    return lines
