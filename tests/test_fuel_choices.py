"""Prudent budgets: knees of sampled curves, nodes and α_crit in closed form and against another program, the least fuel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from relaxations.bounds import Bound, Status
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.shaping.sensitivity import residual
from relaxations.spending import least_fuel
from relaxations.transition_fuels import farthest, nodes, reason_against
from suite.fuel_records import Curve, Kind, Point
from suite.fuel_weights import critical_weight


def curve_of(times: Sequence[tuple[float, float]]) -> Curve:
    def bound(time: float) -> Bound:
        return Bound(Status.PROVED, time, time, np.zeros(0), None, None, None, 0, 0.0)

    points = tuple(Point(exact(fuel), bound(time)) for fuel, time in times)
    return Curve(Kind("zv", 0), cast(Any, SimpleNamespace()), points[-1], points)


def test_knees_are_where_less_fuel_suddenly_costs_more() -> None:
    fuels = [round(1 + 0.05 * i, 2) for i in range(101)]
    rigid = curve_of([(u, 20 / u + u / 2) for u in fuels])
    assert rigid.knees == ()  # it bends the more the less fuel there is
    bent = curve_of([(u, 20 / u + u / 2 + 2 * max(3.0 - u, 0.0) ** 0.5) for u in fuels])
    assert [float(knee.fuel) for knee in bent.knees] == [3.0]
    many = curve_of([(u, 20 / u + u / 2 + sum(2 * max(at - u, 0.0) ** 0.5 for at in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0))) for u in fuels])
    assert len(many.knees) == 4  # the clearest ones, from more fuel to less
    assert all(a.fuel > b.fuel for a, b in pairwise(many.knees))


@pytest.mark.parametrize("seed", range(5))
def test_nodes_are_commands_of_two_pulses_that_leave_nothing(seed: int) -> None:
    """Checked against the residual of their four impulses, and the double integral of two pulses."""
    rng = np.random.default_rng([2026, seed])
    omega, mass, distance, limit = (exact(f"{x:.3g}") for x in rng.uniform(0.5, 4.0, 4))
    plant = LinearPlant.from_modes(1 / mass, [(omega, 0, exact(f"{rng.uniform(-2, 2):.3g}"))])
    posed = problem([plant], Maneuver(distance, Limits.of(-limit, limit)))
    found = nodes(posed, 0.0, math.inf)
    assert reason_against(posed) is None
    for node in found:
        width = node.fuel / (2 * float(limit))
        times = [0.0, width, node.second, node.second + width]
        assert times[-1] == pytest.approx(node.maneuver_time, rel=1e-14)
        assert width <= node.second * (1 + 1e-12)
        assert float(residual(times, [1, -1, -1, 1], float(omega), 0.0)[0]) <= 1e-12 * node.number
        assert float(limit) * width * node.second / float(mass) == pytest.approx(float(distance), rel=1e-13)
        assert node.fuel == pytest.approx(float(mass * omega * distance) / (node.number * math.pi), rel=1e-14)
    assert len(found) == 50 or found == ()


@pytest.mark.parametrize(
    ("plant", "limits", "words"),
    [
        (LinearPlant.from_modes(1, [(1, "0.01", 1)]), ("-1", "1"), "no damping, not 0.01"),
        (LinearPlant.from_modes(1, [(1, 0, 1), (2, 0, 1)]), ("-1", "1"), "one flexible mode, not 2"),
        (LinearPlant.from_modes(1, [(1, 0, 1)]), ("-1", "2"), "as far from the input at rest on both sides"),
        (LinearPlant.from_transfer([1], [1, 1, 1, 0]), ("-1", "1"), "a mass"),
    ],
)
def test_where_there_is_no_closed_form_it_says_why(plant: LinearPlant, limits: tuple[str, str], words: str) -> None:
    posed = problem([plant], Maneuver(Fraction(1), Limits.of(*limits)))
    assert words in (reason_against(posed) or "")
    assert nodes(posed, 0.0, 9.0) == ()


@pytest.mark.parametrize(("displacement", "alpha"), [("5", 0.0308234664), ("1", 0.6824116224)])
def test_from_what_weight_on_the_first_node_is_best(displacement: str, alpha: float) -> None:
    """The digits are those of a linear program in the costate's coefficients at 160,000 instants: the least α for which it switches as the
    command does, the dead zone included, with H = 0 at the beginning."""
    posed = problem([LinearPlant.from_transfer([1], [1, 0, 2, 0, 0])], Maneuver(exact(displacement), Limits.of(-1, 1)))
    found = critical_weight(posed)
    assert found is not None
    assert found.alpha == pytest.approx(alpha, rel=1e-7)


def test_there_is_a_first_node_until_the_pulses_meet() -> None:
    plant = LinearPlant.from_transfer([1], [1, 0, 2, 0, 0])
    posed = problem([plant], Maneuver(Fraction(5), Limits.of(-1, 1)))
    assert float(farthest(posed) or 0) == pytest.approx(math.pi**2, rel=1e-14)  # two pulses of a whole period each
    for displacement, first in (("9.86", 1), ("9.88", 2)):
        beyond = problem([plant], Maneuver(exact(displacement), Limits.of(-1, 1)))
        assert nodes(beyond, 0.0, math.inf)[0].number == first
    assert critical_weight(problem([plant], Maneuver(exact("9.88"), Limits.of(-1, 1)))) is None


def test_the_least_fuel() -> None:
    lag = problem([LinearPlant.from_transfer([1], [1, 1, 0])], Maneuver(Fraction(3), Limits.of(-1, 1)))
    assert least_fuel(lag) == pytest.approx(3.0, rel=1e-6)  # ∫u adds up to the displacement
    mass = problem([LinearPlant.from_transfer([1], [1, 0, 0])], Maneuver(Fraction(3), Limits.of(-1, 1)))
    assert least_fuel(mass) is None  # the less, the longer it takes
