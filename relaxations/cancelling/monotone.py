"""How short a filter could be whose answer never turns back, with any number of delays: a lower bound that is proven in balls.

Such a filter is a measure that is nowhere negative: on [0, T] any, after T one of its decaying terms. It satisfies `G_f(p) = 0` at every
flexible pole, so for any weights y the sum of

    q(t) = Re Σ y* (ω(t - T))^j e^{κω(t - T)}                  over what acts until T, and
    Re Σ y* ω^j j! Σ_g c_g / (-z_g - κω)^(j+1) …               over its tail

is 0. Where q > 0 on [0, T], and the second for every tail that is nowhere negative, there is none: of T nor shorter (it may wait). Tails
are positive sums of few: of one real zero its own, `e^{zr}` and `r e^{zr}` of a double one, `e^{z_1 r} - e^{z_2 r}` and `e^{z_2 r}` of two
with z_1 > z_2; a complex pair alone has none. The weights come from a linear program on a grid; what is claimed is q's sign between its
instants too (`relaxations.checking.durations`), of the poles and zeros as doubles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import acb, arb, fmpq
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.cancelling.conditions import Conditions
from relaxations.checking.durations import Condition, none_as_short
from relaxations.plants import precision

Reals = NDArray[np.float64]

CELLS = 800  # instants of the linear program
HALVINGS = 40  # of the bracket of the duration
POSITIVE = 1e-10  # what counts as more than nothing in the linear program, weights of order one
SHORTER = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # relative: how far below its optimum the proof is tried
BITS = 128


@dataclass(frozen=True, slots=True)
class _Tail:
    """`Σ weight r^power/power! e^{rate r}`, nowhere negative: its terms (weight, rate [1/s], power)."""

    terms: tuple[tuple[int, float, int], ...]


def least_monotone(conditions: Conditions, known: float) -> float | None:
    """The longest T [s] for which it is proven that no such filter is as short; `known` [s] is the duration of one.

    None where nothing was proven: for poles other than flexible ones, and for tails of more zeros than those above.
    """
    tails = _tails(conditions)
    if tails is None or conditions.rigid or not all(pole.is_flexible for pole in conditions.poles) or not conditions.poles:
        return None
    low, high = 0.0, known * (1.0 + 1e-6)
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if _weights(conditions, tails, middle)[1] > POSITIVE else (low, middle)
    for less in SHORTER:
        claimed = low * (1.0 - less)
        weights, margin = _weights(conditions, tails, claimed)
        if margin > 0.0 and _proven(conditions, tails, claimed, weights):
            return claimed
    return None


def _tails(conditions: Conditions) -> tuple[_Tail, ...] | None:
    zeros = sorted(conditions.zeros, key=lambda zero: -zero.value.real)
    real = [zero for zero in zeros if not zero.is_flexible]
    match zeros:
        case []:
            return ()
        case [zero] if zero.is_flexible:
            return () if zero.multiplicity == 1 else None
        case [zero] if zero.multiplicity <= 2:
            return tuple(_Tail(((1, zero.value.real, power),)) for power in range(zero.multiplicity))
        case [slow, fast] if len(real) == 2 and slow.multiplicity == fast.multiplicity == 1:
            return _Tail(((1, slow.value.real, 0), (-1, fast.value.real, 0))), _Tail(((1, fast.value.real, 0),))
        case _:
            return None


def _modes(conditions: Conditions) -> list[tuple[float, float, int]]:
    """(frequency, damping, power) of every complex equation."""
    return [(p.natural_frequency, p.damping_ratio, j) for p in conditions.poles for j in range(p.multiplicity)]


def _weights(conditions: Conditions, tails: Sequence[_Tail], duration: float) -> tuple[NDArray[np.complex128], float]:
    """The weights with parts within ±1 for which the least of q and of the tails' sums is largest, and that."""
    since = np.linspace(-duration, 0.0, CELLS + 1)
    columns = []
    for frequency, damping, power in _modes(conditions):
        kappa = complex(damping, math.sqrt(1.0 - damping**2))
        motion = (frequency * since) ** power * np.exp(kappa * frequency * since)
        after = [
            sum(
                weight * frequency**power * math.comb(power + k, k) * math.factorial(power) / (-rate - kappa * frequency) ** (power + k + 1)
                for weight, rate, k in tail.terms
            )
            for tail in tails
        ]
        both = np.concatenate([motion, np.array(after, dtype=complex)])
        columns += [both.real, both.imag]  # Re(y* z) = Re y Re z + Im y Im z
    table = np.stack(columns, axis=1)
    scales = np.abs(table).max(axis=1, keepdims=True)
    rows = np.hstack([-table / np.maximum(scales, 1e-300), np.ones((len(table), 1))])
    bounds = [(-1.0, 1.0)] * table.shape[1] + [(None, None)]
    cost = np.append(np.zeros(table.shape[1]), -1.0)
    solved = linprog(cost, A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds, options={"primal_feasibility_tolerance": 1e-10})
    if solved.x is None:
        return np.zeros(len(columns) // 2, dtype=complex), 0.0
    return solved.x[:-1:2] + 1j * solved.x[1:-1:2], float(solved.x[-1])


def _proven(conditions: Conditions, tails: Sequence[_Tail], duration: float, weights: NDArray[np.complex128]) -> bool:
    asked = [
        Condition(Fraction(frequency), Fraction(damping), Fraction(0), power, (Fraction(y.real), Fraction(y.imag)))
        for (frequency, damping, power), y in zip(_modes(conditions), map(complex, weights), strict=True)
    ]
    return all(_keeps(asked, tail) for tail in tails) and none_as_short(Fraction(duration), asked)


def _keeps(asked: Sequence[Condition], tail: _Tail) -> bool:
    """Whether the sum over a tail is positive, in balls."""
    with precision(BITS):
        total = acb(0)
        for one in asked:
            frequency, damping, real, imaginary = (arb(fmpq(x.numerator, x.denominator)) for x in (one.frequency, one.damping, *one.weight))
            kappa = acb(damping, (1 - damping * damping).sqrt())
            for weight, rate, k in tail.terms:
                factor = weight * math.comb(one.power + k, k) * math.factorial(one.power)
                total += acb(real, -imaginary) * factor * frequency**one.power / (-arb(rate) - kappa * frequency) ** (one.power + k + 1)
        return bool(total.real > 0)
