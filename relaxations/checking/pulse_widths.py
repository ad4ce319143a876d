"""No pulses that begin at given intervals do: an exhaustive search over their widths, each part of it refuted in balls.

Pulse k of height a begins at kh and lasts w_k, 0 ≤ w_k ≤ h, k < n. A shaper's pulses satisfy `a Σ_k ∫_0^{w_k} z_i(kh + x) dx = b_i` with

    z_0 = 1, b_0 = 1,     z_i(t) = (t - nh)^j e^{κ_i ω_i (t - nh)}, b_i = 0

For any weights, P(t) = y_0 + Re Σ y_i* z_i(t), and any part of the box of widths `l_k ≤ w_k ≤ u_k`

    a Σ_k min over [l_k, u_k] of ∫_0^w P(kh + x) dx > y_0

so contradicts them. A box is halved where no weights do that alone; the halves cover it. Fewer intervals are widths of 0 at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import flint
from flint import acb, arb, fmpq

BITS = 128
CELLS = (4, 16, 64)  # of a width's range, tried one after the other


@dataclass(frozen=True, slots=True)
class Vanishing:
    """At natural `frequency` [rad/s] and `damping` derivative number `power` of the vibration is 0. All exact."""

    frequency: Fraction
    damping: Fraction
    power: int


@dataclass(frozen=True, slots=True)
class Weights:
    """y_0, and (re, im) of y_i for every condition: they refute a box."""

    sum: Fraction
    vanishing: tuple[tuple[Fraction, Fraction], ...]


@dataclass(frozen=True, slots=True)
class Halves:
    """Pulse number `pulse` lasts at most `at` [s], or at least that long."""

    pulse: int
    at: Fraction
    below: Weights | Halves
    above: Weights | Halves


def no_widths(conditions: Sequence[Vanishing], height: Fraction, interval: Fraction, count: int, search: Weights | Halves) -> bool:
    """Whether it is proven that no pulses of `height` [1/s] on `count` intervals [s], or on fewer, meet the conditions."""
    sound = all(c.frequency > 0 and 0 <= c.damping < 1 and c.power >= 0 for c in conditions)
    if not (sound and height > 0 and interval > 0 and count > 0):
        return False
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        waiting: list[tuple[Weights | Halves, tuple[Fraction, ...], tuple[Fraction, ...]]] = [
            (search, (Fraction(0),) * count, (interval,) * count)
        ]
        while waiting:
            node, low, high = waiting.pop()
            if isinstance(node, Weights):
                if len(node.vanishing) != len(conditions) or not _refuted(conditions, height, interval, node, low, high):
                    return False
                continue
            if not (0 <= node.pulse < count and low[node.pulse] <= node.at <= high[node.pulse]):
                return False
            waiting.append((node.below, low, _replaced(high, node.pulse, node.at)))
            waiting.append((node.above, _replaced(low, node.pulse, node.at), high))
        return True
    finally:
        flint.ctx.prec = before


def _replaced(values: tuple[Fraction, ...], place: int, value: Fraction) -> tuple[Fraction, ...]:
    return (*values[:place], value, *values[place + 1 :])


def _refuted(
    conditions: Sequence[Vanishing],
    height: Fraction,
    interval: Fraction,
    weights: Weights,
    low: Sequence[Fraction],
    high: Sequence[Fraction],
) -> bool:
    function = _Function(conditions, weights)
    count = len(low)
    for cells in CELLS:
        total = arb(0)
        for k in range(count):
            start = _arb((k - count) * interval)
            total += function.least(start, start + _arb(low[k]), start + _arb(high[k]), cells)
        if _arb(height) * total > _arb(weights.sum):
            return True
    return False


def _arb(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


class _Function:
    """P of s = t - nh, with its integral from 0 and its first two derivatives."""

    def __init__(self, conditions: Sequence[Vanishing], weights: Weights) -> None:
        self.constant = _arb(weights.sum)
        self.terms: list[tuple[acb, list[acb], acb]] = []
        for c, (real, imaginary) in zip(conditions, weights.vanishing, strict=True):
            omega, zeta = _arb(c.frequency), _arb(c.damping)
            rate = omega * acb(zeta, (1 - zeta * zeta).sqrt())
            # ∫ s^j e^{bs} = e^{bs} Σ_k c_k s^k with c_j = 1/b, c_{k-1} = -k c_k / b
            integral = [acb(0)] * c.power + [1 / rate]
            for k in range(c.power, 0, -1):
                integral[k - 1] = -k * integral[k] / rate
            self.terms.append((rate, integral, acb(_arb(real), -_arb(imaginary))))

    def __call__(self, s: arb, order: int) -> arb:
        """Derivative number `order` of P; -1: its integral."""
        total = self.constant * s if order == -1 else self.constant if order == 0 else arb(0)
        for rate, integral, weight in self.terms:
            polynomial = integral
            for _ in range(order + 1):  # (e^{bs} q)' = e^{bs} (q' + b q)
                risen = [*(k * c for k, c in enumerate(polynomial) if k), acb(0)]
                polynomial = [a + rate * b for a, b in zip(risen, polynomial, strict=True)]
            value = acb(0)
            for c in reversed(polynomial):
                value = value * s + c
            total += (weight * (rate * s).exp() * value).real
        return total

    def least(self, start: arb, low: arb, high: arb, cells: int) -> arb:
        """A lower bound of the integral from `start` to anywhere between `low` and `high`."""
        below, width = None, (high - low) / cells
        for n in range(cells):
            left = low + n * width
            middle, half = left + width / 2, (width / 2).upper()
            value, slope = self(middle, -1), self(middle, 0)
            bend = self(left.union(left + width), 1)
            least = (value - abs(slope) * half + _less(bend.lower() * half * half / 2)).lower()
            below = least if below is None or least < below else below
        assert below is not None
        return below - self(start, -1)


def _less(number: arb) -> arb:
    """The number where it is negative, else 0."""
    return number if not number > 0 else arb(0)
