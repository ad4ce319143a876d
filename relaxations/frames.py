"""A frame: other coordinates of the moment equations, in which they are orthonormal over a horizon.

The rows b of long chains of modes are nearly dependent. Over T seconds signals of a bandwidth of ω rad/s have some ωT/π degrees of freedom;
where there are more equations than that, each further one adds less than the one before, to a free-free chain a thousandth for every 20
poles more, and doubles, which know b to 1e-16, end at about 90. So the rows are combined once in as many digits as that takes, `f = W b`,
and f, which is of order one and as smooth as b, is kept as a Chebyshev series: from there on doubles are good enough for everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from relaxations.plants import precision

Reals = NDArray[np.float64]

CHUNK = 4096  # points evaluated at a time: the table of their cosines stays small


def nodes(count: int) -> Reals:
    """Angles θ of the Chebyshev points cos θ."""
    return (np.arange(count) + 0.5) * np.pi / count


def series(values: Reals) -> Reals:
    """Chebyshev coefficients of functions given at `nodes`: shape (n, count) both."""
    count = values.shape[1]
    coefficients = values @ np.cos(np.outer(nodes(count), np.arange(count))) * (2.0 / count)
    coefficients[:, 0] /= 2.0
    return coefficients


@dataclass(frozen=True, slots=True)
class Frame:
    """`f = W b` on [0, horizon] [s]: Chebyshev series (size, degree + 1) of f and of its integral from 0, `f' = slopes f`, the target in f.

    `change` is W with `bits` bits, `outside` the same in doubles.
    """

    horizon: float
    functions: Reals
    integrals: Reals
    slopes: Reals
    target: Reals
    outside: Reals
    change: arb_mat
    bits: int

    @property
    def condition(self) -> float:
        """How much larger than f the terms may be that it is combined of."""
        return float(np.abs(self.outside).max())

    def rows(self, s: Reals, integrals: int) -> Reals:
        """f or its integral at times to go s in [0, horizon] [s]: shape (size, len(s))."""
        coefficients = self.integrals if integrals else self.functions
        result, degrees = np.empty((len(coefficients), len(s))), np.arange(coefficients.shape[1])[:, None]
        for at in range(0, len(s), CHUNK):
            part = slice(at, at + CHUNK)
            result[:, part] = coefficients @ np.cos(degrees * np.arccos(np.clip(2.0 * s[part] / self.horizon - 1.0, -1.0, 1.0)))
        return result

    def modal(self, costate: Reals) -> tuple[Fraction, ...]:
        """The costate of b of which `costate` is that of f, `Wᵀ λ`, with a third of W's digits: what is left after the Gram matrix."""
        with precision(self.bits):
            column = self.change.transpose() * arb_mat(len(costate), 1, [arb(float(value)) for value in costate])
            return tuple(decimal(value, self.bits // 10) for value in column.entries())


def decimal(value: arb, digits: int) -> Fraction:
    """The middle of a ball to so many digits."""
    return Fraction(value.mid().str(digits, radius=False, more=True))


def doubles(matrix: arb_mat) -> Reals:
    """The middles of a matrix of balls."""
    return np.array([float(value.mid()) for value in matrix.entries()]).reshape(matrix.nrows(), matrix.ncols())
