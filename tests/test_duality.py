"""Weak duality: roots of the costate, the support integral, and that no costate ever claims too long a time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from problems import AWKWARD, FACTS, KNOWN, Known
from scipy.integrate import quad

from relaxations.bounds import Settings, grid_minimum
from relaxations.duality import costate_roots, lower_bound, support
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact


def oscillator():
    return problem([LinearPlant.from_transfer([1], [1, 0, 1])], Maneuver(exact("0.5"), Limits.of(-1, 1)))


def test_roots_of_a_sine():
    found = costate_roots(oscillator(), np.array([0.0, 1.0]), 20.0)  # Im e^{js}
    np.testing.assert_allclose(found, np.pi * np.arange(1, 7), rtol=4e-16)


def test_a_costate_without_roots_has_none():
    rigid = problem([LinearPlant.from_transfer([1], [1, 0, 0])], Maneuver(exact(1), Limits.of(-1, 1)))
    assert len(costate_roots(rigid, np.array([1.0, 1.0]), 5.0)) == 0


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-10])
def test_a_pair_of_roots_between_two_samples_is_found(depth: float):
    # 1 + depth - (1 + 2 depth) cos(s - 1): twice below zero by a hair around s = 1, far narrower than any sampling.
    mixed = problem([LinearPlant.from_transfer([1], [1, 0, 1, 0])], Maneuver(exact(1), Limits.of(-1, 1)))
    cosine, sine = np.cos(1.0), np.sin(1.0)
    costate = np.array([1.0 + depth, -(1 + 2 * depth) * cosine, -(1 + 2 * depth) * sine])
    found = costate_roots(mixed, costate, 4.0)
    assert len(found) == 2
    half = np.arccos((1 + depth) / (1 + 2 * depth))
    np.testing.assert_allclose(found, [1 - half, 1 + half], atol=1e-15 / half)  # the slope at the root is about half


def test_roots_in_a_boundary_layer_are_found():
    # With q = e^{-10⁴ s} in (0, 1): 1 - 3 q + 1.5 q² has one root there, 1 - 4 q + 3.2 q² has two.
    stiff = problem([LinearPlant.from_zeros_poles([], [0, -10_000, -20_000], 1)], Maneuver(exact("1e-3"), Limits.of(-1, 1)))
    found = costate_roots(stiff, np.array([1.0, -3.0, 1.5]), 1000.0)
    q = (3 - np.sqrt(9 - 6)) / 3
    np.testing.assert_allclose(found, [-np.log(q) / 1e4], rtol=1e-12)
    both = costate_roots(stiff, np.array([1.0, -4.0, 3.2]), 1000.0)
    q = (4 + np.array([1, -1]) * np.sqrt(16 - 12.8)) / 6.4
    np.testing.assert_allclose(both, -np.log(q) / 1e4, rtol=1e-12)


@pytest.mark.parametrize("known", [k for k in FACTS if k.plant().order <= 8], ids=lambda k: k.name)
def test_the_support_integral_by_quadrature(known: Known):
    posed = known.problem()
    costate = np.random.default_rng(7).normal(size=posed.size)

    def integrand(s: float) -> float:
        p = float(costate @ posed.rows([s])[:, 0])
        return max(posed.upper * p, posed.lower * p)

    assert known.time is not None
    value = support(posed, costate, known.time)
    pieces = np.concatenate([[0.0], value.roots, [known.time]])
    expected = sum(quad(integrand, a, b, epsrel=1e-12)[0] for a, b in itertools.pairwise(pieces))
    assert value.integral == pytest.approx(expected, rel=1e-11)
    assert value.rounding < 1e-11 * max(1.0, abs(value.integral)) * posed.size
    assert value.final == pytest.approx(integrand(known.time), rel=1e-12)


@pytest.mark.parametrize("known", KNOWN, ids=lambda k: k.name)
def test_no_costate_claims_more_than_the_minimum_time(known: Known):
    # Weak duality is true of every λ: of good ones, of bad ones, and of good ones spoiled a little.
    assert known.time is not None
    posed = known.problem()
    grid = grid_minimum(posed, Settings())
    solution = grid.below or grid.above
    assert solution is not None
    good = solution.costate
    rng = np.random.default_rng(11)
    noise = [good * (1 + size * rng.normal(size=posed.size)) for size in (1e-6, 1e-3, 0.1, 1.0)]
    size = 1.0 / np.abs(posed.rows(np.linspace(0, known.time, 20))).max(axis=1)
    random = [rng.normal(size=posed.size) * size for _ in range(3)]
    for costate in [good, *noise, *random]:
        claimed = lower_bound(posed, costate, known.time)
        assert claimed <= known.time * (1 + 1e-12) + known.error  # rounding of the known time itself
    assert lower_bound(posed, 1e6 * good, known.time) == pytest.approx(lower_bound(posed, good, known.time), rel=1e-9)  # λ has no unit


@pytest.mark.parametrize("known", [k for k in KNOWN if k in AWKWARD or k.plant().order <= 12], ids=lambda k: k.name)
def test_the_grids_own_multiplier_is_already_a_good_costate(known: Known):
    assert known.time is not None
    posed = known.problem()
    grid = grid_minimum(posed, Settings())
    assert grid.above is not None
    # The error of the bound is second order in that of λ, which is the grid's: about (1/200)² of the time, squared in turn when smooth.
    assert lower_bound(posed, grid.above.costate, known.time) >= known.time * (1 - 2e-3)


def test_a_costate_that_says_nothing_gives_zero():
    posed = oscillator()
    assert lower_bound(posed, -posed.target, 1.0) == 0.0
    assert lower_bound(posed, np.zeros(2), 1.0) == 0.0
