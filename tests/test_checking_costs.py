"""Certificates of fuel and time weighted: accepted, and what a liar could write; the truth of one mass is known in closed form."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import pytest
from corruption import at, nudge, numbers, put
from flint import fmpq
from forgery import RECORDED, changed, forged, number, opened, posed, task, written
from problems import transfer

from relaxations.checking import costs, lower
from relaxations.checking.balls import System
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import PIECES, Malformed, Refuted, Undecided, shaped
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.onoff.weights import weighted
from relaxations.plants import exact


@cache
def original() -> bytes:
    """One mass, limits -1 and 2, price 1: the least cost of a unit move is √11."""
    if (file := RECORDED / "cost.json").exists():
        return file.read_bytes()
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


@pytest.mark.slow
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


@pytest.mark.parametrize("less", ["0", "1/2", "1", "3"])
def test_a_cost_that_is_less_is_proven(less: str) -> None:
    assert lie(lambda data: data["claim"].update(lower=less)) is Outcome.PROVED


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


# One costate on one interval of times: D is a piecewise polynomial, its least value known in fractions where D' = 1 - σ(p) is 0.


def integral(p: tuple[Fraction, Fraction], limits: tuple[Fraction, Fraction], price: Fraction, end: Fraction) -> Fraction:
    """∫_0^end σ(p) for p = a + b s, exactly: σ is straight between its kinks."""
    (low, high), (a, b) = limits, p
    kinks = sorted({Fraction(0), end, *((x - a) / b for x in (price, -price) if 0 < (x - a) / b < end)})
    total = Fraction(0)
    for begin, after in pairwise(kinks):
        middle = a + b * (begin + after) / 2
        total += max(Fraction(0), high * (middle - price), low * (middle + price)) * (after - begin)
    return total


def least_of(
    p: tuple[Fraction, Fraction], limits: tuple[Fraction, Fraction], price: Fraction, way: Fraction, times: tuple[Fraction, Fraction]
) -> Fraction:
    """The least D on an interval of times: at its ends, or where σ is 1."""
    (low, high), (a, b) = limits, p
    levels = [*([price + 1 / high] if high else []), *([-price + 1 / low] if low else [])]
    inner = [(level - a) / b for level in levels if times[0] < (level - a) / b < times[1]]
    return min(time + b * way - integral(p, limits, price, time) for time in (*times, *inner))


def one_piece(begin: Fraction, end: Fraction, *coefficients: Fraction) -> Any:
    chain = {"near": ["0", "0"], "coefficients": [[written(c), "0"] for c in coefficients]}
    return shaped({"begin": written(begin), "end": written(end), "costate": [[chain]]}, PIECES[0], "piece")


def proven(own: System, price: Fraction, pieces: Any, cost: Fraction) -> bool:
    try:
        costs.prove(own, fmpq(price.numerator, price.denominator), pieces, fmpq(cost.numerator, cost.denominator), lower.support)
    except (Refuted, Undecided):
        return False
    return True


@pytest.mark.parametrize("seed", range(80))
def test_a_costate_proves_its_least_bound_on_an_interval_and_no_more(seed: int) -> None:
    rng = random.Random(seed)
    low, high = limits = rng.choice(
        [
            (Fraction(-1), Fraction(1)),
            (Fraction(-1), Fraction(2)),
            (Fraction(-2), Fraction(1, 2)),
            (Fraction(0), Fraction(1)),
            (Fraction(-3), Fraction(0)),
        ]
    )
    a, b = p = Fraction(rng.randint(-12, 12), 4), Fraction(rng.choice([-3, -2, -1, 1, 2, 3]), rng.choice([1, 2, 4]))
    price, begin = Fraction(rng.randint(1, 6), 4), rng.choice([Fraction(0), Fraction(rng.randint(1, 8), 3)])
    end = begin + Fraction(rng.randint(1, 12), 3)
    way = (1 if b > 0 else -1) * Fraction(rng.randint(8, 20), 3) / abs(b) + rng.randint(0, 3) * (1 if b > 0 else -1)
    cost = least_of(p, limits, price, way, (begin, end))
    if cost <= 0:
        return
    with posed(task(["1"], ["1", "0", "0"], written(way), limits=(written(low), written(high)))) as own:
        exact, piece = fmpq(price.numerator, price.denominator), one_piece(begin, end, a, b)
        less, more = cost * Fraction(997, 1000), cost + Fraction(1, 10**9)  # where a costate crosses its price a thousandth may be lost
        costs.least(own, exact, piece, fmpq(less.numerator, less.denominator), lower.support)
        with pytest.raises((Refuted, Undecided)):
            costs.least(own, exact, piece, fmpq(more.numerator, more.denominator), lower.support)


def test_where_a_bound_rises_all_the_way_its_begin_is_enough() -> None:
    """|p| < α everywhere: σ = 0, D = T + λ d rises by 1 each second and is told from the cost even where they are equal, but for balls."""
    with posed(task(["1"], ["1", "0"], "2")) as own:
        for cost, fine in ((Fraction(3) - Fraction(1, 10**15), True), (Fraction(3) + Fraction(1, 10**15), False)):
            pieces = [one_piece(Fraction(0), Fraction(2), Fraction(3, 2)), one_piece(Fraction(2), Fraction(4), Fraction(1, 2))]
            assert proven(own, Fraction(2), pieces, cost) is fine
        assert proven(own, Fraction(2), [one_piece(Fraction(0), Fraction(4), Fraction(3, 2))], Fraction(3) - Fraction(1, 10**9))
        assert not proven(own, Fraction(2), [one_piece(Fraction(0), Fraction(4), Fraction(3, 2))], Fraction(4))


def test_pieces_reach_the_cost() -> None:
    """An integrator: 2 units take 2 s and cost 2 + 2 α = 6 at α = 2; p = 3 is the costate at which σ = 1, D = 6 for all times."""
    with posed(task(["1"], ["1", "0"], "2")) as own:
        for end, cost, fine in (
            ("6", "5.999999", True),
            ("5.99", "5.999999", False),
            ("5.999999", "5.999999", True),
            ("9", "5.999999", True),
        ):
            assert proven(own, Fraction(2), [one_piece(Fraction(0), Fraction(end), Fraction(3))], Fraction(cost)) is fine
        assert not proven(own, Fraction(2), [one_piece(Fraction(0), Fraction(9), Fraction(3))], Fraction("6.000001"))
        assert not proven(own, Fraction(2), [], Fraction(1, 10**9))
        assert proven(own, Fraction(2), [], Fraction(0))
        assert not proven(own, Fraction(2), [one_piece(Fraction(0), Fraction(9), Fraction(1, 10))], Fraction(1, 4))  # D = T + 1/5
        two = [one_piece(Fraction(0), Fraction(1), Fraction(3)), one_piece(Fraction(1), Fraction(7), Fraction(29, 10))]
        assert not proven(own, Fraction(2), two, Fraction("5.999"))
        assert proven(own, Fraction(2), two, Fraction("5.8"))


def test_fuel_is_counted_segment_by_segment() -> None:
    command: list[Any] = [fmpq(7), fmpq(0), fmpq(1), fmpq(3), fmpq(2), fmpq(-1, 2), fmpq(1, 3)]  # 1 s, 2 s, 4 s
    with posed(task(["1"], ["1", "0"], "2")) as own:
        assert costs.within(own, fmpq(3), command, 3).contains(fmpq(7) + 3 * (2 + 1 + fmpq(4, 3)))
        assert costs.within(own, fmpq(1, 2), command[:1], 0) == 7
    with posed(task(["1"], ["1", "1"], "1/2")) as own, pytest.raises(Malformed, match="rests without input"):
        costs.within(own, fmpq(3), command, 3)
    with posed(task(["1"], ["1", "1"], "1/2")) as own, pytest.raises(Malformed, match="rests without input"):
        costs.prove(own, fmpq(3), [], fmpq(0), lower.support)
