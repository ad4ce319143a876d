"""Decimals of a bound that remain a bound, and numbers that JSON has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

LONGEST = 30  # decimals; of what is smaller the power of ten is written
LARGEST = 12  # digits before the point; of what is larger too


def interval(sides: Sequence[float]) -> str:
    """Both ends, rounded outward."""
    return f"[{outward(sides[0], ROUND_FLOOR)}, {outward(sides[1], ROUND_CEILING)}]"


def outward(value: float | None, rounding: str) -> str:
    """12 decimals, of small numbers 13 digits, of very small and large ones with their power of ten, rounded so that a bound stays one."""
    if value is None:
        return "–"
    if not math.isfinite(value):
        return repr(value)
    exact = Decimal(value)
    decimals = max(12, 12 - exact.adjusted()) if exact < Decimal("0.1") and exact else 12
    if decimals > LONGEST or exact.adjusted() >= LARGEST:
        return f"{Context(prec=13, rounding=rounding).plus(exact):.12e}"
    return f"{exact.quantize(Decimal(1).scaleb(-decimals), rounding):f}"


def number(value: float | None) -> float | None:
    """A number for JSON: null where it does not exist or is infinite."""
    return value if value is not None and math.isfinite(value) else None
