"""Minimum times under further limits by a second way: state space, a linear program for each time in HiGHS, bisection. Nothing dual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    named outputs at `looks` instants of every cell.

    With `steps` the input is constant over the cells and the limits of the slope are those of its steps, h times as large for `step` h [s].
    A plant that is not at rest has the coordinate ξ, D(d/dt) ξ = u, and its derivatives at `start`.
    """

    plant: LinearPlant
    displacement: float
    lower: float
    upper: float
    fuel: float | None = None
    rate: tuple[float, float] | None = None
    deflections: Mapping[str, float] = field(default_factory=dict)
    start: Sequence[float] = ()
    step: float | None = None
    looks: int = 1

    def fraction(self, time: float, cells: int) -> float:
        """The largest α such that α of the rest, less what becomes of α of the start, is reached in `time` [s], in so many cells."""
        model, h = StateSpace.of(self.plant), time / cells
        target, hold = model.rest(self.displacement)
        n, count, sloped = len(target), cells + 1, self.rate is not None and self.step is None
        # Unknown: node values v_0 … v_N (of steps the first N), the same parts without sign, α: states are x_k = states[k] v + α drift[k].
        begin = np.array(self.start[::-1]) if len(self.start) else np.zeros(n)
        looked, drifts, parts = [], [], [model.step(h * j / self.looks) for j in range(1, self.looks + 1)]
        state, drift = np.zeros((n, count)), begin
        for k in range(cells):
            for transition, constant, ramp in parts:
                inner = transition @ state
                inner[:, k] += constant - ramp / h if sloped else constant
                if sloped:
                    inner[:, k + 1] += ramp / h
                looked.append(inner)
                drifts.append(transition @ drift)
            state, drift = looked[-1], drifts[-1]
        scale = np.abs(state).max(axis=1)
        split = np.hstack([np.eye(count), -np.eye(count)])  # v = v⁺ - v⁻
        equal = [np.hstack([state @ split, (drift - target)[:, None]]) / scale[:, None]]
        below, bounds = [np.zeros((0, 2 * count + 1))], [np.zeros(0)]

        def at_most(rows: Reals, limit: float) -> None:
            below.append(rows if rows.shape[1] == 2 * count + 1 else np.hstack([rows, np.zeros((len(rows), 1))]))
            bounds.append(np.full(len(rows), limit))

        weights = np.full(count, h)
        if sloped:
            weights[[0, -1]] = h / 2
            ends = np.zeros((2, 2 * count + 1))
            ends[0, [0, count]], ends[1, [cells, count + cells, -1]] = (1.0, -1.0), (1.0, -1.0, -hold)
            equal.append(ends)
        else:
            weights[-1] = 0.0
        if self.rate is not None:
            steps = np.diff(np.eye(count), axis=0) @ split
            if self.step is not None:  # the first step, and the last one, to α hold
                steps = np.vstack([split[:1], steps[:-1], -split[-2:-1]])
            steps = np.hstack([steps, np.zeros((len(steps), 1))])
            if self.step is not None:
                steps[-1, -1] = hold
            width = h if self.step is None else self.step
            at_most(steps, self.rate[1] * width)
            at_most(-steps, -self.rate[0] * width)
        if self.fuel is not None:
            at_most(np.tile(weights, 2)[None, :], self.fuel)
        for name, limit in self.deflections.items():
            row = StateSpace.of(self.plant, name).C
            courses = np.column_stack([np.array([row @ x for x in looked]) @ split, [row @ x for x in drifts]])
            at_most(courses, limit)
            at_most(-courses, limit)
        rows, right = np.vstack(equal), np.zeros(sum(map(len, equal)))
        sides = [*[(0.0, self.upper)] * count, *[(0.0, -self.lower)] * count, (0.0, None)]
        cost = np.append(np.zeros(2 * count), -1.0)
        found = linprog(cost, A_eq=rows, b_eq=right, A_ub=np.vstack(below), b_ub=np.concatenate(bounds), bounds=sides, method="highs")
        assert found.success, found.message
        return float(found.x[-1])

    def time(self, low: float, high: float, cells: int, digits: float = 1e-5) -> float:
        """The least time of the grid [s] between `low`, where the target is out of reach, and `high`, where it is not."""
        assert self.fraction(low, cells) < 1.0 < self.fraction(high, cells)
        while high - low > digits * high:
            middle = (low + high) / 2
            low, high = (low, middle) if self.fraction(middle, cells) >= 1.0 else (middle, high)
        return high
