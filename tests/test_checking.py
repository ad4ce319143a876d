"""The checker: proves what is known, refuses what is a hair beyond, and never believes a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import forgery
import pytest
from flint import fmpq
from forgery import certificate, changed, command, costate, number, opened, proven, proven_tail, task, written
from problems import KNOWN, PROBLEMS

from relaxations import certificates
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Malformed, real

HAIR = Fraction(1, 10**12)
"""Relative distance of a claim from the truth at which it must fall: the brackets are narrower than 1e-12."""

# Facts proven to 1e-12; the degenerate ones (fewer switches than equations) come out by repair and are wider.
REGULAR = [known for known in KNOWN if known.name != "two_mass_one_switch"]


def outcome(content: bytes) -> Outcome:
    return check(content).outcome


# What is known.


@pytest.mark.parametrize("name", [known.name for known in KNOWN])
def test_known_minimum_times_are_proven(name: str) -> None:
    found, known = check(proven(name)), forgery.known(name)
    assert found.outcome is Outcome.PROVED
    below, above = (number(opened(proven(name))["claim"][side]) for side in ("lower", "upper"))
    assert known.time is not None
    assert below - Fraction(known.error) <= Fraction(known.time) <= above + Fraction(known.error)
    assert above / below - 1 < (HAIR if known in REGULAR else Fraction(1, 10**8))


@pytest.mark.parametrize("name", list(forgery.TAILS))
def test_output_rest_is_proven(name: str) -> None:
    assert check(proven_tail(name)).outcome is Outcome.PROVED


@pytest.mark.parametrize("name", [known.name for known in REGULAR])
@pytest.mark.parametrize(("side", "factor"), [("lower", 1 + HAIR), ("upper", 1 - HAIR)])
def test_a_hair_beyond_is_refuted(name: str, side: str, factor: Fraction) -> None:
    other = "upper" if side == "lower" else "lower"

    def lie(data: dict[str, Any]) -> None:
        data["claim"] = {side: written(number(data["claim"][side]) * factor), other: None, "impossible": None}

    assert outcome(changed(proven(name), lie)) is Outcome.REFUTED


@pytest.mark.parametrize("name", ["real_zero", "pitch", "complex_zeros", "double_zero", "rest_on_a_limit", "short_tail"])
@pytest.mark.parametrize(("side", "factor"), [("lower", 1 + HAIR), ("upper", 1 - HAIR)])
def test_a_hair_beyond_is_not_proven_with_a_tail(name: str, side: str, factor: Fraction) -> None:
    """Refuted, or inconclusive where a limit that the tail touches comes first."""

    def lie(data: dict[str, Any]) -> None:
        data["claim"] = {"lower": None, "upper": None, "impossible": None, side: written(number(data["claim"][side]) * factor)}

    assert outcome(changed(proven_tail(name), lie)) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


def test_weaker_claims_are_proven_too() -> None:
    def weaker(data: dict[str, Any]) -> None:
        data["claim"] |= {"lower": "4", "upper": "5"}

    assert outcome(changed(proven("two_mass_1"), weaker)) is Outcome.PROVED


# 1/s moved by 1 within |u| ≤ 1 takes 1 s: p = λ, and the command is u = 1.
INTEGRATOR = task(["1"], ["1", "0"])
ONE = costate((("0", "0"), [("1", "0")]))
GO = command("1", [("0", "1")], [["time", 0, 0]])


@pytest.mark.parametrize(
    ("claimed", "expected"),
    [
        ("0.999", Outcome.PROVED),
        ("0x1.fffffffffffffp-1", Outcome.PROVED),
        ("1", Outcome.INCONCLUSIVE),  # the inequality is strict, and an equality
        ("0x1.0000000000001p+0", Outcome.REFUTED),
        ("1001/1000", Outcome.REFUTED),
    ],
)
def test_the_lower_side_of_an_integrator(claimed: str, expected: Outcome) -> None:
    assert outcome(certificate(INTEGRATOR, lower=claimed, witnesses=(ONE, None))) is expected


@pytest.mark.parametrize(
    ("claimed", "expected"), [("1.001", Outcome.PROVED), ("1", Outcome.PROVED), ("0.999", Outcome.REFUTED), ("0", Outcome.REFUTED)]
)
def test_the_upper_side_of_an_integrator(claimed: str, expected: Outcome) -> None:
    """The duration is an unknown here, and Krawczyk's test is exact on a linear equation."""
    assert outcome(certificate(INTEGRATOR, upper=claimed, witnesses=(None, GO))) is expected


def test_a_plant_without_dynamics_needs_no_time() -> None:
    nothing = command("0", [], [])
    assert outcome(certificate(task(["2"], ["1"]), lower="0", upper="0", witnesses=(None, nothing))) is Outcome.PROVED
    assert outcome(certificate(task(["0.5"], ["1"]), upper="0", witnesses=(None, nothing))) is Outcome.MALFORMED  # needs u = 2
    assert outcome(certificate(task(["2"], ["1"]), lower="1", witnesses=(costate(), None))) is Outcome.REFUTED


def test_a_tail_alone_may_touch_its_limit_at_the_first_instant() -> None:
    """(s²+2s+3)/(s²+1): u(0+) = Δ/D = 1, the limit itself. A hair less room, and the same command leaves the limits."""
    assert opened(proven_tail("at_once_on_a_limit"))["claim"] == {"lower": "0", "upper": "0", "impossible": None}

    def less(data: dict[str, Any]) -> None:
        data["task"]["limits"]["input"][1] = "0.999999999999"

    assert outcome(changed(proven_tail("at_once_on_a_limit"), less)) is Outcome.REFUTED


# Tasks that no time suffices for.


@pytest.mark.parametrize(
    ("posed", "criterion", "expected"),
    [
        (task(["1"], ["1", "0", "0"], limits=("0", "1")), "face", Outcome.PROVED),
        (task(["1"], ["1", "0", "0"], limits=("-1", "0")), "face", Outcome.PROVED),
        (task(["1"], ["1", "0", "0"], limits=("2", "3"), initial_input="3"), "face", Outcome.PROVED),
        (task(["1"], ["1", "0", "0"], limits=("-0.001", "1")), "face", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0"], limits=("0", "1")), "face", Outcome.INCONCLUSIVE),  # one integrator: takes 1 s
        (task(["1"], ["1", "0"], "-1", limits=("0", "1")), "face", Outcome.PROVED),  # there and never back
        (task(["1"], ["1", "0"], "-1", limits=("-1", "0")), "face", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0"], limits=("-1", "0")), "face", Outcome.PROVED),
        (task(["1"], ["1", "1", "0"], limits=("0", "1")), "face", Outcome.PROVED),  # drag alone never stops
        (task(["1"], ["1", "1", "0"], limits=("-1", "0")), "face", Outcome.PROVED),
        (task(["1"], ["1", "1", "0"], limits=("-1/1000", "1")), "face", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0", "1", "0"], limits=("0", "1")), "face", Outcome.INCONCLUSIVE),  # a mode swings back
        (task(["1"], ["1", "2"], "0.25", limits=("0", "1")), "face", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "-1/3", "-2/3"], "-1", limits=("0", "1")), "face", Outcome.PROVED),  # falls the other way
        (task(["1"], ["1", "-1/3", "-2/3"], "1", limits=("-1", "0")), "face", Outcome.PROVED),
        (task(["1"], ["1", "-1/3", "-2/3"], "-1", limits=("-1/1000", "1")), "face", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0", "0"], limits=("0", "1")), "remainder", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "1"]), "remainder", Outcome.PROVED),
        (task(["1"], ["1", "1"], "-1"), "remainder", Outcome.PROVED),
        (task(["1"], ["1", "1"], "0.999"), "remainder", Outcome.INCONCLUSIVE),
        (task(["1"], ["1", "0", "1"], limits=("0", "1")), "remainder", Outcome.INCONCLUSIVE),  # takes 2π/3
        (task(["-1"], ["1", "-1"]), "remainder", Outcome.INCONCLUSIVE),  # an unstable pole says nothing
        (task(["-0.5"], ["1", "-0.5"]), "remainder", Outcome.INCONCLUSIVE),
        (task(["1", "1"], ["1", "0", "0"], limits=("0", "1"), rest="output"), "face", Outcome.PROVED),  # the tail cannot pull either
        (task(["1", "1"], ["1", "0", "0"], limits=("-0.001", "1"), rest="output"), "face", Outcome.INCONCLUSIVE),
        # The rest input is a limit. A tail along -3 and -4 cannot make up for what the pole -1 lacks, one along -1 can for -2.
        (task(["1", "7", "12"], ["1", "8", "17", "10"], "1.2", rest="output"), "remainder", Outcome.PROVED),
        (task(["1", "7", "12"], ["1", "8", "17", "10"], "-1.2", rest="output"), "remainder", Outcome.PROVED),
        (task(["1", "7", "12"], ["1", "8", "17", "10"], "1.19", rest="output"), "remainder", Outcome.INCONCLUSIVE),
        (task(["1", "4", "3"], ["1", "11", "38", "40"], "0.075", rest="output"), "remainder", Outcome.INCONCLUSIVE),  # takes 0.108 s
        (task(["1", "4", "3"], ["1", "7.5", "13.5", "5"], "0.6", rest="output"), "remainder", Outcome.PROVED),  # -1/2 is right of both
        (task(["-1", "1"], ["1", "0", "0"], limits=("0", "1"), rest="output"), "face", Outcome.PROVED),
        (task(["1", "0", "1"], ["1", "0", "0"], limits=("0", "1"), rest="output"), "face", Outcome.PROVED),
        (task(["1"], ["1", "2", "2", "1"], zeros={"mode[1]": 2, "real[1]": 1}), "remainder", Outcome.PROVED),
    ],
)
def test_impossible_tasks(posed: dict[str, Any], criterion: str, expected: Outcome) -> None:
    assert outcome(certificate(posed, impossible=criterion)) is expected


@pytest.mark.parametrize(
    ("numerator", "denominator", "limit", "others", "expected"),
    [
        (["1", "3"], ["1", "0.4", "1"], "3", {}, Outcome.PROVED),
        (["1", "3"], ["1", "0.4", "1"], "3", {"displacement": "-3"}, Outcome.PROVED),
        (["1", "3"], ["1", "0.4", "1"], "3", {"zeros": {"mode[1]": 1}}, Outcome.PROVED),
        (["1", "3"], ["1", "0.4", "1"], "3", {"sample_time": "0.25"}, Outcome.PROVED),
        (["1", "3"], ["1", "0.4", "1"], "3.0000001", {}, Outcome.INCONCLUSIVE),  # a little beyond, and it only takes its time
        (["1", "3"], ["1", "0.4", "1"], "3", {"rest": "output"}, Outcome.INCONCLUSIVE),  # the input decays along the zero
        (["1", "3"], ["1", "0.4", "1"], "3", {"initial_state": ["1", "0"]}, Outcome.INCONCLUSIVE),
        (["3"], ["1", "0.4", "1"], "3", {}, Outcome.INCONCLUSIVE),  # without a zero it comes from within
        (["-1", "3"], ["1", "0.4", "1"], "3", {}, Outcome.INCONCLUSIVE),  # right of the origin: it begins the other way
        (["-6", "3"], ["1", "0.4", "1"], "3", {}, Outcome.INCONCLUSIVE),  # and at 1/2, too
        (["3", "6", "6"], ["1", "1.4", "1.4", "1"], "3", {}, Outcome.INCONCLUSIVE),  # a pair of zeros: takes 3.19 s from 0 to 6
        (["1", "3"], ["1", "3.4", "2.2", "3"], "3", {}, Outcome.INCONCLUSIVE),  # the pole at -3 is the zero
        (["1", "6", "9"], ["1", "3.4", "2.2", "3"], "3", {}, Outcome.PROVED),  # a double zero, of which one is left
    ],
)
def test_an_output_that_may_not_overshoot(
    numerator: list[str], denominator: list[str], limit: str, others: dict[str, Any], expected: Outcome
) -> None:
    # The input is scaled so that the limits of the input never matter.
    posed = task(
        numerator, denominator, **{"displacement": "3", "limits": ("-9", "9"), **others}, deflection={"y": limit}, outputs={"y": numerator}
    )
    assert outcome(certificate(posed, impossible="overshoot")) is expected


def test_whose_overshoot_it_is() -> None:
    # A cart rests 1 farther; its speed rests at 0, an output that leads it (0.5 s + 1) does not.
    led = task(["1"], ["1", "0", "0"], deflection={"led": "1"}, outputs={"led": ["0.5", "1"]})
    assert outcome(certificate(led, impossible="overshoot")) is Outcome.PROVED
    speed = task(["1"], ["1", "0", "0"], deflection={"speed": "1"}, outputs={"speed": ["1", "0"]})
    assert outcome(certificate(speed, impossible="overshoot")) is Outcome.INCONCLUSIVE
    both = {"deflection": {"a_speed": "1", "led": "1"}, "outputs": {"a_speed": ["1", "0"], "led": ["0.5", "1"]}}
    assert outcome(certificate(task(["1"], ["1", "0", "0"], **both), impossible="overshoot")) is Outcome.PROVED


@pytest.mark.parametrize("known", PROBLEMS, ids=lambda known: known.name)
def test_possible_tasks_are_not_called_impossible(known: Any) -> None:
    posed = certificates.task(known.problem())
    called = [outcome(certificate(posed, impossible=criterion)) is Outcome.PROVED for criterion in ("face", "remainder")]
    assert any(called) == (known.time is None)


# Reading.

MALFORMED: dict[str, Callable[[dict[str, Any]], Any]] = {
    "exactly": lambda data: data.pop("lower"),
    "certificate is an object of exactly": lambda data: data.update(extra=None),
    "certificate.format is one of": lambda data: data.update(format="slewcert-certificate/2"),
    "a task has one plant, or one that varies": lambda data: data["task"].update(plants=[]),
    "array of 0 to 1": lambda data: data["task"]["plants"].append(data["task"]["plants"][0]),
    "displacement is not 0": lambda data: data["task"].update(displacement="0"),
    "limits ascend": lambda data: data["task"]["limits"].update(input=["1", "1"]),
    "limits exclude": lambda data: data["task"].update(initial_input="1.001"),
    "belongs to an output rest": lambda data: data["task"]["limits"].update(tail_length={"time": "1", "within": "1"}),
    "rest is one of output, state": lambda data: data["task"].update(rest="speed"),
    "monic": lambda data: data["task"]["plants"][0].update(denominator=["2", "0", "1"]),
    "leading coefficients": lambda data: data["task"]["plants"][0].update(numerator=["0", "1"]),
    "proper": lambda data: data["task"]["plants"][0].update(numerator=["1"] * 9),
    "zero at the origin": lambda data: data["task"]["plants"][0].update(numerator=["1", "0"]),
    "numerator is an array of 1 to 201": lambda data: data["task"]["plants"][0].update(numerator=[]),
    "the plant has no mode[2]": lambda data: data["task"]["plants"][0].update(zeros={"mode[2]": 1}),
    "zeros names mode[i] and real[i]": lambda data: data["task"]["plants"][0].update(zeros={"mode[01]": 1}),
    "names mode[i]": lambda data: data["task"]["plants"][0].update(zeros={"mode[1]\nPROVED": 1}),
    "zeros is a whole number from 0 on, not True": lambda data: data["task"]["plants"][0].update(zeros={"mode[1]": True}),
    "counts from 0 to 20": lambda data: data["task"]["plants"][0].update(zeros={"mode[1]": 21}),
    "claim has sides": lambda data: data.update(claim={"lower": None, "upper": None, "impossible": None}),
    "or says that the task is impossible": lambda data: data["claim"].update(impossible="face"),
    "impossible is one of": lambda data: data.update(claim={"lower": None, "upper": None, "impossible": "magic"}),
    "not negative": lambda data: data["claim"].update(lower="-1"),
    "no witness": lambda data: data.update(lower=None),
    "has no witness": lambda data: data.update(upper=None),
    "costate is an array of 1 to 1": lambda data: data["lower"].update(costate=[]),
    "a root is named twice": lambda data: data["lower"]["costate"][0].append(data["lower"]["costate"][0][0]),
    "other coefficients than": lambda data: data["lower"]["costate"][0][0]["coefficients"][0].__setitem__(1, "1"),
    "multiplicity allows": lambda data: data["lower"]["costate"][0][0]["coefficients"].extend([["1", "0"]] * 5),
    "a tail that the task does not have": lambda data: data["lower"].update(tail=[{"time": "0", "upper": "1", "lower": "0"}]),
    "multipliers of the tail are not negative": lambda data: data["lower"].update(tail=[{"time": "0", "upper": "-1", "lower": "0"}]),
    "tail are not negative": lambda data: data["lower"].update(tail=[{"time": "0", "upper": "1", "lower": "-1"}]),
    "times and multipliers": lambda data: data["lower"].update(tail=[{"time": "-1", "upper": "1", "lower": "0"}]),
    "coefficients of a tail": lambda data: data["upper"].update(tail=[{"near": ["-1", "0"], "coefficients": [["1", "0"]]}]),
    "radius is positive": lambda data: data["upper"].update(radius="0"),
    "begins at 0": lambda data: data["upper"]["segments"][0].update(start="0.1"),
    "lasts longer than 0": lambda data: data["upper"].update(maneuver_time="0"),
    "a move with segments": lambda data: data["upper"].update(segments=[], free=[]),
    "names an unknown twice": lambda data: data["upper"]["free"].append(data["upper"]["free"][0]),
    "4 equations need 4 unknowns": lambda data: data["upper"]["free"].pop(),
    "names no unknown: ['start', 0, 0]": lambda data: data["upper"].update(free=[["start", 0, 0]]),
    "names no unknown: ['start', 4, 0]": lambda data: data["upper"].update(free=[["start", 4, 0]]),
    "names no unknown: ['level', 4, 0]": lambda data: data["upper"].update(free=[["level", 4, 0]]),
    "names no unknown: ['level', 1, 1]": lambda data: data["upper"].update(free=[["level", 1, 1]]),
    "names no unknown: ['time', 1, 0]": lambda data: data["upper"].update(free=[["time", 1, 0]]),
    "names no unknown: ['re', 0, 0]": lambda data: data["upper"].update(free=[["re", 0, 0]]),
    "free[0][0] is one of im, level, re, start, time": lambda data: data["upper"].update(free=[["tail", 0, 0]]),
    "free[0][1] is a whole number from 0 on, not -1": lambda data: data["upper"].update(free=[["level", -1, 0]]),
    "free[0][1] is a whole number from 0 on, not False": lambda data: data["upper"].update(free=[["time", False, 0]]),
    "free[0] is an array of 3 items": lambda data: data["upper"].update(free=["time"]),
}


@pytest.mark.parametrize("sentence", MALFORMED)
def test_malformed_certificates_say_what_is_wrong(sentence: str) -> None:
    found = check(changed(proven("two_mass_1"), MALFORMED[sentence]))
    assert found.outcome is Outcome.MALFORMED
    assert found.certificate is None
    assert sentence in found.reason


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data["task"]["limits"].update(tail_length={"time": "-1", "within": "1"}), "a time from 0 on"),
        (lambda data: data["task"]["limits"].update(tail_length={"time": "1", "within": "0"}), "a fraction from 0"),
        (lambda data: data["task"]["limits"].update(tail_length={"time": "1", "within": "1.01"}), "a fraction from 0"),
        (lambda data: data["task"]["plants"][0].update(denominator=["1", "1", "0"]), "no common factor"),
        (lambda data: data["upper"]["tail"].append(data["upper"]["tail"][0]), "named twice"),
        (lambda data: data["upper"]["tail"][0]["coefficients"].append(["0", "0"]), "other coefficients"),
        (lambda data: data["upper"].update(free=[["im", 0, 0], ["time", 0, 0]]), "names no unknown: ['im', 0, 0]"),
        (lambda data: data["upper"].update(free=[["re", 0, 1], ["time", 0, 0]]), "names no unknown: ['re', 0, 1]"),
        (lambda data: data["upper"].update(maneuver_time="0", segments=[], free=[["time", 0, 0]]), "names no unknown: ['time', 0, 0]"),
    ],
)
def test_malformed_output_rests(change: Callable[[dict[str, Any]], Any], sentence: str) -> None:
    found = check(changed(proven_tail("real_zero"), change))
    assert found.outcome is Outcome.MALFORMED
    assert sentence in found.reason


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"null",
        b"[]",
        b'"slewcert"',
        b"\xff\xfe",
        b"\xef\xbb\xbf{}",
        b'{"a":1,"a":1}',
        b'{"a":NaN}',
        b'{"a":-Infinity}',
        b'{"a":1.5}',
        b'{"a":1e5}',
        b'{"a":-0}',
        b'{"a":' + b"9" * 5000 + b"}",
        b"[" * 1_000_000,
        b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
        b'{"digest":"\\ud800"}',
        b'{"b":1,"a":1}',
        b"{}\n",
        b" " * (16 * 2**20 + 1),
    ],
    ids=range(20),
)
def test_what_is_no_certificate_at_all(content: bytes) -> None:
    assert outcome(content) is Outcome.MALFORMED


def test_members_stand_in_their_order() -> None:
    """RFC 8785 sorts them, and a digest of other bytes does not help."""
    data = opened(proven("rigid_body"))
    plain = {name: data[name] for name in reversed(data) if name != "digest"}
    text = json.dumps(plain, separators=(",", ":"))
    for of in (text, json.dumps(plain, sort_keys=True, separators=(",", ":"))):
        digest = hashlib.sha256(of.encode()).hexdigest()
        assert outcome(f'{text[:-1]},"digest":"{digest}"}}'.encode()) is Outcome.MALFORMED
        assert outcome(f'{{"digest":"{digest}",{text[1:]}'.encode()) is Outcome.MALFORMED


def test_every_prefix_and_a_wrong_digest_are_malformed() -> None:
    content = proven("rigid_body")
    for end in range(len(content)):
        assert outcome(content[:end]) is Outcome.MALFORMED
    data = opened(content)
    data["claim"]["lower"] = "1"
    assert outcome(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()) is Outcome.MALFORMED


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", Fraction(0)),
        ("-12.05", Fraction(-1205, 100)),
        ("3/7", Fraction(3, 7)),
        ("-1/3", Fraction(-1, 3)),
        ("0x1p+0", Fraction(1)),
        ("-0x1.8p-1074", Fraction(-3, 2**1075)),
        ("0x1.fffffffffffffp+1023", Fraction(float.fromhex("0x1.fffffffffffffp+1023"))),
        ("1" + "0" * 1999, Fraction(10**1999)),
    ],
)
def test_numbers_are_exact(text: str, value: Fraction) -> None:
    assert real(text) == fmpq(value.numerator, value.denominator)


NO_NUMBERS = """
- -0 +1 01 1. .5 1.0 1.50 1e5 1_0 ² ١ nan inf NaN -Infinity 1/1 2/4 0/3 1/0 1/-2 -0/1 1/02 1//2
0x1 0x2p+0 0x1.80p+0 0x1p0 0x1p-0 0x1p+01 0x1.p+0 0X1P+0 0x1.8p+1101 0x1p+99999 0x1.8P+0 0x1.11111111111111p+0
"""


@pytest.mark.parametrize("text", [*NO_NUMBERS.split(), "", "1 ", " 1", "1\n", "1" + "0" * 2000, 1, None, True, ["1"], {}])
def test_other_texts_are_no_numbers(text: Any) -> None:
    with pytest.raises(Malformed):
        real(text)


def test_the_writers_numbers_are_the_readers() -> None:
    for value in (
        0.0,
        -0.0,
        1.0,
        0.1,
        -1e-300,
        5e-324 * 2**60,
        1e300,
        Fraction(1, 3),
        Fraction(-5, 8),
        Fraction(10**70),
        Fraction(1, 2**300),
    ):
        assert real(certificates.text(value)) == fmpq(*Fraction(value).as_integer_ratio())
