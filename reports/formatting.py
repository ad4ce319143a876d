"""Numbers as people read them, without changing what they say: rounding never moves a value across its limit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context

NOTHING = "–"
_MOST_DIGITS = 17  # tell any two float64 apart


def number(value: float | None, apart_from: Iterable[float | None] = (), digits: int = 6) -> str:
    """`value` to `digits` significant digits, or as many as show on which side of the numbers in `apart_from` it lies; – for None."""
    if value is None:
        return NOTHING
    others = [other for other in apart_from if other is not None]
    for count in range(digits, _MOST_DIGITS + 1):
        text = f"{value:.{count}g}"
        shown = float(text)
        if all((shown > other) == (value > other) and (shown < other) == (value < other) for other in others):
            return _plain(text)
    return _plain(repr(value))


def exact(value: float | None) -> str:
    """The shortest decimal that gives `value` back; – for None."""
    return NOTHING if value is None else _plain(repr(float(value)).removesuffix(".0"))


def at_least(value: float | None, digits: int = 10) -> str:
    """A lower bound to so many significant digits, rounded down, so that it remains one."""
    return NOTHING if value is None else _plain(f"{Context(prec=digits, rounding=ROUND_FLOOR).create_decimal(value):g}")


def at_most(value: float | None, digits: int = 10) -> str:
    """An upper bound to so many significant digits, rounded up."""
    return NOTHING if value is None else _plain(f"{Context(prec=digits, rounding=ROUND_CEILING).create_decimal(value):g}")


def with_unit(text: str, unit: str | None) -> str:
    """A number and its unit, kept on one line."""
    return text if not unit or text == NOTHING else f"{text}\u00a0{unit}"


def bounds(requirement: Mapping[str, float | None]) -> str:
    """A requirement's limits, which are inclusive: `≤ 0.05`, `≥ 2`, or both."""
    low, high = requirement["min"], requirement["max"]
    if low is not None and high is not None:
        return f"{number(low)} to {number(high)}"
    return f"≤ {number(high)}" if high is not None else f"≥ {number(low)}" if low is not None else NOTHING


def quantity(name: str, value: float | None, verdict: str, apart_from: Iterable[float | None] = ()) -> str:
    """A quantity's value; the rate of a jump is infinite, which JSON writes as null."""
    if value is None and name == "peak_rate" and verdict in ("pass", "fail"):
        return "∞"
    return number(value, apart_from)


def bracket(lower: float | None, upper: float | None) -> tuple[str, str, str]:
    """The digits that both sides have in common, then the rest of the lower and of the upper side."""
    low, high = exact(lower), exact(upper)
    same = next((i for i, (a, b) in enumerate(zip(low, high, strict=False)) if a != b), min(len(low), len(high)))
    return low[:same], low[same:], high[same:]


def gap(lower: float | None, upper: float | None) -> float | None:
    """upper/lower - 1; 0 for an empty move, None where it does not exist."""
    if lower is None or upper is None:
        return None
    if lower == upper:
        return 0.0
    return upper / lower - 1.0 if lower > 0.0 else None


def sentence(text: str | None) -> str:
    """A reason as a sentence of its own."""
    return text[0].upper() + text[1:] if text else ""


def _plain(text: str) -> str:
    """`1e-09` as `1e-9`."""
    return re.sub(r"e([+-])0+(?=\d)", r"e\1", text).replace("e+", "e")
