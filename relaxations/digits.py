"""The moment equations in as many digits as are asked for: the same rows as `relaxations.maneuvers.Problem`, python-flint's balls as long
floats. Nothing is proven here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import comb, factorial
from typing import cast

from flint import acb, arb, arb_mat, fmpq, fmpq_poly

from relaxations.initial import chain
from relaxations.maneuvers import Problem
from relaxations.plants import Pole, rational
from relaxations.tails import Cap, Contact
from relaxations.transitions import Transition

Root = tuple[acb, int, bool]
"""Value, multiplicity, and whether it stands for a conjugate pair."""


@dataclass(frozen=True, slots=True)
class Equations:
    """Rest after the move, `∫ b u = target + columns c`, at the precision that is set; rows as in `relaxations.moments.Basis`."""

    roots: tuple[Root, ...]
    zeros: tuple[Root, ...]
    target: arb_mat  # (size, 1)
    columns: arb_mat  # (size, n) of the tail's coefficients
    caps: tuple[Cap, ...]
    begin: tuple[tuple[acb, ...], ...]  # moments of an initial state at every root, none at rest

    def aim(self, time: arb) -> arb_mat:
        """What the command's moments must be, but for a tail, at the end of a move of so many seconds: shape (size, 1)."""
        return self.target - self.drift(time) if self.begin else self.target

    def drift(self, time: arb, derivative: bool = False) -> arb_mat:
        """What the moments of the initial state become without input, or the derivative of that: shape (size, 1)."""
        if not self.begin:
            return arb_mat(self.target.nrows(), 1)
        entries: list[arb] = []
        for (root, multiplicity, flexible), first in zip(self.roots, self.begin, strict=True):
            powers = [(root * time).exp()]
            for k in range(1, multiplicity):
                powers.append(powers[-1] * time / k)
            course = [sum((first[i] * powers[k - i] for i in range(k + 1)), acb(0)) for k in range(multiplicity)]
            if derivative:
                course = [root * x + below for x, below in zip(course, [acb(0), *course], strict=False)]
            entries += [part for x in course for part in _parts(x, flexible)]
        return arb_mat(len(entries), 1, entries)

    def rows(self, s: Sequence[arb], integrated: bool = False) -> arb_mat:
        """b at times to go s [s], or its integral from 0: shape (size, len(s))."""
        points = [self._row(at, integrated) for at in s]
        return arb_mat(len(points), self.target.nrows(), [value for point in points for value in point]).transpose()

    def _row(self, s: arb, integrated: bool) -> list[arb]:
        out: list[arb] = []
        for root, multiplicity, flexible in self.roots:
            below, value = acb(1), (root * s).exp()
            for k in range(multiplicity):
                if k:
                    value = value * s / k
                if integrated:
                    below = value * s / (k + 1) if root.is_zero() else (value - below) / root
                out += _parts(below if integrated else value, flexible)
        return out

    def changes(self, s: Sequence[arb]) -> arb_mat:
        """b' at times to go s [s]: shape (size, len(s))."""
        return self.slopes() * self.rows(s)

    def slopes(self) -> arb_mat:
        """The matrix J with `b' = J b`: shape (size, size)."""
        size, at = self.target.nrows(), 0
        matrix = [[arb(0)] * size for _ in range(size)]
        for root, multiplicity, flexible in self.roots:
            width = 2 if flexible else 1
            for row in range(at, at + width * multiplicity):
                matrix[row][row] = root.real
                if row >= at + width:
                    matrix[row][row - width] = arb(1)
            for row in range(at, at + 2 * multiplicity, 2) if flexible else ():
                matrix[row][row + 1], matrix[row + 1][row] = -root.imag, root.imag
            at += width * multiplicity
        return arb_mat(matrix)

    def touching(self, contacts: Sequence[Contact], places: Sequence[arb], derivative: int = 0) -> arb_mat:
        """As `relaxations.tails.TailSpace.touching`, with the contacts at these places."""
        entries: list[arb] = []
        for contact, place in zip(contacts, places, strict=True):
            row = [arb(0)] * self.columns.ncols()
            if contact.cap is None:
                row = self.shapes([place], derivative).entries()
            else:
                turned = place + derivative * arb.pi() / 2
                for j, value in zip(self.caps[contact.cap].at, (turned.cos(), turned.sin()), strict=False):
                    row[j] = value
            entries += [contact.side * value for value in row]
        return arb_mat(len(contacts), self.columns.ncols(), entries)

    def shapes(self, since: Sequence[float | arb], derivative: int = 0) -> arb_mat:
        """As `relaxations.tails.TailSpace.rows`: the tail at `since` [s], or its `derivative`, for each unit coefficient."""
        entries: list[arb] = []
        for r in map(arb, since):
            for zero, multiplicity, flexible in self.zeros:
                decay = (zero * r).exp()
                chain = [decay * r**power / factorial(power) for power in range(multiplicity)]
                for power in range(multiplicity):
                    lower = range(min(derivative, power) + 1)
                    value = sum((comb(derivative, i) * zero ** (derivative - i) * chain[power - i] for i in lower), acb(0))
                    entries += [value.real, -value.imag] if flexible else [value.real]
        return arb_mat(len(since), self.columns.ncols(), entries)


@dataclass(frozen=True, slots=True)
class VaryingEquations(Equations):
    """The same of a plant that varies, `∫ g v = x_ss - x_0`: t takes the place of time to go (`relaxations.transitions`)."""

    transition: Transition

    def rows(self, s: Sequence[arb], integrated: bool = False) -> arb_mat:
        """g at instants s [s], or its integral from 0: shape (size, len(s))."""
        return self.transition.long(s, 2 if integrated else 0)

    def changes(self, s: Sequence[arb]) -> arb_mat:
        """g' at instants s [s]: shape (size, len(s))."""
        return self.transition.long(s, 1)


def _parts(value: acb, flexible: bool) -> list[arb]:
    return [value.real, value.imag] if flexible else [value.real]


@lru_cache(maxsize=64)
def _isolated(coefficients: tuple[fmpq, ...], bits: int) -> tuple[acb, ...]:
    """The roots of a polynomial, lowest power first; `bits` is the precision that they are computed at, and cached for."""
    del bits
    return tuple(ball for ball, _ in cast("list[tuple[acb, int]]", fmpq_poly(list(coefficients)).complex_roots()))


def roots_near(wanted: Sequence[Pole], polynomial: fmpq_poly, bits: int) -> tuple[Root, ...]:
    """The roots that `wanted` are in doubles, at the precision `bits`, which must be set already."""
    found = _isolated(tuple(polynomial.coeffs()), bits) if wanted else ()
    chosen = []
    for pole in wanted:
        near = min(found, key=lambda ball: abs(complex(float(ball.real.mid()), float(ball.imag.mid())) - pole.value))
        chosen.append((acb(near.real.mid(), near.imag.mid()), pole.multiplicity, pole.is_flexible))
    return tuple(chosen)


def equations(problem: Problem, bits: int) -> Equations:
    """The equations of all plants, with roots of `bits` bits: the precision that must be set already."""
    maneuver, entries = problem.maneuver, []
    if problem.transition is not None:
        plant, begin = problem.transition.plant, maneuver.initial
        rest = plant.rest(maneuver.displacement)[0]
        away = rest if begin is None else [x - first for x, first in zip(rest, begin, strict=True)]
        state = arb_mat(plant.order, 1, [arb(rational(x)) for x in away])
        return VaryingEquations((), (), state, arb_mat(plant.order, 0), (), (), Transition(plant, bits))
    zeros = roots_near(problem.tail.zeros, problem.plants[0].numerators[problem.plants[0].output], bits)
    roots: list[Root] = []
    for plant, own in zip(problem.plants, problem.sets, strict=True):
        hold = rational(plant.rest_input(maneuver.displacement))
        found = roots_near(own.basis.poles, plant.denominator, bits)
        roots += found
        for root, multiplicity, flexible in found:
            for k in range(multiplicity):
                if root.is_zero():
                    lowest, static = plant.denominator.coeffs()[multiplicity], plant.numerators[plant.output](fmpq(0))
                    value = acb(rational(maneuver.displacement) * lowest / static) if k == multiplicity - 1 else acb(0)
                else:
                    value = acb(hold) / (-root) ** (k + 1)
                entries += _parts(value, flexible)
    units = [(zero, power, unit) for zero, powers, pair in zeros for power in range(powers) for unit in ((1, 1j) if pair else (1,))]
    columns = [_column(roots, zero, power, acb(unit)) for zero, power, unit in units]
    table = arb_mat(len(columns), len(entries), [value for column in columns for value in column]).transpose()
    first: tuple[tuple[acb, ...], ...] = ()
    if maneuver.initial is not None:
        denominator = problem.plants[0].denominator
        first = tuple(tuple(chain(root, count, denominator, maneuver.initial)) for root, count, _ in roots)
    return Equations(tuple(roots), zeros, arb_mat(len(entries), 1, entries), table, problem.tail.caps, first)


def _column(roots: Sequence[Root], zero: acb, power: int, unit: acb) -> list[arb]:
    """What the tail `Re unit r^l/l! e^{zr}` adds to the moments asked for at the end of the move."""
    column: list[arb] = []
    for root, multiplicity, flexible in roots:
        for k in range(multiplicity):
            factor = comb(k + power, power) * (-1) ** power
            one, other = (factor / (z - root) ** (k + power + 1) for z in (zero, zero.conjugate()))
            column += _parts((unit * one + unit.conjugate() * other) / 2, flexible)
    return column
