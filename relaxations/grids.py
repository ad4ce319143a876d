"""Where the instants of the grid lie: dense where a mode is alive, coarse where it is not.

A mode that decays leaves its mark on the costate within some time constants of the end of the move, one that grows within some of its
beginning. A uniform grid would have to resolve the fastest mode everywhere, or would miss those boundary layers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import SolverError
from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

FADING = 0.25  # the density of a mode's instants is halved after four time constants: the mode itself has lost 98 % by then
UNRESOLVED = 20  # times the most cells: a grid so much too coarse says nothing
OUTLINE = 400  # points in which the density is sketched, uniform and towards each end


def grid(problem: Problem, horizon: float, least: int, per_period: float, most: int) -> Reals:
    """Instants 0 … `horizon` [s], ascending: `least` cells, doubled until every mode has `per_period` of them a period, `most` or so.

    Numbers of cells come in few sizes, so that programs are compiled once.
    """
    poles = {pole for pole in problem.poles if pole}
    fastest = max((abs(pole) for pole in poles), default=0.0)
    to_go = np.linspace(0.0, horizon, OUTLINE)
    if fastest * horizon > OUTLINE:
        layer = np.geomspace(0.01 / fastest, horizon, OUTLINE)
        to_go = np.unique(np.concatenate([to_go, layer, horizon - layer[:-1]]))
    modes = np.zeros(to_go.shape)
    for pole in poles:
        distance = to_go if pole.real <= 0.0 else horizon - to_go
        modes = np.maximum(modes, per_period * abs(pole) / (2 * np.pi) / (1.0 + FADING * abs(pole.real) * distance))
    cells, wanted = least, float(np.trapezoid(modes, to_go))
    if wanted > UNRESOLVED * most:
        periods = wanted / per_period
        raise SolverError(f"the move would last some {periods:.2g} periods of the plant's fastest modes, more than a grid can resolve")
    while cells < wanted and cells < most:
        cells *= 2
    density = modes + least / horizon
    counted = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(to_go))])
    instants = horizon - np.interp(np.linspace(counted[-1], 0.0, cells + 1), counted, to_go)
    instants[[0, -1]] = 0.0, horizon
    return instants
