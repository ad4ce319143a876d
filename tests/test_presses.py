"""Prices of limits of outputs: those of a limit that is touched act at an instant, those of one that is held over every cell."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from box_tasks import TWIN

from fmus.twins import twin_family
from relaxations import posing, programs
from relaxations.bounds import Settings, exponent_of, instants
from relaxations.duality import lower_bound
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.presses import Press, off, over, sampled, touching

FAMILY = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})


def posed(limit: str = "0.4") -> Problem:
    limits = Limits(Fraction(-1), Fraction(1), deflection={"output_rate": Fraction(limit)})
    return problem([FAMILY.member([Fraction(1)])], Maneuver(Fraction(1), limits))


def priced(*weights: float, begin: float = 1.0, cell: float = 0.1) -> list[Press]:
    course = posed().courses[0]
    edges = begin + cell * np.arange(len(weights) + 1)
    return [Press(course, a, b, w, a + 0.3 * cell) for a, b, w in zip(edges[:-1], edges[1:], weights, strict=True)]


def test_a_limit_that_is_touched_is_priced_at_its_instant() -> None:
    (one,) = touching(priced(1e-9, 2.0, -1e-9))
    assert one.weight == 2.0
    assert one.begin < one.at < one.end
    assert one.end - one.begin < 1e-3
    assert one.at == pytest.approx(1.13)


def test_a_limit_that_is_held_keeps_its_prices() -> None:
    held = priced(1.0, 2.0, 1.0)
    assert touching(held) == tuple(held)
    both = [*held, *priced(0.0, 3.0, begin=4.0)]
    assert [press.weight for press in touching(both)] == [1.0, 2.0, 1.0, 3.0]
    assert touching([]) == ()


def test_what_prices_take_off_is_what_a_walk_along_the_costate_says() -> None:
    task, pressed = posed(), priced(1.0, -2.0, 0.5)
    points = np.linspace(0.0, 3.0, 301)
    basis, nothing = task.sets[0].basis, np.zeros(task.size)
    walked = -sampled([basis], [nothing], pressed, points)
    assert [off(pressed, s) for s in points[::30]] == pytest.approx(walked[::30], abs=1e-12)
    fine = np.linspace(0.0, 3.0, 3001)
    course = -sampled([basis], [nothing], pressed, fine)
    whole = float(np.trapezoid(course, fine))
    assert float(over(pressed, np.array([0.0, 1.1, 3.0])).sum()) == pytest.approx(whole, abs=1e-6)


def test_a_grid_s_prices_bound_from_below() -> None:
    """However they are spread: any are valid, and those of a grid are good to its cells."""
    task = posed("0.5")
    solution = programs.solve(posing.build(task, instants(task, 4.5, Settings(least_cells=200))))
    exponent, fraction = exponent_of(solution), solution.fraction
    root = 4.5 * fraction ** (-1.0 / exponent)
    for prices in (solution.prices.pressed, touching(solution.prices.pressed)):
        bound = lower_bound(task, solution.costate, 4.5, solution.price(task), type(solution.prices)(pressed=prices))
        assert 0.95 * root < bound < root * 1.001
