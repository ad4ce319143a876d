"""Named outputs c(t) x of a plant that varies, and what their limits do to its costate: further components of the rows that are followed.

A row (π, ρ) obeys `(π, ρ)' = -(π, ρ) [A 0; -c 0]` where `π' = -π A + ρ c`; a row (x, u, u') obeys `x' = A x + B u` with an input that is
straight, and (c, 0, 0) makes the output of it. Deviations count from the initial rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

from flint import arb, arb_mat, fmpq

from relaxations.checking import courses
from relaxations.checking.reading import require
from relaxations.checking.transitions import Kick, added, steps

NOTHING = fmpq(0)


def sensible(task: Any, state: Sequence[fmpq]) -> None:
    """Raise `Malformed` unless the limited outputs are those that are written, and within their limits wherever the plant may rest."""
    schedule, n, limits = task.schedule, len(state), task.limits.deflection
    require(schedule.outputs.keys() == limits.keys(), "the outputs of a schedule are those whose deflection is limited")
    for name, limit in limits.items():
        rows = schedule.outputs[name]
        fine = limit > 0 and len(rows) == len(schedule.instants) and all(len(row) == n for row in rows)
        require(fine, f"the limit of the output {name} is more than 0, and it has n numbers at every instant")
        require(all(abs(inner(row, state)) <= limit for row in rows), f"the output {name} rests beyond its limit")
        require(abs(inner(rows[0], task.initial_state or [])) <= limit, f"the output {name} begins beyond its limit")


def inner(a: Sequence[fmpq], b: Sequence[fmpq]) -> fmpq:
    """Σ a_i b_i."""
    return sum((x * y for x, y in zip(a, b, strict=False)), NOTHING)


def at(schedule: Any, rows: Sequence[Sequence[fmpq]], instant: fmpq) -> list[fmpq]:
    """A row of the schedule at an instant."""
    for (s, t), (a, b) in zip(pairwise(schedule.instants), pairwise(rows), strict=True):
        if instant <= t:
            return [x + (y - x) * (instant - s) / (t - s) for x, y in zip(a, b, strict=True)]
    return [*rows[-1]]


def driven(task: Any, numbers: Sequence[fmpq], presses: Sequence[Any]) -> tuple[Any, arb_mat, list[Kick]]:
    """The schedule with the densities ρ of multipliers as further components, the row that it begins with, and how these change."""
    schedule, n, names = task.schedule, len(numbers), sorted({press.output for press in presses})
    size = n + len(names)
    rows = [
        [[*row, *[NOTHING] * len(names)] for row in A]
        + [[*[-x for x in schedule.outputs[name][i]], *[NOTHING] * len(names)] for name in names]
        for i, A in enumerate(schedule.A)
    ]
    columns = [[*b, *[NOTHING] * len(names)] for b in schedule.B]
    kicks = []
    for press in presses:
        place = n + names.index(press.output)
        if press.begin == press.end:
            jump = [press.weight * x for x in at(schedule, schedule.outputs[press.output], press.begin)]
            kicks.append((press.begin, added(arb_mat(1, size, [*jump, *[NOTHING] * len(names)]))))
            continue
        rate = press.weight / (press.end - press.begin)
        for instant, change in ((press.begin, rate), (press.end, -rate)):
            kicks.append((instant, added(arb_mat(1, size, [change if i == place else NOTHING for i in range(size)]))))
    start = arb_mat(1, size, [*numbers, *[NOTHING] * len(names)])
    return SimpleNamespace(instants=schedule.instants, A=rows, B=columns), start, kicks


def gained(task: Any, state: Sequence[fmpq], presses: Sequence[Any]) -> arb:
    """`∫ ρ c x_ss dt - Σ limit ∫ |ρ| dt`."""
    total, schedule = NOTHING, task.schedule
    for press in presses:
        rests = [inner(row, state) for row in schedule.outputs[press.output]]
        total -= abs(press.weight) * task.limits.deflection[press.output]
        if len({*rests}) == 1 or press.begin == press.end:
            total += press.weight * inner(at(schedule, schedule.outputs[press.output], press.begin), state)
            continue
        inside = [instant for instant in schedule.instants if press.begin < instant < press.end]
        edges = [press.begin, *inside, press.end]
        seen = [inner(at(schedule, schedule.outputs[press.output], edge), state) for edge in edges]
        area = sum(((t - s) * (a + b) / 2 for (s, t), (a, b) in zip(pairwise(edges), pairwise(seen), strict=True)), NOTHING)
        total += press.weight * area / (press.end - press.begin)
    return arb(total)


def prove(task: Any, instants: Sequence[fmpq | arb], levels: Sequence[arb], end: fmpq | None) -> None:
    """Prove that every limited output stays within its limit during the move; raises `Refuted` or `Undecided`.

    The input is constant from instant to instant, or straight, and then ends at `end`. While it is not known whether an instant is past
    the input is somewhere between its two levels: what it does until then is a mean of what these do, weight by weight.
    """
    schedule, n = task.schedule, len(task.schedule.B[0])
    minus = [
        [[-A[j][i] for j in range(n)] + [NOTHING] * 2 for i in range(n)]
        + [[*[-x for x in b], NOTHING, NOTHING], [*[NOTHING] * n, fmpq(-1), NOTHING]]
        for A, b in zip(schedule.A, schedule.B, strict=True)
    ]
    kicks: list[Kick] = []
    for i, instant in enumerate(instants[:-1]):
        before = levels[i - 1] if i and end is None else arb(0) if end is None else levels[i]
        slope = arb(0)
        if end is not None:
            after = [*levels, arb(end)][i + 1]
            slope = (after - levels[i]) / arb(instants[i + 1] - instant)
        if not isinstance(instant, fmpq):
            kicks.append((exactly(arb(instant).lower()), moving(before.union(levels[i]), slope)))
        kicks.append((instant if isinstance(instant, fmpq) else exactly(arb(instant).upper()), moving(levels[i], slope)))
    finish, start = arb(instants[-1]).upper(), arb_mat(1, n + 2, [*(task.initial_state or [NOTHING] * n), NOTHING, NOTHING])
    for name, limit in task.limits.deflection.items():
        seen = SimpleNamespace(instants=schedule.instants, A=minus, B=[[*row, NOTHING, NOTHING] for row in schedule.outputs[name]])
        for step in steps(seen, start, finish, kicks):
            length = (finish - arb(step.begin)).min(arb(step.length)).upper()
            course: Any = step.costate
            courses.within(course, length, limit, name, ())


def moving(level: arb, slope: arb) -> Any:
    """The input and its slope from an instant on."""

    def changed(rows: arb_mat) -> arb_mat:
        entries = rows.entries()
        return arb_mat(1, len(entries), [*entries[:-2], level, slope])

    return changed


def exactly(number: arb) -> fmpq:
    """The fraction that an exact number is."""
    mantissa, exponent = number.man_exp()
    return fmpq(mantissa) * fmpq(2) ** int(exponent)
