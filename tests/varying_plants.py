"""Varying plants for tests: cranes and double integrators, seeded random ones, and their transition by another method."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.maneuvers import Limits, Maneuver, Problem
from relaxations.plants import Exact, exact
from relaxations.proofs import REGULAR, minimum_time
from relaxations.transitions import VaryingPlant
from relaxations.varying import varying_problem

Reals = NDArray[np.float64]

GROWING = VaryingPlant.of([0, 2], [[[0, 1], [0, 0]]] * 2, [[0, 1], [0, 3]], [[1, 0]] * 2)
"""x'' = (1 + t) u until t = 2."""


def crane(lengths: dict[str, str], gravity: str = "9.81") -> VaryingPlant:
    """A trolley whose acceleration is commanded, a load on a cable of these lengths, by their instants; no damping."""
    g, B, A, C = exact(gravity), [], [], []
    for length in map(exact, lengths.values()):
        A.append([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -g / length, 0]])
        B.append([0, 1, 0, -1 / length])
        C.append([1, 0, length, 0])
    return VaryingPlant.of(list(lengths), A, B, C)


def random_plant(seed: int) -> VaryingPlant:
    """A rigid body and a mode whose frequency, damping and gains vary over two to four instants."""
    rng = np.random.default_rng([25, seed])
    count = int(rng.integers(2, 5))
    instants = [0, *np.cumsum(rng.uniform(0.3, 1.5, count - 1)).round(3).tolist()]
    A, B = [], []
    for _ in instants:
        omega, zeta, pull = rng.uniform(1.5, 3.0), rng.choice([0.0, 0.05, 0.2]), rng.uniform(0.0, 0.5)
        A.append([[0, 1, 0, 0], [0, 0, _short(pull), 0], [0, 0, 0, 1], [0, 0, _short(-(omega**2)), _short(-2 * zeta * omega)]])
        B.append([0, _short(rng.uniform(0.5, 1.5)), 0, _short(rng.uniform(-1.0, -0.3))])
    return VaryingPlant.of([str(t) for t in instants], A, B, [[1, 0, _short(rng.uniform(0.2, 1.0)), 0]] * len(instants))


def _short(value: float) -> str:
    return f"{value:.4f}"


def posed(plant: VaryingPlant, displacement: Exact = 1, lower: Exact = -1, upper: Exact = 1, fuel: Exact | None = None) -> Problem:
    return varying_problem(plant, Maneuver(exact(displacement), Limits.of(lower, upper, fuel)))


def matrices(plant: VaryingPlant, t: float) -> tuple[Reals, Reals]:
    """A and B at an instant."""
    instants = [float(x) for x in plant.instants]
    share = np.array([np.interp(t, instants, unit) for unit in np.eye(len(instants))])
    return np.tensordot(share, np.array(plant.A, dtype=float), 1), share @ np.array(plant.B, dtype=float)


def landed(plant: VaryingPlant, starts: Reals, levels: Reals, duration: float) -> Reals:
    """The state at the end of a staircase from rest, by Runge and Kutta's method of order 8 between all jumps."""
    edges = np.unique([*starts, duration, *(float(t) for t in plant.instants if t < duration)])
    state = np.zeros(plant.order)
    for begin, end in pairwise(edges):
        level = levels[np.searchsorted(starts, begin, side="right") - 1]

        def rates(t: float, x: Reals, level: Any = level) -> Reals:
            A, B = matrices(plant, t)
            return A @ x + B * level

        state = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return state


def reaches(plant: VaryingPlant, state: Reals, duration: float, limits: tuple[float, float], cells: int = 120) -> bool:
    """Whether HiGHS finds a staircase from rest to `state`; the transition is that of `solve_ivp`, cell by cell."""
    edges, columns = np.linspace(0.0, duration, cells + 1), np.zeros((plant.order, 0))

    def rates(t: float, x: Reals) -> Reals:
        A, B = matrices(plant, t)
        moved = x.reshape(plant.order, -1)
        return (A @ moved + np.outer(B, np.append(np.zeros(moved.shape[1] - 1), 1.0))).ravel()

    for begin, end in pairwise(edges):
        extended = np.hstack([columns, np.zeros((plant.order, 1))])
        columns = solve_ivp(rates, (begin, end), extended.ravel(), method="RK45", rtol=1e-8, atol=1e-10).y[:, -1].reshape(plant.order, -1)
    scale = np.abs(columns).max(axis=1)
    found = linprog(np.zeros(cells), A_eq=columns / scale[:, None], b_eq=state / scale, bounds=[limits] * cells, method="highs")
    return found.status == 0


def rest(plant: VaryingPlant, displacement: Exact = 1) -> Reals:
    return np.array([float(x) for x in plant.rest(Fraction(displacement))[0]])


HOISTING = crane({"0": "8", "1": "7.5", "2": "6.75", "3": "6.25", "4": "6"})

STIFF_A, STIFF_B, STIFF_C = [[0, 1], [-1, 0]], [0, 1], [1, 0]  # held at its target by an input


def proven(asked: Problem, gap: float = REGULAR) -> tuple[Bound, Command, bytes]:
    found = minimum_time(asked)
    assert found.status is Status.PROVED, found.reason
    assert found.command is not None
    assert found.upper is not None
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.upper - found.lower <= gap * found.lower
    return found, found.command, found.certificate
