"""Degenerate optima with fewer switches than equations: a bang-bang command that lands all the same, by what its task happens to be.

A load that begins on its switching curve needs one arc for two equations, a spring over π² units one switch for four. Newton's method has
no square system there, and a program on a grid sees arcs that are too thin to be told from none. Without these the equations are
consistent, and least squares in many digits find the duration and the switches. What is left, some 1e-45, the input takes away after the
move, by levels close to its final rest in pieces of a very short time: the unknowns of Krawczyk's test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb, arb_mat

from relaxations import certificates
from relaxations.bounds import Settings, cut, instants
from relaxations.commands import Command, Segment, Tail
from relaxations.digits import Equations, equations
from relaxations.errors import SolverError
from relaxations.frames import decimal
from relaxations.maneuvers import Problem
from relaxations.plants import precision, rational
from relaxations.refinement import Extremal
from relaxations.sides import MARGINS, Proof, Side, accepted, lower_side, rounded

BITS, BITS_PER_EQUATION = 256, 8
THIN = 5e-2  # of the duration: an arc so thin may be none
ITERATIONS, DIGITS = 40, 45
CLOSED = 1e-24  # of the residual
SHARES = (1e-13, 1e-12, 1e-11, 1e-10, 1e-9)  # of the duration: how long the input may take after the move
LEANS = (1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7)  # of the duration: how far beneath it costates that turn with it are looked for
BENEATH, LAYER = (1e-12, 1e-9), 300  # of the duration: how far beneath it programs are solved; instants at either end
ROOM = Fraction(9, 10)  # of the nearer limit's distance from the final rest


@dataclass(frozen=True, slots=True)
class Landing:
    """Duration T [s], times to go of the switches [s], absolute levels in order of time to go, and a costate if it is determined.

    Of a plant that begins elsewhere than at rest also times a little beneath T, and costates that may refute them.
    """

    maneuver_time: Fraction
    switches_to_go: tuple[Fraction, ...]
    levels: tuple[Fraction, ...]
    costate: tuple[Fraction, ...] | None
    leaning: tuple[tuple[Fraction, tuple[Fraction, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class _Moments:
    """`∫ b u - aim(T)` in long floats, with what a plant that begins elsewhere than at rest brings along."""

    exact: Equations
    levels: Sequence[arb]

    def missed(self, x: Sequence[arb]) -> tuple[arb_mat, arb_mat]:
        """The residual at (s, T), and its derivative."""
        jumps = [*(before - after for before, after in pairwise(self.levels)), self.levels[-1]]
        integrals, impulses = self.exact.rows(x, True), self.exact.rows(x)
        slopes = arb_mat([[b * jump for b, jump in zip(row, jumps, strict=True)] for row in impulses.tolist()])
        residual, last = integrals * arb_mat(len(x), 1, jumps) - self.exact.aim(x[-1]), self.exact.drift(x[-1], True).entries()
        slopes = arb_mat([[*row[:-1], row[-1] + more] for row, more in zip(slopes.tolist(), last, strict=True)])
        return residual.mid(), slopes.mid()


def landing(problem: Problem, extremal: Extremal) -> Landing | None:
    """The command of an extremal, or of its outline, without thin arcs; None if it does not land, or is not degenerate."""
    others, hold = problem.plants[1:], problem.hold
    edges = [0.0, *extremal.switches_to_go.tolist(), extremal.maneuver_time]
    wide = [b - a >= THIN * extremal.maneuver_time for a, b in pairwise(edges)]
    kept = [i for i, fine in enumerate(wide) if fine]
    if others or not problem.bang_bang or problem.tail.size or not kept or not problem.lower < hold < problem.upper:
        return None
    arcs = [kept[0], *(after for before, after in pairwise(kept) if extremal.levels[before] != extremal.levels[after])]
    if len(arcs) >= problem.size:
        return None
    inner = any(not fine and kept[0] < i < kept[-1] for i, fine in enumerate(wide))
    bits = BITS + BITS_PER_EQUATION * problem.size
    with precision(bits):
        exact, maneuver = equations(problem, bits), problem.maneuver
        moments = _Moments(exact, [arb(rational(extremal.exact_levels[i] - maneuver.rest)) for i in arcs])
        x = [arb(edges[i]) for i in arcs[1:]] + [arb(extremal.maneuver_time)]
        try:
            found = _least_squares(moments, x, bits)
            if found is None:
                return None
            ends = [*([arb(0)] if not wide[0] else []), *found[:-1], *([found[-1]] if not wide[-1] else [])]
            costate = None if inner else _costate(moments, found[-1], ends)
        except ZeroDivisionError:
            return None
        numbers = [decimal(value, DIGITS) for value in found]
        leaning = () if inner or problem.begin is None else tuple(_leaning(moments, numbers))
    return Landing(numbers[-1], tuple(numbers[:-1]), tuple(extremal.exact_levels[i] for i in arcs), costate, leaning)


def _least_squares(moments: _Moments, x: list[arb], bits: int) -> list[arb] | None:
    """Gauss and Newton's method: the switches and the duration at which the residual vanishes, or None."""
    for _ in range(ITERATIONS):
        residual, slopes = moments.missed(x)
        turned = slopes.transpose()
        step = (turned * slopes).mid().solve((turned * residual).mid(), algorithm="approx").entries()
        x = [(value - change).mid() for value, change in zip(x, step, strict=True)]
        if not all(a < b for a, b in pairwise([arb(0), *x])):
            return None
        if all(abs(change) < arb(2) ** (-bits // 2) * x[-1] for change in step):
            left = max(float(abs(value).mid()) for value in moments.missed(x)[0].entries())
            return x if left <= CLOSED else None
    return None


def _costate(moments: _Moments, time: arb, places: Sequence[arb]) -> tuple[Fraction, ...] | None:
    """λ with `λ·b = 0` at these times to go and `λ·aim(T) = 1`, if there are as many equations as unknowns, or more that agree."""
    aim = moments.exact.aim(time)
    if len(places) + 1 < aim.nrows():
        return None
    table = arb_mat([*([*column] for column in moments.exact.rows(places).transpose().tolist()), aim.entries()])
    wanted = arb_mat(table.nrows(), 1, [0] * len(places) + [1])
    turned = table.transpose()
    found = (turned * table).mid().solve((turned * wanted).mid(), algorithm="approx").mid()
    off = max(float(abs(value).mid()) for value in (table * found - wanted).entries())
    return tuple(decimal(value, DIGITS) for value in found.entries()) if off < 1e-40 else None


def _leaning(moments: _Moments, numbers: Sequence[Fraction]) -> Iterator[tuple[Fraction, tuple[Fraction, ...]]]:
    """Times beneath the duration, the closest first, and costates that vanish at the switches and at one end of the move, or both.

    What is to be reached turns with the time, and the costate has to lean ahead of it: a pendulum (ω = 1) that one arc of π brings to rest
    is at rest no sooner, by `p(s) = sin(s + δ)` at T = π - δ, since `λ·aim(T) - ∫ |p| ds = 1 - cos δ`.
    """
    *switches, duration = numbers
    for lean in LEANS:
        time = duration * (1 - Fraction(lean))
        end = arb(rational(time))
        for ends in ([end], [arb(0)], [arb(0), end]):
            places = sorted([*(arb(rational(s)) for s in switches), *ends], key=float)
            with suppress(ZeroDivisionError):
                if len(places) + 1 == moments.exact.aim(end).nrows() and (found := _costate(moments, end, places)) is not None:
                    yield time, found


def settled(problem: Problem, task: dict[str, Any], extremal: Extremal) -> Proof:
    """Both sides of a degenerate optimum as far as they are proven that way: the closest claims that are accepted."""
    found = landing(problem, extremal)
    if found is None:
        return Proof()
    proof, maneuver = Proof(), problem.maneuver
    if found.costate is not None:
        witness = certificates.costate_witness(problem, found.costate)
        claims = (Side(found.maneuver_time * (1 - Fraction(margin)), witness) for margin in MARGINS)
        proof = Proof(next((side for side in claims if accepted(task, lower=side)), None))
    for time, costate in found.leaning if proof.lower is None else ():
        side = Side(time, certificates.costate_witness(problem, costate))
        if accepted(task, lower=side):
            proof = Proof(side)
            break
    (plant, *_) = problem.plants
    final, limits, size = maneuver.rest + plant.rest_input(maneuver.displacement), maneuver.limits, problem.size
    starts = [Fraction(0), *(found.maneuver_time - s for s in reversed(found.switches_to_go))]
    for share in SHARES:
        piece = Fraction(share) * found.maneuver_time / size
        duration = found.maneuver_time + size * piece
        begins = [*starts, *(found.maneuver_time + k * piece for k in range(size))]
        levels = [*reversed(found.levels), *[final] * size]
        free: list[list[Any]] = [["level", len(starts) + k, 0] for k in range(size)]
        radius = ROOM * min(limits.upper - final, final - limits.lower)
        side = Side(duration, certificates.command_witness(duration, begins, levels, [], free, radius))
        if accepted(task, upper=side):
            arcs = zip([*starts, found.maneuver_time], [*reversed(found.levels), final], strict=True)
            segments = tuple(Segment(float(start), float(level)) for start, level in arcs)
            command = Command(rounded(duration, float("inf")), segments, Tail(float(final)))
            return Proof(proof.lower, side, command, final=True)
    return proof


def beneath(problem: Problem, task: dict[str, Any], time: float, settings: Settings) -> Proof:
    """The lower side just beneath a duration where the reachable fraction is flat: only the costate of a program there refutes it.

    One grid is dense, the other densest at both ends, where arcs may be thin.
    """
    proof, below = Proof(), time * (1.0 - BENEATH[0])
    layer = below * np.geomspace(1e-10, 1e-2, LAYER)
    ends = np.unique(np.concatenate([instants(problem, below, settings.finer(4)), layer, below - layer]))
    for grid in (instants(problem, time * (1.0 - BENEATH[1]), settings.finer(64)), ends):
        with suppress(SolverError):
            solution = cut(problem, grid, 0.0)
            posed = replace(solution.problem, maneuver=problem.maneuver)
            proof = proof.better(Proof(lower_side(posed, task, solution, solution.maneuver_time)))
    return proof
