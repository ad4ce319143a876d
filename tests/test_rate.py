"""Limits of the input's slope: commands made of ramps, known minimum times, both sides proven; lies about them."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
import proving
import pytest
from independent_limits import Limited
from problems import transfer, two_mass

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.proofs import COURSED, minimum_time
from relaxations.response import response

PLANTS = {"spring": two_mass, "rigid": transfer([1], [1, 0, 0]), "integrator": transfer([1], [1, 0]), "lag": transfer([1], [1, 1])}


@cache
def bound(plant: str, displacement: str, rate: tuple[str, str] | None, fuel: str | None = None, high: str = "1") -> Bound:
    limits = Limits.of(-1, high, fuel, None, rate)
    return minimum_time(problem([PLANTS[plant]()], Maneuver(Fraction(displacement), limits)))


def sides(found: Bound) -> tuple[float, float]:
    return proving.sides(found, 2 * COURSED)


def holds(time: float, found: Bound) -> bool:
    lower, upper = sides(found)
    return lower * (1 - 1e-14) <= time <= upper * (1 + 1e-14)


def test_an_integrator_goes_up_and_down_a_trapezoid() -> None:
    # ∫u = 2 with |u| ≤ 1 and slopes of 4: T = 2 + 1/4; slopes of 2 and -4: T = 2 + 1/4 + 1/8.
    assert holds(2.25, bound("integrator", "2", ("-4", "4")))
    assert holds(2 + 0.25 + 0.125, bound("integrator", "2", ("-4", "2")))
    # Too short for the limit of the input: a triangle of area 1/16 = r (T/2)².
    assert holds(2 * sqrt(1 / 16 / 4), bound("integrator", "0.0625", ("-4", "4")))


def test_a_rigid_body_of_limited_jerk() -> None:
    # Ramps of 1/4 s at both ends, of 1/2 s in the middle: Δ = a (T/2) (T/2 - 1/4) = 1 for T/2 = 1/8 + √(1/64 + 1).
    assert holds(2 * (0.125 + sqrt(1 / 64 + 1)), bound("rigid", "1", ("-4", "4")))


def test_the_two_mass_spring_of_limited_rate() -> None:
    lower, upper = sides(bound("spring", "1", ("-10", "10")))  # 4.321 s from grids, both sides agreeing
    assert 4.3205 < lower < upper < 4.3215


@pytest.mark.slow
def test_the_two_mass_spring_of_low_rate() -> None:
    lower, upper = sides(bound("spring", "1", ("-3", "3")))
    assert 4.5875 < lower < upper < 4.5885


def test_a_plant_that_is_held_ends_at_what_holds_it() -> None:
    # 1/(s+1) to 1/2: up to 1 with the slope 4, and down again to 1/2 at T; the input never jumps.
    found = bound("lag", "0.5", ("-4", "4"))
    lower, upper = sides(found)
    free = bound("lag", "0.5", None)
    assert free.lower < lower
    assert found.command is not None
    assert found.command.segments[0].level == 0.0
    last = found.command.segments[-1]
    assert last.level + last.slope * (found.command.end - last.start) == pytest.approx(0.5, abs=1e-12)
    after = response(PLANTS["lag"](), found.command, np.linspace(upper, upper + 5, 50))
    assert after == pytest.approx(np.full(50, 0.5), abs=1e-9)


@pytest.mark.slow
def test_lower_rates_take_no_less_time_and_high_ones_come_to_nothing() -> None:
    free = bound("rigid", "1", None)
    times = [sides(bound("rigid", "1", (f"-{rate}", rate))) for rate in ("100", "16", "4")]
    assert all(later[0] > earlier[1] for earlier, later in pairwise(times))
    assert free.upper is not None
    assert free.lower < times[0][0] < free.upper * 1.01


@pytest.mark.slow
def test_fuel_and_rate_together() -> None:
    found = bound("rigid", "1", ("-4", "4"), "1")
    assert found.status is Status.PROVED
    assert found.upper is not None
    both = found.lower, found.upper
    assert both[1] <= both[0] * (1 + 1e-4)  # where the input crosses 0 and rests there, the grid's ramps are less exact
    assert both[0] > max(sides(bound("rigid", "1", ("-4", "4")))[1], 2.5)
    other = Limited(PLANTS["rigid"](), 1.0, -1.0, 1.0, 1.0, (-4.0, 4.0)).time(0.98 * both[0], 1.02 * both[1], 100, 1e-4)
    assert other == pytest.approx(both[1], rel=2e-3)


def test_where_limits_of_the_slope_make_no_sense() -> None:
    def refused(words: str, rate: Any, **others: Any) -> None:
        limits = Limits.of(-1, 1, None, others.pop("deflection", None), rate)
        with pytest.raises(ManeuverError, match=words):
            problem([transfer([1, 1], [1, 2, 0])()], Maneuver(Fraction(1), limits, **others))

    for rate in ((1, 2), (-2, -1), (0, 1), (-1, 0)):
        refused("contain 0", rate)
