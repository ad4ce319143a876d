"""A budget of fuel: minimum times known from the literature, both sides proven; what it may not be; lies about it."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import exp, log
from typing import Any

import numpy as np
import proving
import pytest
from forgery import certificate, changed, costate, number, task, written
from independent_limits import Limited
from marks import first
from problems import transfer

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import LIMITED, REGULAR, minimum_time

PLANTS = {"spring": transfer([1], [1, 0, 2, 0, 0]), "rigid": transfer([1], [1, 0, 0]), "lag": transfer([1], [1, 1, 0])}
SPRING, RIGID, LAG = PLANTS


@cache
def bound(plant: str, displacement: str, fuel: str | None, lower: str = "-1", upper: str = "1", robustness: int = 0) -> Bound:
    return minimum_time(problem([PLANTS[plant]()], Maneuver(exact(displacement), Limits.of(lower, upper, fuel), robustness=robustness)))


def sides(found: Bound, gap: float = REGULAR) -> tuple[float, float]:
    return proving.sides(found, gap)


# Two-mass spring, Δ = 5, |u| ≤ 1: Singhose, Singh and Seering, J. Dynamic Systems, Measurement, and Control 121 (1999), digits by Newton's
# method on the switch times, of which those in the first half are given.
PROFILES = {
    ("4", 0): (8.1107317945, (0.8169711992, 1.7558594103, 2.9388882111)),
    ("3.5", 0): (8.7965032368, ()),
    ("3.5", 1): (9.2461624729, (0.5501287725, 1.8495533507, 3.0494245782)),
}


@pytest.mark.parametrize(("fuel", "robustness"), first(1, PROFILES))
def test_known_profiles_lie_between_the_proven_sides(fuel: str, robustness: int) -> None:
    found, (time, switches) = bound(SPRING, "5", fuel, robustness=robustness), PROFILES[fuel, robustness]
    lower, upper = sides(found)
    assert lower <= time + 5e-11
    assert upper >= time - 5e-11
    assert found.command is not None
    assert found.switches == 6
    assert abs(found.command.fuel() - float(fuel)) <= 1e-14 * float(fuel)
    starts, levels = zip(*((segment.start, segment.level) for segment in found.command.segments), strict=True)
    assert levels == (1.0, 0.0, 1.0, 0.0, -1.0, 0.0, -1.0)
    np.testing.assert_allclose([*starts[1:], upper - starts[-1]][: len(switches)], switches, rtol=0.0, atol=6e-11)
    np.testing.assert_allclose(starts[1:], upper - np.array(starts[:0:-1]), rtol=0.0, atol=1e-13)  # the profile is antisymmetric


# Where exactly so much fuel is left that no second pair of pulses is needed, M ω Δ/(n π), the optimum is degenerate: two switches for
# five equations. The numbers are such nodes to ten digits.
@pytest.mark.parametrize(("fuel", "time", "gap"), [("4.5015815808", 6.6936737286, 3e-8), ("2.2507907904", 10.0111612715, 3e-7)])
def test_nodes_of_fuel(fuel: str, time: float, gap: float) -> None:
    lower, upper = sides(bound(SPRING, "5", fuel), gap)  # on grids that are dense where the command changes
    assert lower <= time + 5e-11
    assert upper >= time - 5e-11


@pytest.mark.parametrize(("low", "high", "fuel"), [("-1", "1", "1"), ("-1", "2", "1"), ("-3", "0.5", "0.25")])
def test_a_rigid_body_coasts_at_the_speed_that_its_fuel_gives(low: str, high: str, fuel: str) -> None:
    # v = U/2 after U/(2 high) seconds, and as much to brake: T = 2 Δ/U + U/4 (1/high + 1/|low|).
    a, b, budget = float(high), -float(low), float(fuel)
    lower, upper = sides(bound(RIGID, "1", fuel, low, high))
    time = 2 / budget + budget / 4 * (1 / a + 1 / b)
    assert lower <= time * (1 + 1e-14)
    assert upper >= time * (1 - 1e-14)


def test_a_budget_that_is_not_needed_changes_nothing() -> None:
    free, rich = bound(SPRING, "5", None), bound(SPRING, "5", "6.6627284204")
    assert (rich.lower, rich.upper, rich.switches) == (free.lower, free.upper, free.switches)
    poor = bound(SPRING, "5", "6.66272842")  # one that is short by 3e-11
    lower, upper = sides(poor, 3e-8)  # its price is too low for the grid's program to tell from none
    assert upper >= free.lower
    assert free.upper is not None
    assert lower <= free.upper * (1 + 1e-10)


def test_less_fuel_takes_no_less_time() -> None:
    times = [sides(bound(SPRING, "5", fuel), LIMITED) for fuel in ("6.6627284204", "5", "4.5015815808", "4", "3.5")]
    assert all(later[1] > earlier[0] for earlier, later in pairwise(times))
    assert times[-1][0] > times[0][1]


def test_too_little_fuel_is_impossible_and_enough_is_not() -> None:
    # 1/(s (s+1)): all the fuel must add up to the displacement.
    poor = bound(LAG, "1", "0.999999")
    assert poor.status is Status.IMPOSSIBLE
    assert poor.certificate is not None
    assert check(poor.certificate).outcome is Outcome.PROVED
    assert "at most 0.999999" in claim(check(poor.certificate))
    lower, upper = sides(bound(LAG, "1", "1.1"))
    assert lower < upper < 10
    for fuel, zeros, outcome in (
        ("1", {}, Outcome.INCONCLUSIVE),
        ("1.1", {}, Outcome.INCONCLUSIVE),
        ("0.9", {"real[1]": 1}, Outcome.PROVED),
    ):
        content = certificate(task(["1"], ["1", "1", "0"], fuel=fuel, zeros=zeros), impossible="fuel")
        assert check(content).outcome is outcome
    for budget, bottom in ((None, ["1", "1", "0"]), ("0.1", ["1", "0", "0"])):
        assert check(certificate(task(["1"], bottom, fuel=budget), impossible="fuel")).outcome is Outcome.INCONCLUSIVE


def test_the_tail_is_no_part_of_the_budget_and_makes_more_possible() -> None:
    plant = transfer([1, 1], [1, 2, 0])()  # (s+1)/(s (s+2)), ∫u = 2 in all
    limits = Limits.of(-1, 1, "1.9")
    assert minimum_time(problem([plant], Maneuver(Fraction(1), limits))).status is Status.IMPOSSIBLE
    lower, upper = sides(minimum_time(problem([plant], Maneuver(Fraction(1), limits, tail=True))))
    free = minimum_time(problem([plant], Maneuver(Fraction(1), Limits.of(-1, 1), tail=True)))
    assert free.upper is not None
    assert upper >= free.lower
    assert lower <= 1.9  # at full force the fuel is gone by then


def test_where_a_budget_makes_no_sense() -> None:
    with pytest.raises(ManeuverError, match=r"held at its target by 0\.5"):
        problem([transfer([1], [1, 0, 1])()], Maneuver(Fraction(1, 2), Limits.of(-1, 1, 1)))
    for nothing in ("0", "-1"):
        with pytest.raises(ManeuverError, match="more than 0"):
            problem([PLANTS[RIGID]()], Maneuver(Fraction(1), Limits.of(-1, 1, nothing)))
    for fuel in ("0", "-1"):
        assert check(certificate(task(["1"], ["1", "0", "0"], fuel=fuel), "1", witnesses=(costate(), None))).outcome is Outcome.MALFORMED
    held = certificate(task(["1"], ["1", "0", "1"], "0.5", fuel="1"), "1", witnesses=(costate(), None))
    assert check(held).outcome is Outcome.MALFORMED
    for price, of in (("1", None), ("-1", "1")):
        content = certificate(task(["1"], ["1", "0", "0"], fuel=of), "1", witnesses=(costate(fuel=price), None))
        assert check(content).outcome is Outcome.MALFORMED


@pytest.mark.parametrize("seed", range(2))
def test_random_budgets_against_another_program(seed: int) -> None:
    rng = np.random.default_rng([2026, seed])
    frequency, damping = rng.uniform(1.0, 4.0), rng.choice([0.0, 0.02, 0.2])
    bottom = np.polymul([1, 0, 0], [1, 2 * damping * frequency, frequency**2])
    plant = LinearPlant.from_transfer([1], [float(f"{c:.4g}") for c in bottom])
    low, high = -float(f"{rng.uniform(0.5, 2):.3g}"), float(f"{rng.uniform(0.5, 2):.3g}")
    free = minimum_time(problem([plant], Maneuver(Fraction(1), Limits.of(low, high))))
    assert free.command is not None
    assert free.upper is not None
    budget = float(f"{rng.uniform(0.5, 0.95) * free.command.fuel():.3g}")
    lower, upper = sides(minimum_time(problem([plant], Maneuver(Fraction(1), Limits.of(low, high, budget)))))
    other = Limited(plant, 1.0, low, high, budget).time(0.98 * lower, 1.02 * upper, 100, 1e-4)
    assert other >= lower * (1 - 1e-6)
    assert other == pytest.approx(upper, rel=4e-3)  # what a grid of 100 steps is slower


def test_a_lag_in_closed_form() -> None:
    # 1/(s (s+1)), |u| ≤ 1, U = 1.1: u = 1 at first for 1.05 s, -1 for 0.05 s at the end, and ∫u e^{-s} ds = 0 over the time to go.
    lower, upper = sides(bound(LAG, "1", "1.1"))
    assert lower <= log((exp(1.05) - 1) / (1 - exp(-0.05))) <= upper


# Too little for any time: sharp for one mode that begins elsewhere than at rest, and with a tail.

PENDULUM = LinearPlant.from_transfer([1], [1, 0, 1])


@pytest.mark.parametrize(("fuel", "status"), [("0.1", Status.IMPOSSIBLE), ("1.726", Status.IMPOSSIBLE), ("1.74", Status.PROVED)])
def test_a_swing_takes_as_much_fuel_as_its_momentum(fuel: str, status: Status) -> None:
    """√(1.7² + 0.3²) = 1.72627 is what every input has to do at least, however long it may take."""
    found = minimum_time(problem([PENDULUM], Maneuver(Fraction(0), Limits.of(-1, 1, fuel), initial=(Fraction("1.7"), Fraction("0.3")))))
    assert found.status is status
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED


def test_a_mass_that_moves_takes_its_momentum() -> None:
    mass = LinearPlant.from_transfer([1], [1, 0, 0])
    for fuel, status in (("0.99", Status.IMPOSSIBLE), ("1.4", Status.PROVED)):
        found = minimum_time(problem([mass], Maneuver(Fraction(1), Limits.of(-1, 1, fuel), initial=(Fraction(0), Fraction(1)))))
        assert found.status is status, found.reason


@pytest.mark.parametrize(
    ("numerator", "denominator", "needed"),
    [([1, 2], [1, 1, 0], "1"), ([1, 2], [1, 1, 1, 0], "0.7"), ([1, 2, 5], [1, 1, 1, 0], "0.3")],
)
def test_a_tail_does_not_replace_the_fuel(numerator: list[int], denominator: list[int], needed: str) -> None:
    plant = LinearPlant.from_transfer(numerator, denominator)

    def asked(fuel: Fraction) -> Problem:
        return problem([plant], Maneuver(Fraction(2), Limits(Fraction(-1), Fraction(1), fuel), tail=True))

    found = minimum_time(asked(Fraction(needed) * Fraction(99, 100)))
    assert found.status is Status.IMPOSSIBLE
    assert found.certificate is not None
    content = found.certificate
    assert check(content).outcome is Outcome.PROVED
    assert minimum_time(asked(Fraction(needed) * 2)).status is not Status.IMPOSSIBLE

    def richer(data: Any) -> None:
        data["task"]["limits"]["fuel"] = "3"

    def cheaper(data: Any) -> None:  # the costate is larger than the price somewhere
        data["lower"]["fuel"] = written(number(data["lower"]["fuel"]) * Fraction(9, 10))

    for change in (richer, cheaper):
        assert check(changed(content, change)).outcome is Outcome.INCONCLUSIVE
