"""Numbers for people: short, but never on the other side of their limit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.formatting import at_least, at_most, bounds, bracket, exact, gap, number, quantity, sentence, with_unit


@pytest.mark.parametrize(
    ("value", "apart_from", "text"),
    [
        (None, (), "–"),
        (0.0, (), "0"),
        (0.046330000001, (0.05,), "0.04633"),
        (0.0500000001, (0.05,), "0.0500000001"),
        (0.05, (0.05,), "0.05"),
        (-1e-9, (0.0,), "-1e-9"),
        (3.1e-10, (), "3.1e-10"),
        (1e21, (), "1e21"),
        (float(2**53 + 2), (float(2**53),), "9.0072e15"),
    ],
)
def test_numbers(value: float | None, apart_from: tuple[float, ...], text: str) -> None:
    assert number(value, apart_from) == text


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_rounding_never_crosses_a_limit(value: float, limit: float) -> None:
    shown = float(number(value, (limit,)))
    assert (shown > limit) == (value > limit)
    assert (shown < limit) == (value < limit)
    assert float(exact(value)) == value


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_a_bracket_is_shown_exactly(lower: float, upper: float) -> None:
    common, low, high = bracket(lower, upper)
    assert (float(common + low), float(common + high)) == (lower, upper)


@given(st.floats(1e-300, 1e300), st.integers(1, 12))
def test_rounded_bounds_remain_bounds(value: float, digits: int) -> None:
    assert float(at_least(value, digits)) <= value <= float(at_most(value, digits))
    assert float(at_most(value, digits)) <= value * (1 + 2 * 10.0 ** (1 - digits))


def test_rounded_bounds() -> None:
    assert (at_least(0.15 + 1e-12), at_most(0.15 + 1e-12), at_least(None)) == ("0.1500000000", "0.1500000001", "–")
    assert (at_least(1.0), at_most(3.001e-9, 3)) == ("1", "3.01e-9")


def test_brackets_and_gaps() -> None:
    assert bracket(9.14867432411051, 9.14867432411053) == ("9.1486743241105", "1", "3")
    assert bracket(2.0, 2.5) == ("2", "", ".5")
    assert bracket(None, 2.5) == ("", "–", "2.5")
    assert gap(2.0, 3.0) == 0.5
    assert gap(0.0, 0.0) == 0.0
    assert gap(0.0, 1.0) is None
    assert gap(1.0, None) is None


def test_limits_and_units() -> None:
    assert bounds({"min": None, "max": 0.05}) == "≤ 0.05"
    assert bounds({"min": 2.0, "max": None}) == "≥ 2"
    assert bounds({"min": 4.99, "max": 5.01}) == "4.99 to 5.01"
    assert with_unit("5", "m") == "5\u00a0m"
    assert with_unit("–", "m") == "–"
    assert quantity("peak_rate", None, "fail") == "∞"
    assert quantity("peak_rate", None, "error") == "–"
    assert quantity("fuel", None, "pass") == "–"
    assert sentence("the limit is near") == "The limit is near"
    assert sentence(None) == ""
