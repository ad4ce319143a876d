"""Shapers in closed form: sequences of impulses that leave one mode at rest (Singer and Seering; docs/theory.md, section 5).

An impulse A at t leaves the mode with the phasor `A e^{κωt}`, κ = ζ + j√(1 - ζ²); the sum of all phasors is what is left.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import ShaperError
from relaxations.shaping.amplitudes import LEAST, decay_per_radian, named, smallest_of_derivatives, too_small
from relaxations.shaping.continuation import continued
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

SPAN = 0.75  # of half a damped period is the spacing of mzv's three impulses
MOST_NEGATIVE = 1e4  # what rounding leaves is then 1e-12


def derivative_shaper(mode: Mode, derivatives: int = 0) -> Shaper:
    """ZV (0), ZVD (1), ZVDD (2) …: residual vibration and so many derivatives of it are zero at the mode.

    Amplitudes `C(n, k) K^k / (1 + K)^n`, n = derivatives + 1, at k half damped periods: n ZV shapers in a row. The residual is analytic in
    the pole, so derivatives by frequency and by damping vanish together. Raises `ShaperError` for a negative number, and where the last
    amplitude is none that doubles hold.
    """
    if derivatives < 0:
        raise ShaperError(f"derivatives are counted from 0 (zv) on, not {derivatives}")
    n, decay, half = derivatives + 1, mode.decay, mode.half_period
    if n > 1000:
        raise ShaperError(f"{derivatives} derivatives: more than 999 are more than doubles can hold")
    if smallest_of_derivatives(mode.damping, derivatives) < LEAST:
        raise ShaperError(too_small(named(derivatives), mode.damping, lambda damping: smallest_of_derivatives(damping, derivatives)))
    whole = (1.0 + decay) ** n
    return Shaper(tuple(k * half for k in range(n + 1)), tuple(math.comb(n, k) * decay**k / whole for k in range(n + 1)))


def mzv(mode: Mode) -> Shaper:
    """Three impulses at 0, 3/8 and 3/4 of the damped period with zero vibration: between ZV and ZVD in duration and robustness.

    Equally spaced impulses `(1, -2 Re q, |q|²)/(1 - 2 Re q + |q|²)`, q = e^{-κω·3P/8}, have their only zeros at the mode. This holds at any
    damping, as far as doubles hold the last amplitude; beyond that raises `ShaperError`.
    """
    require_mzv(mode)
    return equally_spaced(mode, SPAN * mode.half_period)


def require_mzv(mode: Mode) -> None:
    """Raises `ShaperError` where doubles do not hold the last amplitude."""
    if smallest_of_mzv(mode.damping) < LEAST:
        raise ShaperError(too_small("mzv", mode.damping, smallest_of_mzv))


def smallest_of_mzv(damping: float) -> float:
    """Decimal logarithm of the last amplitude, |q|²/(1 - 2 Re q + |q|²), q = e^{3π(r + j)/4}⁻¹."""
    folds = SPAN * math.pi * decay_per_radian(damping)
    size = math.exp(-folds)
    return (-2.0 * folds - math.log1p(math.sqrt(2.0) * size + size * size)) / math.log(10.0)


def equally_spaced(mode: Mode, spacing: float) -> Shaper:
    """Three impulses, `spacing` [s] apart, with zero vibration: as close as one likes, at the price of negative amplitudes.

    On a controller's sample grid (`spacing` a multiple of the sample time) it is exact. Raises `ShaperError` at whole damped periods, where
    impulses cannot cancel.
    """
    turn = mode.pole * spacing
    size, cosine = math.exp(turn.real), math.cos(turn.imag)
    middle, last = -2.0 * size * cosine, size * size
    total = 1.0 + middle + last
    if not spacing > 0.0 or total <= 1e-12:
        raise ShaperError(f"impulses {spacing!r} s apart act on the mode in the same phase; half a damped period is {mode.half_period!r} s")
    return Shaper((0.0, spacing, 2.0 * spacing), (1.0 / total, middle / total, last / total))


def negative_zv(mode: Mode, negative: float) -> Shaper:
    """The shortest of three impulses A, -b, 1 + b - A with zero vibration, b = `negative` > 0 specified.

    Undamped `A = (1 + b)/2` and `cos φ = b/(1 + b)` for the spacing φ/ω; b = 1 is then the unity-magnitude shaper 1, -1, 1. With damping
    the duration is least where `(1 - e^{κφ_3}) / (κ e^{κφ_2})` is real, φ_i = ωt_i. Raises `ShaperError` unless b > 0.
    """
    if not 0.0 < negative < math.inf:
        raise ShaperError(f"the specified negative amplitude is given as a positive number, not {negative!r}")
    if negative > MOST_NEGATIVE:
        raise ShaperError(
            f"a negative amplitude of {negative!r} is more than {MOST_NEGATIVE:g}: impulses of that size, rounded to doubles, leave more "
            "of the mode than nothing; 1 already takes but two thirds of the duration of zv"
        )

    def system(x: Reals, damping: float) -> Reals:
        first, second, third = x
        direction = complex(damping, math.sqrt(1.0 - damping**2))
        middle, last = np.exp(direction * second), np.exp(direction * third)
        closed = first - negative * middle + (1.0 + negative - first) * last
        return np.array([closed.real, closed.imag, ((1.0 - last) / (direction * middle)).imag])

    spacing = math.acos(negative / (1.0 + negative))
    first, second, third = map(float, continued(system, np.array([(1.0 + negative) / 2.0, spacing, 2.0 * spacing]), mode.damping))
    return Shaper((0.0, second / mode.frequency, third / mode.frequency), (first, -negative, 1.0 + negative - first))
