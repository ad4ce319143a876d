"""Where grid instants lie."""

from __future__ import annotations

import numpy as np
import pytest
from problems import KNOWN, Known, two_mass

from relaxations.errors import SolverError
from relaxations.grids import grid
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact


def posed(plant: LinearPlant, displacement: str = "0.5") -> Problem:
    return problem([plant], Maneuver(exact(displacement), Limits.of(-1, 1)))


@pytest.mark.parametrize("known", KNOWN, ids=lambda known: known.name)
@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_instants_ascend_from_zero_to_the_horizon(known: Known, factor: float):
    horizon = known.time * factor if known.time else factor
    instants = grid(known.problem(), horizon, 200, 12, 20_000)
    assert instants[0] == 0.0
    assert instants[-1] == horizon
    assert (np.diff(instants) > 0).all()


def test_a_rigid_body_has_a_uniform_grid():
    instants = grid(posed(LinearPlant.from_transfer([1], [1, 0, 0])), 3.0, 200, 12, 20_000)
    np.testing.assert_allclose(instants, np.linspace(0, 3, 201), atol=1e-14)


def test_an_undamped_mode_is_resolved_everywhere_in_numbers_that_are_doubled():
    horizon = 1000.0
    instants = grid(posed(two_mass()), horizon, 200, 12, 20_000)
    cells = len(instants) - 1
    assert cells in {200 * 2**k for k in range(8)}
    period = 2 * np.pi / np.sqrt(2)
    assert np.diff(instants).max() < period / 11


def test_a_fast_decay_is_resolved_at_the_end_and_a_fast_growth_at_the_beginning():
    for poles, near in (([-1, -1e4], -1), ([-1, 1e4], 0)):
        instants = grid(posed(LinearPlant.from_zeros_poles([], poles, 1), "1e-5"), 10.0, 200, 12, 20_000)
        widths = np.diff(instants)
        assert widths[near] < 1e-3
        assert len(widths) <= 400
        assert widths.max() < 0.3


def test_no_more_cells_than_asked_for_however_fast_the_mode():
    instants = grid(posed(two_mass(stiffness=100)), 1e2, 200, 12, 1000)  # 225 periods want 2700 cells
    assert len(instants) - 1 == 1600  # the first number of doublings at or above it


def test_a_move_of_countless_periods_is_not_pretended_to_be_resolved():
    with pytest.raises(SolverError, match="periods"):
        grid(posed(two_mass(stiffness="1e12")), 1e3, 200, 12, 1000)
