"""How far a shaped step takes a mode from it, enclosed at every instant: between the shaper's instants the deflection is a closed form.

With the mode's response y to the shaped unit step u the deflection e = y - u is, between two instants at which u jumps (or its slope does),

    e(t) = c + Re(C e^{p (t - t_k)}),     p = -ζω + jω_d

where c = 0 for impulses and -2ζ/ω times the slope for pulses. |e| is largest at an end of the interval or at one of the first two instants
at which e' = Re(C p e^{pτ}) = 0: later extrema of the decaying part are smaller. After the last instant the same holds for ever.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import flint
from flint import acb, arb, fmpq

from relaxations.checking.worst import above_as_double, below_as_double

BITS = 128


@dataclass(frozen=True, slots=True)
class Deflection:
    """The largest |y - u| lies in [lower, upper], as a fraction of what an unshaped step of the same size deflects without damping."""

    lower: float
    upper: float


def largest_deflection(
    times: Sequence[Fraction], amplitudes: Sequence[Fraction], frequency: Fraction, damping: Fraction, order: int = 0
) -> Deflection:
    """Enclose `max |y - u|` over all instants, for impulses (order 0) or jumps at the edges of pulses (order 1); exact numbers all."""
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        return _enclosed([_arb(t) for t in times], [_arb(a) for a in amplitudes], _arb(frequency), _arb(damping), order)
    finally:
        flint.ctx.prec = before


def _arb(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


def _enclosed(times: list[arb], amplitudes: list[arb], omega: arb, zeta: arb, order: int) -> Deflection:
    root = (1 - zeta * zeta).sqrt()
    sigma, turning = zeta * omega, omega * root
    # What one jump brings: e = -1, e' = 0 just after an impulse; e = 0, e' = -1 where a slope of 1 begins.
    if order == 0:
        steady, start = arb(0), acb(-1, zeta / root)
    else:
        steady = -2 * zeta / omega
        start = acb(-steady, (1 - 2 * zeta * zeta) / turning)
    lower, upper = arb(0), arb(0)
    level, phasor, last = arb(0), acb(0), times[0]
    for k, (time, jump) in enumerate(zip(times, amplitudes, strict=True)):
        phasor *= acb(-sigma * (time - last), turning * (time - last)).exp()
        level, phasor, last = level + jump * steady, phasor + jump * start, time
        length = times[k + 1] - time if k + 1 < len(times) else None
        least, most = _piece(level, phasor, sigma, turning, root, length)
        lower, upper = _larger(lower, least), _larger(upper, most)
    return Deflection(below_as_double(lower), above_as_double(upper))


def _piece(level: arb, phasor: acb, sigma: arb, turning: arb, root: arb, length: arb | None) -> tuple[arb, arb]:
    """Bounds of the largest |level + Re(phasor e^{pτ})| over 0 ≤ τ ≤ length (None: for ever)."""

    def value(since: arb) -> arb:
        return abs(level + (phasor * acb(-sigma * since, turning * since).exp()).real)

    ends = [abs(level + phasor.real), abs(level) if length is None else value(length)]
    least, most = _larger(ends[0].lower(), ends[1].lower() if length is not None else arb(0)), _larger(ends[0].upper(), ends[1].upper())
    slope = phasor * acb(-sigma, turning)
    # Re(slope e^{jθ}) = 0 at θ = π/2 - arg(slope) + kπ; where the argument cannot be told, any θ may be one.
    known = not bool(abs(slope).contains(arb(0)))
    if known and slope.real < 0 and slope.imag.contains(arb(0)):
        known, slope = True, -slope  # the half turn changes k alone, and keeps the argument off its cut
    angle = (arb.pi() / 2 - slope.arg()) if known else arb(0)
    shift = math.floor(float(angle.mid()) / math.pi)
    for k in range(-1, 3):
        if not known:
            most = _larger(most, (abs(level) + abs(phasor)).upper())
            break
        since = (angle + (k - shift) * arb.pi()) / turning
        if since < 0 or (length is not None and since > length):
            continue
        at = value(since)
        most = _larger(most, at.upper())
        if since > 0 and (length is None or since < length):
            least = _larger(least, at.lower())
    return least, most


def _larger(one: arb, other: arb) -> arb:
    return other if other > one else one
