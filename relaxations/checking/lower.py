"""The lower side: weak duality (docs/theory.md, equation 2) with the integral of σ(p) in balls, its sign changes isolated.

    λᵀ target > ∫_0^T σ(p) ds + Σ μ⁺ above + μ⁻ below + Σ cap |excess|   ⇒   no admissible command takes T or less

for σ(p) = max(upper p, lower p), lower ≤ 0 ≤ upper: the right side grows with T. Where the rest input lies *on* a limit, no T may be
enough, and balls cannot decide an equality. Two exact criteria then speak of a real pole a that is right of all zeros of the tail v(r). It
asks for ∫_0^T e^{as} u ds + ∫_0^∞ e^{-ar} v dr = m:

face       if u may leave 0 to one side only, and m is 0 or on the other side, then u is 0 almost everywhere: nothing moves.
final      of a box: a plant of it comes to rest too far from the target, whatever the command (`members.Shift`).
remainder  if a is stable and u_ss is a limit, then m = u_ss ∫_0^∞ e^{as} ds, v is on one side of 0, and the left side is never that large.
fuel       a budget of fuel is less than a pole that does not decay asks for (`spent`).
overshoot  an output is limited to where it comes to rest, and a real zero takes it beyond (`overshoots`).

A budget of fuel adds μ fuel on the right, μ ≥ 0, and σ(p) = max(0, upper (p - μ)) + max(0, lower (p + μ)), both parts of the kind above.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import flint
from flint import acb, arb, arb_mat, fmpq

from relaxations.checking import boxes, changes, courses, members, overshoots, pulses, ramps, spent
from relaxations.checking.balls import Root, System, Wave, flat, placed, spend
from relaxations.checking.reading import Refuted, Undecided, require

MOST_CELLS = 50_000  # of a sample time: their integrals one by one


def impossible(system: System, criterion: str, witness: Any) -> None:
    """Prove that no admissible command reaches the target in any time, or raise `Undecided`."""
    if criterion == "final":
        require(system.task.box is not None and bool(witness and len(witness.samples) == 1), "one plant that rests too far from its target")
        members.too_far(system.task, witness.samples[0].place)
        return
    if criterion == "fuel":
        if not spent.too_little(system, witness, costate):
            raise Undecided("at no pole that does not decay the fuel is proven too little")
        return
    if criterion == "overshoot":
        if not overshoots.has_to(system):
            raise Undecided("no output that may not overshoot is proven to")
        return
    if system.begin:
        raise Undecided("the criteria speak of moves from rest")
    begins = accumulate((root.size for root in system.roots), initial=0)
    poles = [(root.value.real, system.target[i, 0]) for root, i in zip(system.roots, begins, strict=False) if not root.flexible]
    right = [(a, m) for a, m in poles if all(zero.value.real < a for zero in system.zeros)]
    met = {
        "face": any((m <= 0 and system.lower == 0) or (m >= 0 and system.upper == 0) for _, m in right),
        "remainder": system.rest != 0 and system.rest in (system.lower, system.upper) and any(a < 0 for a, _ in right),
    }
    if not met[criterion]:
        raise Undecided(f"the criterion '{criterion}' does not apply to this task")


def costate(system: System, witness: Any) -> tuple[arb_mat, arb]:
    """λ, and the price of the tail's limits: the λ written, moved (least squares) onto the equalities of a free tail, in balls.

    These are `λᵀ column_j + Σ (μ⁺ - μ⁻) shape_j(τ) = 0`, shapes of the input, its slope, outputs, and q(0) shape_j(0) of an input that is
    continuous. Where a coefficient is limited, what is left of the sum may be an excess.
    """
    numbers, capped, columns = placed(system.roots, witness.costate[0])[0], system.capped, system.columns.transpose().tolist()
    written, price, pull = arb_mat(len(numbers), 1, numbers), arb(0), arb_mat(len(columns), 1)
    for contact in witness.tail:
        above, below = system.room(contact.time)
        price += arb(contact.upper * above + contact.lower * below)
        pull += flat(system.zeros, Root.impulse, arb(contact.time)) * arb(contact.upper - contact.lower)
    for contact in witness.after:
        answer, above, below = system.after(contact.output)
        price += arb(contact.upper * above + contact.lower * below)
        pull += flat(system.zeros, answered, answer, arb(contact.time)) * arb(contact.upper - contact.lower)
    if system.sloped and witness.steps:  # where the tail begins, the move has to end
        pull += flat(system.zeros, Root.impulse, arb(0)) * arb(witness.steps[0])
    free = sorted({*range(len(columns))} - {place for places, _ in capped for place in places})
    rows, pulled = arb_mat(len(free), len(numbers), [x for place in free for x in columns[place]]), [pull[place, 0] for place in free]
    spend(len(free) ** 2 * len(numbers))
    moved = written - rows.transpose() * (rows * rows.transpose()).solve(rows * written + arb_mat(len(free), 1, pulled))
    excess = system.columns.transpose() * moved + pull
    return moved, price + sum((cap * abs(acb(*(excess[place, 0] for place in places))) for places, cap in capped), arb(0))


def answered(zero: Root, answer: Any, since: arb) -> list[acb]:
    """What each coefficient of a tail's chain at a zero does to its slope or to an output, some time after the move."""
    units = [[acb(i == k) for i in range(zero.multiplicity)] for k in range(zero.multiplicity)]
    return [sum((c * b for c, b in zip(answer(unit, zero), zero.impulse(since), strict=True)), acb(0)) for unit in units]


def support(p: Any, horizon: arb, lower: arb, upper: arb, fine: arb, begin: arb | None = None) -> arb:
    """A ball around `∫ max(upper p, lower p) ds` from 0, or `begin`, to the horizon, both exact, lower ≤ 0 ≤ upper; p: a `Wave` or series.

    From the left, intervals are bisected until p has a sign, or is monotone: interval Newton then encloses its root. Where the integrand
    is smaller than `fine` it counts as a radius instead. Raises `Undecided` where p is not known that well.
    """
    weights, span = {1: upper, -1: lower, 0: arb(0)}, upper - lower
    a, sign, total = (
        arb(0) if begin is None else begin,
        0,
        arb(0),
    )  # what is left of a is done, but for the antiderivative at a, where the integrand has this sign on the left
    waiting: list[tuple[arb, int | None]] = [(horizon, None)]  # where the next intervals end, and the sign of p on them if it is known
    while waiting:
        b, new = waiting.pop()
        if a == b:
            continue
        if new is None:
            c, value, slope, values = p.over(a, b)
            size = (abs(values) * span).upper()
            if values > 0 or values < 0:
                new = 1 if values > 0 else -1
            elif size <= fine:
                new, total = 0, total + arb(0, (size * (b - a)).upper())
            elif not (a < c < b) or not value.rad() * span <= fine:
                raise Undecided("the sign of the costate is undecided at this precision")
            else:
                waiting += [(b, None), (c, None)]
                if slope > 0 or slope < 0:
                    # p = slope (s - root): one sign left of all that `root` holds, the other right of it, whether or not it is in [a, b].
                    root, rising = c - value / slope, 1 if slope > 0 else -1
                    low, high = root.lower().max(a).min(b), root.upper().max(a).min(b)
                    if (high - low) * 2 <= b - a:
                        waiting[-2:] = [(b, rising), (high, None), (low, -rising)]
                continue
        if new != sign:
            total += (weights[sign] - weights[new]) * p.integral(a)
        a, sign = b, new
    return total + weights[sign] * p.integral(horizon)


Part = tuple[Wave, arb, arb]  # p, lower, upper


def parts(system: System, p: Wave, fuel: fmpq) -> list[Part]:
    """σ(p) with the multiplier of the fuel as a sum of terms `max(lower p, upper p)`."""
    lower, upper = arb(system.lower), arb(system.upper)
    return [(p, lower, upper)] if fuel == 0 else [(p.raised(-arb(fuel)), arb(0), upper), (p.raised(arb(fuel)), lower, arb(0))]


def sampled(roots: tuple[Root, ...], whole: Sequence[courses.Piece], count: int, step: fmpq) -> list[arb]:
    """The integrals of p over cells of `step`."""
    found, before, done = [], arb(0), arb(0)
    for begin, length, chains in whole:
        course = courses.integrated(roots, chains)
        while len(found) < count and (len(found) + 1) * step <= begin + length:
            after = done + courses.value(roots, course, arb((len(found) + 1) * step - begin))
            found.append(after - before)
            before = after
        done += courses.value(roots, course, arb(length))
    return found


def prove(system: System, witness: Any, time: fmpq) -> None:
    """Prove that no admissible command takes less than `time` seconds; raises `Refuted` or `Undecided`.

    With a sample time the commands that are refuted take one sample less, or even fewer. Of many short samples it is enough that no
    measurable input can do it in their time.
    """
    if witness.changes:
        changes.prove(system, witness.changes, time, support)
        return
    if witness.pulses:
        pulses.prove(system, witness.pulses, time, support)
        return
    require(bool(system.zeros) or not (witness.tail or witness.after), "multipliers of a tail that the task does not have")
    numbers, price = costate(system, witness)
    relaxed = boxes.relaxed(system, witness.samples)
    others, more, relief = relaxed.roots, relaxed.numbers, relaxed.gain
    price += arb(witness.fuel * (system.task.limits.fuel or 0))
    price += sum((arb(abs(press.weight) * system.task.limits.deflection[press.output]) for press in witness.deflection), arb(0))
    step, entries, own = system.task.limits.sample_time, [*numbers.entries(), *more], (*system.roots, *others)
    count = int((time / step).ceil()) - 1 if step else 0
    roots = courses.common(own, 2) if step or witness.deflection or relaxed.pressed or witness.ramps or not own else own
    nothing = [[acb(0)] * root.multiplicity for root in roots]
    if step and count > MOST_CELLS and (witness.deflection or relaxed.pressed or witness.steps):
        raise Undecided("more samples than a check may look at with multipliers of outputs or of steps")

    def sides(horizon: Any) -> tuple[arb, arb]:
        """Both sides of (2) for moves of exactly so many seconds, but for what they share."""
        aim = system.target - system.drift(arb(horizon))
        terms = [a * b for a, b in zip(numbers.entries(), aim.entries(), strict=True)]
        gain = sum(terms, relief - price) + courses.begun(system, roots, witness.deflection, horizon)
        size = sum((abs(term) for term in terms), abs(relief) + price)
        kicks = [*courses.pressed(system, roots, witness.deflection, horizon), *relaxed.kicks(system, roots, horizon)]
        kicks += ramps.edges(witness.ramps, nothing, horizon)
        kicks.sort(key=lambda kick: kick[0])
        whole = list(courses.pieces(roots, courses.given(own, roots, entries), kicks, horizon))
        if step and count <= MOST_CELLS:
            right, first = ramps.stepped(system, sampled(roots, whole, count, step), witness)
        else:
            fine = (size / arb(time) * arb(2) ** (-flint.ctx.prec // 2)).lower()
            right, first = ramps.most(
                system.task,
                roots,
                whole,
                witness.ramps,
                arb(witness.steps[0]) if witness.steps else None,
                lambda wave, length, low, high: support(wave, length, low, high, fine),
                lambda wave: parts(system, wave, witness.fuel),
            )
        return right, gain + first * arb(system.rest)

    last = count * step if step else time  # the longest moves that are refuted: who rests sooner is at rest then, too
    horizon = last if step and count <= MOST_CELLS else arb(last).upper()
    right, left = sides(horizon)
    if right < left:
        return
    shorter = horizon if step else arb(last).lower()
    right, left = (right, left) if horizon == shorter else sides(shorter)
    empty = left <= 0 and not (witness.ramps or witness.steps)  # the right side is not negative then
    if (right > left or empty) and count <= MOST_CELLS:
        raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality (2) is undecided at this precision")
