"""Plants that vary along a known schedule: constant ones, closed forms, other programs, the checker's enclosures, lies, refusals."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_mat
from forgery import changed, forged, number, opened, written
from scipy.optimize import root_scalar
from scipy.special import airy
from varying_plants import GROWING, crane, landed, posed, random_plant, reaches, rest

from relaxations.bounds import Bound, Status
from relaxations.checking import varying as checker
from relaxations.checking.balls import work
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import read
from relaxations.commands import Command
from relaxations.errors import ManeuverError, PlantError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact, precision
from relaxations.proofs import REGULAR, minimum_time
from relaxations.transitions import Transition, VaryingPlant
from relaxations.varying import varying_problem
from relaxations.varying_response import varying_response

SPRING_A, SPRING_B, SPRING_C = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [1, -1, 0, 0]], [0, 0, 1, 0], [0, 1, 0, 0]
DAMPED_A, DAMPED_B, DAMPED_C = [[0, 1, 0], [0, "-0.5", 1], [0, "-3", "-0.2"]], [0, 1, 2], [1, 0, 0]
STIFF_A, STIFF_B, STIFF_C = [[0, 1], [-1, 0]], [0, 1], [1, 0]  # held at its target by an input


def proven(asked: Problem, gap: float = REGULAR) -> tuple[Bound, Command, bytes]:
    found = minimum_time(asked)
    assert found.status is Status.PROVED, found.reason
    assert found.command is not None
    assert found.upper is not None
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.upper - found.lower <= gap * found.lower
    return found, found.command, found.certificate


@pytest.mark.parametrize(
    ("A", "B", "C", "displacement", "limits"),
    [
        (SPRING_A, SPRING_B, SPRING_C, 1, Limits.of(-1, 1)),
        (SPRING_A, SPRING_B, SPRING_C, 5, Limits.of(-1, 1, 4)),
        (DAMPED_A, DAMPED_B, DAMPED_C, 2, Limits.of(-1, "0.7")),
        (STIFF_A, STIFF_B, STIFF_C, "0.5", Limits.of(-1, 1)),
        (STIFF_A, STIFF_B, STIFF_C, "-0.5", Limits.of(-1, "0.25")),
    ],
)
def test_a_constant_schedule_is_the_constant_plant(A, B, C, displacement, limits) -> None:
    maneuver = Maneuver(exact(displacement), limits)
    constant = minimum_time(problem([LinearPlant.from_state_space(A, B, C)], maneuver))
    for instants in ([0], [0, "0.3", 1, 100]):
        plant = VaryingPlant.of(instants, [A] * len(instants), [B] * len(instants), [C] * len(instants))
        found, command, _ = proven(varying_problem(plant, maneuver))
        assert (found.lower, found.upper, found.switches) == (constant.lower, constant.upper, constant.switches)
        assert constant.command is not None
        assert [s.level for s in command.segments] == [s.level for s in constant.command.segments]
        starts = [[s.start for s in each.segments] for each in (command, constant.command)]
        np.testing.assert_allclose(*starts, rtol=0.0, atol=4e-15)
        assert command.tail == constant.command.tail


def growing_time(displacement: float) -> tuple[float, float]:
    """x'' = (1 + t) u: one switch at t_1, `2 (t_1 + t_1²/2) = T + T²/2` for the velocity, `2 m(t_1) = m(T) - Δ`, m = t²/2 + t³/3."""

    def m(t: float) -> float:
        return t * t / 2 + t**3 / 3

    def switch(T: float) -> float:
        return float(np.sqrt(1 + (T + T * T / 2)) - 1)

    time = float(root_scalar(lambda T: m(T) - 2 * m(switch(T)) - displacement, bracket=(0.1, 2.0), xtol=1e-15).root)
    return time, switch(time)


@pytest.mark.parametrize("displacement", ["1", "0.05", "1.5"])
def test_a_gain_that_grows_has_a_closed_form(displacement: str) -> None:
    time, switch = growing_time(float(displacement))
    found, command, _ = proven(posed(GROWING, displacement))
    assert found.lower <= time * (1 + 1e-14)
    assert found.upper is not None
    assert found.upper >= time * (1 - 1e-14)
    assert command.segments[1].start == pytest.approx(switch, rel=1e-13)


def test_the_transition_of_a_stiffening_spring_is_airys() -> None:
    # z'' = -(1 + t) z is solved by Ai(-(1 + t)) and Bi; Φ(0, t) = W(0) W(t)⁻¹ for their matrix W.
    end, x = 3.0, np.linspace(0.0, 3.0, 31)
    plant = VaryingPlant.of([0, 3], [[[0, 1], [-1, 0]], [[0, 1], [-4, 0]]], [[0, 1]] * 2, [[1, 0]] * 2)

    def wronski(t: float) -> np.ndarray:
        ai, rate_a, bi, rate_b = airy(-(1 + t))
        return np.array([[ai, bi], [-rate_a, -rate_b]])

    expected = np.array([wronski(0.0) @ np.linalg.inv(wronski(t)) @ [0.0, 1.0] for t in x]).T
    np.testing.assert_allclose(Transition(plant).rows(x), expected, rtol=0.0, atol=2e-14)
    transition = Transition(plant)
    step = 1e-4
    middle = x[1:-1]
    np.testing.assert_allclose(
        (transition.rows(middle + step) - transition.rows(middle - step)) / 2 / step, transition.slopes(middle), atol=1e-7
    )
    sums = np.diff(transition.rows(np.array([0.0, end]), 1))[:, 0]
    fine = np.linspace(0.0, end, 20001)
    np.testing.assert_allclose(sums, np.trapezoid(transition.rows(fine), fine, axis=1), atol=1e-8)


HOISTING = crane({"0": "8", "1": "7.5", "2": "6.75", "3": "6.25", "4": "6"})


@pytest.mark.parametrize("plant", [HOISTING, *(random_plant(seed) for seed in range(3))])
def test_the_command_lands_and_another_program_finds_none_that_is_shorter(plant: VaryingPlant) -> None:
    found, command, _ = proven(posed(plant, 2))
    starts, levels = (np.array([getattr(s, which) for s in command.segments]) for which in ("start", "level"))
    target = rest(plant, 2)
    np.testing.assert_allclose(landed(plant, starts, levels, command.maneuver_time), target, rtol=0.0, atol=1e-9)
    assert set(levels) == {-1.0, 1.0}
    assert found.upper is not None
    assert reaches(plant, target, found.upper * 1.02, (-1.0, 1.0))
    assert not reaches(plant, target, found.lower * 0.99, (-1.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 60))
def test_many_random_schedules(seed: int) -> None:
    plant = random_plant(seed)
    found, command, _ = proven(posed(plant, 2, -1, "1.5"), gap=1e-6)
    starts, levels = (np.array([getattr(s, which) for s in command.segments]) for which in ("start", "level"))
    np.testing.assert_allclose(landed(plant, starts, levels, command.maneuver_time), rest(plant, 2), rtol=0.0, atol=1e-6)
    assert not reaches(plant, rest(plant, 2), found.lower * 0.99, (-1.0, 1.5))


def test_fuel_is_limited_and_more_of_it_is_never_slower() -> None:
    free, command, _ = proven(posed(HOISTING, 2))
    found = [proven(posed(HOISTING, 2, fuel=fuel))[0] for fuel in ("2.9", "2.2", "1.5")]
    assert command.fuel() > 2.9
    assert all(after.lower > before.upper for before, after in pairwise([free, *found]))  # type: ignore[operator]
    assert found[1].command is not None
    assert found[1].command.fuel() == pytest.approx(2.2, rel=1e-14)
    assert proven(posed(HOISTING, 2, fuel="10"))[0].upper == free.upper


def test_the_response_ends_at_rest_and_is_the_constant_plants_where_nothing_varies() -> None:
    from relaxations.response import response

    _, command, _ = proven(posed(HOISTING, 2))
    times = np.linspace(0.0, 25.0, 501)
    y = varying_response(HOISTING, command, times)
    np.testing.assert_allclose(y[times >= command.end], 2.0, rtol=0.0, atol=1e-7)
    spring = VaryingPlant.of([0, 2], [SPRING_A] * 2, [SPRING_B] * 2, [SPRING_C] * 2)
    plant = LinearPlant.from_state_space(SPRING_A, SPRING_B, SPRING_C)
    np.testing.assert_allclose(varying_response(spring, command, times), response(plant, command, times), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("plant", [HOISTING, GROWING, random_plant(7)])
def test_the_checkers_steps_enclose_the_transition(plant: VaryingPlant) -> None:
    schedule = read(proven(posed(plant, 1))[2]).task.schedule
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


@pytest.mark.parametrize("plant", [HOISTING, GROWING, random_plant(7)])
def test_what_is_cut_off_is_enclosed_too(plant: VaryingPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    """Series of some 16 terms in arithmetic of many digits: what is left out is then much more than rounding."""
    schedule, n = read(proven(posed(plant, 1))[2]).task.schedule, plant.order
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
    text = claim(check(proven(posed(GROWING))[2]))
    assert "every matrix linear in t between these instants, constant after the last" in text
    assert "t = 2 s: A = [[0, 1], [0, 0]], B = [0, 3], C = [1, 0], D = 0" in text


# Lies.


def outcome(content: bytes, change) -> Outcome:
    return check(changed(content, change)).outcome


@pytest.mark.parametrize("plant", [GROWING, HOISTING])
def test_lies_about_a_varying_plant(plant: VaryingPlant) -> None:
    content = proven(posed(plant))[2]
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
    content = proven(posed(HOISTING, 2, fuel="2"))[2]
    for fuel, refuted in (("1.9999999", "lower"), ("2.0000001", "upper")):  # what is left is the side that it takes away from
        one = outcome(content, lambda d, fuel=fuel, kept=refuted: (d["task"]["limits"].update(fuel=fuel), d["claim"].update({kept: None})))
        assert one is Outcome.REFUTED
    dear = outcome(content, lambda d: d["lower"].update(fuel=written(number(d["lower"]["fuel"]) * Fraction(11, 10))))
    assert dear is Outcome.REFUTED
    free = proven(posed(HOISTING, 2))[2]
    for limits in (["-0.99", "1"], ["-1", "0.99"]):
        assert (
            outcome(free, lambda d, limits=limits: (d["task"]["limits"].update(input=limits), d["claim"].update(lower=None)))
            is Outcome.REFUTED
        )


def test_krawczyks_test_finds_the_exact_command() -> None:
    """The start written is off by 1e-9, and the claim by 1e-11 only: the solution is found within a radius of 1e-6."""
    content = proven(posed(GROWING))[2]

    def moved(d: Any) -> None:
        segment = d["upper"]["segments"][1]
        segment["start"] = written(number(segment["start"]) + Fraction(1, 10**9))
        d["upper"]["radius"] = "1/1000000"
        d["claim"].update(upper=written(number(d["claim"]["upper"]) * (1 + Fraction(1, 10**11))))

    assert outcome(content, moved) is Outcome.PROVED


def test_rests_that_are_held() -> None:
    held = VaryingPlant.of([0, 1], [STIFF_A] * 2, [STIFF_B] * 2, [STIFF_C] * 2)
    content = proven(posed(held, "0.5"))[2]
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
    "comes to a rest of its state": lambda d: d["task"]["limits"].update(sample_time="1"),
    "no rest at the target, or more": lambda d: d["task"]["schedule"].update(C=[["0", "0"]] * 2),
    "is none at an instant": lambda d: d["task"]["schedule"].update(A=[[["0", "1"], ["1", "0"]], [["0", "1"], ["0", "0"]]]),
    "exclude the input": lambda d: d["task"]["limits"].update(input=["0.5", "1"]),
}


@pytest.mark.parametrize("said", MALFORMED)
def test_malformed_schedules_say_what_is_wrong(said: str) -> None:
    found = check(changed(proven(posed(GROWING))[2], MALFORMED[said]))
    assert found.outcome is Outcome.MALFORMED
    assert said in found.reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_random_corruption_of_a_schedule_never_proves_a_falsehood(seed: int) -> None:
    """One number anywhere is changed; what still proves is checked against another program."""
    rng = np.random.default_rng([7, seed])
    content = proven(posed(HOISTING, 2))[2]
    data = opened(content)
    places: list[tuple[object, object]] = []

    def walk(node: object) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            value = node[key]  # type: ignore[index]
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
    value = number(node[key])  # type: ignore[index]
    node[key] = written(value * Fraction(str(round(rng.uniform(0.9, 1.1), 4))) + Fraction(int(rng.integers(-1, 2)), 1000))  # type: ignore[index]
    found = check(forged(data))
    if found.outcome is not Outcome.PROVED:
        return
    task = found.certificate.written["task"]  # type: ignore[union-attr]
    schedule = task["schedule"]
    plant = VaryingPlant.of(schedule["instants"], schedule["A"], schedule["B"], schedule["C"], schedule["D"])
    target = np.array([float(x) for x in plant.rest(number(task["displacement"]))[0]])
    low, high = (float(number(x)) for x in task["limits"]["input"])
    claimed = data["claim"]
    assert not reaches(plant, target, float(number(claimed["lower"])) * 0.99, (low, high))
    assert reaches(plant, target, float(number(claimed["upper"])) * 1.02, (low, high))


@pytest.mark.slow
def test_hostile_schedules_end() -> None:
    content = proven(posed(GROWING))[2]
    stiff = changed(content, lambda d: d["task"]["schedule"].update(A=[[["0", "1"], ["0", "-1" + "0" * 12]]] * 2))
    assert check(stiff).outcome in {Outcome.INCONCLUSIVE, Outcome.REFUTED}
    late = changed(content, lambda d: d["claim"].update(upper=None, lower="1" + "0" * 30))
    assert check(late).outcome is not Outcome.PROVED
    digits = "1." + "3" * 1900
    heavy = changed(content, lambda d: d["task"]["schedule"].update(B=[["0", digits], ["0", "3"]]))
    assert check(heavy).outcome is not Outcome.PROVED


# What is refused.


def test_a_rest_lasts_or_there_is_none() -> None:
    with pytest.raises(PlantError, match=r"none at 0 s: there the plant would move on, by 1 a second; .* not where the plant rests"):
        posed(VaryingPlant.of([0, 1], [[[0, 1], [-1, 0]], [[0, 1], [-2, 0]]], [[0, 1]] * 2, [[1, 0]] * 2))
    with pytest.raises(PlantError, match="no rest"):
        posed(VaryingPlant.of([0], [[[0, 1], [0, 0]]], [[0, 1]], [[0, 1]]))
    with pytest.raises(PlantError, match="ascend from 0"):
        VaryingPlant.of([0, 1, 1], [[[0]]] * 3, [[1]] * 3, [[1]] * 3)
    with pytest.raises(PlantError, match="as many matrices"):
        VaryingPlant.of([0, 1], [[[0]]], [[1]] * 2, [[1]] * 2)
    with pytest.raises(PlantError, match="moves no state"):
        VaryingPlant.of([0], [[[0]]], [[0]], [[1]])


def test_scales_of_time_do_not_matter() -> None:
    # x'' = (1 + t/τ) u with u of 1/τ²: the closed form, τ times as long.
    time, _ = growing_time(1.0)
    for power in (-6, 6):
        tau = Fraction(10) ** power
        plant = VaryingPlant.of([0, 2 * tau], [[[0, 1], [0, 0]]] * 2, [[0, 1], [0, 3]], [[1, 0]] * 2)
        found, _, _ = proven(posed(plant, 1, -1 / tau**2, 1 / tau**2))
        assert found.upper == pytest.approx(time * float(tau), rel=1e-13)


def test_states_that_the_input_never_moves_are_dropped() -> None:
    A = [[0, 1, 5], [0, 0, 3], [0, 0, -1]]
    plant = VaryingPlant.of([0, 2], [A] * 2, [[0, 1, 0], [0, 3, 0]], [[1, 0, 2]] * 2)
    assert (plant.order, plant.A[0]) == (2, ((0, 1), (0, 0)))
    assert "1 of 3 states are not moved" in plant.notes[0]
    assert proven(posed(plant))[0].upper == proven(posed(GROWING))[0].upper


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"tail": True}, "tail"),
        ({"robustness": 1}, "robustness"),
        ({"sample_time": Fraction(1, 10)}, "a sample time"),
        ({"initial": (Fraction(1), Fraction(0))}, "an initial state"),
    ],
)
def test_what_a_varying_plant_is_not_moved_with(others: dict[str, object], said: str) -> None:
    with pytest.raises(ManeuverError, match=said):
        varying_problem(GROWING, Maneuver(Fraction(1), Limits.of(-1, 1), **others))  # type: ignore[arg-type]
    for limits in (Limits.of(-1, 1, rate=(-1, 1)), Limits.of(-1, 1, deflection={"output": 1})):
        with pytest.raises(ManeuverError, match="limits o"):
            varying_problem(GROWING, Maneuver(Fraction(1), limits))
    with pytest.raises(ManeuverError, match="outside the limits"):
        posed(GROWING, lower="0.1")


def test_certificates_are_canonical_and_name_the_schedule() -> None:
    data = json.loads(proven(posed(HOISTING, 2))[2])
    assert data["task"]["plants"] == []
    assert data["task"]["schedule"]["instants"] == ["0", "1", "2", "3", "4"]
    assert len(data["lower"]["costate"][0][0]["coefficients"]) == HOISTING.order
