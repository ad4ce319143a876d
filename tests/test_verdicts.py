"""Pass, fail, undecided and error: of one run, of a requirement over its scope, and of everything together."""

from __future__ import annotations

import itertools
import math

import pytest

from suite.quantity_names import parse_quantity
from suite.study import Requirement
from suite.verdicts import Judgement, Measured, RunVerdict, Verdict, judge, judge_run, limit, margin, overall

PASS, FAIL, UNDECIDED, ERROR = Verdict.PASS, Verdict.FAIL, Verdict.UNDECIDED, Verdict.ERROR


def requirement(minimum: float | None = None, maximum: float | None = None, *, nominal_only: bool = False) -> Requirement:
    return Requirement("R1", "", parse_quantity("residual_vibration"), minimum, maximum, "", "nominal" if nominal_only else "box")


AT_MOST = requirement(maximum=1.0)


def runs(*values: tuple[float, float] | None) -> list[RunVerdict]:
    """The nominal run first; None is one that failed."""
    return [
        RunVerdict(f"{i:04d}", i == 0, value and Measured(*value), "SIGSEGV" if value is None else "") for i, value in enumerate(values)
    ]


def outcome(asked: Requirement, *values: tuple[float, float] | None) -> Judgement:
    return judge(asked, runs(*values))


@pytest.mark.parametrize(
    ("value", "error", "verdict"),
    [
        (0.9, 0.0, PASS),
        (1.0, 0.0, PASS),  # limits are inclusive
        (math.nextafter(1.0, 2.0), 0.0, FAIL),
        (0.9, 0.05, PASS),
        (0.9, 0.1, UNDECIDED),  # the limit lies within 0.9 ± 0.1
        (1.1, 0.2, UNDECIDED),
        (1.0, 1e-300, UNDECIDED),
        (1.1, 0.05, FAIL),
        (0.5, math.inf, UNDECIDED),
        (math.inf, 0.0, FAIL),
        (-math.inf, 0.0, PASS),
        (math.nan, 0.0, ERROR),
        (0.5, math.nan, ERROR),
    ],
)
def test_one_run_against_a_maximum(value: float, error: float, verdict: Verdict) -> None:
    assert judge_run(AT_MOST, Measured(value, error)) is verdict
    mirrored = requirement(minimum=-1.0)
    assert judge_run(mirrored, Measured(-value, error)) is verdict


@pytest.mark.parametrize(
    ("value", "nearest", "least", "verdict"),
    [
        (2.5, 2.0, 0.5, PASS),
        (5.0, 6.0, 1.0, PASS),
        (7.0, 6.0, -1.0, FAIL),
        (1.0, 2.0, -1.0, FAIL),
        (2.0, 2.0, 0.0, PASS),
        (6.0, 6.0, 0.0, PASS),
    ],
)
def test_of_two_limits_the_nearer_one_counts(value: float, nearest: float, least: float, verdict: Verdict) -> None:
    between = requirement(2.0, 6.0)
    assert (margin(between, value), limit(between, value)) == (least, nearest)
    assert judge_run(between, Measured(value, 0.0)) is verdict


def test_the_worst_run_is_the_one_with_the_least_margin() -> None:
    found = outcome(AT_MOST, (0.2, 0.0), (0.9, 0.0), (0.5, 0.0))
    assert (found.verdict, found.worst_run, found.measured, found.margin) == (PASS, "0001", Measured(0.9, 0.0), pytest.approx(0.1))
    assert found.reason == "residual_vibration is 0.9 in run 0001, 0.1 within the limit 1"
    found = outcome(requirement(0.1, 1.0), (0.15, 0.0), (0.9, 0.0))
    assert found.worst_run == "0000", "0.05 above the minimum is nearer than 0.1 below the maximum"


def test_a_fail_says_which_run_and_by_how_much() -> None:
    found = outcome(AT_MOST, (0.2, 0.0), (1.5, 0.0), (1.25, 0.0))
    assert (found.verdict, found.worst_run, found.margin) == (FAIL, "0001", -0.5)
    assert found.reason == "residual_vibration is 1.5 in run 0001, 0.5 beyond the limit 1"


def test_a_run_in_error_is_never_passed_over() -> None:
    found = outcome(AT_MOST, (0.2, 0.0), None, (0.3, 0.0), None)
    assert (found.verdict, found.worst_run, found.measured, found.margin) == (ERROR, "0001", None, None)
    assert found.reason == "run 0001 could not be finished: SIGSEGV (and 1 more)"


def test_a_fail_stays_one_beside_a_run_in_error_and_names_both() -> None:
    found = outcome(AT_MOST, (1.5, 0.0), None)
    assert (found.verdict, found.worst_run, found.measured) == (FAIL, "0000", Measured(1.5, 0.0))
    assert "0.5 beyond the limit 1" in found.reason
    assert "run 0001 could not be finished: SIGSEGV" in found.reason


def test_the_evidence_is_a_run_that_has_the_verdict() -> None:
    undecided = outcome(AT_MOST, (0.95, 0.0), (0.9, 0.2))
    assert (undecided.verdict, undecided.worst_run) == (UNDECIDED, "0001"), "0000 has less margin, but passes"
    assert undecided.reason == "residual_vibration is 0.9 in run 0001: the limit 1 lies within its numerical error 0.2"
    failed = outcome(AT_MOST, (1.2, 0.5), (1.1, 0.0))
    assert (failed.verdict, failed.worst_run) == (FAIL, "0001"), "0000 is farther out, but undecided"
    without = outcome(AT_MOST, (0.99, 0.0), (math.nan, 0.0))
    assert (without.verdict, without.worst_run) == (ERROR, "0001")
    assert without.reason == "residual_vibration has no value in run 0001"


def test_a_nominal_scope_looks_at_the_nominal_run_only() -> None:
    asked = requirement(maximum=1.0, nominal_only=True)
    assert outcome(asked, (0.5, 0.0), (7.0, 0.0), None).verdict is PASS
    assert outcome(asked, None, (0.5, 0.0)).verdict is ERROR


def test_without_a_run_nothing_passes() -> None:
    assert judge(AT_MOST, []).verdict is ERROR
    assert judge(AT_MOST, []).reason == "no run was made"
    elsewhere = [RunVerdict("0001", False, Measured(0.5, 0.0))]
    assert judge(requirement(maximum=1.0, nominal_only=True), elsewhere).verdict is ERROR


def test_overall_is_fail_before_error_before_undecided_before_pass() -> None:
    order = [FAIL, ERROR, UNDECIDED, PASS]
    for kinds in itertools.product(order, repeat=3):
        assert overall(kinds) is min(kinds, key=order.index)
    assert overall([]) is PASS
