"""No shaper is as short: a function of the multipliers is proven positive in balls, on all instants that such a shaper could use.

Let positive impulses within [0, T], of sum 1, satisfy `|Σ A_k z_i(t_k)| ≤ V_i` with `z_i(t) = (ω_i(t - T))^j e^{κ_i ω_i (t - T)}`. For any
complex weights y then

    Σ A_k p(t_k) = Re Σ_i y_i* Σ_k A_k z_i(t_k) ≤ Σ |y_i| V_i,     p(t) = Re Σ_i y_i* z_i(t)

so `p > Σ |y_i| V_i` on [0, T] contradicts it. Where negative impulses are allowed that sum to at most N in size, the positive ones sum to
1 more than they, and with p < M on [0, T]

    Σ A_k p(t_k) ≥ min p - N (M - min p)

so `p > (Σ |y_i| V_i + N M)/(1 + N)` contradicts it. Any measure in place of impulses, pulses too, is refuted alike. A shorter shaper leaves
no more when the vibration is measured at T instead of at its own end, for it decays, and conditions with V = 0 (all derivatives below
included) hold at every instant alike: one T refutes all shorter ones.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import comb, perm

import flint
from flint import acb, arb, fmpq

BITS = 128
MOST_CELLS = 20_000
RELATIVE = 1e-16  # of what pulses must contribute: a cell that adds no more is small enough
FIRST_CELLS, ENOUGH = 64, 1e-9  # of a function of order one: a cell that adds no more to a bound is small enough


@dataclass(frozen=True, slots=True)
class Condition:
    """At natural `frequency` [rad/s] and `damping` derivative number `power` is at most `tolerance`; `weight`: (re, im). All exact."""

    frequency: Fraction
    damping: Fraction
    tolerance: Fraction
    power: int
    weight: tuple[Fraction, Fraction]


def none_as_short(
    duration: Fraction,
    conditions: Sequence[Condition],
    negative: Fraction = Fraction(0),
    highest: Fraction = Fraction(0),
    bits: int = BITS,
) -> bool:
    """Whether it is proven that no shaper of at most `duration` [s] meets the conditions; False: not proven.

    Positive shapers, or those whose `negative` amplitudes sum to at most so much in size; p is then below `highest`, which is proven too.
    """
    before, flint.ctx.prec = flint.ctx.prec, max(bits, BITS)
    try:
        if not (_sound(conditions) and negative >= 0):
            return False
        if negative == 0:
            return _positive(_arb(duration), _Function(conditions))
        above = _arb(highest)
        function, mirrored = _Function(conditions), _Function(conditions, sign=-1, offset=-above)
        function.offset = (function.offset + _arb(negative) * above) / (1 + _arb(negative))
        return _positive(_arb(duration), mirrored) and _positive(_arb(duration), function)
    finally:
        flint.ctx.prec = before


def _sound(conditions: Sequence[Condition]) -> bool:
    """A derivative says something at every instant only if it and all below it vanish; a tolerance, if vibration decays."""
    vanishing = {(c.frequency, c.damping, c.power) for c in conditions if c.tolerance == 0}
    return all(
        c.frequency > 0
        and 0 <= c.damping < 1
        and c.tolerance >= 0
        and (c.power == 0 or all((c.frequency, c.damping, below) in vanishing for below in range(c.power + 1)))
        for c in conditions
    )


def _arb(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


class _Function:
    """±p - offset of s = t - T, with its first three derivatives; the offset is Σ |y_i| V_i unless another is given."""

    def __init__(self, conditions: Sequence[Condition], sign: int = 1, offset: arb | None = None) -> None:
        self.terms, self.offset = [], arb(0)
        for c in conditions:
            omega, zeta = _arb(c.frequency), _arb(c.damping)
            weight = acb(_arb(c.weight[0]), -_arb(c.weight[1]))
            self.terms.append((omega, acb(zeta, (1 - zeta * zeta).sqrt()), c.power, sign * weight))
            self.offset += abs(weight) * _arb(c.tolerance)
        self.offset = self.offset if offset is None else offset

    def __call__(self, s: arb, orders: Sequence[int]) -> list[arb]:
        values = [arb(0) for _ in orders]
        for omega, kappa, power, weight in self.terms:
            x = omega * s
            motion = weight * (kappa * x).exp()
            for place, order in enumerate(orders):
                parts = (comb(order, k) * perm(power, k) * x ** (power - k) * kappa ** (order - k) for k in range(min(order, power) + 1))
                values[place] += (motion * sum(parts, acb(0)) * omega**order).real
        if 0 in orders:
            values[list(orders).index(0)] -= self.offset
        return values

    def integral(self, s: arb) -> arb:
        """An antiderivative: `∫ x^j e^{κx} dx = e^{κx} Σ_i (-1)^i j!/(j - i)! x^{j-i}/κ^{i+1}`, x = ωs."""
        total = -self.offset * s
        for omega, kappa, power, weight in self.terms:
            x = omega * s
            parts = ((-1) ** i * perm(power, i) * x ** (power - i) / kappa ** (i + 1) for i in range(power + 1))
            total += (weight * (kappa * x).exp() * sum(parts, acb(0)) / omega).real
        return total


def _positive(duration: arb, function: Callable[[arb, Sequence[int]], list[arb]]) -> bool:
    count = 0
    waiting: list[tuple[float, int, arb, arb]] = [(0.0, 0, -duration.upper(), arb(0))]
    while waiting:
        _, _, low, high = heapq.heappop(waiting)
        middle, half = ((low + high) / 2).mid(), (high - low) / 2
        value, slope, bend = function(middle, (0, 1, 2))
        if not value > 0:
            return False  # not proven here, and halving cells does not change the value at a point
        (third,) = function(low.union(high), (3,))
        if not _least(value, slope, bend - abs(third).upper() * half, half) > 0:
            count += 1
            if count > MOST_CELLS:
                return False
            heapq.heappush(waiting, (float(half.mid()), 2 * count, low, middle))
            heapq.heappush(waiting, (float(half.mid()), 2 * count + 1, middle, high))
    return True


def _least(value: arb, slope: arb, bend: arb, half: arb) -> arb:
    """A lower bound of value + slope x + bend x²/2 on |x| ≤ half."""
    lowest = bend.lower()
    if lowest > 0 and abs(slope) < lowest * half:
        return value - slope * slope / (2 * lowest)
    return value - abs(slope) * half + lowest * half * half / 2 if not lowest > 0 else value - abs(slope) * half


def none_on_samples(interval: Fraction, count: int, conditions: Sequence[Condition], negative: Fraction = Fraction(0)) -> bool:
    """Whether it is proven that no impulses at multiples of `interval` [s], from 0 to `count` of them, meet the conditions.

    Positive ones, or those whose `negative` amplitudes sum to at most so much in size: `(1 + N) min p - N max p > Σ |y_i| V_i` on samples.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        if not (_sound(conditions) and interval > 0 and negative >= 0):
            return False
        values, most = _on_samples(interval, count, conditions), _arb(negative)
        if negative == 0:
            return all(value > 0 for value in values)
        return all((1 + most) * low - most * high > 0 for low in values for high in values)
    finally:
        flint.ctx.prec = before


def none_within_sums_on_samples(interval: Fraction, count: int, conditions: Sequence[Condition], lower: Fraction, upper: Fraction) -> bool:
    """Whether it is proven that no impulses at multiples of `interval`, 0 to `count` of them, of such partial sums meet the conditions.

    `Σ A_k p(t_k) = p(T) - Σ S_k (p(t_{k+1}) - p(t_k))`, at least p(T) less the sum of `max(l Δp, u Δp)`.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        if not (_sound(conditions) and lower <= 0 and upper >= 1 and interval > 0):
            return False
        values = _on_samples(interval, count, conditions)
        least, low, high = values[-1], _arb(lower), _arb(upper)
        for here, after in pairwise(values):
            step = after - here
            least -= (low * step).union(high * step).upper()
        return bool(least > 0)
    finally:
        flint.ctx.prec = before


def _on_samples(interval: Fraction, count: int, conditions: Sequence[Condition]) -> list[arb]:
    """p - Σ |y_i| V_i at the instants, T the last of them."""
    function = _Function(conditions)
    return [function(_arb((k - count) * interval), (0,))[0] for k in range(count + 1)]


def none_within_sums(duration: Fraction, conditions: Sequence[Condition], lower: Fraction, upper: Fraction) -> bool:
    """Whether it is proven that no sequence of partial sums in [lower, upper] of at most `duration` [s] meets the conditions.

    Partial sums S, 0 before and 1 at the end, make `Σ A_k p(t_k) = p(T) - ∫ S p'`, at least `p(T) - ∫ max(l p', u p')`. A shorter sequence
    is one that stays at 1, which lies between the bounds, until T.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        if not (_sound(conditions) and lower <= 0 and upper >= 1 and duration > 0):
            return False
        function = _Function(conditions)
        end, first = function(arb(0), (0,))[0], function(-_arb(duration), (0,))[0]  # p - offset
        rises = _rises(_arb(duration), function)
        if rises is None:
            return False
        falls = rises - (end - first)
        return bool(end - _arb(upper) * rises + _arb(lower) * falls > 0)
    finally:
        flint.ctx.prec = before


def none_of_sums_up_to_one(duration: Fraction, conditions: Sequence[Condition], bits: int = BITS) -> bool:
    """Whether it is proven that no sequence of partial sums of at most 1, of at most `duration` [s], meets the conditions.

    With `p' > 0` on [0, T] partial sums S make `Σ A_k p(t_k) = p(T) - ∫ S p' ≥ p(0)`, so `p(0) > Σ |y_i| V_i` contradicts it. A shorter
    sequence is one that stays at 1 until T.
    """
    before, flint.ctx.prec = flint.ctx.prec, max(bits, BITS)
    try:
        if not (_sound(conditions) and duration > 0):
            return False
        function, whole = _Function(conditions), _arb(duration)
        return bool(function(-whole, (0,))[0] > 0) and _positive(whole, lambda s, orders: function(s, [order + 1 for order in orders]))
    finally:
        flint.ctx.prec = before


def none_of_pulses(
    duration: Fraction, conditions: Sequence[Condition], height: Fraction, level: Fraction = Fraction(1), bits: int = BITS
) -> bool:
    """Whether it is proven that no pulses of at most `height` a [1/s] within at most `duration` [s] meet the conditions.

    Any course 0 ≤ u ≤ a of integral 1 makes `c - Σ |y_i| V_i ≤ ∫ u (c - p) ≤ a ∫ max(c - p, 0)`, c the `level`. What lies within a
    shorter time lies within this one too.
    """
    before, flint.ctx.prec = flint.ctx.prec, max(bits, BITS)
    try:
        if not (_sound(conditions) and duration > 0 and height > 0 and level > 0):
            return False
        function = _Function(conditions)
        room = _arb(level) - function.offset
        if not room > 0:
            return False
        return _is_below(_arb(duration), function, function.integral, room, room / _arb(height))
    finally:
        flint.ctx.prec = before


def none_of_dips(duration: Fraction, conditions: Sequence[Condition], lower: Fraction, bits: int = BITS) -> bool:
    """Whether it is proven that no sequence of partial sums in [lower, 1], of at most `duration` [s], meets the conditions.

    Partial sums S = 1 - x make `Σ A_k p(t_k) = p(0) + ∫ x p' ≥ p(0) - (1 - l) ∫ max(-p', 0)`, which contradicts them where it is more
    than `Σ |y_i| V_i`. A shorter sequence is one that stays at 1 until T.
    """
    before, flint.ctx.prec = flint.ctx.prec, max(bits, BITS)
    try:
        if not (_sound(conditions) and duration > 0 and lower <= 0):
            return False
        function, whole, depth = _Function(conditions), _arb(duration), 1 - _arb(lower)
        first = function(-whole, (0,))[0]
        if not first > 0:
            return False
        return _is_below(
            whole,
            lambda s, orders: function(s, [order + 1 for order in orders]),
            lambda s: function(s, (0,))[0],
            arb(0),
            first / depth,
        )
    finally:
        flint.ctx.prec = before


def _is_below(
    duration: arb, function: Callable[[arb, Sequence[int]], list[arb]], integral: Callable[[arb], arb], room: arb, limit: arb
) -> bool:
    """Whether `∫ max(room - q, 0)` on [-duration, 0] is below `limit`, q the function: cells of untold sign count for their most."""
    enough = limit.lower() * RELATIVE
    total, width = arb(0), duration / FIRST_CELLS
    waiting = [(-duration + k * width, -duration + (k + 1) * width) for k in range(FIRST_CELLS)]
    count = 0
    while waiting and total < limit:
        low, high = waiting.pop()
        count += 1
        if count > MOST_CELLS:
            return False
        middle, half = ((low + high) / 2).mid(), ((high - low) / 2).upper()
        value, slope, bend = function(middle, (0, 1, 2))
        third = abs(function(low.union(high), (3,))[0]).upper() * half
        if _least(value - room, slope, bend - third, half) >= 0:
            continue
        least_missing = _least(room - value, -slope, -bend - third, half)
        if least_missing > 0:
            total += room * (high - low) - (integral(high) - integral(low))
            continue
        most = 2 * half * (room - _least(value, slope, bend - third, half)).upper()
        if most < enough:
            total += most.max(arb(0))
        else:
            waiting += [(low, middle), (middle, high)]
    return bool(total < limit)


def _rises(duration: arb, function: _Function) -> arb | None:
    """An upper bound of `∫ max(p', 0)` on [-duration, 0]: where a cell's sign is not told, its width times the largest slope."""
    total, width = arb(0), duration / FIRST_CELLS
    waiting = [(-duration + k * width, -duration + (k + 1) * width) for k in range(FIRST_CELLS)]
    count = 0
    while waiting:
        low, high = waiting.pop()
        count += 1
        if count > MOST_CELLS:
            return None
        middle, half = ((low + high) / 2).mid(), ((high - low) / 2).upper()
        slope = function(middle, (1,))[0] + arb(0, (abs(function(low.union(high), (2,))[0]).upper() * half).upper())
        if slope > 0:
            total += function(high, (0,))[0] - function(low, (0,))[0]
        elif not slope < 0:
            most = 2 * half * slope.upper()  # above 0, or the sign would be told
            if most < ENOUGH:
                total += most
            else:
                waiting += [(low, middle), (middle, high)]
    return total
