"""The bracket of the minimum time: known answers, pairs that must differ, random plants, and what must not matter."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from independent import StateSpace, reachable_fraction
from problems import FACTS, IMPOSSIBLE, KNOWN, Known, chain, two_mass
from random_maneuvers import random_maneuver

from relaxations import bounds
from relaxations.bounds import Bound, Settings, Status, bracket
from relaxations.duality import lower_bound
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import Exact, LinearPlant, exact
from relaxations.refinement import Failure
from relaxations.response import moments, response

GAP = 1e-11  # relative; rounding of the support integral times the condition of the costate, at 24 poles 5e-14
transfer, zeros_poles = LinearPlant.from_transfer, LinearPlant.from_zeros_poles


def bracketed(plant: LinearPlant, displacement: Exact, limits: tuple[Exact, Exact] = (-1, 1), rest: Exact = 0) -> Bound:
    return bracket(problem([plant], Maneuver(exact(displacement), Limits.of(*limits), exact(rest))))


def upper_of(found: Bound) -> float:
    assert found.upper is not None, found.reason
    return found.upper


@pytest.mark.parametrize("known", KNOWN, ids=lambda k: k.name)
def test_known_minimum_times(known: Known):
    found = bracket(known.problem())
    assert known.time is not None
    upper = upper_of(found)
    slack = known.error + 1e-13 * known.time  # the digits given, and rounding of T
    assert found.lower - slack <= known.time <= upper + slack
    assert abs(upper - known.time) <= slack
    assert found.gap is not None
    assert 0.0 <= found.gap <= GAP
    assert found.programs <= 10
    assert found.status is Status.BRACKETED  # two floats are no proof
    assert found.command is not None
    assert found.command.maneuver_time == upper
    assert found.switches == len(found.command.segments) - 1


@pytest.mark.parametrize("known", IMPOSSIBLE, ids=lambda k: k.name)
def test_impossible_tasks_have_no_upper_side(known: Known):
    found = bracket(known.problem())
    assert found.upper is None
    assert found.command is None
    assert found.gap is None
    assert found.lower > 1.0
    assert found.reason is not None
    assert "no command was found" in found.reason


def test_a_plant_without_states_needs_no_time():
    found = bracketed(transfer([3], [2]), 1)
    assert (found.lower, found.upper, found.gap) == (0.0, 0.0, 0.0)
    assert found.command is not None
    assert found.command(0.0) == pytest.approx(2 / 3, rel=1e-15)


# Paired instances: the same settings, a little harder, must take longer.


@pytest.mark.parametrize("known", [k for k in FACTS if k.plant().order <= 12], ids=lambda k: k.name)
def test_a_little_less_force_takes_longer_and_a_little_more_is_faster(known: Known):
    lower, upper = (exact(x) for x in known.limits)
    hair = exact("0.999")
    tight = upper_of(bracket(replace(known, limits=(lower * hair, upper * hair)).problem()))
    wide = bracket(replace(known, limits=(lower / hair, upper / hair)).problem())
    assert known.time is not None
    # Each side by more than both brackets together: a thousandth of force is at least 1e-5 of time (chains: T ~ F^(-1/24)).
    assert upper_of(wide) < known.time * (1 - 1e-5)
    assert tight > known.time * (1 + 1e-5)


def test_a_little_further_takes_longer():
    times = [upper_of(bracketed(two_mass(), d)) for d in ("0.999", 1, "1.001", 5, "5.001")]
    assert all(a < b for a, b in itertools.pairwise(times))


def test_more_robust_takes_longer():
    times = [upper_of(bracket(replace(FACTS[0], robustness=n).problem())) for n in (0, 1, 2, 3)]
    assert all(a < b for a, b in itertools.pairwise(times))


def test_two_plants_take_longer_than_either():
    task = Maneuver(exact("0.5"), Limits.of(-1, 1))
    plants = [transfer([1], [1, 0, 1]), transfer([2], [1, 0, 2])]
    alone = [upper_of(bracket(problem([plant], task))) for plant in plants]
    found = bracket(problem(plants, task))
    assert found.lower > max(alone)
    assert found.gap is not None
    assert found.gap <= GAP
    assert found.command is not None
    for plant in plants:  # the one command stops both
        after = np.linspace(found.command.end, found.command.end + 10, 50)
        np.testing.assert_allclose(response(plant, found.command, after), 0.5, atol=1e-12)


# What must not matter.


@pytest.mark.parametrize("seed", range(4))
def test_the_mirrored_task_takes_the_same_time(seed: int):
    case = random_maneuver(seed)
    low, high = case.limits
    mirrored = replace(case, displacement=-case.displacement, limits=(-high, -low), rest=-case.rest)
    assert upper_of(bracket(mirrored.problem())) == pytest.approx(upper_of(bracket(case.problem())), rel=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_where_the_input_counts_from_does_not_matter(seed: int):
    case = random_maneuver(seed)
    low, high = case.limits
    shifted = replace(case, limits=(low + 7, high + 7), rest=case.rest + 7)
    assert upper_of(bracket(shifted.problem())) == pytest.approx(upper_of(bracket(case.problem())), rel=1e-10)


@pytest.mark.parametrize("output", [1, 2])
def test_which_mass_is_the_output_does_not_matter_to_a_rest_of_the_state(output: int):
    assert upper_of(bracketed(two_mass(output), 1)) == pytest.approx(4.2178665105, abs=5e-11)


# Random plants.


@pytest.mark.parametrize("seed", range(12))
def test_random_maneuvers(seed: int):
    case = random_maneuver(seed)
    posed = case.problem()
    found = bracket(posed)
    upper, command = upper_of(found), found.command
    assert command is not None
    # The bracket, before it is clipped: a costate that claims more than a command needs would be an error of one of them.
    assert found.lower <= upper
    assert lower_bound(posed, found.costate, upper) <= upper * (1 + 1e-12)
    assert found.gap is not None
    assert found.gap <= 1e-10, found.reason  # nine equations of neighbouring real poles leave 2e-11
    # The command is admissible, exactly, and counts from its rest.
    low, high = (float(x) for x in case.limits)
    assert all(low <= segment.level <= high for segment in command.segments)
    # It lands: our moments, and by matrix exponentials in another basis.
    target = posed.sets[0]
    size = np.abs(target.basis.rows(np.linspace(0, upper, 200))).max(axis=1) * upper * (high - low)
    assert np.abs((moments(target.basis, command, command.end, posed.rest) - target.target) / size).max() < 1e-9
    space = StateSpace.of(case.plant)
    _, hold = space.rest(float(case.displacement))
    after = np.linspace(command.end, command.end + 30.0, 61)
    outputs = space.output(space.states(command, after, posed.rest), command(after, posed.rest) - posed.rest)
    np.testing.assert_allclose(outputs, float(case.displacement), rtol=1e-9)
    assert command.tail.steady == pytest.approx(hold + float(case.rest), abs=1e-12)
    # No staircase does it in less time (that would refute the lower side), and one does it in little more.
    if not case.robustness:
        args = (space, float(case.displacement), posed.lower, posed.upper)
        assert reachable_fraction(*args, 0.995 * found.lower, 150) < 1.0
        assert reachable_fraction(*args, 1.05 * upper, 150) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 230))
def test_many_random_maneuvers(seed: int):
    test_random_maneuvers(seed)


# Awkward plants: each was wrong once, or could be.


AWKWARD_PLANTS = {
    "a long move": (two_mass(), "1e4", 1e-12),
    "a short move": (two_mass(), "1e-3", 1e-11),
    "stiff: 1e-3 and 1e4 rad/s": (zeros_poles([], ["-0.001", -10_000], 10), "0.5", GAP),
    "stiff: four decades each": (zeros_poles([], ["-0.001", -1, -1000, -10_000], 10_000), "0.5", GAP),
    "a fast damped mode": (zeros_poles([], [0, 0, (-1, 1000), (-1, -1000)], 1_000_000), 5, GAP),
    "a repeated pair": (zeros_poles([], [(0, 1), (0, -1)] * 2 + [0, 0], 1), 1, GAP),
    "a damped pair three times": (zeros_poles([], [("-0.1", 1), ("-0.1", -1)] * 3 + [0, 0], 1), 1, GAP),
    "a real pole eight times": (zeros_poles([], [-1] * 8, 1), "0.5", 1e-10),
    "twelve poles": (
        zeros_poles([], [0, 0] + [(-exact(w) / 100, s * exact(w)) for w in (1, "2.3", "3.1", "4.7", "6.3") for s in (1, -1)], 1000),
        1,
        GAP,
    ),
    "unstable": (transfer([1], [1, 0, -1, 0, 0]), 1, GAP),
    "unstable and fast": (zeros_poles([], [100, -1], 100), "0.5", GAP),
    "unstable pair": (zeros_poles([], [(1, 10), (1, -10), -1], 100), "0.5", GAP),
    "feed-through": (transfer([1, 2, 3], [1, "0.1", 1]), 1, GAP),
    "feed-through and integrator": (transfer([1, 0, 3], [1, 1, 1, 0]), 1, GAP),
    "zero on the right": (transfer([-1, 1], [1, "0.2", 1]), "0.5", GAP),
    "hidden mode": (transfer([1, 0, 1], [1, 0, 1, 0, 0]), 1, GAP),
    # In modal coordinates nearly equal poles cancel, as 1/distance for each of them: a frame keeps the digits.
    "nearly equal real poles": (zeros_poles([], [0, -1, "-1.000001"], 1), 1, GAP),
    "nearly equal pairs": (zeros_poles([], [0, 0, (0, 1), (0, -1), (0, "1.00001"), (0, "-1.00001")], 1), 1, GAP),
    "nearly an integrator": (zeros_poles([], [0, "-1e-6"], 1), 1, GAP),
}


@pytest.mark.parametrize("name", AWKWARD_PLANTS)
def test_awkward_plants_are_bracketed(name: str):
    plant, displacement, gap = AWKWARD_PLANTS[name]
    found = bracketed(plant, displacement)
    assert found.gap is not None
    assert found.gap <= gap
    assert found.switches is not None, found.reason
    assert found.command is not None
    assert found.dual is not None
    assert lower_bound(found.dual.problem, found.dual.costate, found.lower) <= upper_of(found) * (1 + gap)


@pytest.mark.parametrize(("lower", "upper"), [("-0.3", "0.7"), ("-0.001", 1), (-1, "0.001")])
@pytest.mark.parametrize("displacement", [5, -5])
def test_unequal_limits(lower: Exact, upper: Exact, displacement: int):
    found = bracketed(two_mass(), displacement, (lower, upper))
    assert found.gap is not None
    assert found.gap <= 1e-10  # the short arcs are a thousandth of the move
    # The rigid body alone is a lower bound: T ≥ √(2 m Δ (a + b)/(a b)), m = 2.
    a, b = float(exact(upper)), -float(exact(lower))
    assert found.lower >= np.sqrt(4 * 5 * (a + b) / (a * b)) * (1 - 1e-12)


def test_nearly_equal_poles_approach_the_repeated_one():
    double = upper_of(bracketed(zeros_poles([], [0, -1, -1], 1), 1))
    near = bracketed(zeros_poles([], [0, -1, "-1.0001"], 1), 1)
    assert upper_of(near) == pytest.approx(double, abs=2e-4)
    assert upper_of(near) != double


# When refinement gives up, the grid's staircase is the command.


def test_without_refinement_the_staircase_is_a_command_and_the_reason_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bounds, "refine", lambda *_: Failure("not today"))
    posed = problem([two_mass()], Maneuver(exact(5), Limits.of("-0.9", 1), exact("0.1")))
    found = bracket(posed)
    assert found.switches is None
    assert found.reason is not None
    assert "not today" in found.reason
    assert found.command is not None
    levels = [s.level for s in found.command.segments]
    assert min(levels) >= -0.9
    assert max(levels) <= 1.0
    after = np.linspace(found.command.end, found.command.end + 20, 100)
    np.testing.assert_allclose(response(two_mass(), found.command, after, rest=0.1), 5.0, atol=1e-6)  # the solver's 1e-10 drifts
    assert found.gap is not None
    assert 0 < found.gap < 1e-2


def test_settings_are_obeyed():
    known = FACTS[0].problem()
    assert bracket(known, Settings(programs=1)).programs == 1
    coarse = bracket(known, Settings(least_cells=40, cells_per_equation=5))
    assert coarse.upper == pytest.approx(4.2178665105, abs=5e-11)  # the grid is only a start


def test_the_same_problem_gives_the_same_bits():
    first, second = (bracket(problem([chain(4)], Maneuver(exact(2), Limits.of(-1, 1)))) for _ in range(2))
    assert first.command == second.command
    assert first.lower == second.lower
    assert first.costate.tobytes() == second.costate.tobytes()
