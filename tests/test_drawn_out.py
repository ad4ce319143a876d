"""Impulses drawn out to pulses of one width: how short such pulses could be where tolerances are kept."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from relaxations.shaping.bands import Band
from relaxations.shaping.drawn_out import least_factor
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request


@pytest.mark.parametrize(("dampings", "width"), [(None, 0.05), ((0.0, 0.4), 0.2), ((0.1, 0.9), 0.6)])
def test_no_factor_of_the_band_is_less(dampings: tuple[float, float] | None, width: float):
    band = Band(Mode(2 * math.pi, 0.2), 0.7, 1.3, 0.05, dampings)
    chance = np.random.default_rng(3)
    omega, zeta = 2 * math.pi * chance.uniform(0.7, 1.3, 20_000), chance.uniform(*(dampings or (0.2, 0.2)), 20_000)
    turns = (zeta + 1j * np.sqrt(1 - zeta**2)) * omega * width
    factors = np.abs((1 - np.exp(-turns)) / turns)
    least = least_factor(band, width)
    assert factors.min() * (1 - 5e-2) < least <= factors.min()  # looks at 401 dampings from 0.1 to 0.9 lose 4 %


def longest_refuted(band: Band, width: float, span: float) -> bool:
    """Whether an independent program finds no positive pulses on a grid of begins up to `span` [s]; its tolerance is a polygon around."""
    begins = np.linspace(0.0, span, 241)
    omega = band.mode.frequency * np.linspace(band.low, band.high, 41)
    pole = (band.mode.damping + 1j * math.sqrt(1 - band.mode.damping**2)) * omega[:, None]
    left = np.exp(pole * (begins - span)) * (1 - np.exp(-pole * width)) / (pole * width)
    turned = np.vstack([(np.exp(-1j * angle) * left).real for angle in np.linspace(0.0, 2 * math.pi, 48, endpoint=False)])
    found = linprog(
        np.zeros(len(begins)),
        A_ub=turned,
        b_ub=np.full(len(turned), band.tolerance),
        A_eq=np.ones((1, len(begins))),
        b_eq=[1.0],
        bounds=(0.0, None),
        method="highs",
    )
    return found.status == 2


def test_the_least_duration_of_pulses_within_a_tolerance():
    mode, width = Mode(2 * math.pi, 0.05), 0.05
    made = make("si", Request((mode,), pulse=width))
    assert made.least is not None
    assert made.least.among == "positive shapers within the tolerance over every band, as pulses of one width"
    assert 0.995 * made.shaper.duration < made.least.duration < made.shaper.duration
    band = Band(mode, 0.8, 1.2, 0.05)
    assert longest_refuted(band, width, made.least.duration - width - 1e-3)
    assert not longest_refuted(band, width, made.shaper.duration - width + 1e-2)
