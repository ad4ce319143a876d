"""Least fuel at a given time, and fuel weighted against time: digits of the literature, certificates, and what a check does not say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import pi, sqrt

import numpy as np
import pytest
from independent_limits import Limited
from marks import slow
from problems import transfer

from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.onoff.spent import fuel_at
from relaxations.onoff.weights import extremal_prices, weighted
from relaxations.plants import exact
from relaxations.proofs import minimum_time

SPRING = transfer([1], [1, 0, 2, 0, 0])
OMEGA, MASS = sqrt(2), 2.0


def posed(displacement: float, fuel: str | None = None, robustness: int = 0) -> Problem:
    return problem([SPRING()], Maneuver(exact(str(displacement)), Limits.of(-1, 1, fuel), robustness=robustness))


def node(displacement: float, number: int) -> Command:
    """Two pulses a number of periods apart: equation (33) of Singhose, Singh and Seering (1999), mended."""
    fuel, second = MASS * OMEGA * displacement / (number * pi), 2 * pi * number / OMEGA
    return Command(second + fuel / 2, (Segment(0.0, 1.0), Segment(fuel / 2, 0.0), Segment(second, -1.0)), Tail(0.0))


# Budgets and minimum times of the fuel-limited two-mass spring: the least fuel at that time is the budget.
@pytest.mark.parametrize(("time", "robustness", "fuel"), [(8.1107317945, 0, 4.0), (9.2461624729, 1, 3.5)])
def test_the_least_fuel_at_a_time_is_the_budget_of_that_minimum_time(time: float, robustness: int, fuel: float) -> None:
    found = fuel_at(posed(5.0, robustness=robustness), time)
    assert found.lower is not None
    assert found.upper is not None
    # ten digits of the time are given; fuel changes less than twice as fast
    assert float(found.lower) <= fuel + 2e-10
    assert float(found.upper) >= fuel - 2e-10
    assert float(found.upper / found.lower) - 1.0 <= 3e-9
    assert found.below is not None
    assert found.above is not None
    for side in (found.below, found.above):
        assert side.certificate is not None
        assert check(side.certificate).outcome is Outcome.PROVED
    assert found.below.lower >= time  # within less fuel nothing is as fast
    assert found.command is not None
    assert found.command.maneuver_time <= time
    assert found.command.fuel() <= float(found.upper) * (1 + 1e-12)


def test_an_independent_program_knows_no_less_fuel() -> None:
    # Staircases are commands: with less fuel than the lower side none of them reaches the target (state space, HiGHS).
    found = fuel_at(posed(5.0), 8.5)
    assert found.lower is not None
    assert found.upper is not None
    less, more = (Limited(SPRING(), 5.0, -1.0, 1.0, fuel=float(fuel)) for fuel in (found.lower * Fraction(9999, 10000), found.upper * 1))
    assert less.fraction(8.5, 120) < 1.0
    assert more.fraction(8.55, 240) > 1.0


@pytest.mark.slow
def test_more_time_never_burns_more_and_a_short_time_is_refused() -> None:
    times = [6.7, 7.5, 9.0, 12.0]
    burnt = [fuel_at(posed(5.0), time).computed for time in times]
    assert all(np.diff(burnt) <= 1e-9)
    with pytest.raises(ManeuverError, match=r"whatever the fuel: the minimum time is at least 6\.66"):
        fuel_at(posed(5.0), 6.0)


# The price from which on one pair of pulses is extremal; the digits of an evaluation by other means are 0.6825 and 0.03083.
@pytest.mark.parametrize(("displacement", "price"), [(1.0, 0.68241), (5.0, 0.030823)])
def test_the_critical_price_of_a_node(displacement: float, price: float) -> None:
    prices = extremal_prices(posed(displacement), node(displacement, 1))
    assert prices is not None
    assert prices[0] == pytest.approx(price, rel=3e-5)  # of a costate looked at in 4000 places
    assert prices[1] > prices[0]


def test_further_moves_have_smaller_critical_prices() -> None:
    prices = [extremal_prices(posed(displacement), node(displacement, 1)) for displacement in (1.0, 2.0, 3.0, 4.0, 5.0)]
    assert all(one is not None and other is not None and other[0] < one[0] for one, other in pairwise(prices))


def test_between_nodes_a_command_is_extremal_for_one_price_and_costs_more_than_its_neighbours() -> None:
    commands = {fuel: minimum_time(posed(5.0, fuel)) for fuel in ("3.9", "4", "4.1")}
    middle = commands["4"].command
    assert middle is not None
    prices = extremal_prices(posed(5.0), middle)
    assert prices is not None
    assert prices[1] - prices[0] <= 1e-6
    costs = {fuel: bound.lower + prices[0] * float(fuel) for fuel, bound in commands.items()}
    assert costs["4"] > max(costs["3.9"], costs["4.1"])  # so it minimises nothing


def test_a_command_with_other_switches_is_extremal_for_no_price() -> None:
    wrong = Command(7.0, (Segment(0.0, 1.0), Segment(1.0, 0.0), Segment(1.1, 1.0), Segment(3.0, 0.0), Segment(5.5, -1.0)), Tail(0.0))
    assert extremal_prices(posed(5.0), wrong) is None


def rigid(displacement: str, lower: int, upper: int) -> Problem:
    return problem([transfer([1], [1, 0, 0])()], Maneuver(exact(displacement), Limits.of(lower, upper)))


# One mass: a pulse, a coast, a pulse. With the speed v between them T = d/v + v (1/a + 1/b)/2, and the fuel is 2 v.
@pytest.mark.parametrize(("displacement", "lower", "upper", "price"), [slow("1", -1, 2, "1"), ("5", -1, 1, "0.25"), slow("-3", -2, 1, "4")])
def test_a_mass_has_its_least_cost_in_closed_form(displacement: str, lower: int, upper: int, price: str) -> None:
    found = weighted(rigid(displacement, lower, upper), Fraction(price))
    cost = 2.0 * sqrt(abs(float(displacement)) * ((1 / upper - 1 / lower) / 2 + 2 * float(price)))
    assert found.lower is not None
    assert found.upper is not None
    assert found.lower <= cost * (1 + 1e-15)
    assert found.upper >= cost * (1 - 1e-15)
    assert found.gap is not None
    assert found.gap <= 1.1e-9
    assert found.extremal
    assert found.certificate is not None
    checked = check(found.certificate)
    assert checked.outcome is Outcome.PROVED
    assert checked.to_dict()["price"] == price
    assert checked.to_dict()["maneuver_time"] is None  # nothing is said of the time


@pytest.mark.slow
def test_an_independent_program_knows_no_cheaper_command() -> None:
    # Staircases are commands: at every T the least fuel of one (state space, HiGHS) costs what the lower side says or more.
    found = weighted(posed(1.0), Fraction(1, 2))
    assert found.lower is not None
    assert found.upper is not None
    costs = []
    for time in (4.4, 4.6, found.command.maneuver_time, 4.9, 5.3):
        limited = Limited(SPRING(), 1.0, -1.0, 1.0)
        fuel = least(limited, time, 120)
        costs.append(time + 0.5 * fuel)
    assert min(costs) >= found.lower
    assert costs[2] <= found.upper * (1 + 1e-3)  # as close as the grid is
    assert found.upper <= found.lower * (1 + 1.1e-9)


def least(limited: Limited, time: float, cells: int) -> float:
    """The least fuel of a staircase, by halving what it may burn."""
    low, high = 0.0, time
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (low, middle) if replace(limited, fuel=middle).fraction(time, cells) >= 1.0 else (middle, high)
    return high


@pytest.mark.slow
@pytest.mark.parametrize(("price", "number"), [("0.5", 1), ("3", 2), ("0.1", 1)])
def test_the_weighted_cost_is_bracketed_at_its_nodes(price: str, number: int) -> None:
    found = weighted(posed(5.0), Fraction(price))
    best = node(5.0, number)
    cost = best.maneuver_time + float(price) * best.fuel()
    assert found.lower is not None
    assert found.upper is not None
    assert found.lower <= cost * (1 + 1e-15)
    assert cost * (1 - 1e-15) <= found.upper
    assert found.upper / found.lower - 1.0 <= 1e-6  # the command is repaired there, and the costates are not unique
    assert found.extremal
    four = minimum_time(posed(5.0, "4"))
    assert found.minimises(four.lower + float(price) * 4.0) is False
    assert found.minimises(found.upper) is True
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED


@pytest.mark.parametrize("price", ["0", "-1"])
def test_a_price_that_is_none_is_refused(price: str) -> None:
    with pytest.raises(ManeuverError, match="more than 0"):
        weighted(posed(5.0), Fraction(price))


@pytest.mark.parametrize(
    "asked",
    [
        lambda: problem([SPRING()], Maneuver(exact("5"), Limits.of(-1, 1, None, {}, ("-1", "1")))),
        lambda: problem([SPRING()], Maneuver(exact("5"), replace(Limits.of(-1, 1), held=1))),
        lambda: problem([SPRING()], Maneuver(exact("5"), Limits.of(-1, 1), sample_time=Fraction(1, 4))),
        lambda: problem([transfer([1], [1, 0, 1])()], Maneuver(exact("0.5"), Limits.of(-1, 1))),
    ],
)
def test_other_tasks_have_no_weighted_cost(asked: Callable[[], Problem]) -> None:
    with pytest.raises(ManeuverError):
        weighted(asked(), Fraction(1, 2))


@pytest.mark.slow
def test_between_nodes_the_price_is_met_exactly() -> None:
    # Insensitive to the stiffness, a command between two nodes may be a minimiser: its thinnest coast lasts 0.03 s.

    found = weighted(posed(5.0, robustness=1), Fraction(1, 20))
    assert found.upper == pytest.approx(7.97841289689, abs=6e-12)
    assert found.gap is not None
    assert found.gap <= 1.1e-9
    assert found.extremal
    assert found.prices == pytest.approx((0.05, 0.05), rel=2e-7)  # the secant ends at 1e-7, the interval is as wide as SLACK
