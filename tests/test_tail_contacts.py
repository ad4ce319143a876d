"""Tails that touch a limit in their course: digits from an independent solution, other starts, pairs that must and must not be proven."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest
from random_plants import random_task

from relaxations.bounds import Settings, Status, bracket, contacts, grid_minimum
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact
from relaxations.polishing import polish
from relaxations.proofs import minimum_time
from relaxations.refinement import Extremal, refine
from relaxations.tails import Contact, TailStart

DIGITS = Fraction(1, 10**28)  # a tail is kept 1e-30 of the input's range inside a limit that it touches


def cubic(lower: int = -1) -> Problem:
    """(s + 1)(s + 2)/s³ by 100 units, within [lower, 1]."""
    return problem([LinearPlant.from_transfer([1, 3, 2], [1, 0, 0, 0])], Maneuver(exact(100), Limits.of(lower, 1), tail=True))


def duration(c1: Decimal, c2: Decimal, jump: int) -> Decimal:
    """T with the tail c1 e^{-r} + c2 e^{-2r}, of the input 1, 1 - jump, 1: by ∫u = ∫tu = 0 and ∫t²u = 100, t counted from the end.

    With s_2 - s_1 = d and s_1 + s_2 = S for the times to go of its two switches one equation in d is left: by bisection.
    """
    moments = c1 + c2 / 2, c1 + c2 / 4, 2 * c1 + c2 / 4
    low = d = Decimal(1)
    high = Decimal(10)
    for _ in range(140):
        d = (low + high) / 2
        time = jump * d - moments[0]
        total = (time**2 - 2 * moments[1]) / (jump * d)
        over = (time**3 - jump * d * (3 * total**2 + d**2) / 4) / 3 + moments[2] - 100 > 0
        low, high = (low, d) if over else (d, high)
    return jump * d - moments[0]


def polished(posed: Problem) -> tuple[Fraction, Extremal]:
    extremal = bracket(posed).dual
    assert isinstance(extremal, Extremal)
    found = polish(posed, extremal)
    assert found is not None
    return found.maneuver_time, extremal


def test_a_tail_between_both_limits() -> None:
    """It begins on the lower limit and touches the upper one: c_1 + c_2 = -1, c_1² = -4 c_2, so c_1 = 2 + 2√2 and τ = ln(1 + √2)."""
    getcontext().prec = 50
    root = Decimal(2).sqrt()
    time, extremal = polished(cubic())
    assert abs(time - Fraction(duration(2 + 2 * root, -3 - 2 * root, 2))) < DIGITS
    still, moving = sorted(extremal.tail.contacts, key=lambda contact: contact.place)
    assert (still.place, still.side, still.moving, moving.side, moving.moving) == (0.0, -1, False, 1, True)
    assert moving.place == pytest.approx(np.log(1 + np.sqrt(2)), abs=1e-12)
    assert extremal.tail.coefficients == pytest.approx([2 + 2 * np.sqrt(2), -3 - 2 * np.sqrt(2)], abs=1e-11)


def test_the_best_of_all_tails_that_touch_a_limit() -> None:
    """Within [-3, 1] one number is free: the least T over it, c_2 = -c_1²/4, by golden sections."""
    getcontext().prec = 50
    low, high = Decimal("5.3"), Decimal("5.9")  # 3 + c_1 - c_1²/4 > 0 up to 6: the tail begins above the lower limit
    share = (Decimal(5).sqrt() - 1) / 2
    for _ in range(90):  # T is known to the square of that
        left, right = high - share * (high - low), low + share * (high - low)
        smaller = duration(left, -(left**2) / 4, 4) < duration(right, -(right**2) / 4, 4)
        low, high = (low, right) if smaller else (left, high)
    time, extremal = polished(cubic(-3))
    assert abs(time - Fraction(duration(low, -(low**2) / 4, 4))) < DIGITS
    assert extremal.tail.coefficients[0] == pytest.approx(float(low), abs=1e-10)


@pytest.mark.parametrize("seed", [65, 80, 108, 166, 315, 409, 627])
def test_random_tasks_whose_tails_touch_a_limit(seed: int) -> None:
    """In one place or two, with a contact at the end of the move or without; 65 has a tail of cancelling terms that begins on a limit."""
    found = minimum_time(random_task(seed).problem())
    assert found.status is Status.PROVED, found.reason
    assert found.switches is not None
    assert found.gap is not None
    assert found.gap <= 1e-12
    assert isinstance(found.dual, Extremal)
    assert seed == 65 or any(contact.moving for contact in found.dual.tail.contacts)


def test_a_tail_that_must_be_short_touches_the_tighter_limit_in_its_course() -> None:
    plant = LinearPlant.from_transfer([1, 1, 5], [1, 0, 0, 0])
    times = []
    for within in ("1", "0.31", "0.3"):
        length = exact(1), exact(within)
        found = minimum_time(problem([plant], Maneuver(exact(2), Limits.of(-1, 1), tail=True, tail_length=length)))
        assert found.status is Status.PROVED, found.reason
        assert found.gap is not None
        assert found.gap <= 1e-12
        assert isinstance(found.dual, Extremal)
        times.append(found.lower)
        if within != "1":
            assert any(contact.moving and contact.place > 1.0 for contact in found.dual.tail.contacts)
    assert times[0] < times[1] < times[2]


@pytest.mark.parametrize("lower", ["-1", "0"])
def test_a_tail_may_begin_on_the_limit_where_it_ends(lower: str) -> None:
    """u_ss is the upper limit: the tail comes from it, and returns to it from below."""
    plant = LinearPlant.from_zeros_poles([-3, -1], [-2, "-1.2", ("-0.1", 2), ("-0.1", -2)], 1)
    found = minimum_time(problem([plant], Maneuver(1 / plant.rest_input(Fraction(1)), Limits.of(lower, 1), tail=True)))
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= 1e-12
    assert found.command is not None
    assert found.command.tail(0.0) == pytest.approx(1.0, abs=1e-12)


# Wrong beginnings.


def start(posed: Problem) -> tuple[np.ndarray, float, TailStart]:
    solution = grid_minimum(posed, Settings()).above
    assert solution is not None
    return solution.costate, solution.maneuver_time, contacts(posed, solution)


def test_a_contact_that_was_not_seen_is_found() -> None:
    """Without the contact at the end of the move Newton's method comes to a tail that is beyond that limit there."""
    posed = cubic()
    costate, time, tail = start(posed)
    seen = tuple(contact for contact in tail.contacts if contact.moving)
    found = refine(posed, costate, time, TailStart(tail.coefficients, seen))
    assert isinstance(found, Extremal)
    assert len(found.tail.contacts) == 2
    assert found.maneuver_time == pytest.approx(float(polished(posed)[0]), rel=1e-12)


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_contact_that_is_misplaced_is_moved(factor: float) -> None:
    posed = cubic(-3)
    costate, time, tail = start(posed)
    elsewhere = tuple(replace(contact, place=factor * contact.place) for contact in tail.contacts)
    found = refine(posed, costate, time, TailStart(tail.coefficients, elsewhere))
    assert isinstance(found, Extremal)
    assert found.maneuver_time == pytest.approx(float(polished(posed)[0]), rel=1e-12)


def test_a_contact_that_is_none_is_let_go() -> None:
    posed = cubic(-3)
    costate, time, tail = start(posed)
    for other in (Contact(0.0, -1, 0.1), Contact(2.0, 1, 0.1)):
        found = refine(posed, costate, time, TailStart(tail.coefficients, (*tail.contacts, other)))
        if isinstance(found, Extremal):  # or Newton's method finds no way, which is said
            assert found.maneuver_time == pytest.approx(float(polished(posed)[0]), rel=1e-12)
            assert len(found.tail.contacts) == 1
        else:
            assert found.reason


@pytest.mark.parametrize("lower", [-1, -3])
def test_a_hair_less_room_takes_longer(lower: int) -> None:
    """Paired: each instance is proven, and the two brackets do not meet."""
    wide = minimum_time(cubic(lower))
    plant = LinearPlant.from_transfer([1, 3, 2], [1, 0, 0, 0])
    tight = minimum_time(problem([plant], Maneuver(exact(100), Limits.of(lower, "0.999999999"), tail=True)))
    assert wide.status is tight.status is Status.PROVED
    assert wide.upper is not None
    assert wide.upper < tight.lower


# The derivatives of tails.


def test_derivatives_of_a_tail() -> None:
    zeros = [-1, -1, -1, ("-0.5", 2), ("-0.5", -2)]
    plant = LinearPlant.from_zeros_poles(zeros, [0, 0, -2, -3, -4, -5], 1)
    tail = problem([plant], Maneuver(exact(1), Limits.of(-1, 1), tail=True)).tail
    r, h = np.linspace(0.1, 5.0, 50), 1e-5
    for derivative in (1, 2):
        difference = (tail.rows(r + h, derivative - 1) - tail.rows(r - h, derivative - 1)) / (2 * h)
        np.testing.assert_allclose(tail.rows(r, derivative), difference, atol=1e-8)  # h² of terms of order 10, rounding 1e-16/h
