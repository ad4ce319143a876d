"""Deflection-limited shapers: the limit holds at every instant of an independent integration, nothing is left, and limits cost time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.impulses import derivative_shaper
from relaxations.sensitivity import residual
from relaxations.shaper_deflection import deflection, deflection_limited
from relaxations.shaper_modes import Mode
from relaxations.shapers import Shaper

ONE, TWO = (Mode(2 * math.pi, 0.02),), (Mode(6.0, 0.02), Mode(17.0, 0.03))


def integrated(shaper: Shaper, mode: Mode) -> float:
    """The largest |y - u| while the step is shaped, by integration of the differential equation from impulse to impulse."""
    state, largest, level = [0.0, 0.0], 0.0, 0.0
    stops = [*shaper.times, shaper.times[-1] + 2 * mode.half_period]
    for amplitude, begin, end in zip(shaper.amplitudes, stops[:-1], stops[1:], strict=True):
        level += amplitude
        square, damped = mode.frequency**2, 2 * mode.damping * mode.frequency
        force = lambda t, x, u=level, k=square, c=damped: [x[1], k * (u - x[0]) - c * x[1]]  # noqa: E731
        run = solve_ivp(force, (begin, end), state, rtol=1e-9, atol=1e-11, max_step=mode.half_period / 50)
        largest = max(largest, float(np.abs(run.y[0] - level).max()))
        state = run.y[:, -1].tolist()
    return largest


def test_the_deflection_of_an_unshaped_step_is_1_and_of_zv_a_half():
    for shaper, known in ((Shaper((0.0,), (1.0,)), 1.0), (derivative_shaper(Mode(3.0), 0), 0.5)):
        found = deflection(shaper, Mode(3.0))
        assert found.lower <= known * (1 + 1e-15)
        assert found.upper == pytest.approx(known, rel=1e-14)


@pytest.mark.parametrize(("modes", "limit", "derivatives"), [(ONE, 0.4, 0), (ONE, 0.2, 1), (TWO, 0.4, 0)])
def test_the_limit_holds_and_nothing_is_left(modes: tuple[Mode, ...], limit: float, derivatives: int):
    found = deflection_limited(modes, limit, derivatives=derivatives)
    assert sum(found.amplitudes) == pytest.approx(1.0, abs=1e-12)
    sums = np.cumsum(found.amplitudes)
    assert sums.min() >= -1e-8
    assert sums.max() <= 1 + 1e-8
    for mode in modes:
        assert integrated(found, mode) <= limit * (1 + 1e-6)
        nudge = 1e-3  # with further derivatives zero the residual grows with their power
        at = [float(residual(found.times, found.amplitudes, mode.frequency * f, mode.damping)[0]) for f in (1.0, 1.0 + nudge)]
        assert at[0] < 1e-10
        assert at[1] < 20.0 * nudge ** (derivatives + 1) * 5.0**derivatives


def test_a_tighter_limit_takes_longer_and_wider_sums_do_not():
    durations = [deflection_limited(ONE, limit).duration for limit in (0.6, 0.4, 0.2, 0.1)]
    assert durations == sorted(durations)
    assert deflection_limited(ONE, 0.4, (-1.0, 2.0)).duration <= durations[1]


def test_mistakes_are_named():
    with pytest.raises(ShaperError, match="positive fraction"):
        deflection_limited(ONE, 0.0)
    with pytest.raises(ImpossibleShaperError, match=r"at most 0\.25"):
        deflection_limited(ONE, 0.4, sample_time=0.3)
    with pytest.raises(ShaperError, match="at least one mode"):
        deflection_limited([], 0.4)
