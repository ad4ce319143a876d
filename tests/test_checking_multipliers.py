"""Multipliers of the lower side, one by one: where a continuous input begins its tail, and what outputs take off the costate."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from flint import acb, arb, fmpq
from forgery import certificate, command, costate, system, task

from relaxations.checking import courses, lower
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import read

pytestmark = pytest.mark.usefixtures("enough_work")


@pytest.mark.parametrize("first", ["0", "3", "-5/4"])
def test_a_costate_is_moved_onto_the_equalities_of_a_continuous_tail(first: str) -> None:
    """`λᵀ column_j + q(0) shape_j(0) = 0`: of the shapes e^{-3r}, Re e^{zr} and Re i e^{zr} the last one begins at 0."""
    of = task(["1", "5", "11", "15"], ["1", "1.2", "4.2", "4", "0", "0"], "2", rest="output", rate=["-4", "4"])  # (s + 3)(s² + 2s + 5)
    ramps: Any = [{"edges": ["0", "1"], "levels": ["0"]}]
    witness = costate((("0", "0"), [("1", "0"), ("-2", "0")]), ramps=ramps, steps=[first])
    moved, price = lower.costate(system(of), read(certificate(of, "1", witnesses=(witness, None))).lower)
    posed, q = system(of), arb(fmpq(*map(int, f"{first}/1".split("/")[:2])))
    sums = (posed.columns.transpose() * moved).entries()
    begins = [x for zero in posed.zeros for x in ((1, 0) if zero.flexible else (1,))]
    assert [float(x) for x in (total + q * begin for total, begin in zip(sums, begins, strict=True))] == pytest.approx([0, 0, 0], abs=1e-25)
    assert price == 0


def test_what_several_multipliers_take_off_together() -> None:
    """The cart's speed answers 1 to an impulse of the input, s to a step: weights at once, and spread over intervals."""
    posed = system(task(["1"], ["1", "0", "0"], outputs={"rate": ["1", "0"]}, deflection={"rate": "0.5"}))
    roots = courses.common(posed.roots, 2)
    given = (("1", "1", "2"), ("2", "4", "3"), ("1/2", "1", "1"), ("5/2", "5/2", "-1"), ("6", "7", "9"))
    presses = [SimpleNamespace(output="rate", **dict(zip(("begin", "end", "weight"), map(_number, one), strict=True))) for one in given]
    kicks = courses.pressed(posed, roots, presses, arb(5))
    assert [float(at) for at, _ in kicks] == [0.5, 1, 1, 2, 2.5, 4]
    seen = 0
    for begin, length, chains in courses.pieces(roots, [[acb(0)] * root.multiplicity for root in roots], kicks, arb(5)):
        for share in (0.25, 0.75):
            s = float(begin) + share * float(length)
            expected = -2 * (s > 1) + (s > 2.5) - 1.5 * (max(s - 2, 0) - max(s - 4, 0)) - 2 * (max(s - 0.5, 0) - max(s - 1, 0))
            assert float(courses.value(roots, chains, arb(share) * length)) == pytest.approx(expected, abs=1e-12)
            seen += 1
    assert seen == 12


def _number(text: str) -> fmpq:
    above, _, below = text.partition("/")
    return fmpq(int(above), int(below or 1))


@pytest.mark.parametrize("rate", [["-4", "0"], ["0", "4"]])
def test_slopes_have_room_on_either_side(rate: list[str]) -> None:
    witness = command("2", [("0", "0"), ("1", "1")], [["level", 1, 0]])
    assert check(certificate(task(["1"], ["1", "0"], rate=rate), upper="2", witnesses=(None, witness))).outcome is Outcome.MALFORMED
    small = task(["1"], ["1", "0"], "1/4", rate=["-1/2", "1/2"])
    witness = command("2", [("0", "0"), ("1", "1/4")], [["level", 1, 0]])
    assert check(certificate(small, upper="2", witnesses=(None, witness))).outcome is Outcome.PROVED


def test_a_box_of_plants_that_are_listed_has_outputs_of_its_own() -> None:
    """Names and degrees of outputs, the nominal plant's highest coefficient, places: what is malformed, and what is not."""
    listed = [{"place": [str(k)], "numerator": ["2"], "denominator": ["2", str(2 + 2 * k)], "outputs": {"w": ["4"]}} for k in (0, 1)]
    parameter = {"name": "k", "nominal": "0", "low": "0", "high": "1"}
    box = {"parameters": [parameter], "numerator": [], "denominator": [], "outputs": {}, "plants": listed}
    box |= {"tolerance": "1/2", "final_tolerance": None}
    of = task(["1"], ["1", "1"], limits=("-5", "5"), outputs={"w": ["2"]}, deflection={"w": "9"})

    def malformed(**changes: Any) -> bool:
        witness = command("1", [("0", "1")], [])
        return check(certificate({**of, "box": {**box, **changes}}, upper="1", witnesses=(None, witness))).outcome is Outcome.MALFORMED

    def second(**changes: Any) -> list[Any]:
        return [listed[0], {**listed[1], **changes}]

    assert not malformed()
    assert malformed(plants=second(outputs={}))
    assert malformed(plants=second(outputs={"v": ["4"]}))
    assert malformed(plants=second(outputs={"w": ["4", "1"]}))
    assert malformed(plants=second(place=["0"]))
    assert malformed(plants=second(place=["2"]))
    assert malformed(plants=second(place=["1", "1"]))
    assert malformed(outputs={"w": [[["4", [0]]]]})
    assert malformed(tolerance="0")
    assert malformed(parameters=[{**parameter, "nominal": None}])
    assert malformed(plants=[{**listed[0], "numerator": ["1"]}, listed[1]])
    assert malformed(plants=[{**listed[0], "outputs": {"w": ["2"]}}, listed[1]])


LIMITED = task(["1", "1"], ["1", "2", "0"], rest="output", rate=["-4", "4"], outputs={"w": ["1"]}, deflection={"w": "9"})
AFTER = {"output": None, "time": "1", "upper": "1", "lower": "0"}


@pytest.mark.parametrize(
    ("changes", "fine"),
    [
        ({}, True),
        ({"output": "w"}, True),
        ({"time": "0", "lower": "1/2"}, True),
        ({"output": "v"}, False),
        ({"time": "-1"}, False),
        ({"upper": "-1"}, False),
        ({"lower": "-1/1000"}, False),
        ({"output": "w", "upper": "-1"}, False),
    ],
)
def test_multipliers_after_the_move_are_of_limits_and_not_negative(changes: dict[str, Any], fine: bool) -> None:
    witness = costate((("0", "0"), [("1", "0")]), after=[{**AFTER, **changes}])
    assert (check(certificate(LIMITED, "1", witnesses=(witness, None))).outcome is not Outcome.MALFORMED) == fine


def test_multipliers_belong_to_limits_that_there_are() -> None:
    def malformed(of: Any, **others: Any) -> bool:
        return check(certificate(of, "1", witnesses=(costate((("0", "0"), [("1", "0")]), **others), None))).outcome is Outcome.MALFORMED

    free = task(["1", "1"], ["1", "2", "0"], rest="output")
    assert malformed(free, after=[AFTER])
    assert malformed(free, fuel="1")
    assert malformed({**free, "limits": {**free["limits"], "fuel": "1"}}, fuel="-1")
    assert malformed({**free, "limits": {**free["limits"], "fuel": "0"}})
    assert not malformed({**free, "limits": {**free["limits"], "fuel": "1"}}, fuel="1/2")
    press = {"output": "w", "begin": "0", "end": "1", "weight": "1"}
    assert not malformed(LIMITED, deflection=[press])
    assert malformed(LIMITED, deflection=[{**press, "begin": "2"}])


def test_multipliers_of_a_start_add_up() -> None:
    """What the cart's speed of 3 is worth to several of them: 3 times their sum, in any order, each within the horizon."""
    posed = system(task(["1"], ["1", "0", "0"], initial_state=["0", "3"], outputs={"v": ["1", "0"]}, deflection={"v": "9"}))
    roots = courses.common(posed.roots, 2)
    given = (("1", "2", "2"), ("3", "3", "5"), ("2", "4", "-1"), ("1/2", "1/2", "7"))
    presses = [SimpleNamespace(output="v", **dict(zip(("begin", "end", "weight"), map(_number, one), strict=True))) for one in given]
    for order in (presses, presses[::-1], [presses[1], presses[0], *presses[2:]]):
        assert float(courses.begun(posed, roots, order, arb(5))) == pytest.approx(3 * (2 + 5 - 1 + 7), abs=1e-20)


def test_where_a_tail_begins_counts_beside_what_comes_after() -> None:
    """`λᵀ column_j + Σ (μ⁺ - μ⁻) shape_j(τ) + q(0) shape_j(0) = 0`."""
    of = task(["1", "3"], ["1", "1.2", "4.2", "4", "0", "0"], "2", rest="output", rate=["-4", "4"])
    ramps: Any = [{"edges": ["0", "1"], "levels": ["0"]}]
    contact = {"time": "1/2", "upper": "3", "lower": "1"}
    witness = costate((("0", "0"), [("1", "0"), ("-2", "0")]), ramps=ramps, steps=["5/4"], tail=[contact])
    moved, _ = lower.costate(system(of), read(certificate(of, "1", witnesses=(witness, None))).lower)
    (total,) = (system(of).columns.transpose() * moved).entries()
    assert float(total) == pytest.approx(-2 * math.exp(-1.5) - 1.25, abs=1e-25)
