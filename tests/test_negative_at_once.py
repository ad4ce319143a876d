"""Shapers with negative impulses for several modes in one solution: what they keep, how short they are, nothing false proven."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog

from relaxations.checking.durations import Condition, none_within_sums
from relaxations.shaping.impulses import negative_zv
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.negative_amplitudes import negative_at_once
from relaxations.shaping.requests import Request
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.vanishing import left

HERTZ = 2 * math.pi


def test_of_one_mode_it_is_the_three_impulses():
    for mode, negative in ((Mode(3.0), 1.0), (Mode(3.0, 0.1), 0.5)):
        found, known = negative_at_once([mode], negative), negative_zv(mode, negative)
        assert found.times == pytest.approx(known.times, abs=1e-7)
        assert found.duration == pytest.approx(known.duration, rel=1e-12)
        assert found.amplitudes == pytest.approx(known.amplitudes, abs=1e-6)


@pytest.mark.parametrize(
    ("modes", "negative"),
    [((Mode(HERTZ, 0.05), Mode(2.7 * HERTZ, 0.1)), 0.3), ((Mode(HERTZ), Mode(2.3 * HERTZ, 0.02), Mode(4.1 * HERTZ)), 0.5)],
)
def test_specified_negative_amplitudes_of_several_modes(modes: tuple[Mode, ...], negative: float):
    both = make("sna-zv", Request(modes, negative=negative, simultaneous=True))
    shaper = both.shaper
    assert all(left(shaper, mode) <= 1e-12 for mode in modes)
    assert -math.fsum(a for a in shaper.amplitudes if a < 0.0) == pytest.approx(negative, abs=1e-12)
    assert math.fsum(shaper.amplitudes) == pytest.approx(1.0, abs=1e-12)
    assert shaper.duration < make("sna-zv", Request(modes, negative=negative)).shaper.duration
    assert both.least is not None
    assert 0.98 * shaper.duration < both.least.duration <= shaper.duration
    assert not on_grid(modes, negative, 0.99 * shaper.duration)
    assert on_grid(modes, negative, 1.01 * shaper.duration)


def on_grid(modes: tuple[Mode, ...], negative: float, duration: float, cells: int = 400) -> bool:
    """Whether a grid holds such a sequence; with time from the beginning and unscaled."""
    instants = np.linspace(0.0, duration, cells + 1)
    z = np.array([np.exp(mode.frequency * mode.direction * instants) for mode in modes])
    table = np.vstack([np.ones(cells + 1), np.real(z), np.imag(z)])
    count = cells + 1
    found = linprog(
        np.zeros(2 * count),
        A_ub=np.concatenate([np.zeros(count), np.ones(count)])[None, :],
        b_ub=[negative],
        A_eq=np.hstack([table, -table]),
        b_eq=np.eye(len(table))[0],
        method="highs",
    )
    return found.status == 0


@pytest.mark.slow
def test_unity_magnitude_humps_of_several_modes():
    modes = (Mode(HERTZ, 0.05), Mode(1.3 * HERTZ, 0.02))
    found = make("um-ei", Request(modes, simultaneous=True))
    assert found.shaper.amplitudes == tuple((-1.0) ** k for k in range(len(found.shaper.times)))
    for number, band in found.ranges:
        assert band.low < 1.0 < band.high
        omega = np.linspace(band.low, band.high, 2001) * modes[number].frequency
        assert residual(found.shaper.times, found.shaper.amplitudes, omega, modes[number].damping).max() <= 0.05
    assert found.shaper.duration < 0.8 * make("um-ei", Request(modes)).shaper.duration
    assert found.least is not None
    assert 0.999 * found.shaper.duration < found.least.duration <= found.shaper.duration


class TestTheProof:
    def test_a_known_least_duration_is_told_to_a_millionth(self):
        """Undamped, bounds 0 and 1: 2π/3, by p = cos(t - T/2)."""
        for factor, proven in ((1 - 1e-6, True), (1 + 1e-6, False)):
            duration = Fraction(2 * math.pi / 3 * factor)
            half = float(duration) / 2
            weight = Fraction(math.cos(half)), Fraction(-math.sin(half))
            condition = Condition(Fraction(1), Fraction(0), Fraction(0), 0, weight)
            assert none_within_sums(duration, [condition], Fraction(0), Fraction(1)) is proven

    def test_nothing_is_refuted_that_there_is(self):
        """Random multipliers against the sequence 1, -1, 1 itself, with bounds that hold it, and tolerances that it keeps."""
        chance = np.random.default_rng(6)
        for _ in range(40):
            damping, upper = float(chance.uniform(0, 0.5)), 1 + Fraction(int(chance.integers(0, 3)), 2)
            shaper = make("um-zv", Request((Mode(2.0, damping),))).shaper
            conditions = []
            for omega in chance.uniform(1.5, 2.5, 3):
                kept = float(residual(shaper.times, shaper.amplitudes, omega, damping)[0]) * (1 + 1e-9)
                weight = tuple(Fraction(float(x)) for x in chance.normal(size=2))
                conditions.append(Condition(Fraction(float(omega)), Fraction(damping), Fraction(kept), 0, (weight[0], weight[1])))
            duration = Fraction(shaper.duration * float(chance.uniform(1.0, 1.5)))
            assert not none_within_sums(duration, conditions, Fraction(0), upper)

    def test_what_makes_no_sense_is_not_proven(self):
        condition = Condition(Fraction(1), Fraction(0), Fraction(0), 0, (Fraction(1, 2), Fraction(-1, 2)))
        assert not none_within_sums(Fraction(1, 10), [condition], Fraction(1, 2), Fraction(1))
        assert not none_within_sums(Fraction(1, 10), [condition], Fraction(0), Fraction(1, 2))
        assert not none_within_sums(Fraction(0), [condition], Fraction(0), Fraction(1))
