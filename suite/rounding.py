"""Decimals of a bound that remain a bound."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

VERY_SMALL = Decimal("1e-6")


def interval(sides: Sequence[float]) -> str:
    """Both ends, rounded outward."""
    return f"[{outward(sides[0], ROUND_FLOOR)}, {outward(sides[1], ROUND_CEILING)}]"


def outward(value: float | None, rounding: str) -> str:
    """12 decimals, of small numbers 13 digits, of very small ones 6 and the power of ten; rounded so that a bound stays one."""
    if value is None:
        return "–"
    exact = Decimal(value)
    if 0 < exact < VERY_SMALL:
        return f"{exact.quantize(Decimal(1).scaleb(exact.adjusted() - 5), rounding):.5e}"
    decimals = max(12, 12 - exact.adjusted()) if exact < Decimal("0.1") and exact else 12
    return f"{exact.quantize(Decimal(1).scaleb(-decimals), rounding):f}"
