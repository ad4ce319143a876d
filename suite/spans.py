"""Options of the form LO:HI:N."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from fractions import Fraction

SPAN = re.compile(r"([^:]+):([^:]+):(\d+)")


def span(option: str, text: str, most: int, example: str, error: type[Exception]) -> tuple[Fraction, Fraction, int]:
    """Both ends, exact, and how many values; raises `error` unless LO < HI and N is from 2 to `most`."""
    match = SPAN.fullmatch(text.strip())
    try:
        if match is None:
            raise InvalidOperation
        low, high = (Fraction(Decimal(part)) for part in match.groups()[:2])
    except (InvalidOperation, ValueError, OverflowError):
        raise error(f"{option} is LO:HI:N, such as {example}, not {text!r}") from None
    count = int(match[3])
    if not 2 <= count <= most or not low < high:
        raise error(f"{option} {text}: LO < HI, and N from 2 to {most}")
    return low, high, count
