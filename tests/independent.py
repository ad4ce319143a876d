"""A second way to every number of `relaxations`, through state space and SciPy only: no modal coordinates, no closed forms of ours."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.signal import tf2ss

from relaxations.commands import Command
from relaxations.plants import LinearPlant

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class StateSpace:
    """`x' = A x + B u`, `y = C x + D u`; A (n, n), B (n,), C (n,)."""

    A: Reals
    B: Reals
    C: Reals
    D: float

    @staticmethod
    def of(plant: LinearPlant, output: str | None = None) -> StateSpace:
        """Controller form of the plant's polynomials as floats."""
        numerator = [float(c) for c in reversed(_fractions(plant.numerators[output or plant.output].coeffs()))]
        A, B, C, D = tf2ss(numerator, [float(c) for c in reversed(_fractions(plant.denominator.coeffs()))])
        return StateSpace(A, B[:, 0], C[0], float(D[0, 0]))

    def rest(self, displacement: float) -> tuple[Reals, float]:
        """(x_ss, u_ss) with `A x + B u = 0`, `C x + D u = displacement`."""
        matrix = np.block([[self.A, self.B[:, None]], [self.C[None, :], np.array([[self.D]])]])
        solution = np.linalg.solve(matrix, np.append(np.zeros(len(self.B)), displacement))
        return np.asarray(solution[:-1], dtype=np.float64), float(solution[-1])

    def step(self, width: float) -> tuple[Reals, Reals, Reals]:
        """Exact transition over `width` [s]: of the state, of a constant input, of a ramp of slope 1."""
        n = len(self.B)
        matrix = np.zeros((n + 2, n + 2))
        matrix[:n, :n], matrix[:n, n], matrix[n, n + 1] = self.A, self.B, 1.0
        result = np.asarray(expm(matrix * width), dtype=np.float64)
        return result[:n, :n], result[:n, n], result[:n, n + 1]

    def states(self, command: Command, times: Reals, rest: float = 0.0) -> Reals:
        """x at `times` [s] from x = 0, shape (len(times), n): a matrix exponential for each piece. No decaying tail (use `integrate`)."""
        points = np.unique(np.concatenate([[0.0], command.breakpoints, times]))
        states = {0.0: np.zeros(len(self.B))}
        for a, b in itertools.pairwise(points):
            middle = float(command((a + b) / 2, rest)) - rest
            slope = (float(command(a + 0.75 * (b - a), rest)) - float(command(a + 0.25 * (b - a), rest))) / (0.5 * (b - a))
            transition, constant, ramp = self.step(b - a)
            states[float(b)] = transition @ states[float(a)] + constant * (middle - slope * (b - a) / 2) + ramp * slope
        return np.array([states[float(t)] for t in times])

    def output(self, states: Reals, inputs: Reals) -> Reals:
        return states @ self.C + self.D * inputs

    def integrate(self, command: Command, times: Reals, rest: float = 0.0) -> Reals:
        """y at `times` [s], tail included, by an adaptive Runge-Kutta method of order 8 that restarts at every breakpoint."""
        points = np.unique(np.concatenate([[0.0], command.breakpoints, times]))
        states = {0.0: np.zeros(len(self.B))}
        for a, b in itertools.pairwise(points):
            last = float(command(np.nextafter(b, a), rest)) - rest

            def slope(t: float, x: Reals, b: float = b, last: float = last) -> Reals:
                return self.A @ x + self.B * (last if t >= b else float(command(t, rest)) - rest)

            states[float(b)] = solve_ivp(slope, (a, b), states[float(a)], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        return self.output(np.array([states[float(t)] for t in times]), command(times, rest) - rest)


def reachable_fraction(plant: StateSpace, displacement: float, lower: float, upper: float, time: float, cells: int) -> float:
    """The largest α such that a staircase of `cells` equal steps within the limits (deviations) reaches α of the rest in `time` [s]."""
    target, _ = plant.rest(displacement)
    transition, constant, _ = plant.step(time / cells)
    columns, column = np.zeros((len(target), cells)), constant
    for k in range(cells - 1, -1, -1):
        columns[:, k] = column
        column = transition @ column
    scale = np.abs(columns).max(axis=1)
    equations = np.column_stack([columns, -target]) / scale[:, None]
    cost = np.append(np.zeros(cells), -1.0)
    result = linprog(cost, A_eq=equations, b_eq=np.zeros(len(target)), bounds=[*[(lower, upper)] * cells, (None, None)], method="highs")
    assert result.success, result.message
    return float(result.x[-1])


def _fractions(coefficients: list) -> list[float]:
    return [int(c.p) / int(c.q) for c in coefficients]
