"""The worst residual over a box: enclosed, attained where it says, and wrong claims are not made."""

from __future__ import annotations

import math
from fractions import Fraction

import flint
import numpy as np
import pytest

from relaxations.checking import worst
from relaxations.checking.worst import worst_residual
from relaxations.shaping.sensitivity import residual


def exact(numbers) -> list[Fraction]:
    return [Fraction(float(x)) for x in numbers]


def test_random_sequences_never_exceed_their_enclosure_and_attain_it():
    chance = np.random.default_rng(4)
    for _ in range(12):
        count = int(chance.integers(1, 6))
        times = np.concatenate([[0.0], np.cumsum(chance.uniform(0.05, 1.0, count))])
        amplitudes = chance.normal(size=count + 1)
        low, least = chance.uniform(0.5, 4.0), chance.uniform(0.0, 0.5)
        high, most = low + chance.uniform(0.0, 2.0), least + chance.uniform(0.0, 0.3)
        found = worst_residual(exact(times), exact(amplitudes), (Fraction(low), Fraction(high)), (Fraction(least), Fraction(most)))
        sampled = max(
            float(residual(times, amplitudes, np.linspace(low, high, 201), damping).max()) for damping in np.linspace(least, most, 41)
        )
        assert sampled <= found.upper * (1 + 1e-12)  # the sample's own rounding
        assert found.upper - found.lower <= 1.01e-6 * found.upper
        assert low <= found.frequency <= high
        assert least <= found.damping <= most
        there = float(residual(times, amplitudes, found.frequency, found.damping)[0])
        assert there == pytest.approx(found.lower, rel=1e-9)


def test_a_box_that_is_a_point_and_a_residual_that_vanishes():
    one = Fraction(1)
    found = worst_residual([Fraction(0), Fraction(1, 2)], [Fraction(1, 2)] * 2, (one, one), (Fraction(0), Fraction(0)))
    assert found.lower <= np.cos(0.25) <= found.upper
    nothing = worst_residual([Fraction(0)], [Fraction(0)], (one, 2 * one), (Fraction(0), Fraction(1, 10)))
    assert nothing.lower == 0.0 <= nothing.upper <= 1e-9


def test_few_cells_tell_less_but_nothing_wrong_and_the_precision_is_put_back(monkeypatch: pytest.MonkeyPatch):
    box = (Fraction(2), Fraction(4)), (Fraction(0), Fraction(1, 5))
    close = worst_residual(exact([0, 1, 2]), exact([0.25, 0.5, 0.25]), *box)
    monkeypatch.setattr(worst, "MOST_CELLS", 5)
    before = flint.ctx.prec
    rough = worst_residual(exact([0, 1, 2]), exact([0.25, 0.5, 0.25]), *box)
    assert rough.lower <= close.lower <= close.upper <= rough.upper
    assert rough.upper > close.upper * (1 + 1e-3)
    assert flint.ctx.prec == before


def test_a_band_that_is_wide_is_enclosed_for_pulses_too():
    """Powers of the frequency over a wide ball must not reach 0."""
    times, jumps = [Fraction(x) for x in (0, 1, 2, 3)], [Fraction(x) for x in (1, -1, 1, -1)]
    for order in (1, 2, 3):
        found = worst_residual(times, jumps, (Fraction(1, 5), Fraction(9, 5)), (Fraction(1, 20), Fraction(1, 20)), order=order)
        at = np.linspace(0.2, 1.8, 4001)
        direction = complex(0.05, math.sqrt(1 - 0.05**2))
        sampled = np.abs(np.exp(direction * np.multiply.outer(at, np.arange(4) - 3)) @ [1, -1, 1, -1]) / at**order
        assert found.upper >= sampled.max() * (1 - 1e-12)
        assert found.lower <= sampled.max() * (1 + 1e-5)
        assert found.upper == pytest.approx(found.lower, rel=1e-5)


def test_sides_hold_where_squares_are_no_doubles():
    """Beyond 1e154 a square overflows and below 1e-154 it is none: scaled by a power of two, both sides are scaled, to a double or so."""
    times, amplitudes = exact([0.0, 0.4, 1.1, 1.3]), exact([1.0, -1.5, 0.75, 0.75])
    box = (Fraction(2), Fraction(3)), (Fraction(1, 5), Fraction(1, 5))
    found = worst_residual(times, amplitudes, *box, relative=1e-3, absolute=0.0)
    for power in (-1000, -600, 600, 1000):
        scaled = worst_residual(times, [a * Fraction(2) ** power for a in amplitudes], *box, relative=1e-3, absolute=0.0)
        assert 0.0 < scaled.lower <= scaled.upper
        assert (scaled.lower * 2.0**-power, scaled.upper * 2.0**-power) == pytest.approx((found.lower, found.upper), rel=1e-15)
    beyond = worst_residual(times, [a * Fraction(2) ** 1024 for a in amplitudes], *box)
    assert beyond.lower <= beyond.upper == math.inf


def test_both_sides_are_rounded_outward():
    """A third is no double; the residual of one impulse is its amplitude."""
    point = (Fraction(1), Fraction(1)), (Fraction(0), Fraction(0))
    for amplitude in (Fraction(1, 3), Fraction(2, 3), Fraction(1, 7), Fraction(1, 10)):
        found = worst_residual([Fraction(0)], [amplitude], *point, relative=1e-15, absolute=0.0)
        assert Fraction(found.lower) < amplitude < Fraction(found.upper)
