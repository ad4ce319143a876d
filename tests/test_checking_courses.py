"""Certificates of limits of outputs: hand-made ones, and lies about them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from flint import arb, fmpq
from forgery import certificate, changed, command, costate, number, opened, proven_limited, system, task, written

from relaxations.checking import balls, courses, reading
from relaxations.checking.claims import Outcome, check, claim

# Lies, about the cart with |u| ≤ 1 and a speed of at most 1/2: T = 2.5, u = 1 until 0.5, -1 from 2 on; p = 2 (s - 1/2) until 1/2, 0
# until 2, 2 (s - 2) from there: λ = (-1, 2), the multiplier 2 per second of the speed between.

COURSE: dict[str, Any] = {"deflection": {"rate": "0.5"}, "outputs": {"rate": ["1", "0"]}}
PRESS = {"output": "rate", "begin": "0.5", "end": "2", "weight": "3"}


def lower_side(time: str, presses: list[dict[str, str]], **others: Any) -> Outcome:
    witness = costate((("0", "0"), [("-1", "0"), ("2", "0")]), deflection=presses)
    return check(certificate(task(["1"], ["1", "0", "0"], **{**COURSE, **others}), time, witnesses=(witness, None))).outcome


def test_the_lower_side_of_a_course() -> None:
    assert lower_side("2.4999999", [PRESS]) is Outcome.PROVED
    assert lower_side("2.5000001", [PRESS]) is Outcome.REFUTED
    assert lower_side("2.01", []) is Outcome.REFUTED
    parts = [{**PRESS, "end": "1.25", "weight": "1.5"}, {**PRESS, "begin": "1.25", "weight": "1.5"}]
    assert lower_side("2.4999999", parts) is Outcome.PROVED
    for change in ({"weight": "2.9"}, {"weight": "-3"}, {"begin": "0.6"}, {"end": "1.9"}, {"begin": "1.25", "end": "1.25"}):
        assert lower_side("2.4999999", [{**PRESS, **change}]) is not Outcome.PROVED
    assert lower_side("2.4999999", [PRESS], deflection={"rate": "0.501"}) is Outcome.REFUTED
    assert lower_side("2.4999999", [PRESS], outputs={"rate": ["0.999", "0"]}) is not Outcome.PROVED
    assert lower_side("2.4999999", [PRESS], outputs={"rate": ["1.001", "0"]}) is not Outcome.PROVED


def test_the_upper_side_of_a_course() -> None:
    def outcome(time: str, limit: str, segments: list[tuple[str, str]]) -> Outcome:
        posed = task(["1"], ["1", "0", "0"], **{**COURSE, "deflection": {"rate": limit}})
        return check(certificate(posed, upper=time, witnesses=(None, command(time, segments, [["level", 0, 0], ["level", 2, 0]])))).outcome

    slower = [("0", "0.952380952"), ("0.5", "0"), ("2.1", "-0.952380952")]  # 1/2.1 fast
    assert outcome("2.6", "0.4762", slower) is Outcome.PROVED
    assert outcome("2.6", "0.4761", slower) is Outcome.REFUTED
    assert outcome("2.6", "0.5", slower) is Outcome.PROVED


def test_what_the_checker_calls_malformed() -> None:
    for others in (
        {"outputs": {}},
        {"deflection": {}},
        {"deflection": {"rate": "0"}},
        {"deflection": {"rate": "-0.5"}},
        {"outputs": {"rate": ["1", "0", "0"]}},
        {"outputs": {"rate": ["0", "1"]}},
        {"outputs": {"rate": ["1"]}},  # this output rests at 1, beyond its limit
    ):
        assert lower_side("2.4", [PRESS], **others) is Outcome.MALFORMED, others
    for change in ({"output": "speed"}, {"begin": "-1"}, {"begin": "3"}):
        assert lower_side("2.4", [{**PRESS, **change}]) is Outcome.MALFORMED


def test_the_whole_move_is_looked_at_from_its_exact_begin() -> None:
    """The cart's speed: that of a duration in a ball until its end; and one that begins at its limit, and falls from there."""

    def outcome(limit: str, numbers: list[Any], start: list[str] | None = None) -> str:
        posed = system(task(["1"], ["1", "0", "0"], initial_state=start, **{**COURSE, "deflection": {"rate": limit}}))
        posed.task.rest = "output"  # these end in no rest, from which a course could be known at its end
        balls.work["left"] = 1e8
        try:
            courses.prove(posed, (len(numbers) - 1) // 2, numbers)
        except (reading.Refuted, reading.Undecided) as problem:
            return f"{type(problem).__name__}: {problem}"
        return "proved"

    assert outcome("2.0101", [arb(2, 0.01), fmpq(0), fmpq(1)]) == "proved"
    assert outcome("2.005", [arb(2, 0.01), fmpq(0), fmpq(1)]) != "proved"
    assert outcome("1.9", [fmpq(2), fmpq(0), fmpq(1)]) == "Refuted: the output rate leaves its limit"
    for side in (1, -1):
        falls = [fmpq(2), fmpq(0), fmpq(1), fmpq(-side, 2), fmpq(0)]
        assert outcome("0.5", falls, ["0", str(fmpq(side, 2))]) == "proved"
        assert outcome("0.5", [x if i < 3 else -x for i, x in enumerate(falls)], ["0", str(fmpq(side, 2))]) != "proved"


def test_what_is_given_of_outputs_has_their_names() -> None:
    read = reading.by_name([reading.real, 1, 2])
    assert read({"a": ["1"], "b": ["2", "1/2"]}, "here") == {"a": (1,), "b": (2, fmpq(1, 2))}
    assert len(read({f"w{i}": ["1"] for i in range(reading.MOST_OUTPUTS)}, "here")) == reading.MOST_OUTPUTS
    for data, said in (
        ({f"w{i}": ["1"] for i in range(reading.MOST_OUTPUTS + 1)}, "here names at most 50 outputs"),
        ([], "here names at most 50 outputs"),
        (None, "here names at most 50 outputs"),
        ({"": ["1"]}, "here is a short name"),
        ({"a\n": ["1"]}, "here is a short name"),
        ({"a": "1"}, r"here\.a is an array of 1 to 2 items"),
        ({"a": ["x"]}, r"here\.a\[0\] is no exact number: 'x'"),
    ):
        with pytest.raises(reading.Malformed, match=said):
            read(data, "here")


def test_a_changed_limit_changes_the_claim() -> None:
    content = proven_limited("speed")
    assert "'output_rate', numerator [1, 0], never leaves its first rest value by more than 0.5" in claim(check(content))
    times = [number(opened(content)["claim"][side]) for side in ("lower", "upper")]
    for limit, outcome in (("0.499", Outcome.REFUTED), ("0.51", Outcome.REFUTED)):
        lie = changed(content, lambda data, limit=limit: data["task"]["limits"]["deflection"].update(output_rate=limit))
        assert check(lie).outcome is outcome
    for side, time, factor in zip(("lower", "upper"), times, (Fraction(100001, 100000), Fraction(99999, 100000)), strict=True):
        lie = changed(content, lambda data, side=side, time=time, factor=factor: data["claim"].update({side: written(time * factor)}))
        assert check(lie).outcome is Outcome.REFUTED
