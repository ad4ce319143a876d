"""Lower sides of commands of pulses: known minimum times, an integer program, the inequality by quadrature, lies; one mirrored command."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from math import pi, sqrt
from typing import Any

import flint
import numpy as np
import pytest
from flint import fmpq
from forgery import forged, opened
from marks import first, slow
from scipy.optimize import LinearConstraint, milp

from relaxations import certificates
from relaxations.bounds import Bound, Status
from relaxations.checking import lower, pulses
from relaxations.checking.balls import System, system, work
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import LEAF, TASK, shaped
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time

INTEGRATOR, RIGID, TWO_MASS = (1, 0), (1, 0, 0), (1, 0, 2, 0, 0)  # denominators
PERIOD = sqrt(2.0) * pi


def posed(
    denominator: tuple[int, ...], displacement: str, width: str | None, count: int | None = None, lowest: str = "-1", highest: str = "1"
) -> Problem:
    limits = Limits(Fraction(lowest), Fraction(highest), None, None if width is None else Fraction(width), count)
    return problem([LinearPlant.from_transfer([1], list(denominator))], Maneuver(Fraction(displacement), limits))


@cache
def found(*asked: Any) -> Bound:
    return minimum_time(posed(*asked))


def content(*asked: Any) -> bytes:
    written = found(*asked).certificate
    assert written is not None
    return written


@pytest.mark.parametrize(
    ("asked", "known"),
    [
        slow((TWO_MASS, "5", None, 2), PERIOD + 10.0 / PERIOD),  # two pulses one period apart: three instants, four equations
        slow((RIGID, "1", "1.1"), 2 * 1.1 + 2 * sqrt(1 + 1.1**2)),  # back, forth and back
        slow((INTEGRATOR, "1", "1.5"), 4.0),  # 2.5 s forth, 1.5 s back
        ((INTEGRATOR, "1", "0.8", None, "-1", "2"), 1.7),  # 0.9 s at 2, 0.8 s back
    ],
)
def test_known_minimum_times_of_pulses_are_bracketed(asked: tuple[Any, ...], known: float) -> None:
    bound = found(*asked)
    assert bound.status is Status.PROVED
    assert bound.upper is not None
    assert bound.lower <= known <= bound.upper * (1 + 1e-15)
    assert bound.upper == pytest.approx(known, rel=1e-7)  # a hair of 1e-8 is kept
    assert bound.upper / bound.lower - 1 <= 1.01e-4
    assert check(content(*asked)).outcome is Outcome.PROVED
    assert "The lower side is that of such pulses." in claim(check(content(*asked)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "gap"),
    [
        ((TWO_MASS, "5", "0.8"), 1.01e-4),
        ((TWO_MASS, "5", "1"), 1.01e-4),
        ((TWO_MASS, "5", "0.9", None, "-1", "2"), 1.01e-4),
        ((TWO_MASS, "5", None, 3), 1.01e-4),
    ],
)
def test_two_masses_on_thrusters_to_four_digits(asked: tuple[Any, ...], gap: float) -> None:
    bound = found(*asked)
    assert bound.upper is not None
    assert bound.upper / bound.lower - 1 <= gap


def integer_time(displacement: int, width: int, step: Fraction) -> int:
    """The fewest samples in which pulses of at least `width` samples move 1/s² by `displacement` step²: an integer program each."""
    for count in range(1, 200):
        # variables: up (count), down (count), begins of ups and downs
        weights = np.arange(count - 1, -1, -1) + 0.5
        rows = [
            np.concatenate([np.ones(count), -np.ones(count), np.zeros(2 * count)]),
            np.concatenate([weights, -weights, np.zeros(2 * count)]),
        ]
        met: Any = np.array([0.0, displacement])
        constraints = [LinearConstraint(np.array(rows), met, met)]
        both = np.hstack([np.eye(count), np.eye(count), np.zeros((count, 2 * count))])
        constraints.append(LinearConstraint(both, -np.inf, 1.0))
        for side in range(2):
            starts = np.zeros((count, 4 * count))
            on, begun = side * count, (2 + side) * count
            for k in range(count):  # what is on and was not has begun, and stays on
                starts[k, on + k], starts[k, begun + k] = 1.0, -1.0
                if k:
                    starts[k, on + k - 1] = -1.0
            constraints.append(LinearConstraint(starts, -np.inf, 0.0))
            for k in range(count):
                if k + width > count:
                    row = np.zeros((1, 4 * count))
                    row[0, begun + k] = 1.0
                    constraints.append(LinearConstraint(row, 0.0, 0.0))
                for later in range(k, min(k + width, count)):
                    row = np.zeros((1, 4 * count))
                    row[0, begun + k], row[0, on + later] = 1.0, -1.0
                    constraints.append(LinearConstraint(row, -np.inf, 0.0))
        if milp(np.zeros(4 * count), integrality=np.ones(4 * count), bounds=(0, 1), constraints=constraints).status == 0:
            return count
    raise AssertionError("no command was found")


@pytest.mark.slow
@pytest.mark.parametrize(("displacement", "width"), [(9, 4), (16, 5), (7, 3), (12, 6), (5, 4)])
def test_no_integer_program_is_faster_than_the_lower_side(displacement: int, width: int) -> None:
    """Pulses whose edges are on a grid are some of all pulses."""
    step = Fraction(1, 4)
    bound = found(RIGID, str(displacement * step**2), str(width * step))
    assert bound.lower <= float(integer_time(displacement, width, step) * step) + 1e-12


def test_the_inequality_is_the_integral_that_quadrature_sees() -> None:
    """Random parts and multipliers of the two-mass spring: both sides in doubles, by midpoints."""
    rng, one = random.Random(3), posed(TWO_MASS, "5", "0.8")
    before, flint.ctx.prec, work["left"] = flint.ctx.prec, 128, 1e12
    try:
        own, time, seen = _system(one), Fraction(7), set[bool]()
        for _ in range(40):
            edges = sorted(Fraction(rng.randint(0, 700), 100) for _ in range(8))
            box = tuple(
                pulses.Range((_exact(a), _exact(b)), (_exact(c), _exact(d)), rng.choice([-1, 0, 1]))
                for a, b, c, d in (edges[:4], edges[4:])
            )
            costate = np.array([rng.uniform(-1, 1) for _ in range(4)]) * rng.choice([0.1, 1.0])
            widths = [rng.choice([0.0, rng.uniform(0, 1)]) for _ in range(2)]
            leaf = shaped(_leaf(one, costate, widths), LEAF, "leaf")
            s = (np.arange(200_000) + 0.5) * 7.0 / 200_000
            p = costate @ one.rows(s)
            values = np.zeros_like(s)
            for (a, b, c, d), part, price in zip((edges[:4], edges[4:]), box, widths, strict=True):
                own_line = np.max([u * p + price for u in (1, -1) if part.sign in (0, u)], axis=0)
                may, sure = (s > float(a)) & (s < float(d)), (s > float(b)) & (s < float(c))
                values = np.where(sure, own_line, np.where(may, np.maximum(values, own_line), values))
            # a later pulse's own part is not admitted where the first is certain: the parts follow one another
            margin = float(costate @ one.target) + 0.8 * sum(widths) - float(values.mean() * 7.0)
            if abs(margin) > 1e-4:  # quadrature is good for 1e-5
                assert pulses.refuted(own, box, leaf, _exact(time), lower.support) is (margin > 0)
                seen.add(margin > 0)
        assert seen == {True, False}
    finally:
        flint.ctx.prec = before


def _exact(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def _system(one: Problem) -> System:
    return system(shaped(certificates.task(one), TASK, "task"))


def _leaf(one: Problem, costate: Any, widths: list[float]) -> dict[str, Any]:
    written = certificates.costate_witness(one, costate)["costate"]
    return {"costate": written, "widths": [certificates.text(x) for x in widths], "fuel": "0"}


def _node(data: Any, what: str) -> Any:
    return next(node[what] for node in data["lower"]["pulses"] if node[what])


def _swapped(data: Any) -> None:
    nodes = data["lower"]["pulses"]
    places = [i for i, node in enumerate(nodes) if node["leaf"] and any(x != "0" for x in node["leaf"]["widths"])]
    nodes[places[0]], nodes[places[-1]] = nodes[places[-1]], nodes[places[0]]


LIES: dict[str, Callable[[Any], Any]] = {
    "a part left out": lambda data: data["lower"]["pulses"].pop(),
    "a part twice": lambda data: data["lower"]["pulses"].append(data["lower"]["pulses"][-1]),
    "no more splits": lambda data: data["lower"].update(pulses=[node for node in data["lower"]["pulses"] if node["leaf"]]),
    "one part for all": lambda data: data["lower"].update(pulses=[next(node for node in data["lower"]["pulses"][::-1] if node["leaf"])]),
    "parts that change places": _swapped,
    "narrower pulses": lambda data: data["task"]["limits"].update(pulse_width="0.9"),
    "another move": lambda data: data["task"].update(displacement="0.9"),
    "stronger thrusters": lambda data: data["task"]["limits"].update(input=["-1.2", "1.2"]),
    "a longer time": lambda data: data["claim"].update(lower="5.18"),
    "a split of a pulse that is not there": lambda data: _node(data, "split").update(pulse=7),
    "prices below 0": lambda data: _node(data, "leaf").update(fuel="-1"),
    "a price of fuel without a budget": lambda data: _node(data, "leaf").update(fuel="1"),
    "a node that does both": lambda data: data["lower"]["pulses"][-1].update(split={"pulse": 0, "edge": "end", "at": "1"}),
    "a start": lambda data: data["task"].update(initial_state=["0", "1"]),
}


@pytest.mark.parametrize("lie", first(4, LIES))
def test_lies_about_trees_are_not_believed(lie: str) -> None:
    data = opened(content(RIGID, "1", "1.1"))
    data["claim"]["upper"], data["upper"] = None, None
    assert check(forged(data)).outcome is Outcome.PROVED
    LIES[lie](data)
    assert check(forged(data)).outcome is not Outcome.PROVED


@pytest.mark.slow
def test_no_changed_trees_prove_more_than_the_truth() -> None:
    """A claim above the minimum time, with trees that are changed at random: never proven."""
    rng, data = random.Random(11), opened(content(TWO_MASS, "5", None, 2))
    data["claim"] = {"lower": "6.694", "upper": None, "impossible": None}  # the truth is 6.69367
    data["upper"] = None
    for _ in range(12):
        lie = json.loads(json.dumps(data))
        nodes = lie["lower"]["pulses"]
        for _ in range(rng.randint(1, 3)):
            node = rng.choice(nodes)
            if node["split"]:
                node["split"].update(at=str(rng.randint(0, 7)), edge=rng.choice(["begin", "end"]), pulse=rng.randint(0, 1))
            else:
                node["leaf"]["costate"] = rng.choice([other for other in nodes if other["leaf"]])["leaf"]["costate"]
        assert check(forged(lie)).outcome is not Outcome.PROVED


def test_the_balls_of_a_mirrored_command_hold_for_the_whole_of_it() -> None:
    """Against the exact answer: three instants of two unknowns."""
    data = opened(content(TWO_MASS, "5", None, 2))
    assert data["upper"]["mirrored"] is True
    starts = [
        Fraction(float.fromhex(segment["start"])) if "x" in segment["start"] else Fraction(segment["start"])
        for segment in data["upper"]["segments"]
    ]
    assert [float(x) for x in starts] == pytest.approx([0.0, 10.0 / PERIOD, PERIOD], abs=1e-12)
