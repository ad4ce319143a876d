"""Where a plant that is not at rest begins: exact coordinates, their moments, and how these move on without an input.

A controllable plant `D(d/dt) ξ = u`, `y = N(d/dt) ξ` (deviations from rest) is described by ξ and its first n - 1 derivatives. With
`D(s)/(s - p)^{k+1} = Σ q_i s^i` its moments are `M_{p,k} = Σ q_i ξ^{(i)}`, for `(d/dt - p) M_{p,k}` is M_{p,k-1}, or u for k = 0. So a
plant that begins with moments m rests at T if the command's own moments there are `target - E(T) m`, E(T) m what m becomes without input.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import cast

import numpy as np
from flint import acb, fmpq_mat, fmpq_poly
from numpy.typing import NDArray

from relaxations.errors import ManeuverError
from relaxations.moments import Basis
from relaxations.plants import Exact, LinearPlant, exact, fraction, precision, rational

Reals = NDArray[np.float64]

BITS = 256


def from_state(plant: LinearPlant, A: Sequence[Sequence[Exact]], B: Sequence[Exact], state: Sequence[Exact]) -> tuple[Fraction, ...]:
    """ξ and its derivatives of a plant `x' = A x + B u` at the deviation x = `state`.

    `x = Σ w_i ξ^{(i)}` with `(sI - A)^{-1} B = Σ w_i s^i / D(s)`.

    Raises `ManeuverError` if a part of the state is one that the input cannot move.
    """
    system, vector = (fmpq_mat([[rational(exact(x)) for x in row] for row in rows]) for rows in (A, [[b] for b in B]))
    coefficients, order, size = plant.denominator.coeffs(), plant.order, len(B)
    columns = [vector]  # w_{n-1} = B, w_{i-1} = A w_i + d_i B
    for i in range(order - 1, 0, -1):
        columns.insert(0, system * columns[0] + vector * coefficients[i])
    matrix = fmpq_mat([[column[row, 0] for column in columns] for row in range(size)])
    wanted = fmpq_mat([[rational(exact(x))] for x in state])
    found = (matrix.transpose() * matrix).solve(matrix.transpose() * wanted)
    if matrix * found != wanted:
        raise ManeuverError("the initial state moves a mode that the input cannot reach: no command brings it to rest")
    return tuple(fraction(found[i, 0]) for i in range(order))


def from_output(plant: LinearPlant, derivatives: Sequence[Exact]) -> tuple[Fraction, ...]:
    """ξ and its derivatives of a plant whose output and its derivatives begin as given, n numbers, while the input rests.

    Raises `ManeuverError` for another number of them, and for an output that does not see the whole state.
    """
    n, row = plant.order, plant.numerators[plant.output] % plant.denominator
    if len(derivatives) != n:
        raise ManeuverError(
            f"the plant has {n} states: give the output's deviation and its first {n - 1} derivatives, not {len(derivatives)} numbers"
        )
    rows = []
    for _ in range(n):
        rows.append([row[i] for i in range(n)])
        row = (row * fmpq_poly([0, 1])) % plant.denominator
    matrix = fmpq_mat(rows)
    if matrix.det() == 0:
        raise ManeuverError("the output does not see every mode, so it does not say in what state the plant begins")
    found = matrix.solve(fmpq_mat([[rational(exact(x))] for x in derivatives]))
    return tuple(fraction(found[i, 0]) for i in range(n))


def at_rest(plant: LinearPlant, displacement: Fraction) -> tuple[Fraction, ...]:
    """ξ and its derivatives where the output rests `displacement` away: all but the first are 0."""
    return (displacement / fraction(plant.numerators[plant.output][0]), *[Fraction(0)] * (plant.order - 1))


def moments(plant: LinearPlant, basis: Basis, start: Sequence[Fraction]) -> Reals:
    """The moments (rows of `basis`, whose poles are the plant's) of ξ and its derivatives."""
    values = []
    with precision(BITS):
        found = [root for root, _ in cast("list[tuple[acb, int]]", plant.denominator.complex_roots())]
        for pole in basis.poles:
            near = min(found, key=lambda ball, pole=pole: float(abs(ball - acb(pole.value.real, pole.value.imag)).mid()))
            values += [complex(float(x.real.mid()), float(x.imag.mid())) for x in chain(near, pole.multiplicity, plant.denominator, start)]
    return basis.real(iter(np.array([value]) for value in values))[:, 0]


def chain(pole: acb, multiplicity: int, denominator: fmpq_poly, start: Sequence[Fraction]) -> list[acb]:
    """The moments at one pole of ξ and its derivatives, at the precision that is set."""
    quotient, found = [acb(c) for c in denominator.coeffs()], []
    for _ in range(multiplicity):
        below = [quotient[-1]]  # synthetic division by s - p, from the highest power down
        for coefficient in reversed(quotient[1:-1]):
            below.insert(0, coefficient + pole * below[0])
        quotient = below
        found.append(sum((q * rational(x) for q, x in zip(quotient, start, strict=False)), acb(0)))
    return found


def moved(basis: Basis, begin: Reals, times: Reals) -> tuple[Reals, Reals]:
    """`E(t) m` at times [s], and its derivative: shapes (n, len(times))."""
    course = basis.free(begin, times)
    transposed = np.array([basis.derivative(unit) for unit in np.eye(basis.size)])
    return course, transposed @ course if basis.size else course
