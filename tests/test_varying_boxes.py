"""Boxes of plants that vary: other programs and transitions, constant plants, nested boxes, the checker's lies, refusals."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from forgery import changed, number, opened, written
from marks import first
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from varying_plants import crane, matrices

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Axis, Box, Listed
from relaxations.transitions import VaryingPlant
from relaxations.varying import varying_problem
from relaxations.varying_boxes import VaryingBox, varying_box_time

Reals = NDArray[np.float64]

pytestmark = pytest.mark.slow  # the tests without a solver are in test_checking_varied*.py

MOVE = Maneuver(Fraction(3), Limits.of(-1, 1))
ONE = Fraction(1)


def hoisting(scale: str, last: str = "3") -> VaryingPlant:
    """A crane that hauls in within 3 s, all its lengths times a factor."""
    return crane({"0": str(5 * Fraction(scale)), "3": str(Fraction(last) * Fraction(scale))})


def box(scales: tuple[str, ...], tolerance: str = "0.02", last: str = "3") -> VaryingBox:
    """The nominal crane and others."""
    values = [Fraction(scale) for scale in ("1", *scales)]
    members = tuple(((value,), hoisting(str(value), last)) for value in values)
    return VaryingBox((Axis("scale", ONE, min(values), max(values)),), members, exact(tolerance))


@cache
def found(scales: tuple[str, ...] = ("0.9",), tolerance: str = "0.02", last: str = "3") -> Bound:
    """The bracket, proven."""
    bound = varying_box_time(box(scales, tolerance, last), MOVE)
    assert bound.status is Status.PROVED, bound.reason
    assert bound.certificate is not None
    assert check(bound.certificate).outcome is Outcome.PROVED
    assert bound.gap is not None
    assert 0.0 < bound.gap <= 1e-4
    return bound


def residual(plant: VaryingPlant, command: Any, times: Reals) -> Reals:
    """The output less its target at times after the command, by Runge and Kutta's method."""
    edges = np.unique([s.start for s in command.segments] + [command.maneuver_time, *(float(t) for t in plant.instants)])
    edges = np.append(edges[edges < times[-1]], times[-1])
    state, seen = np.zeros(plant.order), []
    instants = [float(t) for t in plant.instants]
    for begin, end in pairwise(edges):
        level = [s.level for s in command.segments if s.start <= begin][-1] if begin < command.maneuver_time else 0.0

        def rates(t: float, x: Reals, level: float = level) -> Reals:
            A, B = matrices(plant, t)
            return A @ x + B * level

        inside = times[(times > begin) & (times <= end)]
        states = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-11, atol=1e-13, t_eval=np.unique(np.append(inside, end))).y
        state = states[:, -1]
        C = np.array([np.interp(inside, instants, column) for column in np.array(plant.C, dtype=float).T])
        seen += list((C * states[:, : len(inside)]).sum(axis=0))
    return np.array(seen) - 3.0


@pytest.mark.slow
def test_the_command_does_what_is_claimed_by_another_integration() -> None:
    bound = found()
    assert bound.command is not None
    worst = []
    for scale in ("1", "0.9"):
        times = np.linspace(bound.command.maneuver_time, bound.command.maneuver_time + 12.0, 400)[1:]
        worst.append(float(np.abs(residual(hoisting(scale), bound.command, times)).max()))
    assert max(worst) <= 0.06 * (1 + 1e-6)
    assert max(worst) >= 0.06 * (1 - 1e-3)  # 400 looks are that close to a peak


def least(plants: list[VaryingPlant], horizon: float, cells: int) -> float:
    """The least residual over V |Δ|, on equal cells, by HiGHS: columns are numerically integrated responses of single cells."""
    edges, after = np.linspace(0.0, horizon, cells + 1), np.linspace(0.0, 5.0, 60)
    rows, ends = [], []
    for plant in plants:
        instants = [float(t) for t in plant.instants]

        def rates(t: float, x: Reals, plant: VaryingPlant = plant) -> Reals:
            A, B = matrices(plant, t)
            Y = x.reshape(4, 5)
            return np.column_stack([A @ Y[:, :4], A @ Y[:, 4] + B]).ravel()

        state, columns = np.column_stack([np.eye(4), np.zeros(4)]), np.zeros((4, cells))
        for k, (begin, end) in enumerate(pairwise(edges)):
            moved = solve_ivp(rates, (begin, end), state.ravel(), method="DOP853", rtol=1e-9, atol=1e-11, max_step=end - begin).y[:, -1]
            columns = moved.reshape(4, 5)[:, :4] @ columns
            columns[:, k] += moved.reshape(4, 5)[:, 4]
        C = np.array(plant.C[-1], dtype=float)
        assert horizon > instants[-1]
        values, vectors = np.linalg.eig(np.array(plant.A[-1], dtype=float)[2:, 2:])
        for tau in after:
            swing = (vectors @ np.diag(np.exp(values * tau)) @ np.linalg.inv(vectors)).real
            rows.append(C[2:] @ swing @ columns[2:] / 0.06)
        ends.append(columns[:2])
    rows_, s = np.array(rows), -np.ones((len(rows), 1))
    answer = linprog(
        np.append(np.zeros(cells), 1.0),
        A_ub=np.block([[rows_, s], [-rows_, s]]),
        b_ub=np.zeros(2 * len(rows)),
        A_eq=np.column_stack([ends[0], np.zeros(2)]),
        b_eq=[3.0, 0.0],
        bounds=[(-1, 1)] * cells + [(0, None)],
    )
    assert answer.status == 0
    return float(answer.fun)


@pytest.mark.slow
def test_another_program_agrees() -> None:
    bound, plants = found(), [hoisting("1"), hoisting("0.9")]
    assert bound.upper is not None
    assert least(plants, bound.lower * 0.997, 50) > 1.0
    assert least(plants, bound.upper * 1.003, 50) < 1.0


@pytest.mark.slow
def test_the_command_for_one_plant_is_shorter_and_leaves_more_in_the_other() -> None:
    alone = found(())
    assert alone.upper is not None
    assert alone.upper < found().lower
    assert alone.command is not None
    times = np.linspace(alone.command.maneuver_time, alone.command.maneuver_time + 8.0, 200)[1:]
    assert float(np.abs(residual(hoisting("0.9"), alone.command, times)).max()) > 0.06


CLAIM = ("'scale' in [0.9, 1] (nominal 1)", "these 2 plants", "while it still varies and ever after, is at most 0.02")


def test_the_claim_says_which_plants_it_is_about() -> None:
    content = found().certificate
    assert content is not None
    words = claim(check(content))
    assert all(part in words for part in CLAIM), words
    assert "nothing is said of any other plant" in words


Change = Any


def _level(data: dict[str, Any], by: str) -> None:
    segment = data["upper"]["segments"][0]
    segment["level"] = written(number(segment["level"]) + Fraction(by))


LIES: dict[str, Change] = {
    "lower too late": lambda d: d["claim"].update(lower=written(number(d["claim"]["lower"]) * Fraction("1.0001"))),
    "upper too early": lambda d: d["claim"].update(upper=written(number(d["claim"]["upper"]) * Fraction("0.99999"))),
    "level moved": lambda d: _level(d, "-0.001"),
    "level beyond": lambda d: _level(d, "0.001"),
    "tolerance halved": lambda d: d["task"]["box"].update(tolerance="0.01"),
    "tolerance doubled": lambda d: d["task"]["box"].update(tolerance="0.04"),
    "no tolerance": lambda d: d["task"]["box"].update(tolerance="0"),
    "another plant": lambda d: d["task"]["schedule"]["members"][1]["C"][-1].__setitem__(2, "9"),
    "another nominal plant": lambda d: d["task"]["schedule"]["members"][0]["C"][-1].__setitem__(2, "9"),
    "another nominal plant, twice": lambda d: [
        which["C"][-1].__setitem__(2, "9") for which in (d["task"]["schedule"], d["task"]["schedule"]["members"][0])
    ],
    "a plant twice": lambda d: d["task"]["schedule"]["members"].append(d["task"]["schedule"]["members"][0]),
    "no plants": lambda d: d["task"]["schedule"].update(members=[]),
    "no nominal plant": lambda d: d["task"]["schedule"]["members"].pop(0),
    "no box": lambda d: d["task"].update(box=None),
    "a place outside": lambda d: d["task"]["schedule"]["members"][1].update(place=["0.5"]),
    "a final tolerance": lambda d: d["task"]["box"].update(final_tolerance="1"),
    "fuel": lambda d: d["task"]["limits"].update(fuel="100"),
    "an unknown": lambda d: d["upper"].update(free=[["time", 0, 0]]),
    "no samples": lambda d: d["lower"].update(samples=[]),
    "a sample elsewhere": lambda d: d["lower"]["samples"][0].update(place=["0.95"]),
    "prices turned": lambda d: [
        c.update(upper=c["lower"], lower=c["upper"]) for sample in d["lower"]["samples"] for c in sample["residual"]
    ],
    "prices too low": lambda d: [c.update(upper="0") for sample in d["lower"]["samples"] for c in sample["residual"]],
    "a costate of all states": lambda d: d["lower"]["costate"][0][0].update(coefficients=[["1", "0"]] * 4),
    "a complex costate": lambda d: d["lower"]["costate"][0][0].update(coefficients=[["1", "1"]] * 2),
}


@pytest.mark.parametrize("name", first(8, LIES))
def test_lies_are_not_believed(name: str) -> None:
    content = found().certificate
    assert content is not None
    assert check(changed(content, LIES[name])).outcome in (Outcome.REFUTED, Outcome.INCONCLUSIVE, Outcome.MALFORMED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_no_corrupted_claim_is_believed(seed: int) -> None:
    """A side claimed better than its bracket allows, by a witness that is changed somewhere."""
    bound, rng = found(), np.random.default_rng([7, seed])
    assert bound.certificate is not None

    def corrupt(data: dict[str, Any]) -> None:
        which = "lower" if seed % 2 else "upper"
        factor = Fraction("1.00001") if which == "lower" else Fraction("0.99999")
        data["claim"][which] = written(number(data["claim"][which]) * factor)
        if which == "upper":
            data["upper"]["maneuver_time"] = data["claim"]["upper"]
            segments = data["upper"]["segments"]
            segment = segments[int(rng.integers(len(segments)))]
            segment["level"] = written(number(segment["level"]) * Fraction(float(rng.uniform(0.5, 1.0))))
        else:
            sample = data["lower"]["samples"][int(rng.integers(len(data["lower"]["samples"])))]
            for contact in sample["residual"]:
                contact["upper"] = written(number(contact["upper"]) * Fraction(float(rng.uniform(0.5, 2.0))))

    assert check(changed(bound.certificate, corrupt)).outcome is not Outcome.PROVED


@pytest.mark.slow
def test_nested_boxes_are_ordered() -> None:
    bounds = [found(scales) for scales in ((), ("0.9",), ("0.9", "1.1"), ("0.9", "1.1", "0.8", "1.2"))]
    assert all(a.upper is not None and a.lower <= (b.upper or 0.0) for a, b in pairwise(bounds))
    assert [bound.lower for bound in bounds] == sorted(bound.lower for bound in bounds)
    tighter = [found(("0.9",), tolerance).lower for tolerance in ("0.04", "0.02", "0.005")]
    assert tighter == sorted(tighter)
    nominal = minimum_time(varying_problem(hoisting("1"), MOVE))
    assert found((), "0.0001").lower <= nominal.lower
    assert found((), "0.0001").lower == pytest.approx(nominal.lower, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("scales", [(), ("0.9",), ("0.9", "1.1")])
def test_a_schedule_that_does_not_vary_is_the_constant_box(scales: tuple[str, ...]) -> None:
    bound, asked = found(scales, last="5"), box(scales, last="5")
    listed = tuple((place, LinearPlant.from_state_space(plant.A[0], plant.B[0], plant.C[0])) for place, plant in asked.members)
    constant = minimum_time(
        problem(
            [LinearPlant.from_state_space(hoisting("1", "5").A[0], hoisting("1", "5").B[0], hoisting("1", "5").C[0])],
            Maneuver(Fraction(3), Limits.of(-1, 1), box=Box(asked.axes, Listed(listed), asked.tolerance)),
        )
    )
    assert constant.upper is not None
    assert bound.upper is not None
    assert bound.lower <= constant.upper
    assert constant.lower <= bound.upper


@pytest.mark.parametrize(
    ("maneuver", "words"),
    [
        (Maneuver(Fraction(3), Limits.of(-1, 1, 4)), "input only"),
        (Maneuver(Fraction(3), Limits.of(-1, 1), sample_time=Fraction(1, 10)), "input only"),
        (Maneuver(Fraction(3), Limits.of(-1, 1), tail=True), "tail"),
        (Maneuver(Fraction(0), Limits.of(-1, 1)), "nothing to move"),
    ],
)
def test_what_does_not_go_with_such_a_box_is_refused(maneuver: Maneuver, words: str) -> None:
    with pytest.raises(ManeuverError, match=words):
        varying_box_time(box(()), maneuver)


def test_boxes_that_are_none_are_refused() -> None:
    axis, plant = (Axis("scale", ONE, ONE, ONE),), hoisting("1")
    with pytest.raises(ManeuverError, match="more than 0"):
        VaryingBox(axis, (((ONE,), plant),), Fraction(0))
    with pytest.raises(ManeuverError, match="different places"):
        VaryingBox(axis, (((ONE,), plant), ((ONE,), plant)), ONE)
    with pytest.raises(ManeuverError, match="different places"):
        VaryingBox(axis, (((Fraction(2),), plant),), ONE)
    with pytest.raises(ManeuverError, match="same instants"):
        VaryingBox((Axis("scale", ONE, ONE, Fraction(2)),), (((ONE,), plant), ((Fraction(2),), crane({"0": "5", "4": "3"}))), ONE)
    # springs of other stiffness are held elsewhere by the same input; a plant with friction shares no body
    springs = [VaryingPlant.of([0, 1], [[[0, 1], [-k, "-0.1"]]] * 2, [[0, 1]] * 2, [[1, 0]] * 2) for k in (1, 2)]
    with pytest.raises(ManeuverError, match="final input"):
        varying_box_time(VaryingBox((Axis("k", ONE, ONE, Fraction(2)),), (((ONE,), springs[0]), ((Fraction(2),), springs[1])), ONE), MANY)
    dragged = VaryingPlant.of([0, 1], [[[0, 1], [0, -1]], [[0, 1], [0, -2]]], [[0, 1]] * 2, [[1, 0]] * 2)
    with pytest.raises(ManeuverError, match="pole at the origin"):
        varying_box_time(VaryingBox(axis, (((ONE,), dragged),), Fraction(1, 10)), MANY)


MANY = Maneuver(Fraction(1, 2), Limits.of(-3, 3))


@pytest.mark.slow
def test_plants_without_bodies() -> None:
    """Damped servos whose stiffness and drive rise together: no equation is exact, and the residual decays."""

    def servo(k: Fraction) -> VaryingPlant:
        A = [[[0, 1], [-k * s, Fraction(-1, 5)]] for s in (1, 4)]
        return VaryingPlant.of([0, 2], A, [[0, k * s] for s in (1, 4)], [[1, 0]] * 2)

    values = [ONE, Fraction(9, 10), Fraction(11, 10)]
    asked = VaryingBox((Axis("k", ONE, values[1], values[2]),), tuple(((k,), servo(k)) for k in values), Fraction(1, 50))
    bound = varying_box_time(asked, Maneuver(Fraction(1), Limits.of(-2, 2)))
    assert bound.status is Status.PROVED, bound.reason
    assert bound.gap is not None
    assert bound.gap <= 1e-4
    assert bound.certificate is not None
    assert opened(bound.certificate)["lower"]["costate"] == [[{"near": ["0", "0"], "coefficients": []}]]
