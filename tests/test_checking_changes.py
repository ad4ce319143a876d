"""Inputs one way, then the other: covers of every change of sign, and what lies between two of their nodes, by numbers of one's own."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import pytest
from flint import arb, fmpq
from forgery import certificate, costate, system, task

from relaxations.checking import balls, changes, lower
from relaxations.checking.claims import Check, Outcome, check
from relaxations.checking.reading import Refuted, Undecided

pytestmark = pytest.mark.usefixtures("enough_work")

FORMS = {1: "positive, then negative", -1: "negative, then positive"}
NOTHING = ("0", "0")


def held(along: int = 1, sides: tuple[str, str] = ("-1", "1"), displacement: str = "1", **others: Any) -> dict[str, Any]:
    return task(["1"], ["1", "0", "0"], displacement, limits=sides, held=FORMS[along], **others)


def node(at: Fraction, coefficients: Iterable[Any], fuel: Fraction = Fraction(0)) -> dict[str, Any]:
    """p = c_0 + c_1 s, s the time to go."""
    chain = {"near": ["0", "0"], "coefficients": [[str(c), "0"] for c in coefficients]}
    return {"at": str(at), "costate": [[chain]], "fuel": str(fuel)}


def covered(of: dict[str, Any], nodes: Iterable[Any], time: Fraction) -> Check:
    return check(certificate(of, str(time), witnesses=(costate((("0", "0"), [NOTHING]), changes=list(nodes)), None)))


def evenly(time: Fraction, parts: int) -> list[Fraction]:
    return [time * k / parts for k in range(parts + 1)]


@pytest.mark.parametrize("along", [1, -1])
@pytest.mark.parametrize(("strong", "weak"), [("1", "1"), ("1", "13/10"), ("13/10", "1"), ("2", "1/2")])
def test_the_cart_of_any_limits(along: int, strong: str, weak: str) -> None:
    """T² = 2 (1/E + 1/L) for a move by 1; the sign changes at r = E T/(E + L) to go."""
    e, other = Fraction(strong), Fraction(weak)
    sides = (f"-{weak}", strong) if along > 0 else (f"-{strong}", weak)
    of = held(along, sides, str(along))
    square = 2 * (1 / e + 1 / other)
    fastest = Fraction(square**0.5).limit_denominator(10**9)
    for factor, outcome in ((Fraction(99, 100), Outcome.PROVED), (Fraction(101, 100), Outcome.REFUTED)):
        time = factor * fastest
        change = time * e / (e + other)
        nodes = [node(at, (-along * change, along)) for at in evenly(time, 40)]
        assert (covered(of, nodes, time).outcome is Outcome.PROVED) == (outcome is Outcome.PROVED)


@pytest.mark.parametrize("along", [1, -1])
def test_the_cart_on_a_budget(along: int) -> None:
    """Pulses of 3/4 s each, so that 3/4 (T - 3/4) = 1; |p| = μ where the input is switched."""
    of, fastest = held(along, displacement=str(along), fuel="3/2"), Fraction(25, 12)
    for time, proved in ((fastest - Fraction(1, 60), True), (fastest + Fraction(1, 60), False)):
        coefficients, price = (-along * time / 2, along), time / 2 - Fraction(3, 4)
        nodes = [node(at, coefficients, price) for at in evenly(time, 60)]
        assert (covered(of, nodes, time).outcome is Outcome.PROVED) == proved
        if proved:  # a dearer budget is not refuted by it, nor is a price that nobody pays
            assert covered({**of, "limits": {**of["limits"], "fuel": "8/5"}}, nodes, time).outcome is not Outcome.PROVED
            free = [{**one, "fuel": "0"} for one in nodes]
            assert covered(of, free, time).outcome is not Outcome.PROVED


def test_every_node_must_refute() -> None:
    """Also the last one, and those after two at the same instant; no costate at all refutes nothing."""
    time = Fraction(19, 10)
    good = [node(at, (-time / 2, 1)) for at in evenly(time, 20)]
    assert covered(held(), good, time).outcome is Outcome.PROVED
    none = node(Fraction(0), (0, 0))["costate"]
    for place in range(len(good)):
        bad = {**good[place], "costate": none}
        assert covered(held(), [*good[:place], bad, *good[place + 1 :]], time).outcome is not Outcome.PROVED, place
    twice = [*good[:11], *good[10:]]
    assert covered(held(), twice, time).outcome is Outcome.PROVED
    assert covered(held(), [*twice[:-1], {**twice[-1], "costate": none}], time).outcome is not Outcome.PROVED
    assert covered(held(), [{**one, "costate": none} for one in good], time).outcome is not Outcome.PROVED
    assert covered(held(), good[:-1], time).outcome is not Outcome.PROVED


def wave(*coefficients: float, order: int = 2) -> balls.Wave:
    return balls.Wave.of(system(task(["1"], ["1", *"0" * order], held=FORMS[1])).roots, [arb(c) for c in coefficients])


def test_a_price_is_paid_from_an_instant_on() -> None:
    """`∫ max(0, s - 1/4) ds` from 1/2 to 1."""
    paid = changes.pay(wave(0, 1), fmpq(1, 4), arb(1), (arb(1) / 2, arb(1)), lower.support, arb(2) ** -100)
    assert float(paid) == pytest.approx((0.75**2 - 0.25**2) / 2, abs=1e-20)


def test_ranges_beside_a_price() -> None:
    low, high = changes.beyond(wave(0.5, -1), -1, fmpq(1, 2), arb(1), arb(2))
    assert (float(low), float(high)) == pytest.approx((0.0, 1.0), abs=1e-8)  # radii of balls have 30 bits


def test_the_least_and_the_most_of_balls_are_upper_bounds() -> None:
    balls_ = [arb(5), arb(2, 0.5), arb(9), arb(3)]
    assert 2.5 <= float(changes.min_of(balls_)) < 2.51
    assert 2.5 <= float(changes.min_of([arb(2, 0.5)])) < 2.51
    assert 9 <= float(changes.max_of(balls_)) < 9.01
    assert 2.5 <= float(changes.max_of([arb(2, 0.5), arb(1)])) < 2.51


@pytest.mark.parametrize(
    ("first", "other", "price", "expected"),
    [
        ((0.1, 0.1), (0.2, 0.1), 0, 2 / 4 * (0.4 - 0.2)),
        ((-0.2, -0.1), (-0.1, -0.1), 0, 3 / 4 * (0.4 - 0.2)),
        ((0.5, 0), (0, 1), 1, 2 / 4 * 1),
        ((0, -1), (-0.5, 0), 1, 3 / 4 * 1),
    ],
)
def test_what_lies_between_nodes_of_one_side(first: tuple[float, ...], other: tuple[float, ...], price: int, expected: float) -> None:
    prices = fmpq(price), fmpq(price)
    assert float(changes.between([wave(*first), wave(*other)], prices, arb(1), arb(2), arb(2), arb(3))) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(
    ("first", "other"), [((3, -2, 0.5), (2.5, -3, 0.25)), ((4, -2, 0.5), (2.5, -3, 0.25)), ((3, -2, 0.25), (2.5, -3, 0.5))]
)
def test_what_lies_between_nodes_whose_costates_fall(first: tuple[float, ...], other: tuple[float, ...]) -> None:
    """p = c_0 + c_1 s + c_2 s²/2 from 1 to 3/2: the formula, worked out."""
    (a0, a1, a2), (b0, b1, b2), w = first, other, 0.5
    ends = abs(a0 + a1 + a2 / 2), abs(b0 + b1 * 1.5 + b2 * 1.5**2 / 2)
    off = max(ends) + w / 4 * abs(a1 + a2 - b1 - b2 * 1.5) + w * w / 8 * max(a2, b2)
    steep = -max(a1 + a2 * 1.5, b1 + b2 * 1.5)
    found = changes.falling([wave(*first, order=3), wave(*other, order=3)], arb(1), arb(1.5), arb(7))
    assert [float(x) for x in found] == pytest.approx([7 * off**2 / (2 * steep)], rel=1e-7)
    assert changes.falling([wave(*first, order=3), wave(1, 0, 0, order=3)], arb(1), arb(1.5), arb(7)) == []


def test_a_level_that_may_be_on_either_side_after_the_change() -> None:
    posed = system(held())
    for last in (arb(0, 0.25), arb(-0.25, 0.5)):
        with pytest.raises(Undecided, match="level 2"):
            changes.form(posed, [fmpq(1), fmpq(-1), last])
    with pytest.raises(Refuted, match="level 2"):
        changes.form(posed, [fmpq(1), fmpq(-1), fmpq(1, 4)])


def test_the_bend_is_the_largest_of_the_whole_interval() -> None:
    """p'' = 1/2 + s reaches 2 at 3/2, where p' is still negative."""
    first, other, w = (3, -4, 0.5, 1), (2.5, -5, 0.25, 0.5), 0.5

    def at(c: tuple[float, ...], s: float) -> tuple[float, float]:
        return c[0] + c[1] * s + c[2] * s**2 / 2 + c[3] * s**3 / 6, c[1] + c[2] * s + c[3] * s**2 / 2

    (a, falls), (b, also) = at(first, 1), at(other, 1.5)
    off = max(abs(a), abs(b)) + w / 4 * abs(falls - also) + w * w / 8 * 2
    steep = -max(at(first, 1.5)[1], at(other, 1.5)[1])
    (found,) = changes.falling([wave(*first, order=4), wave(*other, order=4)], arb(1), arb(1.5), arb(7))
    assert 7 * off**2 / (2 * steep) <= float(found.upper()) <= 1.05 * 7 * off**2 / (2 * steep)
