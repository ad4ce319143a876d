"""Shapers in closed form against known answers, and against the residual's own definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from marks import slow

from relaxations.bounds import Status
from relaxations.errors import ShaperError
from relaxations.shaping.bounded import bounded
from relaxations.shaping.humps import extra_insensitive, unity_magnitude
from relaxations.shaping.impulses import derivative_shaper, equally_spaced, mzv, negative_zv
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import insensitivity, residual
from relaxations.shaping.shapers import Shaper

DAMPINGS = (0.0, 0.02, 0.1, 0.3, 0.7)
ROUNDING = 1e-12  # of numbers of order one, computed in closed form


def left(shaper: Shaper, mode: Mode, relative: float = 1.0) -> float:
    return float(residual(shaper.times, shaper.amplitudes, relative * mode.frequency, mode.damping)[0])


@pytest.mark.parametrize("damping", DAMPINGS)
def test_zv_zvd_zvdd_are_the_binomials(damping: float):
    mode = Mode(3.0, damping)
    decay, half = math.exp(-damping * math.pi / math.sqrt(1 - damping**2)), math.pi / (3.0 * math.sqrt(1 - damping**2))
    known = {0: [1, decay], 1: [1, 2 * decay, decay**2], 2: [1, 3 * decay, 3 * decay**2, decay**3]}
    for derivatives, weights in known.items():
        found = derivative_shaper(mode, derivatives)
        assert found.amplitudes == pytest.approx(np.array(weights) / sum(weights), abs=ROUNDING)
        assert found.times == pytest.approx(half * np.arange(derivatives + 2), abs=ROUNDING)


@pytest.mark.parametrize("derivatives", range(5))
@pytest.mark.parametrize("damping", DAMPINGS)
def test_as_many_derivatives_vanish_as_were_asked_for(derivatives: int, damping: float):
    mode = Mode(2.0, damping)
    shaper = derivative_shaper(mode, derivatives)
    t, a = np.array(shaper.times), np.array(shaper.amplitudes)
    for order in range(derivatives + 1):
        terms = a * t**order * np.exp(mode.frequency * mode.direction * (t - t[-1]))
        assert abs(terms.sum()) <= ROUNDING * np.abs(terms).sum()
    one_more = a * t ** (derivatives + 1) * np.exp(mode.frequency * mode.direction * (t - t[-1]))
    assert abs(one_more.sum()) > 1e-6 * np.abs(one_more).sum()


def test_the_undamped_facts():
    mode = Mode(2 * math.pi)
    ei = extra_insensitive(mode, 0.05).shaper
    assert ei.times == pytest.approx([0.0, 0.5, 1.0], abs=ROUNDING)
    assert ei.amplitudes == pytest.approx([1.05 / 4, 0.95 / 2, 1.05 / 4], abs=ROUNDING)
    widths = {
        "zv": (derivative_shaper(mode), 0.0636885329),
        "zvd": (derivative_shaper(mode, 1), 0.2871325863),
        "zvdd": (derivative_shaper(mode, 2), 0.4803815347),
        "ei": (ei, 0.3994507513),
    }
    for name, (shaper, width) in widths.items():
        assert insensitivity(shaper.times, shaper.amplitudes, mode.frequency, 0.0, 0.05) == pytest.approx(width, abs=5e-11), name
    unity = negative_zv(mode, 1.0)
    assert unity.times == pytest.approx([0.0, 1 / 6, 1 / 3], abs=ROUNDING)
    assert unity.amplitudes == pytest.approx([1.0, -1.0, 1.0], abs=ROUNDING)


@pytest.mark.parametrize("damping", DAMPINGS)
def test_mzv_and_equally_spaced_impulses_leave_nothing(damping: float):
    mode = Mode(5.0, damping)
    for shaper in (mzv(mode), equally_spaced(mode, 0.1), equally_spaced(mode, 1.3 * mode.half_period)):
        assert sum(shaper.amplitudes) == pytest.approx(1.0, abs=ROUNDING)
        assert left(shaper, mode) <= ROUNDING * sum(map(abs, shaper.amplitudes))
    assert mzv(mode).duration == pytest.approx(1.5 * mode.half_period, rel=ROUNDING)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3, 0.6])
@pytest.mark.parametrize("negative", [0.1, 0.5, 1.0, 2.0])
def test_a_specified_negative_amplitude_is_shorter_than_zv_and_no_neighbour_is_shorter(damping: float, negative: float):
    mode = Mode(4.0, damping)
    shaper = negative_zv(mode, negative)
    assert shaper.amplitudes[1] == -negative
    assert left(shaper, mode) <= 1e-11 * sum(map(abs, shaper.amplitudes))
    assert shaper.duration < derivative_shaper(mode).duration
    if damping == 0.0:
        spacing = math.acos(negative / (1 + negative)) / 4.0
        assert shaper.times == pytest.approx([0.0, spacing, 2 * spacing], abs=ROUNDING)


@pytest.mark.parametrize("humps", [1, 2, 3])
@pytest.mark.parametrize("damping", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("tolerance", [slow(0.01), 0.05, slow(0.2)])
def test_the_humps_touch_the_tolerance_and_nothing_exceeds_it(humps: int, damping: float, tolerance: float):
    mode = Mode(2 * math.pi, damping)
    for make in (extra_insensitive, unity_magnitude):
        shaper = make(mode, tolerance, humps).shaper
        assert sum(shaper.amplitudes) == pytest.approx(1.0, abs=1e-11)
        width = insensitivity(shaper.times, shaper.amplitudes, mode.frequency, damping, tolerance * (1 + 1e-9))
        middle = left(shaper, mode)
        assert middle == pytest.approx(tolerance if humps % 2 else 0.0, abs=1e-10)
        assert width > insensitivity(*_zvd(mode), mode.frequency, damping, tolerance) * (0.6 if make is unity_magnitude else 1.0)
    assert min(extra_insensitive(mode, tolerance, humps).shaper.amplitudes) > 0
    assert [round(a) for a in unity_magnitude(mode, tolerance, humps).shaper.amplitudes] == [(-1) ** k for k in range(2 * humps + 3)]


def _zvd(mode: Mode) -> tuple[tuple[float, ...], tuple[float, ...]]:
    shaper = derivative_shaper(mode, 1)
    return shaper.times, shaper.amplitudes


def test_partial_sums_in_bounds_are_proven_shortest():
    found = bounded([Mode(1.0)], 0, 1)
    assert found.bound is not None
    assert found.bound.status is Status.PROVED
    assert found.shaper.times == pytest.approx([0.0, math.pi / 3, 2 * math.pi / 3], abs=1e-12)
    assert found.shaper.amplitudes == (1.0, -1.0, 1.0)
    modes = [Mode(1.0, 0.1), Mode(2.6, 0.02)]
    both = bounded(modes, 0, 1)
    assert both.bound is not None
    assert both.bound.status is Status.PROVED
    for mode in modes:
        assert left(both.shaper, mode) <= 1e-12
    assert both.shaper.duration < sum(bounded([mode], 0, 1).shaper.duration for mode in modes)  # convolution is longer


def test_time_scales_with_frequency():
    for make in (derivative_shaper, mzv, lambda m: extra_insensitive(m, 0.05, 2).shaper, lambda m: negative_zv(m, 0.4)):
        slow, fast = make(Mode(1.0, 0.07)), make(Mode(250.0, 0.07))
        assert np.array(slow.times) / 250.0 == pytest.approx(np.array(fast.times), rel=1e-11)
        assert slow.amplitudes == pytest.approx(fast.amplitudes, abs=1e-11)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Mode(0.0), ["0.0", "positive"]),
        (lambda: Mode(-1.0, 1.0), ["-1.0", "1.0", "less than 1"]),
        (lambda: Mode(math.nan), ["nan"]),
        (lambda: extra_insensitive(Mode(1.0), 0.0), ["0.0", "between 0 and 1"]),
        (lambda: extra_insensitive(Mode(1.0), 0.05, 0), ["humps", "0"]),
        (lambda: negative_zv(Mode(1.0), -0.3), ["-0.3"]),
        (lambda: derivative_shaper(Mode(1.0), -1), ["-1"]),
        (lambda: equally_spaced(Mode(1.0), 2 * math.pi), ["same phase"]),
        (lambda: bounded([Mode(1.0)], 0.1, 1), ["0.1"]),
        (lambda: bounded([], 0, 1), ["mode"]),
    ],
)
def test_mistakes_are_named(make, words: list[str]):
    with pytest.raises(ShaperError) as caught:
        make()
    assert all(word in str(caught.value) for word in words)
