"""Sensitivity curves of impulse sequences against the published insensitivities, recomputed to ten digits."""

from __future__ import annotations

import itertools
from math import comb, exp, pi, sqrt

import numpy as np
import pytest

from relaxations.shaping.sensitivity import insensitivity, residual

DIGITS = 5e-11  # half a unit of the tenth decimal


def derivative_shaper(zeros: int, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """ZV, ZVD, ZVDD, …: binomial amplitudes at half damped periods of a mode with ω = 1."""
    ratio = exp(-damping * pi / sqrt(1 - damping**2))
    amplitudes = np.array([comb(zeros, k) * ratio**k for k in range(zeros + 1)])
    return np.arange(zeros + 1) * pi / sqrt(1 - damping**2), amplitudes / amplitudes.sum()


@pytest.mark.parametrize(("zeros", "width"), [(1, 0.0636885329), (2, 0.2871325863), (3, 0.4803815347)])
def test_insensitivities_of_derivative_shapers(zeros: int, width: float):
    assert insensitivity(*derivative_shaper(zeros), 1.0, 0.0, 0.05) == pytest.approx(width, abs=DIGITS)


def test_insensitivity_of_the_extra_insensitive_shaper():
    V = 0.05
    amplitudes = [(1 + V) / 4, (1 - V) / 2, (1 + V) / 4]
    times = [0.0, pi, 2 * pi]
    assert residual(times, amplitudes, 1.0, 0.0)[0] == pytest.approx(V, abs=1e-15)
    assert insensitivity(times, amplitudes, 1.0, 0.0, V) == pytest.approx(0.3994507513, abs=DIGITS)


def test_insensitivity_of_a_fuel_limited_bang_bang_command():
    # Two-mass spring, Δ = 5, fuel 4, antisymmetric; impulses in units of the step amplitude. The paper gives 0.107.
    half = [0.0, 0.8169711992, 1.7558594103, 2.9388882111]
    times = half + [8.1107317945 - t for t in reversed(half)]
    amplitudes = [1, -1, 1, -1, -1, 1, -1, 1]
    assert residual(times, amplitudes, sqrt(2), 0.0)[0] < 1e-9  # the switch times have ten digits
    assert insensitivity(times, amplitudes, sqrt(2), 0.0, 0.05) == pytest.approx(0.10653, abs=5e-6)  # five digits given


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("zeros", [1, 2, 3, 5])
def test_a_shaper_leaves_nothing_at_its_mode_to_the_order_of_its_zeros(zeros: int, damping: float):
    times, amplitudes = derivative_shaper(zeros, damping)
    assert residual(times, amplitudes, 1.0, damping)[0] < 1e-15
    # V ~ |ω - 1|^zeros: halving the distance divides by 2^zeros, up to a relative error of the order of the distance.
    near, far = residual(times, amplitudes, [1.005, 1.01], damping)
    assert far / near == pytest.approx(2.0**zeros, rel=0.02)


def test_the_undamped_zv_shaper_has_the_textbook_curve():
    times, amplitudes = derivative_shaper(1)
    relative = np.linspace(0.1, 3.0, 50)
    np.testing.assert_allclose(residual(times, amplitudes, relative, 0.0), np.abs(np.cos(relative * pi / 2)), atol=1e-15)


def test_one_impulse_leaves_everything():
    np.testing.assert_allclose(residual([2.0], [1.0], [0.5, 1.0, 7.0], 0.1), 1.0)
    assert insensitivity([2.0], [1.0], 1.0, 0.0, 0.05) == 0.0


def test_units_of_time_do_not_matter():
    times, amplitudes = derivative_shaper(2, 0.1)
    widths = [insensitivity(times * unit, amplitudes, 1.0 / unit, 0.1, 0.05) for unit in (1e-6, 1.0, 1e6)]
    np.testing.assert_allclose(widths, widths[1], rtol=1e-10)


def test_the_interval_is_the_connected_one_around_the_mode():
    times, amplitudes = derivative_shaper(1)
    # At three times the frequency the ZV shaper works again, but that is another interval.
    assert residual(times, amplitudes, 3.0, 0.0)[0] < 1e-15
    assert insensitivity(times, amplitudes, 1.0, 0.0, 0.05) < 0.1


def test_a_looser_level_never_narrows_the_interval():
    times, amplitudes = derivative_shaper(2)
    widths = [insensitivity(times, amplitudes, 1.0, 0.0, level) for level in np.linspace(0.01, 0.9, 30)]
    assert all(a < b for a, b in itertools.pairwise(widths))
