"""Robust tasks with limits of the input's slope: one continuous command for every plant of a box, both sides proven; lies about them."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import proving
import pytest
from box_tasks import ONE, SPRING, TOW, TWIN, K, axis, forged, robust, transfer
from forgery import opened, scaled
from independent_boxes import Boxed

from fmus.twins import twin_family
from relaxations.bounds import Bound
from relaxations.checking.claims import Outcome
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.robust import moved
from relaxations.robust.boxes import Axis, Box, Family, Listed

GAP = 2e-4  # between the sides: grids know where ramps begin and end to a fraction of a cell
COARSE = 3e-3  # of the time: what a grid of 160 cells, of the other program, is off by

Rate = tuple[str, str] | None


@cache
def bound(family: Family, axes: tuple[Axis, ...], rate: Rate, displacement: str = "0.5", tolerance: str = "0.05") -> Bound:
    return fastest(family, axes, rate, displacement, tolerance)


def fastest(family: Family | Listed, axes: tuple[Axis, ...], rate: Rate, displacement: str = "0.5", tolerance: str = "0.05") -> Bound:
    plant = family.member([a.nominal for a in axes])
    box = Box(axes, family, Fraction(tolerance))
    return minimum_time(problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1, rate=rate), box=box)))


STIFFNESS = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})
TENTH, FIFTH = (axis("k", "0.1"),), (axis("stiffness", "0.2"),)


def sides(found: Bound) -> tuple[float, float]:
    return proving.sides(found, GAP)


def places(axes: tuple[Axis, ...], count: int) -> list[tuple[Fraction, ...]]:
    (one,) = axes
    return [(one.nominal,), *((one.low + (one.high - one.low) * Fraction(i, count - 1),) for i in range(count))]


@pytest.mark.slow
@pytest.mark.parametrize(("family", "axes", "displacement"), [(SPRING, TENTH, "0.5"), (STIFFNESS, FIFTH, "1")])
def test_another_program_finds_the_same_time(family: Family, axes: tuple[Axis, ...], displacement: str) -> None:
    lower, upper = sides(bound(family, axes, ("-3", "3"), displacement))
    plants = [family.member(place) for place in places(axes, 3)]
    other = Boxed(plants, float(displacement), -1.0, 1.0, 0.05 * float(displacement), (-3.0, 3.0), window=7.0, looks=80)
    assert other.fraction(lower * (1 - COARSE), 120) < 1.0 < other.fraction(upper * (1 + COARSE), 120)


@pytest.mark.slow
def test_the_command_is_continuous_and_keeps_what_it_may_in_every_plant() -> None:
    found = bound(STIFFNESS, FIFTH, ("-3", "3"), "1")
    command = found.command
    assert command is not None
    edges = np.array(command.breakpoints[1:-1])
    assert np.abs(command(edges - 1e-9) - command(edges + 1e-9)).max() <= 1e-7
    assert max(abs(segment.slope) for segment in command.segments) <= 3.0 + 1e-9
    worst = 0.0
    for k in np.linspace(0.8, 1.2, 41):
        times = command.maneuver_time + np.linspace(0.0, 10.0, 2001)
        course = response(STIFFNESS.member([Fraction(float(k))]), command, times)
        worst = max(worst, float(np.abs(course - (course.max() + course.min()) / 2).max()))
    assert 0.0499 <= worst <= 0.05 * (1 + 1e-6)  # all that is allowed is used; the middle of a sampled course is off by 1e-7


@pytest.mark.slow
def test_a_tighter_slope_takes_no_less_and_a_loose_one_as_long_as_none() -> None:
    free = robust("1", "0.05", axis("stiffness", "0.2"))
    times = [bound(STIFFNESS, FIFTH, rate, "1") for rate in (("-20", "20"), ("-3", "3"))]
    for looser, tighter in pairwise([free, *times]):
        assert tighter.upper is not None
        assert looser.lower <= tighter.upper
    assert times[0].upper is not None
    # From one limit to the other takes 0.1 s; each of the switches, and the two ends, cost no more than half of that.
    assert times[0].upper - free.lower <= 0.1 * 4


@pytest.mark.slow
def test_a_box_without_width_is_no_longer_than_rest() -> None:
    plant = SPRING.member([Fraction(1)])
    rest = minimum_time(problem([plant], Maneuver(Fraction("0.5"), Limits.of(-1, 1, rate=(-3, 3)))))
    found = bound(SPRING, (axis("k", "0"),), ("-3", "3"), tolerance="0.0001")
    assert rest.upper is not None
    assert found.lower <= rest.upper
    assert found.lower >= rest.lower * (1 - 1e-3)  # and near it: of so small a tolerance little is gained


@pytest.mark.slow
def test_a_list_of_plants_and_moved_roots() -> None:
    few = Listed(tuple(((Fraction(k),), SPRING.member([Fraction(k)])) for k in ("1", "1.1")))
    listed = fastest(few, (axis("k", "0.1"),), ("-4", "4"))
    assert listed.reason is not None  # both sides are proven, the upper one for those two plants
    assert listed.reason.startswith("sampled: both sides are proven")
    plant = LinearPlant.from_transfer([1], [1, "0.2", 1])
    axes = (moved.axis(plant, "mode[1].frequency", Fraction("0.9"), Fraction("1.1")),)
    sides(bound(moved.moved(plant, axes), axes, ("-4", "4")))


SLOW = (*((SPRING, seed) for seed in range(4)), *((TOW, seed) for seed in range(4, 8)), *((STIFFNESS, seed) for seed in range(8, 12)))


@pytest.mark.slow
@pytest.mark.parametrize(("family", "seed"), SLOW)
def test_random_boxes_against_another_program(family: Family, seed: int) -> None:
    rng = np.random.default_rng([2026, 29, seed])
    name = "stiffness" if family is STIFFNESS else "k"
    width, tolerance, rate = (f"{rng.uniform(*ends):.2g}" for ends in ((0.05, 0.25), (0.02, 0.15), (2.0, 12.0)))
    displacement = f"{rng.uniform(0.3, 0.6) if name == 'k' else rng.uniform(0.5, 3):.2g}"
    axes = (axis(name, width),)
    lower, upper = sides(bound(family, axes, (f"-{rate}", rate), displacement, tolerance))
    plants, slope = [family.member(place) for place in places(axes, 7)], float(rate)
    allowed = float(tolerance) * float(displacement)
    other = Boxed(plants, float(displacement), -1.0, 1.0, allowed, (-slope, slope), window=30.0, looks=400)
    assert other.fraction(lower * (1 - COARSE), 200) < 1.0 < other.fraction(upper * (1 + COARSE), 200)


# Lies, told in certificates that are right but for them.


def outcome(change: Any, displacement: str = "0.5") -> Outcome:
    return forged(bound(SPRING, TENTH, ("-3", "3"), displacement).certificate or b"", change)


LIES: dict[str, Any] = {
    "a tighter slope": lambda data: data["task"]["limits"].update(rate=["-2.9", "2.9"]),
    "a slope to one side": lambda data: data["task"]["limits"].update(rate=["-3", "2.9"]),
    "a smaller tolerance": lambda data: data["task"]["box"].update(tolerance="0.0499"),
    "a wider box": lambda data: data["task"]["box"]["parameters"][0].update(high="1.101"),
    "steps of a continuous input": lambda data: data["task"]["limits"].update(sample_time="0.01"),
    "a level too high": lambda data: scaled(data, ("upper", "segments", 40, "level"), "1.01"),
    "a jump at first": lambda data: data["upper"]["segments"][0].update(level="0.01"),
    "shorter than it is": lambda data: scaled(data, ("claim", "upper"), "0.9999"),
    "no residual's price": lambda data: [data["claim"].update(upper=None), data["lower"].update(samples=[])],
    "no ramps": lambda data: [data["claim"].update(upper=None), data["lower"].update(ramps=[])],
    "a longer lower side": lambda data: scaled(data, ("claim", "lower"), "1.0001"),
    "a wider slope below": lambda data: [data["claim"].update(upper=None), data["task"]["limits"].update(rate=["-3.1", "3.1"])],
}


@pytest.mark.slow
def test_the_truth_is_believed() -> None:
    assert outcome(lambda data: None) is Outcome.PROVED
    content = opened(bound(SPRING, TENTH, ("-3", "3")).certificate or b"")
    assert content["lower"]["ramps"]
    assert any(sample["residual"] for sample in content["lower"]["samples"])


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES)
def test_lies_are_not_believed(lie: str) -> None:
    assert outcome(LIES[lie]) is not Outcome.PROVED


def test_bodies_alone_are_at_rest_together() -> None:
    """1/(m s²) has no mode: what the box asks is what the nominal plant asks, the rigid body of limited jerk."""
    masses = transfer(["m"], [ONE], [K, {}, {}])
    found = bound(masses, (axis("m", "0.1"),), ("-4", "4"), "1")
    time = 2 * (0.125 + (1 / 64 + 1) ** 0.5)
    lower, upper = proving.sides(found, 2e-5)
    assert lower * (1 - 1e-14) <= time <= upper * (1 + 1e-14)
