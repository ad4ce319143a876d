"""Newton's method on an extremal once more, in arithmetic of many digits: a command written with 45 of them makes both sides of a bracket
agree to the last bit of a double.

The equations are those of `relaxations.refinement`. With as many instants and tail coefficients as the command's own equations (moments,
contacts of the tail) they are solved for the command alone, and the costate follows from linear equations; with more of them the costate
takes part. python-flint's balls serve as long floats here, nothing is proven.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import arb, arb_mat

from relaxations.digits import Equations, equations, rational
from relaxations.frames import decimal
from relaxations.maneuvers import Problem
from relaxations.plants import precision
from relaxations.refinement import Extremal

BITS, BITS_PER_EQUATION = 192, 4  # the condition of a chain's equations grows with every mode
ITERATIONS = 30
MOST_EQUATIONS = 1000
SHARES = (1, 0.5, 0.25, 0.125, 2.0**-4, 2.0**-6, 2.0**-8)
DIGITS = 45  # of the numbers handed on
INSIDE = Fraction(1, 10**30)  # of its room: how far a tail that touches a limit is kept inside it


@dataclass(frozen=True, slots=True)
class Polished:
    """An extremal in exact decimals of many digits: duration T [s], starts [s], costate rows, tail coefficients and contact multipliers."""

    maneuver_time: Fraction
    starts: tuple[Fraction, ...]
    costate: tuple[Fraction, ...]
    tail: tuple[Fraction, ...]
    multipliers: tuple[tuple[float, Fraction, Fraction], ...]  # (instant after the move [s], μ⁺, μ⁻)


@dataclass(frozen=True, slots=True)
class _System:
    """The equations of an extremal in two blocks: those of the command x = (s, T, c), and those of the costate y = (λ, μ), linear in y.

    `∫ b u = target + columns c` and `shapes c = room`; `b(s_i)ᵀ λ = 0`, `columnsᵀ λ + shapesᵀ μ = 0` and `targetᵀ λ - roomᵀ μ = 1`.
    """

    exact: Equations
    levels: Sequence[arb]
    shapes: arb_mat  # (contacts, n), signed by the contacts' sides
    room: arb_mat  # (contacts, 1)

    def command(self, x: arb_mat) -> tuple[arb_mat, arb_mat, arb_mat]:
        """Residuals of the command's equations, their derivative by x, and b at the switches."""
        m, n, contacts = len(self.levels) - 1, self.shapes.ncols(), self.shapes.nrows()
        instants, tail = x.entries()[: m + 1], arb_mat(n, 1, x.entries()[m + 1 :])
        integrals, impulses = self.exact.rows(instants, True), self.exact.rows(instants)
        jumps = [*(before - after for before, after in itertools.pairwise(self.levels)), self.levels[-1]]
        missed = integrals * arb_mat(m + 1, 1, jumps) - self.exact.target - self.exact.columns * tail
        touching = self.shapes * tail - self.room * (1 - arb(rational(INSIDE)))
        slopes = [
            [*(b * jump for b, jump in zip(row, jumps, strict=True)), *(-c for c in columns)]
            for row, columns in zip(impulses.tolist(), self.exact.columns.tolist(), strict=True)
        ]
        slopes += [[*[arb(0)] * (m + 1), *row] for row in self.shapes.tolist()] if contacts else []
        residuals = [*missed.entries(), *touching.entries()]
        return arb_mat(len(residuals), 1, residuals), arb_mat(slopes), arb_mat([row[:m] for row in impulses.tolist()])

    def costate(self, impulses: arb_mat) -> tuple[arb_mat, arb_mat]:
        """Matrix and right side of the costate's equations, from b at the switches."""
        contacts = self.shapes.nrows()
        rows = [[*column, *[arb(0)] * contacts] for column in impulses.transpose().tolist()]
        tails = zip(self.exact.columns.transpose().tolist(), self.shapes.transpose().tolist(), strict=True)
        rows += [[*column, *shape] for column, shape in tails] if self.shapes.ncols() else []
        rows += [[*self.exact.target.entries(), *(-room for room in self.room.entries())]]
        return arb_mat(rows), arb_mat(len(rows), 1, [0] * (len(rows) - 1) + [1])


def polish(problem: Problem, extremal: Extremal, bits: int | None = None) -> Polished | None:
    """The extremal to some 45 digits, or None if Newton's method leaves it (degenerate optima have no square system).

    It may also start from a mere outline (`relaxations.refinement.outline`), where double precision has failed.
    """
    if len(problem.plants) != 1 or problem.size + len(extremal.switches_to_go) > MOST_EQUATIONS:
        return None
    bits = bits or BITS + BITS_PER_EQUATION * problem.size
    with precision(bits):
        try:
            return _polish(problem, extremal, bits)
        except ZeroDivisionError:
            return None


def _polish(problem: Problem, extremal: Extremal, bits: int) -> Polished | None:
    contacts, exact, m = extremal.tail.contacts, equations(problem, bits), len(extremal.switches_to_go)
    size, n, a = problem.size, problem.tail.size, len(contacts)
    command = m + 1 + n
    if command < size + a:
        return None
    shapes = arb_mat(a, n, [c.side * value for c in contacts for value in exact.shapes([c.time]).entries()])
    room = arb_mat(a, 1, [arb(rational(_exact_room(problem, c.time, c.side))) for c in contacts])
    levels = [arb(rational(_level(problem, float(level)))) for level in extremal.levels(problem)]
    system = _System(exact, levels, shapes, room)
    start = [*extremal.switches_to_go, extremal.maneuver_time, *extremal.tail.coefficients]
    x = arb_mat(command, 1, [arb(float(value)) for value in start])
    joint, y = command > size + a, arb_mat(size + a, 1)
    if joint:
        costate = [arb(rational(Fraction(value))) for value in problem.modal(extremal.costate)]
        y = arb_mat(size + a, 1, [*costate, *(arb(c.multiplier) for c in contacts)])
    distance = None
    for _ in range(ITERATIONS):
        missed, slopes, impulses = system.command(x)
        if joint:
            matrix, wanted = system.costate(impulses)
            bends = (arb_mat(1, size, y.entries()[:size]) * exact.slopes() * impulses).entries()
            bent = [[bends[i] if i == j else arb(0) for j in range(command)] for i in range(m)]
            bent += [[arb(0)] * command for _ in range(command - m)]
            whole = [[*row, *[arb(0)] * (size + a)] for row in slopes.tolist()]
            whole += [[*one, *other] for one, other in zip(bent, matrix.tolist(), strict=True)]
            residuals = arb_mat(len(whole), 1, [*missed.entries(), *(matrix * y - wanted).entries()])
            step = arb_mat(whole).mid().solve(residuals.mid(), algorithm="approx").entries()
        else:
            step = slopes.mid().solve(missed.mid(), algorithm="approx").entries()
        # A step that would reorder the arcs is shortened: a start may be no better than the grid.
        share = next((share for share in SHARES if _ordered([x[i, 0] - share * step[i] for i in range(m + 1)])), None)
        if share is None:
            return None
        x = arb_mat(command, 1, [value - share * change for value, change in zip(x.entries(), step, strict=False)]).mid()
        y = (
            arb_mat(size + a, 1, [value - share * change for value, change in zip(y.entries(), step[command:], strict=False)]).mid()
            if joint
            else y
        )
        moved = max(float(abs(change).mid()) for change in step[: m + 1]) / float(x[m, 0].mid())
        if not moved < 1e3 or (distance is not None and distance < 1e-6 and moved > distance):
            return None
        if moved < 2.0 ** (-bits // 2):
            break
        distance = moved
    else:
        return None
    if not joint:
        matrix, wanted = system.costate(system.command(x)[2])
        y = matrix.mid().solve(wanted, algorithm="approx")
    numbers, prices = [decimal(value, DIGITS) for value in x.entries()], [decimal(value, DIGITS) for value in y.entries()]
    time = numbers[m]
    starts = (Fraction(0), *(time - value for value in reversed(numbers[:m])))
    if any(after <= before for before, after in zip(starts, (*starts[1:], time), strict=True)):
        return None
    mu = [max(value, Fraction(0)) for value in prices[size:]]
    pairs = tuple((c.time, p, Fraction(0)) if c.side > 0 else (c.time, Fraction(0), p) for c, p in zip(contacts, mu, strict=True))
    return Polished(time, starts, tuple(prices[:size]), tuple(numbers[m + 1 :]), pairs)


def _ordered(instants: list[arb]) -> bool:
    """Whether times to go and the duration after them ascend from 0."""
    return all(before < after for before, after in itertools.pairwise([arb(0), *instants]))


def _level(problem: Problem, deviation: float) -> Fraction:
    limits, rest = problem.maneuver.limits, problem.maneuver.rest
    return (limits.upper if deviation == problem.upper else limits.lower) - rest


def _exact_room(problem: Problem, since: float, side: int) -> Fraction:
    maneuver = problem.maneuver
    final = maneuver.rest + problem.plants[0].rest_input(maneuver.displacement)
    above, below = maneuver.limits.upper - final, final - maneuver.limits.lower
    if maneuver.tail_length is not None and since >= float(maneuver.tail_length[0]):
        tight = maneuver.tail_length[1] * min(above, below)
        above, below = min(above, tight), min(below, tight)
    return above if side > 0 else below
