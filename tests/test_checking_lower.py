"""The lower side as a whole: the horizon that it speaks of, what its multipliers cost, and where it gives up."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from flint import arb, fmpq
from forgery import certificate, costate, task

from relaxations.checking import lower
from relaxations.checking.claims import Check, Outcome, check


def found(of: dict[str, Any], time: str, *chains: tuple[str, str], **others: Any) -> Check:
    witness = costate((("0", "0"), list(chains)), **others)
    return check(certificate(of, time, witnesses=(witness, None)))


@pytest.mark.parametrize(("first", "time", "outcome"), [("-1/2", "0.9999999", Outcome.PROVED), ("-1/2", "1.0000001", Outcome.REFUTED)])
def test_where_a_ramp_begins_is_given(first: str, time: str, outcome: Outcome) -> None:
    """1/s by 1 with slopes of ±4: up to 2 and down in 1 s. q = s - 1/2 and p = 1: 4 ∫ |q| = T² at T = 1, less before."""
    of = task(["1"], ["1", "0"], limits=("-9", "9"), rate=["-4", "4"])
    ramp = {"edges": ["0", "2"], "levels": ["0"]}
    assert found(of, time, ("1", "0"), ramps=[ramp], steps=[first]).outcome is outcome
    assert found(of, time, ("1", "0"), ramps=[ramp]).outcome is Outcome.REFUTED  # q = s - T: 2 T²


@pytest.mark.parametrize("time", ["2/3", "1/3", "5/7", "0.3", "0.7"])
def test_the_whole_time_that_is_claimed_is_looked_at(time: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fraction is no number in balls: rather a hair more."""
    ends: list[arb] = []
    support = lower.support
    monkeypatch.setattr(lower, "support", lambda p, horizon, *others: ends.append(horizon) or support(p, horizon, *others))
    assert found(task(["1"], ["1", "0"]), time, ("1", "0")).outcome is Outcome.PROVED
    mantissa, exponent = ends[0].man_exp()
    written = Fraction(time)
    assert fmpq(mantissa) * fmpq(2) ** int(exponent) >= fmpq(written.numerator, written.denominator)


def test_samples_refute_what_ends_with_one() -> None:
    """1/s² from a speed of -1, samples of 1 s: less than 1.9 s is 1 s at most, x(1) - 1 ≥ -1 + 5/2 - 1 and no contradiction."""
    of = task(["1"], ["1", "0", "0"], "1", limits=("-5", "5"), initial_state=["0", "-1"], sample_time="1")
    assert found(of, "1.9", ("0", "0"), ("1", "0")).outcome is not Outcome.PROVED  # 2 < 5/2; 2.9 at 1.9 s
    weaker = {**of, "limits": {**of["limits"], "input": ["-3.9", "3.9"]}}
    assert found(weaker, "1.9", ("0", "0"), ("1", "0")).outcome is Outcome.PROVED


@pytest.mark.parametrize("limit", ["0.5", "2"])
def test_multipliers_of_outputs_have_their_price(limit: str) -> None:
    """The cart at a speed of v at most and |u| ≤ v/(T/5): scaled in time and length, 5 v until v, as long at v, and back."""
    v = Fraction(limit)
    of = task(
        ["1"], ["1", "0", "0"], str(2 * v), outputs={"rate": ["1", "0"]}, deflection={"rate": limit}, limits=(str(-2 * v), str(2 * v))
    )
    press = {"output": "rate", "begin": "0.5", "end": "2", "weight": "3"}  # p = 2 s - 1 less 2 (s - 1/2): T = 2 + 1/2
    for time, outcome in (("2.4999999", Outcome.PROVED), ("2.5000001", Outcome.REFUTED)):
        assert found(of, time, ("-1", "0"), ("2", "0"), deflection=[press]).outcome is outcome


def test_more_samples_than_may_be_looked_at() -> None:
    of = task(["1"], ["1", "0", "0"], outputs={"rate": ["1", "0"]}, deflection={"rate": "0.5"}, sample_time="1/1000000")
    press = {"output": "rate", "begin": "0.5", "end": "2", "weight": "3"}
    given_up = found(of, "2.4999", ("-1", "0"), ("2", "0"), deflection=[press])
    assert (given_up.outcome, "more samples than a check may look at" in given_up.reason) == (Outcome.INCONCLUSIVE, True)
    slopes = task(["1"], ["1", "0", "0"], rate=["-9", "9"], sample_time="1/1000000")
    given_up = found(slopes, "1.9", ("-1", "0"), ("1", "0"), steps=["1"])
    assert (given_up.outcome, "more samples than a check may look at" in given_up.reason) == (Outcome.INCONCLUSIVE, True)
    assert found(task(["1"], ["1", "0", "0"], sample_time="1/1000000"), "1.9", ("-1", "0"), ("1", "0")).outcome is Outcome.PROVED
