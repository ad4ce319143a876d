"""Robust minimum times under further limits by a second way: state space of some plants of a box, linear programs in HiGHS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import factorial

import numpy as np
from independent import StateSpace
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.plants import LinearPlant

Reals = NDArray[np.float64]


def resting(plant: LinearPlant, output: str | None = None) -> float:
    """`N(0) / (D/s^r)(0)` by the coefficients, r poles at the origin."""
    below = [int(c.p) / int(c.q) for c in plant.denominator.coeffs()]
    above = [int(c.p) / int(c.q) for c in plant.numerators[output or plant.output].coeffs()] or [0.0]
    return above[0] / next(c for c in below if c)


@dataclass(frozen=True)
class Boxed:
    """Some plants (the first is the nominal one) that share a command and may keep a residual of `allowed` each about where they rest.

    `deflections` limit named outputs in all of them, at all nodes and `looks` instants in a `window` [s] after the move.
    """

    plants: Sequence[LinearPlant]
    displacement: float
    lower: float
    upper: float
    allowed: float
    rate: tuple[float, float] | None = None
    deflections: Mapping[str, float] = field(default_factory=dict)
    window: float = 20.0
    looks: int = 240

    def fraction(self, time: float, cells: int) -> float:
        """The largest α of the target that is reached in `time` [s] with so many cells; the residuals scale with it."""
        h, count, plant = time / cells, cells + 1, self.plants[0]
        rigid, gain = plant.rigid_order, resting(plant)
        hold = 0.0 if rigid else self.displacement / gain
        to_go, sloped = time - h * np.arange(count), self.rate is not None
        # Columns: node values v_0 … v_N (of steps the first N) and α.
        equal, below, bounds = [np.zeros((0, count + 1))], [np.zeros((0, count + 1))], [np.zeros(0)]
        for k in range(rigid):  # ∫ s^k/k! u ds, exactly
            row = np.zeros(count + 1)
            powers = [to_go ** (k + j) / factorial(k + j) for j in (1, 2)]
            if sloped:
                risen = (powers[1][:-1] - powers[1][1:]) / h - powers[0][1:]  # ∫ of s^k/k! times the share of the cell's second node
                row[1:count] += risen
                row[: count - 1] += -np.diff(powers[0]) - risen
            else:
                row[: count - 1] = -np.diff(powers[0])
            row[-1] = -(self.displacement / gain if k == rigid - 1 else 0.0)
            equal.append(row[None, :])
        if sloped:
            ends = np.zeros((2, count + 1))
            ends[0, 0], ends[1, cells], ends[1, -1] = 1.0, 1.0, -hold
            equal.append(ends)
            steps = np.hstack([np.diff(np.eye(count), axis=0), np.zeros((cells, 1))])
            assert self.rate is not None
            below += [steps, -steps]
            bounds += [np.full(cells, self.rate[1] * h), np.full(cells, -self.rate[0] * h)]
        for one in self.plants:
            model = StateSpace.of(one)
            transition, constant, ramp = model.step(h)
            later, lasting, _ = model.step(self.window / self.looks)
            state, inner = np.zeros((len(constant), count + 1)), []
            for k in range(cells):
                state = transition @ state
                state[:, k] += constant - ramp / h if sloped else constant
                if sloped:
                    state[:, k + 1] += ramp / h
                inner.append(state)
            after = [state]
            for _ in range(self.looks):
                state = later @ state
                state[:, -1] += lasting * hold
                after.append(state)
            final = self.displacement * resting(one) / gain
            course = np.array([model.C @ x for x in after])
            course[:, -1] += model.D * hold - final
            for sign in (1.0, -1.0):
                rows = sign * course
                rows[:, -1] -= self.allowed
                below.append(rows)
                bounds.append(np.zeros(len(rows)))
            for name, limit in self.deflections.items():
                row = StateSpace.of(one, name).C
                seen = np.array([row @ x for x in [*inner, *after]])
                below += [seen, -seen]
                bounds += [np.full(len(seen), limit)] * 2
        rows = np.vstack(equal)
        rows = rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True, initial=0.0), 1e-300)
        cost = np.append(np.zeros(count), -1.0)
        sides = [*[(self.lower, self.upper)] * count, (0.0, None)]
        found = linprog(
            cost, A_eq=rows, b_eq=np.zeros(len(rows)), A_ub=np.vstack(below), b_ub=np.concatenate(bounds), bounds=sides, method="highs"
        )
        assert found.success, found.message
        return float(found.x[-1])

    def time(self, low: float, high: float, cells: int, digits: float = 1e-4) -> float:
        """The least time of the grid [s] between `low`, where the target is out of reach, and `high`, where it is not."""
        assert self.fraction(low, cells) < 1.0 < self.fraction(high, cells)
        while high - low > digits * high:
            middle = (low + high) / 2
            low, high = (low, middle) if self.fraction(middle, cells) >= 1.0 else (middle, high)
        return high
