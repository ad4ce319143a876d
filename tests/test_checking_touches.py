"""Courses that touch their limits where the move begins and where it ends, and nowhere else; pulses beside a first rest that is not 0."""

from __future__ import annotations

from typing import Any

import pytest
from flint import acb, arb, fmpq
from forgery import certificate, command, costate, system, task

from relaxations.checking import balls, courses
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import Refuted, Undecided

pytestmark = pytest.mark.usefixtures("enough_work")

PLACE = {"y": ["1"]}


def moved(segments: list[tuple[str, str]], time: str, displacement: str, limit: str, outputs: dict[str, Any] = PLACE) -> Outcome:
    """The cart 1/s², by a given command."""
    posed = task(["1"], ["1", "0", "0"], displacement, limits=("-1", "1"), outputs=outputs, deflection=dict.fromkeys(outputs, limit))
    return check(certificate(posed, upper=time, witnesses=(None, command(time, segments, [])))).outcome


def test_a_cart_may_stop_at_its_limit_but_not_pass_it_on_the_way() -> None:
    assert moved([("0", "1"), ("1", "-1")], "2", "1", "1") is Outcome.PROVED
    assert moved([("0", "-1"), ("1", "1")], "2", "-1", "1") is Outcome.PROVED
    assert moved([("0", "1"), ("1", "0"), ("2", "-1")], "3", "2", "2") is Outcome.PROVED
    there_and_back = [("0", "1"), ("1", "-1"), ("5/2", "1")]  # to 1, and back to 3/4
    assert moved(there_and_back, "3", "3/4", "99/100") is Outcome.REFUTED
    assert moved(there_and_back, "3", "3/4", "101/100") is Outcome.PROVED
    assert moved(there_and_back, "3", "3/4", "3/4") is Outcome.REFUTED


def test_where_a_cart_begins_is_known_of_its_first_piece_alone() -> None:
    """From -1/4 at rest to 3/4, and back to 1/2: the second piece begins somewhere else, and faster."""
    segments = [("0", "1"), ("1", "-1"), ("5/2", "1")]
    for limit, outcome in (("37/50", Outcome.REFUTED), ("19/25", Outcome.PROVED)):
        posed = task(["1"], ["1", "0", "0"], "1/2", limits=("-2", "2"), initial_state=["-1/4", "0"], outputs=PLACE, deflection={"y": limit})
        assert (
            check(certificate(posed, upper="3", witnesses=(None, command("3", segments, [["level", 1, 0], ["level", 2, 0]])))).outcome
            is outcome
        )


def test_a_speed_that_begins_and_rests_at_0_is_limited_all_the_same() -> None:
    speed = {"v": ["1", "0"]}
    assert moved([("0", "1"), ("1", "-1")], "2", "1", "9/10", speed) is Outcome.REFUTED
    assert moved([("0", "1"), ("1", "-1")], "2", "1", "11/10", speed) is Outcome.PROVED
    assert moved([("0", "1"), ("1", "0"), ("2", "-1")], "3", "2", "9/10", speed) is Outcome.REFUTED


@pytest.mark.parametrize(
    ("numerator", "output", "expected"),
    [
        (["2"], ["4"], [6, 0, 0]),
        (["2"], ["1", "4"], [6, 0]),
        (["2"], ["5", "1", "4"], [6]),
        (["1", "2"], ["7", "4"], [6, 0]),
        (["2"], ["1", "0"], [0, 0]),
    ],
)
def test_where_an_output_rests(numerator: list[str], output: list[str], expected: list[int]) -> None:
    """3 N(0)/2, and as many derivatives as it has before the input comes into them."""
    posed = task(numerator, ["1", "2", "1", "0"], "3", outputs={"w": output}, deflection={"w": "9"})
    assert courses.resting(system(posed).task, "w") == [fmpq(x) for x in expected]
    if len(numerator) > 1:
        assert courses.resting(system({**posed, "rest": "output"}).task, "w") == []


def wave(*coefficients: float) -> balls.Wave:
    """Σ c_k t^k/k!."""
    return balls.Wave.of((balls.Root(acb(0), len(coefficients)),), [arb(c) for c in coefficients])


def within(course: balls.Wave, last: list[int], limit: int = 1, end: float = 1.0) -> str:
    try:
        courses.within(course, arb(end), fmpq(limit), "w", (), [fmpq(x) for x in last])
    except (Refuted, Undecided) as problem:
        return type(problem).__name__
    return "within"


@pytest.mark.parametrize("side", [1, -1])
def test_what_is_exact_at_the_end_may_touch_there(side: int) -> None:
    for course, last, outcome in (
        ((0, 1), [1], "within"),  # straight to the limit
        ((0, 1), [], "Undecided"),
        ((0, 2, -2), [1, 0], "within"),  # 1 - (1 - t)²
        ((0, 2, -2), [1], "Undecided"),
        ((0, 3, -6, 6), [1, 0, 0], "within"),  # 1 - (1 - t)³
        ((0.5, 2, -5, 6), [1, 0], "Undecided"),  # beyond it before the end, and close to it there
        ((2, -2, 2), [1, 0], "Refuted"),  # 1 + (1 - t)²
        ((1.5, -0.5), [1], "Refuted"),  # down to it
    ):
        assert within(wave(*(side * c for c in course)), [side * x for x in last]) == outcome, course
    assert within(wave(*(side * c for c in (0, 1))), [side * 2], end=2.0) != "within", "its end is beyond the limit"


def test_taylor_from_the_other_end() -> None:
    """z(r) = y(1 - r): each derivative of odd order has the other sign."""
    span = arb(0).union(arb(1))

    def recedes(back: bool, first: tuple[int, ...], *derivatives: float) -> bool:
        # The course is asked for its derivatives over the span, and for nothing else.
        def course(_: arb) -> list[arb]:
            return [arb(0, 9), *(arb(x) for x in derivatives)]

        asked: Any = course
        return courses.recedes(asked, span, fmpq(1), [fmpq(x) for x in first], 1, back=back)

    assert recedes(True, (1,), 1)
    assert not recedes(True, (1,), -1)
    assert recedes(False, (1,), -1)
    assert not recedes(False, (1,), 1)
    for back in (True, False):
        assert recedes(back, (1, 0), 1 if not back else -1, -1)
        assert not recedes(back, (1, 0), 1 if not back else -1, 1)
        assert not recedes(back, (2, 0), -1 if not back else 1, -1)
        assert not recedes(back, (), -1 if not back else 1)
    # A slope at the end that carries it over the limit, whatever comes later.
    assert not recedes(True, (1, -1, 0), -1, 1, 1)
    assert not recedes(False, (1, 1, 0), 1, 1, -1)
    # The third decides: backwards it falls where y''' ≥ 0; not where the second carries it over.
    assert recedes(True, (1, 0, 0), -1, 1, 1)
    assert not recedes(True, (1, 0, 0), -1, 1, -1)
    assert recedes(False, (1, 0, 0), 1, 1, -1)
    assert not recedes(False, (1, 0, 0), 1, 1, 1)
    assert recedes(True, (1, 1, 0), -1, 1, 1)
    assert recedes(False, (1, -1, 0), 1, 1, -1)
    for back, third in ((True, 1), (False, -1)):
        assert not recedes(back, (1, 0, 1), -1 if back else 1, 1, third)


@pytest.mark.parametrize("numerator", [["1", "4", "2"], ["3", "6"]])
@pytest.mark.parametrize("factor", [["1"], ["2", "1"]])
def test_an_output_with_the_controlled_one_s_zeros_is_not_moved_by_a_tail_at_all(numerator: list[str], factor: list[str]) -> None:
    """Not even by the width of a ball, though the zeros are irrational."""
    output = [str(sum(int(a) * int(b) for i, a in enumerate(numerator) for j, b in enumerate(factor) if i + j == k))
              for k in range(len(numerator) + len(factor) - 1)]  # fmt: skip
    posed = system(task(numerator, ["1", "5", "7", "3", "1", "0"], "1", rest="output", outputs={"w": output}, deflection={"w": "9"}))
    answer, *_ = posed.after("w")
    assert all(x.is_zero() for zero in posed.zeros for x in answer([acb(3)] * zero.multiplicity, zero))
    other = [*output[:-1], str(int(output[-1]) + 1)]
    posed = system(task(numerator, ["1", "5", "7", "3", "1", "0"], "1", rest="output", outputs={"w": other}, deflection={"w": "9"}))
    answer, *_ = posed.after("w")
    assert not any(x.contains(0) for zero in posed.zeros for x in answer([acb(3)] * zero.multiplicity, zero)[:1])


def test_pulses_beside_a_first_rest_that_is_not_0() -> None:
    posed = task(["1"], ["1", "0", "0"], limits=("0", "2"), initial_input="1", pulses=2)
    full = command("2", [("0", "2"), ("1", "0")], [])
    assert check(certificate(posed, upper="2", witnesses=(None, full))).outcome is Outcome.PROVED
    narrow = {**posed, "limits": {**posed["limits"], "input": ["-1", "2"]}}
    assert check(certificate(narrow, upper="2", witnesses=(None, full))).outcome is not Outcome.PROVED


@pytest.mark.parametrize(
    ("form", "first", "second"),
    [("positive, then negative", "positive", "negative"), ("negative, then positive", "negative", "positive")],
)
def test_the_claim_says_which_form_is_meant(form: str, first: str, second: str) -> None:
    posed = task(["1"], ["1", "0", "0"], limits=("0", "2"), initial_input="1", held=form)
    said = claim(check(certificate(posed, lower="0", witnesses=(costate(), None))))
    assert f"until some instant of the move u is 1 or on its {first} side, and from then on\n  1 or on its {second} side." in said
