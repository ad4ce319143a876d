"""The frame (`relaxations.frames`) that a problem's moment equations ask for: their orthonormal combinations, found in long floats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from flint import arb, arb_mat

from relaxations.digits import equations
from relaxations.frames import Frame, doubles, nodes, series
from relaxations.maneuvers import Problem
from relaxations.plants import precision

BITS, BITS_PER_EQUATION = 128, 4  # a Gram matrix has the square of the rows' condition
EXTRA_NODES = 64  # beyond one for each radian and each equation
MOST_NODES = 2000  # the longest move that one series follows has twice as many radians of its fastest mode
TRIES = 3  # with twice the bits and half as many nodes again each time
EXACT = 1e-9  # how far from orthonormal the functions found, and how large a series' last coefficients, may be


def framed(problem: Problem, horizon: float) -> Problem | None:
    """The problem in a frame on [0, `horizon`] [s]; None if its modes are too fast, too many or too much alike, it begins in motion
    or varies."""
    if problem.begin is not None or problem.transition is not None:
        return None
    fastest = max((abs(pole.value) for own in problem.sets for pole in own.basis.poles), default=0.0)
    count = int(fastest * horizon / 2) + problem.size + EXTRA_NODES
    for bits in ((BITS + BITS_PER_EQUATION * problem.size) * 2**k for k in range(TRIES)):
        if count > MOST_NODES:
            break
        with precision(bits):
            found = _framed(problem, horizon, count, bits)
        if found is not None:
            return found
        count += count // 2
    return None


def _framed(problem: Problem, horizon: float, count: int, bits: int) -> Problem | None:
    exact = equations(problem, bits)
    points = horizon / 2 * (1.0 + np.cos(nodes(count)))
    weights = horizon / 2 * np.pi / count * np.sin(nodes(count))  # of the integral over the horizon: any positive ones would do
    table = exact.rows([arb(float(s)) for s in points])
    heavy = arb_mat([[value * w for value, w in zip(row, map(arb, weights.tolist()), strict=True)] for row in table.tolist()])
    factor = _factor((heavy * table.transpose()).tolist())
    if factor is None:
        return None
    size = len(factor)
    back = arb_mat([[*row, *[arb(0)] * (size - len(row))] for row in factor])  # b = L f
    change = back.solve(arb_mat(size, size, 1), algorithm="approx")
    values = doubles(change * table)
    functions, integrals = series(values), series(doubles(change * exact.rows([arb(float(s)) for s in points], True)))
    last = max(float(np.abs(one[:, -count // 16 :]).max() / np.abs(one).max()) for one in (functions, integrals))
    if not max(last, float(np.abs(values * weights @ values.T - np.eye(size)).max())) <= EXACT:
        return None
    slopes, target, columns = (doubles(change * other) for other in (exact.slopes() * back, exact.target, exact.columns))
    frame = Frame(horizon, functions, integrals, slopes, target[:, 0], doubles(change), change, bits)
    return replace(problem, frame=frame, tail=replace(problem.tail, columns=columns))


def _factor(gram: list[list[arb]]) -> list[list[arb]] | None:
    """Cholesky's factor L, `L Lᵀ = gram`, its rows up to the diagonal; None where the digits do not tell that the matrix is positive."""
    factor: list[list[arb]] = []
    for i, given in enumerate(gram):
        row: list[arb] = []
        for j in range(i + 1):
            left = given[j]
            other = factor[j] if j < i else row
            for k in range(j):
                left -= row[k] * other[k]
            if j == i and not left > 0:
                return None
            row.append((left.sqrt() if j == i else left / other[j]).mid())
        factor.append(row)
    return factor
