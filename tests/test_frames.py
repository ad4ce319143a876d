"""Equations in long floats, and frames: the same functions in other coordinates, orthonormal, with all the digits that modal ones lose."""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from flint import arb, arb_mat
from numpy.typing import NDArray
from problems import KNOWN, Known, chain, two_mass
from random_plants import random_task

from relaxations.conditioning import framed
from relaxations.digits import equations
from relaxations.frames import doubles, nodes, series
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact, precision, rational

UNIT = Limits.of(-1, 1)
TAIL = LinearPlant.from_zeros_poles([-1, -1, (-2, 3), (-2, -3)], [0, 0, -3, (-1, 2), (-1, -2), (-1, 2), (-1, -2), -5], 2)
WITH_TAIL = problem([TAIL], Maneuver(Fraction(1), Limits.of(-3, 4), robustness=1, tail=True))
EVERY = (
    {known.name: known.problem() for known in KNOWN} | {"tail": WITH_TAIL} | {f"random {k}": random_task(k).problem() for k in range(20)}
)


def legendre(end: float, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Instants in [0, end] and weights of a quadrature of that many points."""
    x, w = np.polynomial.legendre.leggauss(count)
    return end * (x + 1) / 2, end * w / 2


def made(posed: Problem, horizon: float) -> Problem:
    found = framed(posed, horizon)
    assert found is not None
    assert found.frame is not None
    return found


@pytest.mark.parametrize("name", EVERY)
def test_long_floats_begin_with_the_digits_of_the_doubles(name: str):
    posed, s = EVERY[name], [0.0, 0.3, 1.7, 5.0]
    close = partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-11)  # doubles cancel in integrals and derivatives
    costate = np.random.default_rng(0).normal(size=posed.size)
    with precision(256):
        found = equations(posed, 256)
        for integrals in (0, 1):
            close(doubles(found.rows([arb(x) for x in s], bool(integrals))), posed.rows(s, integrals))
        close(doubles(found.target)[:, 0], posed.target)
        close(doubles(found.columns), posed.tail.columns)
        for derivative in range(3):
            close(doubles(found.shapes(s, derivative)), posed.tail.rows(np.array(s), derivative))
        close(costate @ doubles(found.slopes()), posed.derivative(costate))


def test_series_are_exact_for_polynomials():
    x = np.cos(nodes(6))
    np.testing.assert_allclose(series(np.array([x**0, x, 2 * x**2 - 1])), np.eye(6)[:3], atol=1e-15)


@pytest.mark.parametrize("name", ["two_mass_1", "two_mass_robust", "chain_8", "real_mode", "triple_integrator", "unstable", "tail"])
def test_a_frame_is_the_same_equations_in_orthonormal_coordinates(name: str):
    posed, horizon = EVERY[name], 4.0
    found = made(posed, horizon)
    assert found.frame is not None
    change, s = found.frame.outside, np.linspace(0.0, horizon, 57)
    t, w = legendre(horizon, 200)
    np.testing.assert_allclose(found.rows(t) * w @ found.rows(t).T, np.eye(posed.size), atol=2e-3)  # weights of another quadrature
    # Modal coordinates cancel as much as W is large; that much of a double is lost on the right.
    lost = 1e-13 * max(1.0, found.frame.condition) * np.abs(posed.rows(s)).max()
    close = partial(np.testing.assert_allclose, rtol=0.0, atol=lost)
    for integrals in (0, 1):
        close(found.rows(s, integrals), change @ posed.rows(s, integrals))
    close(found.target, change @ posed.target)
    close(found.tail.columns, change @ posed.tail.columns)
    costate = np.random.default_rng(1).normal(size=posed.size)
    modal = np.array(found.modal(costate), dtype=float)
    scale = np.abs(costate) @ np.abs(found.rows(s)).max(axis=1)
    np.testing.assert_allclose(costate @ found.rows(s), modal @ posed.rows(s), rtol=0, atol=scale * lost)
    steps = 1e-5
    differences = (costate @ found.rows(s[1:-1] + steps) - costate @ found.rows(s[1:-1] - steps)) / (2 * steps)
    size = np.abs(found.derivative(costate)) @ np.abs(found.rows(s)).max(axis=1)
    np.testing.assert_allclose(found.derivative(costate) @ found.rows(s[1:-1]), differences, rtol=0, atol=1e-6 * size)  # of the differences


def test_a_frame_knows_digits_that_doubles_have_lost():
    """60 poles in 73 s: the least independent combination of the modal rows is 4e-8 of them, and yet f is right to 1e-12."""
    posed = problem([chain(30)], Maneuver(Fraction(5), UNIT))
    found = made(posed, 73.0)
    assert found.frame is not None
    s = np.linspace(0.0, 73.0, 41)
    with precision(found.frame.bits):
        truth = doubles(found.frame.change * equations(posed, found.frame.bits).rows([arb(float(x)) for x in s]))
    assert np.abs(found.rows(s) - truth).max() <= 1e-12
    assert np.abs(found.frame.outside @ posed.rows(s) - truth).max() >= 1e-10
    # A costate in f and the one that it stands for are the same function.
    costate = np.random.default_rng(2).normal(size=posed.size)
    with precision(found.frame.bits):
        row = arb_mat(1, posed.size, [arb(rational(Fraction(value))) for value in found.modal(costate)])
        modal = doubles(row * equations(posed, found.frame.bits).rows([arb(float(x)) for x in s]))[0]
    np.testing.assert_allclose(costate @ found.rows(s), modal, rtol=0, atol=1e-11)


def test_beyond_its_horizon_a_frame_goes_on():
    found = made(problem([two_mass()], Maneuver(Fraction(1), UNIT)), 4.0)
    before, after = found.rows([4.0 - 1e-9]), found.rows([4.0 + 1e-9])
    np.testing.assert_allclose(before, after, atol=1e-7)


@pytest.mark.parametrize("known", [KNOWN[0], KNOWN[3]], ids=lambda known: known.name)
def test_a_frame_of_a_framed_problem_is_made_of_the_moments(known: Known):
    posed = known.problem()
    once, twice = made(posed, 5.0), made(made(posed, 9.0), 5.0)
    s = np.linspace(0.0, 5.0, 9)
    np.testing.assert_array_equal(once.rows(s), twice.rows(s))
    np.testing.assert_array_equal(once.target, twice.target)


def test_there_is_no_frame_for_countless_periods():
    assert framed(problem([two_mass(stiffness="1e12")], Maneuver(exact(1), UNIT)), 1e3) is None
