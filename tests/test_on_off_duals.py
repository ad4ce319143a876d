"""Where a costate crosses its price: every arc is seen, however thin, and every crossing is a root."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from problems import transfer

from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.onoff.duals import Looks, Windows, evaluated
from relaxations.plants import exact

PLANTS: list[Any] = [([1], [1, 0, 2, 0, 0]), ([1], [1, 0.1, 2, 0, 0]), ([1, 1], [1, 0.3, 4, 1, 0]), ([1], [1, 0.2, 5, 0.3, 4, 0, 0])]


def looks(plant: Any, robustness: int) -> Looks:
    posed = problem([transfer(*plant)()], Maneuver(exact("5"), Limits.of(-1, 1), robustness=robustness))
    return Looks.of(posed, 7.7, 1)


@pytest.mark.parametrize("plant", PLANTS, ids=str)
@pytest.mark.parametrize("robustness", [0, 1])
@pytest.mark.parametrize("height", [1e-3, 1e-6, -1e-6])
def test_arcs_between_samples_are_seen(plant: Any, robustness: int, height: float) -> None:
    """Prices a little below a peak of |p|, or a little above it, with changes of sign on a grid a hundred times as fine."""
    seen, random = looks(plant, robustness), np.random.default_rng(7)
    fine = np.linspace(0.0, seen.maneuver_time, 100 * (len(seen.grid) - 1) + 1)
    table = seen.rows(fine)
    tried = 0
    for _ in range(20):
        costate = random.normal(size=len(seen.table))
        for side in (1, -1):
            p = side * (costate @ table)
            peaks = 200 + np.flatnonzero((p[200:-200] > p[199:-201]) & (p[200:-200] > p[201:-199]))
            for at in peaks:
                price = float(p[at] * (1.0 - height))
                if price <= 0.0:
                    continue
                roots = seen.crossings(costate, side, price)
                values = side * (costate @ seen.rows(roots)) - price
                assert np.abs(values).max(initial=0.0) <= 1e-12 * np.abs(p).max()
                off = p < price
                changes = fine[np.flatnonzero(off[1:] != off[:-1])]
                found = [np.any((roots >= change - 1e-9) & (roots <= change + fine[1] + 1e-9)) for change in changes]
                assert all(found), (side, price, changes[np.logical_not(found)])
                tried += len(changes)
    assert tried >= 10


@pytest.mark.slow
def test_the_support_is_that_of_quadrature_where_arcs_are_thin() -> None:
    seen, random = looks(PLANTS[0], 1), np.random.default_rng(3)
    fine = np.linspace(0.0, seen.maneuver_time, 2_000_001)
    table = seen.rows(fine)
    for _ in range(5):
        costate = random.normal(size=len(seen.table))
        p = costate @ table
        price = float(np.abs(p).max()) * (1.0 - 1e-5)
        found = evaluated(seen, Windows(0.0, seen.maneuver_time), costate, price, 0.0)
        true = float(np.trapezoid(np.maximum(np.abs(p) - price, 0.0), fine))
        assert found.value == pytest.approx(true, rel=1e-3)  # a hundred samples or so of what is thin
