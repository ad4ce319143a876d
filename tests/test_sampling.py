"""Commands on a controller's sample grid: the least number of samples, proven, and by another program; and that they land."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from forgery import forged
from independent import StateSpace, reachable_fraction
from proving import proven

from relaxations import sampling
from relaxations.bounds import Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response

TWO_MASS = LinearPlant.from_transfer([1], [2, 0, 4, 0, 0])
DAMPED = LinearPlant.from_transfer([1], [1, Fraction(1, 5), 1])
RIGID = LinearPlant.from_transfer([1], [1, 0, 0])
UNSTABLE = LinearPlant.from_transfer([1], [1, -1])
CASES = {
    "two masses": (TWO_MASS, 5, 0),
    "two masses, robust": (TWO_MASS, 5, 1),
    "damped": (DAMPED, Fraction(1, 2), 0),
    "rigid": (RIGID, 1, 0),
    "unstable": (UNSTABLE, Fraction(9, 10), 0),
}


def posed(
    plant: LinearPlant, displacement: Fraction | int, step: Fraction | str | None, robustness: int = 0, tail: bool = False
) -> Problem:
    limits = Limits(Fraction(-1), Fraction(1))
    sample_time = None if step is None else Fraction(step)
    return problem([plant], Maneuver(Fraction(displacement), limits, robustness=robustness, tail=tail, sample_time=sample_time))


def check_within(command: Command, step: float) -> None:
    for segment in command.segments:
        assert abs(segment.level) <= 1.0
        assert segment.slope == 0.0
        assert segment.start / step == pytest.approx(round(segment.start / step), abs=1e-9)


@pytest.mark.parametrize("step", ["1/4", "0.05"])
@pytest.mark.parametrize("name", CASES)
def test_no_fewer_samples_do_and_so_many_land(name: str, step: str) -> None:
    plant, displacement, robustness = CASES[name]
    found, command = proven(posed(plant, displacement, step, robustness))
    h = float(Fraction(step))
    assert found.lower == pytest.approx(found.upper, rel=1e-15), "the same number of samples"
    assert command.maneuver_time == found.upper
    assert command.maneuver_time / h == pytest.approx(round(command.maneuver_time / h), abs=1e-9)
    nominal = minimum_time(posed(plant, displacement, None, robustness))
    assert nominal.lower <= found.lower < nominal.lower + 3 * h, "what a grid costs here"
    check_within(command, h)
    if plant is not UNSTABLE:
        after = np.linspace(command.end, command.end + 30.0, 300)
        # The slowest of these motions is of size 5; levels are corrected to rounding.
        np.testing.assert_allclose(response(plant, command, after), float(displacement), rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(("name", "step"), [("two masses", "1/4"), ("two masses", "2.5"), ("damped", "1/4"), ("damped", "2")])
def test_another_program_finds_no_fewer_samples(name: str, step: str) -> None:
    plant, displacement, _ = CASES[name]
    found, _ = proven(posed(plant, displacement, step))
    h = float(Fraction(step))
    samples = round(found.lower / h)
    space = StateSpace.of(plant)
    if name == "two masses":  # its rest is no solution of A x + B u = 0 alone: the output is moved by rigid-body motion
        rest = np.linalg.lstsq(np.vstack([space.A, space.C]), np.append(np.zeros(len(space.B)), float(displacement)), rcond=None)[0]
        assert np.allclose(space.A @ rest, 0.0)
        object.__setattr__(space, "rest", lambda _: (rest, 0.0))
    fractions = [reachable_fraction(space, float(displacement), -1.0, 1.0, n * h, n) for n in (samples - 1, samples)]
    assert fractions[0] < 1.0 - 1e-6
    assert fractions[1] >= 1.0 - 1e-9


def test_a_minimum_that_is_a_whole_number_of_samples_is_proven_in_fractions() -> None:
    found, command = proven(posed(RIGID, 1, "0.1"))
    assert found.lower == found.upper == 2.0
    assert [(s.start, s.level) for s in command.segments] == [(0.0, 1.0), (1.0, -1.0)]
    assert found.certificate is not None
    data = json.loads(found.certificate)
    assert data["upper"]["free"] == []
    data["upper"]["segments"][1]["start"] = "1.1"
    assert check(forged(data)).outcome is Outcome.REFUTED


@pytest.mark.slow
def test_shorter_samples_come_closer_to_the_minimum_of_all_commands() -> None:
    nominal = minimum_time(posed(TWO_MASS, 5, None))
    ends = [proven(posed(TWO_MASS, 5, Fraction(2) ** -k))[0] for k in range(-1, 8)]
    uppers = [found.upper for found in ends if found.upper is not None]
    assert all(found.lower == found.upper for found in ends), "sample times that doubles hold"
    assert uppers == sorted(uppers, reverse=True), "a command on a grid is one on half of it too"
    assert nominal.upper is not None
    assert nominal.lower <= uppers[-1] <= nominal.upper + Fraction(1, 2**7)


def test_samples_longer_than_half_a_period_are_no_error() -> None:
    slow, quick = posed(TWO_MASS, 5, "2.5"), posed(TWO_MASS, 5, "2.2")
    assert any("longer than half the period of a mode, 2.2" in note for note in slow.notes)
    assert not any("half the period" in note for note in quick.notes)
    assert proven(slow)[0].lower >= 4 * 2.5, "four equations"


def test_more_samples_than_a_program_may_have_are_bracketed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 400)
    nominal, (found, command) = minimum_time(posed(TWO_MASS, 5, None)), proven(posed(TWO_MASS, 5, "0.01"))
    assert nominal.lower <= found.lower <= nominal.lower + 0.01
    assert found.upper is not None
    assert found.lower < found.upper <= found.lower + 0.08
    check_within(command, 0.01)


def test_what_is_out_of_reach_of_so_many_samples_has_no_upper_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 5)
    found = minimum_time(posed(TWO_MASS, 5, "1"))
    assert found.status is Status.BRACKETED
    assert found.upper is None
    assert found.reason is not None
    assert "no command was found of up to" in found.reason
    assert found.lower > 5.0


def test_an_output_rest_and_no_time_at_all_are_refused() -> None:
    with pytest.raises(ManeuverError, match="input that decays"):
        posed(LinearPlant.from_transfer([1, 1], [1, 1, 1]), Fraction(1, 2), "0.1", tail=True)
    with pytest.raises(ManeuverError, match="more than 0"):
        posed(RIGID, 1, "0")
