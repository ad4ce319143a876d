"""Where in a box a command is worst: those places become samples of the program, until it holds between them too."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

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
TOLERANCE = 1e-7  # of α: closer to the root is closer than the grid


def sampled(posed: Problem, settings: Settings) -> tuple[Problem, Settings]:
    """The problem with as many samples as its box needs, and the settings for it."""
    maneuver, chosen = posed.maneuver, replace(settings, tolerance=max(settings.tolerance, TOLERANCE))
    box = maneuver.box
    assert box is not None
    places = list(box.samples) or [box.nominal, *_grid(box, FIRST.get(len(box.axes), 2))]
    fine = _grid(box, FINE.get(len(box.axes), 7))
    looked = [Sample.of(place, box.family.member(place), posed.hold) for place in fine]
    near: float | None = None
    for _ in range(ROUNDS):
        posed = problem(posed.plants, replace(maneuver, box=replace(box, samples=tuple(dict.fromkeys(places)))))
        try:
            found = bracket(posed, chosen, near)
        except SolverError:
            break
        if found.upper is None or not isinstance(found.dual, GridSolution):
            break
        near = found.upper
        worst = _worst(box, looked, found.dual, posed)
        if not worst:
            break
        places += worst
    return posed, chosen


def _grid(box: Box, count: int) -> list[tuple[Fraction, ...]]:
    """Places evenly over the box, its corners among them."""
    sides = [sorted({a.low + (a.high - a.low) * Fraction(i, count - 1) for i in range(count)}) for a in box.axes]
    return list(itertools.product(*sides))


def _worst(box: Box, looked: Sequence[Sample], solution: GridSolution, posed: Problem) -> list[tuple[Fraction, ...]]:
    """The local maxima of the residual over the box that exceed the tolerance."""
    assert posed.residuals is not None
    instants, levels = solution.program.instants, solution.levels / solution.fraction
    sides = [len({sample.place[i] for sample in looked}) for i in range(len(box.axes))]
    sizes = np.array([_size(sample, instants, levels) for sample in looked]).reshape(sides)
    found = []
    for at in np.ndindex(*sides):
        if sizes[at] > posed.residuals.allowed * (1.0 + EXCESS) and sizes[at] >= _around(sizes, at).max():
            found.append(_top(box, looked[int(np.ravel_multi_index(at, sides))], sizes, at))
    return found


def _size(sample: Sample, instants: Reals, levels: Reals) -> float:
    return float(sample.peaks(sample.table(instants) @ levels - sample.rest)[1].max())


def _around(sizes: Reals, at: tuple[int, ...]) -> Reals:
    return sizes[tuple(slice(max(i - 1, 0), i + 2) for i in at)]


def _top(box: Box, sample: Sample, sizes: Reals, at: tuple[int, ...]) -> tuple[Fraction, ...]:
    """The top of the parabolas through a local maximum and its neighbours, axis by axis."""
    place = []
    for k, (axis, value) in enumerate(zip(box.axes, sample.place, strict=True)):
        shift = 0.0
        if 0 < at[k] < sizes.shape[k] - 1:
            before, here, after = (sizes[(*at[:k], at[k] + step, *at[k + 1 :])] for step in (-1, 0, 1))
            bend = before - 2 * here + after
            shift = float((before - after) / (2 * bend)) if bend < 0 else 0.0
        step = float(axis.high - axis.low) / max(sizes.shape[k] - 1, 1)
        moved = value + Fraction(round(shift * step * 2**40), 2**40)
        place.append(min(max(moved, axis.low), axis.high))
    return tuple(place)
