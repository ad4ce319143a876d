"""One flexible mode and one delay: filters in closed form, with the branch that the published arctangents leave open.

With p = -ζω + jω√(1-ζ²) and N(s) the monic product over the zeros, `A + e^{-sT}/N(s) = 0` at p reads, in phasors,

    A = |e^{-pT}| / |N(p)| > 0,     ω_d T = π - arg N(p)  (mod 2π)

so that T is the least positive instant for which sine and cosine have the right sign: (7), (8), (10), (11), (34) to (38), (44), (45) of
Singh (J. Dynamic Systems, Measurement, and Control 134, 2012, 011015) in one. All gains are scaled so that a plant of gain
`G_p(0) = N(0)/|p|²` takes its output to the reference.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.prefilters import Prefilter
from relaxations.errors import ShaperError
from relaxations.plants import LinearPlant
from relaxations.shaping.modes import Mode

SINGULAR = 1e-12  # of the gains' size: a static gain that small is 0


def pole_last(mode: Mode, zeros: Sequence[complex]) -> Prefilter:
    """`A + B e^{-sT}/N(s)` (4), (32), (43): any number of zeros [1/s] left of the axis, real or in conjugate pairs, repeated or not."""
    conditions = _conditions(mode, zeros)
    p = mode.pole
    at = _value(conditions, p)
    delay = _least(math.pi - cmath.phase(at), p.imag)
    step = math.exp(-p.real * delay) / abs(at)
    return _scaled(conditions, delay, (step, 0.0), 1.0, delay)


def pole_first(mode: Mode, zeros: Sequence[complex], positive: bool = False) -> Prefilter:
    """`B/N(s) + A e^{-sT}` (17): `B = -A N(p) e^{-pT}`.

    With (24) the gains differ in sign and `ω_d T = arg N(p)` (mod 2π), the shorter one; `positive`: they do not, and it is π more.
    """
    conditions = _conditions(mode, zeros)
    p = mode.pole
    at = _value(conditions, p)
    delay = _least(cmath.phase(at) + (math.pi if positive else 0.0), p.imag)
    block = abs(at) * math.exp(-p.real * delay) * (1.0 if positive else -1.0)
    return _scaled(conditions, delay, (0.0, 1.0), block, 0.0)


def step_and_pole_last(mode: Mode, zeros: Sequence[complex], delay: float) -> Prefilter:
    """`A_1 + (A_2 + B/N(s)) e^{-sT}` (27) for a given delay T [s], such as a multiple of a sample time.

    Raises `ShaperError` where it is singular: T a multiple of π/ω_d (29), or a static gain (30) of 0.
    """
    if not 0.0 < delay < math.inf:
        raise ShaperError(f"a delay is positive and finite, not {delay!r} s")
    conditions = _conditions(mode, zeros)
    p = mode.pole
    turned, at = cmath.exp(-p * delay), _value(conditions, p)
    if abs(turned.imag) <= SINGULAR * abs(turned):
        raise ShaperError(f"T = {delay!r} s is a multiple of half the mode's damped period: steps alone cancel it there, or nothing does")
    second = -(turned / at).imag / turned.imag
    first = -(second * turned + turned / at).real
    return _scaled(conditions, delay, (first, second), 1.0, delay)


def _conditions(mode: Mode, zeros: Sequence[complex]) -> Conditions:
    pole, values = mode.pole, [complex(zero) for zero in zeros]
    if len(values) > 2:
        raise ShaperError(f"one mode has at most two zeros, not {len(values)}")
    roots = [[z.real, z.imag] for z in values], [[pole.real, pole.imag], [pole.real, -pole.imag]]
    return Conditions.of(LinearPlant.from_zeros_poles(*roots, 1), zeros=values)


def _value(conditions: Conditions, at: complex) -> complex:
    factors = [
        (at - zero.value) * (at - zero.value.conjugate()) if zero.is_flexible else at - zero.value
        for zero in conditions.zeros
        for _ in range(zero.multiplicity)
    ]
    return complex(np.prod(factors)) if factors else 1 + 0j


def _least(phase: float, frequency: float) -> float:
    """The least positive T with `frequency T = phase` (mod 2π)."""
    turned = math.fmod(phase, 2.0 * math.pi)
    return (turned if turned > 0.0 else turned + 2.0 * math.pi) / frequency


def _scaled(conditions: Conditions, delay: float, gains: tuple[float, float], block: float, start: float) -> Prefilter:
    if conditions.order:
        plain = Prefilter((0.0, delay), gains, conditions.terms(0, block, start))
    else:  # without zeros the term with the pole is a step
        plain = Prefilter((0.0, delay), (gains[0] + block * (start == 0.0), gains[1] + block * (start > 0.0)))
    if abs(plain.gain) <= SINGULAR * (math.fsum(map(abs, gains)) + abs(block)):
        raise ShaperError(f"the filter's static gain is 0 at T = {delay!r} s: the plant would not leave its rest")
    return plain.scaled(conditions.target / plain.gain)
