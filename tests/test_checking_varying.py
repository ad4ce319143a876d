"""The checker's part for plants that vary: its enclosures of the transition, lies, malformed and hostile schedules."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_mat
from forgery import changed, forged, number, opened, written
from varying_plants import GROWING, HOISTING, certified, random_plant, reaches

from relaxations.checking import transitions as checker
from relaxations.checking.balls import work
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import read
from relaxations.plants import precision
from relaxations.transitions import Transition, VaryingPlant

PLANTS = {"hoisting": HOISTING, "growing": GROWING, "random": random_plant(7)}


@pytest.mark.parametrize("name", PLANTS)
def test_the_checkers_steps_enclose_the_transition(name: str) -> None:
    plant, schedule = PLANTS[name], read(certified(name)).task.schedule
    work["left"] = 1e9
    rng = np.random.default_rng(3)
    with precision(128):
        steps = list(checker.steps(schedule, arb_mat(plant.order, plant.order, 1), arb(7)))
        places = [(step, arb(Fraction(str(round(rng.uniform(0, 1), 6))).numerator) / 10**6) for step in steps]
        seen = [(step, share, step.impulse(arb(step.length) * share), step.step(arb(step.length) * share)) for step, share in places]
    exactly = Transition(plant, 400)
    with precision(400):
        for step, share, impulse, total in seen:
            begin, at = arb(step.begin), arb(step.begin) + arb(step.length) * share
            truth, sums = exactly.long([at], 0), exactly.long([at], 2) - exactly.long([begin], 2)
            assert all(ball.overlaps(value) for ball, value in zip(impulse.entries(), truth.entries(), strict=True))
            assert all(ball.overlaps(value) for ball, value in zip(total.entries(), sums.entries(), strict=True))
            assert max(float(ball.rad()) for ball in impulse.entries()) < 1e-25


@pytest.mark.parametrize("name", PLANTS)
def test_what_is_cut_off_is_enclosed_too(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Series of some 16 terms in arithmetic of many digits: what is left out is then much more than rounding."""
    plant, schedule = PLANTS[name], read(certified(name)).task.schedule
    n = plant.order
    monkeypatch.setattr(checker, "flint", SimpleNamespace(ctx=SimpleNamespace(prec=4)))
    work["left"] = 1e9
    exactly = Transition(plant, 400)
    with precision(400):
        for row in range(n):
            begun = [arb(0)] * n
            begun[row] = arb(1)
            start = arb_mat([begun])
            # One step only: what comes in is exact, so that what comes out is wide for no other reason.
            step = next(checker.steps(schedule, start, arb(1)))
            assert len(step.rows) < 20
            for share in (arb(1), arb(2) / 3):
                tau = arb(step.length) * share
                truth, slope, total = (exactly.long([tau], which)[row, 0] for which in range(3))
                assert step.impulse(tau)[0, 0].overlaps(truth)
                assert step.step(tau)[0, 0].overlaps(total)
                _, value, steep, _ = step.costate.over(tau.mid(), tau.mid())
                assert value.overlaps(truth)
                assert steep.overlaps(slope)
                assert (step.costate.integral(tau)).overlaps(total)
                assert float(value.rad()) < 1e-5


def test_what_the_claim_says() -> None:
    text = claim(check(certified("growing")))
    assert "every matrix linear in t between these instants, constant after the last" in text
    assert "t = 2 s: A = [[0, 1], [0, 0]], B = [0, 3], C = [1, 0], D = 0" in text


# Lies.


def outcome(content: bytes, change) -> Outcome:
    return check(changed(content, change)).outcome


@pytest.mark.parametrize("name", ["growing", "hoisting"])
def test_lies_about_a_varying_plant(name: str) -> None:
    content = certified(name)
    data = opened(content)
    lower, upper = (number(data["claim"][side]) for side in ("lower", "upper"))
    for side, value in (("lower", lower), ("upper", upper)):
        for factor, wanted in ((Fraction(1000001, 10**6), "lower"), (Fraction(999999, 10**6), "upper")):
            got = outcome(content, lambda d, side=side, value=value, factor=factor: d["claim"].update({side: written(value * factor)}))
            assert got is (Outcome.REFUTED if side == wanted else Outcome.PROVED)

    def gain(d: Any, factor: Fraction) -> None:
        last = d["task"]["schedule"]["B"]
        last[-1] = [written(number(x) * factor) for x in last[-1]]

    assert outcome(content, lambda d: gain(d, Fraction(101, 100))) is Outcome.REFUTED  # a stronger actuator: faster, and elsewhere
    assert outcome(content, lambda d: (gain(d, Fraction(101, 100)), d["claim"].update(upper=None))) is Outcome.REFUTED
    assert outcome(content, lambda d: (gain(d, Fraction(99, 100)), d["claim"].update(upper=None))) in {Outcome.PROVED, Outcome.REFUTED}
    assert outcome(content, lambda d: (gain(d, Fraction(99, 100)), d["claim"].update(lower=None))) is Outcome.REFUTED
    assert outcome(content, lambda d: d["task"]["limits"].update(input=["-1.1", "1.1"])) is Outcome.REFUTED
    assert outcome(content, lambda d: d["upper"]["segments"][1].update(level="0.9")) is Outcome.REFUTED
    assert outcome(content, lambda d: d["upper"]["free"].pop()) is Outcome.MALFORMED
    assert outcome(content, lambda d: d["lower"]["costate"][0][0]["coefficients"].pop()) is Outcome.MALFORMED
    assert outcome(content, lambda d: d["lower"]["costate"][0][0]["coefficients"].append(["0", "0"])) is Outcome.MALFORMED

    def flip(d: Any) -> None:
        chain = d["lower"]["costate"][0][0]
        chain["coefficients"] = [[written(-number(a)), b] for a, b in chain["coefficients"]]

    assert outcome(content, flip) is Outcome.REFUTED
    assert outcome(content, lambda d: d["claim"].update(impossible="face", lower=None, upper=None)) is Outcome.INCONCLUSIVE


def test_lies_about_fuel_and_limits() -> None:
    content = certified("hoisting_fuel")
    for fuel, refuted in (("1.9999999", "lower"), ("2.0000001", "upper")):  # what is left is the side that it takes away from
        one = outcome(content, lambda d, fuel=fuel, kept=refuted: (d["task"]["limits"].update(fuel=fuel), d["claim"].update({kept: None})))
        assert one is Outcome.REFUTED
    dear = outcome(content, lambda d: d["lower"].update(fuel=written(number(d["lower"]["fuel"]) * Fraction(11, 10))))
    assert dear is Outcome.REFUTED
    free = certified("hoisting_far")
    for limits in (["-0.99", "1"], ["-1", "0.99"]):
        assert (
            outcome(free, lambda d, limits=limits: (d["task"]["limits"].update(input=limits), d["claim"].update(lower=None)))
            is Outcome.REFUTED
        )


def test_krawczyks_test_finds_the_exact_command() -> None:
    """The start written is off by 1e-9, and the claim by 1e-11 only: the solution is found within a radius of 1e-6."""
    content = certified("growing")

    def moved(d: Any) -> None:
        segment = d["upper"]["segments"][1]
        segment["start"] = written(number(segment["start"]) + Fraction(1, 10**9))
        d["upper"]["radius"] = "1/1000000"
        d["claim"].update(upper=written(number(d["claim"]["upper"]) * (1 + Fraction(1, 10**11))))

    assert outcome(content, moved) is Outcome.PROVED


@pytest.mark.parametrize("off", [Fraction(1, 10**9), Fraction(-1, 10**9)])
def test_fuel_is_that_of_the_exact_command(off: Fraction) -> None:
    content = certified("hoisting_fuel")
    place = next(i for kind, i, _ in opened(content)["upper"]["free"] if kind == "start")

    def moved(d: Any) -> None:
        segment = d["upper"]["segments"][place]
        segment["start"] = written(number(segment["start"]) + off)
        d["upper"]["radius"] = "1/1000000"
        d["task"]["limits"]["fuel"] = "2.0000000001"
        d["claim"].update(lower=None, upper=written(number(d["claim"]["upper"]) * (1 + Fraction(1, 10**10))))

    assert outcome(content, moved) is Outcome.PROVED


def test_rests_that_are_held() -> None:
    content = certified("held")
    for change, said in (
        (lambda d: d["task"]["limits"].update(input=["0.2", "1"]), "exclude the input"),
        (lambda d: d["task"]["limits"].update(fuel="5"), "rests without input"),
    ):
        found = check(changed(content, change))
        assert found.outcome is Outcome.MALFORMED
        assert said in found.reason


MALFORMED = {
    "the final rest is none": lambda d: d["task"]["schedule"].update(C=[["2", "0"], ["1", "0"]]),
    "ascend from 0": lambda d: d["task"]["schedule"].update(instants=["0", "0"]),
    "the instants of a schedule ascend": lambda d: d["task"]["schedule"].update(instants=["1", "2"]),
    "for every instant": lambda d: d["task"]["schedule"]["A"].pop(),
    "B and C have n numbers": lambda d: d["task"]["schedule"]["C"][0].append("0"),
    "A is n×n": lambda d: d["task"]["schedule"]["A"][0].pop(),
    "one plant, or one that varies": lambda d: d["task"].update(schedule=None),
    "comes to a rest of its state": lambda d: d["task"].update(rest="output"),
    "no rest at the target, or more": lambda d: d["task"]["schedule"].update(C=[["0", "0"]] * 2),
    "is none at an instant": lambda d: d["task"]["schedule"].update(A=[[["0", "1"], ["1", "0"]], [["0", "1"], ["0", "0"]]]),
    "exclude the input": lambda d: d["task"]["limits"].update(input=["0.5", "1"]),
}


@pytest.mark.parametrize("said", MALFORMED)
def test_malformed_schedules_say_what_is_wrong(said: str) -> None:
    found = check(changed(certified("growing"), MALFORMED[said]))
    assert found.outcome is Outcome.MALFORMED
    assert said in found.reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_random_corruption_of_a_schedule_never_proves_a_falsehood(seed: int) -> None:
    """One number anywhere is changed; what still proves is checked against another program."""
    rng = np.random.default_rng([7, seed])
    content = certified("hoisting_far")
    data = opened(content)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            value = node[key]
            if isinstance(value, str):
                try:
                    number(value)
                except (ValueError, ZeroDivisionError):
                    continue
                places.append((node, key))
            else:
                walk(value)

    walk({key: data[key] for key in ("task", "claim", "lower", "upper")})
    node, key = places[rng.integers(len(places))]
    value = number(node[key])
    node[key] = written(value * Fraction(str(round(rng.uniform(0.9, 1.1), 4))) + Fraction(int(rng.integers(-1, 2)), 1000))
    found = check(forged(data))
    if found.outcome is not Outcome.PROVED:
        return
    assert found.certificate is not None
    task = found.certificate.written["task"]
    schedule = task["schedule"]
    plant = VaryingPlant.of(schedule["instants"], schedule["A"], schedule["B"], schedule["C"], schedule["D"])
    target = np.array([float(x) for x in plant.rest(number(task["displacement"]))[0]])
    low, high = (float(number(x)) for x in task["limits"]["input"])
    claimed = data["claim"]
    assert not reaches(plant, target, float(number(claimed["lower"])) * 0.99, (low, high))
    assert reaches(plant, target, float(number(claimed["upper"])) * 1.02, (low, high))


@pytest.mark.slow
def test_hostile_schedules_end() -> None:
    content = certified("growing")
    stiff = changed(content, lambda d: d["task"]["schedule"].update(A=[[["0", "1"], ["0", "-1" + "0" * 12]]] * 2))
    assert check(stiff).outcome in {Outcome.INCONCLUSIVE, Outcome.REFUTED}
    late = changed(content, lambda d: d["claim"].update(upper=None, lower="1" + "0" * 30))
    assert check(late).outcome is not Outcome.PROVED
    digits = "1." + "3" * 1900
    heavy = changed(content, lambda d: d["task"]["schedule"].update(B=[["0", digits], ["0", "3"]]))
    assert check(heavy).outcome is not Outcome.PROVED
