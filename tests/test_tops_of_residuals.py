"""Where a residual exceeds its tolerance between the places that are looked at."""

from __future__ import annotations

import math

import numpy as np
import pytest

from relaxations.shaping.bands import Band, exceeded
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import residual

# Four impulses for 36.581 and 44.934 Hz; of the second mode the highest residual, 0.0500011, is 1.199026 times its frequency.
TIMES = np.array([0.0, 0.0108920759, 0.0217841430, 0.0326762189])
AMPLITUDES = np.array([0.1597974324, 0.3402025676, 0.3402025676, 0.1597974324])
MODE = Mode(2 * math.pi * 44.934)


@pytest.mark.parametrize("end", [1.199725, 1.1992, 1.19903, 1.25, 1.199025])
def test_a_top_beside_an_end_is_seen(end: float) -> None:
    factors = np.linspace(0.95, end, 400_001)
    course = residual(TIMES, AMPLITUDES, factors * MODE.frequency, 0.0)
    top = int(course.argmax())
    for tolerance, seen in ((course[top] - 1e-9, True), (course[top] + 1e-9, False)):
        found = exceeded(TIMES, AMPLITUDES, [Band(MODE, 0.95, end, float(tolerance))], 1.0)
        assert bool(found) == seen
        assert all(abs(demand.frequency / MODE.frequency - factors[top]) < 1e-4 for demand in found)


def test_a_band_of_one_frequency_has_one_place() -> None:
    here = float(residual(TIMES, AMPLITUDES, 1.1 * MODE.frequency, 0.0)[0])
    assert exceeded(TIMES, AMPLITUDES, [Band(MODE, 1.1, 1.1, here * (1 - 1e-9))], 1.0)
    assert not exceeded(TIMES, AMPLITUDES, [Band(MODE, 1.1, 1.1, here * (1 + 1e-9))], 1.0)
