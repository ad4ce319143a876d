"""Commands of a sampled actuator: the least number of samples by another program, and that they land."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from independent import StateSpace, reachable_fraction

from relaxations import sampling
from relaxations.commands import Command
from relaxations.errors import SolverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.sampling import sampled_minimum

TWO_MASS = LinearPlant.from_transfer([1], [2, 0, 4, 0, 0])
DAMPED = LinearPlant.from_transfer([1], [1, Fraction(1, 5), 1])
RIGID = LinearPlant.from_transfer([1], [1, 0, 0])
CASES = {
    "two masses": (TWO_MASS, 5, 0),
    "two masses, robust": (TWO_MASS, 5, 1),
    "damped": (DAMPED, Fraction(1, 2), 0),
    "rigid": (RIGID, 1, 0),
}


def posed(plant: LinearPlant, displacement: Fraction | int, robustness: int = 0, tail: bool = False) -> Problem:
    limits = Limits(Fraction(-1), Fraction(1))
    return problem([plant], Maneuver(Fraction(displacement), limits, robustness=robustness, tail=tail))


def check_within(command: Command, step: float) -> None:
    for segment in command.segments:
        assert abs(segment.level) <= 1.0
        assert segment.slope == 0.0
        assert segment.start / step == pytest.approx(round(segment.start / step), abs=1e-9)


@pytest.mark.parametrize("step", [0.25, 0.05])
@pytest.mark.parametrize("name", CASES)
def test_the_command_lands_on_the_grid_and_within_the_limits(name: str, step: float) -> None:
    plant, displacement, robustness = CASES[name]
    asked = posed(plant, displacement, robustness)
    least = minimum_time(asked).lower
    found = sampled_minimum(asked, step, least)
    assert found.command.maneuver_time == pytest.approx(found.samples * step, rel=1e-15)
    assert found.command.maneuver_time >= least
    assert found.command.maneuver_time < least + 3 * step, "what a grid costs here"
    check_within(found.command, step)
    after = np.linspace(found.command.end, found.command.end + 30.0, 300)
    # The slowest of these motions is of size 5; where the time is not a tie, levels are corrected to rounding.
    np.testing.assert_allclose(response(plant, found.command, after), float(displacement), rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("name", ["two masses", "damped"])
def test_another_program_finds_no_fewer_samples(name: str) -> None:
    plant, displacement, _ = CASES[name]
    step = 0.25
    found = sampled_minimum(posed(plant, displacement), step)
    space = StateSpace.of(plant)
    if name == "two masses":  # its rest is no solution of A x + B u = 0 alone: the output is moved by rigid-body motion
        rest = np.linalg.lstsq(np.vstack([space.A, space.C]), np.append(np.zeros(len(space.B)), float(displacement)), rcond=None)[0]
        space_rest = rest, 0.0
        assert np.allclose(space.A @ rest, 0.0)
        object.__setattr__(space, "rest", lambda _: space_rest)
    fractions = [reachable_fraction(space, float(displacement), -1.0, 1.0, n * step, n) for n in (found.samples - 1, found.samples)]
    assert fractions[0] < 1.0 - 1e-6
    assert fractions[1] >= 1.0 - 1e-9


def test_where_the_minimum_is_a_whole_number_of_samples_the_grid_costs_nothing() -> None:
    found = sampled_minimum(posed(RIGID, 1), 0.1, least=1.9999999999999998)
    assert found.samples == 20
    assert [(s.start, s.level) for s in found.command.segments] == [(0.0, 1.0), (pytest.approx(1.0), -1.0)]


def test_a_bound_saves_programs_and_changes_nothing() -> None:
    asked = posed(TWO_MASS, 5)
    blind, told = sampled_minimum(asked, 0.25), sampled_minimum(asked, 0.25, minimum_time(asked).lower)
    assert blind.samples == told.samples
    assert told.programs < blind.programs


def test_an_output_rest_is_refused() -> None:
    with pytest.raises(SolverError, match="input that decays"):
        sampled_minimum(posed(LinearPlant.from_transfer([1, 1], [1, 1, 1]), Fraction(1, 2), tail=True), 0.1)


def test_a_search_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 30)
    with pytest.raises(SolverError, match="at most 30 samples"):
        sampled_minimum(posed(TWO_MASS, 5), 0.01)
