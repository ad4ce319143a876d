"""What a command leaves in a box that it was not made for: proven, close to what is really left, and refused where it makes no sense."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from box_tasks import SERVO, TOW, TWIN, axis, forged, left, residual

from fmus.twins import twin_family
from relaxations.bounds import Bound
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Axis, Box, Family
from relaxations.robust.worst import worst_residual

STIFFNESS = axis("stiffness", "3/10")


def posed(displacement: str, *axes: Axis, family: Family | None = None) -> Problem:
    family = family or twin_family(TWIN, "x2", [a.name for a in axes], {})
    maneuver = Maneuver(Fraction(displacement), Limits.of(-1, 1), box=Box(axes, family, Fraction(1, 20)))
    return problem([family.member([a.nominal for a in axes])], maneuver)


def fastest(boxed: Problem, robustness: int) -> Bound:
    return minimum_time(problem(boxed.plants, replace(boxed.maneuver, box=None, robustness=robustness)))


@pytest.mark.parametrize(("displacement", "robustness"), [("5", 0), ("5", 1), ("5", 2), ("-1", 1)])
def test_what_is_proven_is_what_is_left_at_the_worst_stiffness(displacement: str, robustness: int) -> None:
    boxed = posed(displacement, STIFFNESS)
    bound = fastest(boxed, robustness)
    assert bound.command is not None
    found = worst_residual(boxed, bound.command)
    assert found is not None
    measured = max(abs(residual(bound, float(displacement), stiffness=k)) for k in np.linspace(0.7, 1.3, 31).tolist())
    # Both ends of the range are among the 31, and the worst place of these commands is one of them; peaks are sampled in time.
    assert measured * (1 - 1e-6) <= float(found.tolerance) <= measured * (1 + 1e-4)
    assert check(found.certificate).outcome is Outcome.PROVED


def test_a_smaller_tolerance_is_not_proven_of_the_same_command() -> None:
    boxed = posed("5", STIFFNESS)
    found = worst_residual(boxed, fastest(boxed, 0).command or Command(0.0, (), Tail(0.0)))
    assert found is not None

    def less(content: dict[str, Any]) -> None:
        content["task"]["box"]["tolerance"] = "0.1394"  # 0.02 % less

    assert forged(found.certificate, lambda content: None) is Outcome.PROVED
    assert forged(found.certificate, less) is not Outcome.PROVED


def test_two_parameters() -> None:
    boxed = posed("5", STIFFNESS, axis("mass_2", "1/10"))
    bound = fastest(boxed, 1)
    assert bound.command is not None
    found = worst_residual(boxed, bound.command)
    assert found is not None
    measured = max(residual(bound, 5.0, stiffness=k, mass_2=m) for k in (0.7, 1.0, 1.3) for m in (0.9, 1.0, 1.1))
    assert measured * (1 - 1e-6) <= float(found.tolerance) <= measured * 1.02


@pytest.mark.parametrize("family", [SERVO, TOW], ids=["no body at all", "damped"])
def test_plants_without_a_rigid_body(family: Family) -> None:
    boxed = posed("1/2", axis("k", "1/5"), family=family)
    bound = fastest(boxed, 0)
    assert bound.command is not None
    found = worst_residual(boxed, bound.command)
    assert found is not None
    measured = max(left(bound, family.member([Fraction(k, 100)]), 0.5)[0] for k in range(80, 121, 5))
    assert measured * (1 - 1e-6) <= float(found.tolerance) <= measured * 1.01


def test_the_command_of_the_box_keeps_its_own_tolerance() -> None:
    boxed = posed("5", STIFFNESS)
    command = minimum_time(boxed).command
    assert command is not None
    found = worst_residual(boxed, command)
    assert found is not None
    assert Fraction(498, 10000) < found.tolerance <= Fraction(5, 100)


def test_what_makes_no_sense_is_refused() -> None:
    boxed = posed("5", STIFFNESS)
    command = fastest(boxed, 0).command
    assert command is not None
    with pytest.raises(ManeuverError, match="needs a box"):
        worst_residual(problem(boxed.plants, replace(boxed.maneuver, box=None)), command)
    with pytest.raises(ManeuverError, match="constant pieces"):
        worst_residual(boxed, command.shifted(1.0))
    with pytest.raises(ManeuverError, match="constant pieces"):
        worst_residual(boxed, replace(command, segments=(Segment(0.0, 0.0, 0.1),)))


def test_a_command_that_misses_the_target_is_proven_nothing_of() -> None:
    boxed = posed("5", STIFFNESS)
    assert worst_residual(boxed, Command(6.0, (Segment(0.0, 1.0), Segment(3.0, -1.0)), Tail(0.0))) is None
