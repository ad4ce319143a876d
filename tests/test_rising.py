"""The slope of the reachable fraction by the time of a move: what multipliers say, against programs a little before and after."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from box_tasks import TWIN, axis

from fmus.twins import twin_family
from relaxations import posing, programs
from relaxations.bounds import Settings, exponent_of, first_looks, instants
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.prices import NONE
from relaxations.robust.boxes import Box

FAMILY = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})
SPEED = {"output_rate": Fraction("0.4")}
RATE = Fraction(-3), Fraction(3)
START = tuple(Fraction(x) for x in ("0.1", "0", "0.05", "0"))
ASIDE = 1e-4  # of T
CLOSE = {"rate": 0.05}  # what a grid's ramps, whose ends lie on nodes, leave open; else 1 %

TASKS: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {
    "speed": ({"deflection": SPEED}, {}, 4.7),
    "fuel and speed": ({"deflection": SPEED, "fuel": Fraction("1.5")}, {}, 4.7),
    "speed and a start": ({"deflection": SPEED}, {"initial": START}, 4.5),
    "rate": ({"rate": RATE}, {}, 4.6),
    "rate and speed": ({"rate": RATE, "deflection": SPEED}, {}, 5.1),
    "a box and speed": ({"deflection": SPEED}, {"box": Box((axis("stiffness", "0.1"),), FAMILY, Fraction("0.05"))}, 4.8),
}


def posed(name: str) -> Problem:
    limits, others, _ = TASKS[name]
    return problem([FAMILY.member([Fraction(1)])], Maneuver(Fraction(1), Limits(Fraction(-1), Fraction(1), **limits), **others))


def solved(task: Problem, time: float) -> programs.GridSolution:
    return programs.solve(posing.build(task, instants(task, time, Settings(least_cells=300)), first_looks(task)))


@pytest.mark.parametrize("name", TASKS)
def test_multipliers_know_the_slope(name: str) -> None:
    task, time = posed(name), TASKS[name][2]
    here, before, after = (solved(task, time * shift) for shift in (1.0, 1.0 - ASIDE, 1.0 + ASIDE))
    seen = math.log(after.fraction / before.fraction) / math.log((1.0 + ASIDE) / (1.0 - ASIDE))
    assert exponent_of(here) == pytest.approx(seen, rel=CLOSE.get(name.split()[0], 0.01))


@pytest.mark.parametrize("name", ["speed", "rate and speed"])
def test_without_the_prices_of_outputs_and_slopes_it_is_another(name: str) -> None:
    here = solved(posed(name), TASKS[name][2])
    assert abs(exponent_of(replace(here, prices=NONE)) / exponent_of(here) - 1.0) > 0.5
