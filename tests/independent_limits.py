"""Minimum times under further limits by a second way: state space, a linear program for each time in HiGHS, bisection. Nothing dual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from independent import StateSpace
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.plants import LinearPlant

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Limited:
    """State rest of a plant under limits: of the input, of `∫ |u|`, of the input's slope (the input is then continuous, from 0), and of
    named outputs at the ends of the cells."""

    plant: LinearPlant
    displacement: float
    lower: float
    upper: float
    fuel: float | None = None
    rate: tuple[float, float] | None = None
    deflections: Mapping[str, float] = field(default_factory=dict)

    def fraction(self, time: float, cells: int) -> float:
        """The largest α such that α of the rest is reached in `time` [s]; the input is `cells` steps, or so many ramps."""
        model, h = StateSpace.of(self.plant), time / cells
        target, hold = model.rest(self.displacement)
        transition, constant, ramp = model.step(h)
        n, count = len(target), cells + 1
        # Unknown: node values v_0 … v_N (of steps the first N), the same parts without sign, α.
        states = np.zeros((count, n, count))
        for k in range(cells):
            states[k + 1] = transition @ states[k]
            states[k + 1][:, k] += constant - ramp / h if self.rate else constant
            if self.rate:
                states[k + 1][:, k + 1] += ramp / h
        scale = np.abs(states[-1]).max(axis=1)
        split = np.hstack([np.eye(count), -np.eye(count)])  # v = v⁺ - v⁻
        equal = [np.hstack([states[-1] @ split, -target[:, None]]) / scale[:, None]]
        below, bounds = [np.zeros((0, 2 * count + 1))], [np.zeros(0)]

        def at_most(rows: Reals, limit: float) -> None:
            below.append(np.hstack([rows, np.zeros((len(rows), 1))]))
            bounds.append(np.full(len(rows), limit))

        weights = np.full(count, h)
        if self.rate:
            weights[[0, -1]] = h / 2
            ends = np.zeros((2, 2 * count + 1))
            ends[0, [0, count]], ends[1, [cells, count + cells, -1]] = (1.0, -1.0), (1.0, -1.0, -hold)
            equal.append(ends)
            slopes = np.diff(np.eye(count), axis=0) @ split / h
            at_most(slopes, self.rate[1])
            at_most(-slopes, -self.rate[0])
        else:
            weights[-1] = 0.0
        if self.fuel is not None:
            at_most(np.tile(weights, 2)[None, :], self.fuel)
        for name, limit in self.deflections.items():
            row = StateSpace.of(self.plant, name).C
            courses = np.einsum("n,knm->km", row, states)[1:] @ split
            at_most(courses, limit)
            at_most(-courses, limit)
        rows, right = np.vstack(equal), np.zeros(sum(map(len, equal)))
        parts = [*[(0.0, self.upper)] * count, *[(0.0, -self.lower)] * count, (None, None)]
        cost = np.append(np.zeros(2 * count), -1.0)
        found = linprog(cost, A_eq=rows, b_eq=right, A_ub=np.vstack(below), b_ub=np.concatenate(bounds), bounds=parts, method="highs")
        assert found.success, found.message
        return float(found.x[-1])

    def time(self, low: float, high: float, cells: int, digits: float = 1e-5) -> float:
        """The least time of the grid [s] between `low`, where the target is out of reach, and `high`, where it is not."""
        assert self.fraction(low, cells) < 1.0 < self.fraction(high, cells)
        while high - low > digits * high:
            middle = (low + high) / 2
            low, high = (low, middle) if self.fraction(middle, cells) >= 1.0 else (middle, high)
        return high
