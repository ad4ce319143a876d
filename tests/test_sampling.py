"""Commands on a controller's sample grid: the least number of samples, proven, and by another program; and that they land."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from forgery import forged
from independent import StateSpace, reachable_fraction

from relaxations import sampling
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
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


def proven(asked: Problem) -> tuple[Bound, Command]:
    """The bracket, both sides of which the checker has accepted."""
    found = minimum_time(asked)
    assert found.status is Status.PROVED, found.reason
    assert found.certificate is not None
    assert found.command is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    return found, found.command


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


# The certificate: its new terms, and what becomes of them when they are changed.


@pytest.fixture(scope="module")
def certificate() -> bytes:
    found = minimum_time(posed(TWO_MASS, 5, "1/4")).certificate
    assert found is not None
    return found


def test_the_claim_says_what_commands_it_is_about(certificate: bytes) -> None:
    said = claim(check(certificate))
    assert "u is constant on each [k h, (k + 1) h), h = 0.25 s, and T is a whole number of h." in said
    assert "no command within the limits that is constant over each sample does this in less than 9" in said


@pytest.mark.parametrize(
    ("where", "value", "outcome"),
    [
        (("task", "limits", "sample_time"), None, Outcome.REFUTED),  # of all commands some are faster than 9 s
        (("task", "limits", "sample_time"), "0.05", Outcome.REFUTED),  # so are some on a finer grid
        (("task", "limits", "sample_time"), "0.2", Outcome.MALFORMED),  # on which the command is not
        (("task", "limits", "sample_time"), "0", Outcome.MALFORMED),
        (("task", "limits", "sample_time"), "-0.25", Outcome.MALFORMED),
        (("task", "rest"), "output", Outcome.MALFORMED),
        (("claim", "lower"), "9.25", Outcome.REFUTED),
        (("claim", "lower"), "9.01", Outcome.REFUTED),  # a sample more would be refuted too
        (("claim", "lower"), "8.99", Outcome.PROVED),  # weaker
        (("claim", "upper"), "8.99", Outcome.REFUTED),
        (("claim", "upper"), "9.1", Outcome.PROVED),
        (("upper", "maneuver_time"), "9.01", Outcome.MALFORMED),
        (("upper", "segments", 1, "start"), "0.26", Outcome.MALFORMED),
        (("upper", "free", 0), ["time", 0, 0], Outcome.MALFORMED),
        (("upper", "free", 0), ["start", 1, 0], Outcome.MALFORMED),
    ],
)
def test_a_changed_certificate_proves_nothing_false(
    certificate: bytes, where: tuple[str | int, ...], value: object, outcome: Outcome
) -> None:
    data = json.loads(certificate)
    place = data
    for step in where[:-1]:
        place = place[step]
    place[where[-1]] = value
    assert check(forged(data)).outcome is outcome
