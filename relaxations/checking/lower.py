"""The lower side: weak duality (docs/theory.md, equation 2) with the integral of σ(p) in balls, its sign changes isolated.

    λᵀ target > ∫_0^T σ(p) ds + Σ μ⁺ above + μ⁻ below + Σ cap |excess|   ⇒   no admissible command takes T or less

for σ(p) = max(upper p, lower p), lower ≤ 0 ≤ upper: the right side grows with T. Where the rest input lies *on* a limit, no T may be
enough, and balls cannot decide an equality. Two exact criteria then speak of a real pole a that is right of all zeros of the tail v(r). It
asks for ∫_0^T e^{as} u ds + ∫_0^∞ e^{-ar} v dr = m:

face       if u may leave 0 to one side only, and m is 0 or on the other side, then u is 0 almost everywhere: nothing moves.
final      of a box: a plant of it comes to rest too far from the target, whatever the command (`members.Shift`).
remainder  if a is stable and u_ss is a limit, then m = u_ss ∫_0^∞ e^{as} ds, v is on one side of 0, and the left side is never that large.

A budget of fuel adds μ fuel on the right, μ ≥ 0, and σ(p) = max(0, upper (p - μ)) + max(0, lower (p + μ)), both parts of the kind above. It
may make a task impossible too: where the pole is 0, and there is no tail, m = ∫_0^T u ds is at most the fuel.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import flint
from flint import acb, arb, arb_mat, fmpq

from relaxations.checking import boxes, courses, members, ramps
from relaxations.checking.balls import Root, System, Wave, flat, placed, spend
from relaxations.checking.reading import Refuted, Undecided, require

MOST_CELLS = 50_000  # of a sample time: their integrals one by one


def impossible(system: System, criterion: str, witness: Any) -> None:
    """Prove that no admissible command reaches the target in any time, or raise `Undecided`."""
    if criterion == "final":
        require(system.task.box is not None and bool(witness and len(witness.samples) == 1), "one plant that rests too far from its target")
        members.too_far(system.task, witness.samples[0].place)
        return
    if system.begin:
        raise Undecided("the criteria speak of moves from rest")
    begins = accumulate((root.size for root in system.roots), initial=0)
    poles = [(root.value.real, system.target[i, 0]) for root, i in zip(system.roots, begins, strict=False) if not root.flexible]
    fuel, right = system.task.limits.fuel, [(a, m) for a, m in poles if all(zero.value.real < a for zero in system.zeros)]
    met = {
        "face": any((m <= 0 and system.lower == 0) or (m >= 0 and system.upper == 0) for _, m in right),
        "fuel": fuel is not None and not system.zeros and not system.begin and any(a.is_zero() and abs(m) > fuel for a, m in poles),
        "remainder": system.rest != 0 and system.rest in (system.lower, system.upper) and any(a < 0 for a, _ in right),
    }
    if not met[criterion]:
        raise Undecided(f"the criterion '{criterion}' does not apply to this task")


def costate(system: System, witness: Any) -> tuple[arb_mat, arb]:
    """λ, and the price of the tail's limits: the λ written, moved (least squares) onto the equalities of a free tail, in balls.

    These are `λᵀ column_j + Σ (μ⁺ - μ⁻) shape_j(τ) = 0`. Where a coefficient is limited, what is left of the sum may be an excess.
    """
    numbers, capped, columns = placed(system.roots, witness.costate[0])[0], system.capped, system.columns.transpose().tolist()
    written, price, pull = arb_mat(len(numbers), 1, numbers), arb(0), arb_mat(len(columns), 1)
    for contact in witness.tail:
        above, below = system.room(contact.time)
        price += arb(contact.upper * above + contact.lower * below)
        pull += flat(system.zeros, Root.impulse, arb(contact.time)) * arb(contact.upper - contact.lower)
    free = sorted({*range(len(columns))} - {place for places, _ in capped for place in places})
    rows, pulled = arb_mat(len(free), len(numbers), [x for place in free for x in columns[place]]), [pull[place, 0] for place in free]
    spend(len(free) ** 2 * len(numbers))
    moved = written - rows.transpose() * (rows * rows.transpose()).solve(rows * written + arb_mat(len(free), 1, pulled))
    excess = system.columns.transpose() * moved + pull
    return moved, price + sum((cap * abs(acb(*(excess[place, 0] for place in places))) for places, cap in capped), arb(0))


def support(p: Any, horizon: arb, lower: arb, upper: arb, fine: arb) -> arb:
    """A ball around `∫_0^horizon max(upper p, lower p) ds` for an exact horizon and lower ≤ 0 ≤ upper; p is a `Wave`, or a series.

    From the left, intervals are bisected until p has a sign, or is monotone: interval Newton then encloses its root. Where the integrand
    is smaller than `fine` it counts as a radius instead. Raises `Undecided` where p is not known that well.
    """
    weights, span = {1: upper, -1: lower, 0: arb(0)}, upper - lower
    a, sign, total = arb(0), 0, arb(0)  # [0, a] is done, but for the antiderivative at a, where the integrand has this sign on the left
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


def sampled(p: Wave, count: int, step: fmpq, lower: arb, upper: arb) -> arb:
    """A ball around `Σ_k max(upper ∫_cell p, lower ∫_cell p)` over cells of `step`: the most that inputs can do, constant on each."""
    total = before = arb(0)
    for k in range(1, count + 1):
        after = p.integral(arb(k * step))
        total += (upper * (after - before)).max(lower * (after - before))
        before = after
    return total


def prove(system: System, witness: Any, time: fmpq) -> None:
    """Prove that no admissible command takes less than `time` seconds; raises `Refuted` or `Undecided`.

    With a sample time the commands that are refuted take one sample less, or even fewer.
    """
    require(bool(system.zeros) or not witness.tail, "multipliers of a tail that the task does not have")
    numbers, price = costate(system, witness)
    roots, others, relief = boxes.relaxed(system, witness.samples)
    price += arb(witness.fuel * (system.task.limits.fuel or 0))
    price += sum((arb(abs(press.weight) * system.task.limits.deflection[press.output]) for press in witness.deflection), arb(0))
    step = system.task.limits.sample_time
    last = ((time / step).ceil() - 1) * step if step else time  # the longest moves that are refuted: who rests sooner is at rest then, too
    aim = system.target - system.drift(arb(last))
    gain = sum((a * b for a, b in zip(numbers.entries(), aim.entries(), strict=True)), relief - price)
    if system.task.limits.rate is not None:
        entries, end = numbers.entries(), arb(time).upper()
        size = sum((abs(a * b) for a, b in zip(entries, aim.entries(), strict=True)), arb(0))
        fine = (size / end * arb(2) ** (-flint.ctx.prec // 2)).lower()
        right, first = ramps.most(
            system,
            entries,
            witness,
            end,
            lambda wave, length, low, high: support(wave, length, low, high, fine),
            lambda q: parts(system, q, witness.fuel),
        )
        if right < gain + first * arb(system.rest):
            return
        if right > gain + first * arb(system.rest):
            raise Refuted("the lower bound's inequality (2) is false for this costate and these ramps at the time that is claimed")
        raise Undecided("the lower bound's inequality (2) is undecided at this precision")
    if gain <= 0:
        raise Refuted("the lower bound's inequality (2) is false for this costate, whatever the input")
    if not gain > 0:
        raise Undecided("the lower bound's inequality (2) is undecided at this precision")
    p, end = Wave.of((*system.roots, *roots), [*numbers.entries(), *others]), arb(time)
    fine = (gain / end * arb(2) ** (-flint.ctx.prec // 2)).lower()
    terms = parts(system, p, witness.fuel)
    if step:
        count = int(last / step)
        # Many short samples can do no more than a measurable input can in their time.
        short = count <= MOST_CELLS
        each = (
            sampled(q, count, step, low, high) if short else support(q, arb(count * step).upper(), low, high, fine)
            for q, low, high in terms
        )
        least = sum(each, arb(0))
        if least < gain:
            return
        if least > gain and count <= MOST_CELLS:
            raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
        raise Undecided("the lower bound's inequality (2) is undecided at this precision")

    def most(horizon: arb) -> arb:
        """The right side of (2) but for the prices of limits: over the pieces of p, if multipliers of outputs make pieces of it."""
        waves = courses.pressed(system, numbers.entries(), witness.deflection, horizon) if witness.deflection else [(horizon, p)]
        each = ((length, *part) for length, wave in waves for part in parts(system, wave, witness.fuel))
        return sum((support(q, length, low, high, fine) for length, q, low, high in each), arb(0))

    if most(end.upper()) < gain:
        return
    if most(end.lower()) > gain:
        raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality (2) is undecided at this precision")
