"""Least durations where a mode decays by far more than doubles tell: tight, and never above what exists."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from marks import slow

from relaxations.checking.durations import Condition, none_of_dips, none_of_sums_up_to_one
from relaxations.shaping.bounded import bounded
from relaxations.shaping.humps import extra_insensitive, unity_magnitude
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.touching import least_of_positive, least_up_to_one_of

W = 2 * math.pi


@pytest.mark.parametrize(("damping", "humps"), [(0.3, 1), slow(0.9, 3), slow(0.99, 2), (0.999, 1)])
def test_of_humps_it_is_within_a_few_parts_in_a_hundred_million(damping: float, humps: int):
    made = extra_insensitive(Mode(W, damping), 0.05, humps)
    lower = least_of_positive(made.zeros, made.shaper)
    assert lower is not None
    assert made.shaper.duration * (1 - 5e-8) < lower < made.shaper.duration


@pytest.mark.parametrize(("damping", "humps"), [(0.99, 1), slow(0.985, 2), slow(0.985, 3), slow(0.99, 4)])
def test_of_humps_of_unity_magnitude_too(damping: float, humps: int):
    made = unity_magnitude(Mode(W, damping), 0.05, humps)
    lower = least_up_to_one_of(made.zeros, made.dips)
    assert lower is not None
    assert made.shaper.duration * (1 - 5e-8) < lower < made.shaper.duration


def test_zero_vibration_of_one_mode_is_half_a_period_and_what_is_no_shortest_shaper_proves_nothing():
    mode = Mode(W, 0.95)
    assert least_of_positive([mode], derivative_shaper(mode)) == pytest.approx(mode.half_period, rel=5e-8)
    assert least_of_positive([mode], derivative_shaper(mode, 1)) is None  # an impulse too many
    other = mode.scaled(1.3)
    longer = derivative_shaper(other)
    assert (least_of_positive([mode], longer) or 0.0) <= mode.half_period  # not its zero: nothing beyond what is true


def test_no_weights_refute_partial_sums_up_to_1_that_exist():
    """1, -1, 1 of the mode takes 0.98270 s; random weights, and those of all directions, refute no such duration."""
    mode = Mode(W, 0.9)
    exact = Fraction(mode.frequency), Fraction(mode.damping)
    for angle in np.linspace(0.0, 2 * np.pi, 721):
        weight = Fraction(math.cos(angle)), Fraction(math.sin(angle))
        assert not none_of_sums_up_to_one(Fraction(98271, 100000), [Condition(*exact, Fraction(0), 0, weight)])
    told = [
        angle
        for angle in np.linspace(0.0, 2 * np.pi, 721)
        if none_of_sums_up_to_one(
            Fraction(97, 100), [Condition(*exact, Fraction(0), 0, (Fraction(math.cos(angle)), Fraction(math.sin(angle))))]
        )
    ]
    assert told, "a shorter one is refuted by some"
    assert not none_of_sums_up_to_one(Fraction(0), [Condition(*exact, Fraction(0), 0, (Fraction(1), Fraction(0)))])


def test_no_weights_refute_dips_that_exist():
    """1, -1, 1 of the mode takes 0.98270 s, and a dip to -1 less; weights of all directions and sizes refute neither."""
    mode = Mode(W, 0.9)
    exact = Fraction(mode.frequency), Fraction(mode.damping)

    def refuted(duration: float, angle: float, lower: int) -> bool:
        weight = Fraction(math.cos(angle)), Fraction(math.sin(angle))
        return none_of_dips(Fraction(duration), [Condition(*exact, Fraction(0), 0, weight)], Fraction(lower))

    for lower in (0, -1):
        needed = bounded([mode], lower, 1).shaper.duration
        angles = np.linspace(0.0, 2 * np.pi, 41)
        assert not any(refuted(needed * (1 + 1e-9), angle, lower) for angle in angles)
        told = [angle for angle in angles if refuted(needed * 0.97, angle, lower)]
        assert told, "a shorter one is refuted by some"
        assert not refuted(needed * 0.97, told[0] + np.pi, lower)
        assert not refuted(needed * 0.97, told[0], 1), "sums do not end at 1 between such bounds"
        assert not refuted(0.0, told[0], lower)
    angle = next(angle for angle in angles if refuted(0.95, angle, 0))
    weight = Fraction(math.cos(angle)), Fraction(math.sin(angle))
    assert not none_of_dips(Fraction(95, 100), [Condition(*exact, Fraction(1), 0, weight)], Fraction(0)), "all of it may be left"


@pytest.mark.parametrize(("frequencies", "damping"), [((1.0, 1.7, 2.9), 0.05), ((1.0, 2.7), 0.9)])
def test_negative_amplitudes_of_several_modes_are_proven_to_be_the_shortest(frequencies: tuple[float, ...], damping: float):
    modes = tuple(Mode(W * f, damping) for f in frequencies)
    made = make("sna-zv", Request(modes, negative=1.0, simultaneous=True))
    assert made.least is not None
    assert made.shaper.duration * (1 - 3e-5) < made.least.duration <= made.shaper.duration


def test_several_modes_that_decay_have_a_least_duration():
    modes = (Mode(W, 0.99), Mode(2.7 * W, 0.99))
    for kind in ("um-zv", "um-ei"):
        made = make(kind, Request(modes))
        assert made.least is not None
        assert 0.0 < made.least.duration < made.shaper.duration
