"""The exact response a_vs_b SciPy: matrix exponentials for segments and slopes, Runge-Kutta for tails."""

from __future__ import annotations

import numpy as np
import pytest
from independent import StateSpace
from problems import FACTS, Known, chain, two_mass

from relaxations.bounds import bracket
from relaxations.commands import Command, Segment, Tail, TailTerm
from relaxations.moments import Basis
from relaxations.plants import LinearPlant
from relaxations.response import jumps, moments, response

PLANTS = {
    "two_mass": two_mass(),
    "two_mass damped": two_mass(stiffness="0.7", damping="0.3", mass_2="2.5"),
    "chain_5": chain(5),
    "triple pole": LinearPlant.from_transfer([1, 2], [1, 3, 3, 1]),
    "repeated pair": LinearPlant.from_zeros_poles([], [("-0.2", 1), ("-0.2", -1), ("-0.2", 1), ("-0.2", -1), 0], 1),
    "feed-through": LinearPlant.from_transfer([1, 2, 3], [1, "0.1", 1]),
    "unstable": LinearPlant.from_transfer([1], [1, "-0.3", "0.5"]),
    "no states": LinearPlant.from_transfer([3], [2]),
}
STEPS = Command(3.0, (Segment(0.0, 1.0), Segment(0.7, -0.5), Segment(2.2, 0.25)), Tail(0.1))
SLOPES = Command(3.0, (Segment(0.4, 0.0, 2.0), Segment(1.0, 1.0, -0.5), Segment(3.0, -1.0)), Tail(0.1))
TIMES = np.unique(np.concatenate([np.linspace(0.0, 8.0, 33), STEPS.breakpoints, SLOPES.breakpoints]))
ROUNDING = 2e-12  # of the largest value: the matrix exponential's own error over a dozen steps


@pytest.mark.parametrize("name", [name for name in PLANTS if name != "no states"])
@pytest.mark.parametrize("command", [STEPS, SLOPES], ids=["steps", "slopes"])
@pytest.mark.parametrize("rest", [0.0, 0.3])
def test_segments_a_vs_b_matrix_exponentials(name: str, command: Command, rest: float):
    plant = PLANTS[name]
    space = StateSpace.of(plant)
    expected = space.output(space.states(command, TIMES, rest), command(TIMES, rest) - rest)
    ours = response(plant, command, TIMES, rest=rest)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=ROUNDING * max(1.0, np.abs(expected).max()))


TAILS = {
    "real": (TailTerm(-0.8 + 0j, 0, 0.5 + 0j),),
    "pair": (TailTerm(-0.3 + 1.5j, 0, 0.5 - 0.2j),),
    "repeated": (TailTerm(-0.8 + 0j, 0, 0.5 + 0j), TailTerm(-0.8 + 0j, 1, -0.4 + 0j), TailTerm(-0.8 + 0j, 2, 0.3 + 0j)),
    "repeated pair": (TailTerm(-0.2 + 1j, 0, 0.5 - 0.2j), TailTerm(-0.2 + 1j, 1, -0.1 + 0.3j)),  # in resonance with a repeated pair
    "pole -1": (TailTerm(-1.0 + 0j, 1, 0.7 + 0j),),  # in resonance with a triple pole
    "next to a pole": (TailTerm(-1.0 - 1e-10 + 0j, 1, 0.7 + 0j),),
    "fast": (TailTerm(-50.0 + 0j, 0, 1.0 + 0j),),
}


@pytest.mark.parametrize("tail", TAILS)
@pytest.mark.parametrize("name", ["two_mass", "triple pole", "repeated pair", "feed-through", "unstable"])
def test_tails_a_vs_b_runge_kutta(name: str, tail: str):
    plant = PLANTS[name]
    command = Command(1.5, (Segment(0.0, 1.0), Segment(0.7, -0.5, 0.2)), Tail(0.1, TAILS[tail]))
    times = np.array([0.5, 1.5, 1.6, 2.5, 4.0, 7.0])
    expected = StateSpace.of(plant).integrate(command, times)
    # Runge-Kutta at a relative 1e-12 a step; the unstable plant amplifies what it leaves by e^{0.15 · 7}.
    np.testing.assert_allclose(response(plant, command, times), expected, rtol=0, atol=2e-10 * max(1.0, np.abs(expected).max()))


def test_a_plant_without_states_is_its_gain():
    np.testing.assert_allclose(response(PLANTS["no states"], SLOPES, TIMES, rest=0.3), 1.5 * (SLOPES(TIMES, 0.3) - 0.3), rtol=1e-15)


def test_at_a_jump_a_fed_through_output_has_jumped():
    plant = LinearPlant.from_transfer([2, 1], [1, 1])
    assert response(plant, STEPS, [0.0])[0] == 2.0


def test_every_output_has_its_own_response():
    plant = two_mass()
    parts = {name: response(plant, STEPS, TIMES, name) for name in plant.numerators}
    np.testing.assert_allclose(parts["spring"], parts["position_2"] - parts["position_1"], atol=1e-14 * np.abs(parts["position_1"]).max())
    rate = np.gradient(response(plant, STEPS, np.linspace(4, 5, 1001)), 1e-3)[1:-1]
    np.testing.assert_allclose(rate, response(plant, STEPS, np.linspace(4, 5, 1001), "output_rate")[1:-1], atol=1e-6)  # h²/6 · y'''


def test_a_shifted_command_gives_a_shifted_response():
    shifted = response(two_mass(), SLOPES.shifted(0.25), TIMES + 0.25)
    np.testing.assert_allclose(shifted, response(two_mass(), SLOPES, TIMES), atol=1e-13)


def test_jumps_add_up_to_the_final_input_and_leave_no_slope():
    table = jumps(SLOPES, 0.3)
    np.testing.assert_array_equal(table[:, 0], [0.4, 1.0, 3.0, 3.4])
    assert table[:, 2].sum() == 0.0
    grown = sum(level + slope * (SLOPES.end - instant) for instant, level, slope in table)
    assert grown == pytest.approx(SLOPES.tail.steady - 0.3, abs=1e-15)


@pytest.mark.parametrize("known", [known for known in FACTS if not known.robustness], ids=lambda known: known.name)
def test_the_time_optimal_command_comes_to_rest_and_stays(known: Known):
    plant, command = known.plant(), bracket(known.problem()).command
    assert command is not None
    displacement = float(known.maneuver.displacement)
    times = np.linspace(command.end, command.end + 30.0, 301)
    # The last digit of a switch time, times the largest speed, on each of two dozen switches; it drifts for 30 s.
    np.testing.assert_allclose(response(plant, command, times), displacement, rtol=0, atol=1e-10)
    target = known.problem().sets[0].target
    np.testing.assert_allclose(moments(Basis(plant.poles), command, command.end + 0.0), target, atol=1e-11)


def test_nothing_moves_before_the_command():
    late = STEPS.shifted(2.0)
    np.testing.assert_array_equal(response(two_mass(), late, [0.0, 1.0, 2.0]), 0.0)
