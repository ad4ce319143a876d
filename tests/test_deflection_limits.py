"""Limits on named outputs in the course of the move: known minimum times, both sides proven; what they may not be; lies about them."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import comb, factorial, sqrt
from typing import Any

import numpy as np
import proving
import pytest
from flint import acb, arb, fmpq
from forgery import forged, opened
from independent import StateSpace
from independent_limits import Limited
from problems import transfer, two_mass

from relaxations.bounds import Bound, Status
from relaxations.checking import courses
from relaxations.checking.balls import Root, Wave
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Refuted, Undecided
from relaxations.courses import Course
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.proofs import COURSED, minimum_time

PLANTS = {"spring": two_mass, "rigid": transfer([1], [1, 0, 0]), "lag": transfer([1], [1, "0.5", 0])}


@cache
def bound(plant: str, displacement: str, fuel: str | None = None, input: tuple[str, str] = ("-1", "1"), **deflection: str) -> Bound:
    return minimum_time(problem([PLANTS[plant]()], Maneuver(Fraction(displacement), Limits.of(*input, fuel, deflection))))


def sides(found: Bound) -> tuple[float, float]:
    return proving.sides(found, COURSED)


@pytest.mark.parametrize(("low", "high", "speed"), [("-1", "1", "0.5"), ("-2", "1", "0.75"), ("-1", "1", "0.999")])
def test_a_rigid_body_of_limited_speed_moves_in_a_trapezoid(low: str, high: str, speed: str) -> None:
    # T = Δ/v + v/2 (1/a + 1/b): up to speed with a, down with b.
    a, b, v = float(high), -float(low), float(speed)
    lower, upper = sides(bound("rigid", "1", input=(low, high), output_rate=speed))
    time = 1 / v + v / 2 * (1 / a + 1 / b)
    assert lower <= time * (1 + 1e-14)
    assert upper >= time * (1 - 1e-14)


@pytest.mark.slow
def test_the_two_mass_spring_with_a_limited_spring() -> None:
    # 4.757 and 5.371 s from grids, both sides agreeing to the digits given.
    lower, upper = sides(bound("spring", "1", spring="0.3"))
    assert 4.7560 < lower < upper < 4.7570
    assert bound("spring", "1").lower <= upper


@pytest.mark.slow
def test_the_two_mass_spring_with_a_stiffly_limited_spring() -> None:
    lower, upper = sides(bound("spring", "1", spring="0.2"))
    assert 5.3700 < lower < upper < 5.3715


@pytest.mark.slow
def test_a_limit_that_is_not_needed_changes_nothing() -> None:
    free = bound("spring", "5")
    assert free.command is not None
    model = StateSpace.of(two_mass(), "spring")
    times = np.linspace(0.0, free.command.maneuver_time, 401)
    peak = float(np.abs(model.states(free.command, times) @ model.C).max())
    slack = bound("spring", "5", spring=f"{peak * 1.001:.9f}")
    assert (slack.lower, slack.upper, slack.switches) == (free.lower, free.upper, free.switches)
    tight = sides(bound("spring", "5", spring=f"{peak * 0.97:.9f}"))
    assert tight[0] > free.upper  # type: ignore[operator]


@pytest.mark.slow
def test_tighter_limits_take_no_less_time() -> None:
    times = [sides(bound("rigid", "1", output_rate=speed)) for speed in ("0.999", "0.75", "0.5")]
    assert all(later[0] > earlier[1] for earlier, later in pairwise(times))


@pytest.mark.slow
def test_fuel_and_speed_together_are_no_faster_than_either() -> None:
    # A cart with fuel U reaches the speed U/2 at most: a limit of the speed below makes the fuel plenty.
    both = sides(bound("rigid", "1", "1", output_rate="0.4"))
    assert both[0] <= 1 / 0.4 + 0.4 <= both[1] * (1 + 1e-12)
    other = sides(bound("rigid", "1", "0.6", output_rate="0.4"))
    assert other[0] <= 2 / 0.6 + 0.3 <= other[1] * (1 + 1e-12)


@pytest.mark.slow
def test_the_command_of_the_bracket_respects_the_limit_in_between_too() -> None:
    found = bound("spring", "1", spring="0.3")
    assert found.command is not None
    model = StateSpace.of(two_mass(), "spring")
    times = np.linspace(0.0, found.command.maneuver_time + 5.0, 301)
    course = model.states(found.command, times) @ model.C
    assert 0.299 < np.abs(course).max() <= 0.3
    assert np.abs(course[times > found.command.maneuver_time]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_random_limits_against_another_program(seed: int) -> None:
    rng = np.random.default_rng([2026, 7, seed])
    stiffness, damping = f"{rng.uniform(0.5, 3):.3g}", f"{rng.choice([0.0, 0.1]):.3g}"
    plant = two_mass(2, stiffness, damping)
    free = minimum_time(problem([plant], Maneuver(Fraction(1), Limits.of(-1, 1))))
    assert free.command is not None
    model = StateSpace.of(plant, "spring")
    peak = np.abs(model.states(free.command, np.linspace(0.0, free.command.maneuver_time, 301)) @ model.C).max()
    limit, fuel = float(f"{rng.uniform(0.6, 0.9) * peak:.3g}"), float(f"{0.9 * free.command.fuel():.3g}") if seed else None
    limits = Limits.of(-1, 1, fuel, {"spring": limit})
    lower, upper = sides(minimum_time(problem([plant], Maneuver(Fraction(1), limits))))
    other = Limited(plant, 1.0, -1.0, 1.0, fuel, None, {"spring": limit}).time(0.98 * lower, 1.02 * upper, 100, 1e-4)
    assert other == pytest.approx(upper, rel=4e-3)  # a grid of 100 steps is slower, though it is only limited at its instants


def test_where_a_limit_makes_no_sense() -> None:
    def refused(words: str, plant: Any = two_mass, displacement: str = "1", **others: Any) -> None:
        limits = Limits.of(-5, 5, None, others.pop("deflection"))
        with pytest.raises(ManeuverError, match=words):
            problem([plant()], Maneuver(Fraction(displacement), limits, **others))

    refused("the plant has output, output_rate, position_1", deflection={"sprig": 1})
    refused("may be more than 0", deflection={"spring": 0})
    refused("'position_1' deviates by 1", deflection={"position_1": "0.999"})
    refused("has feed-through", transfer([1, 1], [1, 2]), deflection={"output": 1})
    problem([two_mass()], Maneuver(Fraction(1), Limits.of(-1, 1, None, {"position_1": 1})))  # where it rests, exactly


def test_no_overshoot_of_the_controlled_output_itself() -> None:
    # The limit is where the output rests: the mass of a damped oscillator must not go beyond its target, which it touches at the end.
    limits = Limits.of(-1, 3, None, {"output": 1})
    lower, upper = sides(minimum_time(problem([transfer([1], [1, "0.4", 1])()], Maneuver(Fraction(1), limits))))
    free = minimum_time(problem([transfer([1], [1, "0.4", 1])()], Maneuver(Fraction(1), Limits.of(-1, 3))))
    assert (lower, upper) == sides(free)  # which does not overshoot


@pytest.mark.slow
def test_a_lag_that_may_not_overshoot_never_comes_to_rest() -> None:
    # (s + 3)/(s² + 0.4 s + 1) to 3: its zero's own motion ends at 1 and is less than 1 as long as the output is at most 3.
    def bounded(limit: str) -> Bound:
        limits = Limits.of(-2, 2, None, {"output": limit})
        return minimum_time(problem([transfer([1, 3], [1, "0.4", 1])()], Maneuver(Fraction(3), limits)))

    assert bounded("3").status is Status.IMPOSSIBLE
    assert proving.sides(bounded("3.3"), COURSED)[0] > 1.4  # without a limit 1.3683 s


@pytest.mark.slow
def test_an_output_rests_on_its_limit_all_the_way_to_the_end() -> None:
    # 6 (s² + 2s + 2)/… to 6, at most 6: its zeros' own motion takes it there in finite time, at -6 for a while and then at 6.
    limits = Limits.of(-2, 2, None, {"output": 6})
    lower, upper = proving.sides(minimum_time(problem([transfer([3, 6, 6], [1, "1.4", "1.4", 1])()], Maneuver(Fraction(6), limits))), 1e-4)
    assert 3.188 < lower < upper < 3.1886


@pytest.mark.parametrize("place", ["-0.9", "0.9"])
def test_a_body_that_moves_too_fast_to_stop_at_its_target_overshoots(place: str) -> None:
    # At a speed of 2 it stops at ±2, 2 s later, and comes back to ±1: the fastest command is no witness of a move within ±1.
    sign = -1 if place.startswith("-") else 1
    start = (Fraction(place), Fraction(2 * sign))
    found = minimum_time(problem([PLANTS["rigid"]()], Maneuver(Fraction(sign), Limits.of(-1, 1), initial=start)))
    sides(found)

    def limited(limit: str) -> Outcome:
        data = opened(found.certificate or b"")
        data["task"]["limits"]["deflection"] = {"output": limit}
        data["task"]["plants"][0]["outputs"] = {"output": ["1"]}
        data["claim"]["lower"], data["lower"] = None, None
        return check(forged(data)).outcome

    assert limited("1") is not Outcome.PROVED
    assert limited("2.8999") is not Outcome.PROVED
    assert limited("2.9001") is Outcome.PROVED


THIRD = arb(1) / 3  # no double: what touches a limit there is told from it by its derivatives alone


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("power", "factor", "known", "fine"),
    [
        (1, -1, 1, True),  # 1 - (1/3 - t): from beneath
        (1, 1, 1, False),
        (2, -1, 2, True),
        (2, 1, 2, False),
        (3, -1, 3, True),
        (3, 1, 3, False),
        (2, -1, 1, False),  # the slope is not known to be 0: that does not say it
        (2, -1, 0, False),
    ],
)
def test_what_rests_on_its_limit_comes_from_beneath(side: int, power: int, factor: int, known: int, fine: bool) -> None:
    """1 ± (1/3 - t)^k until t = 1/3, where its value and all derivatives but the k-th are known exactly."""
    chains = [arb(side)] + [arb(0)] * 3
    for k in range(power + 1):  # c_k t^k/k!
        chains[k] += side * factor * comb(power, k) * (-1) ** k * THIRD ** (power - k) * factorial(k)
    course = Wave.of((Root(acb(0), 4),), chains)
    last = [fmpq(side), *[fmpq(0)] * (power - 1)][:known]
    if fine:
        courses.within(course, THIRD.upper(), fmpq(1), "output", (), last)
    else:
        with pytest.raises((Undecided, Refuted)):
            courses.within(course, THIRD.upper(), fmpq(1), "output", (), last)
    with pytest.raises((Undecided, Refuted)):  # its rest beyond the limit, or not on its side
        courses.within(course, THIRD.upper(), fmpq(99, 100), "output", (), last)


def test_courses_in_floating_point_are_those_of_state_space() -> None:
    rng, plant = np.random.default_rng(5), two_mass(2, "1.3", "0.2")
    instants, course = np.sort(np.append(rng.uniform(0, 4, 7), [0.0, 4.0])), Course.of(plant, "spring", 1.0, 0.0)
    levels = rng.uniform(-1, 1, 8)
    times, values = course.along(instants, levels)
    model = StateSpace.of(plant, "spring")
    from relaxations.commands import Command, Segment, Tail

    steps = Command(4.0, tuple(Segment(float(s), float(u)) for s, u in zip(instants, levels, strict=False)), Tail(0.0))
    assert values == pytest.approx(model.states(steps, times) @ model.C, abs=1e-12)
    assert sqrt(2) > np.abs(values).max() > 0.01
