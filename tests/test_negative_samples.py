"""Negative impulses on samples: nothing left or a tolerance kept, on as few samples as do, against programs of its own."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from marks import slow
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.checking.durations import Condition, none_on_samples, none_within_sums_on_samples
from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.negative_samples import negative_on_samples
from relaxations.shaping.requests import Made, Request
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.vanishing import left

Complexes = NDArray[np.complex128]
ONE = Mode(2 * math.pi, 0.05)
TWO = Mode(2 * math.pi * 2.7, 0.02)
DIRECTIONS = 64  # of the polygon around each disc: it holds the disc, so what has no point in it has none in the disc


def columns(modes: list[Mode], step: float, samples: int) -> Complexes:
    since = step * (np.arange(samples + 1) - samples)
    poles = np.array([m.frequency * complex(m.damping, math.sqrt(1 - m.damping**2)) for m in modes])
    return np.exp(poles[:, None] * since).astype(np.complex128)


def vanishes(modes: list[Mode], negative: float, step: float, samples: int) -> bool:
    """Whether a program of its own has impulses that leave nothing."""
    z, n = columns(modes, step, samples), samples + 1
    table = np.vstack([np.ones(n), z.real, z.imag])
    found = linprog(
        np.zeros(2 * n),
        A_ub=np.concatenate([np.zeros(n), np.ones(n)])[None, :],
        b_ub=[negative],
        A_eq=np.hstack([table, -table]),
        b_eq=np.eye(len(table))[0],
        bounds=(0.0, None),
        method="highs",
    )
    return found.status == 0


@pytest.mark.parametrize(
    ("modes", "negative", "step"),
    [
        ([ONE], 1.0, 0.02),
        ([ONE], 0.3, 0.007),
        ([ONE, TWO], 0.5, 0.01),
        ([Mode(2 * math.pi, 0.9)], 1.0, 0.01),
        ([Mode(7.0, 0.99)], 2.0, 0.01),
    ],
)
def test_nothing_is_left_with_so_much_of_negative_impulses_and_fewer_samples_do_not_do(modes: list[Mode], negative: float, step: float):
    shaper, needed = negative_on_samples(modes, negative, step)
    places = np.array(shaper.times) / step
    assert np.abs(places - np.round(places)).max() < 1e-9
    assert round(places[-1]) == needed
    assert -sum(a for a in shaper.amplitudes if a < 0) <= negative * (1 + 1e-9)
    assert math.fsum(shaper.amplitudes) == pytest.approx(1.0, abs=1e-14)
    assert all(left(shaper, mode) <= 1e-12 for mode in modes)
    assert vanishes(modes, negative, step, needed)
    assert not vanishes(modes, negative, step, needed - 1)


def within(made: Made, step: float, samples: int) -> bool:
    """Whether partial sums in [0, 1] have a residual in the polygons at 15 frequencies of every range."""
    rows, limits = [], []
    for _, band in made.ranges:
        for frequency in np.linspace(*band.ends, 15):
            z = columns([Mode(float(frequency), band.mode.damping)], step, samples)[0]
            for theta in np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False):
                turned = (np.exp(-1j * theta) * z).real
                rows.append(turned[:-1] - turned[1:])
                limits.append(band.tolerance - turned[-1])
    found = linprog(np.zeros(samples), A_ub=np.array(rows), b_ub=limits, bounds=(0.0, 1.0), method="highs")
    return found.status == 0


@pytest.mark.parametrize(
    ("kind", "modes", "step"),
    [("um-ei", [ONE], 0.02), slow("um-ei", [Mode(2 * math.pi, 0.3)], 0.01), ("um-2-hump-ei", [ONE], 0.05), slow("um-ei", [ONE, TWO], 0.02)],
)
def test_unity_magnitude_humps_keep_their_range_on_samples_and_fewer_do_not_do(kind: str, modes: list[Mode], step: float):
    made = make(kind, Request(tuple(modes), sample_time=step))
    places = np.array(made.shaper.times) / step
    assert np.abs(places - np.round(places)).max() < 1e-9
    sums = list(itertools.accumulate(made.shaper.amplitudes))
    assert min(sums) >= -1e-15
    assert max(sums) <= 1 + 1e-15
    for _, band in made.ranges:
        seen = residual(made.shaper.times, made.shaper.amplitudes, np.linspace(*band.ends, 2001), band.mode.damping)
        assert float(seen.max()) <= band.tolerance
    assert made.least is not None
    samples = round(places[-1])
    assert made.least.duration == pytest.approx(samples * step, rel=1e-14)
    assert within(made, step, samples)
    assert not within(made, step, samples - 1)


def condition(mode: Mode, tolerance: float, weight: complex) -> Condition:
    parts = Fraction(weight.real), Fraction(weight.imag)
    return Condition(Fraction(mode.frequency), Fraction(mode.damping), Fraction(tolerance), 0, parts)


def test_no_weights_refute_samples_that_hold_a_shaper():
    """Random weights, and those that nearly do: what exists is never refuted."""
    chance = np.random.default_rng(4)
    step, negative = Fraction(1, 50), Fraction(1)
    for _ in range(200):
        weight = complex(*chance.normal(size=2))
        assert not none_on_samples(step, 17, [condition(ONE, 0.0, weight)], negative)  # 17 samples do, for b = 1
        assert not none_within_sums_on_samples(step, 37, [condition(ONE, 0.05, weight)], Fraction(0), Fraction(1))  # um-ei's
        assert not none_within_sums_on_samples(step, 17, [condition(ONE, 0.0, weight)], Fraction(0), Fraction(1))  # um-zv's


def test_bounds_that_hold_no_shaper_and_more_negative_impulses_are_told():
    step = Fraction(1, 50)
    found = [w for w in np.exp(1j * np.linspace(0, 2 * np.pi, 721)) if none_on_samples(step, 16, [condition(ONE, 0.0, w)], Fraction(1))]
    assert found, "16 samples are refuted by some direction"
    assert not any(none_on_samples(step, 16, [condition(ONE, 0.0, w)], Fraction(2)) for w in found), "with more of them there is one"
    assert not any(none_on_samples(step, 16, [condition(ONE, 0.0, w)], Fraction(-1)) for w in found)
    assert not none_within_sums_on_samples(step, 16, [condition(ONE, 0.0, found[0])], Fraction(1, 2), Fraction(1))
    assert not none_within_sums_on_samples(-step, 16, [condition(ONE, 0.0, found[0])], Fraction(0), Fraction(1))


def test_what_is_too_coarse_or_too_fine_is_refused():
    with pytest.raises(ImpossibleShaperError, match="too coarse"):
        make("um-ei", Request((ONE,), sample_time=0.6))
    with pytest.raises(ShaperError, match="up to 1000 are searched"):
        make("sna-zv", Request((ONE,), sample_time=1e-5, negative=1.0))
    with pytest.raises(ShaperError, match="given as a positive number"):
        make("sna-zv", Request((ONE,), sample_time=0.01, negative=-1.0))


def test_a_last_impulse_may_be_next_to_nothing_and_says_when_it_is_over():
    """With much damping decay does it all: one impulse, and as long a wait as with free instants (2.094 s)."""
    mode, step, tolerance = Mode(12.642, 0.9), 0.04924, 0.2
    made = make("um-ei", Request((mode,), tolerance=tolerance, sample_time=step))
    assert made.shaper.duration == pytest.approx(43 * step)
    assert made.least is not None
    assert made.least.duration == pytest.approx(43 * step)
    ((_, band),) = made.ranges
    rate = mode.damping * mode.frequency * band.low
    assert math.exp(-rate * 42 * step) > tolerance > math.exp(-rate * 43 * step)
    curve = residual(made.shaper.times, made.shaper.amplitudes, mode.frequency * np.linspace(band.low, band.high, 2001), mode.damping)
    assert curve.max() <= tolerance


@pytest.mark.slow
def test_fine_samples_come_to_the_free_instants():
    mode = Mode(2 * math.pi, 0.05)
    free, made = make("um-ei", Request((mode,))), make("um-ei", Request((mode,), sample_time=0.005))
    assert free.shaper.duration < made.shaper.duration < free.shaper.duration + 2 * 0.005
    assert made.least is not None
    assert made.least.duration == pytest.approx(148 * 0.005)
