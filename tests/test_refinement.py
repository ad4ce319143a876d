"""Newton's method on the switch times: known instants, rough starts, degenerate optima, and wrong patterns that must be refused."""

from __future__ import annotations

import numpy as np
import pytest
from marks import first
from problems import AWKWARD, FACTS, KNOWN, Known, chain, two_mass

from relaxations.bounds import Settings, grid_minimum
from relaxations.duality import lower_bound
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.moments import Basis
from relaxations.plants import LinearPlant, exact
from relaxations.refinement import Extremal, Failure, moment_residual, refine
from relaxations.response import moments

DIGITS = 5e-11  # half a unit of the tenth decimal, to which the switch times are given


def start(posed: Problem) -> tuple[np.ndarray, float]:
    grid = grid_minimum(posed, Settings())
    solution = grid.above or grid.below
    assert solution is not None
    return solution.costate, solution.maneuver_time


def refined(posed: Problem) -> Extremal:
    found = refine(posed, *start(posed))
    assert isinstance(found, Extremal), found
    return found


@pytest.mark.parametrize("known", [k for k in KNOWN if k.switches], ids=lambda k: k.name)
def test_switch_times_are_the_known_ones(known: Known):
    posed = known.problem()
    command = refined(posed).command(posed)
    np.testing.assert_allclose([s.start for s in command.segments[1:]], known.switches, rtol=0, atol=DIGITS + 1e-13)


@pytest.mark.parametrize("known", KNOWN, ids=lambda k: k.name)
def test_an_extremal_meets_the_moments_and_its_costate_vanishes_at_its_switches(known: Known):
    posed = known.problem()
    found = refined(posed)
    assert known.time is not None
    assert abs(found.maneuver_time - known.time) <= known.error + 1e-13 * known.time
    edges = np.concatenate([[0.0], found.switches_to_go, [found.maneuver_time]])
    residual, _ = moment_residual(posed, found.levels, edges)
    size = np.abs(posed.rows(np.linspace(0, found.maneuver_time, 400))).max(axis=1) * found.maneuver_time * max(posed.upper, -posed.lower)
    assert np.abs(residual / size).max() < 1e-14  # rounding of the instants: 1e-16 T each, times b
    at = posed.rows(found.switches_to_go)
    assert np.all(np.abs(found.costate @ at) <= 1e-11 * (np.abs(found.costate) @ np.abs(at)))
    assert found.costate @ posed.target == pytest.approx(1.0, rel=1e-12)
    # What the command does, counted from its own segments, forward in time.
    landed = np.concatenate([moments(t.basis, found.command(posed), found.maneuver_time, posed.rest) for t in posed.sets])
    assert np.abs((landed - posed.target) / size).max() < 1e-14


@pytest.mark.parametrize("known", [k for k in FACTS if k.plant().order <= 8], ids=lambda k: k.name)
@pytest.mark.parametrize("seed", first(1, range(3)))
def test_a_rough_start_finds_the_same_command_or_says_why_not(known: Known, seed: int):
    assert known.time is not None
    posed = known.problem()
    costate, time = start(posed)
    rng = np.random.default_rng(seed)
    for size in (1e-4, 1e-2, 0.1, 0.5):
        found = refine(posed, costate * (1 + size * rng.normal(size=posed.size)), time * (1 + size * abs(rng.normal())))
        if isinstance(found, Failure):
            assert found.reason
            assert size > 1e-3, found.reason  # a start as good as a grid's must do
        else:
            # An extremal is optimal: there is no second one.
            assert found.maneuver_time == pytest.approx(known.time, abs=known.error + 1e-12)


def test_a_pattern_of_another_problem_is_refused():
    # Signs of the costate that no command for this displacement has: the bracket would not close.
    posed = problem([two_mass()], Maneuver(exact(5), Limits.of(-1, 1)))
    costate, time = start(problem([two_mass()], Maneuver(exact("0.05"), Limits.of(-1, 1))))
    for factor in (0.2, 0.5, 1.0, 3.0, 10.0):
        found = refine(posed, costate, time * factor)
        if isinstance(found, Extremal):
            assert found.maneuver_time == pytest.approx(6.6627284203, abs=DIGITS)
            assert lower_bound(posed, found.costate, found.maneuver_time) >= found.maneuver_time * (1 - 1e-11)
        else:
            assert "switches" in found.reason


def test_a_costate_without_a_switch_cannot_stop_a_rigid_body():
    posed = problem([LinearPlant.from_transfer([1], [1, 0, 0])], Maneuver(exact(1), Limits.of(-1, 1)))
    assert isinstance(refine(posed, np.array([1.0, 1.0]), 2.0), Failure)


def test_fewer_switches_than_equations_are_solved_all_the_same():
    known = next(k for k in AWKWARD if k.name == "two_mass_one_switch")
    posed = known.problem()
    found = refined(posed)
    assert len(found.switches_to_go) == 1  # four equations
    assert found.switches_to_go[0] == pytest.approx(found.maneuver_time / 2, rel=1e-12)


def test_fast_growth_does_not_hide_the_slow_modes():
    # A pole at 100 rad/s for 0.7 s: rows e^{70} apart.
    posed = problem([LinearPlant.from_zeros_poles([], [100, -1], 100)], Maneuver(exact("0.5"), Limits.of(-1, 1)))
    found = refined(posed)
    assert lower_bound(posed, found.costate, found.maneuver_time) >= found.maneuver_time * (1 - 1e-11)


def test_robust_commands_meet_the_derivatives_too():
    posed = problem([chain(3)], Maneuver(exact(1), Limits.of(-1, 1), robustness=1))
    command = refined(posed).command(posed)
    # The residual of the moment at a slightly wrong frequency is of second order.
    poles = chain(3).flexible
    for pole in poles:
        off = [float(np.linalg.norm(moments(Basis((type(pole)(pole.value * (1 + d), 1),)), command, command.end))) for d in (1e-3, 2e-3)]
        assert off[1] / off[0] == pytest.approx(4.0, rel=0.05)


def test_levels_alternate_between_the_limits():
    posed = problem([two_mass()], Maneuver(exact(-5), Limits.of("-0.3", "0.7"), exact("0.1")))
    command = refined(posed).command(posed)
    assert {s.level for s in command.segments} == {-0.3, 0.7}
    assert all(a.level != b.level for a, b in zip(command.segments, command.segments[1:], strict=False))
    assert command.tail.steady == 0.1
