"""A plant that varies: x' = A(t) x + B(t) u, y = C(t) x + D(t) u, every matrix linear between the instants of a schedule, then constant.

Deviations v = u - u_ss from the final rest (x_ss, u_ss), a rest at every instant, satisfy `∫_0^T g v dt = x_ss` where a move of T seconds
ends, with g = Φ(0, t) B(t) and the transition Φ (docs/theory.md, section 3). Both sides stand on enclosures of Φ(0, t): over a step it is
the series Σ Y_k τ^k with `(k+1) Y_{k+1} = -(Y_k A_0 + Y_{k-1} A_1)`, cut off, and a ball around the rest of it. With weights w > 0 and
|q| = Σ |q_i| w_i of a row, |q A| ≤ (a_0 + a_1 τ) |q|, so that `|Y_0| e^{a_0 τ + a_1 τ²/2}` has coefficients that are no smaller than those
of |Y|; and of a series with the sum m(τ) and coefficients m_k ≥ 0 those beyond K add at most `ρ^{-K-1} m(ρ τ)`, ρ > 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import flint
from flint import arb, arb_mat, arb_poly, fmpq, fmpq_mat

from relaxations.checking import lower, upper
from relaxations.checking.balls import spend
from relaxations.checking.reading import Refuted, Undecided, require

RATIO, REACH = 8, 1.5  # ρ, and the length of a step times a_0
SWEEPS, LIGHTEST = 60, 2.0**-12  # of the iteration for the weights, and the least of these


@dataclass(frozen=True, slots=True)
class Series:
    """A power series in the time since a step's begin, cut off: what is left out of value and slope is in balls around 0."""

    polynomial: arb_poly
    left: arb
    steep: arb

    def over(self, a: arb, b: arb) -> tuple[arb, arb, arb, arb]:
        """The middle c of [a, b], the value there, and balls around slope and value on all of [a, b]."""
        spend(40)
        c = ((a + b) / 2).mid()
        x, moved = a.union(b).union(c) - c, self.polynomial(arb_poly([c, 1]))
        return c, moved[0] + self.left, moved.derivative()(x) + self.steep, moved(x) + self.left

    def integral(self, s: arb) -> arb:
        """From 0 to s."""
        return self.polynomial.integral()(s) + self.left * s

    def raised(self, level: arb) -> Series:
        """The series plus a constant."""
        return Series(self.polynomial + level, self.left, self.steep)


@dataclass(frozen=True, slots=True)
class Step:
    """Rows q Φ(0, t) from `begin` on, for so many seconds: the matrices of their series, those of A and B, and what is left out of each."""

    begin: fmpq
    length: fmpq
    rows: list[arb_mat]
    column: tuple[arb_mat, arb_mat]
    left: arb_mat  # of the rows
    beyond: arb  # of p = q Φ(0, t) B(t), for each row

    @property
    def costate(self) -> Series:
        """q Φ(0, t) B(t) of the one row that there is."""
        polynomial = arb_poly([product(self.rows, self.column, k)[0, 0] for k in range(len(self.rows))])
        return Series(polynomial, self.beyond, self.beyond * len(self.rows) / arb(self.length))

    def impulse(self, tau: arb) -> arb_mat:
        """q Φ(0, t) B(t)."""
        return (horner(self.rows, tau) + self.left) * (self.column[0] + self.column[1] * tau)

    def step(self, tau: arb) -> arb_mat:
        """Its integral from the begin of the step on."""
        terms = [product(self.rows, self.column, k) / (k + 1) for k in range(len(self.rows))]
        return horner(terms, tau) * tau + arb_mat(self.left.nrows(), 1, [self.beyond * tau] * self.left.nrows())


def horner(series: Sequence[arb_mat], tau: arb) -> arb_mat:
    """The sum of a cut-off series of matrices."""
    value = series[-1]
    for coefficient in reversed(series[:-1]):
        value = value * tau + coefficient
    return value


def product(series: Sequence[arb_mat], linear: tuple[arb_mat, arb_mat], k: int) -> arb_mat:
    """Coefficient k of a series times a linear function."""
    return series[k] * linear[0] + series[k - 1] * linear[1] if k else series[0] * linear[0]


def weights(schedule: Any) -> list[arb]:
    """Positive weights for which the norms of all A are small: about the eigenvector of |A| for its largest eigenvalue."""
    n = len(schedule.B[0])
    size = [[max(abs(float(arb(a[i][j]))) for a in schedule.A) for j in range(n)] for i in range(n)]
    scale = max(map(max, size)) or 1.0
    found = [1.0] * n
    for _ in range(SWEEPS):
        moved = [sum(size[i][j] / scale * found[j] for j in range(n)) + 0.01 * found[i] for i in range(n)]
        found = [max(x / max(moved), LIGHTEST) for x in moved]
    return [arb(x) for x in found]


def steps(schedule: Any, start: arb_mat, end: arb) -> Iterator[Step]:
    """From 0 until `end` is reached: enclosures of `start` Φ(0, t)."""
    n, at, w, rows = len(schedule.B[0]), fmpq(0), weights(schedule), start
    matrices = [(arb_mat(n, n, [x for row in a for x in row]), arb_mat(n, 1, b)) for a, b in zip(schedule.A, schedule.B, strict=True)]
    count = 8 + int((flint.ctx.prec + 20) / 3)
    while True:
        after = next((i for i, instant in enumerate(schedule.instants) if instant > at), None)
        if after is None:
            (A, B), room = matrices[-1], None
            rise, growth = arb_mat(n, n), arb_mat(n, 1)
        else:
            width = schedule.instants[after] - schedule.instants[after - 1]
            (A, B), (last, other) = matrices[after - 1 : after + 1]
            rise, growth = (last - A) / arb(width), (other - B) / arb(width)
            A, B = (here + change * arb(at - schedule.instants[after - 1]) for here, change in ((A, rise), (B, growth)))
            room = schedule.instants[after] - at
        a_0, a_1 = (largest([weighed(matrix.tolist()[i], w) / w[i] for i in range(n)]) for matrix in (A, rise))
        # As long as the bound of what is left out allows; a power of 2, so that instants stay short.
        length = fmpq(2) ** 20
        while not (a_0 + a_1 * RATIO * arb(length) / 2) * arb(length) <= REACH:
            length /= 2
            if length < fmpq(2) ** -60:
                raise Undecided("the plant's matrices are too large to follow its transition")
        if room is not None and length >= room:
            length = room
        spend(count * (4 + n * n * rows.nrows() / 8))
        series = [rows]
        for k in range(count):
            series.append(product(series, (A, rise), k) / -(k + 1))
        far = arb(length) * RATIO
        kept = (a_0 * far + a_1 * far * far / 2).exp() / arb(RATIO) ** (count + 1)
        sizes = [weighed(row, w) * kept for row in rows.tolist()]
        left = arb_mat(rows.nrows(), n, [arb(0, (size / w[j]).upper()) for size in sizes for j in range(n)])
        b, more = (largest([abs(x) / w[i] for i, x in enumerate(column.entries())]) for column in (B, growth))
        yield Step(at, length, series, (B, growth), left, arb(0, (largest(sizes) * (b + far * more)).upper()))
        rows, at = horner(series, arb(length)) + left, at + length
        if at >= end:
            return


def weighed(row: Sequence[arb], w: Sequence[arb]) -> arb:
    """Σ |q_i| w_i."""
    return sum((abs(x) * weight for x, weight in zip(row, w, strict=True)), arb(0))


def largest(numbers: Sequence[arb]) -> arb:
    """A bound of all of them."""
    found = arb(0)
    for number in numbers:
        found = found.max(number.upper())
    return found


@dataclass(frozen=True, slots=True)
class Varying:
    """The task: where the plant must come to rest, and the limits of v, exact."""

    task: Any
    state: list[fmpq]
    final: fmpq  # the input at the final rest
    lower: fmpq
    upper: fmpq


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
    return Varying(task, state, final, low - final, high - final)


def lower_side(task: Varying, witness: Any, time: fmpq) -> None:
    """Prove that no admissible command takes `time` or less: `λᵀ x_ss > ∫_0^time σ(λᵀ g) dt` (+ μ fuel); or raise."""
    chains = witness.costate[0]
    fine = not (witness.tail or witness.samples or witness.deflection or witness.ramps or witness.steps) and len(chains) == 1
    require(
        fine and len(chains[0].coefficients) == len(task.state), "the costate of a plant that varies is one chain, a number for each state"
    )
    numbers = [re for re, _ in chains[0].coefficients]
    require(not any(im for _, im in chains[0].coefficients), "the costate of a plant that varies is real")
    gain = arb(sum((a * b for a, b in zip(numbers, task.state, strict=True)), fmpq(0)) - witness.fuel * (task.task.limits.fuel or 0))
    if not gain > 0:
        raise Refuted("the lower bound's inequality (2) is false for this costate, whatever the input")
    end, price, total = arb(time), arb(witness.fuel), arb(0)
    fine_enough = (gain / end * arb(2) ** (-flint.ctx.prec // 2)).lower()
    for step in steps(task.task.schedule, arb_mat([numbers]), end.upper()):
        length = arb(step.length).min(end - arb(step.begin)).upper()  # rather a hair too far: σ is not negative
        p = step.costate
        parts = [(p, task.lower, task.upper)]
        if task.task.limits.fuel is not None:
            parts = [(p.raised(-price), fmpq(0), task.upper), (p.raised(price), task.lower, fmpq(0))]
        total += sum((lower.support(q, length, arb(low), arb(high), fine_enough) for q, low, high in parts), arb(0))
    if total < gain:
        return
    if total > gain + fine_enough * end:
        raise Refuted("the lower bound's inequality (2) is false for this costate at the time that is claimed")
    raise Undecided("the lower bound's inequality (2) is undecided at this precision")


def upper_side(task: Varying, witness: Any, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists, by Krawczyk's test on `∫ g v = x_ss`; or raise."""
    n, size = len(witness.segments), len(task.state)
    require(n > 0 and not witness.tail, "the command of a plant that varies has segments, and no tail")
    command, unknowns = upper.as_written(task.task, (), witness)
    last = largest([arb(x) for x in command[: n + 1]]) + 2 * arb(witness.radius).upper()
    motion = list(steps(task.task.schedule, arb_mat(size, size, 1), last))
    followed = arb(motion[-1].begin + motion[-1].length)
    begun = [arb_mat(size, 1)]  # the integral of g until each step begins
    for step in motion:
        begun.append(begun[-1] + step.step(arb(step.length)))

    def seen(instant: arb | fmpq, integrated: bool) -> arb_mat:
        """g or its integral from 0 at an instant: over its ball, of all steps that it meets."""
        at, found = arb(instant), None
        spend(len(motion) / 4)
        if not 0 <= at <= followed:
            raise Undecided("an instant of the command is outside the time that was followed")
        for i, step in enumerate(motion):
            tau = at - arb(step.begin)
            if tau < 0 or tau > arb(step.length):
                continue
            spend(len(step.rows) * (2 + size * size / 8))
            tau = inside(tau, arb(step.length))
            value = begun[i] + step.step(tau) if integrated else step.impulse(tau)
            found = (
                value if found is None else arb_mat(size, 1, [a.union(b) for a, b in zip(found.entries(), value.entries(), strict=True)])
            )
        assert found is not None
        return found

    def values(command: Sequence[fmpq | arb]) -> tuple[list[fmpq | arb], list[arb]]:
        """The instants from 0 to the duration, and v between them."""
        shift = task.task.initial_input - task.final
        return [*command[1 : n + 1], command[0]], [arb(level + shift) for level in command[n + 1 : 2 * n + 1]]

    def residual(command: Sequence[fmpq | arb]) -> arb_mat:
        instants, v = values(command)
        integrals = [seen(instant, True) for instant in instants]
        return sum(((b - a) * level for (a, b), level in zip(pairwise(integrals), v, strict=True)), -arb_mat(size, 1, task.state))

    def derivative(command: Sequence[fmpq | arb], place: int) -> arb_mat:
        instants, v = values(command)
        if place == 0:
            return seen(command[0], False) * v[-1]
        if place <= n:
            return seen(instants[place - 1], False) * (v[place - 2] - v[place - 1])
        return seen(instants[place - n], True) - seen(instants[place - n - 1], True)

    command = upper.krawczyk(command, unknowns, size, witness.radius, residual, derivative)
    instants, v = values(command)
    for i, (before, after) in enumerate(pairwise(instants), 1):
        upper.at_most(before, after, f"instant {i} comes after the one before")
    for i, level in enumerate(command[n + 1 : 2 * n + 1]):
        upper.at_most(task.task.limits.input[0], level + task.task.initial_input, f"level {i} is above its limit")
        upper.at_most(level + task.task.initial_input, task.task.limits.input[1], f"level {i} is below its limit")
    if task.task.limits.fuel is not None:
        burnt = sum((abs(level) * arb(b - a) for level, (a, b) in zip(v, pairwise(instants), strict=True)), arb(0))
        upper.at_most(burnt, task.task.limits.fuel, "the move uses no more fuel than there is")
    upper.at_most(command[0], time, "the command takes no longer than claimed")


def inside(tau: arb, length: arb) -> arb:
    """The part of a ball of times that is within a step."""
    return tau.lower().max(arb(0)).union(tau.upper().min(length))


def prove(certificate: Any) -> None:
    """Prove every side that is claimed; raises `Refuted`, `Undecided` or `Malformed`."""
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
    others = (limits.deflection, limits.rate, limits.pulse_width, limits.pulses, limits.sample_time, limits.tail_length)
    fine = task.rest == "state" and task.box is None and task.initial_state is None and not any((*others, limits.zero_sensitivity))
    require(fine, "a plant that varies comes to a rest of its state, within limits of its input and its fuel only")


def described(task: Any) -> list[str]:
    """The plant in words and numbers as written."""
    schedule = task["schedule"]
    lines = ["Plant: x' = A(t) x + B(t) u, y = C(t) x + D(t) u, every matrix linear in t between these instants, constant after the last."]
    for instant, A, b, C, d in zip(*(schedule[name] for name in ("instants", "A", "B", "C", "D")), strict=True):
        rows = ", ".join(f"[{', '.join(row)}]" for row in A)
        lines.append(f"  t = {instant} s: A = [{rows}], B = [{', '.join(b)}], C = [{', '.join(C)}], D = {d}")
    return lines
