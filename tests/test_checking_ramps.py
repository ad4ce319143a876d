"""Certificates of limits of the slope: hand-made ones, and lies about them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from forgery import certificate, changed, command, costate, number, opened, proven_limited, task, written

from relaxations.checking.claims import Outcome, check, claim

# Lies, about the integrator with |u| ≤ 1 and slopes of 4, ∫u = 2: T = 2.25. p = 1; q = -1/4 … 0 over the last 1/4 s.

RATE = ("-4", "4")
RAMPS = [{"edges": ["0", "0.25"], "levels": ["0"]}, {"edges": ["2", "9"], "levels": ["0"]}]


def lower_side(time: str, ramps: list[dict[str, Any]], **others: Any) -> Outcome:
    posed = task(["1"], ["1", "0"], "2", **{"rate": list(RATE), **others})
    return check(certificate(posed, time, witnesses=(costate((("0", "0"), [("1", "0")]), ramps=ramps), None))).outcome


def test_the_lower_side_of_ramps() -> None:
    assert lower_side("2.2499999", RAMPS) is Outcome.PROVED
    assert lower_side("2.2500001", RAMPS) is Outcome.REFUTED
    assert lower_side("2.01", []) is Outcome.REFUTED  # without ramps it is the bound of the input's limits alone
    assert lower_side("1.99", []) is Outcome.PROVED
    split = [{"edges": ["0", "0.125", "0.25"], "levels": ["0", "0"]}, RAMPS[1]]
    assert lower_side("2.2499999", split) is Outcome.PROVED
    for edges in (["0", "0.3"], ["0", "0.2"], ["0.01", "0.25"]):
        assert lower_side("2.2499999", [{"edges": edges, "levels": ["0"]}, RAMPS[1]]) is not Outcome.PROVED
    assert lower_side("2.2499999", [{**RAMPS[0], "levels": ["0.1"]}, RAMPS[1]]) is not Outcome.PROVED
    assert lower_side("2.2499999", RAMPS, rate=["-4", "4.001"]) is Outcome.REFUTED
    assert lower_side("2.2499999", RAMPS, limits=("-1", "1.001")) is Outcome.REFUTED


def test_what_the_checker_calls_malformed() -> None:
    bad: list[list[dict[str, Any]]] = [
        [{"edges": ["0.25", "0"], "levels": ["0"]}],
        [{"edges": ["0", "0"], "levels": ["0"]}],
        [{"edges": ["0", "1"], "levels": []}],
        [{"edges": ["0", "1"], "levels": ["0", "0"]}],
        [RAMPS[1], RAMPS[0]],
        [RAMPS[0], RAMPS[0]],
        [{"edges": ["-1", "1"], "levels": ["0"]}],
    ]
    for ramps in bad:
        assert lower_side("1", ramps) is Outcome.MALFORMED, ramps
    for others in ({"rate": None}, {"rate": ["0", "1"]}, {"rate": ["1", "4"]}, {"sample_time": "1"}, {"pulses": 2}):
        assert lower_side("1", RAMPS, **others) is Outcome.MALFORMED, others


def test_a_level_costs_what_an_input_there_could_gain() -> None:
    # With fuel at a price of 1/2 the integrand is max(0, 1 - 1/2) = 1/2; a ramp at the level 3/4 costs 1/4 a second, one at 1/2 nothing.
    def outcome(time: str, level: str) -> Outcome:
        ramp = [{"edges": ["0", "1"], "levels": [level]}]
        posed = task(["1"], ["1", "0"], "2", rate=["-1000000", "1000000"], fuel="3")
        witness = costate((("0", "0"), [("2", "0")]), fuel="1", ramps=[ramp[0]])
        return check(certificate(posed, time, witnesses=(witness, None))).outcome

    assert outcome("0.5", "2") is Outcome.PROVED  # q = 0 but for the level itself: p = 2 = level, and 1/2 s cost 1/2; 4 - 3 = 1
    assert outcome("1.5", "2") is Outcome.REFUTED  # 3/2 of 1


def test_the_upper_side_of_ramps() -> None:
    def outcome(time: str, nodes: list[tuple[str, str]], free: list[list[Any]], rate: tuple[str, str] = RATE) -> Outcome:
        posed = task(["1"], ["1", "0"], "2", rate=list(rate), limits=("-1", "1.01"))
        return check(certificate(posed, upper=time, witnesses=(None, command(time, nodes, free)))).outcome

    # Up to 1 in 0.3 s and down again: ∫u = 2.3 - 0.3 = 2.
    nodes = [("0", "0"), ("0.3", "1"), ("2", "1")]
    assert outcome("2.3", nodes, [["level", 1, 0]]) is Outcome.PROVED
    assert outcome("2.3", nodes, [["level", 1, 0]], ("-3", "4")) is Outcome.REFUTED
    assert outcome("2.3", nodes, [["level", 1, 0]], ("-4", "3.3")) is Outcome.REFUTED
    assert outcome("2.3", nodes, [["level", 0, 0]]) is Outcome.MALFORMED  # the input begins where it rests
    assert outcome("2.3", nodes, [["time", 0, 0]]) is Outcome.MALFORMED
    assert outcome("2.3", nodes, []) is Outcome.MALFORMED
    assert outcome("2.3", [("0", "0.1"), *nodes[1:]], [["level", 1, 0]]) is Outcome.REFUTED
    assert outcome("2", [("0", "1")], []) is not Outcome.PROVED  # steps are no way around
    assert outcome("2.2", [("0", "0"), ("0.3", "1"), ("1.9", "1")], [["level", 1, 0]]) is Outcome.REFUTED  # does not get there


def test_a_changed_rate_changes_the_claim() -> None:
    content = proven_limited("slope")
    assert "its slope stays in [-4, 4]" in claim(check(content))
    times = [number(opened(content)["claim"][side]) for side in ("lower", "upper")]
    for rate in (["-3.9", "3.9"], ["-4.1", "4.1"]):
        assert check(changed(content, lambda data, rate=rate: data["task"]["limits"].update(rate=rate))).outcome is not Outcome.PROVED
    for side, time, factor in zip(("lower", "upper"), times, (Fraction(100001, 100000), Fraction(99999, 100000)), strict=True):
        lie = changed(content, lambda data, side=side, time=time, factor=factor: data["claim"].update({side: written(time * factor)}))
        assert check(lie).outcome is Outcome.REFUTED
