"""Pulses one way, then the other: brackets of the family, proven; digits of the literature; an independent program; lies about it."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import pi, sqrt
from types import SimpleNamespace
from typing import Any

import numpy as np
import proving
import pytest
from flint import arb, fmpq
from forgery import changed, number, written
from independent import StateSpace
from marks import first, slow
from problems import transfer
from scipy.optimize import linprog

from relaxations.bounds import Bound, Status
from relaxations.checking import changes
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import Refuted, Undecided
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.onoff.held import in_form, towards
from relaxations.plants import exact
from relaxations.proofs import minimum_time

PLANTS = {
    "spring": transfer([1], [1, 0, 2, 0, 0]),
    "rigid": transfer([1], [1, 0, 0]),
    "damped": transfer([1], [1, "0.2", 2, 0, 0]),
    "lag": transfer([1], [1, 1, 0]),
}


def posed(plant: str, displacement: str, fuel: str | None = None, robustness: int = 0, limits: tuple[str, str] = ("-1", "1")) -> Problem:
    one = PLANTS[plant]()
    held = towards(one, Fraction(displacement))
    return problem([one], Maneuver(exact(displacement), replace(Limits.of(*limits, fuel), held=held), robustness=robustness))


@cache
def bound(plant: str, displacement: str, fuel: str | None = None, robustness: int = 0, limits: tuple[str, str] = ("-1", "1")) -> Bound:
    return minimum_time(posed(plant, displacement, fuel, robustness, limits))


def test_a_budget_below_the_first_node_leaves_the_fastest_command_in_form() -> None:
    lower, upper = proving.sides(bound("spring", "5", "4"), 1e-12)
    assert lower <= 8.1107317945 + 5e-11
    assert upper >= 8.1107317945 - 5e-11


# The fuel-efficient command of Singhose, Singh and Seering, J. Dynamic Systems, Measurement, and Control 121 (1999): of the form, as
# fast as that goes, no budget. For one undamped mode it is the node of equation (33), mended: a period between the pulses,
# U = M ω Δ/(π u_max) of fuel, T = U/2 + 2π/ω. With a further zero its digits are those of Newton's method on five switches.
NODE = 2 * sqrt(2) * 5 / pi / 2 + 2 * pi / sqrt(2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("displacement", "fuel", "robustness", "time", "gap"),
    [
        slow("5", None, 0, NODE, 2e-5),
        ("5", None, 1, 7.7210011331, 2e-9),
        ("5", "5.2", 1, 7.7222295009, 2e-6),
    ],
)
def test_the_form_costs_time_where_the_fastest_command_is_of_another(
    displacement: str, fuel: str | None, robustness: int, time: float, gap: float
) -> None:
    found = bound("spring", displacement, fuel, robustness)
    lower, upper = proving.sides(found, gap)
    assert lower <= time * (1 + 1e-10) <= upper * (1 + 2e-10)
    assert upper - time <= time * 2e-10  # the node's levels are a hair below full thrust
    assert found.command is not None
    assert in_form(posed("spring", displacement, fuel, robustness), found.command)
    free = minimum_time(problem([PLANTS["spring"]()], Maneuver(exact(displacement), Limits.of(-1, 1, fuel), robustness=robustness)))
    assert free.lower <= lower  # the form never beats the bound of all commands
    assert free.upper is not None
    assert free.upper < lower  # and costs time here


def fraction(plant: str, displacement: float, time: float, change: int, cells: int) -> float:
    """The largest part of the rest that a staircase of the form reaches, in state space (HiGHS): nothing dual, no closed form."""
    model = StateSpace.of(PLANTS[plant]())
    target, _ = model.rest(displacement)
    transition, column, _ = model.step(time / cells)
    table = np.zeros((len(target), cells))
    for k in range(cells - 1, -1, -1):
        table[:, k], column = column, transition @ column
    scale = np.abs(table).max(axis=1)
    sign = np.where(np.arange(cells) < change, 1.0, -1.0)
    result = linprog(
        np.append(np.zeros(len(sign)), -1.0),
        A_eq=np.column_stack([table * sign, -target]) / scale[:, None],
        b_eq=np.zeros(len(target)),
        bounds=[*[(0.0, 1.0)] * len(sign), (0.0, None)],
        method="highs",
    )
    assert result.success
    return float(result.x[-1])


@pytest.mark.slow
def test_an_independent_program_agrees_on_both_sides() -> None:
    # A staircase is a command of the family: none may do it in less than the lower side; slightly longer than the upper one must.
    found = bound("spring", "5")
    lower, upper = proving.sides(found, 2e-5)
    assert max(fraction("spring", 5.0, lower * (1 - 1e-9), change, 120) for change in range(10, 120, 10)) < 1.0
    assert max(fraction("spring", 5.0, upper * 1.002, change, 240) for change in (110, 120, 130)) >= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("limits", [("-2", "1"), slow(("-1", "1")), slow(("-0.5", "1"))])
def test_damped_plants_and_limits_that_differ(limits: tuple[str, str]) -> None:
    found = bound("damped", "2", None, 0, limits)
    lower, upper = proving.sides(found, 1e-4)
    free = minimum_time(problem([PLANTS["damped"]()], Maneuver(exact("2"), Limits.of(*limits))))
    assert free.lower <= lower <= upper
    assert found.command is not None
    assert in_form(posed("damped", "2", None, 0, limits), found.command)


@pytest.mark.slow
def test_the_other_way_is_the_mirror() -> None:
    there, back = bound("spring", "5", None, 1), bound("spring", "-5", None, 1)
    assert proving.sides(there, 2e-9) == pytest.approx(proving.sides(back, 2e-9), rel=1e-9)
    assert back.command is not None
    assert back.command.segments[0].level == -1.0


@pytest.mark.slow
def test_the_claim_says_what_family_it_is_about() -> None:
    found = bound("spring", "5", None, 1)
    assert found.certificate is not None
    words = claim(check(found.certificate))
    assert "The claim is about inputs of this form alone." in words
    assert "on its positive side" in words


LIES: dict[str, Any] = {
    "a higher lower side": lambda data: data["claim"].update(lower="7.7211"),
    "all commands": lambda data: data["task"]["limits"].update(held=None),
    "the mirrored form": lambda data: data["task"]["limits"].update(held="negative, then positive"),
    "changes of sign left out": lambda data: data["lower"]["changes"].__delitem__(slice(12, 40)),
    "changes that do not cover the time": lambda data: data["lower"]["changes"].pop(),
    "changes that begin later": lambda data: data["lower"]["changes"].__delitem__(slice(0, 2)),
    "a command of another form": lambda data: data["upper"]["segments"][2].update(level="-1"),
    "more fuel": lambda data: data["task"]["limits"].update(fuel="4"),
    "a longer way": lambda data: data["task"].update(displacement="-5"),
}


@pytest.mark.parametrize("lie", first(4, LIES))
def test_lies_about_a_form_are_not_proved(lie: str) -> None:
    found = bound("spring", "5", None, 1)
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert check(changed(found.certificate, LIES[lie])).outcome is not Outcome.PROVED


def test_what_no_form_can_do_is_refused() -> None:
    with pytest.raises(ManeuverError, match="rigid-body mode"):
        towards(transfer([1], [1, 0, 1])(), Fraction(1))
    with pytest.raises(ManeuverError, match="3 integrators"):
        towards(transfer([1], [1, 0, 0, 0])(), Fraction(1))


def test_too_little_fuel_is_impossible_in_form_too() -> None:
    assert bound("lag", "1", "0.9").status is Status.IMPOSSIBLE
    assert bound("lag", "1", "1.2").status is Status.PROVED


def held_system(rest: int = 0) -> Any:
    return SimpleNamespace(rest=rest, task=SimpleNamespace(limits=SimpleNamespace(held="positive, then negative")))


def test_a_level_that_may_be_on_the_other_side_has_changed_its_sign() -> None:
    """A ball from -1/2 to exactly 0: the level after it may not go back."""
    balls = (arb(-0.25 - k * 2.0**-33, 0.25) for k in range(-200, 200))
    doubtful = next(ball for ball in balls if 1 * ball <= 0 and not 1 * ball < 0)  # products are rounded outward
    changes.form(held_system(), [fmpq(1), doubtful, fmpq(-1)])
    with pytest.raises(Refuted, match="level 2"):
        changes.form(held_system(), [fmpq(1), doubtful, fmpq(1), fmpq(-1)])


def test_a_form_is_of_moves_that_end_without_input() -> None:
    """Else the input at the target were on the first side for ever."""
    for claimed in (lambda system: changes.form(system, [fmpq(1)]), lambda system: changes.prove(system, [], fmpq(1), lambda *_: arb(0))):
        with pytest.raises(Undecided, match="without input"):
            claimed(held_system(rest=1))


def test_no_changes_of_sign_are_too_close_to_be_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    content = bound("spring", "5", None, 1).certificate
    assert content is not None
    seen: list[Any] = []
    between = changes.between
    monkeypatch.setattr(changes, "between", lambda *given: (seen.append(given[2:4]), between(*given))[1])
    assert check(content).outcome is Outcome.PROVED
    before = len(seen)

    def closely(data: Any) -> None:
        nodes = data["lower"]["changes"]
        place = next(i for i, (a, b) in enumerate(pairwise(nodes)) if number(a["at"]) < number(b["at"]))
        nodes.insert(place + 1, {**nodes[place], "at": written(number(nodes[place]["at"]) + Fraction(1, 10**42))})

    seen.clear()
    check(changed(content, closely))
    assert len(seen) % (before + 1) == 0
