"""Polishing: many digits that an independent computation knows, and no answer where there is no square system."""

from __future__ import annotations

from fractions import Fraction

import pytest
from problems import chain, two_mass

from relaxations.bounds import bracket
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.polishing import polish
from relaxations.refinement import Extremal


def test_digits_of_a_long_chain() -> None:
    """n = 11 unit masses, Δ = 5: 27.0783724615642386…, by Newton's method at 400 bits on the antisymmetric switch times."""
    posed = problem([chain(11)], Maneuver(Fraction(5), Limits.of(-1, 1)))
    extremal = bracket(posed).dual
    assert isinstance(extremal, Extremal)
    polished = polish(posed, extremal)
    assert polished is not None
    assert abs(polished.maneuver_time - Fraction("27.0783724615642386")) < Fraction(1, 10**15)  # the digits given


def test_closed_form_to_forty_digits() -> None:
    """1/s² within [-b, a]: T² = 2Δ(a + b)/(ab), exactly."""
    posed = problem([LinearPlant.from_transfer([1], [1, 0, 0])], Maneuver(Fraction(3), Limits.of("-0.5", 2)))
    extremal = bracket(posed).dual
    assert isinstance(extremal, Extremal)
    polished = polish(posed, extremal)
    assert polished is not None
    square = Fraction(2 * 3) * (2 + Fraction(1, 2)) / (2 * Fraction(1, 2))
    assert abs(polished.maneuver_time**2 - square) < Fraction(1, 10**40)  # 45 digits are handed on
    assert [round(float(start), 12) for start in polished.starts] == pytest.approx([0.0, float(square) ** 0.5 * 0.2])


def test_degenerate_optima_have_no_square_system() -> None:
    """Δ = π² has one switch for four equations."""
    posed = problem([two_mass()], Maneuver(exact("9.8696044010893586188344909998761511353137"), Limits.of(-1, 1)))
    extremal = bracket(posed).dual
    assert not isinstance(extremal, Extremal) or polish(posed, extremal) is None
