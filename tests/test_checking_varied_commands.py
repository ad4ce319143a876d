"""The upper side of a plant that varies: commands that land, by an integration of one's own, and each limit just kept and just missed."""

from __future__ import annotations

import functools
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from flint import arb
from forgery import certificate, command, task
from marks import first
from numpy.typing import NDArray
from scipy.optimize import fsolve
from test_checking_varied import INSTANTS, Case, scheduled, written

from relaxations.checking import varying, varying_courses
from relaxations.checking.claims import Check, Outcome, check

STEPS = 50  # of Runge and Kutta for each piece: an error of 1e-10
OFF = 1e-6  # by how much a limit is kept, or missed
TARGET = 0.4
FREE = {
    "instants": [["time", 0, 0], ["start", 1, 0]],
    "levels": [["level", 0, 0], ["level", 2, 0]],
    "straight": [["level", 1, 0], ["level", 3, 0]],
    "pulses": [["start", 1, 0], ["start", 2, 0]],
}


def course(case: Case, starts: list[float], levels: list[float], end: float, straight: bool) -> tuple[NDArray[Any], NDArray[Any]]:
    """Where the plant is, and how fast, at dense instants; the input is u_0 + the levels, or straight from one to the next."""
    made, at = case.made(), [float(x) for x in INSTANTS]
    A, b, first = np.array(made["A"]), [row[1] for row in made["B"]], made["initial_input"]
    final = first + (TARGET if case.spring else 0.0)
    x = np.zeros(2) if case.stay else np.array(made["start"])
    edges = sorted({*starts, end, *(t for t in at if 0 < t < end)})
    knots, heights = [*starts, end], [*levels, final]

    def rate(t: float, x: NDArray[Any], piece: int) -> NDArray[Any]:
        slope = (heights[piece + 1] - heights[piece]) / (knots[piece + 1] - knots[piece]) if straight else 0.0
        u = heights[piece] + slope * (t - knots[piece]) - first  # x counts from the first rest
        matrix = [[np.interp(t, at, A[:, i, j]) for j in range(2)] for i in range(2)]
        return np.array(matrix) @ x + np.array([0.0, np.interp(t, at, b)]) * u

    found = [x]
    for s, t in pairwise(edges):
        piece, h = int(np.searchsorted(knots, s, "right")) - 1, (t - s) / STEPS
        for k in range(STEPS):
            now = s + k * h
            k1 = rate(now, x, piece)
            k2 = rate(now + h / 2, x + h / 2 * k1, piece)
            k3 = rate(now + h / 2, x + h / 2 * k2, piece)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(now + h, x + h * k3, piece))
            found.append(x)
    return np.array(edges), np.array(found)


@functools.cache
def landing(case: Case, which: str) -> tuple[list[float], list[float], float]:
    """Starts, absolute levels and duration of a command that brings the plant to rest at its target."""
    first = case.made()["initial_input"]
    final = first + (TARGET if case.spring else 0.0)
    straight = which == "straight"

    def complete(x: Any) -> tuple[list[float], list[float], float]:
        if which == "instants":
            return [0.0, float(x[1]), 1.4], [first + 0.9, first - 0.7, final + 0.3], float(x[0])
        if which == "pulses":
            return [0.0, float(x[0]), float(x[1])], [first + 0.9, first - 0.7, final], 2.5
        if which == "levels":
            return [0.0, 0.8, 1.3], [float(x[0]), first + 0.1, float(x[1])], 2.0
        return [0.0, 0.3, 0.9, 1.6], [first, float(x[0]), first + 0.2, float(x[1])], 2.0

    guess = {"instants": [2.0, 0.7], "pulses": [0.8, 1.7], "levels": [first + 0.5, first - 0.5], "straight": [first + 0.5, first - 0.5]}[
        which
    ]
    x, _, found, said = fsolve(lambda x: course(case, *complete(x), straight)[1][-1] - [TARGET, 0.0], guess, xtol=1e-13, full_output=True)
    assert found == 1 or "not making good progress" in said
    assert np.abs(course(case, *complete(x), straight)[1][-1] - [TARGET, 0.0]).max() < 1e-9
    return complete(x)


def asked(case: Case, which: str, *, upper: float | None = None, off: float = 0.0, **limits: Any) -> Check:
    """What the checker says of the command, or of one whose unknowns are written so far off."""
    given_starts, given_levels, end = landing(case, which)
    starts, levels = [*given_starts], [*given_levels]
    for k, (kind, i, _) in enumerate(FREE[which]):
        if kind == "level":
            levels[i] += off * (-1) ** k
        elif kind == "start":
            starts[i] -= off
        else:
            end += off
    made, highest, changed = case.made(), 9.0, limits.pop("schedule", {})
    of = task(
        ["1"], ["1", "0", "0"], written(TARGET), limits=limits.pop("input", (written(-highest), written(highest))),
        initial_input=written(made["initial_input"]), **limits,
    )  # fmt: skip
    of |= scheduled(case, made, {"v": [["0", "1"]] * 3} if limits.get("deflection") else None)
    of["schedule"] |= changed
    segments = [(short(start), short(level)) for start, level in zip(starts, levels, strict=True)]
    witness = command(short(end), segments, FREE[which], "1/1000" if off else "1/1000000")
    return check(certificate(of, upper=short(upper or end + 1e-6), witnesses=(None, witness)))


def told(case: Case, which: str, **others: Any) -> Outcome:
    return asked(case, which, **others).outcome


def short(x: float) -> str:
    return str(Fraction(x).limit_denominator(10**12))


CASES = [
    (Case(40), "instants"), (Case(50, stay=False), "instants"), (Case(50, spring=True), "instants"), (Case(43), "levels"),
    (Case(44, spring=True), "levels"), (Case(45, stay=False), "levels"), (Case(46), "straight"), (Case(47, spring=True), "straight"),
    (Case(48, stay=False), "straight"),
]  # fmt: skip
RATE: dict[str, dict[str, Any]] = {"straight": {"rate": ["-50", "50"]}}


@pytest.mark.parametrize(("case", "which"), first(2, CASES), ids=str)
def test_a_command_that_lands_within_every_limit(case: Case, which: str) -> None:
    starts, levels, end = landing(case, which)
    made, straight = case.made(), which == "straight"
    rate: dict[str, Any] = RATE.get(which, {})
    first = made["initial_input"]
    final = first + (TARGET if case.spring else 0.0)
    assert told(case, which, **rate) is Outcome.PROVED
    if which == "instants":
        assert told(case, which, upper=end - 1e-6) is Outcome.REFUTED
    low, high = min(*levels, first, final), max(*levels, first, final)
    for side, value in ((0, low), (1, high)):
        for off, outcome in ((OFF, Outcome.PROVED), (-OFF, Outcome.REFUTED)):
            sides = [-9.0, 9.0]
            sides[side] = value + (off if side else -off)
            if outcome is Outcome.REFUTED and value in (first, final):
                continue  # then the task itself is none
            assert told(case, which, input=(short(sides[0]), short(sides[1])), **rate) is outcome, (side, off)
    knots, heights = [*starts, end], [*levels, final]
    if not case.spring:
        if straight:  # |u| along each line, which may cross 0
            fine = np.linspace(0.0, end, 400_001)
            burnt = float(np.trapezoid(np.abs(np.interp(fine, knots, heights) - first), fine))
        else:
            burnt = sum(abs(level - first) * (b - a) for level, (a, b) in zip(levels, pairwise(knots), strict=True))
        for off, outcome in ((OFF, Outcome.PROVED), (-OFF, Outcome.REFUTED)):
            assert told(case, which, fuel=short(burnt + off), **rate) is outcome
    if straight:
        slopes = [(b - a) / (t - s) for (s, t), (a, b) in zip(pairwise(knots), pairwise(heights), strict=True)]
        for side, value in ((0, min(slopes)), (1, max(slopes))):
            for off, outcome in ((OFF, Outcome.PROVED), (-OFF, Outcome.REFUTED)):
                sides = [-50.0, 50.0]
                sides[side] = value + (off if side else -off)
                assert told(case, which, rate=[short(x) for x in sides]) is outcome, (side, off)
    fastest = float(np.abs(course(case, starts, levels, end, straight)[1][:, 1]).max())
    for off, outcome in ((1e-3, Outcome.PROVED), (-1e-3, Outcome.REFUTED)):  # the dense instants miss the peak by less
        assert told(case, which, deflection={"v": short(fastest + off)}, **rate) is outcome


@pytest.mark.parametrize("off", [1e-4, -1e-4])
@pytest.mark.parametrize(("case", "which"), CASES, ids=str)
def test_what_is_written_is_near_the_command_and_not_the_command(case: Case, which: str, off: float) -> None:
    """Limits are about the exact command, wherever in its neighbourhood the one written is."""
    _, levels, end = landing(case, which)
    rate: dict[str, Any] = RATE.get(which, {})
    if which == "instants":  # an instant is found to the square of what it is off, here with some factor
        assert told(case, which, off=off, upper=end + 2e-5) is Outcome.PROVED
        assert told(case, which, off=off, upper=end - 2e-5) is not Outcome.PROVED
        if not case.spring:
            knots = [*landing(case, which)[0], end]
            burnt = sum(abs(level) * (b - a) for level, (a, b) in zip(levels, pairwise(knots), strict=True))
            for further, outcome in ((3e-5, Outcome.PROVED), (-3e-5, Outcome.REFUTED)):
                assert told(case, which, off=5 * off, upper=end + 1e-2, fuel=short(burnt + further)) is outcome
        return
    seen = 0
    for _, i, _ in FREE[which]:
        for side, most in ((0, min(levels)), (1, max(levels))):
            sides = [-9.0, 9.0]
            for further, proved in ((1e-6, True), (-1e-6, False)):
                sides[side] = most + (further if side else -further)
                if levels[i] == most:
                    outcome = told(case, which, off=off, input=(short(sides[0]), short(sides[1])), **rate)
                    assert outcome is (Outcome.PROVED if proved else Outcome.REFUTED), (i, side, further)
                    seen += 1
    assert seen >= 2


def test_the_part_of_a_ball_within_a_step() -> None:
    for ball, low, high in ((arb(0.5, 0.25), 0.25, 0.75), (arb(0, 0.25), 0, 0.25), (arb(1, 0.25), 0.75, 1), (arb(0.5, 2), 0, 1)):
        found = varying.inside(ball, arb(1))
        assert (float(found.lower()), float(found.upper())) == pytest.approx((low, high), abs=1e-8)  # radii have 30 bits


def test_pulses_of_a_plant_that_varies() -> None:
    """Two, at the limits: wide enough and few enough, or not."""
    case, sides = Case(40), ("-7/10", "9/10")
    starts, _, _ = landing(case, "pulses")
    narrow = min(b - a for a, b in pairwise(starts))
    for limits, outcome in (
        ({"pulse_width": short(narrow - OFF), "pulses": 2}, Outcome.PROVED),
        ({"pulse_width": short(narrow + OFF)}, Outcome.REFUTED),
        ({"pulses": 1}, Outcome.REFUTED),
    ):
        further: dict[str, Any] = limits
        assert told(case, "pulses", input=sides, **further) is outcome
        assert told(case, "pulses", input=("-1", "9/10"), **further) is Outcome.MALFORMED, "-0.7 is no full thrust then"


def test_rests_at_every_instant_of_the_schedule() -> None:
    """One rest at the target at the last instant, and the same at all; it may be on a limit of the input."""
    mass, spring = Case(40), Case(44, spring=True)
    none, elsewhere = "no rest at the target, or more than one", "the final rest is none at an instant"
    changes: list[tuple[Case, str, dict[str, Any], str]] = [
        (mass, "instants", {"B": [["0", "1"]] * 2 + [["0", "0"]]}, none),  # drifts, whatever the input
        (mass, "instants", {"A": [[["0", "1"], ["0", "0"]]] * 2 + [[["0", "0"], ["0", "0"]]]}, none),  # rests at any speed
        (spring, "levels", {"D": ["0", "1", "0"]}, elsewhere),  # sees the input for a while
        (spring, "levels", {"D": ["0", "0", "1"]}, elsewhere),
    ]
    for case, which, change, said in changes:
        found = asked(case, which, schedule=change)
        assert (found.outcome, said in found.reason) == (Outcome.MALFORMED, True), found.reason
    first = spring.made()["initial_input"]
    assert told(spring, "levels", input=("-9", short(round(first + TARGET, 6)))) is Outcome.REFUTED, (
        "it is on a limit, and the command beyond"
    )
    assert told(spring, "levels", input=(short(first), "9")) is Outcome.REFUTED


@pytest.mark.parametrize(("limit", "value", "said"), [
    ("held", "positive, then negative", "a plant that varies comes to a rest of its state"),
    ("tail_length", {"time": "1", "within": "1/10"}, "a tail length belongs to an output rest"),
    ("zero_sensitivity", {"zero[1]": {"shift": "1/8", "residual": "1/4"}}, "sensitivity to a zero belongs to an output rest"),
])  # fmt: skip
def test_what_does_not_go_with_a_plant_that_varies(limit: str, value: Any, said: str) -> None:
    further: dict[str, Any] = {limit: value}
    found = asked(Case(40), "instants", **further)
    assert (found.outcome, said in found.reason) == (Outcome.MALFORMED, True), found.reason


@pytest.mark.parametrize("case", [Case(46), Case(47, spring=True)], ids=str)
def test_a_straight_input_ends_where_it_is_held(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    monkeypatch.setattr(varying_courses, "prove", lambda *given: ends.append(given[3]))
    assert told(case, "straight", rate=["-50", "50"]) is Outcome.PROVED
    assert [float(end) for end in ends] == [TARGET if case.spring else 0.0]
