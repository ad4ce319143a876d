"""Certificates of fuel and time weighted: accepted, and what a liar could write; the truth of one mass is known in closed form."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import pytest
from corruption import at, nudge, numbers, put
from forgery import changed, forged, number, opened, written
from problems import transfer

from relaxations.checking.claims import Outcome, check, claim
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.onoff.weights import weighted
from relaxations.plants import exact


@cache
def original() -> bytes:
    """One mass, limits -1 and 2, price 1: the least cost of a unit move is √11."""
    found = weighted(problem([transfer([1], [1, 0, 0])()], Maneuver(exact("1"), Limits.of(-1, 2))), Fraction(1))
    assert found.certificate is not None
    return found.certificate


def squared(data: dict[str, Any]) -> Fraction:
    """The square of the least cost that a certificate of one mass is about: 4 d ((1/a + 1/b)/2 + 2 α), d the way as the input sees it."""
    task = data["task"]
    low, high = (number(side) - number(task["initial_input"]) for side in task["limits"]["input"])
    way = abs(number(task["displacement"]) / number(task["plants"][0]["numerator"][0]))
    return 4 * way * ((1 / high - 1 / low) / 2 + 2 * number(data["price"]))


def true(data: dict[str, Any]) -> bool:
    """Whether both sides of the claim are so."""
    lower, upper = (data["claim"][side] for side in ("lower", "upper"))
    least = squared(data)
    return (lower is None or number(lower) ** 2 <= least) and (upper is None or number(upper) ** 2 >= least)


def test_the_certificate_is_accepted_and_says_what_it_is_about() -> None:
    found = check(original())
    assert found.outcome is Outcome.PROVED
    assert true(opened(original()))
    words = claim(found)
    assert "Cost: T + 1 ∫|u(t) - 0| dt, in seconds, the integral from 0 to T. T is free." in words
    assert "does this at a cost of less than 3.3166" in words
    assert "one does it at a cost of at most 3.3166" in words
    record = found.to_dict()
    assert record["price"] == "1"
    assert record["maneuver_time"] is None
    assert abs(float(record["cost"]["lower"]) - 11**0.5) < 1e-8


def test_each_side_stands_alone() -> None:
    for side in ("lower", "upper"):
        data = opened(original())
        data["claim"][side], data[side] = None, None
        assert check(forged(data)).outcome is Outcome.PROVED


@pytest.mark.parametrize("seed", range(60))
def test_whatever_number_is_changed_nothing_false_is_proven(seed: int) -> None:
    rng, data = random.Random(seed), opened(original())
    places = [path for path in numbers(data) if path[0] != "digest" and "denominator" not in path]
    for path in rng.sample(places, rng.choice((1, 1, 2, 5))):
        put(data, path, nudge(at(data, path), rng))
    if check(forged(data)).outcome is Outcome.PROVED:
        assert true(data)


@pytest.mark.parametrize("factor", [Fraction(1) + Fraction(k, 10**e) for k in (-1, 1) for e in (1, 4, 8, 11)])
@pytest.mark.parametrize("place", [("price",), ("task", "displacement"), ("task", "limits", "input", 0), ("task", "limits", "input", 1)])
def test_another_task_is_proven_only_if_its_claim_is_true(factor: Fraction, place: tuple[Any, ...]) -> None:
    data = opened(original())
    put(data, place, written(number(at(data, place)) * factor))
    if check(forged(data)).outcome is Outcome.PROVED:
        assert true(data)


def lie(change: Callable[[dict[str, Any]], Any]) -> Outcome:
    return check(changed(original(), change)).outcome


def pieces(data: dict[str, Any]) -> list[Any]:
    return data["lower"]


def close(data: dict[str, Any]) -> int:
    """The piece in which the command's own time lies."""
    time = number(data["upper"]["maneuver_time"])
    return next(i for i, piece in enumerate(data["lower"]) if number(piece["begin"]) <= time < number(piece["end"]))


def test_a_cost_that_is_too_large_is_not_proven() -> None:
    above = "3.316624791"  # √11 = 3.31662479035…
    assert lie(lambda data: data["claim"].update(lower=above)) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


def test_a_command_that_costs_more_is_refuted() -> None:
    assert lie(lambda data: data["claim"].update(upper="3.3166")) is Outcome.REFUTED


def test_a_dearer_fuel_is_not_proven_by_the_command() -> None:
    assert lie(lambda data: data.update(price="1.001")) is Outcome.REFUTED


def test_one_costate_alone_is_not_enough() -> None:
    """The best costate at the best time refutes other times less and less: D has its largest value there."""

    def alone(data: dict[str, Any]) -> None:
        one = data["lower"][close(data)]
        data["lower"] = [{**one, "begin": "0", "end": data["lower"][-1]["end"]}]

    assert lie(alone) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


def test_a_wider_piece_that_hides_a_dip_is_not_proven() -> None:
    """D at the end of the piece is large, and less than the claim within it."""

    def wider(data: dict[str, Any]) -> None:
        i = close(data)
        data["lower"][i + 2 :] = [{**data["lower"][i + 2], "begin": data["lower"][i]["begin"]}, *data["lower"][i + 3 :]]
        del data["lower"][i : i + 2]

    assert lie(wider) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


def test_times_that_no_piece_covers_are_not_proven() -> None:
    assert lie(lambda data: pieces(data).pop()) is Outcome.INCONCLUSIVE
    assert lie(lambda data: pieces(data).clear()) is Outcome.INCONCLUSIVE
    assert lie(lambda data: pieces(data).pop(0)) is Outcome.MALFORMED  # the first one begins at 0
    assert lie(lambda data: pieces(data).pop(2)) is Outcome.MALFORMED  # each where the one before ends
    assert lie(lambda data: pieces(data)[0].update(begin="1")) is Outcome.MALFORMED
    assert lie(lambda data: pieces(data)[0].update(begin="-1")) is Outcome.MALFORMED
    assert lie(lambda data: pieces(data).reverse()) is Outcome.MALFORMED
    assert lie(lambda data: pieces(data)[-1].update(end=pieces(data)[-1]["begin"])) is Outcome.MALFORMED


@pytest.mark.parametrize("size", ["1" + "0" * 300, "-1" + "0" * 300, "1/1" + "0" * 300, "0"])
def test_costates_of_any_size_prove_nothing_false(size: str) -> None:
    def one(data: dict[str, Any]) -> None:
        data["lower"][close(data)]["costate"][0][0]["coefficients"][0][0] = size

    assert lie(one) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.update(price="0"),
        lambda data: data.update(price="-1"),
        lambda data: data.update(price=None),
        lambda data: data.pop("price"),
        lambda data: data.update(format="slewcert-certificate/1"),
        lambda data: data["claim"].update(lower=None, upper=None),
        lambda data: data["claim"].update(lower="-1"),
        lambda data: data["claim"].update(impossible=None),
        lambda data: data.update(lower=None),
        lambda data: data.update(upper=None),
        lambda data: data["upper"].update(radius="0"),
        lambda data: data["task"].update(rest="output"),
        lambda data: data["task"].update(initial_state=["0", "0"]),
        lambda data: data["task"].update(displacement="0"),
        lambda data: data["task"]["limits"].update(fuel="9"),
        lambda data: data["task"]["limits"].update(rate=["-9", "9"]),
        lambda data: data["task"]["limits"].update(pulse_width="0.01"),
        lambda data: data["task"]["limits"].update(pulses=2),
        lambda data: data["task"]["limits"].update(held="positive, then negative"),
        lambda data: data["task"]["limits"].update(sample_time="0.001"),
        lambda data: data["task"]["limits"].update(input=["0.5", "2"]),
        lambda data: data["task"]["plants"].clear(),
        lambda data: data["task"]["plants"].append(copy.deepcopy(data["task"]["plants"][0])),
        lambda data: data["task"]["plants"][0].update(denominator=["1", "0", "1"]),  # held at its target by an input
    ],
)
def test_what_is_no_cost_is_malformed(change: Callable[[dict[str, Any]], Any]) -> None:
    assert lie(change) is Outcome.MALFORMED


def test_limited_outputs_have_no_cost() -> None:
    def limited(data: dict[str, Any]) -> None:
        data["task"]["plants"][0]["outputs"] = {"speed": ["1", "0"]}
        data["task"]["limits"]["deflection"] = {"speed": "9"}

    assert lie(limited) is Outcome.MALFORMED


@pytest.mark.slow
def test_a_flexible_plant_is_checked_alike() -> None:
    found = weighted(problem([transfer([1], [1, 0, 2, 0, 0])()], Maneuver(exact("1"), Limits.of(-1, 1))), Fraction(1, 2))
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    more = changed(found.certificate, lambda data: data["claim"].update(lower=written(number(data["claim"]["upper"]) * 1000001 / 1000000)))
    assert check(more).outcome in (Outcome.REFUTED, Outcome.INCONCLUSIVE)
