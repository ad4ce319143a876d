"""Certificates of limits of steps from sample to sample: hand-made ones, and lies about them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from forgery import certificate, changed, command, costate, number, opened, proven_limited, task, written

from relaxations.checking.claims import Outcome, check, claim
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time

# Lies about ∫u = 1, |u| ≤ 1, samples of 1/8 s and steps of at most 1/4 (slopes of 2): 11 samples. p = 1, q = 1 at the end, falling by 1/8 a
# sample (all that u gains there is in the steps), and the same with the other sign at the beginning of ten samples, or fewer.

FALLING = [1 / 2, 3 / 8, 1 / 4, 1 / 8]


def multipliers(count: int) -> list[str]:
    """The last step first; where the input is inside its limits `∫_cell p - q_k + q_{k-1}` is 0."""
    ends = [f"-{x}" for x in FALLING], [f"{x}" for x in FALLING[::-1]]
    return [*ends[0], *["0"] * (count + 1 - 8), *ends[1]]


def lower_side(time: str, steps: list[str], **others: Any) -> Outcome:
    posed = task(["1"], ["1", "0"], others.pop("displacement", "1"), **{"rate": ["-2", "2"], "sample_time": "1/8", **others})
    return check(certificate(posed, time, witnesses=(costate((("0", "0"), [("1", "0")]), steps=steps), None))).outcome


def test_the_lower_side_of_steps() -> None:
    # ten samples do at most 7/8
    assert lower_side("11/8", multipliers(10)) is Outcome.PROVED
    assert lower_side("11/8", multipliers(10), displacement="0.876") is Outcome.PROVED
    assert lower_side("11/8", multipliers(10), displacement="0.874") is Outcome.REFUTED
    assert lower_side("3/2", multipliers(11)) is not Outcome.PROVED
    assert lower_side("3/2", multipliers(11), displacement="1.01") is Outcome.PROVED
    assert lower_side("11/8", []) is Outcome.REFUTED  # ten samples without limits of their steps do 10/8
    assert lower_side("11/8", multipliers(10), rate=["-2.6", "2.6"]) is Outcome.REFUTED
    assert lower_side("11/8", multipliers(10), rate=None) is Outcome.MALFORMED
    assert lower_side("11/8", multipliers(10), sample_time=None) is Outcome.MALFORMED
    assert lower_side("11/8", multipliers(10), pulses=3) is Outcome.MALFORMED
    for i in range(11):
        worse = [*multipliers(10)]
        worse[i] = "0.7" if not worse[i].startswith("-") else "-0.7"
        assert lower_side("11/8", worse, displacement="0.876") is not Outcome.PROVED, i


def test_the_upper_side_of_steps() -> None:
    def outcome(levels: list[str], rate: tuple[str, str] = ("-2", "2"), step: str = "1/8", free: int = 3) -> Outcome:
        posed = task(["1"], ["1", "0"], rate=list(rate), sample_time=step)
        segments = [(written(Fraction(k, 8)), level) for k, level in enumerate(levels)]
        witness = command(written(Fraction(len(levels), 8)), segments, [["level", free, 0]])
        return check(certificate(posed, upper=written(Fraction(len(levels), 8)), witnesses=(None, witness))).outcome

    levels = ["0.24", "0.48", "0.72", *["0.853333333"] * 6, "0.72", "0.48", "0.24"]  # their sum is 8
    assert outcome(levels, free=5) is Outcome.PROVED
    assert outcome(levels, ("-2", "1.9"), free=5) is Outcome.REFUTED  # 0.24 is more than 1.9/8
    assert outcome(levels, ("-1.9", "2"), free=5) is Outcome.REFUTED
    assert outcome(levels, step="1/16", free=5) is Outcome.REFUTED  # steps of half as much
    assert outcome(levels[1:], free=4) is Outcome.REFUTED  # begins with a step of 0.48
    assert outcome(levels[:-1], free=5) is Outcome.REFUTED  # ends with one


def test_a_changed_limit_changes_the_claim_of_several() -> None:
    content = proven_limited("steps")
    words = claim(check(content))
    assert "From sample to sample, and from and to the rests, u changes by h times a slope in [-4, 4]." in words
    assert "never leaves its first rest value by more than 0.5" in words
    step = Fraction("0.07")
    for side, change in (("lower", step), ("upper", -step)):
        time = number(opened(content)["claim"][side]) + change
        lie = changed(content, lambda data, side=side, time=time: data["claim"].update({side: written(time)}))
        assert check(lie).outcome is not Outcome.PROVED
    for name in ("deflection", "steps"):
        dropped = changed(content, lambda data, name=name: data["lower"].update({name: []}))
        assert check(dropped).outcome is not Outcome.PROVED
    looser = changed(content, lambda data: data["task"]["limits"].update(rate=["-40", "40"]))
    assert check(looser).outcome is not Outcome.PROVED
    tighter = changed(content, lambda data: data["task"]["limits"]["deflection"].update(output_rate="0.45"))
    assert check(tighter).outcome is not Outcome.PROVED


def test_a_level_that_lasts_no_sample_does_not_divide_a_step() -> None:
    """From 1 to -1 by way of 0, at the same instant: two steps of 1 on paper, one of 2 in the machine."""
    mass = LinearPlant.from_transfer([1], [1, 0, 0])
    free = minimum_time(problem([mass], Maneuver(Fraction(1), Limits.of(-1, 1), sample_time=Fraction(1, 2))))
    assert free.certificate is not None

    def stepped(rate: str, between: bool) -> Outcome:
        def change(data: Any) -> None:
            data["task"]["limits"]["rate"] = [f"-{rate}", rate]
            data["claim"]["lower"] = data["lower"] = None
            first, second = data["upper"]["segments"]
            data["upper"]["segments"] = [first, *([{"start": second["start"], "level": "0"}] if between else []), second]

        return check(changed(free.certificate, change)).outcome  # type: ignore[arg-type]

    assert stepped("4", between=False) is Outcome.PROVED
    assert stepped("2", between=False) is Outcome.REFUTED
    assert stepped("2", between=True) is Outcome.REFUTED
