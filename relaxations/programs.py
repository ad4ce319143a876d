"""The linear program on a fixed grid of impulse amplitudes: the one door to cvxpy and Clarabel.

At a fixed maneuver time the *reachable fraction* α of the target is maximised (../docs/theory.md, section 2):

    maximise α   subject to   Q u = α q,   u_k = Σ_{i≤k} A_i,   lower ≤ u ≤ upper

over the impulse amplitudes A and the staircase u that they add up to. The rows are orthonormal, so that no scaling of poles, time or
units is left in them, and the program is always feasible. Solver status is never evidence: what comes out is a candidate.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import SolverError
from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

SETTINGS: dict[str, Any] = {
    # Pinned so that the same inputs give the same bytes; 1e-10 is what grids up to 10⁵ points still reach.
    "direct_solve_method": "qdldl",
    "max_threads": 1,
    "tol_gap_abs": 1e-10,
    "tol_gap_rel": 1e-10,
    "tol_feas": 1e-10,
}


RESIDUAL = 1e-8  # relative; the solver's 1e-10 with room for limits far from the amplitudes used


@dataclass(frozen=True, slots=True)
class GridProgram:
    """The program as built: `instants` (N + 1,) of the grid [s] from 0 to the maneuver time, `rows` (m, N) orthonormal, `target` (m,),
    `basis_change` R with rows = R^{-T} · table, limits in input units."""

    instants: Reals
    rows: Reals
    target: Reals
    basis_change: Reals
    lower: float
    upper: float

    @property
    def maneuver_time(self) -> float:
        """T [s]."""
        return float(self.instants[-1])


@dataclass(frozen=True, slots=True)
class GridSolution:
    """What the solver found: fraction α, levels u (N,) in deviations, multiplier λ (size,) of the moment equations with `λᵀ target = 1`."""

    program: GridProgram
    fraction: float
    levels: Reals
    costate: Reals
    status: str

    @property
    def residual(self) -> float:
        """Violation of the orthonormal rows relative to the part of the target reached (a solution judges itself)."""
        reached = self.fraction * self.program.target
        size = float(np.linalg.norm(reached))
        return float(np.linalg.norm(self.program.rows @ self.levels - reached)) / size if size > 0.0 else np.inf

    @property
    def reaches(self) -> bool:
        """Whether the levels, divided by α, are a command that lands on the target: α ≥ 1, and not by the solver's tolerance alone."""
        return self.fraction >= 1.0 and self.residual <= RESIDUAL


def build(problem: Problem, instants: Reals) -> GridProgram:
    """The program on the grid of `instants` [s], ascending from 0 to the maneuver time; raises `SolverError` if it is too coarse."""
    cells = len(instants) - 1
    integrated = problem.rows(instants[-1] - instants, 1)
    table = integrated[:, :-1] - integrated[:, 1:]
    orthonormal, change = np.linalg.qr(table.T)
    if np.any(np.abs(np.diag(change)) <= cells * np.finfo(float).eps * np.linalg.norm(change, axis=0)):
        raise SolverError(f"the moment equations are dependent on {cells} intervals over {float(instants[-1])!r} s")
    target = np.linalg.solve(change.T, problem.target)
    return GridProgram(instants, orthonormal.T, target, change, problem.lower, problem.upper)


@lru_cache(maxsize=8)
def _compiled(size: int, cells: int) -> dict[str, Any]:
    """The parametrised cvxpy problem of one shape, compiled once (a re-solve then costs a tenth)."""
    import cvxpy as cp

    rows, target = cp.Parameter((size, cells)), cp.Parameter(size)
    lower, upper = cp.Parameter(), cp.Parameter()
    amplitudes, levels, fraction = cp.Variable(cells), cp.Variable(cells), cp.Variable()
    reach = rows @ levels == fraction * target
    constraints = [reach, levels[0] == amplitudes[0], cp.diff(levels) == amplitudes[1:], levels >= lower, levels <= upper]
    return {
        "problem": cp.Problem(cp.Maximize(fraction), constraints),
        "rows": rows,
        "target": target,
        "lower": lower,
        "upper": upper,
        "levels": levels,
        "fraction": fraction,
        "reach": reach,
    }


def solve(program: GridProgram) -> GridSolution:
    """Maximise the reachable fraction; raises `SolverError` with the status if the solver gives no numbers."""
    import cvxpy as cp

    compiled = _compiled(*program.rows.shape)
    # Levels are measured in half the actuator's range and the target in its own length, so that every number is of order one.
    half = (program.upper - program.lower) / 2
    length = float(np.linalg.norm(program.target)) / np.sqrt(program.rows.shape[1])
    compiled["rows"].value = program.rows
    compiled["target"].value = program.target / length
    compiled["lower"].value = program.lower / half
    compiled["upper"].value = program.upper / half
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "solution may be inaccurate": judged below, by what is used of it
        try:
            compiled["problem"].solve(solver=cp.CLARABEL, **SETTINGS)
        except cp.error.SolverError as problem:
            raise SolverError(f"Clarabel found nothing at T = {program.maneuver_time!r} s: {problem}") from None
    status = str(compiled["problem"].status)
    if compiled["levels"].value is None or compiled["reach"].dual_value is None:
        raise SolverError(f"Clarabel found nothing at T = {program.maneuver_time!r} s: status {status}")
    levels = half * np.clip(compiled["levels"].value, program.lower / half, program.upper / half)
    multiplier = np.asarray(compiled["reach"].dual_value)
    # The sign of a multiplier is a convention of the solver; the costate is the one whose maximisers the levels are (weak duality).
    scale = float(multiplier @ program.target)
    if scale == 0.0:
        raise SolverError(f"the multiplier at T = {program.maneuver_time!r} s vanishes on the target")
    costate = np.linalg.solve(program.basis_change, multiplier / scale)
    return GridSolution(program, half * float(compiled["fraction"].value) / length, levels, costate, status)
