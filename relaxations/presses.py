"""Prices of limits on named outputs in the course of the move, and what they take off the costate's function p(s).

A limit `|y(t)| ≤ d` that is priced ν over the times to go [begin, end] takes `ν/(end - begin) ∫ g(s - σ) dσ` off it, g being the output's
response to an impulse: a density, since a limit may hold for a while (../docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.courses import Course
from relaxations.moments import Basis
from relaxations.plants import Pole

Reals = NDArray[np.float64]

PRICED = 1e-9  # of the largest multiplier of a course: smaller ones are what an interior-point method leaves anywhere
REACH = 2.5  # cells between two prices of a limit that holds all the while
TOUCH, NARROW = 0.99, 1e-3  # share of the weight of neighbours that is nearly all; of a cell: so near that it makes no difference
CHUNK = 1_000_000  # responses that are looked at together
NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)  # of a multiplier that is spread over a cell


@dataclass(frozen=True, slots=True)
class Press:
    """The multiplier `weight` of a limit on the output of a course, spread evenly over the times to go from `begin` to `end` [s]; `at` is
    the one that the program had it for."""

    course: Course
    begin: float
    end: float
    weight: float
    at: float

    def freely(self, horizons: Reals) -> Reals:
        """What it is worth that the course does not begin at rest, for moves of these durations [s]."""
        to_go = self.begin + (self.end - self.begin) * (1.0 + NODES) / 2
        return self.weight * (self.course.free(horizons[:, None] - to_go) @ WEIGHTS) / 2


def off(pressed: Sequence[Press], at: float) -> float:
    """What multipliers take off the costate's function at a time to go [s]."""
    return float(_taken(pressed, np.array([at]), 0)[0])


def over(pressed: Sequence[Press], edges: Reals) -> Reals:
    """What they take off its integrals over cells between `edges` of times to go."""
    return np.diff(_taken(pressed, edges, 1))


def _taken(pressed: Sequence[Press], points: Reals, integrals: int) -> Reals:
    """What they take off the costate's function, or its `integrals` from 0, at times to go [s]: the plants' responses, course by course."""
    total, of_course = np.zeros(len(points)), dict[int, list[Press]]()
    for press in pressed:
        of_course.setdefault(id(press.course), []).append(press)
    for own in of_course.values():
        course, begins, ends, weights = own[0].course, *(np.array(x) for x in zip(*((p.begin, p.end, p.weight) for p in own), strict=True))
        widths = ends - begins
        for chosen, more in ((widths == 0.0, 0), (widths > 0.0, 1)):
            if not chosen.any():
                continue
            scaled = weights[chosen] / (widths[chosen] if more else 1.0)
            for edge, sign in ((begins, 1.0), (ends, -1.0))[: 1 + more]:
                count = len(scaled) * len(points) // CHUNK + 1
                for at, weight in zip(np.array_split(edge[chosen], count), np.array_split(sign * scaled, count), strict=True):
                    since = points - at[:, None]
                    reached = course.weights @ course.basis.rows(np.maximum(since, 0.0).ravel(), integrals + more)
                    total += weight @ np.where(since > 0.0, reached.reshape(since.shape), 0.0)
    return total


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
            Press(course, max(float(s - a), 0.0), float(s + b), float(weight), float(s))
            for s, a, b, weight in zip(to_go, before, after, weights, strict=True)
        ]
    return tuple(found)


def smoothed(pressed: Sequence[Press]) -> tuple[Press, ...]:
    """Prices of a limit that holds all the while, averaged over neighbours (1, 2, 1)/4: a grid's alternate from cell to cell where its
    command can bring an output back to its limit only in every second one. Any prices are valid."""
    found: list[Press] = []
    for run in _runs(pressed):
        weights = np.array([press.weight for press in run])
        around = np.concatenate([weights[:1], weights, weights[-1:]])
        averaged = (around[:-2] + 2 * weights + around[2:]) / 4
        found += [replace(press, weight=float(weight)) for press, weight in zip(run, averaged, strict=True)]
    return tuple(found)


def touching(pressed: Sequence[Press]) -> tuple[Press, ...]:
    """Prices with those of a limit that is touched, not held, at an instant: where one of neighbours has nearly all their weight it acts
    at its own time to go, or so near that it makes no difference, and not over a cell."""
    found: list[Press] = []
    for run in _runs(pressed):
        largest = max(run, key=lambda press: abs(press.weight))
        if abs(largest.weight) < TOUCH * sum(abs(press.weight) for press in run):
            found += run
            continue
        near = NARROW * (largest.end - largest.begin)
        found.append(replace(largest, begin=max(largest.at - near, 0.0), end=largest.at + near))
    return tuple(found)


def _runs(pressed: Sequence[Press]) -> list[list[Press]]:
    """Neighbours, which meet, together."""
    runs: list[list[Press]] = []
    for press in sorted(pressed, key=lambda one: (one.course.name, one.course.place or (), one.begin)):
        before = runs[-1][-1] if runs else None
        joined = before is not None and before.course is press.course and press.begin - before.end <= 1e-9 * press.end
        runs[-1].append(press) if joined else runs.append([press])
    return runs


def _joined(to_go: Reals, weights: Reals, cells: NDArray[np.intp]) -> tuple[Reals, Reals]:
    """Multipliers at ascending times to go, those in one cell as one: a course that is on its limit for a while has its tops anywhere."""
    if not len(to_go):
        return to_go, weights
    first = np.flatnonzero(np.diff(cells, prepend=-1))
    sizes = np.add.reduceat(np.abs(weights), first)
    return np.add.reduceat(np.abs(weights) * to_go, first) / sizes, np.add.reduceat(weights, first)


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
    kernels: dict[tuple[tuple[Fraction, ...] | None, str], NDArray[np.complex128]] = {}
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
