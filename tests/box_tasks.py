"""Boxes of plants for tests, and what a command leaves of the move in one of them, by ways that share nothing with the proof."""

from __future__ import annotations

import hashlib
import json
from fractions import Fraction
from typing import Any

import numpy as np
import rfc8785
from independent import StateSpace
from problems import chain
from proving import found_once

from fmus.twins import linear_plant, read_twin, twin_family
from relaxations.bounds import Bound
from relaxations.checking.claims import Outcome, check
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.robust import moved
from relaxations.robust.boxes import Axis, Box, Family, Listed

TWIN = """
input = "force"
states = ["x1", "v1", "x2", "v2"]
A = [
    ["0", "1", "0", "0"],
    ["-stiffness / mass_1", "-damping / mass_1", "stiffness / mass_1", "damping / mass_1"],
    ["0", "0", "0", "1"],
    ["stiffness / mass_2", "damping / mass_2", "-stiffness / mass_2", "-damping / mass_2"],
]
B = ["0", "1 / mass_1", "0", "0"]

[parameters]
mass_1 = "1"
mass_2 = "1"
stiffness = "1"
damping = "0"

[outputs]
x2 = { C = ["0", "0", "1", "0"], D = "0" }
"""


def axis(name: str, width: str, nominal: str = "1") -> Axis:
    middle = Fraction(nominal)
    return Axis(name, middle, middle * (1 - Fraction(width)), middle * (1 + Fraction(width)))


def robust(displacement: str, tolerance: str, *axes: Axis, damping: str = "0") -> Bound:
    family = twin_family(TWIN, "x2", [a.name for a in axes], {"damping": damping})
    maneuver = Maneuver(Fraction(displacement), Limits.of(-1, 1), box=Box(axes, family, Fraction(tolerance)))
    return minimum_time(problem([family.member([a.nominal for a in axes])], maneuver))


def residual(bound: Bound, displacement: float, **parameters: float) -> float:
    """By simulation in closed form, which shares nothing with the proof: the peak of |y - y(∞)| over 40 s after the move."""
    plant = linear_plant(read_twin(TWIN, {name: repr(value) for name, value in parameters.items()}), "x2")
    assert bound.command is not None
    times = bound.command.maneuver_time + np.linspace(0.0, 40.0, 8001)
    course = response(plant, bound.command, times)
    resting = (course.max() + course.min()) / 2  # undamped: the middle of the oscillation
    return float(np.abs(course - resting).max()) / displacement


def transfer(names: list[str], numerator: list[dict[tuple[int, ...], Any]], denominator: list[dict[tuple[int, ...], Any]]) -> Family:
    """A family from its coefficients, highest power of s first, as factors by the powers of the parameters."""
    assert all(len(powers) == len(names) for terms in (*numerator, *denominator) for powers in terms)
    upper, lower = (tuple(tuple((Fraction(c), p) for p, c in terms.items()) for terms in which) for which in (numerator, denominator))
    return Family(upper, lower)


Ranges = tuple[tuple[str, str, str], ...]  # parameter, lower and upper end
ONE, K = {(0,): 1}, {(1,): 1}
SPRING = transfer(["k"], [ONE], [ONE, {}, K])  # 1/(s² + k)
SERVO = transfer(["k"], [K], [ONE, {}, K])  # k/(s² + k): its static gain is 1 everywhere
LAG = transfer(["k"], [K], [ONE, K])
MASS = transfer(["m"], [ONE], [{(1,): 1}, {}, {}])
TOW = transfer(["k"], [ONE], [ONE, {(0,): "0.2"}, K])


def fastest(family: Family | Listed, *axes: Axis, displacement: str = "0.5", tolerance: str = "0.05", final: str | None = None) -> Bound:
    box = Box(axes, family, Fraction(tolerance), final_tolerance=None if final is None else Fraction(final))
    plant = family.member([a.nominal for a in axes])
    return found_once(problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1), box=box)))


def upper_of(bound: Bound) -> float:
    assert bound.upper is not None
    return bound.upper


def left(bound: Bound, plant: LinearPlant, displacement: float, window: float = 60.0) -> tuple[float, float]:
    """By state space and matrix exponentials alone: the peak of |y - y(∞)| after the move, and |y(∞) - Δ|, both over |Δ|."""
    assert bound.command is not None
    space = StateSpace.of(plant)
    hold = float(bound.command(bound.command.end + 1.0))
    rest = float(space.C @ np.linalg.solve(-space.A, space.B)) * hold + space.D * hold
    starts = np.array([segment.start for segment in bound.command.segments])
    state = np.zeros(len(space.B))
    for segment, width in zip(bound.command.segments, np.diff([*starts, bound.command.end]), strict=True):
        transition, constant, _ = space.step(width)
        state = transition @ state + constant * segment.level
    transition, constant, _ = space.step(window / 1500)
    course = []
    for _ in range(1501):
        course.append(space.C @ state + space.D * hold)
        state = transition @ state + constant * hold
    return float(np.abs(np.array(course) - rest).max()) / displacement, abs(rest - displacement) / displacement


def forged(content: bytes, change: Any) -> Outcome:
    data = json.loads(content)
    change(data)
    data.pop("digest")
    return check(rfc8785.dumps({**data, "digest": hashlib.sha256(rfc8785.dumps(data)).hexdigest()})).outcome


TWO_MASS = LinearPlant.from_transfer([1], [1, 0, 2, 0, 0])
BLOCK = LinearPlant.from_transfer([1], [1, "0.2", 1])
CART = LinearPlant.from_transfer([1, 2], [1, "0.4", 2, 0])
LAGGED = LinearPlant.from_transfer([4], [1, "2.4", "1.8", 4])  # a real pole and a mode whose roots are no fractions
PLANTS = {"spring": TWO_MASS, "block": BLOCK, "cart": CART, "lagged": LAGGED, "chain": chain(3), "chain of four": chain(4)}
FREQUENCY: Ranges = (("mode[1].frequency", "0.9", "1.1"),)
DAMPING: Ranges = (("mode[1].damping", "0", "0.2"),)
ZERO: Ranges = (("zero[1]", "0.8", "1.25"),)


def tolerant(name: str, ranges: Ranges, displacement: str, tolerance: str = "0.05", final: str | None = None) -> Bound:
    plant = PLANTS[name]
    axes = tuple(moved.axis(plant, name, Fraction(low), Fraction(high)) for name, low, high in ranges)
    box = Box(axes, moved.moved(plant, axes), Fraction(tolerance), final_tolerance=None if final is None else Fraction(final))
    return found_once(problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1), box=box)))
