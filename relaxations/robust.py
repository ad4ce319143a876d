"""Where in a box a command is worst: those places become samples of the program, until it holds between them too."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from relaxations.bounds import Settings, bracket
from relaxations.boxes import Box, Sample
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem, problem
from relaxations.programs import GridSolution

Reals = NDArray[np.float64]

FIRST = {1: 7, 2: 4}  # samples of each parameter at first, by their number; 2 of more
FINE = {1: 121, 2: 21}  # places of each parameter at which a command is tried; 7 of more
ROUNDS = 8
EXCESS = 1e-7  # relative: a tolerance that is exceeded by less is left to the hair that the proof keeps inside
ROUGH = 1e-5  # of α, while places are still sought
TOLERANCE = 1e-7  # of α: closer to the root is closer than the grid


def sampled(posed: Problem, settings: Settings, near: float | None = None) -> tuple[Problem, Settings]:
    """The problem with as many samples as its box needs, and the settings for it; `near` is a guess at the minimum time [s]."""
    maneuver, chosen = posed.maneuver, replace(settings, tolerance=max(settings.tolerance, TOLERANCE))
    box = maneuver.box
    assert box is not None
    places = list(box.samples) or [box.nominal, *_grid(box, FIRST.get(len(box.axes), 2))]
    fine = _grid(box, FINE.get(len(box.axes), 7))
    looked = [Sample.of(place, box.family.member(place), posed.hold) for place in fine]
    for _ in range(ROUNDS):
        posed = problem(posed.plants, replace(maneuver, box=replace(box, samples=tuple(dict.fromkeys(places)))))
        try:
            found = bracket(posed, replace(chosen, tolerance=max(chosen.tolerance, ROUGH)), near)
        except SolverError:
            break
        if found.upper is None or not isinstance(found.dual, GridSolution):
            break
        near = found.upper
        worst = _worst(box, looked, found.dual, posed, 1.0 + EXCESS)
        if not worst:
            break
        places += worst
    return posed, chosen


def further(posed: Problem, solution: GridSolution, inside: float) -> Problem | None:
    """The problem with samples at the places where a solution whose limits are tightened by `inside` is not; None if there are none."""
    box = posed.maneuver.box
    assert box is not None
    looked = [Sample.of(place, box.family.member(place), posed.hold) for place in _grid(box, FINE.get(len(box.axes), 7))]
    worst = _worst(box, looked, solution, posed, 1.0 - inside / 2)
    if not worst:
        return None
    return problem(posed.plants, replace(posed.maneuver, box=replace(box, samples=tuple(dict.fromkeys((*box.samples, *worst))))))


def _grid(box: Box, count: int) -> list[tuple[Fraction, ...]]:
    """Places evenly over the box, its corners among them."""
    sides = [sorted({a.low + (a.high - a.low) * Fraction(i, count - 1) for i in range(count)}) for a in box.axes]
    return list(itertools.product(*sides))


def _worst(box: Box, looked: Sequence[Sample], solution: GridSolution, posed: Problem, factor: float) -> list[tuple[Fraction, ...]]:
    """The local maxima of the residual over the box that exceed `factor` times the tolerance."""
    assert posed.residuals is not None
    instants, levels = solution.program.instants, solution.levels / solution.fraction
    sides = [len({sample.place[i] for sample in looked}) for i in range(len(box.axes))]
    sizes = np.array([_size(sample, instants, levels) for sample in looked]).reshape(sides)
    over = [at for at in np.ndindex(*sides) if sizes[at] > posed.residuals.allowed * factor and sizes[at] >= _around(sizes, at).max()]
    return [_top(box, posed, solution, looked[int(np.ravel_multi_index(at, sides))].place) for at in over]


def _size(sample: Sample, instants: Reals, levels: Reals) -> float:
    return float(sample.peaks(sample.table(instants) @ levels - sample.rest)[1].max())


def _around(sizes: Reals, at: tuple[int, ...]) -> Reals:
    return sizes[tuple(slice(max(i - 1, 0), i + 2) for i in at)]


def _top(box: Box, posed: Problem, solution: GridSolution, start: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """The local maximum of the residual near a place."""
    instants, levels = solution.program.instants, solution.levels / solution.fraction
    low, high = (np.array([float(side) for side in sides]) for sides in zip(*((a.low, a.high) for a in box.axes), strict=True))
    width = np.where(high > low, high - low, 1.0)

    def place(x: Reals) -> tuple[Fraction, ...]:
        near = (Fraction(round(float(value) * 2**40), 2**40) for value in low + x * width)
        return tuple(min(max(value, axis.low), axis.high) for value, axis in zip(near, box.axes, strict=True))

    allowed = float(box.tolerance * abs(posed.maneuver.displacement))

    def size(x: Reals) -> float:
        return -_size(Sample.of(place(x), box.family.member(place(x)), posed.hold), instants, levels)

    begin = (np.array([float(value) for value in start]) - low) / width
    span = 0.5 / (FINE.get(len(box.axes), 7) - 1)
    found = minimize(
        size,
        begin,
        method="Nelder-Mead",
        bounds=[(max(x - 2 * span, 0.0), min(x + 2 * span, 1.0)) for x in begin],
        options={"xatol": 1e-6, "fatol": EXCESS * allowed / 4, "initial_simplex": None, "maxfev": 60 * len(begin)},
    )
    return place(np.asarray(found.x))
