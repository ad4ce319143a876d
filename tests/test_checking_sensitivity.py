"""The checker on tails whose coefficients are limited because a zero may be elsewhere."""

from __future__ import annotations

from typing import Any

import flint
import pytest
from flint import arb
from forgery import certificate, changed, command, costate, proven_tail, system, task

from relaxations.checking.claims import Outcome, check, claim

NAMES = ("insensitive_real", "insensitive_pair", "insensitive_double", "insensitive_at_once")
PAIR = {"shift": "0.1", "residual": "0.5"}


def outcome(content: bytes) -> Outcome:
    return check(content).outcome


def limited(content: bytes, pair: dict[str, str], side: str) -> Outcome:
    """One side of a certificate under another limit."""

    def change(data: dict[str, Any]) -> None:
        data["task"]["limits"]["zero_sensitivity"]["zero[1]"].update(pair)
        data["claim"][{"lower": "upper", "upper": "lower"}[side]] = None

    return outcome(changed(content, change))


@pytest.mark.parametrize("name", NAMES)
def test_a_certificate_under_another_limit_is_believed_only_where_it_is_true(name: str) -> None:
    content = proven_tail(name)
    for pair in ({"residual": "0.0199999"}, {"shift": "0.1000001"}):
        assert limited(content, pair, "lower") is Outcome.PROVED
        assert limited(content, pair, "upper") is Outcome.REFUTED
    for pair in ({"residual": "0.0200001"}, {"shift": "0.0999999"}):
        assert limited(content, pair, "upper") is Outcome.PROVED
        assert limited(content, pair, "lower") is Outcome.REFUTED
    assert limited(content, {"residual": "0"}, "upper") is Outcome.REFUTED


def test_limits_are_those_of_the_formula() -> None:
    """(s + 1)^m (s² + 2s + 5)/D(s): at -1 the modulus of the highest coefficient is residual |Δ| (m-1)! |D(-1)| / (shift |4 m!|)."""
    for m, numerator in ((1, ["1", "3", "7", "5"]), (2, ["1", "4", "10", "12", "5"]), (3, ["1", "5", "14", "22", "17", "5"])):
        denominator = ["1", "0", "0", "0", "0", "-1"]  # s^5 - 1: -2 at -1
        found = system(
            task(
                numerator,
                denominator,
                "-3",
                rest="output",
                limits=("-9", "16"),
                zero_sensitivity={"zero[1]": {"shift": "1/8", "residual": "1/4"}},
            )
        )
        ((places, cap),) = found.capped
        ((at, zero),) = [(i, zero) for i, zero in enumerate(found.zeros) if not zero.flexible]
        assert [cap is None for cap in found.caps] == [i != at for i in range(2)]
        assert cap.overlaps(arb(3) * 2 * 2 / (4 * m))
        assert float(cap.rad()) < 1e-30
        end = sum(other.size for other in found.zeros[: at + 1])
        assert places == range(end - 1, end)
        assert zero.multiplicity == m


def test_a_pair_of_zeros_has_one_limit_for_real_and_imaginary_part() -> None:
    sensitivity = {"zero[2]": {"shift": "1/8", "residual": "1/4"}}
    found = system(task(["1", "3", "7", "5"], ["1", "0", "0", "0", "0"], rest="output", zero_sensitivity=sensitivity))
    ((places, cap),) = found.capped
    with flint.ctx.workprec(128):
        z = next(zero.value for zero in found.zeros if zero.flexible)
        assert cap.overlaps(2 * abs(z) ** 4 / (abs(z) * abs(z + 1) * 4))  # N'(z) = (z + 1) 4j, D(z) = z⁴
    assert len(places) == 2


def test_the_claim_tells_the_limit() -> None:
    assert claim(check(proven_tail("insensitive_real"))).splitlines()[5:7] == [
        "  The tail at zero[1] (zeros by ascending magnitude) moves the output by at most 0.02 of the displacement",
        "  if that zero lies elsewhere, by up to 0.1 of its magnitude; to first order in that distance.",
    ]


@pytest.mark.parametrize(
    "asked",
    [
        {"zero[2]": PAIR},
        {"zero[0]": PAIR},
        {"mode[1]": PAIR},
        {"zero[1]": {"shift": "0", "residual": "0.5"}},
        {"zero[1]": {"shift": "0.1", "residual": "-1"}},
        {"zero[1]": {"shift": "0.1"}},
        {"zero[1]": "0.1"},
        ["zero[1]"],
    ],
)
def test_what_is_no_sensitivity_is_malformed(asked: Any) -> None:
    of = task(["1", "1"], ["1", "0", "0"], rest="output", zero_sensitivity=asked)
    assert outcome(certificate(of, lower="1/10", witnesses=(costate(), None))) is Outcome.MALFORMED


def test_a_rest_of_the_state_has_no_tail_to_be_sensitive() -> None:
    of = task(["1", "1"], ["1", "0", "0"], zero_sensitivity={"zero[1]": PAIR})
    assert outcome(certificate(of, lower="1/10", witnesses=(costate(), None))) is Outcome.MALFORMED


def test_zeros_that_are_equally_large_have_no_order() -> None:
    """(s + 1)(s² + s + 1): which of them zero[1] is matters only if they are not asked the same."""
    go = command("3", [("0", "1/1000"), ("1", "0")], [["time", 0, 0]])
    for asked, expected in (({"zero[1]": PAIR}, "the order of zero[i]"), ({"zero[1]": PAIR, "zero[2]": PAIR}, "unknowns")):
        of = task(["1", "2", "2", "1"], ["1", "0", "0", "0"], rest="output", zero_sensitivity=asked)
        assert expected in check(certificate(of, upper="3", witnesses=(None, go))).reason
