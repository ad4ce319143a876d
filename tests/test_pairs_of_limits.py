"""Every pair of limits on one plant, and some triples: a bracket that is proven and closed, or a refusal in words; none makes it faster."""

from __future__ import annotations

import functools
import itertools
from fractions import Fraction
from typing import Any

import pytest
from box_tasks import TWIN, axis

from fmus.twins import twin_family
from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Box

FAMILY = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})
NAMES = ("box", "rate", "fuel", "velocity", "samples", "pulses", "start")
REFUSED = {
    frozenset({"box", "start"}): "an initial state is one plant's",
    frozenset({"rate", "pulses"}): "do not go with pulses",
    frozenset({"samples", "pulses"}): "sample",
}
"""What theory refuses (docs/task.md), and a part of the words."""

CHEAP = (
    "fuel",
    "start",
    "pulses",
    "samples",
    "rate",
    "fuel samples",
    "rate samples",
    "fuel start",
    "rate pulses",
    "box start",
    "samples pulses",
)
TRIPLES = ("box rate samples", "rate fuel start", "fuel velocity start", "rate samples start", "box fuel samples", "fuel samples start")
GAP, SLOPED = 1e-4, 1e-6  # of the input's slope alone, or with fuel, an output, a start


def posed(names: frozenset[str]) -> Problem:
    """Two masses of 1 kg, a spring of 1 N/m and 1 N; 1 m to rest."""
    plant = FAMILY.member([Fraction(1)])
    limits: dict[str, Any] = {"deflection": {"output_rate": Fraction("0.4")} if "velocity" in names else {}}
    if "fuel" in names:
        limits["fuel"] = Fraction("1.5")
    if "rate" in names:
        limits["rate"] = (Fraction(-3), Fraction(3))
    if "pulses" in names:
        limits["pulse_width"] = Fraction("0.3")
    others: dict[str, Any] = {"sample_time": Fraction("0.05")} if "samples" in names else {}
    if "start" in names:
        others["initial"] = tuple(Fraction(x) for x in ("0.1", "0", "0.05", "0"))
    if "box" in names:
        others["box"] = Box((axis("stiffness", "0.1"),), FAMILY, Fraction("0.05"))
    return problem([plant], Maneuver(Fraction(1), Limits(Fraction(-1), Fraction(1), **limits), **others))


@functools.cache
def bound(names: frozenset[str]) -> Bound:
    return minimum_time(posed(names))


def holds(text: str) -> None:
    names = frozenset(text.split())
    words = [told for pair, told in REFUSED.items() if pair <= names]
    if words:
        with pytest.raises(ManeuverError, match=words[0]):
            posed(names)
        return
    found = bound(names)
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= GAP or "pulses" in names  # whose lower side is that of all inputs
    assert found.gap <= SLOPED or "rate" not in names or {"box", "samples"} & names
    assert found.upper is not None
    for fewer in itertools.combinations(sorted(names), len(names) - 1):
        # What is asked besides takes no less time. A start is another task, a box asks for a residual instead of rest, and a slope on
        # samples is a limit of their steps.
        left = names - frozenset(fewer)
        if fewer and not {"start", "box"} & left and not (left == {"samples"} and "rate" in names):
            assert found.upper >= bound(frozenset(fewer)).lower * (1 - 1e-12)


@pytest.mark.parametrize("text", CHEAP)
def test_what_is_cheap(text: str) -> None:
    holds(text)


@pytest.mark.slow
@pytest.mark.parametrize("text", [" ".join(pair) for pair in itertools.combinations(NAMES, 2) if " ".join(pair) not in CHEAP])
def test_every_pair(text: str) -> None:
    holds(text)


@pytest.mark.slow
@pytest.mark.parametrize("text", TRIPLES)
def test_some_triples(text: str) -> None:
    holds(text)
