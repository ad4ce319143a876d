"""Tolerances kept by impulses on samples: over the whole box, on as few samples as do, which is proven."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.insensitive import specified
from relaxations.shaping.insensitive_samples import within_on_samples
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.sensitivity import residual
from suite.shaping import assess

HERTZ = 2 * math.pi


def polygons(bands: list[Band], step: float, samples: int, corners: int = 64) -> bool:
    """Whether positive amplitudes keep polygons around the circles of the tolerances, at 21 frequencies of each band."""
    since = step * (np.arange(samples + 1) - samples)
    turns = np.exp(-2j * np.pi * np.arange(corners) / corners)
    rows, limits = [], []
    for band in bands:
        for damping in np.linspace(*_dampings(band), 1 if band.dampings is None else 5):
            for omega in np.linspace(band.low, band.high, 21) * band.mode.frequency:
                rows.append(np.real(turns[:, None] * np.exp(complex(damping, math.sqrt(1 - damping**2)) * omega * since)))
                limits.append(np.full(corners, band.tolerance))
    ones = np.ones((1, samples + 1))
    return linprog(np.zeros(samples + 1), np.vstack(rows), np.concatenate(limits), ones, [1.0], method="highs").status == 0


def _dampings(band: Band) -> tuple[float, float]:
    return band.dampings or (band.mode.damping, band.mode.damping)


@pytest.mark.parametrize(
    ("bands", "step"),
    [
        ([Band(Mode(HERTZ, 0.05), 0.8, 1.2, 0.05)], 0.1),
        ([Band(Mode(HERTZ, 0.05), 0.8, 1.2, 0.05, (0.0, 0.1))], 0.05),
        ([Band(Mode(HERTZ, 0.05), 0.9, 1.1, 0.05), Band(Mode(17.0, 0.1), 0.95, 1.05, 0.1)], 0.04),
    ],
)
def test_it_holds_in_the_whole_box_and_fewer_samples_do_not_do(bands: list[Band], step: float):
    found = within_on_samples(bands, step)
    places = np.array(found.shaper.times) / step
    assert np.abs(places - np.round(places)).max() < 1e-9
    assert min(found.shaper.amplitudes) > 0.0
    for band in bands:
        for damping in np.linspace(*_dampings(band), 21):
            omega = np.linspace(band.low, band.high, 401) * band.mode.frequency
            assert residual(found.shaper.times, found.shaper.amplitudes, omega, damping).max() <= band.tolerance
    assert found.needed == round(places[-1])
    assert not polygons(bands, step, found.needed - 1)
    assert found.shaper.duration >= specified(bands).shaper.duration * (1 - 1e-9)


def test_ei_on_samples_keeps_its_tolerance_over_its_own_range():
    found = assess("ei", Request((Mode(HERTZ, 0.05),), sample_time=0.02))
    assert found.least is not None
    assert found.least.duration == found.shaper.duration == 1.0
    assert "which need 50" in found.least.among
    (kept,) = found.ranges
    assert kept.worst.upper <= 0.05
    assert kept.band.low < 0.8 < 1.2 < kept.band.high


def test_at_quarter_periods_undamped_ei_is_on_samples_as_it_is():
    """F5 in a range that is rounded inward: (1 + V)/4, (1 - V)/2, (1 + V)/4 at half periods, to 1e-5."""
    found = make("ei", Request((Mode(HERTZ),), sample_time=0.25))
    assert found.shaper.times == (0.0, 0.5, 1.0)
    assert found.shaper.amplitudes == pytest.approx((0.2625, 0.475, 0.2625), abs=1e-5)


def test_what_is_not_done_on_samples_is_told_in_words():
    band = Band(Mode(HERTZ, 0.05), 0.8, 1.2, 0.05)
    with pytest.raises(ImpossibleShaperError, match="too coarse"):
        within_on_samples([band], 0.6)
    with pytest.raises(ShaperError, match=r"up to 2000 are searched, so from 0\.0003"):
        within_on_samples([band], 1e-5)
    with pytest.raises(SolverError, match=r"0\.0001 and more are possible"):
        within_on_samples([Band(Mode(HERTZ, 0.05), 0.8, 1.2, 1e-7)], 0.05)
