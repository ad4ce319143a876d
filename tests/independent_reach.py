"""What a staircase reaches in a given time, by a program that shares nothing with ours: a chain of integrators in 1024 bits, and HiGHS.

The plant N/D with further zeros F (F = 1: none) is `D(d/dt) F(d/dt) w = u`, `y = N(d/dt) F(d/dt) w`, with the state x = (w, w', …).
It rests in x = (Δ / (N(0) F(0)), 0, …). A tail moves w by a solution of `S(d/dt) w = 0`, S being the factor of N with the zeros on the
left. All that needs digits is done before the program: powers of the transition, and an orthonormal basis of its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import contextmanager
from fractions import Fraction

import flint
import numpy as np
from flint import acb, acb_poly, arb, arb_mat, fmpq, fmpq_poly
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.plants import LinearPlant

BITS = 1024
INSTANTS = 200
"""At so many the tail is held within the limits, densely at first: what is left out can only help to reach more."""


@contextmanager
def many_bits():
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        yield
    finally:
        flint.ctx.prec = before


def monic(roots: Sequence[acb]) -> list[arb]:
    """Coefficients of ∏(s - root), the constant first, for roots in conjugate pairs."""
    product = acb_poly([1])
    for root in roots:
        product *= acb_poly([-root, 1])
    return [coefficient.real.mid() for coefficient in product.coeffs()]


def roots_of(polynomial: fmpq_poly) -> list[tuple[acb, int]]:
    """The distinct ones, and how often they occur."""
    factors, accurate = polynomial.numer().factor_squarefree()[1], arb(2) ** -(BITS // 2)
    return [(root, count) for factor, count in factors for root in acb_poly(factor.coeffs()).roots(tol=accurate, maxprec=4 * BITS)]


def companion(coefficients: Sequence[arb]) -> arb_mat:
    """x' = A x for a monic polynomial of d/dt, given by its coefficients, the constant first."""
    n = len(coefficients) - 1
    return arb_mat(n, n, [-coefficients[j] if i == n - 1 else arb(int(j == i + 1)) for i in range(n) for j in range(n)])


def cholesky(matrix: arb_mat) -> arb_mat:
    """The lower triangular L with L Lᵀ = matrix."""
    factor = [[arb(0)] * matrix.nrows() for _ in range(matrix.nrows())]
    for i, row in enumerate(factor):
        for j in range(i + 1):
            rest = matrix[i, j] - sum((row[k] * factor[j][k] for k in range(j)), arb(0))
            row[j] = rest.sqrt() if i == j else rest / factor[j][j]
    return arb_mat(factor)


def doubles(matrix: arb_mat) -> NDArray[np.float64]:
    return np.array([float(x.mid()) for x in matrix.entries()]).reshape(matrix.nrows(), matrix.ncols())


class Reach:
    """The largest α such that a staircase of `cells` equal steps (deviations within limits) comes to rest at α Δ in a given time.

    `further` zeros are added at each flexible pole; with `tail` the output alone rests, and the tail keeps within α times the limits.
    """

    def __init__(
        self,
        plant: LinearPlant,
        displacement: Fraction,
        limits: tuple[Fraction, Fraction],
        further: int = 0,
        tail: bool = False,
    ) -> None:
        numerator, denominator = plant.numerators[plant.output], plant.denominator
        with many_bits():
            zeros = [root for root, count in roots_of(numerator) for _ in range(count) if root.real < 0] if tail else []
            more = monic([root for root, _ in roots_of(denominator) for _ in range(further) if not root.imag.contains(0)])
            lead = denominator.coeffs()[-1]
            self.whole = [c.real for c in (acb_poly([acb(c / lead) for c in denominator.coeffs()]) * acb_poly(more)).coeffs()]
            size = arb(fmpq(displacement.numerator, displacement.denominator))
            self.place = size / (arb(numerator.coeffs()[0] / lead) * more[0])
            self.hold = float((self.whole[0] * self.place).mid())
            self.motions, self.slowest = monic(zeros), max((float(zero.real.mid()) for zero in zeros), default=-1.0)
        self.limits = tuple(map(float, limits))

    def tail_table(self, count: int) -> tuple[arb_mat, arb_mat]:
        """States w, w', … at the beginning of each motion of the tail (columns), and the inputs at `count` instants (a row each)."""
        m, n = len(self.motions) - 1, len(self.whole) - 1
        begin = [[arb(int(i == j)) for j in range(m)] for i in range(m)]
        while len(begin) <= n:
            begin.append([-sum((self.motions[k] * begin[len(begin) - m + k][j] for k in range(m)), arb(0)) for j in range(m)])
        first = arb_mat([[sum((self.whole[k] * begin[k][j] for k in range(n + 1)), arb(0)) for j in range(m)]])
        generator, last = companion(self.motions), 40.0 / -self.slowest
        inputs = [(first * (generator * arb(last * (i / (count - 1)) ** 3)).exp()).tolist()[0] for i in range(count)]
        return arb_mat(begin[:n]), arb_mat(inputs)

    def __call__(self, time: float, cells: int, instants: int = INSTANTS) -> float:
        """α at `time` [s]; the tail is held within the limits at so many instants."""
        with many_bits():
            n, m = len(self.whole) - 1, len(self.motions) - 1
            generator = companion(self.whole)
            driven = arb_mat([*([*row, arb(int(i == n - 1))] for i, row in enumerate(generator.tolist())), [arb(0)] * (n + 1)])
            step = (driven * (arb(time) / cells)).exp().mid().tolist()
            transition = arb_mat([row[:n] for row in step[:n]])
            columns = [arb_mat([row[n:] for row in step[:n]])]
            for _ in range(cells - 1):
                columns.append((transition * columns[-1]).mid())  # else balls grow with every step
            rows = arb_mat([[columns[cells - 1 - k][i, 0] for k in range(cells)] for i in range(n)])
            target = [[-self.place] if i == 0 else [arb(0)] for i in range(n)]
            inputs = np.zeros((0, m))
            if m:
                begins, table = self.tail_table(instants)
                # New coordinates of the tail: its inputs become orthonormal columns.
                turning = cholesky(table.transpose() * table)
                inputs, moved = doubles(turning.solve(table.transpose())).T, turning.solve(begins.transpose()).transpose()
                target = [[*row, *(-x for x in extra)] for row, extra in zip(target, moved.tolist(), strict=True)]
            turning = cholesky(rows * rows.transpose())
            values, rest = doubles(turning.solve(rows)), doubles(turning.solve(arb_mat(target)))
        (low, high), hold = self.limits, self.hold
        equations = np.hstack([values, rest])
        cost = np.zeros(equations.shape[1])
        cost[cells] = -1.0
        bounds = [*[(low, high)] * cells, *[(None, None)] * (1 + m)]
        above = np.hstack([np.zeros((len(inputs), cells)), np.full((len(inputs), 1), hold - high), inputs])
        below = np.hstack([np.zeros((len(inputs), cells)), np.full((len(inputs), 1), low - hold), -inputs])
        result = linprog(
            cost,
            A_eq=equations,
            b_eq=np.zeros(n),
            A_ub=np.vstack([above, below]) if m else None,
            b_ub=np.zeros(2 * len(inputs)) if m else None,
            bounds=bounds,
            method="highs",
        )
        assert result.success, result.message
        return float(result.x[cells])
