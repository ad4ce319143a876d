"""What the checker prints: the whole claim in words, numbers rounded to the safe side."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import flint
import pytest
from flint import fmpq
from forgery import certificate, changed, command, costate, opened, proven, proven_tail, task

from relaxations.checking.claims import check, claim, rounded

INTEGRATOR = task(["1"], ["1", "0"])
ONE = costate((("0", "0"), [("1", "0")]))


def test_the_whole_claim_is_printed() -> None:
    words = claim(check(proven_tail("short_tail")))
    assert "From 1 s after T on, the input stays within 0.05 of the nearer limit's distance" in words
    assert "in less than" in words
    assert "at most" in words
    robust = claim(check(proven("two_mass_robust")))
    assert "further zeros of the command: 1 at mode[1]" in robust
    assert "state rest" in robust
    assert "in any time" in claim(check(certificate(task(["1"], ["1", "1"]), impossible="remainder")))
    record = check(proven("two_mass_1")).to_dict()
    assert record["task"] == opened(proven("two_mass_1"))["task"]
    printed = [Decimal(record["maneuver_time"][side]) for side in ("lower", "upper")]
    assert printed[0] < printed[1]
    assert all(abs(value - Decimal("4.2178665105")) < Decimal("1e-10") for value in printed)
    assert check(certificate(task(["1"], ["1", "1"]), impossible="remainder")).to_dict()["impossible"] is True
    assert "maneuver_time" not in check(certificate(INTEGRATOR, lower="2", witnesses=(ONE, None))).to_dict()


def test_claims_word_for_word() -> None:
    """Both sides, rounded outward; an impossible task; an output rest with all that belongs to it."""
    go = command("1", [("0", "1")], [["time", 0, 0]])
    both = certificate(INTEGRATOR, lower="2/3", upper="4/3", witnesses=(ONE, go))
    assert check(both).to_dict() == {
        "status": "proved",
        "task": INTEGRATOR,
        "maneuver_time": {"lower": "0.66666666666666666", "upper": "1.3333333333333334"},
    }
    plant = ["Plant (highest power of s first):", "  numerator    [1]", "  denominator  [1, 0]"]
    moved = (
        "Task: from rest at input 0 move the output by 1; the state (of a controllable realisation) stays at rest from T on (state rest)."
    )
    limits = "Limits: -1 ≤ u(t) ≤ 1 for all t ≥ 0."
    below = "no measurable command within the limits does this in less than 0.66666666666666666 s"
    above = "one does it in at most 1.3333333333333334 s"
    assert claim(check(both)).splitlines() == [*plant, moved, limits, f"Claim: {below}; {above}."]
    for side, words in (("lower", below), ("upper", above)):
        one = changed(both, lambda data, side=side: data["claim"].update({"lower": None, "upper": None, side: data["claim"][side]}))
        assert claim(check(one)).splitlines()[-1] == f"Claim: {words}."
        assert check(one).to_dict()["maneuver_time"][{"lower": "upper", "upper": "lower"}[side]] is None
    never = certificate(task(["1"], ["1", "1"]), impossible="remainder")
    record = {"status": "proved", "task": task(["1"], ["1", "1"]), "maneuver_time": None, "impossible": True}
    assert check(never).to_dict() == record
    assert claim(check(never)).splitlines()[-1] == "Claim: no measurable command within the limits does this in any time."
    refused = check(certificate(INTEGRATOR, lower="2", witnesses=(ONE, None)))
    reason = "the lower bound's inequality (2) is false for this costate at the time that is claimed"
    assert claim(refused).splitlines()[-1] == "Not proven: no measurable command within the limits does this in less than 2 s."
    assert claim(check(b"[]")) == ""
    assert refused.to_dict() == {"status": "refuted", "task": INTEGRATOR, "reason": reason}
    assert check(b"[]").to_dict() == {"status": "malformed", "reason": "no object in canonical form (RFC 8785)"}
    long_claim = task(
        ["1", "2"],
        ["1", "3", "7", "5", "0"],
        "0.5",
        rest="output",
        limits=("-1/3", "2"),
        initial_input="0.25",
        zeros={"mode[1]": 2, "real[1]": 1},
        tail_length={"time": "3", "within": "0.1"},
    )
    assert claim(check(certificate(long_claim, lower="0", witnesses=(costate(), None)))).splitlines() == [
        "Plant (highest power of s first):",
        "  numerator    [1, 2]",
        "  denominator  [1, 3, 7, 5, 0]",
        "  further zeros of the command: 2 at mode[1], 1 at real[1]",
        "Task: from rest at input 0.25 move the output by 0.5; "
        "the output stays at its target from T on, and the input tends to its final rest value (output rest).",
        "Limits: -1/3 ≤ u(t) ≤ 2 for all t ≥ 0.",
        "  From 3 s after T on, the input stays within 0.1 of the nearer limit's distance from its final rest value.",
        "Claim: no measurable command within the limits does this in less than 0 s.",
    ]


@pytest.mark.parametrize("value", [Fraction(1, 3), Fraction(2, 3), Fraction(10**40, 7), Fraction(1, 7 * 10**30), Fraction(0), Fraction(12)])
def test_printed_bounds_are_rounded_to_the_safe_side(value: Fraction) -> None:
    exact = fmpq(value.numerator, value.denominator)
    below, above = (Fraction(rounded(exact, rounding) or "") for rounding in ("ROUND_FLOOR", "ROUND_CEILING"))
    assert below <= value <= above
    assert above - below <= value / 10**15
    assert "E" not in (rounded(exact, "ROUND_FLOOR") or "")


def test_the_precision_outside_is_left_alone() -> None:
    before = flint.ctx.prec
    for content in (proven("two_mass_1"), b"", certificate(INTEGRATOR, lower="2", witnesses=(ONE, None))):
        check(content)
        assert flint.ctx.prec == before
