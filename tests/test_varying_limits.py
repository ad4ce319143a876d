"""Plants that vary: starts, samples, slopes, limits of outputs; against constant plants, closed forms, HiGHS, lies."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
import pytest
from forgery import changed, number, opened, written
from marks import slow
from varying_plants import GROWING, HOISTING, STIFF_A, STIFF_B, STIFF_C, admits, asked_of, posed, proven

from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError, PlantError
from relaxations.initial import from_state
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.transitions import VaryingPlant
from relaxations.varying import varying_problem
from relaxations.varying_response import varying_response

SWING = (0, 0, 1, 0)
CRANE = replace(
    HOISTING,
    outputs={
        "swing": ((Fraction(0), Fraction(0), Fraction(1), Fraction(0)),) * 5,
        "speed": ((Fraction(0), Fraction(1), Fraction(0), Fraction(0)),) * 5,
    },
)
STIFFENING = VaryingPlant.of([0, 2], [STIFF_A, [[0, 1], [-1, "-0.5"]]], [STIFF_B] * 2, [STIFF_C] * 2, outputs={"speed": [[0, 1]] * 2})
"""Held at its target by an input; its damping grows."""

STEP = Fraction(1, 10)
SWINGING = (Fraction(0), Fraction(0), Fraction(1, 10), Fraction(0))


def moved(displacement: str, limits: Limits, **others: Any) -> Maneuver:
    return Maneuver(exact(displacement), limits, **others)


# Against a constant plant, whose programs, certificates and checks are others.


@pytest.mark.parametrize(
    ("limits", "others"),
    [
        (Limits.of(-1, 1), {"sample_time": STEP}),
        (Limits.of(-1, "0.9", rate=(-2, 3)), {"sample_time": STEP}),
        slow(Limits.of(-1, 1, deflection={"output_rate": "0.4"}, rate=(-2, 3)), {"sample_time": STEP}),
        slow(Limits.of(-1, 1, deflection={"output_rate": "0.4"}), {}),
        slow(Limits.of(-1, 1, rate=(-2, 3)), {}),
        (Limits.of(-1, 1), {"initial": ("0.2", "-0.5")}),
        (Limits.of(-1, 1, deflection={"output": "0.6"}), {"sample_time": STEP, "initial": ("0.2", "-0.5")}),
    ],
)
def test_a_constant_schedule_is_the_constant_plant(limits: Limits, others: dict[str, Any]) -> None:
    linear = LinearPlant.from_state_space(STIFF_A, STIFF_B, STIFF_C)
    start = tuple(exact(x) for x in others.pop("initial", ()))
    maneuver = moved("0.5", limits, **others)
    constant = minimum_time(problem([linear], replace(maneuver, initial=from_state(linear, STIFF_A, STIFF_B, start) if start else None)))
    plant = VaryingPlant.of([0, "0.3", 1], [STIFF_A] * 3, [STIFF_B] * 3, [STIFF_C] * 3)
    found, _, _ = proven(varying_problem(plant, replace(maneuver, initial=start or None)), gap=5e-4)
    assert constant.upper is not None
    assert found.upper is not None
    assert found.lower <= constant.upper
    assert constant.lower <= found.upper
    if "sample_time" in others:
        assert (found.lower, found.upper) == (constant.lower, constant.upper)


# Closed forms.


def test_a_mass_that_moves_is_stopped() -> None:
    """x'' = u from a speed of 1: back where it was in 1 + √2 s."""
    mass = VaryingPlant.of([0, 2], [[[0, 1], [0, 0]]] * 2, [[0, 1]] * 2, [[1, 0]] * 2)
    found, _, _ = proven(varying_problem(mass, moved("0", Limits.of(-1, 1), initial=(Fraction(0), Fraction(1)))))
    assert found.upper == pytest.approx(1 + sqrt(2), rel=1e-14)


def test_a_gain_that_grows_stops_sooner() -> None:
    """x'' = (1 + t) u from a speed of 1 until it stands, wherever that is nearest: T + T²/2 = 1."""
    brake = VaryingPlant.of([0, 2], [[[0]]] * 2, [[1], [3]], [[1]] * 2)
    found, command, _ = proven(varying_problem(brake, moved("0", Limits.of(-1, 1), initial=(Fraction(1),))))
    assert found.upper == pytest.approx(sqrt(3) - 1, rel=1e-14)
    assert [segment.level for segment in command.segments] == [-1.0]


@pytest.mark.slow
def test_a_speed_limit_gives_a_trapezoid() -> None:
    """x' ≤ 1/2: to the speed in half a second and back, 3/4 of the way between: 1/2 + 3/2 + 1/2 s."""
    mass = VaryingPlant.of([0, 2], [[[0, 1], [0, 0]]] * 2, [[0, 1]] * 2, [[1, 0]] * 2)
    found, command, content = proven(varying_problem(mass, moved("1", Limits.of(-1, 1, deflection={"output_rate": "0.5"}))), gap=2e-5)
    assert found.upper is not None
    assert found.lower <= 2.5 <= found.upper
    assert "a row times x" in claim(check(content))
    speed = replace(mass, C=((Fraction(0), Fraction(1)),) * 2)
    assert np.abs(varying_response(speed, command, np.linspace(0.0, 3.0, 3001))).max() <= 0.5 + 1e-9


# Against HiGHS, which knows the plant from `solve_ivp` alone.

SAMPLED = {
    "samples": (CRANE, moved("2", Limits.of(-1, 1))),
    "start": (CRANE, moved("2", Limits.of(-1, 1), initial=SWINGING)),
    "stop": (CRANE, moved("0", Limits.of(-1, 1), initial=SWINGING)),
    "steps": (CRANE, moved("2", Limits.of(-1, "0.8", rate=(-4, 5)))),
    "outputs": (CRANE, moved("2", Limits.of(-1, 1, deflection={"swing": "0.06", "speed": "0.9"}))),
    "fuel": (CRANE, moved("2", Limits.of(-1, 1, "1.8"))),
    "all": (CRANE, moved("1", Limits.of(-1, "0.8", 2, {"swing": "0.12", "speed": "0.7"}, (-4, 5)), initial=SWINGING)),
    "held": (STIFFENING, moved("0.5", Limits.of(-1, 1, deflection={"speed": "0.35"}, rate=(-2, 3)), initial=(Fraction(1, 5), Fraction(0)))),
}


@pytest.mark.parametrize("which", [slow(which) if which in ("all", "held", "outputs", "steps", "start") else which for which in SAMPLED])
def test_samples_are_counted_as_another_program_counts_them(which: str) -> None:
    plant, maneuver = SAMPLED[which]
    found, _, _ = proven(varying_problem(plant, replace(maneuver, sample_time=STEP)))
    assert found.upper is not None
    count, asked = round(found.upper / float(STEP)), asked_of(plant, maneuver)
    assert found.upper == pytest.approx(count * float(STEP), rel=1e-15)
    assert found.lower == pytest.approx(found.upper, rel=1e-15)
    assert not admits(plant, asked, (count - 1) * float(STEP), count - 1)
    # Between its samples the command is proven to stay within limits too, which may take one sample more than at them alone.
    assert admits(plant, asked, count * float(STEP), count)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "maneuver"),
    [
        (GROWING, moved("1", Limits.of(-1, 1, deflection={"output_rate": "0.8"}, rate=(-5, 5)))),
        (GROWING, moved("1", Limits.of(-1, 1, rate=(-5, 5)), initial=(Fraction(0), Fraction(1)))),
    ],
)
def test_continuous_commands_are_as_fast_as_finely_sampled_ones(plant: VaryingPlant, maneuver: Maneuver) -> None:
    found, command, _ = proven(varying_problem(plant, maneuver), gap=5e-4)
    assert found.upper is not None
    speed = replace(plant, C=plant.rows["output_rate"]) if maneuver.limits.deflection else plant
    y = varying_response(speed, command, np.linspace(0.0, 2 * found.upper, 2001), begin=maneuver.initial)
    assert np.abs(y).max() <= (0.8 + 1e-9 if maneuver.limits.deflection else 1.5)
    asked = asked_of(replace(plant, outputs={"output_rate": plant.rows["output_rate"]}), maneuver)
    assert admits(plant, asked, found.upper * 1.03, 100)
    assert not admits(plant, asked, found.lower * 0.97, 100)


# More of a limit is never slower, and one that does not matter changes nothing.


@pytest.mark.slow
def test_limits_that_do_not_matter_change_nothing() -> None:
    free, command, _ = proven(posed(HOISTING, 2))
    slack = Limits.of(-1, 1, 20, {"swing": "0.5", "speed": 3})
    found, again, content = proven(varying_problem(CRANE, moved("2", slack)))
    assert (found.lower, found.upper) == (free.lower, free.upper)
    assert again == command
    assert opened(content)["task"]["limits"]["deflection"].keys() == {"swing", "speed"}


@pytest.mark.slow
def test_tighter_limits_are_never_faster() -> None:
    times = []
    for speed in ("0.9", "0.7", "0.5"):
        found, _, _ = proven(varying_problem(CRANE, moved("2", Limits.of(-1, 1, deflection={"speed": speed}), sample_time=STEP)))
        times.append(found.upper)
    assert times == sorted(times)
    assert times[0] < times[-1]


# What is refused.


def test_a_level_that_lasts_no_sample_does_not_divide_a_step() -> None:
    mass = VaryingPlant.of([0, 2], [[[0, 1], [0, 0]]] * 2, [[0, 1]] * 2, [[1, 0]] * 2)
    free = proven(varying_problem(mass, moved("0.9", Limits.of(-1, 1), sample_time=Fraction(1, 2))), gap=1.0)[2]

    def change(data: Any) -> None:
        segments = data["upper"]["segments"]
        levels = [Fraction(0), *(number(segment["level"]) for segment in segments), Fraction(0)]
        steps = [abs(after - before) for before, after in pairwise(levels)]
        place = steps.index(max(steps))
        assert 0 < place < len(segments)  # a step between two levels
        allowed = max([steps[place] / 2, *(step for i, step in enumerate(steps) if i != place)]) * Fraction(1001, 1000)
        assert allowed < steps[place]
        data["task"]["limits"]["rate"] = [written(-2 * allowed), written(2 * allowed)]
        data["claim"]["lower"] = data["lower"] = None
        segments.insert(place, {"start": segments[place]["start"], "level": written((levels[place] + levels[place + 1]) / 2)})
        data["upper"]["free"] = [[kind, i + (i >= place), k] for kind, i, k in data["upper"]["free"]]

    found = check(changed(free, change))
    assert (found.outcome, "lasts no sample" in found.reason) == (Outcome.REFUTED, True), found.reason


def test_states_that_the_input_never_moves_may_not_begin_elsewhere() -> None:
    plant = VaryingPlant.of([0, 2], [[[0, 1, 5], [0, 0, 3], [0, 0, -1]]] * 2, [[0, 1, 0], [0, 3, 0]], [[1, 0, 2]] * 2)
    assert plant.begun([1, 2, 0]) == (1, 2)
    with pytest.raises(PlantError, match=r"begins with x\[3\] away from rest"):
        plant.begun([1, 2, 3])
    with pytest.raises(PlantError, match="has 2 numbers; the states are"):
        plant.begun([1, 2])
    with pytest.raises(PlantError, match="names w; the states are"):
        plant.begun({"w": 1})


def test_the_rate_of_an_output_is_limited_where_it_is_a_row() -> None:
    assert set(GROWING.rows) == {"output", "output_rate"}
    assert set(HOISTING.rows) == {"output"}  # its row varies: the rate has a part that is quadratic in time
    with pytest.raises(ManeuverError, match=r"names 'output_rate'; of a plant that varies it may be that of output, speed, swing"):
        varying_problem(CRANE, moved("2", Limits.of(-1, 1, deflection={"output_rate": 1})))
