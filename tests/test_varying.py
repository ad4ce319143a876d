"""Plants that vary along a known schedule: constant ones, closed forms, other programs, the checker's enclosures, lies, refusals."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from marks import first, slow
from scipy.optimize import root_scalar
from scipy.special import airy
from varying_plants import GROWING, HOISTING, STIFF_A, STIFF_B, STIFF_C, landed, posed, proven, random_plant, reaches, rest

from relaxations.errors import ManeuverError, PlantError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.transitions import Transition, VaryingPlant
from relaxations.varying import varying_problem
from relaxations.varying_response import varying_response

SPRING_A, SPRING_B, SPRING_C = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [1, -1, 0, 0]], [0, 0, 1, 0], [0, 1, 0, 0]
DAMPED_A, DAMPED_B, DAMPED_C = [[0, 1, 0], [0, "-0.5", 1], [0, "-3", "-0.2"]], [0, 1, 2], [1, 0, 0]


@pytest.mark.parametrize(
    ("A", "B", "C", "displacement", "limits"),
    [
        slow(SPRING_A, SPRING_B, SPRING_C, 1, Limits.of(-1, 1)),
        slow(SPRING_A, SPRING_B, SPRING_C, 5, Limits.of(-1, 1, 4)),
        slow(DAMPED_A, DAMPED_B, DAMPED_C, 2, Limits.of(-1, "0.7")),
        slow(STIFF_A, STIFF_B, STIFF_C, "0.5", Limits.of(-1, 1)),
        (STIFF_A, STIFF_B, STIFF_C, "-0.5", Limits.of(-1, "0.25")),
    ],
)
def test_a_constant_schedule_is_the_constant_plant(A, B, C, displacement, limits) -> None:
    maneuver = Maneuver(exact(displacement), limits)
    constant = minimum_time(problem([LinearPlant.from_state_space(A, B, C)], maneuver))
    for instants in ([0], [0, "0.3", 1, 100]):
        plant = VaryingPlant.of(instants, [A] * len(instants), [B] * len(instants), [C] * len(instants))
        found, command, _ = proven(varying_problem(plant, maneuver))
        assert (found.lower, found.upper, found.switches) == (constant.lower, constant.upper, constant.switches)
        assert constant.command is not None
        assert [s.level for s in command.segments] == [s.level for s in constant.command.segments]
        starts = [[s.start for s in each.segments] for each in (command, constant.command)]
        np.testing.assert_allclose(*starts, rtol=0.0, atol=4e-15)
        assert command.tail == constant.command.tail


def growing_time(displacement: float) -> tuple[float, float]:
    """x'' = (1 + t) u: one switch at t_1, `2 (t_1 + t_1²/2) = T + T²/2` for the velocity, `2 m(t_1) = m(T) - Δ`, m = t²/2 + t³/3."""

    def m(t: float) -> float:
        return t * t / 2 + t**3 / 3

    def switch(T: float) -> float:
        return float(np.sqrt(1 + (T + T * T / 2)) - 1)

    time = float(root_scalar(lambda T: m(T) - 2 * m(switch(T)) - displacement, bracket=(0.1, 2.0), xtol=1e-15).root)
    return time, switch(time)


@pytest.mark.parametrize("displacement", ["1", "0.05", "1.5"])
def test_a_gain_that_grows_has_a_closed_form(displacement: str) -> None:
    time, switch = growing_time(float(displacement))
    found, command, _ = proven(posed(GROWING, displacement))
    assert found.lower <= time * (1 + 1e-14)
    assert found.upper is not None
    assert found.upper >= time * (1 - 1e-14)
    assert command.segments[1].start == pytest.approx(switch, rel=1e-13)


def test_the_transition_of_a_stiffening_spring_is_airys() -> None:
    # z'' = -(1 + t) z is solved by Ai(-(1 + t)) and Bi; Φ(0, t) = W(0) W(t)⁻¹ for their matrix W.
    end, x = 3.0, np.linspace(0.0, 3.0, 31)
    plant = VaryingPlant.of([0, 3], [[[0, 1], [-1, 0]], [[0, 1], [-4, 0]]], [[0, 1]] * 2, [[1, 0]] * 2)

    def wronski(t: float) -> np.ndarray:
        ai, rate_a, bi, rate_b = airy(-(1 + t))
        return np.array([[ai, bi], [-rate_a, -rate_b]])

    expected = np.array([wronski(0.0) @ np.linalg.inv(wronski(t)) @ [0.0, 1.0] for t in x]).T
    np.testing.assert_allclose(Transition(plant).rows(x), expected, rtol=0.0, atol=2e-14)
    transition = Transition(plant)
    step = 1e-4
    middle = x[1:-1]
    np.testing.assert_allclose(
        (transition.rows(middle + step) - transition.rows(middle - step)) / 2 / step, transition.slopes(middle), atol=1e-7
    )
    sums = np.diff(transition.rows(np.array([0.0, end]), 1))[:, 0]
    fine = np.linspace(0.0, end, 20001)
    np.testing.assert_allclose(sums, np.trapezoid(transition.rows(fine), fine, axis=1), atol=1e-8)


@pytest.mark.parametrize("plant", first(2, [HOISTING, *(random_plant(seed) for seed in range(3))]))
def test_the_command_lands_and_another_program_finds_none_that_is_shorter(plant: VaryingPlant) -> None:
    found, command, _ = proven(posed(plant, 2))
    starts, levels = (np.array([getattr(s, which) for s in command.segments]) for which in ("start", "level"))
    target = rest(plant, 2)
    np.testing.assert_allclose(landed(plant, starts, levels, command.maneuver_time), target, rtol=0.0, atol=1e-9)
    assert set(levels) == {-1.0, 1.0}
    assert found.upper is not None
    assert reaches(plant, target, found.upper * 1.02, (-1.0, 1.0))
    assert not reaches(plant, target, found.lower * 0.99, (-1.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 60))
def test_many_random_schedules(seed: int) -> None:
    plant = random_plant(seed)
    found, command, _ = proven(posed(plant, 2, -1, "1.5"), gap=1e-6)
    starts, levels = (np.array([getattr(s, which) for s in command.segments]) for which in ("start", "level"))
    np.testing.assert_allclose(landed(plant, starts, levels, command.maneuver_time), rest(plant, 2), rtol=0.0, atol=1e-6)
    assert not reaches(plant, rest(plant, 2), found.lower * 0.99, (-1.0, 1.5))


@pytest.mark.slow
def test_fuel_is_limited_and_more_of_it_is_never_slower() -> None:
    free, command, _ = proven(posed(HOISTING, 2))
    found = [proven(posed(HOISTING, 2, fuel=fuel))[0] for fuel in ("2.9", "2.2")]
    assert command.fuel() > 2.9
    assert all(after.lower > before.upper for before, after in pairwise([free, *found]))  # type: ignore[operator]
    assert found[1].command is not None
    assert found[1].command.fuel() == pytest.approx(2.2, rel=1e-14)
    assert proven(posed(HOISTING, 2, fuel="10"))[0].upper == free.upper


def test_the_response_ends_at_rest_and_is_the_constant_plants_where_nothing_varies() -> None:
    from relaxations.response import response

    _, command, _ = proven(posed(HOISTING, 2))
    times = np.linspace(0.0, 25.0, 501)
    y = varying_response(HOISTING, command, times)
    np.testing.assert_allclose(y[times >= command.end], 2.0, rtol=0.0, atol=1e-7)
    spring = VaryingPlant.of([0, 2], [SPRING_A] * 2, [SPRING_B] * 2, [SPRING_C] * 2)
    plant = LinearPlant.from_state_space(SPRING_A, SPRING_B, SPRING_C)
    np.testing.assert_allclose(varying_response(spring, command, times), response(plant, command, times), rtol=0.0, atol=1e-7)


# What is refused.


def test_a_rest_lasts_or_there_is_none() -> None:
    with pytest.raises(PlantError, match=r"none at 0 s: there the plant would move on, by 1 a second; .* not where the plant rests"):
        posed(VaryingPlant.of([0, 1], [[[0, 1], [-1, 0]], [[0, 1], [-2, 0]]], [[0, 1]] * 2, [[1, 0]] * 2))
    with pytest.raises(PlantError, match="no rest"):
        posed(VaryingPlant.of([0], [[[0, 1], [0, 0]]], [[0, 1]], [[0, 1]]))
    with pytest.raises(PlantError, match="ascend from 0"):
        VaryingPlant.of([0, 1, 1], [[[0]]] * 3, [[1]] * 3, [[1]] * 3)
    with pytest.raises(PlantError, match="as many matrices"):
        VaryingPlant.of([0, 1], [[[0]]], [[1]] * 2, [[1]] * 2)
    with pytest.raises(PlantError, match="moves no state"):
        VaryingPlant.of([0], [[[0]]], [[0]], [[1]])


@pytest.mark.slow
def test_scales_of_time_do_not_matter() -> None:
    # x'' = (1 + t/τ) u with u of 1/τ²: the closed form, τ times as long.
    time, _ = growing_time(1.0)
    for power in (-6, 6):
        tau = Fraction(10) ** power
        plant = VaryingPlant.of([0, 2 * tau], [[[0, 1], [0, 0]]] * 2, [[0, 1], [0, 3]], [[1, 0]] * 2)
        found, _, _ = proven(posed(plant, 1, -1 / tau**2, 1 / tau**2))
        assert found.upper == pytest.approx(time * float(tau), rel=1e-13)


def test_states_that_the_input_never_moves_are_dropped() -> None:
    A = [[0, 1, 5], [0, 0, 3], [0, 0, -1]]
    plant = VaryingPlant.of([0, 2], [A] * 2, [[0, 1, 0], [0, 3, 0]], [[1, 0, 2]] * 2)
    assert (plant.order, plant.A[0]) == (2, ((0, 1), (0, 0)))
    assert "1 of 3 states are not moved" in plant.notes[0]
    assert proven(posed(plant))[0].upper == proven(posed(GROWING))[0].upper


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"tail": True}, "tail"),
        ({"robustness": 1}, "robustness"),
        ({"sample_time": Fraction(0)}, "a sample time is more than 0"),
        ({"initial": (Fraction(1), Fraction(0), Fraction(0))}, "has 2 numbers, not 3"),
        ({"initial": (Fraction(1), Fraction(0))}, "at its final rest already"),
    ],
)
def test_what_a_varying_plant_is_not_moved_with(others: dict[str, object], said: str) -> None:
    with pytest.raises(ManeuverError, match=said):
        varying_problem(GROWING, Maneuver(Fraction(1), Limits.of(-1, 1), **others))  # type: ignore[arg-type]
    for refused, why in (
        (Limits.of(-1, 1, rate=(1, 2)), "limits of the slope contain 0"),
        (Limits(Fraction(-1), Fraction(1), pulses=0), "at least one pulse"),
        (Limits.of(-1, 1, deflection={"speed": 1}), "names 'speed'; of a plant that varies it may be that of output, output_rate"),
        (Limits.of(-1, 1, deflection={"output": "0.5"}), "deviates by 1 at 0 s: no command stays within 0.5"),
    ):
        with pytest.raises(ManeuverError, match=why):
            varying_problem(GROWING, Maneuver(Fraction(1), refused))
    with pytest.raises(ManeuverError, match="outside the limits"):
        posed(GROWING, lower="0.1")


def test_certificates_are_canonical_and_name_the_schedule() -> None:
    data = json.loads(proven(posed(HOISTING, 2))[2])
    assert data["task"]["plants"] == []
    assert data["task"]["schedule"]["instants"] == ["0", "1", "2", "3", "4"]
    assert len(data["lower"]["costate"][0][0]["coefficients"]) == HOISTING.order
