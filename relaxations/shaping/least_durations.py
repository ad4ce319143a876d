"""How short a shaper with negative impulses could be at all, whatever its form: a lower bound that is proven in balls.

Of all sequences (and pulses) of sum 1 whose negative parts sum to at most N in size and that leave no more of the modes than is allowed,
none is as short as the bound. On a grid of instants the least excess r over the tolerances is a second-order cone program; where it stays
above 0 its multipliers give

    p(t) = Re Σ y_i* z_i(t),     (1 + N) min p - N max p > Σ |y_i| V_i

which relaxations.checking.durations proves between the instants, for one duration and with that for all shorter ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb
from numpy.typing import NDArray

from relaxations import programs
from relaxations.checking.durations import Condition, none_as_short
from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.polishing import Demand, rows

Reals = NDArray[np.float64]

CELLS, FINER = 120, 16  # instants of the first grid; how much finer p is looked at
CLOSER = 201  # places between the neighbours of a top
ROUNDS = 8  # of exchange
SHORTER = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # relative: how far below a duration the proof that none is shorter is tried
HALVINGS = 14  # of the bracket of the duration
CLOSE = 1e-7  # excess that counts as none
ABOVE = 1e-10  # how far above p's largest value, p of order one, its bound is claimed; that bound is proven
MISSED = 1e-9  # by which p on the finer grid may go beyond what the program saw


@dataclass(frozen=True, slots=True)
class Remnant:
    """At most `tolerance` of the unshaped vibration is left of `mode`; 0: nothing."""

    mode: Mode
    tolerance: float = 0.0


def least_with_derivatives(mode: Mode, derivatives: int) -> float:
    """(n + 1)π/ω_d [s], rounded down: no positive shaper with zero vibration and n derivatives of it is shorter, at any damping.

    Let x = ω_d(t - T). The function `p = e^{ζω(t-T)} sin x Π_{k=1}^n (x + kπ)` is of the form Re Σ y_j* z_j, so Σ A_k p(t_k) = 0. Back to
    x = -(n+1)π it does not change its sign (where sin x does, one factor does), so positive impulses stand at its zeros, whole half periods
    before T. A shorter shaper has at most n + 1 of these, and a polynomial of degree n that vanishes at all but one of them shows that
    there is none at that one. Pulses are refuted alike.
    """
    with precision(128):
        zeta = arb(mode.damping)
        whole = (derivatives + 1) * arb.pi() / (arb(mode.frequency) * (1 - zeta * zeta).sqrt())
        nearest = float(whole.lower())
        return nearest if arb(nearest) <= whole else math.nextafter(nearest, 0.0)


def least_duration(remnants: Sequence[Remnant], negative: float, known: float) -> float | None:
    """The longest duration [s] for which it is proven that no such shaper is as short; `known` [s] is the duration of one.

    None if nothing was proven, as where an impulse alone leaves no more than is allowed.
    """
    if known <= 0.0 or max(remnant.tolerance for remnant in remnants) >= 1.0:
        return None
    try:
        if proven := _proven(remnants, negative, known, SHORTER[:2]):
            return proven
        low, high = 0.0, known
        for _ in range(HALVINGS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if _solved(remnants, negative, middle, 1)[0] > CLOSE else (low, middle)
        return _proven(remnants, negative, high, SHORTER)
    except SolverError:
        return None


def _demands(remnants: Sequence[Remnant]) -> list[Demand]:
    return [Demand(r.mode.frequency, r.mode.damping, r.tolerance) for r in remnants]


def _proven(remnants: Sequence[Remnant], negative: float, duration: float, shorter: Sequence[float]) -> float | None:
    for less in shorter:
        claimed = duration * (1.0 - less)
        excess, multipliers, highest = _solved(remnants, negative, claimed, ROUNDS)
        if excess <= 0.0:
            continue
        conditions = [
            Condition(Fraction(r.mode.frequency), Fraction(r.mode.damping), Fraction(r.tolerance), 0, (Fraction(y.real), Fraction(y.imag)))
            for r, y in zip(remnants, map(complex, multipliers), strict=True)
        ]
        if none_as_short(Fraction(claimed), conditions, Fraction(negative), Fraction(highest)):
            return claimed
    return None


def _solved(remnants: Sequence[Remnant], negative: float, duration: float, rounds: int) -> tuple[float, NDArray[np.complex128], float]:
    """The least excess, the multipliers, and a number above p."""
    demands, radii = _demands(remnants), np.array([r.tolerance for r in remnants])
    fine = np.linspace(0.0, duration, FINER * CELLS + 1)
    seen = rows(demands, fine, duration)
    chosen = np.arange(0, len(fine), FINER)
    solution = programs.closest(seen[:, chosen], radii, negative)
    for _ in range(rounds - 1):
        course = (solution.multipliers.conj() @ seen).real
        inside = course[chosen]
        beyond = [i for i in (*_tops(course), *_tops(-course)) if not inside.min() - MISSED <= course[i] <= inside.max() + MISSED]
        if not beyond:
            break
        chosen = np.union1d(chosen, beyond)
        solution = programs.closest(seen[:, chosen], radii, negative)
    course = (solution.multipliers.conj() @ seen).real
    highest = float(course.max())
    for i in _tops(course):  # the parabola through three samples of a grid that is finer yet: p's fourth derivative is not felt
        near = np.linspace(fine[max(i - 1, 0)], fine[min(i + 1, len(fine) - 1)], CLOSER)
        closely = (solution.multipliers.conj() @ rows(demands, near, duration)).real
        highest = max(highest, _top(closely, int(closely.argmax())))
    return solution.excess, solution.multipliers, highest + ABOVE


def _top(course: Reals, i: int) -> float:
    """The height of the parabola through a sample and its neighbours."""
    if i in (0, len(course) - 1):
        return float(course[i])
    rise, fall = course[i] - course[i - 1], course[i] - course[i + 1]
    return float(course[i] + (rise - fall) ** 2 / (8.0 * (rise + fall)))


def _tops(course: Reals) -> NDArray[np.intp]:
    padded = np.concatenate([[-np.inf], course, [-np.inf]])
    return np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))
