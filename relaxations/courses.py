"""Named outputs in the course of the move: how far each may deviate, where a command is beyond that, and what its limits do to the costate.

The output of a course is `y = w M` in the moments M of the command (`relaxations.moments`), its response to an impulse `g(s) = w b(s)`. A
limit `|y(t)| ≤ d` that is priced ν over the times to go [begin, end] takes `ν/(end - begin) ∫ g(s - σ) dσ` off the costate's function p(s):
a density, since a limit may hold for a while (../docs/theory.md, section 3).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import fmpq
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.moments import Basis
from relaxations.plants import LinearPlant, Pole, fraction
from relaxations.robust.boxes import at

if TYPE_CHECKING:
    from relaxations.maneuvers import Maneuver

Reals = NDArray[np.float64]

MOST_SHORT = 8  # cells of a block at least
AGAIN = 400  # points at which a command that was found without these limits is looked at
FEW = 4  # nodes of a box's nominal plant, one of so many
FINE = 4  # points of each cell at which a course is looked at
REACH = 2.5  # cells between two prices of a limit that holds all the while
PRICED = 1e-9  # of the largest multiplier of a course: smaller ones are what an interior-point method leaves anywhere
MISSED = 1e-9  # relative excess that calls for another instant
NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)  # of a multiplier that is spread over a cell


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
        moves = np.array([self.basis.free(unit, widths) for unit in np.eye(n)]).transpose(2, 1, 0)  # (cells, n, n)
        moments = np.zeros((len(times), n))
        moments[0] = self.begin
        for k, (move, added) in enumerate(zip(moves, inputs.T, strict=True)):
            moments[k + 1] = move @ moments[k] + added
        return times, moments @ self.weights

    def exceeded(self, instants: Reals, levels: Reals, allowed: float, ramps: bool = False) -> Reals:
        """Nodes, and local extremes, at which the output is beyond `allowed`: as fractions of the move."""
        times, course = self.along(instants, levels, ramps)
        over = np.abs(course) > allowed * (1.0 + MISSED)
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
            before = np.array([basis.free(one, times - instants[first]) for one in np.eye(n)])  # (n of the past, n, times)
            weights = np.array([courses[int(places[i, 0])].weights / courses[int(places[i, 0])].limit for i in mine]).reshape(-1, n)
            columns = at - 1 if ramps else at[:-1]
            known = columns >= 0  # the first node's value is 0
            bends.add(mine, columns[known], np.einsum("kn,nkc->kc", weights, reached[:, :-1])[:, known])
            flow.add(rows + np.arange(n), columns[known], reached[:, -1][:, known] / unit[:, None])
            past.add(rows + np.arange(n), begun + np.arange(n), -np.eye(n))
            if block:
                states.add(mine, begun - n + np.arange(n), np.einsum("kn,pnk,p->kp", weights, before[:, :, :-1], unit))
                past.add(rows + np.arange(n), begun - n + np.arange(n), (before[:, :, -1] * unit[:, None]).T / unit[:, None])
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


def smoothed(pressed: Sequence[Press]) -> tuple[Press, ...]:
    """Prices of a limit that holds all the while, averaged over neighbours (1, 2, 1)/4: a grid's alternate from cell to cell where its
    command can bring an output back to its limit only in every second one. Any prices are valid."""
    found: list[Press] = []
    runs: list[list[Press]] = []
    for press in sorted(pressed, key=lambda one: (one.course.name, one.course.place or (), one.begin)):
        before = runs[-1][-1] if runs else None
        joined = before is not None and before.course is press.course and press.begin - before.end <= 1e-9 * press.end
        runs[-1].append(press) if joined else runs.append([press])
    for run in runs:
        weights = np.array([press.weight for press in run])
        around = np.concatenate([weights[:1], weights, weights[-1:]])
        averaged = (around[:-2] + 2 * weights + around[2:]) / 4
        found += [replace(press, weight=float(weight)) for press, weight in zip(run, averaged, strict=True)]
    return tuple(found)


def _joined(to_go: Reals, weights: Reals, cells: NDArray[np.intp]) -> tuple[Reals, Reals]:
    """Multipliers at ascending times to go, those in one cell as one: a course that is on its limit for a while has its tops anywhere."""
    if not len(to_go):
        return to_go, weights
    first = np.flatnonzero(np.diff(cells, prepend=-1))
    sizes = np.add.reduceat(np.abs(weights), first)
    return np.add.reduceat(np.abs(weights) * to_go, first) / sizes, np.add.reduceat(weights, first)


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


@dataclass(frozen=True, slots=True)
class Press:
    """The multiplier `weight` of a limit on the output of a course, spread evenly over the times to go from `begin` to `end` [s]."""

    course: Course
    begin: float
    end: float
    weight: float

    def freely(self, horizons: Reals) -> Reals:
        """What it is worth that the course does not begin at rest, for moves of these durations [s]."""
        to_go = self.begin + (self.end - self.begin) * (1.0 + NODES) / 2
        return self.weight * (self.course.free(horizons[:, None] - to_go) @ WEIGHTS) / 2

    def over(self, edges: Reals) -> Reals:
        """What it takes off the integrals of the costate's function over cells between `edges` of times to go."""
        if self.end == self.begin:
            reached = self.course.basis.rows(np.maximum(edges - self.begin, 0.0), 1)
        else:
            reached = self.course.basis.rows(np.maximum(edges - self.begin, 0.0), 2)
            reached = (reached - self.course.basis.rows(np.maximum(edges - self.end, 0.0), 2)) / (self.end - self.begin)
        return self.weight * np.diff(self.course.weights @ reached)


def presses(courses: Sequence[Course], places: Reals, multipliers: Reals, instants: Reals, spread: bool) -> tuple[Press, ...]:
    """Multipliers (k,) of limits set to 1 at `places` (course, fraction of the move) (k, 2), `spread` over a cell, half to either side.

    Where they are dense, half the distance to the next one: a limit that holds for a while is priced without gaps. An input that is
    constant over samples needs no spreading: only the costate's integrals over these count.
    """
    found, horizon = [], float(instants[-1])
    for number, course in enumerate(courses):
        own = (places[:, 0] == number) & (np.abs(multipliers) > PRICED * np.abs(multipliers).max(initial=0.0))
        order = np.argsort(-places[own, 1])
        to_go, weights = horizon * (1.0 - places[own, 1][order]), multipliers[own][order]
        weights = weights / course.limit
        to_go, weights = _joined(to_go, weights, np.searchsorted(instants[:-1] + np.diff(instants) / 4, horizon - to_go))
        cell = np.interp(horizon - to_go, (instants[1:] + instants[:-1]) / 2, np.diff(instants))
        gaps = np.diff(to_go)
        after, before = (np.where(gap <= REACH * cell, gap, cell) / 2 for gap in (np.append(gaps, np.inf), np.append(np.inf, gaps)))
        if not spread:
            before, after = 0.0 * before, 0.0 * after
        found += [
            Press(course, max(float(s - a), 0.0), float(s + b), float(weight))
            for s, a, b, weight in zip(to_go, before, after, weights, strict=True)
        ]
    return tuple(found)


class _Sum:
    """`Re Σ_p Σ_k c_pk s^k/k! e^{ps}` over all poles of several bases and 0, in floating point, to be followed along s."""

    def __init__(self, bases: Sequence[Basis]) -> None:
        orders: dict[complex, int] = {0j: 1}
        for basis in bases:
            for pole in basis.poles:
                orders[pole.value] = max(orders.get(pole.value, 0), pole.multiplicity + (pole.value == 0))
        self.basis = Basis(tuple(Pole(value, order) for value, order in orders.items()))
        self.begins = dict(zip(orders, np.cumsum([0, *list(orders.values())[:-1]]), strict=True))
        self.values = np.repeat(list(orders), list(orders.values()))
        self.powers = np.concatenate([np.arange(order) for order in orders.values()])
        self.coefficients = np.zeros(len(self.values), dtype=complex)
        self.orders = orders

    def chains(self, basis: Basis, numbers: Reals) -> NDArray[np.complex128]:
        """The coefficients of a functional of b."""
        found, at = np.zeros_like(self.coefficients), 0
        for pole in basis.poles:
            for k in range(pole.multiplicity):
                width = 2 if pole.is_flexible else 1
                found[self.begins[pole.value] + k] += numbers[at] - (1j * numbers[at + 1] if width == 2 else 0.0)
                at += width
        return found

    def integrated(self, chains: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The coefficients of its integral from 0: `S_k = (b_k - S_{k-1}) / p`, at the origin b_{k+1}."""
        found = np.zeros_like(chains)
        for pole, order in self.orders.items():
            at = self.begins[pole]
            if pole == 0:
                found[at + 1 : at + order] += chains[at : at + order - 1]
                continue
            carried = 0j
            for k in range(order - 1, -1, -1):  # Σ c_k S_k = Σ a_k b_k + a_const: a_k = (c_k - a_{k+1}) / p
                carried = (chains[at + k] - carried) / pole
                found[at + k] += carried
            found[self.begins[0j]] -= carried.real
        return found

    def advance(self, distance: float) -> None:
        """Move the origin of s."""
        moved = np.zeros_like(self.coefficients)
        for pole, order in self.orders.items():
            at, factor = self.begins[pole], np.exp(pole * distance)
            for shift in range(order):
                moved[at : at + order - shift] += factor * self.coefficients[at + shift : at + order]
                factor = factor * distance / (shift + 1)
        self.coefficients = moved

    def __call__(self, s: Reals) -> Reals:
        """Values at s."""
        flat: list[float] = []
        for c, value in zip(self.coefficients, self.values, strict=True):
            flat += [c.real, -c.imag] if value.imag else [c.real]
        return np.asarray(flat) @ self.basis.rows(s)


def sampled(bases: Sequence[Basis], costates: Sequence[Reals], pressed: Sequence[Press], points: Reals) -> Reals:
    """p(s) at ascending `points` from 0 on: the costates' functions less what the multipliers take off."""
    total = _Sum([*bases, *(press.course.basis for press in pressed)])
    for basis, costate in zip(bases, costates, strict=True):
        total.coefficients += total.chains(basis, costate)
    kicks: list[tuple[float, NDArray[np.complex128]]] = []
    kernels: dict[tuple[Any, str], NDArray[np.complex128]] = {}
    for press in pressed:
        key = press.course.place, press.course.name
        if key not in kernels:
            kernels[key] = total.integrated(total.chains(press.course.basis, press.course.weights))
        rate = press.weight / (press.end - press.begin) * kernels[key]
        kicks += [(press.begin, -rate), (press.end, rate)]
    kicks.sort(key=lambda kick: kick[0])
    values, at, origin = np.zeros(len(points)), 0, 0.0
    for begin, kick in [*kicks, (np.inf, np.zeros(0))]:
        until = int(np.searchsorted(points, begin))
        if until > at:
            values[at:until] = total(points[at:until] - origin)
            at = until
        if not begin <= points[-1]:
            break
        total.advance(begin - origin)
        origin = begin
        total.coefficients += kick
    return values
