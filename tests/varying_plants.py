"""Varying plants for tests: cranes and double integrators, seeded random ones, and their transition by another method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from forgery import RECORDED
from numpy.typing import NDArray
from proving import found_once
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.maneuvers import Limits, Maneuver, Problem
from relaxations.plants import Exact, exact
from relaxations.proofs import REGULAR
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


@dataclass(frozen=True)
class Asked:
    """An independent statement of a task: deviations from the initial rest; `hold` that of the final input, `rows` of limited outputs."""

    state: Reals
    hold: float
    limits: tuple[float, float]
    begin: Reals
    rate: tuple[float, float] | None = None
    fuel: float | None = None
    rows: tuple[tuple[Reals, float], ...] = ()


def admits(plant: VaryingPlant, asked: Asked, duration: float, cells: int) -> bool:
    """Whether HiGHS finds levels on so many equal cells, steps between them and outputs at their ends within limits too."""
    edges, n = np.linspace(0.0, duration, cells + 1), plant.order
    moved = np.column_stack([asked.begin, np.zeros((n, 0))])

    def rates(t: float, x: Reals) -> Reals:
        A, B = matrices(plant, t)
        now = x.reshape(n, -1)
        return (A @ now + np.outer(B, np.append(np.zeros(now.shape[1] - 1), 1.0))).ravel()

    above, most = [], []
    for i, (begin, end) in enumerate(pairwise(edges)):
        breaks = [begin, *(float(t) for t in plant.instants if begin < t < end), end]
        moved = np.column_stack([moved, np.zeros(n)])
        for s, t in pairwise(breaks):
            moved = solve_ivp(rates, (s, t), moved.ravel(), method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1].reshape(n, -1)
        for table, limit in asked.rows:
            row = np.array([np.interp(end, [float(t) for t in plant.instants], column) for column in table.T]) @ moved
            for sign in (1.0, -1.0):
                above.append(np.append(sign * row[1:], np.zeros(cells - i - 1)))
                most.append(limit - sign * row[0])
    step = duration / cells
    if asked.rate is not None:
        for k in range(cells + 1):
            change, fixed = np.zeros(cells), 0.0
            if k < cells:
                change[k] = 1.0
            else:
                fixed = asked.hold
            if k:
                change[k - 1] -= 1.0
            above += [change, -change]
            most += [asked.rate[1] * step - fixed, fixed - asked.rate[0] * step]
    lower, upper = asked.limits
    scale = np.abs(moved[:, 1:]).max(axis=1)
    equal, target = moved[:, 1:] / scale[:, None], (asked.state - moved[:, 0]) / scale
    if asked.fuel is None:
        bounds, table = [asked.limits] * cells, above
    else:  # levels are differences of two parts
        bounds, table = [(0.0, upper)] * cells + [(0.0, -lower)] * cells, [np.append(row, -row) for row in above]
        equal, table, most = np.hstack([equal, -equal]), [*table, np.full(2 * cells, step)], [*most, asked.fuel]
    found = linprog(
        np.zeros(len(bounds)),
        A_ub=np.array(table) if table else None,
        b_ub=most or None,
        A_eq=equal,
        b_eq=target,
        bounds=bounds,
        method="highs",
    )
    return found.status == 0


def asked_of(plant: VaryingPlant, maneuver: Maneuver) -> Asked:
    """The independent statement of a maneuver from rest at input 0."""
    state, hold = plant.rest(maneuver.displacement)
    limits, begin = maneuver.limits, maneuver.initial or [0] * plant.order
    known = {"output": plant.C, **plant.outputs}
    return Asked(
        np.array(state, dtype=float),
        float(hold),
        (float(limits.lower), float(limits.upper)),
        np.array(begin, dtype=float),
        None if limits.rate is None else (float(limits.rate[0]), float(limits.rate[1])),
        None if limits.fuel is None else float(limits.fuel),
        tuple((np.array(known[name], dtype=float), float(limit)) for name, limit in limits.deflection.items()),
    )


def rest(plant: VaryingPlant, displacement: Exact = 1) -> Reals:
    return np.array([float(x) for x in plant.rest(Fraction(displacement))[0]])


HOISTING = crane({"0": "8", "1": "7.5", "2": "6.75", "3": "6.25", "4": "6"})

STIFF_A, STIFF_B, STIFF_C = [[0, 1], [-1, 0]], [0, 1], [1, 0]  # held at its target by an input


def proven(asked: Problem, gap: float = REGULAR) -> tuple[Bound, Command, bytes]:
    found = found_once(asked)
    assert found.status is Status.PROVED, found.reason
    assert found.command is not None
    assert found.upper is not None
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.upper - found.lower <= gap * found.lower
    return found, found.command, found.certificate


SWING_AND_SPEED = replace(
    HOISTING, outputs={name: (tuple(Fraction(i == k) for k in range(4)),) * 5 for name, i in (("swing", 2), ("speed", 1))}
)
STEP = Fraction(1, 10)


def _limited(plant: VaryingPlant, displacement: str, limits: Limits, *begin: str, **others: Any) -> Callable[[], Problem]:
    initial = tuple(map(Fraction, begin)) if begin else None
    return lambda: varying_problem(plant, Maneuver(exact(displacement), limits, initial=initial, **others))


CERTIFIED: dict[str, tuple[Callable[[], Problem], float]] = {
    "growing": (lambda: posed(GROWING), REGULAR),
    "hoisting": (lambda: posed(HOISTING), REGULAR),
    "hoisting_far": (lambda: posed(HOISTING, 2), REGULAR),
    "hoisting_fuel": (lambda: posed(HOISTING, 2, fuel="2"), REGULAR),
    "random": (lambda: posed(random_plant(7)), REGULAR),
    "held": (lambda: posed(VaryingPlant.of([0, 1], [STIFF_A] * 2, [STIFF_B] * 2, [STIFF_C] * 2), "0.5"), REGULAR),
    "sampled": (
        _limited(
            *(SWING_AND_SPEED, "1", Limits.of(-1, "0.8", 2, {"swing": "0.12", "speed": "0.7"}, (-4, 5)), "0", "0", "1/10", "0"),
            sample_time=STEP,
        ),
        REGULAR,
    ),
    "sloping": (_limited(GROWING, "1", Limits.of(-1, 1, rate=(-5, 5)), "0", "1"), 5e-4),
    "coasting": (_limited(GROWING, "0.5", Limits.of(-1, 1, deflection={"output_rate": "0.6"})), 5e-4),
}
"""Tasks of plants that vary, and how close their sides are."""


@cache
def certified(name: str) -> bytes:
    """The certificate of one of these."""
    if (file := RECORDED / f"varying_{name}.json").exists():
        return file.read_bytes()
    pose, gap = CERTIFIED[name]
    return proven(pose(), gap)[2]
