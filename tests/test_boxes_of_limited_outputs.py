"""Robust tasks with limits of outputs: in every plant of the box, during the move and after it, for ever; both sides proven; lies."""

from __future__ import annotations

import random
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import proving
import pytest
from box_tasks import MASS, SPRING, TWIN, axis, forged, robust
from corruption import at, leaves, nudge
from forgery import forged as certificate_of
from forgery import number, opened, scaled
from independent_boxes import Boxed

from fmus.twins import twin_family
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.robust import moved
from relaxations.robust.boxes import Axis, Box, Family, Listed

GAP = 5e-4
COARSE = 4e-3  # of the time: what a grid of 120 cells, of the other program, is off by

STRETCH = TWIN + '\nspring = { C = ["-1", "0", "1", "0"], D = "0" }\n'
STIFFNESS, FIFTH = twin_family(STRETCH, "x2", ["stiffness"], {"damping": "0"}, ["spring"]), axis("stiffness", "0.2")
TENTH = axis("k", "0.1")


def posed(family: Family | Listed, axes: tuple[Axis, ...], displacement: str, tolerance: str, limits: dict[str, str], **others: Any) -> Any:
    plant = family.member([a.nominal for a in axes])
    box = Box(axes, family, Fraction(tolerance))
    return problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1, deflection=limits, **others), box=box))


@cache
def stretched(limit: str) -> Bound:
    """The two masses, 20 % of stiffness, the spring's stretch limited."""
    return minimum_time(posed(STIFFNESS, (FIFTH,), "1", "0.05", {"spring": limit}))


@cache
def slow(limit: str = "0.3") -> Bound:
    """One spring to u = 1/2, 10 % of stiffness, the speed limited."""
    return minimum_time(posed(SPRING, (TENTH,), "0.5", "0.05", {"output_rate": limit}))


def sides(found: Bound) -> tuple[float, float]:
    return proving.sides(found, GAP)


def furthest(found: Bound, output: str, family: Family, name: str) -> float:
    """How far an output goes, of 21 plants of the box, during the move and 40 s after it, in closed form."""
    assert found.command is not None
    low, high = {"k": (0.9, 1.1), "stiffness": (0.8, 1.2)}[name]
    times = np.linspace(0.0, found.command.maneuver_time + 40.0, 12001)
    courses = []
    for k in np.linspace(low, high, 21):
        plant = family.member([Fraction(float(k))])
        courses.append(np.abs(response(LinearPlant(plant.denominator, plant.numerators, output), found.command, times)).max())
    return float(max(courses))


@pytest.mark.slow
def test_a_speed_is_kept_in_every_plant_and_all_of_it_is_used() -> None:
    free = minimum_time(posed(SPRING, (TENTH,), "0.5", "0.05", {"output_rate": "10"}))
    found = slow()
    lower, upper = sides(found)
    assert free.upper is not None
    assert free.upper < lower  # 2.892 s without
    assert 0.2999 <= furthest(found, "output_rate", SPRING, "k") <= 0.3 * (1 + 1e-9)
    plants = [SPRING.member([Fraction(k)]) for k in ("1", "0.9", "1.1")]
    other = Boxed(plants, 0.5, -1.0, 1.0, 0.025, deflections={"output_rate": 0.3}, window=7.0, looks=60)
    assert other.fraction(lower * (1 - COARSE), 120) < 1.0 < other.fraction(upper * (1 + COARSE), 120)


@pytest.mark.slow
def test_a_limit_that_is_loose_changes_nothing() -> None:
    loose, free = stretched("10"), robust("1", "0.05", FIFTH)
    sides(loose)
    assert loose.upper is not None
    assert loose.lower == pytest.approx(free.lower, rel=1e-6)
    assert loose.upper == pytest.approx(free.upper, rel=1e-6)


@pytest.mark.slow
def test_a_stretch_is_kept_in_every_plant() -> None:
    found = stretched("0.3")
    lower, upper = sides(found)
    assert stretched("10").upper < lower  # type: ignore[operator]
    assert 0.2999 <= furthest(found, "spring", STIFFNESS, "stiffness") <= 0.3 * (1 + 1e-9)
    plants = [STIFFNESS.member([Fraction(k)]) for k in ("1", "0.8", "0.9", "1.1", "1.2")]
    other = Boxed(plants, 1.0, -1.0, 1.0, 0.05, deflections={"spring": 0.3}, window=7.0, looks=80)
    assert other.fraction(lower * (1 - COARSE), 120) < 1.0 < other.fraction(upper * (1 + COARSE), 120)
    assert sides(stretched("0.25"))[0] > upper


@pytest.mark.slow
def test_the_lightest_body_of_a_box_is_the_fastest() -> None:
    """1/(m s²), m = 1 ± 10 %: the lightest keeps |v| ≤ 1/2 where the nominal one has 0.45, T = Δ/v + v/a with a = 1."""
    lower, upper = sides(minimum_time(posed(MASS, (axis("m", "0.1"),), "1", "0.05", {"output_rate": "0.5"})))
    assert lower <= 1 / 0.45 + 0.45 <= upper


@pytest.mark.slow
def test_slopes_with_them() -> None:
    """Of a tighter speed (0.3) the programs stall where slopes are limited too, and nothing is claimed."""
    sloped = minimum_time(posed(SPRING, (TENTH,), "0.5", "0.05", {"output_rate": "0.4"}, rate=("-20", "20")))
    assert proving.sides(sloped, 2e-3)[1] > slow("0.4").lower
    assert furthest(sloped, "output_rate", SPRING, "k") <= 0.4 * (1 + 1e-9)


@pytest.mark.slow
def test_samples_with_them() -> None:
    plain = slow()
    box = Box((TENTH,), SPRING, Fraction(1, 20))
    limits = Limits.of(-1, 1, deflection={"output_rate": "0.3"})
    maneuver = Maneuver(Fraction(1, 2), limits, box=box, sample_time=Fraction(1, 10))
    sampled = minimum_time(problem([SPRING.member([Fraction(1)])], maneuver))
    lower, upper = proving.sides(sampled, 0.1)
    assert upper > plain.lower
    assert lower >= plain.lower * (1 - 0.1)


@pytest.mark.slow
def test_a_list_of_plants() -> None:
    few = Listed(tuple(((Fraction(k),), SPRING.member([Fraction(k)])) for k in ("1", "1.1")))
    found = minimum_time(posed(few, (TENTH,), "0.5", "0.05", {"output_rate": "0.3"}))
    assert found.status is Status.BRACKETED
    assert found.reason is not None
    assert found.reason.startswith("sampled: both sides are proven")
    assert found.lower <= slow().upper  # type: ignore[operator]


@pytest.mark.slow
def test_moved_roots() -> None:
    """The output of a damped spring and its rate; of two masses an output with zeros of its own, which stay where they are."""
    plant = LinearPlant.from_transfer([1], [1, "0.2", 1])
    axes = (moved.axis(plant, "mode[1].frequency", Fraction("0.9"), Fraction("1.1")),)
    found = minimum_time(posed(moved.moved(plant, axes), axes, "0.5", "0.05", {"output_rate": "0.5"}))
    proving.sides(found, 2e-3)
    words = claim(check(found.certificate or b""))
    assert "The limits of outputs hold in every one of them, for all t ≥ 0." in words
    assert "Each output keeps its static gain and its zeros" in words


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ManeuverError, match="in the plant at"):  # it rests at 0.5556 where k = 0.9
        posed(SPRING, (TENTH,), "0.5", "0.05", {"output": "0.55"})
    with pytest.raises(ManeuverError, match="names 'spring'; the plant has"):
        posed(SPRING, (TENTH,), "0.5", "0.05", {"spring": "1"})
    cart = LinearPlant.from_transfer([1, 2], [1, "0.4", 2, 0])
    both = LinearPlant(cart.denominator, {**cart.numerators, "other": cart.denominator * 0 + 1}, "output")
    axes = (moved.axis(both, "zero[1]", Fraction("0.8"), Fraction("1.25")),)
    box = Box(axes, moved.moved(both, axes), Fraction("0.05"))
    maneuver = Maneuver(Fraction(1), Limits.of(-1, 1, deflection={"other": "1"}), box=box)
    with pytest.raises(ManeuverError, match="where the zeros of 'other' go in the box is not known"):
        problem([both], maneuver)


# Lies, told in certificates that are right but for them.


def outcome(change: Any) -> Outcome:
    return forged(slow().certificate or b"", change)


def pressed(data: Any) -> Any:
    return next(sample for sample in data["lower"]["samples"] if sample["deflection"])


LIES: dict[str, Any] = {
    "a tighter limit": lambda data: data["task"]["limits"]["deflection"].update(output_rate="0.299"),
    "a limit of another output": lambda data: [
        data["task"]["limits"].update(deflection={"output": "0.6"}),
        data["task"]["plants"][0].update(outputs={"output": ["1"]}),
    ],
    "an output that is none of the box": lambda data: data["task"]["box"]["outputs"].update(output_rate=[[["1", [0]]], [["0.1", [0]]]]),
    "an output that goes with the parameter": lambda data: data["task"]["box"]["outputs"].update(output_rate=[[["1", [1]]], []]),
    "no output in the box": lambda data: data["task"]["box"].update(outputs={}),
    "a wider box": lambda data: data["task"]["box"]["parameters"][0].update(low="0.89"),
    "a level too high": lambda data: scaled(data, ("upper", "segments", 30, "level"), "1.05"),
    "no prices of the output": lambda data: [
        data["claim"].update(upper=None),
        *(sample.update(deflection=[]) for sample in data["lower"]["samples"]),
    ],
    "a longer lower side": lambda data: [data["claim"].update(upper=None), scaled(data, ("claim", "lower"), "1.002")],
    "a shorter upper side": lambda data: [data["claim"].update(lower=None), scaled(data, ("claim", "upper"), "0.9999")],
    "a wider limit below": lambda data: [
        data["claim"].update(upper=None),
        data["task"]["limits"]["deflection"].update(output_rate="0.31"),
    ],
    "a price of no limit": lambda data: pressed(data)["deflection"][0].update(output="output"),
    "a price after the move of a slope": lambda data: pressed(data)["after"].append(
        {"output": None, "time": "0", "upper": "1", "lower": "0"}
    ),
}


@pytest.mark.slow
def test_the_truth_is_believed() -> None:
    assert outcome(lambda data: None) is Outcome.PROVED
    assert pressed(opened(slow().certificate or b""))


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES)
def test_lies_are_not_believed(lie: str) -> None:
    assert outcome(LIES[lie]) is not Outcome.PROVED


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_what_a_tampered_certificate_proves_is_true(seed: int) -> None:
    """Any number of it changed a little, task, claim and witnesses alike: what is proven then, another program finds true."""
    rng, data = random.Random(f"outputs of a box, {seed}"), opened(slow().certificate or b"")
    paths = [path for path in leaves(data) if path[0] != "digest" and is_number(at(data, path))]
    kinds = sorted({path[:2] for path in paths})
    kind = rng.choice(kinds)
    node: Any = data
    *steps, last = rng.choice([path for path in paths if path[:2] == kind])
    for step in steps:
        node = node[step]
    node[last] = nudge(node[last], rng)
    found = check(certificate_of(data))
    if found.outcome is not Outcome.PROVED:
        return
    task, claimed = data["task"], data["claim"]
    ((limited, limit),) = task["limits"]["deflection"].items()
    (parameter,) = task["box"]["parameters"]
    low, high = (number(parameter[end]) for end in ("low", "high"))
    plants = [SPRING.member([k]) for k in (number(parameter["nominal"]), low, (low + high) / 2, high)]
    displacement, (least, most) = float(number(task["displacement"])), (float(number(side)) for side in task["limits"]["input"])
    allowed = float(number(task["box"]["tolerance"])) * abs(displacement)
    other = Boxed(plants, displacement, least, most, allowed, deflections={limited: float(number(limit))}, window=7.0, looks=60)
    assert float(number(claimed["lower"])) <= other_time(other, 1.0 + COARSE)
    assert float(number(claimed["upper"])) >= other_time(other, 1.0 - COARSE)


def is_number(value: Any) -> bool:
    """A number as certificates write it."""
    try:
        number(value)
    except (TypeError, ValueError, AttributeError):
        return False
    return True


def other_time(other: Boxed, factor: float) -> float:
    """The least time of the other program's grid, times a factor."""
    return other.time(1.0, 12.0, 120, 1e-3) * factor
