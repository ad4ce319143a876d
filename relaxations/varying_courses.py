"""Named outputs c(t) x of a plant that varies, in the course of the move: `relaxations.courses` along another transition.

Deviations x - x_ss from the final rest begin at x_0 - x_ss and obey `x' = A x + B v`, so that without an input v the output is
`c (x_ss - Φ(t, 0) (x_ss - x_0))`. A limit on it that is priced ρ(t) drives the costate: `π' = -π A + ρ c`, p = π B, and

    π(0) (x_ss - x_0) + ∫ ρ c x_ss dt ≤ ∫_0^T σ(p) dt + limit ∫ |ρ| dt

where π(0) is the program's multiplier λ of the equations less `∫ ρ c Φ(t, 0) dt`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from relaxations.courses import FINE, MOST_SHORT, Course, Motion
from relaxations.errors import ManeuverError
from relaxations.limits import Limits
from relaxations.moments import Basis
from relaxations.presses import Press
from relaxations.transitions import VaryingPlant

Reals = NDArray[np.float64]

SAME = 1e-12  # of the move: instants so close are one
SHORT, TERMS, NOTHING = 0.5, 24, 1e-18  # of a series for one part of a cell: length times pace, terms at most, what is left out


def flows(table: Reals, instants: Reals, edges: Reals) -> Reals:
    """`x(e_{k+1}) = Y_k x(e_k)` for `x' = A(t) x`, A(t) between `instants` of its `table` (I, m, m), then constant: shape (N, m, m)."""
    inner = instants[(instants > edges[0]) & (instants < edges[-1])]
    points = np.union1d(edges, inner)
    pace = float(np.abs(np.linalg.eigvals(np.abs(table).max(axis=0))).max())
    parts = np.maximum(np.ceil(np.diff(points) * pace / SHORT), 1.0).astype(int)
    shares = (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)) / np.repeat(parts, parts)
    points = np.append(np.repeat(points[:-1], parts) + shares * np.repeat(np.diff(points), parts), points[-1])
    widths, begins = np.diff(points)[:, None, None], points[:-1]
    after = np.searchsorted(instants, begins + np.diff(points) / 2)
    at = np.clip(after, 1, len(instants) - 1) if len(instants) > 1 else np.zeros(len(begins), dtype=int)
    last = after >= len(instants)
    low, high = table[at - 1], table[at]
    spans = instants[at] - instants[at - 1] if len(instants) > 1 else np.ones(len(begins))
    rise = np.where(last[:, None, None], 0.0, (high - low) / spans[:, None, None])
    value = np.where(last[:, None, None], table[-1], low + rise * (begins - instants[at - 1])[:, None, None])
    unit = np.broadcast_to(np.eye(table.shape[1]), value.shape)
    terms, moved = [np.zeros_like(value), unit], unit.copy()
    for k in range(TERMS):
        terms = [terms[1], (widths * (value @ terms[1]) + widths * widths * (rise @ terms[0])) / (k + 1)]
        moved = moved + terms[1]
        if max(np.abs(terms[0]).max(), np.abs(terms[1]).max()) <= NOTHING * np.abs(moved).max():
            break
    found, firsts = [], np.searchsorted(points, edges)
    for a, b in itertools.pairwise(firsts):
        whole = moved[a]
        for k in range(a + 1, b):
            whole = moved[k] @ whole
        found.append(whole)
    return np.array(found)


@dataclass(frozen=True)
class VaryingCourse(Course):
    """A course c(t) x of a plant that varies; `rows` (I, n) at its instants, `rest` x_ss and `away` x_ss - x_0 (n,)."""

    plant: VaryingPlant
    rows: Reals
    rest: Reals
    away: Reals

    @property
    def instants(self) -> Reals:
        """Those of the schedule [s]."""
        return np.array([float(t) for t in self.plant.instants])

    def at(self, times: Reals) -> Reals:
        """c at times [s]: shape (len(times), n)."""
        return np.array([np.interp(times, self.instants, column) for column in self.rows.T]).T

    @property
    def moving(self) -> Reals:
        """The matrices of x, of an input and of its slope."""
        A, B = np.array(self.plant.A, dtype=float), np.array(self.plant.B, dtype=float)
        return forced(A, B)

    def along(self, instants: Reals, levels: Reals, ramps: bool = False) -> tuple[Reals, Reals]:
        """Instants [s] of the program, backwards in time, `FINE` to a cell, and the output there."""
        widths = np.repeat(np.diff(instants) / FINE, FINE)
        program = np.concatenate([[0.0], np.cumsum(widths)])
        times = program[-1] - program[::-1]
        times[0] = 0.0
        if ramps:
            nodes = np.interp(program, instants, np.concatenate([[0.0], levels]))[::-1]
            inputs, slopes = nodes[:-1], np.diff(nodes) / np.diff(times)
        else:
            inputs = np.repeat(levels, FINE)[::-1]
            slopes = np.zeros(len(inputs))
        n, state = len(self.rest), -self.away
        states = [state]
        for Y, v, slope in zip(flows(self.moving, self.instants, times), inputs, slopes, strict=True):
            state = Y[:n, :n] @ state + Y[:n, n] * v + Y[:n, n + 1] * slope
            states.append(state)
        course = np.einsum("kn,kn->k", self.at(times), np.array(states) + self.rest)
        return program, course[::-1]


def forced(A: Reals, B: Reals) -> Reals:
    """Tables of `x' = A x + B u, u' = s, s' = 0`."""
    count, n = B.shape
    table = np.zeros((count, n + 2, n + 2))
    table[:, :n, :n], table[:, :n, n], table[:, n, n + 1] = A, B, 1.0
    return table


def varying_courses(plant: VaryingPlant, limits: Limits, state: Sequence[Fraction], begin: Sequence[Fraction]) -> tuple[VaryingCourse, ...]:
    """The outputs whose deflection is limited, of a plant that is moved from `begin` to rest at `state`.

    Raises `ManeuverError` for one that may not be.
    """
    found = []
    for name, limit in limits.deflection.items():
        known = plant.rows
        if name not in known:
            listed = ", ".join(sorted(known)) or "none without feed-through"
            raise ManeuverError(f"a deflection limit names {name!r}; of a plant that varies it may be that of {listed}")
        if not limit > 0:
            raise ManeuverError(f"the deflection of {name!r} may be more than 0, not {float(limit)!r}")
        rows = known[name]
        if not any(any(row) for row in rows):
            continue
        for instant, row in zip(plant.instants, rows, strict=True):
            final = sum((c * x for c, x in zip(row, state, strict=True)), Fraction(0))
            if abs(final) > limit:
                raise ManeuverError(
                    f"at its final rest {name!r} deviates by {float(final):.10g} at {float(instant):.6g} s: "
                    f"no command stays within {float(limit)!r}"
                )
        first = sum((c * x for c, x in zip(rows[0], begin, strict=True)), Fraction(0))
        if abs(first) > limit:
            raise ManeuverError(f"at first {name!r} deviates by {float(first):.10g}: that is beyond its limit, {float(limit)!r}, already")
        rest = np.array([float(x) for x in state])
        away = np.array([float(s - x) for s, x in zip(state, begin, strict=True)])
        table = np.array(rows, dtype=float)
        final = float(table[-1] @ rest)
        found.append(VaryingCourse(name, Basis(()), np.zeros(0), float(limit), final, np.zeros(0), None, plant, table, rest, away))
    return tuple(found)


def varying_motion(courses: Sequence[VaryingCourse], instants: Reals, extra: Reals, ramps: bool) -> Motion:
    """`relaxations.courses.motion` of levels that are those of the move backwards, at all nodes but the move's begin and end."""
    horizon, cells, first = float(instants[-1]), len(instants) - 1, courses[0]
    nodes = horizon - instants[::-1]
    nodes[0] = 0.0
    places = [(number, at / horizon) for number in range(len(courses)) for at in instants[1:-1]]
    places = np.unique(np.concatenate([np.array(places).reshape(-1, 2), extra[(extra[:, 1] < 1.0) & (extra[:, 1] > 0.0)]]), axis=0)
    times = horizon * (1.0 - places[:, 1])
    near = nodes[np.clip(np.searchsorted(nodes, times - SAME * horizon), 0, cells)]
    times = np.where(np.abs(near - times) <= SAME * horizon, near, times)
    fine = np.union1d(nodes, times)
    of_cell = np.clip(np.searchsorted(nodes, fine[:-1], side="right") - 1, 0, cells - 1)
    Y, n = flows(first.moving, first.instants, fine), len(first.rest)
    size = np.maximum(np.abs(Y[:, :n, n]).sum(axis=0), np.finfo(float).tiny)  # of what a unit of input does to a state, about
    length = max(MOST_SHORT, round(cells**0.5 / 2))
    seen = {number: np.searchsorted(fine, times[places[:, 0] == number]) for number in range(len(courses))}
    rows_at: dict[int, list[tuple[int, int]]] = {}
    for number in range(len(courses)):
        for place, at in zip(np.flatnonzero(places[:, 0] == number), seen[number], strict=True):
            rows_at.setdefault(int(at), []).append((int(place), number))
    weights = [course.at(fine) for course in courses]
    count, blocks = len(places), -(-cells // length)
    bends, states = np.zeros((count, cells)), np.zeros((count, n * blocks))
    flow, past = np.zeros((n * blocks, cells)), np.zeros((n * blocks, n * blocks))
    moved, before, begin = np.zeros((n, cells + 1)), np.zeros((n, n)), -first.away
    free = np.zeros(count)
    for k, step in enumerate(Y):
        cell = int(of_cell[k])
        moved, before, begin = step[:n, :n] @ moved, step[:n, :n] @ before, step[:n, :n] @ begin
        if ramps:
            share, width = fine[k] - nodes[cell], nodes[cell + 1] - nodes[cell]
            moved[:, cell] += step[:n, n] * (1.0 - share / width) - step[:n, n + 1] / width
            moved[:, cell + 1] += step[:n, n] * share / width + step[:n, n + 1] / width
        else:
            moved[:, cell] += step[:n, n]
        block = cell // length
        for place, number in rows_at.get(k + 1, ()):
            row, limit = weights[number][k + 1], courses[number].limit
            bends[place] = (row @ moved)[:-1][::-1] / limit  # the program's cells, or nodes but the one at the move's end, are backwards
            if block:
                states[place, n * (block - 1) : n * block] = (row @ before) * size / limit
            free[place] = row @ (first.rest + begin) / limit
        if fine[k + 1] == nodes[cell + 1] and ((cell + 1) % length == 0 or cell + 1 == cells):
            own = slice(n * block, n * (block + 1))
            flow[own] = moved[:, :-1][:, ::-1] / size[:, None]
            past[own, own] = -np.eye(n)
            if block:
                past[own, n * (block - 1) : n * block] = before * size / size[:, None]
            moved, before = np.zeros((n, cells + 1)), np.eye(n)
    finals = np.zeros(count)
    for number, course in enumerate(courses):
        own_places = places[:, 0] == number
        finals[own_places] = course.at(times[own_places]) @ first.rest / course.limit
    return Motion(places, csr_array(bends), csr_array(states), csr_array(flow), csr_array(past), finals, free, n * blocks)


def driven(costate: Reals, pressed: Sequence[Press], points: Reals) -> tuple[Reals, Reals, Reals]:
    """π(0), and at ascending `points` from 0 on p, and its integral from 0."""
    first = pressed[0].course
    assert isinstance(first, VaryingCourse)
    plant, n = first.plant, len(costate)
    courses = list({press.course.name: press.course for press in pressed}.values())
    names = [course.name for course in courses]
    ends = [at for press in pressed for at in (press.begin, press.end)]
    edges = np.unique(np.concatenate([[0.0], points, ends]))
    A, B, size = np.array(plant.A, dtype=float), np.array(plant.B, dtype=float), n + len(courses) + 1
    table = np.zeros((len(plant.instants), size, size))
    table[:, :n, :n], table[:, -1, :n] = -A.transpose(0, 2, 1), B
    for i, course in enumerate(courses):
        assert isinstance(course, VaryingCourse)
        table[:, :n, n + i] = course.rows
    Y, middle = flows(table, first.instants, edges), (edges[1:] + edges[:-1]) / 2
    density, jumps = np.zeros((len(middle), len(courses))), np.zeros((len(edges), n))
    for press in pressed:
        assert isinstance(press.course, VaryingCourse)
        if press.begin == press.end:
            jumps[np.searchsorted(edges, press.begin)] += press.weight * press.course.at(np.array([press.begin]))[0]
        else:
            inside = (middle > press.begin) & (middle < press.end)
            density[inside, names.index(press.course.name)] += press.weight / (press.end - press.begin)
    back = np.zeros(n)
    for step, rho, jump in zip(Y[::-1], density[::-1], jumps[1:][::-1], strict=True):
        back = np.linalg.solve(step[:n, :n], back - jump - step[:n, n:-1] @ rho)
    begin = costate + back - jumps[0]
    inputs = np.array([np.interp(edges, first.instants, column) for column in B.T]).T
    row, total = begin + jumps[0], 0.0
    p, integral = [row @ inputs[0]], [0.0]
    for k, (step, rho) in enumerate(zip(Y, density, strict=True)):
        total += step[-1, :n] @ row + step[-1, n:-1] @ rho
        row = step[:n, :n] @ row + step[:n, n:-1] @ rho + jumps[k + 1]
        p.append(row @ inputs[k + 1])
        integral.append(total)
    at = np.searchsorted(edges, points)
    return begin, np.array(p)[at], np.array(integral)[at]


def gained(pressed: Sequence[Press]) -> float:
    """`∫ ρ c x_ss dt`."""
    total = 0.0
    for press in pressed:
        course = press.course
        assert isinstance(course, VaryingCourse)
        inner = course.instants[(course.instants > press.begin) & (course.instants < press.end)]
        edges = np.concatenate([[press.begin], inner, [press.end]])
        seen = course.at(edges) @ course.rest
        mean = seen[0] if press.end == press.begin else np.trapezoid(seen, edges) / (press.end - press.begin)
        total += press.weight * float(mean)
    return total
