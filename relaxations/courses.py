"""Named outputs in the course of the move: how far each may deviate, where a command is beyond that, and what its limits do to the costate.

The output of a course is `y = w M` in the moments M of the command (`relaxations.moments`), its response to an impulse `g(s) = w b(s)`. A
limit `|y(t)| ≤ d` that is priced ν over the times to go [begin, end] takes `ν/(end - begin) ∫ g(s - σ) dσ` off the costate's function p(s):
a density, since a limit may hold for a while (../docs/theory.md, section 3).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from flint import fmpq
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.moments import Basis
from relaxations.plants import LinearPlant, fraction
from relaxations.robust.boxes import at

if TYPE_CHECKING:
    from relaxations.maneuvers import Maneuver

Reals = NDArray[np.float64]

MOST_SHORT = 8  # cells of a block at least
AGAIN = 400  # points at which a command that was found without these limits is looked at
FEW = 4  # nodes of a box's nominal plant, one of so many
FINE = 4  # points of each cell at which a course is looked at
MISSED = 1e-9  # relative excess that calls for another instant
LANDING = 0.05  # of the move: how long before its end an output that comes to rest on its limit begins to be let there


@dataclass(frozen=True, slots=True)
class Course:
    """The output `name` may deviate from its first rest value by `limit` (output units); after the move it rests at `final`, a deviation.

    `weights` (n,) of the moments over all poles of the plant; these are `begin` (n,) at first, nothing at rest. `place` is that of a plant
    in a box.
    """

    name: str
    basis: Basis
    weights: Reals
    limit: float
    final: float
    begin: Reals
    place: tuple[Fraction, ...] | None

    @staticmethod
    def of(
        plant: LinearPlant, name: str, limit: float, final: float, begin: Reals | None = None, place: tuple[Fraction, ...] | None = None
    ) -> Course:
        """Of a plant's output without feed-through."""
        basis = Basis(plant.poles)
        weights, begin = basis.weights(plant.partial(name)), np.zeros(basis.size) if begin is None else begin
        return Course(name, basis, weights, limit, final, begin, place)

    def free(self, times: Reals) -> Reals:
        """The output without an input, at times [s]; nothing before the move."""
        flat = np.maximum(times, 0.0).ravel()
        return np.where(times >= 0.0, (self.weights @ self.basis.free(self.begin, flat)).reshape(times.shape), 0.0)

    def along(self, instants: Reals, levels: Reals, ramps: bool = False) -> tuple[Reals, Reals]:
        """Instants [s], `FINE` to a cell, and the output there."""
        widths = np.repeat(np.diff(instants) / FINE, FINE)
        times = np.concatenate([[0.0], np.cumsum(widths)])
        n = self.basis.size
        if ramps:
            values = np.interp(times, instants, np.concatenate([[0.0], levels]))
            slopes = np.diff(values) / widths
            inputs = self.basis.rows(widths, 1) * values[:-1] + self.basis.rows(widths, 2) * slopes
        else:
            inputs = self.basis.rows(widths, 1) * np.repeat(levels, FINE)
        moves = self.basis.moves(widths).transpose(2, 0, 1)  # (cells, n, n)
        moments = np.zeros((len(times), n))
        moments[0] = self.begin
        for k, (move, added) in enumerate(zip(moves, inputs.T, strict=True)):
            moments[k + 1] = move @ moments[k] + added
        return times, moments @ self.weights

    def exceeded(self, instants: Reals, levels: Reals, allowed: float, ramps: bool = False) -> Reals:
        """Nodes, and local extremes, at which the output is beyond `allowed`: as fractions of the move."""
        times, course = self.along(instants, levels, ramps)
        inside = 1.0 - allowed / self.limit
        final = np.full(len(times), self.final / self.limit)
        room = self.limit * shares_left(inside, final, times / instants[-1]) if self.place is None and inside > 0.0 else allowed
        over = np.abs(course) > room * (1.0 + MISSED)
        inner = np.abs(course[1:-1])
        tops = np.flatnonzero((inner >= np.abs(course[:-2])) & (inner >= np.abs(course[2:]))) + 1
        nodes = np.arange(FINE, len(times), FINE)
        chosen = np.union1d(nodes[over[nodes]], tops[over[tops]])
        found = times[chosen]
        top = np.isin(chosen, tops) & (chosen % FINE != 0)
        y0, y1, y2 = course[chosen - 1], course[chosen], course[np.minimum(chosen + 1, len(times) - 1)]
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = np.nan_to_num((y0 - y2) / (2 * (y0 - 2 * y1 + y2)), posinf=0.0, neginf=0.0)
        found = found + np.where(top, np.clip(shift, -1, 1) * (times[np.maximum(chosen, 1)] - times[np.maximum(chosen, 1) - 1]), 0.0)
        return np.clip(found / instants[-1], 0.0, 1.0)


def shares_left(inside: float, finals: Reals, places: Reals) -> Reals:
    """The shares of their limits that are left, at places of the move, to outputs that are to be `inside` these by a fraction of the room
    beyond where they come to rest, `finals` (shares too); of one that rests on its limit, of the limit, and of less when it lands."""
    room = 1.0 - np.abs(finals)
    return 1.0 - inside * np.where(room > inside, room, np.minimum((1.0 - places) / LANDING, 1.0))


def respects(courses: Sequence[Course], command: Command, rest: float) -> bool:
    """Whether constant segments keep the courses within their limits, as far as some points of each tell."""
    instants = np.union1d(command.breakpoints, np.linspace(0.0, command.end, AGAIN))
    levels = command((instants[1:] + instants[:-1]) / 2, rest) - rest
    return not len(exceeded_places(courses, instants, levels, 1.0))


@dataclass(frozen=True, slots=True)
class Motion:
    """The courses of the levels u of a grid, in units of their limits: `bends u + states z` where `flow u + past z = 0`.

    z are the moments at the end of every block of some cells, so that all four are sparse: what a place sees of the move's beginning, it
    sees through them, so many `unknowns`. A row of bends belongs to a place (course, fraction of the move); it ends at `finals` (k,), and
    without an input it would be at `free` (k,) there.
    """

    places: Reals
    bends: csr_array
    states: csr_array
    flow: csr_array
    past: csr_array
    finals: Reals
    free: Reals
    unknowns: int


def motion(courses: Sequence[Course], instants: Reals, extra: Reals, ramps: bool = False) -> Motion:
    """At all nodes of the grid `instants` (N + 1,) [s] but the first, and at `extra` places (k, 2); levels (N,) as in `Course.along`."""
    horizon, cells = float(instants[-1]), len(instants) - 1
    length = max(MOST_SHORT, round(cells**0.5 / 2))
    edges = [*range(0, cells, length), cells]
    # Of a box the nominal plant, at some nodes; the others where they were beyond a limit.
    active = [i for i, course in enumerate(courses) if course.place == courses[0].place or i in extra[:, 0]]
    first = [i for i in active if courses[i].place == courses[0].place]
    nodes = [(number, at / horizon) for number in first for at in (instants[1:] if courses[0].place is None else instants[FEW::FEW])]
    places = np.unique(np.concatenate([np.array(nodes), extra]), axis=0)
    bases = list({courses[number].basis: None for number in active})
    bends, states, flow, past = (_Entries() for _ in range(4))
    begun, rows = 0, 0
    for basis in bases:
        n = basis.size
        table = np.abs(np.diff(basis.rows(horizon - instants, 1), axis=1)).sum(axis=1)
        unit = np.where(table > 0.0, table, 1.0)
        own = [number for number in active if courses[number].basis == basis]
        for block, (first, last) in enumerate(itertools.pairwise(edges)):
            at = np.arange(first, last + 1)
            mine = np.flatnonzero(np.isin(places[:, 0], own))
            times = horizon * places[mine, 1]
            mine = mine[(times > instants[first]) & (times <= instants[last] if last < cells else times > instants[first])]
            times = np.append(horizon * places[mine, 1], instants[last])
            reached = _reached(basis, instants[at], times, ramps)  # (n, times, nodes or cells)
            before = basis.moves(times - instants[first])  # (n, n of the past, times)
            weights = np.array([courses[int(places[i, 0])].weights / courses[int(places[i, 0])].limit for i in mine]).reshape(-1, n)
            columns = at - 1 if ramps else at[:-1]
            known = columns >= 0  # the first node's value is 0
            bends.add(mine, columns[known], np.einsum("kn,nkc->kc", weights, reached[:, :-1])[:, known])
            flow.add(rows + np.arange(n), columns[known], reached[:, -1][:, known] / unit[:, None])
            past.add(rows + np.arange(n), begun + np.arange(n), -np.eye(n))
            if block:
                states.add(mine, begun - n + np.arange(n), np.einsum("kn,npk,p->kp", weights, before[:, :, :-1], unit))
                past.add(rows + np.arange(n), begun - n + np.arange(n), before[:, :, -1] * unit / unit[:, None])
            begun, rows = begun + n, rows + n
    finals, free = np.zeros(len(places)), np.zeros(len(places))
    for number, course in enumerate(courses):
        own = places[:, 0] == number
        finals[own], free[own] = course.final / course.limit, course.free(horizon * places[own, 1]) / course.limit
    count = len(places)
    return Motion(
        places,
        bends.array((count, cells)),
        states.array((count, begun)),
        flow.array((rows, cells)),
        past.array((rows, begun)),
        finals,
        free,
        begun,
    )


def _reached(basis: Basis, nodes: Reals, times: Reals, ramps: bool) -> Reals:
    """The moments at `times`, from 0 at the first node, for each unit level of a cell, or unit value at a node: (n, times, …)."""
    since = np.maximum(times[:, None] - nodes[None, :], 0.0)

    def integrals(order: int) -> Reals:
        return basis.rows(since.ravel(), order).reshape(-1, *since.shape)

    if not ramps:
        return -np.diff(integrals(1), axis=2)
    slopes = -np.diff(integrals(2), axis=2) / np.diff(nodes)
    nothing = np.zeros((*slopes.shape[:2], 1))
    values = np.concatenate([nothing, slopes], axis=2) - np.concatenate([slopes, nothing], axis=2)
    values[:, :, 0] += integrals(1)[:, :, 0]  # the level that the block begins with
    return values


class _Entries:
    """The entries of a sparse matrix, block by block."""

    def __init__(self) -> None:
        self.blocks: list[tuple[NDArray[np.intp], NDArray[np.intp], Reals]] = []

    def add(self, rows: NDArray[np.intp], columns: NDArray[np.intp], values: Reals) -> None:
        self.blocks.append((np.repeat(rows, len(columns)), np.tile(columns, len(rows)), values.ravel()))

    def array(self, shape: tuple[int, int]) -> csr_array:
        if not self.blocks:
            return csr_array(shape)
        rows, columns, values = (np.concatenate(parts) for parts in zip(*self.blocks, strict=True))
        return csr_array(coo_array((values, (rows, columns)), shape=shape))


def courses_of(plants: Sequence[LinearPlant], maneuver: Maneuver, begin: Reals | None = None) -> tuple[Course, ...]:
    """The outputs whose deflection is limited, from moments `begin` on, of a box those of its samples, one sample after the other; raises
    `ManeuverError` for one that may not be."""
    found, box = [], maneuver.box
    everywhere: list[tuple[tuple[Fraction, ...] | None, LinearPlant]] = [(None, plant) for plant in plants]
    if box is not None and maneuver.limits.deflection:
        everywhere = [(place, box.family.member(place)) for place in box.looked]
    for place, plant in everywhere:
        where = "" if box is None or place in (None, box.nominal) else f" in the plant {at(place)}"
        for name, limit in maneuver.limits.deflection.items():
            if name not in plant.numerators:
                others = ", ".join(sorted(plant.numerators))
                if box is not None and name in plants[0].numerators:
                    raise ManeuverError(f"where the zeros of {name!r} go in the box is not known: a deflection limit may name {others}")
                raise ManeuverError(f"a deflection limit names {name!r}; the plant has {others}")
            if not limit > 0:
                raise ManeuverError(f"the deflection of {name!r} may be more than 0, not {float(limit)!r}")
            numerator = plant.numerators[name]
            if not numerator and box is None:
                continue  # the input does not reach it
            if numerator.degree() == plant.order:
                raise ManeuverError(f"the output {name!r} has feed-through: it jumps with the input, whose limits are its own")
            final = fraction(numerator(fmpq(0)) / plant.denominator[plant.rigid_order]) * moved(plants[0], maneuver.displacement)
            if abs(final) > limit:
                why = f"no command stays within {float(limit)!r}"
                raise ManeuverError(f"at its final rest{where} {name!r} deviates by {float(final):.10g}: {why}")
            first = sum((fraction(c) * x for c, x in zip(numerator.coeffs(), maneuver.initial or (), strict=False)), Fraction(0))
            if abs(first) > limit:
                raise ManeuverError(
                    f"at first {name!r} deviates by {float(first):.10g}: that is beyond its limit, {float(limit)!r}, already"
                )
            found.append(Course.of(plant, name, float(limit), float(final), begin, place))
    return tuple(found)


def moved(plant: LinearPlant, displacement: Fraction) -> Fraction:
    """What brings a plant to its target: the one moment at the origin that moves a body for good, or else the input that holds."""
    return displacement * fraction(plant.denominator[plant.rigid_order] / plant.numerators[plant.output](fmpq(0)))


def exceeded_places(courses: Sequence[Course], instants: Reals, levels: Reals, share: float, ramps: bool = False) -> Reals:
    """Places at which levels bring a course beyond the `share` of its limit: shape (k, 2)."""
    found = [
        (number, fraction)
        for number, course in enumerate(courses)
        for fraction in course.exceeded(instants, levels, share * course.limit, ramps)
    ]
    return np.array(found).reshape(-1, 2)
