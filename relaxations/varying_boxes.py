"""The minimum time of a box of plants that vary: finitely many, each with its schedule, one command, a residual within a tolerance.

The time T is the root of s(T) = 1 for the least s with which some command leaves `|y - target| ≤ s V |Δ|` in every plant, at instants from
T on, while it still varies and after. Seen from the beginning (`relaxations.transitions`) the residual at t_k is the row `c(t_k) Φ(t_k, 0)`
times `∫ g v dt - (x_ss - x_0)`. States that are integrals of the input, the same ones in all plants, come to rest exactly. Residuals are
looked at where they are largest (cutting planes), cells are cut where the command changes, and the checker decides what was proven.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from flint import fmpq_mat
from numpy.typing import NDArray

from relaxations import certificates
from relaxations.bounds import NOT_PROVEN, Bound, Status
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ManeuverError, SolverError
from relaxations.maneuvers import Maneuver, Problem
from relaxations.nearest import Nearest, nearest
from relaxations.plants import fraction, rational
from relaxations.repair import pivots
from relaxations.robust.boxes import Axis, Place
from relaxations.sides import Proof, Side, accepted, concluded
from relaxations.transitions import VaryingPlant
from relaxations.varying import varying_problem
from relaxations.varying_courses import flows

Reals = NDArray[np.float64]

CELLS, ZOOMS, PARTS = 64, 3, 8  # of a grid at first; how often those are cut in which the command changes, and into how many
LOOKS, FINE, PERIODS, LATER = 12, 16, 1.5, 12.0  # looks at a residual a period, how much finer it is searched, for how many periods
CUTS, PEAKS = 6, 3  # rounds of cuts, and how many looks a plant gets in one
MOST, ROUGH, CLOSE, NARROW, TINY = 40, 1e-5, 1e-10, 1e-13, 1e-12  # programs for one root; how close log s comes to 0, at first and last
OVER = 1e-9  # relative: a residual that much beyond its limit is cut off
BEYOND = (1e-9, 1e-8, 1e-7, 3e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3)
"""How far beyond the root (relative) the proven command may last, and before it the refuted time."""
SNAP, SMALL = 1e-7, 1e-3  # of the range: levels that close to a limit are on it; smaller jumps are none


@dataclass(frozen=True)
class VaryingBox:
    """Plants at places of a box; each may keep a residual of `tolerance` |Δ| from the end of the move on.

    Raises `ManeuverError` unless places lie in the ranges, each once, the nominal one among them, all plants have the same instants and the
    same number of states, and the tolerance is more than 0.
    """

    axes: tuple[Axis, ...]
    members: tuple[tuple[Place, VaryingPlant], ...]
    tolerance: Fraction

    def __post_init__(self) -> None:
        places = [place for place, _ in self.members]
        if not self.tolerance > 0:
            raise ManeuverError(f"a tolerance is more than 0, not {float(self.tolerance)!r}")
        fine = all(len(p) == len(self.axes) and all(a.low <= x <= a.high for a, x in zip(self.axes, p, strict=True)) for p in places)
        if not fine or len(set(places)) != len(places) or self.nominal not in places:
            raise ManeuverError("plants of a box are at different places of its ranges, the nominal place among them")
        if len({(plant.instants, plant.order, plant.kept) for _, plant in self.members}) != 1:
            raise ManeuverError("plants of a box that vary have the same instants and the same states that the input moves")

    @property
    def nominal(self) -> Place:
        """The nominal place."""
        return tuple(axis.nominal for axis in self.axes)

    @cached_property
    def bodies(self) -> list[int]:
        """States that are integrals, of the input or of such states, by the same constant numbers in all plants."""
        plants, found = [plant for _, plant in self.members], list[int]()
        rows = [{(*A[i], b[i]) for p in plants for A, b in zip(p.A, p.B, strict=True)} for i in range(plants[0].order)]
        while more := [
            i
            for i, own in enumerate(rows)
            if i not in found and len(own) == 1 and not any(x for j, x in enumerate(min(own)[:-1]) if j not in found)
        ]:
            found += more
        return found


@dataclass(frozen=True, slots=True)
class Look:
    """A program's answer at a time T [s]: its nodes [s], what it looked at (plant, seconds after T), and what it found."""

    time: float
    nodes: Reals
    looked: list[tuple[int, float]]
    found: Nearest


@dataclass
class Search:
    """Programs of one task; `shares` are the nodes as fractions of T, `extra` further looks (plant, seconds after T)."""

    box: VaryingBox
    problems: list[Problem]
    shares: Reals
    extra: list[tuple[int, float]]
    count: int = 0
    slope: float = -6.0  # d log s/d log T, as seen last

    @property
    def plants(self) -> list[VaryingPlant]:
        """The plants in the order of the box."""
        return [plant for _, plant in self.box.members]

    @property
    def allowed(self) -> float:
        """What a residual may be."""
        return float(self.box.tolerance * abs(self.problems[0].maneuver.displacement))

    @cached_property
    def paces(self) -> list[tuple[float, float]]:
        """The slowest and the fastest period of what each plant does after its schedule [s]."""
        found = []
        for plant in self.plants:
            own = [i for i in range(plant.order) if i not in self.box.bodies]
            values = np.abs(np.linalg.eigvals(np.array(plant.A[-1], dtype=float)[np.ix_(own, own)])) if own else np.ones(1)
            if not values.min() > 0.0:
                raise ManeuverError(
                    "beside the bodies that all plants of a box share none may have a pole at the origin after its schedule"
                )
            found.append((2 * math.pi / float(values.min()), 2 * math.pi / float(values.max())))
        return found

    def first(self, which: int, horizon: float, periods: float, density: int) -> Reals:
        """Seconds after a move of `horizon` at which the residual of a plant is looked at."""
        (slow, fast), rest = self.paces[which], max(float(self.plants[which].instants[-1]) - horizon, 0.0)
        return np.linspace(0.0, rest + periods * slow, math.ceil((rest + periods * slow) / fast * density) + 1)

    def seen(self, which: int, instants: Reals) -> Reals:
        """The rows c(t) Φ(t, 0) at ascending instants [s]: (len, n)."""
        plant = self.plants[which]
        times = np.array([float(t) for t in plant.instants])
        state, rows = np.eye(plant.order), []
        C = np.array([np.interp(instants, times, column) for column in np.array(plant.C, dtype=float).T]).T
        edges = np.unique(np.concatenate([[0.0], instants]))
        states = [state]
        for Y in flows(np.array(plant.A, dtype=float), times, edges) if len(edges) > 1 else ():
            states.append(Y @ states[-1])
        for c, at in zip(C, np.searchsorted(edges, instants), strict=True):
            rows.append(c @ states[at])
        return np.array(rows).reshape(-1, plant.order)

    def moved(self, which: int, nodes: Reals) -> Reals:
        """The moments of a unit level in each cell: (n, N)."""
        return np.diff(self.problems[which].rows(nodes, 1), axis=1)

    def look(self, horizon: float) -> Look:
        """The least residual that a command of that time leaves."""
        nodes, rows, aims, looked = horizon * self.shares, [], [], list[tuple[int, float]]()
        for which, problem in enumerate(self.problems):
            after = [*self.first(which, horizon, PERIODS, LOOKS), *(tau for k, tau in self.extra if k == which)]
            after = np.unique(after)
            own = self.seen(which, horizon + after) / self.allowed
            rows.append(own @ self.moved(which, nodes))
            aims.append(own @ problem.target)
            looked += [(which, float(tau)) for tau in after]
        first, bodies = self.problems[0], self.box.bodies
        exact = self.moved(0, nodes)[bodies]
        self.count += 1
        found = nearest(np.vstack(rows), np.concatenate(aims), exact, first.target[bodies], (first.lower, first.upper))
        return Look(horizon, nodes, looked, found)

    def cut(self, look: Look, limit: float) -> bool:
        """Add looks where a command's residual has peaks beyond `limit` that were not looked at; whether there are any."""
        more = list[tuple[int, float]]()
        for which, problem in enumerate(self.problems):
            after = self.first(which, look.time, LATER, LOOKS * FINE)
            moments = self.moved(which, look.nodes) @ look.found.levels - problem.target
            size = np.abs(self.seen(which, look.time + after) @ moments) / self.allowed
            a, b, c = size[:-2], size[1:-1], size[2:]
            bend = np.minimum(a - 2 * b + c, -np.finfo(float).tiny)
            tops, shifts = b - (a - c) ** 2 / bend / 8, (a - c) / bend / 2  # of parabolas through three values
            peaks = [int(k) for k in np.flatnonzero((b >= a) & (b >= c) & (tops > limit))]
            for k in sorted(peaks, key=lambda k, tops=tops: (-round(float(tops[k]), 7), k))[:PEAKS]:  # of equal ones the first
                tau = float(after[k + 1] + shifts[k] * (after[1] - after[0]))
                if min((abs(tau - old) for w, old in (*look.looked, *more) if w == which), default=np.inf) > 1e-6 * self.paces[which][1]:
                    more.append((which, tau))
        self.extra += more
        return bool(more)

    def zoom(self, look: Look) -> None:
        """Cut the cells in which the command is between its limits, and those beside a jump; else the nodes are those of the first grid."""
        first, levels, edges = self.problems[0], look.found.levels, self.shares
        span = first.upper - first.lower
        between = np.minimum(levels - first.lower, first.upper - levels) > SMALL * span
        jumps = np.abs(np.diff(levels)) > SMALL * span
        chosen = np.flatnonzero(between | np.append(jumps, False) | np.append(False, jumps))
        parts = [np.linspace(edges[k], edges[k + 1], PARTS + 1) for k in chosen]
        self.shares = np.unique(np.concatenate([np.linspace(0.0, 1.0, CELLS + 1), *parts]).round(14))

    def root(self, near: float, close: float) -> Look:
        """The time at which the least residual is the one that is allowed; raises `SolverError`."""
        low, high, horizon, last = 0.0, math.inf, near, None
        for _ in range(MOST):
            look = self.look(horizon)
            off = math.log(max(look.found.excess, TINY))
            if abs(off) <= close or high / max(low, horizon / 2) - 1.0 <= NARROW:
                return look
            if last is not None and (slope := (off - last[1]) / math.log(horizon / last[0])) < -1e-3:
                self.slope = slope
            last = horizon, off
            low, high = (horizon, high) if off > 0.0 else (low, horizon)
            following = horizon * math.exp(min(max(-off / self.slope, -1.0), 1.0))
            if not low < following < high:
                following = (low + high) / 2 if math.isfinite(high) else 2 * low
            horizon = following
        raise SolverError("no time was found at which a command suits the box")


def varying_box_time(box: VaryingBox, maneuver: Maneuver) -> Bound:
    """Bracket the least time of a command that suits every plant of the box, and prove both sides where that is possible.

    Raises `ManeuverError` for limits other than those of the input, a start that is no rest, plants that are held at the target by
    different inputs, that share no body but keep drifting, or whose rests differ in what they share.
    """
    begun, limits = time.perf_counter(), maneuver.limits
    further = limits.fuel is not None or limits.rate is not None or bool(limits.deflection) or limits.pulsed or bool(limits.held)
    if further or maneuver.sample_time is not None or maneuver.initial is not None:
        raise ManeuverError("a box of plants that vary goes with limits of the input only, and begins at rest")
    if maneuver.box is not None:
        raise ManeuverError("the box is given beside the maneuver, not in it: its plants have schedules")
    problems = [varying_problem(plant, maneuver) for _, plant in box.members]
    if len({problem.maneuver.rest for problem in problems}) != 1:
        raise ManeuverError("one command cannot hold all plants of the box at the target: each needs another final input")
    rests = [plant.rest(maneuver.displacement)[0] for _, plant in box.members]
    if len({tuple(state[i] for i in box.bodies) for state in rests}) != 1:
        raise ManeuverError("the plants of the box come to rest at different places of the bodies that they share")
    nominal = next(problem for (place, _), problem in zip(box.members, problems, strict=True) if place == box.nominal)
    task = certificates.boxed(certificates.task(nominal), box.axes, box.members, box.tolerance)
    search = Search(box, problems, np.linspace(0.0, 1.0, CELLS + 1), [])
    look = search.root(max(slow for slow, _ in search.paces), ROUGH)
    for zoom in range(ZOOMS + 1):
        for _ in range(CUTS):
            if not search.cut(look, 1.0 + (OVER if zoom == ZOOMS else ROUGH)):
                break
            look = search.root(look.time, ROUGH)
        if zoom < ZOOMS:
            search.zoom(look)
            look = search.root(look.time, ROUGH)
    look = search.root(look.time, CLOSE)
    proof = _upper(search, task, look).better(Proof(_lower(search, task, look)))
    found = Bound(Status.BRACKETED, 0.0, None, np.zeros(0), None, None, NOT_PROVEN, search.count, 0.0)
    return replace(concluded(task, proof, found, time.perf_counter() - begun), programs=search.count)


def _lower(search: Search, task: dict[str, Any], look: Look) -> Side | None:
    """The lower side by the program's multipliers, claimed as close to its time as the checker accepts."""
    force = np.maximum(look.found.above, look.found.below)
    largest, text = float(force.max(initial=0.0)), certificates.text
    for margin in (1e-11, 1e-10, *BEYOND):
        claim = Fraction(look.time * (1.0 - margin))
        samples: dict[int, list[dict[str, Any]]] = {}
        for (which, tau), above, below in zip(look.looked, look.found.above, look.found.below, strict=True):
            if max(above, below) > 1e-7 * largest:
                since = max(Fraction(look.time + tau) - claim, Fraction(0))
                contact = {
                    "time": text(since),
                    "upper": text(float(max(above - below, 0.0))),
                    "lower": text(float(max(below - above, 0.0))),
                }
                samples.setdefault(which, []).append(contact)
        # the program's rows are measured in what is allowed
        scale = Fraction(search.allowed)
        chain = {"near": ["0", "0"], "coefficients": [[text(-Fraction(y) * scale), "0"] for y in map(float, look.found.sums)]}
        written = [
            {"place": [text(x) for x in search.box.members[which][0]], "residual": contacts, "deflection": [], "after": []}
            for which, contacts in samples.items()
        ]
        nothing: dict[str, Any] = {
            "changes": [],
            "pulses": [],
            "tail": [],
            "after": [],
            "fuel": "0",
            "deflection": [],
            "ramps": [],
            "steps": [],
        }
        side = Side(claim, {"costate": [[chain]], "samples": written, **nothing})
        if accepted(task, lower=side):
            return side
    return None


def _upper(search: Search, task: dict[str, Any], look: Look) -> Proof:
    """The upper side: a staircase a little beyond the root, its bodies brought to rest exactly."""
    for beyond in BEYOND:
        try:
            late = search.look(look.time * (1.0 + beyond))
            for _ in range(CUTS):
                if not search.cut(late, 1.0):
                    break
                late = search.look(late.time)
        except SolverError:
            continue
        written = _exactly(search, late) if late.found.excess < 1.0 else None
        if written is None:
            continue
        end, starts, levels = written
        side = Side(end, certificates.command_witness(end, starts, levels, [], [], Fraction(1, 10**6)))
        if accepted(task, upper=side):
            final = search.problems[0].maneuver.rest
            segments = tuple(Segment(float(s), float(level)) for s, level in zip(starts, levels, strict=True))
            return Proof(None, side, Command(float(end), segments, Tail(float(final))), None)
    return Proof()


def _exactly(search: Search, look: Look) -> tuple[Fraction, list[Fraction], list[Fraction]] | None:
    """The command in fractions: (duration, starts, absolute levels); a few levels between the limits are moved so that bodies rest."""
    problem, bodies = search.problems[0], search.box.bodies
    limits, final = problem.maneuver.limits, problem.maneuver.rest
    span, exact_limits = problem.upper - problem.lower, (limits.lower - final, limits.upper - final)
    nodes, starts, levels = [Fraction(float(x)) for x in look.nodes], list[Fraction](), list[Fraction]()
    for start, v in zip(nodes[:-1], map(float, look.found.levels), strict=True):
        near_low, near_high = v - problem.lower <= SNAP * span, problem.upper - v <= SNAP * span
        level = exact_limits[0] if near_low else exact_limits[1] if near_high else Fraction(v)
        if not levels or level != levels[-1]:
            starts.append(start)
            levels.append(level)
    end = nodes[-1]
    if bodies:
        plant = search.plants[0]
        away = plant.rest(problem.maneuver.displacement)[0]
        columns, aim = _chain(plant, bodies, [*starts, end], [away[i] for i in bodies])
        inside = [k for k, level in enumerate(levels) if level not in exact_limits]
        if len(inside) < len(bodies):
            return None
        table = np.array([[float(columns[i][k]) for k in inside] for i in range(len(bodies))])
        table /= np.maximum(np.abs(table).max(axis=1), np.finfo(float).tiny)[:, None]
        free = [inside[k] for k in pivots(table)[: len(bodies)]]
        held = [
            a - sum((c * v for k, (c, v) in enumerate(zip(row, levels, strict=True)) if k not in free), Fraction(0))
            for row, a in zip(columns, aim, strict=True)
        ]
        try:
            solved = fmpq_mat([[rational(row[k]) for k in free] for row in columns]).solve(fmpq_mat([[rational(x)] for x in held]))
        except ZeroDivisionError:
            return None
        for i, k in enumerate(free):
            levels[k] = fraction(solved[i, 0])
        if not all(exact_limits[0] <= level <= exact_limits[1] for level in levels):
            return None
    return end, starts, [level + final for level in levels]


def _chain(
    plant: VaryingPlant, bodies: Sequence[int], edges: Sequence[Fraction], away: Sequence[Fraction]
) -> tuple[list[list[Fraction]], list[Fraction]]:
    """What a unit level in each piece does to the bodies' states at the end, and what all of them have to do, exactly."""
    A, power = [[plant.A[0][i][j] for j in bodies] for i in bodies], [plant.B[0][i] for i in bodies]
    end, drift = edges[-1], list(away)
    columns, aim = [[Fraction(0)] * (len(edges) - 1) for _ in bodies], list(away)
    for k in range(1, len(bodies) + 1):
        for j, (a, b) in enumerate(itertools.pairwise(edges)):
            share = ((end - a) ** k - (end - b) ** k) / math.factorial(k)
            for i, x in enumerate(power):
                columns[i][j] += x * share
        power, drift = ([sum((x * y for x, y in zip(row, which, strict=True)), Fraction(0)) for row in A] for which in (power, drift))
        aim = [x + y * end**k / math.factorial(k) for x, y in zip(aim, drift, strict=True)]
    return columns, aim
