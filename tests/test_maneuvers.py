"""From a plant and a task to equations: targets, further zeros, limits, and what is refused by definition."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from problems import OSCILLATOR, chain, two_mass

from relaxations.errors import ManeuverError, PlantError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import Exact, LinearPlant

UNIT = Limits.of(-1, 1)
DAMPED = LinearPlant.from_zeros_poles([], [-3, "-0.5", (-1, 3), (-1, -3), ("-0.1", 1), ("-0.1", -1)], 45)


@pytest.mark.parametrize(("lower", "upper"), [(1, -1), (1, 1), ("0.5", "0.25")])
def test_limits_ascend(lower: Exact, upper: Exact):
    with pytest.raises(ManeuverError, match="ascend"):
        Limits.of(lower, upper)


def test_rest_of_a_rigid_plant_is_its_displacement_alone():
    # Chain of 5 unit masses: position → Δ means ∫∫ u = 5 Δ and nothing else.
    posed = problem([chain(5)], Maneuver(Fraction(2), UNIT))
    expected = np.zeros(10)
    expected[1 - 0] = 10.0  # the rows of the origin come first: ∫ u, then ∫ s u
    assert posed.hold == 0.0
    np.testing.assert_allclose(posed.target, expected, atol=1e-14)


def test_rest_of_a_plant_without_integrator_is_holding_the_input():
    posed = problem([OSCILLATOR()], Maneuver(Fraction(1, 2), UNIT))
    assert posed.hold == 0.5
    # level/(-p) at p = j: 0.5 j
    np.testing.assert_allclose(posed.target, [0.0, 0.5], atol=1e-16)


def test_a_feed_through_shares_the_displacement():
    # (s+2)/(s+1): D = 1, G(0) = 2.
    posed = problem([LinearPlant.from_transfer([1, 2], [1, 1])], Maneuver(Fraction(1), UNIT))
    assert posed.hold == 0.5


def test_robustness_adds_zeros_at_flexible_modes_only():
    sizes = [problem([two_mass()], Maneuver(Fraction(1), UNIT, robustness=n)).size for n in range(4)]
    assert sizes == [4, 6, 8, 10]
    multiplicities = [p.multiplicity for p in problem([DAMPED], Maneuver(Fraction(1, 2), UNIT, robustness=2)).sets[0].basis.poles]
    assert multiplicities == [1, 3, 1, 3]  # -0.5, -0.1 ± j, -3, -1 ± 3j


def test_robustness_by_name_counts_modes_by_frequency_and_real_poles_by_magnitude():
    posed = problem([DAMPED], Maneuver(Fraction(1, 2), UNIT, robustness={"mode[2]": 1, "real[1]": 2}))
    assert [(p.value.real, p.multiplicity) for p in posed.sets[0].basis.poles] == [(-0.5, 3), (-0.1, 1), (-3.0, 1), (-1.0, 2)]


def test_further_zeros_ask_for_the_rest_of_the_derivatives_too():
    posed = problem([DAMPED], Maneuver(Fraction(1, 2), UNIT, robustness={"real[2]": 1}))
    hold, p = posed.hold, -3.0
    np.testing.assert_allclose(posed.sets[0].target[3:5], [hold / -p, hold / p**2], rtol=1e-14)


@pytest.mark.parametrize("robustness", [{"mode[3]": 1}, {"real[0]": 1}, {"mode": 1}, {"mode[1]": 1, "elephant": 1}])
def test_an_unknown_mode_names_those_that_exist(robustness: dict[str, int]):
    with pytest.raises(ManeuverError, match=r"mode\[1\], mode\[2\], real\[1\], real\[2\]"):
        problem([DAMPED], Maneuver(Fraction(1, 2), UNIT, robustness=robustness))


@pytest.mark.parametrize("robustness", [-1, {"mode[1]": -2}])
def test_negative_counts_are_refused(robustness: int | dict[str, int]):
    with pytest.raises(ManeuverError, match="0 or more"):
        problem([DAMPED], Maneuver(Fraction(1, 2), UNIT, robustness=robustness))


def test_nothing_to_move_is_refused():
    with pytest.raises(ManeuverError, match="nothing to move"):
        problem([two_mass()], Maneuver(Fraction(0), UNIT))


@pytest.mark.parametrize(("rest", "limits", "where"), [(2, (-1, 1), "initial"), ("0.25", ("0.5", 1), "initial"), ("0.75", (0, 1), "final")])
def test_limits_that_exclude_a_rest_are_refused_by_name(rest: Exact, limits: tuple[Exact, Exact], where: str):
    with pytest.raises(ManeuverError, match=f"{where} rest.*outside the limits"):
        problem([OSCILLATOR()], Maneuver(Fraction(1, 2), Limits.of(*limits), Fraction(rest)))


def test_a_rest_exactly_on_a_limit_is_allowed_and_compared_exactly():
    third = Fraction(1, 3)
    problem([OSCILLATOR()], Maneuver(third, Limits.of(0, third)))
    with pytest.raises(ManeuverError, match="final"):
        problem([OSCILLATOR()], Maneuver(third + Fraction(1, 10**40), Limits.of(0, third)))


def test_a_zero_at_the_origin_has_no_rest():
    with pytest.raises(PlantError, match="zero at the origin"):
        problem([LinearPlant.from_transfer([1, 0], [1, 1, 1])], Maneuver(Fraction(1), UNIT))


def test_limits_count_from_the_rest_input():
    posed = problem([two_mass()], Maneuver(Fraction(1), Limits.of("-0.3", "0.7"), Fraction(1, 10)))
    assert (posed.lower, posed.upper, posed.rest) == (-0.4, 0.6, 0.1)


@pytest.mark.parametrize("rest", ["0.1", "0.3", "-0.2", "0.7"])
def test_going_back_to_absolute_input_never_leaves_the_limits(rest: str):
    # -0.4 + 0.1 = -0.30000000000000004 in doubles.
    posed = problem([two_mass()], Maneuver(Fraction(1), Limits.of("-0.3", "0.7"), Fraction(rest)))
    assert posed.absolute(posed.lower) == -0.3
    assert posed.absolute(posed.upper) == pytest.approx(0.7, abs=2e-16)
    assert posed.absolute(posed.upper) <= 0.7


def test_several_plants_share_one_command():
    plants = [two_mass(stiffness=k) for k in ("0.8", 1, "1.2")]
    posed = problem(plants, Maneuver(Fraction(1), UNIT))
    assert posed.size == 12
    assert posed.rows([0.1, 0.2], 1).shape == (12, 2)
    np.testing.assert_array_equal(posed.target, np.concatenate([problem([p], Maneuver(Fraction(1), UNIT)).target for p in plants]))
    costate = np.random.default_rng(0).normal(size=12)
    s = np.array([0.5, 1.5])
    finite = (costate @ posed.rows(s + 1e-6) - costate @ posed.rows(s - 1e-6)) / 2e-6
    np.testing.assert_allclose(posed.derivative(costate) @ posed.rows(s), finite, rtol=1e-8)  # h²/6 · p'''/p'


def test_plants_that_ask_for_different_final_inputs_are_refused():
    with pytest.raises(ManeuverError, match="share one command"):
        problem([OSCILLATOR(), LinearPlant.from_transfer([1], [1, 0, 2])], Maneuver(Fraction(1, 2), UNIT))


def test_notes_of_the_plant_come_along():
    plant = LinearPlant.from_state_space([[-1, 0], [0, -2]], [1, 0], [1, 1])
    assert problem([plant], Maneuver(Fraction(1, 2), UNIT)).notes == plant.notes
    assert plant.notes
