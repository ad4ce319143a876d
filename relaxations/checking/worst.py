"""The worst residual vibration of impulses over a box of a mode's frequency and damping, enclosed by branch and bound in balls.

`F(ω, ζ) = Σ A_i e^{κω(t_i - t_n)}`, κ = ζ + j√(1 - ζ²). On a cell with centre c and half widths r,

    |F|² ≤ |F(c)|² + |∂_ω|F|²| r_ω + |∂_ζ|F|²| r_ζ,     ∂|F|² = 2 Re(F* ∂F) enclosed on the whole cell

and |F(c)| is a value that is taken. Cells that could hold the maximum are halved until both agree (docs/theory.md, section 6).
Of many impulses nearly everything is taken away by the others, which balls of wide arguments do not see: there F is expanded in p = κω.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import factorial

import flint
from flint import acb, arb, fmpq

BITS = 96
FEW, TERMS = 4, 12  # impulses that are summed as they are; terms of the series for more
MOST_CELLS = 200_000  # about ten seconds for three impulses


@dataclass(frozen=True, slots=True)
class Worst:
    """The largest residual lies in [lower, upper]; it is at least `lower` at natural `frequency` [rad/s] and `damping`."""

    lower: float
    upper: float
    frequency: float
    damping: float
    cells: int


def worst_residual(
    times: Sequence[Fraction],
    amplitudes: Sequence[Fraction],
    frequency: tuple[Fraction, Fraction],
    damping: tuple[Fraction, Fraction],
    relative: float = 1e-6,
    absolute: float = 1e-9,
    order: int = 0,
) -> Worst:
    """Enclose `max |F| / ω^order` over natural frequencies [rad/s] and damping ratios, exact numbers all, to `relative` or `absolute`.

    Of impulses the order is 0, of pulses 1: the amplitudes are then the jumps at their edges.

    What takes more than `MOST_CELLS` cells is enclosed as closely as they tell.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        return _enclosed(_Impulses(times, amplitudes, order), (*map(_arb, frequency),), (*map(_arb, damping),), relative, absolute)
    finally:
        flint.ctx.prec = before


def _arb(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


class _Impulses:
    def __init__(self, times: Sequence[Fraction], amplitudes: Sequence[Fraction], order: int) -> None:
        self.order = order
        self.pairs = [(_arb(t - times[-1]), _arb(a)) for t, a in zip(times, amplitudes, strict=True)]

    def _on_disc(self, pole: acb) -> tuple[acb, acb]:
        """`F = Σ A_i e^{p s_i}` and F' by p = κω on a disc about the ball `pole`: by Taylor's series about its centre.

        What impulses take from each other stays taken in the coefficients; the rest of the series is at most that of e^x.
        """
        centre = pole.mid()
        reach = abs(pole - centre).upper()
        coefficients = [acb(0)] * TERMS
        rest = rest_of_slope = arb(0)
        for since, amplitude in self.pairs:
            term = amplitude * (centre * since).exp()
            far = abs(since) * reach
            last = abs(term) * far.exp() * far ** (TERMS - 1)
            rest += last * far / factorial(TERMS)
            rest_of_slope += last * abs(since) / factorial(TERMS - 1)
            for k in range(TERMS):
                coefficients[k] += term
                term = term * since / (k + 1)
        sizes = [abs(c) for c in coefficients]
        around = sum((sizes[k] * reach**k for k in range(1, TERMS)), rest)
        turned = sum((k * sizes[k] * reach ** (k - 1) for k in range(2, TERMS)), rest_of_slope)
        return _widened(coefficients[0], around), _widened(coefficients[1], turned)

    def square(self, omega: arb, zeta: arb) -> tuple[arb, arb, arb]:
        """|F|²/ω^(2 order) and its derivatives by ω and ζ."""
        root = (1 - zeta * zeta).sqrt()
        direction, turning = acb(zeta, root), acb(1, -zeta / root)
        if len(self.pairs) > FEW:
            value, by_pole = self._on_disc(direction * omega)
            by_omega, by_zeta = by_pole * direction, by_pole * turning * omega
        else:
            value = by_omega = by_zeta = acb(0)
            for since, amplitude in self.pairs:
                motion = amplitude * (direction * omega * since).exp()
                value += motion
                by_omega += motion * direction * since
                by_zeta += motion * turning * omega * since
        mirrored = value.conjugate()
        size = value.real * value.real + value.imag * value.imag
        slope, rise = 2 * (mirrored * by_omega).real, 2 * (mirrored * by_zeta).real
        if self.order:
            # Powers of a wide ball may reach 0; those of its ends do not.
            scale = (omega.lower() ** (2 * self.order)).union(omega.upper() ** (2 * self.order))
            return size / scale, (slope - 2 * self.order * size / omega) / scale, rise / scale
        return size, slope, rise


def _widened(value: acb, by: arb) -> acb:
    margin = arb(0, by.upper())
    return acb(value.real + margin, value.imag + margin)


def _enclosed(impulses: _Impulses, frequency: tuple[arb, ...], damping: tuple[arb, ...], relative: float, absolute: float) -> Worst:
    best, where, count = arb(0), (frequency[0].mid(), damping[0].mid()), 0
    # A ball of each end's own width is part of the box: the ends of an interval of decimals are no dyadic numbers.
    first = (frequency[0].lower(), frequency[1].upper(), damping[0].lower(), damping[1].upper())
    waiting: list[tuple[float, int, tuple[arb, ...]]] = []

    def add(cell: tuple[arb, ...]) -> None:
        nonlocal best, where, count
        low, high, least, most = cell
        omega, zeta = ((low + high) / 2).mid(), ((least + most) / 2).mid()
        across, up = (high - low) / 2, (most - least) / 2
        size, _, _ = impulses.square(omega, zeta)
        _, slope, rise = impulses.square(low.union(high), least.union(most))
        if size.lower() > best:
            best, where = size.lower(), (omega, zeta)
        above = (size + abs(slope) * across + abs(rise) * up).upper().sqrt()
        count += 1
        heapq.heappush(waiting, (-above_as_double(above.upper()), count, (*cell, abs(slope).upper() * across, abs(rise).upper() * up)))

    add(first)
    while True:
        above, bottom = arb(-waiting[0][0]), best.sqrt().lower()
        if above - bottom <= relative * above or above <= absolute or count > MOST_CELLS:
            return Worst(below_as_double(bottom), -waiting[0][0], float(where[0]), float(where[1]), count)
        low, high, least, most, across, up = heapq.heappop(waiting)[2]
        if across >= up:
            middle = ((low + high) / 2).mid()
            add((low, middle, least, most))
            add((middle, high, least, most))
        else:
            middle = ((least + most) / 2).mid()
            add((low, high, least, middle))
            add((low, high, middle, most))


def above_as_double(number: arb) -> float:
    """The least double that is not below."""
    value = float(number)
    return value if arb(value) >= number else math.nextafter(value, math.inf)


def below_as_double(number: arb) -> float:
    """The largest double that is not above."""
    value = float(number)
    return value if arb(value) <= number else math.nextafter(value, -math.inf)
