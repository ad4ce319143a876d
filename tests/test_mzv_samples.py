"""`mzv` on samples: its span, nothing left, and the least slope of the residual, by another program."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.shaping.impulses import derivative_shaper, mzv
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.mzv_samples import mzv_on_samples
from relaxations.shaping.requests import Request
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left
from suite.shaping import assess

HERTZ = 2 * math.pi
CORNERS = 360  # of the polygon about the circle of slopes: least slopes within 1 - cos(π/360) = 4e-5 of the circle's


def phasors(mode: Mode, times: NDArray[Any]) -> NDArray[np.complex128]:
    return np.exp(complex(mode.damping, math.sqrt(1 - mode.damping**2)) * mode.frequency * times)


def slope(mode: Mode, shaper: Shaper, span: float) -> float:
    """`|Σ A t e^{κω(t - span)}|` [s]."""
    times = np.array(shaper.times)
    return float(abs((np.array(shaper.amplitudes) * times * phasors(mode, times - span)).sum()))


def least_slope(mode: Mode, step: float, samples: int) -> float:
    """In HiGHS, with a polygon for the circle."""
    since = step * (np.arange(samples + 1) - samples)
    z = phasors(mode, since)
    turns = np.exp(-2j * np.pi * np.arange(CORNERS) / CORNERS)[:, None]
    within = np.hstack([np.real(turns * since * z), -np.ones((CORNERS, 1))])
    equal = np.hstack([np.vstack([z.real, z.imag, np.ones(samples + 1)]), np.zeros((3, 1))])
    aim = np.append(np.zeros(samples + 1), 1.0)
    found = linprog(aim, within, np.zeros(CORNERS), equal, [0.0, 0.0, 1.0], method="highs")
    assert found.status == 0
    return float(found.fun)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("share", [0.013, 0.11, 0.26, 0.37])
def test_no_other_on_the_same_samples_is_less_sensitive(damping: float, share: float):
    mode = Mode(HERTZ, damping)
    step = share * 2 * mode.half_period
    found, samples = mzv_on_samples(mode, step), math.floor(0.75 / share)
    places = np.array(found.times) / step
    assert np.abs(places - np.round(places)).max() < 1e-9
    assert min(found.amplitudes) > 0.0
    assert len(found.times) <= 4
    assert left(found, mode) < 1e-14
    assert found.duration <= 1.5 * mode.half_period
    least = least_slope(mode, step, samples)
    assert least * (1 - 1e-7) <= slope(mode, found, samples * step) <= least / math.cos(math.pi / CORNERS) * (1 + 1e-7)


def test_eighths_of_a_period_hold_mzv_itself():
    found = mzv_on_samples(Mode(HERTZ), 0.125)
    assert found.times == (0.0, 0.375, 0.75)
    assert found.amplitudes == pytest.approx(np.array([1.0, math.sqrt(2.0), 1.0]) / (2.0 + math.sqrt(2.0)), abs=1e-14)
    assert slope(Mode(HERTZ), found, 0.75) * HERTZ == pytest.approx(0.75 * math.pi * (math.sqrt(2.0) - 1.0), rel=1e-13)


@pytest.mark.parametrize("damping", [0.05, 0.9, 0.999])
def test_fine_samples_come_close_to_the_free_one(damping: float):
    mode = Mode(HERTZ, damping)
    step = mode.half_period / 500
    found, free = mzv_on_samples(mode, step), mzv(mode)
    assert free.duration - step <= found.duration <= free.duration * (1 + 1e-12)
    assert left(found, mode) < 1e-13
    # Under damping the free one is not quite the least sensitive of its span; this one is, but for its samples.
    assert slope(mode, found, free.duration) <= slope(mode, free, free.duration) * 1.01


def test_it_is_between_zv_and_zvd_in_duration_and_insensitivity():
    mode = Mode(HERTZ, 0.05)
    worst = [
        float(residual(one.times, one.amplitudes, HERTZ * np.linspace(0.99, 1.01, 101), 0.05).max())
        for one in (derivative_shaper(mode), mzv_on_samples(mode, 0.01), derivative_shaper(mode, 1))
    ]
    assert worst == sorted(worst, reverse=True)
    assert 0.6 < worst[1] / worst[0] < 0.65, "of slopes 0.976 and 1.571"


def test_its_least_duration_is_that_of_zv_on_these_samples():
    request = Request((Mode(HERTZ, 0.05),), sample_time=0.02)
    found, least = assess("mzv", request), make("zv", request).least
    assert found.least == least
    assert least is not None
    assert least.duration == 0.52
    assert "at multiples of 0.02 s" in least.among
    assert found.shaper.duration == 0.74


def test_several_modes_are_convolved():
    modes = Mode(HERTZ, 0.05), Mode(17.0, 0.1)
    found = make("mzv", Request(modes, sample_time=0.02))
    assert found.shaper.duration == pytest.approx(sum(mzv_on_samples(mode, 0.02).duration for mode in modes), rel=1e-12)
    assert all(left(found.shaper, mode) < 1e-13 for mode in modes)
    assert found.least is not None
    assert 0.5 < found.least.duration < found.shaper.duration


def test_samples_that_are_too_coarse_or_too_fine_are_told_what_would_do():
    mode = Mode(HERTZ)
    with pytest.raises(ImpossibleShaperError, match=r"0\.4 s is too coarse for mzv .* up to 0\.375 s it is possible, and zv up to 0\.5 s"):
        mzv_on_samples(mode, 0.4)
    assert len(mzv_on_samples(mode, 0.3749999).times) == 3
    with pytest.raises(ShaperError, match=r"at most 4096 are searched, so from 0\.0001831 s on"):
        mzv_on_samples(mode, 1e-5)
    with pytest.raises(ShaperError, match="positive and finite"):
        mzv_on_samples(mode, 0.0)
    with pytest.raises(ShaperError, match=r"up to a damping of 0\.99997"):
        mzv_on_samples(Mode(HERTZ, 0.99999), 1.0)
