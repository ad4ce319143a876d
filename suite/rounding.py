"""Decimals of a bound that remain a bound."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal


def interval(sides: Sequence[float]) -> str:
    """Both ends, rounded outward."""
    return f"[{outward(sides[0], ROUND_FLOOR)}, {outward(sides[1], ROUND_CEILING)}]"


def outward(value: float | None, rounding: str) -> str:
    """12 decimals, of small numbers 13 digits, rounded so that a bound stays one."""
    if value is None:
        return "–"
    exact = Decimal(value)
    decimals = max(12, 12 - exact.adjusted()) if exact < Decimal("0.1") and exact else 12
    return f"{exact.quantize(Decimal(1).scaleb(-decimals), rounding):f}"
