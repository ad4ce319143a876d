"""How the reachable fraction α of the target rises with the time T of a move: what Newton's method needs to find the root of α(T) = 1.

All multipliers stand at fixed times to go, so that by the envelope theorem the right side of (2) gains its integrand at T, and the left one
the drift of a plant that does not begin at rest (docs/theory.md, section 3):

    dα/dT = σ(p(T) - q'(T)) + rate(q(T)) - α d/dT [λ·target(T) + Σ ν v_free(T - s)]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relaxations.maneuvers import Problem
from relaxations.presses import off, over
from relaxations.prices import Prices
from relaxations.varying_courses import driven

Reals = NDArray[np.float64]

NEARBY = 1e-5  # of T: how far apart a course without an input is looked at for its slope


def rise(problem: Problem, costate: Reals, prices: Prices, time: float, fraction: float) -> float:
    """dα/dT [1/s] at a move of `time` [s], of multipliers scaled as those of a program's solution of this `fraction` are."""
    end, fuel, rate = _last(problem, costate, prices, time), float(prices.fuel), 0.0
    ramp = prices.ramps[-1] if prices.ramps and problem.rate is not None and prices.ramps[-1].edges[-1] > time else None
    if ramp is not None and problem.rate is not None:  # the move begins within it: the input is inside its limits, and q what is left
        edges = np.array([*(edge for edge in ramp.edges if edge < time), time])
        begins = edges[0] == 0.0
        q = (prices.steps[0] if prices.steps else None) if begins else 0.0
        gained = _integral(problem, costate, prices, edges[[0, -1]]) - float(np.array(ramp.levels[: len(edges) - 1]) @ np.diff(edges))
        q, end = 0.0 if q is None else q + gained, ramp.levels[len(edges) - 2]
        rate = max(problem.rate[0] * q, problem.rate[1] * q)
    dead = float(np.clip(end, -fuel, fuel))
    drift = float(costate @ problem.aim(np.array([time]))[1][:, 0])
    if problem.begin is not None and prices.pressed:
        around = time * np.array([1.0 - NEARBY, 1.0 + NEARBY])
        drift += float(np.diff(sum(press.freely(around) for press in prices.pressed))[0] / (around[1] - around[0]))
    return max(problem.upper * (end - dead), problem.lower * (end - dead)) + rate - fraction * drift


def _last(problem: Problem, costate: Reals, prices: Prices, time: float) -> float:
    """p(T)."""
    if not prices.pressed:
        return float(costate @ problem.rows([time])[:, 0])
    if problem.transition is not None:
        return float(driven(costate, prices.pressed, np.array([0.0, time]))[1][-1])
    return float(costate @ problem.rows([time])[:, 0]) - off(prices.pressed, time)


def _integral(problem: Problem, costate: Reals, prices: Prices, edges: Reals) -> float:
    """The integral of p between two times to go."""
    if problem.transition is not None and prices.pressed:
        return float(np.diff(driven(costate, prices.pressed, edges)[2])[0])
    return float(np.diff(costate @ problem.rows(edges, 1))[0]) - float(over(prices.pressed, edges)[0])
