"""Too little fuel, whatever the time: the costate that asks for the most of what no command needs less than.

With `|λᵀ b(s)| ≤ 1` for all s ≥ 0 every command of T seconds has `λᵀ target - λᵀ drift(T) ≤ ∫ |u| dt` and the price of the tail's limits;
the best λ and prices for all T at once are a small linear program (docs/theory.md, section 5). A candidate: the checker decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.maneuvers import Problem

Reals = NDArray[np.float64]

LONG, COUNT, FINER = 12.0, 600, 8  # time constants of the slowest motion that decays, instants of a grid, how much finer one to look at
SPARSE = 4  # of these instants, times of moves
FAR = 100.0  # times as long, from where on what decays is gone
TOKEN = 1e-12  # of the limits' distance, burnt for a second: a budget that is as good as none
MARGIN = 1e-7  # of the price: how far beyond the largest costate it is


def spending(problem: Problem) -> tuple[Reals, float, tuple[tuple[float, float, float], ...]] | None:
    """Costate, price of the fuel, and of the tail's limits (instant, above, below); None where there is no such bound.

    Poles at which it could grow with the time to go are left out.
    """
    if problem.fuel is None or problem.residuals is not None or len(problem.sets) != 1:
        return None
    poles, tail = problem.sets[0].basis.poles, problem.tail
    if any(pole.value.real > 0.0 or (pole.value.real == 0.0 and pole.multiplicity > 1) for pole in poles):
        return None
    paces = [-root.value.real for root in (*poles, *tail.zeros) if root.value.real < 0.0]
    turning = [abs(pole.value) for pole in poles if pole.value.real == 0.0 and pole.value]
    long = max([LONG / pace for pace in paces] + [2 * np.pi / omega for omega in turning] + [1.0])
    grid, fine = (np.linspace(0.0, long, count) for count in (COUNT, FINER * COUNT))
    grid, times = (
        np.union1d(grid, FAR * long + grid),
        np.union1d(np.linspace(0.0, long, COUNT // 4), tail.known) if tail.size else np.zeros(0),
    )
    table = problem.rows(grid)
    scale = np.abs(table).max(axis=1)
    size, count = problem.size, len(times)
    (above, below), shapes = tail.room(times), tail.rows(times).T if tail.size else np.zeros((0, 0))
    limited = np.vstack([(table / scale[:, None]).T, -(table / scale[:, None]).T])
    aims = (problem.target[:, None] if problem.begin is None else problem.aim(grid[::SPARSE])[0]) / scale[:, None]
    none = np.zeros((len(limited), 2 * count + 1))
    asked = np.hstack([-aims.T, np.zeros((aims.shape[1], 2 * count)), np.ones((aims.shape[1], 1))])  # the least that it asks for, of all T
    found = linprog(
        np.concatenate([np.zeros(size), above, below, [-1.0]]),
        A_ub=np.vstack([np.hstack([limited, none]), asked]),
        b_ub=np.concatenate([np.ones(len(limited)), np.zeros(len(asked))]),
        A_eq=np.hstack([tail.columns.T / scale, shapes, -shapes, np.zeros((tail.size, 1))]) if tail.size else None,
        b_eq=np.zeros(tail.size) if tail.size else None,
        bounds=[(None, None)] * size + [(0.0, None)] * (2 * count) + [(None, None)],
        method="highs",
    )
    if found.status != 0 or -found.fun <= problem.fuel:
        return None
    costate, up, down = found.x[:size] / scale, found.x[size : size + count], found.x[size + count : size + 2 * count]
    courses = [costate @ problem.rows(begin + fine) for begin in (0.0, FAR * long)]
    largest = max(float(np.abs(p).max() + np.abs(np.diff(p, 2)).max() / 8.0) for p in courses)  # and what is between two instants
    priced = np.flatnonzero((up > 0.0) | (down > 0.0))
    return costate, max(largest, 1.0) * (1.0 + MARGIN), tuple((float(times[i]), float(up[i]), float(down[i])) for i in priced)


def least_fuel(problem: Problem) -> float | None:
    """Fuel [input units · s] that every command needs, however long it takes: `λᵀ target / price`, in floating point; under state rest.

    None where there is no such bound, or none above 0: a mass on thrusters needs the less the longer it takes; and from an initial state.
    """
    limits = problem.maneuver.limits
    least = (
        None
        if problem.tail.size or problem.begin is not None
        else spending(replace(problem, fuel=TOKEN * float(limits.upper - limits.lower)))
    )
    return None if least is None else float(least[0] @ problem.target) / least[1]
