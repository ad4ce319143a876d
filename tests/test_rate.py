"""Limits of the input's slope: commands made of ramps, known minimum times, both sides proven; lies about them."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
import pytest
from forgery import certificate, changed, command, costate, number, opened, task, written
from independent_limits import Limited
from problems import transfer, two_mass

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
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
    assert found.status is Status.PROVED, found.reason
    assert found.certificate is not None
    assert found.upper is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.upper - found.lower <= 2 * COURSED * found.lower
    return found.lower, found.upper


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


def test_lower_rates_take_no_less_time_and_high_ones_come_to_nothing() -> None:
    free = bound("rigid", "1", None)
    times = [sides(bound("rigid", "1", (f"-{rate}", rate))) for rate in ("100", "16", "4")]
    assert all(later[0] > earlier[1] for earlier, later in pairwise(times))
    assert free.upper is not None
    assert free.lower < times[0][0] < free.upper * 1.01


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


# Lies, about the integrator with |u| ≤ 1 and slopes of 4, ∫u = 2: T = 2.25. p = 1; q = -1/4 … 0 over the last 1/4 s.

RATE = ("-4", "4")
RAMPS = [{"edges": ["0", "0.25"], "levels": ["0"]}, {"edges": ["2", "9"], "levels": ["0"]}]


def lower_side(time: str, ramps: list[dict[str, Any]], **others: Any) -> Outcome:
    posed = task(["1"], ["1", "0"], "2", **{"rate": list(RATE), **others})
    return check(certificate(posed, time, witnesses=(costate((("0", "0"), [("1", "0")]), ramps=ramps), None))).outcome


def test_the_lower_side_of_ramps() -> None:
    assert lower_side("2.2499999", RAMPS) is Outcome.PROVED
    assert lower_side("2.2500001", RAMPS) is Outcome.REFUTED
    assert lower_side("2.01", []) is Outcome.REFUTED  # without ramps it is the bound of the input's limits alone
    assert lower_side("1.99", []) is Outcome.PROVED
    split = [{"edges": ["0", "0.125", "0.25"], "levels": ["0", "0"]}, RAMPS[1]]
    assert lower_side("2.2499999", split) is Outcome.PROVED
    for edges in (["0", "0.3"], ["0", "0.2"], ["0.01", "0.25"]):
        assert lower_side("2.2499999", [{"edges": edges, "levels": ["0"]}, RAMPS[1]]) is not Outcome.PROVED
    assert lower_side("2.2499999", [{**RAMPS[0], "levels": ["0.1"]}, RAMPS[1]]) is not Outcome.PROVED
    assert lower_side("2.2499999", RAMPS, rate=["-4", "4.001"]) is Outcome.REFUTED
    assert lower_side("2.2499999", RAMPS, limits=("-1", "1.001")) is Outcome.REFUTED


def test_what_the_checker_calls_malformed() -> None:
    bad: list[list[dict[str, Any]]] = [
        [{"edges": ["0.25", "0"], "levels": ["0"]}],
        [{"edges": ["0", "0"], "levels": ["0"]}],
        [{"edges": ["0", "1"], "levels": []}],
        [{"edges": ["0", "1"], "levels": ["0", "0"]}],
        [RAMPS[1], RAMPS[0]],
        [RAMPS[0], RAMPS[0]],
        [{"edges": ["-1", "1"], "levels": ["0"]}],
    ]
    for ramps in bad:
        assert lower_side("1", ramps) is Outcome.MALFORMED, ramps
    for others in ({"rate": None}, {"rate": ["0", "1"]}, {"rate": ["1", "4"]}, {"sample_time": "1"}, {"pulses": 2}):
        assert lower_side("1", RAMPS, **others) is Outcome.MALFORMED, others


def test_a_level_costs_what_an_input_there_could_gain() -> None:
    # With fuel at a price of 1/2 the integrand is max(0, 1 - 1/2) = 1/2; a ramp at the level 3/4 costs 1/4 a second, one at 1/2 nothing.
    def outcome(time: str, level: str) -> Outcome:
        ramp = [{"edges": ["0", "1"], "levels": [level]}]
        posed = task(["1"], ["1", "0"], "2", rate=["-1000000", "1000000"], fuel="3")
        witness = costate((("0", "0"), [("2", "0")]), fuel="1", ramps=[ramp[0]])
        return check(certificate(posed, time, witnesses=(witness, None))).outcome

    assert outcome("0.5", "2") is Outcome.PROVED  # q = 0 but for the level itself: p = 2 = level, and 1/2 s cost 1/2; 4 - 3 = 1
    assert outcome("1.5", "2") is Outcome.REFUTED  # 3/2 of 1


def test_the_upper_side_of_ramps() -> None:
    def outcome(time: str, nodes: list[tuple[str, str]], free: list[list[Any]], rate: tuple[str, str] = RATE) -> Outcome:
        posed = task(["1"], ["1", "0"], "2", rate=list(rate), limits=("-1", "1.01"))
        return check(certificate(posed, upper=time, witnesses=(None, command(time, nodes, free)))).outcome

    # Up to 1 in 0.3 s and down again: ∫u = 2.3 - 0.3 = 2.
    nodes = [("0", "0"), ("0.3", "1"), ("2", "1")]
    assert outcome("2.3", nodes, [["level", 1, 0]]) is Outcome.PROVED
    assert outcome("2.3", nodes, [["level", 1, 0]], ("-3", "4")) is Outcome.REFUTED
    assert outcome("2.3", nodes, [["level", 1, 0]], ("-4", "3.3")) is Outcome.REFUTED
    assert outcome("2.3", nodes, [["level", 0, 0]]) is Outcome.MALFORMED  # the input begins where it rests
    assert outcome("2.3", nodes, [["time", 0, 0]]) is Outcome.MALFORMED
    assert outcome("2.3", nodes, []) is Outcome.MALFORMED
    assert outcome("2.3", [("0", "0.1"), *nodes[1:]], [["level", 1, 0]]) is Outcome.REFUTED
    assert outcome("2", [("0", "1")], []) is not Outcome.PROVED  # steps are no way around
    assert outcome("2.2", [("0", "0"), ("0.3", "1"), ("1.9", "1")], [["level", 1, 0]]) is Outcome.REFUTED  # does not get there


def test_a_changed_rate_changes_the_claim() -> None:
    content = bound("rigid", "1", ("-4", "4")).certificate
    assert content is not None
    assert "its slope stays in [-4, 4]" in claim(check(content))
    times = [number(opened(content)["claim"][side]) for side in ("lower", "upper")]
    for rate in (["-3.9", "3.9"], ["-4.1", "4.1"]):
        assert check(changed(content, lambda data, rate=rate: data["task"]["limits"].update(rate=rate))).outcome is not Outcome.PROVED
    for side, time, factor in zip(("lower", "upper"), times, (Fraction(100001, 100000), Fraction(99999, 100000)), strict=True):
        lie = changed(content, lambda data, side=side, time=time, factor=factor: data["claim"].update({side: written(time * factor)}))
        assert check(lie).outcome is Outcome.REFUTED
