"""A box of plants that vary: finitely many of them, each with a schedule of its own, one command, a residual within a tolerance.

With deviations e = x - x_ss from the final rest, v = u - u_ss, every plant obeys `e' = A(t) e + B(t) v`, e(0) = x_0 - x_ss, and after the
move the output is c(t) e(t) off its target. What is asked is `|c e| ≤ V |Δ|` for all t ≥ T, while the plant still varies and ever after.

The lower side looks at instants t_k ≥ T only, which drops conditions. With numbers ν_k, `π(0) = Σ ν_k c(t_k) Φ(t_k, 0)`, p = Σ π B over all
plants (docs/theory.md, section 3):

    Σ π(0) (x_ss - x_0) = ∫_0^T p v dt - Σ ν_k c(t_k) e(t_k) ≤ ∫_0^T σ(p) dt + V |Δ| Σ |ν_k|

States that are integrals of the input, or of each other, by the same constant numbers in all plants (a body) come to rest exactly; rows of
these have any multiplier. The upper side is a command as written: their rest is a matter of fractions, and e is enclosed plant by plant
until, after the schedule, the moduli of the final plant's motions are small enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import factorial
from types import SimpleNamespace
from typing import Any

import flint
from flint import acb, acb_poly, arb, arb_mat, fmpq, fmpq_mat

from relaxations.checking import courses, lower, upper, varying_courses
from relaxations.checking.balls import isolated, on_axis, spend
from relaxations.checking.reading import Refuted, Undecided, require
from relaxations.checking.transitions import Kick, horner, steps
from relaxations.checking.varying import Varying, posed

NOTHING = fmpq(0)
EVER = arb(10) ** 30  # [s]: motions are followed until they are small


def sensible(task: Any) -> None:
    """Raise `Malformed` unless the box is a list of plants, the one written the nominal one, and goes with the task's limits."""
    box, schedule, limits = task.box, task.schedule, task.limits
    bare = not (limits.rate or limits.sample_time or limits.deflection or limits.pulse_width or limits.pulses or limits.fuel)
    require(bare and task.initial_state is None, "a box of plants that vary goes with limits of the input only, and begins at rest")
    fine = not (box.numerator or box.denominator or box.outputs or box.plants) and box.final_tolerance is None
    require(fine, "a box of plants that vary is the members of the schedule, which all rest at the target")
    require(box.tolerance > 0, "a tolerance is more than 0")
    fine = all(p.nominal is not None and p.low <= p.nominal <= p.high for p in box.parameters)
    require(fine, "a parameter's nominal value lies in its range")
    places, count, n = [member.place for member in schedule.members], len(box.parameters), len(schedule.B[0])
    inside = [len(place) == count and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True)) for place in places]
    require(all(inside) and len(set(places)) == len(places), "plants are listed at different places of the box")
    for member in schedule.members:
        same = all(len(x) == len(schedule.instants) for x in (member.A, member.B, member.C, member.D))
        square = all(len(a) == n and all(len(row) == n for row in a) for a in member.A) and all(len(b) == n for b in (*member.B, *member.C))
        require(same and square, "a plant of the box has as many states and instants as the one written")
    nominal = tuple(p.nominal for p in box.parameters)
    own = [member for member in schedule.members if member.place == nominal]
    ours = (schedule.A, schedule.B, schedule.C, schedule.D)
    require(bool(own) and ours == (own[0].A, own[0].B, own[0].C, own[0].D), "the plant is not the nominal one of the box")


def each(task: Any) -> list[Varying]:
    """The task of every plant; raises `Malformed` unless one input holds all of them at the target."""
    schedules = [SimpleNamespace(**{**vars(task.schedule), **vars(one), "outputs": {}}) for one in task.schedule.members]
    found = [posed(SimpleNamespace(**{**vars(task), "schedule": schedule})) for schedule in schedules]
    require(len({one.final for one in found}) == 1, "the plants of the box are held at the target by different inputs")
    shared = bodies(found)
    require(len({tuple(one.away[i] for i in shared) for one in found}) == 1, "what the plants of the box share comes to rest elsewhere")
    return found


def bodies(plants: Sequence[Varying]) -> list[int]:
    """States that are integrals, of the input or of such states, by the same constant numbers in all plants; in that order."""
    schedules, found = [one.task.schedule for one in plants], list[int]()
    rows = [[(*A[i], b[i]) for s in schedules for A, b in zip(s.A, s.B, strict=True)] for i in range(len(plants[0].state))]
    while True:
        more = [
            i
            for i, own in enumerate(rows)
            if i not in found and len(set(own)) == 1 and not any(x for j, x in enumerate(own[0][:-1]) if j not in found)
        ]
        if not more:
            return found
        found += more


def lower_side(plants: Sequence[Varying], witness: Any, time: fmpq) -> None:
    """Prove that no command within the limits takes less than `time`, by the inequality above; or raise."""
    task, shared, n, chains = plants[0].task, bodies(plants), len(plants[0].state), witness.costate[0]
    others = (witness.tail, witness.after, witness.fuel, witness.deflection, witness.ramps, witness.steps, witness.changes)
    fine = not any(others) and len(chains) == 1 and len(chains[0].coefficients) == len(shared)
    require(fine, "the costate of a box of plants that vary is one chain, a number for each state that is a body's, and samples")
    require(not any(im for _, im in chains[0].coefficients), "the costate of a plant that varies is real")
    allowed, price, size = task.box.tolerance * abs(task.displacement), arb(0), arb(0)
    places = [member.place for member in task.schedule.members]
    starts = {0: arb_mat(1, n)}
    for i, (number, _) in zip(shared, chains[0].coefficients, strict=True):
        starts[0][0, i] = arb(number)
    for sample in witness.samples:
        require(sample.place in places and bool(sample.residual), "a sample is a plant of the box, with multipliers of its residual")
        require(not (sample.deflection or sample.after), "the plants of the box have no limited outputs")
        which = places.index(sample.place)
        schedule = plants[which].task.schedule
        for at, seen in transitions(schedule, n, [time + contact.time for contact in sample.residual]):
            for contact in sample.residual:
                if time + contact.time == at:
                    row = arb_mat(1, n, varying_courses.at(schedule, schedule.C, at)) * seen
                    starts[which] = starts.get(which, arb_mat(1, n)) + row * arb(contact.lower - contact.upper)
                    price += arb((contact.lower + contact.upper) * allowed)
    gain = -price
    for which, start in starts.items():
        terms = [x * a for x, a in zip(start.entries(), plants[which].away, strict=True)]
        gain, size = sum(terms, gain), sum((abs(term) for term in terms), size)
    if gain <= 0:
        raise Refuted("the lower bound's inequality is false for this costate, whatever the input")
    fine_enough = ((size + price) / arb(time) * arb(2) ** (-flint.ctx.prec // 2)).lower()
    begins = arb_mat(1, n * len(starts), [x for start in starts.values() for x in start.entries()])
    total, (low, high) = arb(0), (arb(plants[0].lower), arb(plants[0].upper))
    for step in steps(together([plants[which].task.schedule for which in starts]), begins, arb(time)):
        length = min(step.length, time - step.begin)
        total += lower.support(step.costate, arb(length).upper(), low, high, fine_enough)  # σ is not negative
    if total < gain:
        return
    if total > gain + fine_enough * arb(time):
        raise Refuted("the lower bound's inequality is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality is undecided at this precision")


def together(schedules: Sequence[Any]) -> Any:
    """Plants side by side: one schedule, A in blocks."""
    n, count = len(schedules[0].B[0]), len(schedules)
    A = [
        [[*[NOTHING] * (n * k), *row, *[NOTHING] * (n * (count - 1 - k))] for k, one in enumerate(schedules) for row in one.A[i]]
        for i in range(len(schedules[0].instants))
    ]
    B = [[x for one in schedules for x in one.B[i]] for i in range(len(schedules[0].instants))]
    return SimpleNamespace(instants=schedules[0].instants, A=A, B=B)


def transitions(schedule: Any, n: int, instants: Sequence[fmpq]) -> list[tuple[fmpq, arb_mat]]:
    """Φ(t, 0) at instants, each once: inverses of what is followed."""
    waiting, found = sorted(set(instants), reverse=True), []
    for step in steps(schedule, arb_mat(n, n, 1), arb(waiting[0])):
        while waiting and waiting[-1] <= step.begin + step.length:
            spend(n**3)
            at = waiting.pop()
            found.append((at, (horner(step.rows, arb(at - step.begin)) + step.left).inv()))
    return found


def upper_side(plants: Sequence[Varying], witness: Any, time: fmpq) -> None:
    """Prove that the command as written is within the limits, brings bodies to rest, and leaves every plant within the tolerance."""
    require(bool(witness.segments) and not (witness.tail or witness.free), "the command of a box of plants that vary has no unknowns")
    task, end = plants[0].task, witness.maneuver_time
    instants = [*(segment.start for segment in witness.segments), end]
    levels = [segment.level - plants[0].final for segment in witness.segments]
    for i, (before, after) in enumerate(pairwise(instants), 1):
        upper.at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(levels):
        upper.at_most(plants[0].lower, level, f"level {i} is above its limit")
        upper.at_most(level, plants[0].upper, f"level {i} is below its limit")
    upper.at_most(end, time, "the command takes no longer than claimed")
    shared = bodies(plants)
    if any(rested(plants[0], shared, instants, levels)):
        raise Refuted("the command as written does not bring to rest what all plants share")
    allowed = task.box.tolerance * abs(task.displacement)
    for place, plant in zip((member.place for member in task.schedule.members), plants, strict=True):
        settles(plant, shared, instants, levels, allowed, ", ".join(f"{float(arb(x).mid()):.6g}" for x in place))


def rested(plant: Varying, shared: Sequence[int], instants: Sequence[fmpq], levels: Sequence[fmpq]) -> list[fmpq]:
    """How far the states of bodies are from rest when the command ends, exactly: of k integrals the series has k terms."""
    A = [[plant.task.schedule.A[0][i][j] for j in shared] for i in shared]
    b, e = [plant.task.schedule.B[0][i] for i in shared], [-plant.away[i] for i in shared]

    def moved(x: Sequence[fmpq]) -> list[fmpq]:
        return [varying_courses.inner(row, x) for row in A]

    for (begin, end), v in zip(pairwise(instants), levels, strict=True):
        change = [x + y * v for x, y in zip(moved(e), b, strict=True)]
        for k in range(1, len(shared) + 1):
            e = [x + y * (end - begin) ** k / factorial(k) for x, y in zip(e, change, strict=True)]
            change = moved(change)
        spend(len(shared) ** 3)
    return e


def settles(plant: Varying, shared: Sequence[int], instants: Sequence[fmpq], levels: Sequence[fmpq], allowed: fmpq, where: str) -> None:
    """Prove `|c e| ≤ allowed` from the end of the command on; raises `Refuted` or `Undecided`."""
    schedule, n, end = plant.task.schedule, len(plant.state), instants[-1]
    still, finish = max(end, schedule.instants[-1]), set(shared)
    minus = [
        [[*(-A[j][i] for j in range(n)), NOTHING] for i in range(n)] + [[*(-x for x in b), NOTHING]]
        for A, b in zip(schedule.A, schedule.B, strict=True)
    ]
    seen = SimpleNamespace(instants=schedule.instants, A=minus, B=[[*row, NOTHING] for row in schedule.C])

    def held(level: fmpq) -> Any:
        return lambda rows: arb_mat(1, n + 1, [*rows.entries()[:n], level])

    def over(rows: arb_mat) -> arb_mat:
        return arb_mat(1, n + 1, [arb(0) if i in finish or i == n else x for i, x in enumerate(rows.entries())])

    kicks: list[Kick] = [*((start, held(level)) for start, level in zip(instants[1:-1], levels[1:], strict=True)), (end, over)]
    kicks += [(still, lambda rows: rows)] if still > end else []
    begin, moduli = arb_mat(1, n + 1, [*(-x for x in plant.away), levels[0]]), None
    for step in steps(seen, begin, EVER, kicks):
        if step.begin < end:
            continue
        if step.begin >= still:
            moduli = moduli or motions(plant, shared, step.rows[0].entries())
            since = arb(step.begin - still)
            if sum((size * (rate * since).exp() for size, rate in moduli), arb(0)) <= arb(allowed):
                return
        course: Any = step.costate
        courses.within(course, arb(step.length).upper(), allowed, f"residual of the plant at {where}", ())


def motions(plant: Varying, shared: Sequence[int], e: Sequence[arb]) -> list[tuple[arb, arb]]:
    """Modulus and rate of each motion of the output after the schedule: c adj(s - A) e / det(s - A) at its poles, bodies aside."""
    schedule = plant.task.schedule
    own = [i for i in range(len(plant.state)) if i not in shared]
    if not own:
        return []
    A, c = fmpq_mat([[schedule.A[-1][i][j] for j in own] for i in own]), fmpq_mat([[schedule.C[-1][i] for i in own]])
    below = A.charpoly()
    if below[0] == 0:
        raise Undecided("a plant of the box keeps drifting: beside the bodies that all share it has a pole at the origin")
    # The rows of c adj(s - A), the highest power of s first (Faddeev and Leverrier).
    rows = [c]
    for k in range(len(own) - 1, 0, -1):
        rows.append(rows[-1] * A + c * below[k])
    column = arb_mat(len(own), 1, [e[i] for i in own])
    above = acb_poly([acb((arb_mat(row) * column)[0, 0]) for row in reversed(rows)])
    roots, slope, found = isolated(below), acb_poly(below.derivative().coeffs()), []
    if any(root.multiplicity > 1 for root in roots):
        raise Undecided("a plant of the box has a repeated pole after the schedule")
    if sum(root.flexible and root.value.real.contains(0) for root in roots) != on_axis(below):
        raise Undecided("a pole is not told from the imaginary axis at this precision")
    for root in roots:
        rate = arb(0) if root.flexible and root.value.real.contains(0) else root.value.real
        if not rate <= 0:
            raise Undecided("a plant of the box is unstable after the schedule")
        found.append((abs(above(root.value) / slope(root.value)) * (1 + root.flexible), rate))
    return found


def prove(certificate: Any) -> None:
    """Prove every side that is claimed; raises `Refuted`, `Undecided` or `Malformed`."""
    sensible(certificate.task)
    plants, claimed = each(certificate.task), certificate.claim
    if claimed.impossible is not None:
        raise Undecided("the criteria of impossibility speak of plants that do not vary")
    if claimed.lower:
        lower_side(plants, certificate.lower, claimed.lower)
    if claimed.upper is not None:
        upper_side(plants, certificate.upper, claimed.upper)


def described(task: dict[str, Any]) -> list[str]:
    """The box in words and numbers as written."""
    if not (box := task["box"]):
        return []
    ranges = ", ".join(f"{p['name']!r} in [{p['low']}, {p['high']}] (nominal {p['nominal']})" for p in box["parameters"])
    members = task["schedule"]["members"]
    lines = [f"  and these {len(members)} plants of {ranges}; nothing is said of any other plant of these ranges:"]
    for member in members:
        lines.append(f"  at {', '.join(member['place'])}:")
        for instant, A, b, C, d in zip(task["schedule"]["instants"], *(member[name] for name in ("A", "B", "C", "D")), strict=True):
            rows = ", ".join(f"[{', '.join(row)}]" for row in A)
            lines.append(f"    t = {instant} s: A = [{rows}], B = [{', '.join(b)}], C = [{', '.join(C)}], D = {d}")
    return lines


def promises(task: dict[str, Any]) -> list[str]:
    """In words: what they do after the command."""
    if not (box := task["box"]):
        return []
    return [
        f"  In every one of these plants |y(t) - target| for t ≥ T, while it still varies and ever after, is at most {box['tolerance']}",
        "  of the displacement instead of 0. States that are the same integrals of the input in all of them are at rest from T on.",
    ]
