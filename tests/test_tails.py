"""Tails: their equations against an independent integration, their limits, their extremes."""

from __future__ import annotations

import numpy as np
import pytest
from independent import StateSpace

from relaxations.commands import Command, Segment, Tail
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time

PLANTS = {
    "real": LinearPlant.from_zeros_poles([-1], [0, 0, -3], 2),
    "pair": LinearPlant.from_zeros_poles([("-0.5", 2), ("-0.5", -2)], [0, 0, -2, ("-0.1", 3), ("-0.1", -3)], 1),
    "repeated": LinearPlant.from_zeros_poles([-1, -1], [("-0.2", 1), ("-0.2", -1), -4], 3),
    "feed_through": LinearPlant.from_zeros_poles([-1, -2], [("-0.2", 1), ("-0.2", -1)], 3),
}


@pytest.mark.parametrize("name", PLANTS)
def test_the_output_rests_while_the_input_decays(name: str) -> None:
    """The proven command, integrated by a method that knows nothing of zeros, leaves the output at its target from T on."""
    posed = problem([PLANTS[name]], Maneuver(exact("0.5"), Limits.of(-2, 2), tail=True))
    found = minimum_time(posed)
    assert found.command is not None
    assert found.command.tail.terms
    times = found.command.end + np.linspace(1e-6, 12.0, 40)
    output = StateSpace.of(PLANTS[name]).integrate(found.command, times)
    assert np.abs(output - 0.5).max() < 1e-9  # the integration's own accuracy over some 20 s
    course = found.command.tail(np.linspace(0.0, 30.0, 3001))
    assert course.max() <= 2.0 + 1e-12  # doubles of a proven command
    assert course.min() >= -2.0 - 1e-12


def test_rows_and_terms_agree() -> None:
    posed = problem([PLANTS["repeated"]], Maneuver(exact("0.5"), Limits.of(-2, 2), tail=True))
    coefficients, since = np.array([0.7, -1.3]), np.linspace(0.0, 5.0, 11)
    command = Command(1.0, (Segment(0.0, 1.0),), Tail(0.25, posed.tail.terms(coefficients)))
    assert command.tail(since) - 0.25 == pytest.approx(posed.tail.rows(since) @ coefficients, abs=1e-15)


def test_extremes_are_found_between_the_looks() -> None:
    posed = problem([PLANTS["pair"]], Maneuver(exact("0.5"), Limits.of(-2, 2), tail=True))
    coefficients = np.array([1.0, -0.4])
    fine = np.linspace(0.0, 20.0, 400_001)
    course = posed.tail.rows(fine) @ coefficients
    inner = fine[1:-1][(course[1:-1] - course[:-2]) * (course[2:] - course[1:-1]) <= 0.0][:4]
    found = posed.tail.peaks(coefficients)
    for instant in inner:
        assert np.abs(found - instant).min() < 2e-3  # of a parabola through samples 1/20 of a period apart


def test_a_tail_length_tightens_the_room_from_its_time_on() -> None:
    maneuver = Maneuver(exact("0.5"), Limits.of(-2, 3), tail=True, tail_length=(exact(1), exact("0.1")))
    tail = problem([PLANTS["repeated"]], maneuver).tail
    above, below = tail.room(np.array([0.5, 1.0, 2.0]))
    assert above[0] > above[1] == above[2] == pytest.approx(0.1 * min(tail.above, tail.below))
    assert below[0] > below[1] == below[2]
