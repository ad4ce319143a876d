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

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of unknowns of the command and of the costate: each block has as many equations as the other has unknowns."""
        return len(self.levels) + self.shapes.ncols(), self.exact.target.nrows() + self.shapes.nrows()

    def command(self, x: Sequence[arb]) -> tuple[list[arb], list[list[arb]], arb_mat]:
        """Residuals of the command's equations, their derivative by x, and b at the switches."""
        arcs, n = len(self.levels), self.shapes.ncols()
        instants, tail = x[:arcs], arb_mat(n, 1, x[arcs : arcs + n])
        integrals, impulses = self.exact.rows(instants, True), self.exact.rows(instants)
        jumps = [*(before - after for before, after in itertools.pairwise(self.levels)), self.levels[-1]]
        missed = integrals * arb_mat(arcs, 1, jumps) - self.exact.target - self.exact.columns * tail
        touching = self.shapes * tail - self.room * (1 - arb(rational(INSIDE)))
        rows = zip(impulses.tolist(), self.exact.columns.tolist(), strict=True)
        slopes = [[*(b * jump for b, jump in zip(row, jumps, strict=True)), *(-c for c in columns)] for row, columns in rows]
        slopes += [[*[arb(0)] * arcs, *row] for row in self.shapes.tolist()] if n else []
        return [*missed.entries(), *touching.entries()], slopes, arb_mat([row[:-1] for row in impulses.tolist()])

    def costate(self, impulses: arb_mat) -> tuple[arb_mat, arb_mat]:
        """Matrix and right side of the costate's equations, from b at the switches."""
        contacts = self.shapes.nrows()
        rows = [[*column, *[arb(0)] * contacts] for column in impulses.transpose().tolist()]
        tails = zip(self.exact.columns.transpose().tolist(), self.shapes.transpose().tolist(), strict=True)
        rows += [[*column, *shape] for column, shape in tails] if self.shapes.ncols() else []
        rows += [[*self.exact.target.entries(), *(-room for room in self.room.entries())]]
        return arb_mat(rows), arb_mat(len(rows), 1, [0] * (len(rows) - 1) + [1])

    def step(self, z: Sequence[arb]) -> list[arb]:
        """Newton's step for the command z = x, or for command and costate z = (x, y) together."""
        command, costate = self.sizes
        missed, slopes, impulses = self.command(z)
        if len(z) == command:
            return _solved(arb_mat(slopes), arb_mat(command, 1, missed))
        matrix, wanted = self.costate(impulses)
        y, m = arb_mat(costate, 1, z[command:]), len(self.levels) - 1
        bends = (
            arb_mat(1, self.exact.target.nrows(), z[command : command + self.exact.target.nrows()]) * self.exact.slopes() * impulses
        ).entries()
        whole = [[*row, *[arb(0)] * costate] for row in slopes]
        for i, row in enumerate(matrix.tolist()):
            whole.append([*(bends[i] if i == j < m else arb(0) for j in range(command)), *row])
        return _solved(arb_mat(whole), arb_mat(command + costate, 1, [*missed, *(matrix * y - wanted).entries()]))


def _solved(matrix: arb_mat, right: arb_mat) -> list[arb]:
    return matrix.mid().solve(right.mid(), algorithm="approx").entries()


def polish(problem: Problem, extremal: Extremal, bits: int | None = None) -> Polished | None:
    """The extremal to some 45 digits, or None if Newton's method leaves it (degenerate optima have no square system).

    It may also start from a mere outline (`relaxations.refinement.outline`), where double precision has failed.
    """
    if len(problem.plants) != 1:
        return None
    bits = bits or BITS + BITS_PER_EQUATION * problem.size
    with precision(bits):
        try:
            return _polish(problem, extremal, bits)
        except ZeroDivisionError:
            return None


def _polish(problem: Problem, extremal: Extremal, bits: int) -> Polished | None:
    contacts, exact, arcs = extremal.tail.contacts, equations(problem, bits), len(extremal.switches_to_go) + 1
    shapes = [c.side * value for c in contacts for value in exact.shapes([c.time]).entries()]
    room = [arb(rational(_exact_room(problem, c.time, c.side))) for c in contacts]
    levels = [arb(rational(_level(problem, float(level)))) for level in extremal.levels(problem)]
    system = _System(exact, levels, arb_mat(len(room), problem.tail.size, shapes), arb_mat(len(room), 1, room))
    command, costate = system.sizes
    z = [arb(float(value)) for value in (*extremal.switches_to_go, extremal.maneuver_time, *extremal.tail.coefficients)]
    if command > costate:  # the costate's roots determine the switches
        z += [arb(rational(Fraction(value))) for value in problem.modal(extremal.costate)] + [arb(c.multiplier) for c in contacts]
    if command < costate or len(z) > MOST_EQUATIONS:
        return None
    found = _newton(system, z, bits)
    if found is None:
        return None
    y = found[command:] or _solved(*system.costate(system.command(found)[2]))
    numbers, prices = ([decimal(value, DIGITS) for value in part] for part in (found[:command], y))
    time = numbers[arcs - 1]
    starts = (Fraction(0), *(time - value for value in reversed(numbers[: arcs - 1])))
    if any(after <= before for before, after in zip(starts, (*starts[1:], time), strict=True)):
        return None
    mu = [max(value, Fraction(0)) for value in prices[problem.size :]]
    pairs = tuple((c.time, p, Fraction(0)) if c.side > 0 else (c.time, Fraction(0), p) for c, p in zip(contacts, mu, strict=True))
    return Polished(time, starts, tuple(prices[: problem.size]), tuple(numbers[arcs:]), pairs)


def _newton(system: _System, z: list[arb], bits: int) -> list[arb] | None:
    """Newton's method from z, or None if it comes to no end."""
    distance, arcs = None, len(system.levels)
    for _ in range(ITERATIONS):
        step = system.step(z)
        # A step that would reorder the arcs is shortened: a start may be no better than the grid.
        share = next((share for share in SHARES if _ordered([z[i] - share * step[i] for i in range(arcs)])), None)
        if share is None:
            return None
        z = [(value - share * change).mid() for value, change in zip(z, step, strict=True)]
        moved = max(float(abs(change).mid()) for change in step[:arcs]) / float(z[arcs - 1].mid())
        if not moved < 1e3 or (distance is not None and distance < 1e-6 and moved > distance):
            return None
        if moved < 2.0 ** (-bits // 2):
            return z
        distance = moved
    return None


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
