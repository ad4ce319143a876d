"""The linear program of a box of plants that vary: the least residual that a staircase can leave, and its multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.errors import SolverError

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Nearest:
    """What the solver found of `nearest`: levels (N,), the excess s, the multipliers of both sides of the rows (k,), of the sums (m,)."""

    levels: Reals
    excess: float
    above: Reals
    below: Reals
    sums: Reals


def nearest(rows: Reals, aims: Reals, exact: Reals, target: Reals, limits: tuple[float, float]) -> Nearest:
    """Minimise s subject to `|rows v - aims| ≤ s`, `exact v = target` and v within the limits. Raises `SolverError`.

    By duality `s = -(above - below) aims - sums target - Σ max over v of -((above - below) rows + sums exact) v`, Σ(above + below) = 1.
    """
    cp = programs.modelling()
    half, sizes = (limits[1] - limits[0]) / 2, np.maximum(np.abs(exact).max(axis=1, initial=0.0), np.finfo(float).tiny)
    size = max(1.0, float(np.abs(aims).max(initial=0.0)))  # of s: tolerances may be small beside the move
    v, s = cp.Variable(rows.shape[1]), cp.Variable()
    reached = (rows * half / size) @ v - aims / size
    sides: list[Any] = [reached <= s, -reached <= s, v <= limits[1] / half, v >= limits[0] / half]
    summed: list[Any] = [(exact / sizes[:, None]) @ v == target / sizes / half] if len(exact) else []
    program = cp.Problem(cp.Minimize(s), [*sides, *summed])
    programs.run(program, "program of a box")
    if v.value is None or s.value is None or sides[0].dual_value is None:
        raise SolverError(f"the program of a box has no answer: {program.status}")
    above, below = (np.maximum(np.asarray(side.dual_value), 0.0) for side in sides[:2])
    sums = np.asarray(summed[0].dual_value) * size / sizes / half if summed else np.zeros(0)
    return Nearest(np.clip(v.value * half, *limits), float(s.value) * size, above, below, sums)
