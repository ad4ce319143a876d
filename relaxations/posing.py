"""The rows of the linear program of a problem on a grid of instants, in numbers: what `relaxations.programs` solves.

The equations are replaced by an orthonormal basis of their span, so that no scaling of poles, time or units is left in them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relaxations.conditioning import framed
from relaxations.courses import Motion, motion
from relaxations.errors import ShortHorizonError
from relaxations.maneuvers import Problem
from relaxations.robust.residuals import Residuals
from relaxations.tails import Looks
from relaxations.varying_courses import VaryingCourse, varying_motion

Reals = NDArray[np.float64]

LOST = 1e-12  # of the largest singular value: smaller ones are rounding
DEPENDENT, LOOSE = 1e-4, 1e-2  # what a row adds to those before it, relative to it: where it is less a frame, or another one, is made
MARGIN = 0.02  # how much longer than the move a frame is, so that it serves for the moves that are looked at next


@dataclass(frozen=True, slots=True)
class GridProgram:
    """The program as built, of `problem` in the coordinates chosen for it.

    `instants` (N + 1,) of the grid [s] from 0 to the maneuver time, `rows` (m, N) orthonormal, `target` (m,), `basis_change` R with
    rows = R^{-T} · table, limits in input units; of the tail `columns` (m, n) in the same rows, and its limits `shapes` (k, n) with the
    room `above` and `below` (k,): at the instants `looks` [s] after the move first, of the input and then of its other aspects (`aspect`,
    0 the input, each measured in its `unit`), then the faces of its caps, of these `bounds` at the places `capped` of its coefficients. The
    courses of the move (`motion`) are limited to 1 on either side of zero at α = 1, where they come to rest at `finals`, and to what is
    left of that beside `α finals` else. All limits but the input's are tightened by the fraction `inside`.
    """

    problem: Problem
    instants: Reals
    rows: Reals
    target: Reals
    basis_change: Reals
    lower: float
    upper: float
    columns: Reals
    looks: Reals
    shapes: Reals
    above: Reals
    below: Reals
    bounds: Reals
    capped: tuple[tuple[int, ...], ...]
    aspect: NDArray[np.intp]
    unit: Reals
    motion: Motion | None = None
    inside: float = 0.0

    @property
    def maneuver_time(self) -> float:
        """T [s]."""
        return float(self.instants[-1])


def build(problem: Problem, instants: Reals, looks: Looks | None = None, inside: float = 0.0) -> GridProgram:
    """The program on the grid of `instants` [s], ascending from 0 to the maneuver time; raises `ShortHorizonError` if too short a time.

    `looks` says where the tail's limits are imposed (None: as the problem's tail does at first), tightened by the fraction `inside`.
    """
    horizon, cells = float(instants[-1]), len(instants) - 1
    if problem.frame and problem.frame.horizon < horizon:
        problem = framed(problem, horizon * (1.0 + MARGIN)) or replace(problem, frame=None)
    orthonormal, change, least = _orthonormal(problem, instants)
    if least < (LOOSE if problem.frame else DEPENDENT) and cells >= problem.size and (other := framed(problem, horizon * (1.0 + MARGIN))):
        problem = other
        orthonormal, change, least = _orthonormal(problem, instants)
    if cells < problem.size or least <= cells * np.finfo(float).eps:
        raise ShortHorizonError(f"the moment equations are dependent on {cells} intervals over {horizon!r} s")
    target: Reals = np.linalg.solve(change.T, problem.aimed(horizon)).astype(np.float64)
    columns: Reals = np.linalg.solve(change.T, problem.tail.columns).astype(np.float64)
    moves = problem, instants, orthonormal.T, target, change, problem.lower, problem.upper, columns
    extra = looks.moving if looks else np.zeros((0, 2))
    bent = _motion(problem, instants, extra), inside
    if problem.residuals is not None:
        return _with_residuals(GridProgram(*moves, *_NO_LIMITS, *bent), problem.residuals, looks, inside)
    tail = problem.tail
    at, (faces, room) = looks or tail.looks(), tail.faces((looks or tail.looks()).turns)
    above, below = (np.concatenate([side, room]) * (1.0 - inside) for side in tail.room(at.instants))
    shapes, bounds = [tail.rows(at.instants)], np.array([cap.bound for cap in tail.caps]) * (1.0 - inside)
    sides, units = [(above, below)], [1.0]
    count, half = len(at.instants), (problem.upper - problem.lower) / 2
    above, below = above[:count], below[:count]
    for one in tail.aspects:
        units.append(half / max(one.above, one.below))
        shapes.append(units[-1] * shapes[0] @ one.turned)
        rooms = [np.full(count, units[-1] * side * (1.0 - inside)) for side in (one.above, one.below)]
        above, below = np.concatenate([above, rooms[0]]), np.concatenate([below, rooms[1]])
    above, below = np.concatenate([above, sides[0][0][count:]]), np.concatenate([below, sides[0][1][count:]])
    aspect = np.repeat(np.arange(len(units)), count)
    timed = np.tile(at.instants, len(units))
    caps = tuple(cap.at for cap in tail.caps)
    return GridProgram(*moves, timed, np.vstack([*shapes, faces]), above, below, bounds, caps, aspect, np.array(units)[aspect], *bent)


def _motion(problem: Problem, instants: Reals, extra: Reals) -> Motion | None:
    """The rows of the courses that are limited, at nodes and at `extra` places."""
    varying = [course for course in problem.courses if isinstance(course, VaryingCourse)]
    if varying:
        return varying_motion(varying, instants, extra, problem.sloped)
    return motion(problem.courses, instants, extra, problem.sloped) if problem.courses else None


def _orthonormal(problem: Problem, instants: Reals) -> tuple[Reals, Reals, float]:
    """Q and R of the transposed table of moments on the grid, and the least share of a row that is not a combination of those before."""
    if not problem.size:
        return np.zeros((len(instants) - 1, 0)), np.zeros((0, 0)), 1.0
    orthonormal, change = np.linalg.qr(problem.table(instants).T)
    with np.errstate(over="ignore"):  # what is too large to be measured counts as dependent
        lengths = np.linalg.norm(change, axis=0)
    return orthonormal, change, float(np.min(np.abs(np.diag(change)) / lengths[: len(change)]))


_NO_LIMITS = np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0), (), np.zeros(0, dtype=np.intp), np.zeros(0)


def _with_residuals(program: GridProgram, residuals: Residuals, looks: Looks | None, inside: float) -> GridProgram:
    """The limits `-α below ≤ R M - α e ≤ α above`, for the few directions that the moments have: `W u = z`, orthonormal, z free as a tail.

    The motions of neighbouring plants hardly differ in the time that a move lasts, so their rows are dependent but for rounding.
    """
    at = residuals.looks() if looks is None else looks.instants
    rows, offset = residuals.rows(at)
    left, size, right = np.linalg.svd(residuals.table(program.instants, program.problem.sloped), full_matrices=False)
    kept = size > LOST * size.max(initial=0.0)
    shapes, directions = rows @ (left[:, kept] * size[kept]), right[kept]
    (below, above), free = residuals.rooms(at), len(directions)
    return replace(
        program,
        rows=np.vstack([program.rows, directions]),
        target=np.concatenate([program.target, np.zeros(free)]),
        columns=np.vstack([np.zeros((len(program.target), free)), np.eye(free)]),
        looks=at,
        aspect=np.zeros(len(at), dtype=np.intp),
        unit=np.ones(len(at)),
        shapes=shapes,
        above=above * (1.0 - inside) + offset,
        below=below * (1.0 - inside) - offset,
    )
