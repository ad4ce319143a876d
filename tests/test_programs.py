"""The grid program a_vs_b HiGHS on the same staircase in state space, its multiplier, and what must not matter to it."""

from __future__ import annotations

import numpy as np
import pytest
from independent import StateSpace, reachable_fraction
from problems import AWKWARD, FACTS, KNOWN, Known, chain, two_mass

from relaxations import bounds, posing, programs
from relaxations.bounds import bracket
from relaxations.energy import energy_bound
from relaxations.errors import SolverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact

CELLS = 120
SOLVER = 1e-8  # relative: Clarabel was asked for 1e-10 of numbers that are up to a hundred


def solved(posed: Problem, time: float, cells: int = CELLS) -> programs.GridSolution:
    return programs.solve(posing.build(posed, np.linspace(0.0, time, cells + 1)))


def plain(known: Known) -> bool:
    """Small enough for a matrix exponential and a simplex in doubles."""
    return not known.robustness and known.plant().order <= 8


@pytest.mark.parametrize("known", [k for k in FACTS + AWKWARD if plain(k)], ids=lambda k: k.name)
@pytest.mark.parametrize("factor", [0.6, 1.0, 1.3])
def test_the_reachable_fraction_a_vs_b_highs(known: Known, factor: float):
    assert known.time is not None
    posed = known.problem()
    ours = solved(posed, factor * known.time)
    displacement = float(known.maneuver.displacement)
    theirs = reachable_fraction(StateSpace.of(known.plant()), displacement, posed.lower, posed.upper, factor * known.time, CELLS)
    assert ours.fraction == pytest.approx(theirs, rel=1e-6, abs=1e-7)  # HiGHS meets its equations to 1e-7
    assert ours.residual < SOLVER or ours.fraction < 1e-6  # it is relative to what is reached


@pytest.mark.parametrize("known", FACTS, ids=lambda k: k.name)
def test_the_multiplier_is_the_costate_of_the_staircase(known: Known):
    assert known.time is not None
    posed = known.problem()
    solution = solved(posed, 0.9 * known.time, 300)
    assert solution.costate @ posed.target == pytest.approx(1.0, rel=SOLVER)
    edges = posed.rows(solution.maneuver_time - solution.program.instants, 1)
    integrals = solution.costate @ (edges[:, :-1] - edges[:, 1:])
    # Strong duality on the grid: the right sign, the right size. With the wrong sign this would be negative.
    dual = np.where(integrals > 0, posed.upper, posed.lower) @ integrals
    assert dual == pytest.approx(solution.fraction, rel=1e-6)
    # Complementary slackness: wherever the costate's integral is not small the level is on the limit of its sign.
    clear = np.abs(integrals) > 1e-4 * np.abs(integrals).max()
    expected = np.where(integrals > 0, posed.upper, posed.lower)
    np.testing.assert_allclose(solution.levels[clear], expected[clear], atol=1e-4 * (posed.upper - posed.lower))


def test_the_slope_of_the_fraction_is_the_costate_at_the_horizon():
    posed = problem([two_mass()], Maneuver(exact(1), Limits.of(-1, 1)))
    times = np.array([3.9, 3.9 + 1e-4])
    fractions = [solved(posed, t, 2000).fraction for t in times]
    costate = solved(posed, 3.9, 2000).costate
    slope = abs(float(costate @ posed.rows([3.9])[:, 0]))
    # The grid's fraction is short of the continuous one by O(1/N²) of itself, and smoothly so.
    assert (fractions[1] - fractions[0]) / 1e-4 == pytest.approx(slope, rel=1e-2)


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e3, 1e6])
def test_units_of_time_do_not_matter(unit: float):
    # ω → ω/unit and gain → gain/unit⁴ … is the same plant with a clock that counts in other units.
    k = exact(unit) ** 2
    slow = LinearPlant.from_state_space(
        [[0, 0, 1, 0], [0, 0, 0, 1], [-1 / k, 1 / k, 0, 0], [1 / k, -1 / k, 0, 0]], [0, 0, 1 / k, 0], [0, 1, 0, 0]
    )
    reference = solved(problem([two_mass()], Maneuver(exact(1), Limits.of(-1, 1))), 4.0)
    scaled = solved(problem([slow], Maneuver(exact(1), Limits.of(-1, 1))), 4.0 * unit)
    assert scaled.fraction == pytest.approx(reference.fraction, rel=SOLVER)
    np.testing.assert_allclose(scaled.levels, reference.levels, atol=1e-4)  # where the costate vanishes a level is free to SOLVER/costate


@pytest.mark.parametrize("unit", ["1e-6", "1e-3", "1e3", "1e6"])
def test_units_of_input_and_output_do_not_matter(unit: str):
    reference = bracket(problem([two_mass()], Maneuver(exact(1), Limits.of(-1, 1))))
    force = bracket(problem([two_mass()], Maneuver(exact(unit), Limits.of(f"-{unit}", unit))))
    assert reference.upper is not None
    assert force.upper == pytest.approx(reference.upper, rel=1e-14)  # a few roundings of T
    fast = bracket(problem([two_mass(stiffness=exact(unit) ** 2)], Maneuver(1 / exact(unit) ** 2, Limits.of(-1, 1))))
    assert fast.upper == pytest.approx(reference.upper / float(unit), rel=1e-14)


def test_the_fraction_grows_with_time_and_with_the_limits():
    posed = [problem([chain(4)], Maneuver(exact(2), Limits.of(-1, high))) for high in (1, "1.2")]
    fractions = [[solved(p, t).fraction for t in (6.0, 8.0, 9.0, 10.0)] for p in posed]
    assert np.all(np.diff(fractions, axis=1) > 0)
    assert np.all(np.diff(fractions, axis=0) > 0)


def test_one_sided_limits_may_reach_nothing_at_all():
    # An oscillator that can only be pushed: α ≡ 0 up to T = 1.5 for a whole swing; a multiplier is found all the same.
    posed = problem([LinearPlant.from_transfer([1], [1, 0, 1])], Maneuver(exact(1), Limits.of(0, 1)))
    solution = solved(posed, 1.2)
    assert solution.fraction == pytest.approx(0.0, abs=1e-7)
    assert solution.costate @ posed.target == pytest.approx(1.0, rel=1e-6)


def test_levels_are_inside_the_limits_to_the_last_bit():
    posed = problem([two_mass()], Maneuver(exact(1), Limits.of("-0.3", "0.7"), exact("0.1")))
    levels = solved(posed, 6.0).levels
    assert levels.min() >= posed.lower
    assert levels.max() <= posed.upper


def test_the_same_program_gives_the_same_bytes():
    posed = problem([chain(4)], Maneuver(exact(2), Limits.of(-1, 1)))
    first, second = solved(posed, 9.0), solved(posed, 9.0)
    assert first.levels.tobytes() == second.levels.tobytes()
    assert first.costate.tobytes() == second.costate.tobytes()


def test_a_grid_that_is_too_coarse_for_the_equations_is_refused():
    with pytest.raises(SolverError, match="dependent on 5 intervals"):
        posing.build(problem([chain(4)], Maneuver(exact(2), Limits.of(-1, 1))), np.linspace(0, 9, 6))


def test_rows_of_very_different_size_are_not_taken_for_dependent():
    # e^{100 s} beside e^{-s}: forty decades apart, and independent.
    posed = problem([LinearPlant.from_zeros_poles([], [100, -1], 100)], Maneuver(exact("0.5"), Limits.of(-1, 1)))
    assert 0 < solved(posed, 0.5).fraction < 1


def test_a_solution_judges_itself():
    solution = solved(problem([two_mass()], Maneuver(exact(1), Limits.of(-1, 1))), 5.0)
    assert solution.fraction > 1
    assert solution.reaches
    assert not solved(problem([two_mass()], Maneuver(exact(1), Limits.of(-1, 1))), 4.0).reaches


# What the command's energy allows.


@pytest.mark.parametrize("known", [k for k in KNOWN if k.time], ids=lambda known: known.name)
@pytest.mark.parametrize("factor", [0.5, 0.9, 1.0, 1.3])
def test_no_command_reaches_more_than_its_energy_allows(known: Known, factor: float):
    assert known.time is not None
    posed = known.problem()
    instants = bounds.instants(posed, factor * known.time, bounds.Settings())
    most = energy_bound(posed, instants)
    assert programs.solve(posing.build(posed, instants)).fraction <= most * (1 + 1e-6)  # the solver's tolerance
    assert most >= 1.0 - 1e-4 or factor < 1.0  # the grid's staircase falls short of the command by as much


def test_energy_is_exact_where_the_command_is_constant():
    """1/s: the whole range all the time is the only command of that energy, and α = T/T*."""
    posed = problem([LinearPlant.from_transfer([1], [1, 0])], Maneuver(exact(3), Limits.of(-2, 2)))
    assert energy_bound(posed, np.linspace(0.0, 1.2, 50)) == pytest.approx(1.2 / 1.5, rel=1e-13)


@pytest.mark.slow
def test_energy_says_how_short_a_time_is_that_doubles_cannot_resolve():
    """100 poles in a fifth of their 121 s: the equations are dependent to 1e-80, the bound need not be."""
    posed = problem([chain(50)], Maneuver(exact(5), Limits.of(-1, 1)))
    assert energy_bound(posed, np.linspace(0.0, 25.0, 2501)) < 1e-8
    assert energy_bound(posed, np.linspace(0.0, 121.06, 2501)) > 1.0


def test_a_tail_that_does_everything_needs_no_energy():
    plant = LinearPlant.from_transfer([1, 2, 3], [1, 0, 1])
    posed = problem([plant], Maneuver(exact(1), Limits.of(-1, 1), tail=True))
    assert energy_bound(posed, np.linspace(0.0, 1.0, 50)) == np.inf
