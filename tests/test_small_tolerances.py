"""Tolerances too small for programs, over one band and several: kept, which is proven and computed in many digits, or refused in words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from flint import acb, arb
from marks import slow

from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.bands import Band
from relaxations.shaping.insensitive import specified
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.roots import keeps, rooted
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.small_tolerances import within, within_small
from suite.shaping import assess

HERTZ = 2 * math.pi
TWO = "a tolerance for each of two bands"


def asked(name: str, damping: float, tolerance: float) -> Request:
    mode = Mode(HERTZ, damping)
    if name == "two modes":
        return Request((mode, Mode(2.7 * HERTZ, damping)), tolerance, bands=((0.9, 1.1, tolerance),), simultaneous=True)
    bands = ((0.9, 1.1, tolerance), (1.8, 2.2, 10 * tolerance)) if name == TWO else ((0.97, 1.03, tolerance), (0.8, 1.2, 0.05))
    return Request((mode,), tolerance, bands=bands)


def largest(shaper: Shaper, band: Band, looks: int) -> float:
    """The residual in 128 bits, at the largest of so many frequencies."""
    with precision(128):
        end, zeta = arb(shaper.times[-1]), arb(band.mode.damping)
        found = []
        for omega in np.linspace(*band.ends, looks):
            rate = arb(float(omega)) * acb(zeta, (1 - zeta * zeta).sqrt())
            parts = (arb(a) * (rate * (arb(t) - end)).exp() for t, a in zip(shaper.times, shaper.amplitudes, strict=True))
            found.append(float(abs(sum(parts, acb(0))).upper()))
        return max(found)


def of(request: Request) -> list[Band]:
    return [band for _, band in request.reaches()]


@pytest.mark.parametrize(("damping", "tolerance", "factors"), [slow(0.3, 1e-7, 3), (0.95, 1e-12, 4)])
def test_a_shaper_in_a_row_keeps_what_its_factors_keep_the_roots_of(damping: float, tolerance: float, factors: int):
    bands = of(asked(TWO, damping, tolerance))
    found = rooted(bands)
    assert found.factors == factors
    assert min(found.shaper.amplitudes) > 0.0
    assert math.fsum(found.shaper.amplitudes) == pytest.approx(1.0, abs=1e-14)
    heights = [largest(found.shaper, band, 41) for band in bands]
    assert all(height <= band.tolerance for height, band in zip(heights, bands, strict=True))
    assert max(height / band.tolerance for height, band in zip(heights, bands, strict=True)) > 0.99, "none is kept for nothing"


def test_a_little_more_than_the_tolerance_is_told():
    band, *others = of(asked(TWO, 0.95, 1e-7))
    shaper = rooted([band, *others]).shaper
    times, amplitudes = shaper.times, list(shaper.amplitudes)
    amplitudes[0] += 1e-6
    amplitudes[-1] -= 1e-6
    assert keeps(shaper, [band])
    assert not keeps(Shaper(times, tuple(amplitudes)), [band])


@pytest.mark.parametrize("tolerance", [1e-15, slow(1e-300)])
def test_a_tolerance_that_is_rounding_is_refused_with_what_is_possible(tolerance: float):
    with pytest.raises(SolverError, match=r"tolerances from 1e-13 on, and zv-d:N, which leaves nothing at the mode, are possible"):
        within(of(asked(TWO, 0.0, tolerance)))


@pytest.mark.slow
def test_what_many_derivatives_keep_a_shaper_in_a_row_keeps_sooner():
    (band,) = of(Request((Mode(HERTZ),), 1e-12, bands=((0.9, 1.1, 1e-12),)))
    found = within_small([band])
    assert largest(found.shaper, band, 41) <= 1e-12
    assert found.shaper.duration < 8.0, "13 derivatives keep it from 0.911 to 1.089 only, and take 7.7"


@pytest.mark.slow
def test_a_tolerance_at_which_newton_fails_is_kept_between_samples_too():
    """The grid's own shaper was looked at on samples only, and between them beyond the tolerance by 7e-10 of it."""
    found = assess("si", asked("two modes", 0.0, 1e-3))
    assert found.worst[1] <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damping", "tolerance"), list(itertools.product((0.0, 0.05, 0.3, 0.7, 0.95), (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-12)))
)
@pytest.mark.parametrize("name", ["two modes", TWO, "one within the other"])
def test_several_bands_of_any_tolerance(name: str, damping: float, tolerance: float):
    found = assess("si", asked(name, damping, tolerance))
    assert all(reach.worst.upper <= reach.band.tolerance for reach in found.reaches)
    assert found.least is not None
    assert 0.0 < found.least.duration <= found.shaper.duration
    if tolerance < 1e-7:
        assert any("larger tolerance" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_of_two_bands_of_small_tolerances_it_is_near_the_shortest(tolerance: float):
    """Longer than that of the larger tolerance 1e-4 by little more than the tolerances' logarithms tell."""
    ends = [specified(of(asked("two modes", 0.0, larger))).shaper.duration for larger in (1e-2, 1e-4)]
    step = (ends[1] - ends[0]) / 2  # for each power of ten
    found = make("si", asked("two modes", 0.0, tolerance)).shaper.duration
    assert found <= 1.15 * (ends[1] + step * (math.log10(1e-4 / tolerance)))


def test_tolerances_below_those_of_humps_are_kept_by_derivatives_where_doubles_hold_them():
    (band,) = of(Request((Mode(HERTZ, 0.05),), 1e-15, bands=((0.97, 1.03, 1e-15),)))
    found = within([band])
    assert largest(found.shaper, band, 41) <= 1e-15
    assert found.note


@pytest.mark.slow
def test_dampings_of_a_range_are_kept_by_the_shorter_of_two():
    band = Band(Mode(HERTZ, 0.05), 0.95, 1.05, 1e-8, (0.04, 0.06))
    found = within([band])
    heights: Sequence[float] = [largest(found.shaper, Band(Mode(HERTZ, z), 0.95, 1.05, 1e-8), 21) for z in (0.04, 0.05, 0.06)]
    assert max(heights) <= 1e-8
    assert found.shaper.duration < 7.0, "13 derivatives take 7 periods"
    assert "in a row" in found.note
