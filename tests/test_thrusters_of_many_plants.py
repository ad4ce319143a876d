"""Pulses for every plant of a box, and for a plant that varies: both sides proven, an independent search, lies."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import proving
import pytest
from box_tasks import SERVO, SPRING, TWIN, axis, forged, left
from numpy.typing import NDArray
from scipy.optimize import minimize
from varying_plants import GROWING, crane, landed

from fmus.twins import twin_family
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.commands import Command
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.robust.boxes import Axis, Box, Family, Listed
from relaxations.transitions import VaryingPlant
from relaxations.varying import varying_problem

Reals = NDArray[np.float64]
TENTH = axis("k", "0.1")


def limits(width: str | None, pulses: int | None = None, deflection: dict[str, str] | None = None, fuel: str | None = None) -> Limits:
    limited = {name: Fraction(limit) for name, limit in (deflection or {}).items()}
    return Limits(
        Fraction(-1),
        Fraction(1),
        None if fuel is None else Fraction(fuel),
        None if width is None else Fraction(width),
        pulses,
        limited,
    )


def thrust(family: Family | Listed, uncertain: Axis, displacement: str, asked: Limits, tolerance: str = "0.05") -> Bound:
    box = Box((uncertain,), family, Fraction(tolerance))
    return minimum_time(problem([family.member([uncertain.nominal])], Maneuver(Fraction(displacement), asked, box=box)))


@cache
def spring() -> Bound:
    """A spring to u = 1/2, 10 % of stiffness, in pulses of at least 0.37 s; the shortest one of the fastest command lasts 0.3742 s."""
    return thrust(SPRING, TENTH, "0.5", limits("0.37"))


@cache
def growing() -> Bound:
    """x'' = (1 + t) u until t = 2, in pulses of at least 1 s; the second one of the fastest command lasts 0.61 s."""
    return minimum_time(varying_problem(GROWING, Maneuver(Fraction(1), limits("1"))))


def pulses(found: Bound, width: float) -> Command:
    """The command of a proven bracket, whose pulses are full and wide enough."""
    proving.sides(found, np.inf)
    command = found.command
    assert command is not None
    widths = np.diff([*(s.start for s in command.segments), command.end])
    assert {s.level for s in command.segments} <= {-1.0, 0.0, 1.0}
    assert min(w for s, w in zip(command.segments, widths, strict=True) if s.level) >= width
    return command


@pytest.mark.slow
def test_one_command_for_every_plant_of_a_box() -> None:
    found = spring()
    command = pulses(found, 0.37)
    assert found.lower == pytest.approx(2.89232, abs=1e-4)  # of all inputs
    assert found.gap is not None
    assert 1e-6 < found.gap < 1e-4
    worst = max(left(found, SPRING.member([Fraction(float(k))]), 0.5)[0] for k in np.linspace(0.9, 1.1, 21))
    assert 0.049 <= worst <= 0.05 * (1 + 1e-9)
    assert command.end == found.upper
    words = claim(check(found.certificate or b""))
    assert "in pulses (constant pieces other than that)\n  of at least 0.37 s" in words
    assert "In every one of these plants the residual" in words


@pytest.mark.slow
def test_a_plant_that_varies() -> None:
    found = growing()
    command = pulses(found, 1.0)
    assert found.lower == pytest.approx(1.5391950535317602, rel=1e-12)
    starts, levels = np.array([s.start for s in command.segments]), np.array([s.level for s in command.segments])
    np.testing.assert_allclose(landed(GROWING, starts, levels, command.end), [1.0, 0.0], atol=1e-9)


def test_where_the_pulses_are_wide_enough_nothing_is_lost() -> None:
    free = minimum_time(varying_problem(GROWING, Maneuver(Fraction(1), Limits.of(-1, 1))))
    found = minimum_time(varying_problem(GROWING, Maneuver(Fraction(1), limits("0.6", 2))))
    pulses(found, 0.6)
    assert (found.lower, found.upper) == (free.lower, free.upper)


def best(missed: Callable[[Reals, Reals], Reals], room: float, width: float, count: int, starts: int) -> float:
    """The shortest command of at most so many pieces that is found from random durations: |missed| ≤ room, or 0."""
    rng, shortest = np.random.default_rng(7), np.inf
    kind = "ineq" if room else "eq"
    for n in range(1, count + 1):
        for levels in itertools.product((1.0, 0.0, -1.0), repeat=n):
            if any(a == b for a, b in itertools.pairwise(levels)) or 0.0 in (levels[0], levels[-1]):
                continue
            u = np.array(levels)
            least = np.where(u != 0.0, width, 0.0)
            for _ in range(starts):

                def left_over(d: Reals, u: Reals = u) -> Reals:
                    return room - np.abs(missed(u, d)) if room else missed(u, d)

                tried = minimize(
                    np.sum,
                    least + rng.exponential(0.5, n),
                    constraints=[{"type": kind, "fun": left_over}],
                    bounds=[(w, None) for w in least],
                    method="SLSQP",
                    options={"maxiter": 60},
                )
                over = left_over(tried.x)
                if (over.min() if room else -np.abs(over).max()) > -1e-7:
                    shortest = min(shortest, float(tried.x.sum()))
    return shortest


@pytest.mark.slow
def test_no_other_search_finds_a_shorter_one_for_the_plant_that_varies() -> None:
    def missed(u: Reals, durations: Reals) -> Reals:
        t = np.concatenate([[0.0], np.cumsum(durations)])
        early = np.minimum(t, 2.0)
        first = early + early**2 / 2 + 3 * (t - early)  # ∫ b
        second = early**2 / 2 + early**3 / 3 + 3 * (t**2 - early**2) / 2  # ∫ t b
        speed = np.diff(first) @ u
        return np.array([speed, t[-1] * speed - np.diff(second) @ u - 1.0])

    other, upper = best(missed, 0.0, 1.0, 4, 3), growing().upper
    assert upper is not None
    assert growing().lower < other
    assert upper <= other * (1 + 1e-6)


@pytest.mark.slow
def test_no_other_search_finds_a_shorter_one_for_the_box() -> None:
    """k/(s² + k) to u = 1/2, in pulses of at least 1 s."""
    found = thrust(SERVO, TENTH, "0.5", limits("1"))
    pulses(found, 1.0)
    frequencies = np.sqrt(np.linspace(0.9, 1.1, 9))

    def missed(u: Reals, durations: Reals) -> Reals:
        """Size of x - 1/2 + j v/ω afterwards, for every stiffness."""
        place, speed = np.zeros(9), np.zeros(9)
        for level, width in zip(u, durations, strict=True):
            turned = (place - level - 1j * speed) * np.exp(1j * frequencies * width)
            place, speed = level + turned.real, -turned.imag
        return np.abs(place - 0.5 + 1j * speed)

    other, upper = best(missed, 0.025, 1.0, 5, 4), found.upper
    assert upper is not None
    assert upper <= other * (1 + 1e-5)
    assert found.lower < other


@pytest.mark.slow
def test_wider_pulses_take_longer() -> None:
    gaps = [thrust(SPRING, TENTH, "0.5", limits(width)).gap for width in ("0.4", "0.5")]
    assert gaps[0] is not None
    assert gaps[1] is not None
    assert 5e-3 < gaps[0] < gaps[1]


@pytest.mark.slow
def test_the_two_masses() -> None:
    family = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})
    found = thrust(family, axis("stiffness", "0.3"), "5", limits("0.5"))
    pulses(found, 0.5)
    assert found.gap is not None
    assert found.gap < 3e-3
    short = thrust(family, axis("stiffness", "0.3"), "5", limits("0.1"))
    assert short.gap is not None
    assert short.gap < 1e-4


@pytest.mark.slow
def test_pulses_with_a_limited_output() -> None:
    found = thrust(SPRING, TENTH, "0.5", limits("0.3", deflection={"output_rate": "0.45"}))
    command = pulses(found, 0.3)
    times, speeds = np.linspace(0.0, command.end + 30.0, 8001), []
    for k in np.linspace(0.9, 1.1, 11):
        plant = SPRING.member([Fraction(float(k))])
        speeds.append(np.abs(response(type(plant)(plant.denominator, plant.numerators, "output_rate"), command, times)).max())
    assert max(speeds) <= 0.45 * (1 + 1e-9)


@pytest.mark.slow
def test_a_plant_that_varies_with_a_limited_output_a_budget_and_a_start() -> None:
    soft = VaryingPlant.of([0, 2], [[[0, 1], [-1, 0]], [[0, 1], [-2, 0]]], [[0, 1], [0, 2]], [[1, 0]] * 2, outputs={"speed": [[0, 1]] * 2})
    for width, limit in (("0.3", "0.6"), ("0.3", "0.8"), ("0.8", "2")):
        found = minimum_time(varying_problem(soft, Maneuver(Fraction(1, 2), limits(width, deflection={"speed": limit}))))
        command = pulses(found, float(width))
        if limit == "0.6":
            # The best of what reachable sets on a grid (states 0.01, times 0.05 s) found, polished: one pulse, then it comes by itself.
            assert command.end <= 1.5299577 * (1 + 1e-6)
    hoisting = crane({"0": "2", "3": "1", "5": "1.2"})
    starting = Maneuver(Fraction(1), limits("0.3", fuel="2.5"), initial=tuple(map(Fraction, ("0.1", "0", "0.05", "0"))))
    pulses(minimum_time(varying_problem(hoisting, starting)), 0.3)


@pytest.mark.slow
def test_a_list_of_plants() -> None:
    few = Listed(tuple(((Fraction(k),), SPRING.member([Fraction(k)])) for k in ("1", "1.1")))
    found = thrust(few, TENTH, "0.5", limits("0.65"))
    assert found.status is Status.BRACKETED
    assert found.reason is not None
    assert found.reason.startswith("sampled: both sides are proven")


# Lies, told in certificates that are right but for them.


def last(data: Any, key: str, value: str) -> None:
    data["upper"]["segments"][-1][key] = value


LIES: dict[str, Callable[[Any], Any]] = {
    "wider pulses": lambda data: data["task"]["limits"].update(pulse_width="1.5"),
    "fewer pulses": lambda data: data["task"]["limits"].update(pulses=1),
    "pulses that are not full": lambda data: last(data, "level", "-0.999"),
    "unknown levels": lambda data: data["upper"]["free"].append(["level", 0, 0]),
    "a pulse that begins late": lambda data: data["upper"]["segments"][0].update(start="0.4"),
    "a shorter upper side": lambda data: [data["claim"].update(lower=None), data["claim"].update(upper="2.8923")],
    "a wider thrust": lambda data: [data["claim"].update(lower=None), data["task"]["limits"].update(input=["-1", "1.001"])],
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("told", [spring, growing])
def test_lies_are_not_believed(told: Callable[[], Bound], lie: str) -> None:
    assert forged(told().certificate or b"", lambda data: None) is Outcome.PROVED
    assert forged(told().certificate or b"", LIES[lie]) is not Outcome.PROVED


def test_a_box_that_is_wider_is_another_task() -> None:
    def wider(data: Any) -> None:
        data["task"]["box"]["parameters"][0].update(low="0.88")

    assert forged(spring().certificate or b"", wider) is not Outcome.PROVED
