"""Newton's method on an extremal once more, in arithmetic of many digits: a command written with 45 of them makes both sides of a bracket
agree to the last bit of a double.

The equations are those of `relaxations.refinement`. With as many instants and tail coefficients as the command's own equations (moments,
contacts of the tail) they are solved for the command alone, and the costate follows from linear equations; with more of them the costate
takes part. A budget of fuel is one more of the command's equations, its price one more unknown beside the costate. python-flint's balls
serve as long floats here, nothing is proven.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import arb, arb_mat

from relaxations.digits import Equations, equations
from relaxations.frames import decimal
from relaxations.maneuvers import Problem
from relaxations.plants import precision, rational
from relaxations.refinement import Extremal
from relaxations.tails import Contact, cap_bound

BITS, BITS_PER_EQUATION = 192, 4  # the condition of a chain's equations grows with every mode
ITERATIONS = 30
MOST_EQUATIONS = 1000
SHARES = (1, 0.5, 0.25, 0.125, 2.0**-4, 2.0**-6, 2.0**-8)
DIGITS = 45  # of the numbers handed on
INSIDE = Fraction(1, 10**30)  # of the input's range, a cap, a budget: how far a tail that touches a limit is kept inside it, or fuel saved


@dataclass(frozen=True, slots=True)
class Polished:
    """An extremal in exact decimals of many digits: duration T [s], starts [s], costate rows, tail coefficients and multipliers."""

    maneuver_time: Fraction
    starts: tuple[Fraction, ...]
    costate: tuple[Fraction, ...]
    tail: tuple[Fraction, ...]
    multipliers: tuple[tuple[Fraction, Fraction, Fraction], ...]  # (instant after the move [s], μ⁺, μ⁻)
    fuel: Fraction  # what a unit of it is worth


@dataclass(frozen=True, slots=True)
class _System:
    """The equations of an extremal in two blocks: those of the command x = (s, T, c, τ), and those of the costate y = (λ, μ), linear in y.

    `∫ b u = target + columns c`, `e(τ) c = inside`, and `e'(τ) c = 0` for the contacts that move (their places are τ, e their rows);
    `b(s_i)ᵀ λ = 0`, `columnsᵀ λ + eᵀ μ = 0` and `targetᵀ λ - roomᵀ μ = 1`; the target is what an initial state leaves of it at T. With a
    `fuel` that is left (a list of one, else of none) the first are those of -|u| too, and λ has its price.
    """

    exact: Equations
    levels: Sequence[arb]
    contacts: tuple[Contact, ...]
    room: Sequence[arb]
    inside: Sequence[arb]
    fuel: Sequence[arb]

    @property
    def size(self) -> int:
        """Number of the components of λ."""
        return self.exact.target.nrows() + len(self.fuel)

    def lasting(self, rows: arb_mat, values: Sequence[arb]) -> list[list[arb]]:
        """Rows of the moments, and the one of the fuel if there is a budget."""
        return [*rows.tolist(), *([*values] for _ in self.fuel)]

    @property
    def spent(self) -> list[arb]:
        """What the fuel's row is worth where a unit of jump is at each switch, and at the beginning of the move."""
        jumps = [*itertools.pairwise(self.levels), (self.levels[-1], arb(0))]
        return [-(abs(before) - abs(after)) / (before - after) if before != after else arb(0) for before, after in jumps]

    @property
    def moving(self) -> list[int]:
        """The contacts whose places are unknown."""
        return [k for k, contact in enumerate(self.contacts) if contact.moving]

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of unknowns of the command and of the costate."""
        command = len(self.levels) + self.exact.columns.ncols() + len(self.moving)
        return command, self.size + len(self.contacts)

    def places(self, z: Sequence[arb]) -> list[arb]:
        """Where the contacts are."""
        places = [arb(contact.place) for contact in self.contacts]
        for k, place in zip(self.moving, z[len(self.levels) + self.exact.columns.ncols() :], strict=False):
            places[k] = place
        return places

    def command(self, z: Sequence[arb]) -> tuple[list[arb], list[list[arb]]]:
        """Residuals of the command's equations, and their derivative by x."""
        arcs, n, moving, places = len(self.levels), self.exact.columns.ncols(), self.moving, self.places(z)
        instants, tail = z[:arcs], arb_mat(n, 1, z[arcs : arcs + n])
        integrals, impulses = self.exact.rows(instants, True), self.exact.rows(instants)
        jumps = [*(before - after for before, after in itertools.pairwise(self.levels)), self.levels[-1]]
        missed = (integrals * arb_mat(arcs, 1, jumps) - self.exact.aim(instants[-1]) - self.exact.columns * tail).entries()
        widths = [after - before for before, after in itertools.pairwise([arb(0), *instants])]
        missed += [left - sum((abs(u) * width for u, width in zip(self.levels, widths, strict=True)), arb(0)) for left in self.fuel]
        rows = zip(self.lasting(impulses, self.spent), self.lasting(self.exact.columns, [arb(0)] * n), strict=True)
        still = [arb(0)] * len(moving)
        slopes = [[*(b * jump for b, jump in zip(row, jumps, strict=True)), *(-c for c in columns), *still] for row, columns in rows]
        for row, moved in zip(slopes, self.exact.drift(instants[-1], True).entries(), strict=False):
            row[arcs - 1] += moved
        touching, turning, bending = (self.exact.touching(self.contacts, places, derivative) for derivative in range(3))
        values, changes, bends = ((table * tail).entries() for table in (touching, turning, bending))
        for k in range(len(self.contacts)):
            missed.append(values[k] - self.inside[k])
            slopes.append([*[arb(0)] * arcs, *touching.tolist()[k], *(changes[k] if k == i else arb(0) for i in moving)])
        for k in moving:
            missed.append(changes[k])
            slopes.append([*[arb(0)] * arcs, *turning.tolist()[k], *(bends[k] if k == i else arb(0) for i in moving)])
        return missed, slopes

    def costate(self, z: Sequence[arb]) -> tuple[arb_mat, arb_mat]:
        """Matrix and right side of the costate's equations."""
        impulses, touching = self.exact.rows(z[: len(self.levels) - 1]), self.exact.touching(self.contacts, self.places(z))
        n = self.exact.columns.ncols()
        rows = [[*column, *[arb(0)] * len(self.contacts)] for column in zip(*self.lasting(impulses, self.spent[:-1]), strict=True)]
        tails = zip(zip(*self.lasting(self.exact.columns, [arb(0)] * n), strict=True), touching.transpose().tolist(), strict=True)
        rows += [[*column, *shape] for column, shape in tails] if n else []
        rows += [[*self.exact.aim(z[len(self.levels) - 1]).entries(), *(arb(0) for _ in self.fuel), *(-room for room in self.room)]]
        return arb_mat(rows), arb_mat(len(rows), 1, [0] * (len(rows) - 1) + [1])

    def step(self, z: Sequence[arb]) -> list[arb]:
        """Newton's step for the command z = x, or for command and costate z = (x, y) together."""
        command, costate = self.sizes
        missed, slopes = self.command(z)
        if len(z) == command:
            return _solved(arb_mat(slopes), arb_mat(command, 1, missed))
        matrix, wanted = self.costate(z)
        y, m, n, size = arb_mat(costate, 1, z[command:]), len(self.levels) - 1, self.exact.columns.ncols(), self.exact.target.nrows()
        bends = (arb_mat(1, size, y.entries()[:size]) * self.exact.changes(z[:m])).entries()
        turning, prices = self.exact.touching(self.contacts, self.places(z), 1).tolist(), y.entries()[self.size :]
        whole = [[*row, *[arb(0)] * costate] for row in slopes]
        for i, row in enumerate(matrix.tolist()):
            by_command = [arb(0)] * command
            if i < m:
                by_command[i] = bends[i]
            elif i < m + n:
                by_command[m + 1 + n :] = [prices[k] * turning[k][i - m] for k in self.moving]
            else:
                by_command[m] = -(self.exact.drift(z[m], True).transpose() * arb_mat(size, 1, y.entries()[:size]))[0, 0]
            whole.append([*by_command, *row])
        return _solved(arb_mat(whole), arb_mat(command + costate, 1, [*missed, *(matrix * y - wanted).entries()]))


def _solved(matrix: arb_mat, right: arb_mat) -> list[arb]:
    return matrix.mid().solve(right.mid(), algorithm="approx").entries()


def polish(problem: Problem, extremal: Extremal, bits: int | None = None, instants: Sequence[arb] | None = None) -> Polished | None:
    """The extremal to some 45 digits, or None if Newton's method leaves it (degenerate optima have no square system).

    It may also start from a mere outline (`relaxations.refinement.outline`), where double precision has failed, or from `instants`, the
    times to go of its switches and its duration, in more digits than doubles have.
    """
    if len(problem.plants) != 1:
        return None
    bits = bits or BITS + BITS_PER_EQUATION * problem.size
    with precision(bits):
        try:
            return _polish(problem, extremal, bits, instants)
        except ZeroDivisionError:
            return None


def _polish(problem: Problem, extremal: Extremal, bits: int, instants: Sequence[arb] | None) -> Polished | None:
    contacts, exact, arcs = extremal.tail.contacts, equations(problem, bits), len(extremal.switches_to_go) + 1
    room = [_allowance(problem, exact, contact) for contact in contacts]
    reach = problem.maneuver.limits.upper - problem.maneuver.limits.lower
    margins = [rational(INSIDE) * (r if c.cap is not None else arb(rational(reach))) for c, r in zip(contacts, room, strict=True)]
    levels = [arb(rational(level - problem.maneuver.rest)) for level in extremal.exact_levels]
    fuel = problem.maneuver.limits.fuel if problem.fuel is not None else None
    left = [] if fuel is None else [arb(rational(fuel * (1 - INSIDE)))]
    system = _System(exact, levels, contacts, room, [r - margin for r, margin in zip(room, margins, strict=True)], left)
    command, costate = system.sizes
    own = instants or [arb(float(at)) for at in (*extremal.switches_to_go, extremal.maneuver_time)]
    begin = (*extremal.tail.coefficients, *(c.place for c in contacts if c.moving))
    z, spare = [*own, *(arb(float(value)) for value in begin)], command - len(system.moving) - costate
    if spare > 0:  # the costate's roots determine the switches
        z += [arb(rational(Fraction(value))) for value in problem.modal(extremal.costate)] + [arb(extremal.fuel) for _ in left]
        z += [arb(c.multiplier) for c in contacts]
    if spare < 0 or len(z) > MOST_EQUATIONS:
        return None
    found = _newton(system, z, bits)
    if found is None:
        return None
    y = found[command:] or _solved(*system.costate(found))
    numbers, prices = ([decimal(value, DIGITS) for value in part] for part in (found[:command], y))
    time = numbers[arcs - 1]
    starts = (Fraction(0), *(time - value for value in reversed(numbers[: arcs - 1])))
    if any(after <= before for before, after in zip(starts, (*starts[1:], time), strict=True)):
        return None
    tail, moved = numbers[arcs : arcs + problem.tail.size], iter(numbers[arcs + problem.tail.size :])
    at = [max(next(moved), Fraction(0)) if contact.moving else Fraction(contact.place) for contact in contacts]
    mu, price = [max(value, Fraction(0)) for value in prices[system.size :]], sum(prices[problem.size : system.size], Fraction(0))
    on = [(c.side, r, price) for c, r, price in zip(contacts, at, mu, strict=True) if c.cap is None]
    triples = tuple((r, price, Fraction(0)) if side > 0 else (r, Fraction(0), price) for side, r, price in on)
    return Polished(time, starts, tuple(prices[: problem.size]), tuple(tail), triples, max(price, Fraction(0)))


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


def _allowance(problem: Problem, exact: Equations, contact: Contact) -> arb:
    """`TailSpace.allowance` of one contact."""
    maneuver = problem.maneuver
    if contact.cap is not None:
        cap = problem.tail.caps[contact.cap]
        zero, multiplicity, _ = exact.zeros[cap.zero]
        return cap_bound(problem.plants[0], zero, multiplicity, cap.sensitivity, maneuver.displacement).mid()
    final = maneuver.rest + problem.plants[0].rest_input(maneuver.displacement)
    above, below = maneuver.limits.upper - final, final - maneuver.limits.lower
    if maneuver.tail_length is not None and contact.place >= float(maneuver.tail_length[0]):
        tight = maneuver.tail_length[1] * min(above, below)
        above, below = min(above, tight), min(below, tight)
    return arb(rational(above if contact.side > 0 else below))
