"""Moments: the basis functions, their integrals and the answer to a tail, against quadrature and long arithmetic."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from flint import acb, arb
from independent import StateSpace
from numpy.typing import NDArray
from problems import two_mass
from scipy.integrate import quad

from relaxations.moments import Basis
from relaxations.plants import LinearPlant, Pole, precision

POLES = (Pole(0j, 2), Pole(-0.7 + 0j, 3), Pole(-0.1 + 2j, 2), Pole(3j, 1), Pole(0.4 + 0j, 1))
BASIS = Basis(POLES)
CHAINS = [(pole.value, k, pole.is_flexible) for pole in POLES for k in range(pole.multiplicity)]


def as_rows(values: list[complex]) -> NDArray[np.float64]:
    rows: list[float] = []
    for (_, _, flexible), value in zip(CHAINS, values, strict=True):
        rows += [value.real, value.imag] if flexible else [value.real]
    return np.array(rows)


def long_chain(pole: complex, power: int, integrals: int, s: float) -> complex:
    """The `integrals`-fold integral of `s^power/power! e^{pole s}` by its power series with 600 bits."""
    with precision(600):
        x = acb(pole.real, pole.imag) * arb(s)
        term = acb(s) ** (power + integrals) / factorial(power + integrals)
        total = term
        for k in range(1, 300 + int(6 * abs(pole) * s)):
            term = term * x * (power + k) / (k * (power + k + integrals))
            total += term
        return complex(float(total.real.mid()), float(total.imag.mid()))


def test_size_counts_real_rows():
    assert BASIS.size == 2 + 3 + 2 * 2 + 2 + 1
    assert BASIS.rows([0.5, 1.0, 2.0]).shape == (BASIS.size, 3)
    assert Basis(()).size == 0


@pytest.mark.parametrize("s", [0.0, 0.3, 2.0])
def test_rows_are_what_they_are_called(s: float):
    expected = as_rows([s**k / factorial(k) * np.exp(p * s) for p, k, _ in CHAINS])
    np.testing.assert_allclose(BASIS.rows([s])[:, 0], expected, rtol=1e-15)


@pytest.mark.parametrize("s", [1e-9, 0.4, 1.7, 6.0])
def test_integrals_by_quadrature(s: float):
    def integral(function: str, k: int, p: complex) -> complex:
        weight = {"once": lambda t: 1.0, "twice": lambda t: s - t}[function]

        def part(t: float) -> complex:
            return weight(t) * t**k / factorial(k) * np.exp(p * t)

        return complex(*(quad(lambda t: part(t).real, 0, s, epsrel=1e-13)[0], quad(lambda t: part(t).imag, 0, s, epsrel=1e-13)[0]))

    for integrals, function in ((1, "once"), (2, "twice")):
        expected = as_rows([integral(function, k, p) for p, k, _ in CHAINS])
        np.testing.assert_allclose(BASIS.rows([s], integrals)[:, 0], expected, rtol=1e-11, atol=1e-30)  # quadrature's own error


@pytest.mark.parametrize("pole", [-1 + 0j, 1 + 0j, 1j, -0.1 + 1j, 0.3 + 1j, -5 + 2j])
@pytest.mark.parametrize("power", [0, 1, 2, 5, 7])
def test_no_digits_are_lost_near_the_origin_or_where_series_and_recurrence_meet(pole: complex, power: int):
    times = np.array([1e-8, 0.1, 0.9, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 6.0, 6.5, 7.9, 8.0, 8.1, 12.0, 30.0]) / abs(pole)
    rows = 2 if pole.imag else 1
    basis = Basis((Pole(pole, power + 1),))
    for integrals in (1, 2):
        table = basis.rows(times, integrals)[-rows:]
        ours = table[0] + 1j * table[1] if rows == 2 else table[0]
        exact = np.array([long_chain(pole, power, integrals, s) for s in times])
        # Measured: 8e-14 at worst (a recurrence of eight steps). Alternating series would leave 2e-11.
        np.testing.assert_allclose(ours, exact, rtol=2e-13)


def test_the_derivative_of_a_costate_belongs_to_the_derivative_of_its_function():
    costate = np.random.default_rng(1).normal(size=BASIS.size)
    # ∫_0^s p' = p(s) - p(0), with the closed-form integral on the left.
    s = np.array([0.2, 1.0, 2.5])
    left = BASIS.derivative(costate) @ BASIS.rows(s, 1)
    right = costate @ (BASIS.rows(s) - BASIS.rows([0.0]))
    np.testing.assert_allclose(left, right, rtol=1e-12)


def test_hold_is_where_a_constant_input_keeps_the_modes():
    # Once there, another second of the same input changes nothing: e^{p h} (chain) M + ∫_0^h b · level = M.
    basis, level, h = Basis(tuple(p for p in POLES if not p.is_rigid)), 0.7, 1.0
    held = basis.hold(level)
    at = 0
    for pole in basis.poles:
        width = 2 if pole.is_flexible else 1
        block = held[at : at + width * pole.multiplicity].reshape(pole.multiplicity, width)
        states = block[:, 0] + (1j * block[:, 1] if width == 2 else 0)
        for k in range(pole.multiplicity):
            coasted = sum(h ** (k - i) / factorial(k - i) * np.exp(pole.value * h) * states[i] for i in range(k + 1))
            driven = level * long_chain(pole.value, k, 1, h)
            assert coasted + driven == pytest.approx(states[k], rel=1e-13)
        at += width * pole.multiplicity
    assert not Basis((Pole(0j, 3),)).hold(1.0).any()


@pytest.mark.parametrize(
    "plant",
    [
        two_mass(damping="0.1"),
        LinearPlant.from_transfer([1, 2, 3], [1, 3, 3, 1]),
        LinearPlant.from_zeros_poles([-2], [0, 0, ("-0.1", 1), ("-0.1", -1), ("-0.1", 1), ("-0.1", -1)], 3),
    ],
)
def test_weights_turn_moments_into_outputs(plant: LinearPlant):
    # The step response, from zero state, by the matrix exponential.
    basis, partial, space = Basis(plant.poles), plant.partial(), StateSpace.of(plant)
    for t in (0.1, 1.0, 4.0):
        _, constant, _ = space.step(t)
        ours = float(basis.weights(partial) @ basis.rows([t], 1)[:, 0]) + partial.feedthrough
        assert ours == pytest.approx(float(space.C @ constant) + space.D, rel=1e-12)


@pytest.mark.parametrize("rate", [-0.7 + 0j, -0.7 + 1e-9 + 0j, -0.1 + 2j, -0.1 - 2j, -0.1 + 2.000001j, -3.0 + 1j, -40.0 + 0j])
@pytest.mark.parametrize("power", [0, 1, 3])
def test_the_answer_to_a_tail_by_quadrature(rate: complex, power: int):
    since = np.array([0.0, 0.05, 1.0, 5.0])
    ours = BASIS.tail(rate, power, since)
    for row, (pole, k, _) in zip(ours, CHAINS, strict=True):
        for r, value in zip(since, row, strict=True):

            def part(t: float, pole: complex = pole, k: int = k, r: float = r) -> complex:
                return (r - t) ** k / factorial(k) * np.exp(pole * (r - t)) * t**power * np.exp(rate * t)

            real, imaginary = (quad(f, 0, r, epsrel=1e-12, limit=200)[0] for f in (lambda t: part(t).real, lambda t: part(t).imag))
            assert value == pytest.approx(complex(real, imaginary), rel=1e-9, abs=1e-13)  # quadrature of an oscillation


def test_a_tail_much_faster_or_slower_than_the_plant_does_not_overflow():
    for pole, rate in ((-1e-3, -1e4), (-1e4, -1e-3), (0.0, -1e4)):
        value = Basis((Pole(complex(pole), 2),)).tail(complex(rate), 1, np.array([1.0, 100.0]))
        assert np.isfinite(value).all()
    # ∫_0^r e^{-t'} r' …: the slow state that an impulse-like tail of area 1/10⁴ leaves behind.
    (value,) = Basis((Pole(-1e-3 + 0j, 1),)).tail(-1e4 + 0j, 0, np.array([100.0]))
    assert value[0].real == pytest.approx(np.exp(-0.1) / (1e4 - 1e-3), rel=1e-13)
