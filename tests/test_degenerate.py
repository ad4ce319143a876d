"""Degenerate optima with fewer switches than equations: they land, and are proven close to their closed forms."""

from __future__ import annotations

from fractions import Fraction
from math import pi, sqrt

import pytest
from problems import transfer, two_mass

from relaxations import certificates
from relaxations.bounds import Status, bracket, contacts
from relaxations.checking.claims import Outcome, check
from relaxations.degenerate import landing, settled
from relaxations.initial import from_output
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact
from relaxations.programs import GridSolution
from relaxations.proofs import minimum_time
from relaxations.refinement import Extremal, outline
from relaxations.sides import Proof

PI_SQUARED = "9.869604401089358618834490999876151135313699407240790626413349376220044822419205243001773403718552231824"


def started(plant: LinearPlant, start: tuple[Fraction | int, ...], displacement: int = 0) -> Problem:
    """|u| ≤ 1, from the output and its derivatives."""
    begin = from_output(plant, [Fraction(x) for x in start])
    return problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1), initial=begin))


def seen(asked: Problem) -> Extremal:
    """What a coarse grid makes of it."""
    dual = bracket(asked).dual
    if isinstance(dual, Extremal):
        return dual
    assert isinstance(dual, GridSolution)
    return outline(dual.problem, dual.costate, dual.maneuver_time, contacts(dual.problem, dual), dual.fuel)


def proven(asked: Problem) -> Proof:
    found = seen(asked)
    return settled(found.problem, certificates.task(asked), found)


CASES = {
    "spring over π² units": (problem([two_mass()], Maneuver(exact(PI_SQUARED), Limits.of(-1, 1))), sqrt(8) * pi, 2, 1e-10),
    "body on its switching curve": (started(transfer([1], [1, 0, 0])(), (Fraction(1, 2), -1)), 1.0, 1, 1e-12),
    "body on the other branch": (started(transfer([1], [1, 0, 0])(), (-2, 2)), 2.0, 1, 1e-12),
    "pendulum two units from rest": (started(transfer([1], [1, 0, 1])(), (2, 0)), pi, 1, 1e-12),
}


@pytest.mark.parametrize("name", CASES)
def test_the_command_is_proven_to_land_close_to_its_closed_form(name: str) -> None:
    asked, time, arcs, gap = CASES[name]
    found = landing(asked, seen(asked))
    assert found is not None
    assert len(found.levels) == arcs
    assert float(found.maneuver_time) == pytest.approx(time, rel=4e-16)
    upper, command = proven(asked).upper, proven(asked).command
    assert upper is not None
    assert command is not None
    assert 0 <= float(upper.claim / Fraction(time)) - 1 < gap
    assert command.maneuver_time == pytest.approx(float(upper.claim), rel=2e-16)
    assert [segment.level for segment in command.segments[:-1]] == [float(level) for level in reversed(found.levels)]
    assert command.segments[-1].level == 0.0


@pytest.mark.parametrize(
    ("name", "gap"),
    [("spring over π² units", 2e-11), ("body on its switching curve", 2e-12), ("pendulum two units from rest", 2e-12)],
)
def test_both_sides_are_proven(name: str, gap: float) -> None:
    asked, time, _, _ = CASES[name]
    found = minimum_time(asked)
    assert found.status is Status.PROVED, found.reason
    assert found.upper is not None
    assert found.lower <= time * (1 + 4e-16) <= found.upper * (1 + 4e-16)
    assert found.upper / found.lower - 1 < gap
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED


@pytest.mark.parametrize(
    "asked",
    [
        problem([two_mass()], Maneuver(exact(5), Limits.of(-1, 1))),  # regular: as many instants as equations
        problem([two_mass()], Maneuver(exact("9.87"), Limits.of(-1, 1))),  # near, and not there
        started(transfer([1], [1, 0, 1])(), (Fraction(1999, 1000), 0)),
    ],
)
def test_what_is_regular_is_no_such_command(asked: Problem) -> None:
    assert landing(asked, seen(asked)) is None
    assert proven(asked).upper is None


def test_limits_that_are_the_final_rest_leave_no_room() -> None:
    asked = problem([transfer([1], [1, 0, 1])()], Maneuver(Fraction(1), Limits.of(0, 1)))
    assert landing(asked, seen(asked)) is None
