"""Certificates of limits beyond the input's (samples, starts, pulses, fuel): their words, and lies about them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from forgery import certificate, changed, command, costate, forged, number, opened, proven, proven_limited, task, written

from relaxations.checking.claims import Outcome, check, claim

Path = tuple[str | int, ...]


def altered(name: str, where: Path, value: object) -> bytes:
    """The certificate of that name with one value changed, signed again."""
    data = opened(proven_limited(name))
    place: Any = data
    for step in where[:-1]:
        place = place[step]
    place[where[-1]] = value
    return forged(data)


# Samples.


def test_the_claim_says_what_commands_it_is_about() -> None:
    said = claim(check(proven_limited("sampled")))
    assert "u is constant on each [k h, (k + 1) h), h = 0.25 s, and T is a whole number of h." in said
    assert "no command within the limits that is constant over each sample does this in less than 9" in said


@pytest.mark.parametrize(
    ("where", "value", "outcome"),
    [
        (("task", "limits", "sample_time"), None, Outcome.REFUTED),  # of all commands some are faster than 9 s
        (("task", "limits", "sample_time"), "0.05", Outcome.REFUTED),  # so are some on a finer grid
        (("task", "limits", "sample_time"), "0.2", Outcome.MALFORMED),  # on which the command is not
        (("task", "limits", "sample_time"), "0", Outcome.MALFORMED),
        (("task", "limits", "sample_time"), "-0.25", Outcome.MALFORMED),
        (("task", "rest"), "output", Outcome.MALFORMED),
        (("claim", "lower"), "9.25", Outcome.REFUTED),
        (("claim", "lower"), "9.01", Outcome.REFUTED),  # a sample more would be refuted too
        (("claim", "lower"), "8.99", Outcome.PROVED),  # weaker
        (("claim", "upper"), "8.99", Outcome.REFUTED),
        (("claim", "upper"), "9.1", Outcome.PROVED),
        (("upper", "maneuver_time"), "9.01", Outcome.MALFORMED),
        (("upper", "segments", 1, "start"), "0.26", Outcome.MALFORMED),
        (("upper", "segments", -1, "start"), "8.7", Outcome.MALFORMED),
        (("upper", "free", 0), ["time", 0, 0], Outcome.MALFORMED),
        (("upper", "free", 0), ["start", 1, 0], Outcome.MALFORMED),
    ],
)
def test_samples_changed(where: Path, value: object, outcome: Outcome) -> None:
    assert check(altered("sampled", where, value)).outcome is outcome


def test_every_sample_counts_by_itself() -> None:
    # 1/s², h = 1, p = s - 1: in two samples the integral of |p| is 1 = Δ, that of p is 0.
    chain = costate((("0", "0"), [("-1", "0"), ("1", "0")]))
    posed = task(["1"], ["1", "0", "0"], sample_time="1")
    assert check(certificate(posed, "2", witnesses=(chain, None))).outcome is Outcome.PROVED
    assert check(certificate(posed, "3", witnesses=(chain, None))).outcome is not Outcome.PROVED  # two samples do it


# Starts.


def test_the_claim_says_where_the_plant_begins() -> None:
    said = claim(check(proven_limited("started")))
    assert "x and its derivatives begin at [5, 3]." in said
    assert "Task: from there move the output by 0.25 from that rest" in said


@pytest.mark.parametrize(
    ("value", "outcome"),
    [
        (None, Outcome.REFUTED),
        (["5", "3.01"], Outcome.REFUTED),
        (["5.01", "3"], Outcome.REFUTED),
        (["-5", "-3"], Outcome.REFUTED),
        (["5"], Outcome.MALFORMED),
        (["5", "3", "0"], Outcome.MALFORMED),
        (["5", 3], Outcome.MALFORMED),
        ([], Outcome.MALFORMED),
    ],
)
def test_another_start_is_another_task(value: object, outcome: Outcome) -> None:
    assert check(altered("started", ("task", "initial_state"), value)).outcome is outcome


@pytest.mark.parametrize(
    ("where", "value"),
    [(("plants", 0, "zeros"), {"mode[1]": 1}), (("initial_input",), "0.5"), (("displacement",), "0.3")],
)
def test_what_does_not_go_with_a_start_proves_nothing(where: Path, value: object) -> None:
    assert check(altered("started", ("task", *where), value)).outcome is not Outcome.PROVED


@pytest.mark.parametrize("criterion", ["face", "remainder", "fuel", "overshoot"])
def test_a_start_is_never_called_impossible_by_the_criteria_for_rest(criterion: str) -> None:
    data = opened(proven_limited("started"))
    data["task"]["limits"]["input"] = ["0", "1"]
    data["claim"] = {"lower": None, "upper": None, "impossible": criterion}
    assert check(forged(data)).outcome is not Outcome.PROVED


@pytest.mark.parametrize(
    ("side", "factor", "outcome"),
    [("lower", "1.001", Outcome.REFUTED), ("lower", "0.999", Outcome.PROVED), ("upper", "0.999", Outcome.REFUTED)],
)
def test_stronger_claims_are_refuted_weaker_ones_hold(side: str, factor: str, outcome: Outcome) -> None:
    data = opened(proven_limited("started"))
    found = check(proven_limited("started")).certificate
    assert found is not None
    value = Fraction(str(getattr(found.claim, side))) * Fraction(factor)
    data["claim"][side] = f"{value.numerator}/{value.denominator}"
    assert check(forged(data)).outcome is outcome


@pytest.mark.parametrize(("side", "factor"), [("lower", "1.000001"), ("upper", "0.999999")])
@pytest.mark.parametrize("name", ["started", "braked"])
def test_a_start_is_told_to_six_digits(name: str, side: str, factor: str) -> None:
    content = proven_limited(name)
    value = number(opened(content)["claim"][side]) * Fraction(factor)
    assert check(altered(name, ("claim", side), written(value))).outcome is Outcome.REFUTED


# Pulses.


@pytest.mark.slow
def test_the_claim_says_what_pulses_are_meant() -> None:
    said = claim(check(proven_limited("pulsed")))
    assert "u is -1, 1 or 0, in pulses" in said
    assert "of at least 1.1 s. The lower side is that of such pulses." in said
    assert "no command of such pulses does this in less than 5.17" in said


@pytest.mark.parametrize(
    ("member", "value", "outcome"),
    [
        ("pulse_width", "1", Outcome.PROVED),
        ("pulse_width", None, Outcome.PROVED),
        ("pulse_width", "1.11", Outcome.REFUTED),
        ("pulse_width", "0", Outcome.MALFORMED),
        ("pulse_width", "-1", Outcome.MALFORMED),
        ("pulses", 3, Outcome.PROVED),
        ("pulses", 2, Outcome.REFUTED),
        ("pulses", 0, Outcome.MALFORMED),
        ("pulses", "3", Outcome.MALFORMED),
        ("sample_time", "0.1", Outcome.MALFORMED),
        ("input", ["-1", "2"], Outcome.MALFORMED),  # 1 is no full thrust then
    ],
)
def test_other_pulses_are_another_task(member: str, value: object, outcome: Outcome) -> None:
    data = opened(proven_limited("pulsed"))
    data["claim"]["lower"], data["lower"] = None, None  # whose trees are of these pulses alone
    data["task"]["limits"][member] = value
    assert check(forged(data)).outcome is outcome


def test_partial_thrust_is_no_pulse() -> None:
    assert check(altered("pulsed", ("upper", "segments", 0, "level"), "-0.5")).outcome is not Outcome.PROVED
    assert check(altered("pulsed", ("upper", "free", 0), ["level", 0, 0])).outcome is not Outcome.PROVED
    data = opened(proven_limited("pulsed"))
    data["claim"]["lower"], data["task"]["limits"]["input"] = None, ["-1", "2"]
    assert check(forged(data)).outcome is Outcome.MALFORMED, "1 is no full thrust then"


def pulses(segments: list[tuple[str, str]], time: str, displacement: str, **limits: Any) -> Outcome:
    """Of whole pulses for 1/s²."""
    posed = task(["1"], ["1", "0", "0"], displacement, **limits)
    return check(certificate(posed, upper=time, witnesses=(None, command(time, segments, [])))).outcome


def test_coasts_between_pulses() -> None:
    coast = [("0", "1"), ("1", "0"), ("2", "-1")]
    later = [("0", "0"), ("1", "1"), ("2", "0"), ("3", "-1")]
    for segments, time in ((coast, "3"), (later, "4")):
        assert pulses(segments, time, "2", pulse_width="1", pulses=2) is Outcome.PROVED
        assert pulses(segments, time, "2", pulse_width="1.000001") is Outcome.REFUTED
        assert pulses(segments, time, "2", pulses=1) is Outcome.REFUTED
    uneven = [("0", "2"), ("0.5", "0"), ("1.5", "-1")]
    assert pulses(uneven, "2.5", "1.75", limits=("-1", "2"), pulse_width="0.5") is Outcome.PROVED
    assert pulses(uneven, "2.5", "1.75", limits=("-1", "2"), pulse_width="0.6") is Outcome.REFUTED
    last = [("0", "1"), ("1", "0"), ("2", "-2")]
    assert pulses(last, "2.5", "1.75", limits=("-2", "1"), pulse_width="0.5") is Outcome.PROVED
    assert pulses(last, "2.5", "1.75", limits=("-2", "1"), pulse_width="0.6") is Outcome.REFUTED


# Lies: about the rigid body, whose numbers fit on a line. Δ = 1, |u| ≤ 1, U = 1: T = 2.5, u = 1 until 0.5, -1 from 2 on; p = (s - 1.25)/1.5
# times a factor, μ where it is at the switches.

PROFILE = [("0", "1"), ("0.5", "0"), ("2", "-1")]


def upper_side(time: str, fuel: str | None = "1", segments: list[tuple[str, str]] = PROFILE, free: tuple[int, int] = (0, 2)) -> Outcome:
    posed = task(["1"], ["1", "0", "0"], fuel=fuel)
    return check(certificate(posed, upper=time, witnesses=(None, command(time, segments, [["level", i, 0] for i in free])))).outcome


def lower_side(time: str, price: str, fuel: str | None = "1", slope: str = "1") -> Outcome:
    chains = (("0", "0"), [(written(-number(slope) * Fraction(5, 4)), "0"), (slope, "0")])
    return check(certificate(task(["1"], ["1", "0", "0"], fuel=fuel), time, witnesses=(costate(chains, fuel=price), None))).outcome


def test_the_upper_side_of_a_budget() -> None:
    assert upper_side("2.5") is Outcome.PROVED  # the optimum itself: its numbers are exact
    assert upper_side("2.5", fuel="0.9999999") is Outcome.REFUTED
    slower = [("0", "0.952380952"), ("0.5", "0"), ("2.1", "-0.952380952")]  # v = 1/2.1, which is the fuel too: 2 v
    assert upper_side("2.6", segments=slower) is Outcome.PROVED
    assert upper_side("2.6", fuel=None, segments=slower) is Outcome.PROVED
    assert upper_side("2.6", fuel="0.95", segments=slower) is Outcome.REFUTED
    assert upper_side("2.59", segments=slower) is Outcome.REFUTED


def test_the_lower_side_of_a_budget() -> None:
    assert lower_side("2.4999999", "0.75") is Outcome.PROVED
    assert lower_side("2.5000001", "0.75") is Outcome.REFUTED
    for price in ("0.7", "0.8", "0.5"):  # any other price is worse, none at all is that of the bang-bang command
        assert lower_side("2.4999999", price) is Outcome.REFUTED
        assert lower_side("2.3", price) is Outcome.PROVED
    assert lower_side("2.01", "0") is Outcome.REFUTED
    assert lower_side("2.4999999", "0.75", fuel="1.0001") is Outcome.REFUTED
    assert lower_side("2.4999999", "0.75", fuel="0.9999") is Outcome.PROVED
    assert lower_side("1", "2") is Outcome.REFUTED  # so expensive that nothing is gained at any time


def test_a_changed_budget_changes_the_claim() -> None:
    content = proven("fuel")
    times = [number(opened(content)["claim"][side]) for side in ("lower", "upper")]
    less = changed(content, lambda data: data["task"]["limits"].update(fuel="3.99"))
    assert check(less).outcome is Outcome.REFUTED  # the command burns more
    more = changed(content, lambda data: data["task"]["limits"].update(fuel="4.01"))
    assert check(more).outcome is Outcome.REFUTED  # the lower side is not true any more
    for side, time, factor in zip(("lower", "upper"), times, (Fraction(100001, 100000), Fraction(99999, 100000)), strict=True):
        lie = changed(content, lambda data, side=side, time=time, factor=factor: data["claim"].update({side: written(time * factor)}))
        assert check(lie).outcome is Outcome.REFUTED
    free = changed(
        content, lambda data: (data["task"]["limits"].update(fuel=None), data["claim"].update(lower=None), data["lower"].update(fuel="0"))
    )
    assert check(free).outcome is Outcome.PROVED  # true, about another task


# Commands in fractions alone: a minimum that is a whole number of samples. Δ = 1, |u| ≤ 1, h = 0.1: u = 1 until 1, -1 until 2.


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("upper", "segments", 1, "start"), "1.1"),
        (("upper", "segments", 1, "level"), "-0.9"),
        (("upper", "segments", 0, "level"), "0.9"),
        (("upper", "maneuver_time"), "1.9"),
        (("task", "displacement"), "0.9"),
        (("task", "plants", 0, "numerator"), ["2"]),
    ],
)
def test_what_is_written_without_unknowns_lands_exactly_or_not(where: Path, value: object) -> None:
    assert opened(proven_limited("exact"))["upper"]["free"] == []
    data = opened(altered("exact", where, value))
    data["claim"]["lower"] = data["lower"] = None
    assert check(forged(data)).outcome is Outcome.REFUTED


def exact(order: int, segments: list[tuple[str, str]], time: str, displacement: str = "1") -> Outcome:
    """Of a command of whole numbers for 1/s^order."""
    posed = task(["1"], ["1", *["0"] * order], displacement, sample_time="1", limits=("-9", "9"))
    return check(certificate(posed, upper=time, witnesses=(None, command(time, segments, [])))).outcome


def test_commands_of_whole_numbers() -> None:
    assert exact(1, [("0", "1")], "1") is Outcome.PROVED
    assert exact(1, [("0", "1")], "1", "2") is Outcome.REFUTED
    assert exact(1, [("0", "2"), ("1", "0"), ("3", "-1")], "4") is Outcome.PROVED
    assert exact(3, [("0", "1"), ("1", "-2"), ("2", "1")], "3", "1") is Outcome.PROVED
    assert exact(3, [("0", "1"), ("1", "-2"), ("2", "1")], "3", "2") is Outcome.REFUTED
    assert exact(3, [("0", "1"), ("1", "-1"), ("3", "1")], "4", "2") is Outcome.PROVED
    for wrong in ("1", "4", "-2"):
        assert exact(3, [("0", "1"), ("1", "-1"), ("3", "1")], "4", wrong) is Outcome.REFUTED
    for wrong in ([("0", "1"), ("1", "-1"), ("2", "1")], [("0", "1"), ("2", "-1"), ("3", "1")], [("0", "2"), ("1", "-2"), ("3", "2")]):
        assert exact(3, wrong, "4", "2") is Outcome.REFUTED


def test_the_claim_in_words_with_every_limit() -> None:
    speed = {"outputs": {"speed": ["1", "0"]}, "deflection": {"speed": "8"}}
    slopes = "  u is continuous from its first rest to its last, and its slope stays in [-6, 7]."
    outputs = "  The output 'speed', numerator [1, 0], never leaves its first rest value by more than 8."
    for others, line in (({"rate": ["-6", "7"]}, slopes), (speed, outputs)):
        posed = task(["1"], ["1", "0", "0"], "2", limits=("-3", "4"), fuel="5", **others)
        move = command("9", [("0", "0"), ("1", "1"), ("2", "1")], [["level", 1, 0], ["level", 2, 0]])
        said = claim(check(certificate(posed, upper="9", witnesses=(None, move))))
        assert said.splitlines() == [
            "Plant (highest power of s first):",
            "  numerator    [1]",
            "  denominator  [1, 0, 0]",
            "Task: from rest at input 0 move the output by 2; "
            "the state (of a controllable realisation) stays at rest from T on (state rest).",
            "Limits: -3 ≤ u(t) ≤ 4 for all t ≥ 0.",
            "  The fuel ∫|u(t) - 0| dt of the move, from 0 to T, is at most 5.",
            line,
            "Not proven: one does it in at most 9 s.",
        ]
    for limits, words in (
        ({"pulse_width": "2"}, "of at least 2 s. The"),
        ({"pulses": 3}, "of any width, at most 3 of them. The"),
        ({"pulse_width": "2", "pulses": 3}, "of at least 2 s, at most 3 of them. The"),
    ):
        pulsed = task(["1"], ["1", "0", "0"], "1", **limits)
        *_, thrusters, widths, _ = claim(
            check(certificate(pulsed, upper="9", witnesses=(None, command("9", [("0", "1")], []))))
        ).splitlines()
        assert thrusters == "  Thrusters: until T, u is -1, 1 or 0, in pulses (constant pieces other than that)"
        assert widths == f"  {words} lower side is that of all inputs in the limits."


@pytest.mark.parametrize(
    ("of", "outcome"),
    [
        (task(["1"], ["1", "0"], fuel="0.9"), Outcome.PROVED),
        (task(["1"], ["1", "0"], "-1", fuel="0.9"), Outcome.PROVED),
        (task(["1"], ["1", "0"], fuel="1"), Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0"], "-1", fuel="1.1"), Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0"]), Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0", "0"], fuel="0.9"), Outcome.INCONCLUSIVE),  # in time enough a little fuel moves it as far as you like
        (task(["1"], ["1", "1", "0"], fuel="0.9"), Outcome.PROVED),
        (task(["1"], ["1", "1", "0"], fuel="1.1"), Outcome.INCONCLUSIVE),
        (task(["1", "1"], ["1", "0"], fuel="0.5", rest="output"), Outcome.INCONCLUSIVE),  # the tail is no part of the budget
        (task(["1"], ["1", "0"], fuel="0.9", initial_state=["0.5"]), Outcome.INCONCLUSIVE),
    ],
)
def test_where_too_little_fuel_makes_a_task_impossible(of: dict[str, Any], outcome: Outcome) -> None:
    assert check(certificate(of, impossible="fuel")).outcome is outcome


def test_multipliers_of_slopes_do_not_make_a_budget_too_small() -> None:
    """(s + 1)/(s² + 2s) with a tail, slopes of 1000: a fuel of 3/2 is enough for 2/5 s, and 'steps' once made it impossible."""
    others = {"rest": "output", "limits": ("-20", "20"), "rate": ["-1000", "1000"], "fuel": "3/2"}
    of = task(["1", "1"], ["1", "2", "0"], "1", **others)
    lie = costate((("0", "0"), [("1", "0")]), fuel="1", ramps=[{"edges": ["0", "1"], "levels": ["0"]}], steps=["1"])
    assert check(certificate(of, impossible="fuel", witnesses=(lie, None))).outcome is Outcome.INCONCLUSIVE
    tail = [{"near": ["-1", "0"], "coefficients": [["4/5", "0"]]}]
    nodes = [("0", "0"), ("1/20", "16237/2500"), ("3/10", "13719/10000")]
    truth = command("7/20", nodes, [["level", 1, 0], ["level", 2, 0]], radius="1/100", tail=tail)
    assert check(certificate(of, upper="2/5", witnesses=(None, truth))).outcome is Outcome.PROVED
    for fuel, outcome in (("1.2000001", Outcome.PROVED), ("1.1999999", Outcome.REFUTED)):  # ∫ u is 2, 4/5 of it the tail's
        tight = {**of, "limits": {**of["limits"], "fuel": fuel}}
        assert check(certificate(tight, upper="2/5", witnesses=(None, truth))).outcome is outcome
