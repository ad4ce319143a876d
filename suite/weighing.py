"""Fuel weighed against time, `∫ (1 + α|u|) dt`: what is found of it as records and words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import ROUND_CEILING, ROUND_FLOOR
from fractions import Fraction
from typing import Any

from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem
from relaxations.onoff.weights import Weighted, weighted
from suite.errors import ABSENT, Mistake, StudyError
from suite.rounding import outward
from suite.study import Study


def weighed(study: Study, posed: Problem, alpha: Fraction) -> Weighted:
    """The least `T + α fuel` of a study's move; raises `StudyError` where there is none."""
    try:
        return weighted(posed, alpha)
    except ManeuverError as refused:
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, f"has no least cost: {refused}")]) from None


def status(found: Weighted) -> str:
    """`proved`: both sides are; `bracketed`: one is missing."""
    return "bracketed" if found.lower is None or found.upper is None else "proved"


def record(found: Weighted, rest: float, certificate: str | None) -> dict[str, Any]:
    """The object `weighted` of `bound --json` and of an evidence folder's results, and most of `fuel --alpha --json` (docs/schemas.md)."""
    prices = found.prices and [found.prices[0], found.prices[1] if math.isfinite(found.prices[1]) else None]
    return {
        "status": status(found),
        "alpha": float(found.price),
        "cost": {"lower": found.lower, "upper": found.upper},
        "maneuver_time": found.command.maneuver_time,
        "fuel": found.command.fuel(rest),
        "switch_times": [segment.start for segment in found.command.segments[1:]],
        "extremal": found.extremal,
        "extremal_prices": prices,
        "command": found.command.to_dict(),
        "certificate": certificate,
    }


def lines(found: Weighted, rest: float, unit: str) -> Iterator[str]:
    """The same in words."""
    low = "–" if found.lower is None else outward(found.lower, ROUND_FLOOR)
    high = "–" if found.upper is None else outward(found.upper, ROUND_CEILING)
    yield f"least cost ∫(1 + {float(found.price):g}·|u|) dt: [{low}, {high}] s: {status(found)}"
    if status(found) != "proved":
        yield f"a side without a number is not proven; the command costs {found.computed:.12g} s in floating point"
    yield f"maneuver time {found.command.maneuver_time:.12g} s, fuel {found.command.fuel(rest):.12g} {unit}"
    if found.prices is None:
        yield "dead-zone check (maximum principle): for no α is this command extremal"
        return
    low, high = (f"{one:.6g}" if math.isfinite(one) else "∞" for one in found.prices)
    verdict = "passed" if found.extremal else "failed"
    yield f"dead-zone check (maximum principle): {verdict}; the command is extremal for α from {low} to {high} s per {unit}"
