"""Matrices known to some digits become the plant that they stand for, and no other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from relaxations.errors import PlantError
from relaxations.modes import modes
from relaxations.plants import LinearPlant
from relaxations.realization import realize

Reals = NDArray[np.float64]
EPS = float(np.finfo(float).eps)


def free_chain(masses: Reals, springs: Reals, damping: float) -> Reals:
    """[A B; C 0] of masses in a row, pushed at one end and looked at from the other; damping proportional to stiffness."""
    n = len(masses)
    K = np.zeros((n, n))
    for i, k in enumerate(springs):
        K[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K /= masses[:, None]
    matrix = np.zeros((2 * n + 1, 2 * n + 1))
    matrix[:n, n : 2 * n] = np.eye(n)
    matrix[n : 2 * n, :n], matrix[n : 2 * n, n : 2 * n] = -K, -damping * K
    matrix[n, -1], matrix[-1, n - 1] = 1.0 / masses[0], 1.0
    return matrix


def made(matrix: Reals, uncertainty: Reals) -> LinearPlant:
    return realize(matrix[:-1, :-1], matrix[:-1, -1], matrix[-1, :-1], float(matrix[-1, -1]), uncertainty).plant


def gain_at(plant: LinearPlant, s: complex) -> complex:
    top, bottom = ([complex(float(c)) for c in p.coeffs()] for p in (plant.numerators[plant.output], plant.denominator))
    return complex(np.polyval(top[::-1], s) / np.polyval(bottom[::-1], s))


def transfer(matrix: Reals, s: complex) -> complex:
    n = len(matrix) - 1
    return complex(matrix[n, :n] @ np.linalg.solve(s * np.eye(n) - matrix[:n, :n], matrix[:n, n]) + matrix[n, n])


@pytest.mark.parametrize("error", [8 * EPS, 1e-12, 1e-9])
@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_body_that_floats_is_rigid_and_what_has_no_damping_is_undamped(count: int, damping: float, error: float) -> None:
    """Rounding splits a double pole at the origin into ±1e-8, one of them unstable; of every fifth chain a plant without proof."""
    random = np.random.default_rng(count)
    for _ in range(5):
        exact = free_chain(random.uniform(0.5, 3.0, count), random.uniform(0.5, 3.0, count - 1), damping)
        known = exact * (1.0 + error * random.uniform(-1.0, 1.0, exact.shape))
        plant = made(known, error * np.abs(exact))
        assert plant.rigid_order == 2
        assert not plant.is_unstable
        assert all((pole.value.real == 0.0) == (damping == 0.0) for pole in plant.flexible)
        assert len(plant.flexible) == count - 1
        assert plant.numerators["output"].degree() == (count - 1 if damping else 0)
        for s in (0.3j, 1.0 + 1.0j, 0.1, 5.0j):
            # Poles on the way to s amplify the uncertainty; a hundred of it is allowed, and rounding of the polynomials.
            assert gain_at(plant, s) == pytest.approx(transfer(exact, s), rel=max(300.0 * error, 1e-9))


def test_numbers_that_are_exact_stay_as_they_are() -> None:
    """Binary fractions: what comes out is the exact plant to the last bit, slow, fast and nearly undamped poles included."""
    matrix = np.array([[0.0, 1.0, 0.0, 0.0], [-2.0, -(2.0**-30), 0.0, 1.0], [0.0, 0.0, -(2.0**-20), 1.0], [0.0, 0.0, 0.0, -1024.0]])
    matrix = np.block([[matrix, np.array([[0.0], [0.0], [0.0], [1.0]])], [np.array([[1.0, 0.0, 1.0, 0.0, 0.0]])]])
    expected = LinearPlant.from_state_space(matrix[:4, :4].tolist(), matrix[:4, 4].tolist(), matrix[4, :4].tolist())
    found = made(matrix, 8 * EPS * np.abs(matrix))
    assert found.denominator == expected.denominator
    assert found.numerators["output"] == expected.numerators["output"]
    assert found.notes == ()


@pytest.mark.parametrize("damping", [1e-3, 1e-6])
def test_a_damping_that_the_numbers_do_tell_stays(damping: float) -> None:
    matrix = np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * damping, 1.0], [1.0, 0.0, 0.0]])
    (pole,) = made(matrix, 1e-9 * np.abs(matrix)).poles
    assert pole.damping_ratio == pytest.approx(damping, rel=1e-9)


def test_a_slow_pole_is_no_integrator_unless_it_cannot_be_told() -> None:
    matrix = np.array([[-1e-7, 1.0, 0.0], [0.0, -1.0, 1.0], [1.0, 0.0, 0.0]])
    assert made(matrix, 1e-12 * np.abs(matrix)).rigid_order == 0
    coarse = made(matrix, np.full((3, 3), 1e-6) * (matrix != 0.0))
    assert coarse.rigid_order == 1
    assert "the origin" in coarse.notes[0]


def test_equal_stages_are_one_repeated_pole() -> None:
    """Three lags in a row with entries wrong by 1e-12: their poles lie 1e-4 apart, and are one."""
    random = np.random.default_rng(1)
    exact = np.array([[-2.0, 0.0, 0.0, 1.0], [1.0, -2.0, 0.0, 0.0], [0.0, 1.0, -2.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    for _ in range(20):
        known = exact * (1.0 + 1e-12 * random.uniform(-1.0, 1.0, exact.shape))
        (pole,) = made(known, 1e-12 * np.abs(exact)).poles
        assert pole.multiplicity == 3
        assert pole.value == pytest.approx(-2.0, rel=1e-11)


def test_poles_that_differ_by_more_than_they_may_be_wrong_stay_apart() -> None:
    matrix = np.diag([-1.0, -1.001, 0.0])
    matrix[:2, 2], matrix[2, :2] = 1.0, (1.0, 2.0)
    assert [pole.multiplicity for pole in made(matrix, 1e-9 * np.abs(matrix)).poles] == [1, 1]


def test_what_the_input_nearly_does_not_excite_is_dropped_and_told() -> None:
    """Two equal oscillators pushed alike: the one that they do against each other is excited by rounding alone."""
    oscillator = np.array([[0.0, 1.0], [-1.0 / 3.0, -0.1]])
    matrix = np.zeros((5, 5))
    matrix[:2, :2] = matrix[2:4, 2:4] = oscillator
    matrix[1, 4], matrix[3, 4], matrix[4, 0], matrix[4, 2] = 0.1, 0.1 * (1 + 4 * EPS), 1.0, 2.0
    matrix[3, 2] *= 1.0 - 2 * EPS
    found = made(matrix, 8 * EPS * np.abs(matrix))
    assert found.order == 2
    assert "2 of 4 modes are not excited" in found.notes[0]
    assert gain_at(found, 0.5j) == pytest.approx(transfer(matrix, 0.5j), rel=1e-12)


def test_units_do_not_decide_what_is_excited() -> None:
    """A state in billionths, which one in billions excites by one part in a billion billions, is excited."""
    matrix = np.array([[-1.0, 0.0, 1e9], [1e-18, -2.0, 0.0], [0.0, 1.0, 0.0]])
    sizes = np.array([1e9, 1e-9, 1.0])
    assert realize(matrix[:2, :2], matrix[:2, 2], matrix[2, :2], 0.0, 1e-12 * np.abs(matrix), sizes).plant.order == 2


def test_a_mode_that_the_output_hardly_sees_is_kept() -> None:
    matrix = np.diag([-1.0, -2.0, 0.0])
    matrix[:2, 2], matrix[2, :2] = 1.0, (1.0, 1e-17)
    assert made(matrix, 8 * EPS * np.abs(matrix)).order == 2


def test_a_plant_without_states_is_its_feed_through() -> None:
    plant = made(np.array([[2.5]]), np.array([[1e-15]]))
    assert (plant.order, gain_at(plant, 1.0)) == (0, 2.5)
    with pytest.raises(PlantError, match="does not reach"):
        made(np.array([[-1.0, 0.0], [1.0, 0.0]]), np.zeros((2, 2)))


def test_how_far_a_pole_may_move_is_told() -> None:
    matrix = np.array([[-3.0, 1.0], [2.0, 0.0]])
    found = realize(matrix[:1, :1], matrix[:1, 1], matrix[1, :1], 0.0, 1e-6 * np.abs(matrix))
    assert found.poles.tolist() == [-3.0]
    assert 1e-6 < found.spread[0] <= 3e-6  # of 16 draws within ±3e-6 the largest


# Modes


def test_modes_of_two_masses_in_closed_form() -> None:
    k, m1, m2 = 3.0, 2.0, 0.5
    matrix = free_chain(np.array([m1, m2]), np.array([k]), 0.0)
    found = realize(matrix[:4, :4], matrix[:4, 4], matrix[4, :4], 0.0, 8 * EPS * np.abs(matrix))
    rigid, swing = modes(found.plant, found.poles, found.spread, matrix[:4, :4])
    assert (rigid.kind, rigid.pole.multiplicity, rigid.time_constant, rigid.step_amplitude) == ("rigid", 2, None, None)
    assert rigid.residues[1] == pytest.approx(1.0 / (m1 + m2), rel=1e-12)
    omega = np.sqrt(k / m1 + k / m2)
    assert swing.pole.natural_frequency == pytest.approx(omega, rel=1e-14)
    # y = x_2: a step of the force leaves it swinging by m1/(m1+m2) times the static stretch of the pair.
    assert swing.step_amplitude == pytest.approx(1.0 / ((m1 + m2) * omega**2), rel=1e-12)
    # Participation of mass i in the swing: the other one's share of the mass, half of it in the velocity.
    assert swing.participation == pytest.approx([m2 / (m1 + m2) / 2, m1 / (m1 + m2) / 2] * 2, rel=1e-9)
    assert rigid.participation == pytest.approx([m1 / (m1 + m2) / 2, m2 / (m1 + m2) / 2] * 2, rel=1e-6)


def test_participation_does_not_depend_on_units() -> None:
    random = np.random.default_rng(2)
    matrix = free_chain(random.uniform(0.5, 2.0, 3), random.uniform(0.5, 2.0, 2), 0.02)[:-1, :-1]
    plant = LinearPlant.from_state_space(matrix.tolist(), [0, 0, 0, 1, 0, 0], [0, 0, 1, 0, 0, 0])
    units = 10.0 ** random.integers(-2, 3, 6)
    scaled = matrix * units / units[:, None]
    for one, other in zip(modes(plant, A=matrix), modes(plant, A=scaled), strict=True):
        assert one.participation == pytest.approx(other.participation, abs=1e-6)
        assert sum(one.participation) == pytest.approx(1.0)


def test_a_real_pole_and_its_time_constant() -> None:
    (lag,) = modes(LinearPlant.from_transfer([6], [1, 3]))
    assert (lag.kind, lag.time_constant, lag.step_amplitude) == ("real", pytest.approx(1.0 / 3.0), pytest.approx(2.0))
    (grows,) = modes(LinearPlant.from_transfer([1], [1, -4]))
    assert grows.time_constant == -0.25
