"""The transition of a plant that varies, enclosed: x' = A(t) x + B(t) u, A and B linear between the instants of a schedule, then constant.

Rows q Φ(0, t) with the transition Φ (docs/theory.md, section 3) are over a step the series Σ Y_k τ^k with
`(k+1) Y_{k+1} = -(Y_k A_0 + Y_{k-1} A_1)`, cut off, and a ball around the rest of it. With weights w > 0 and |q| = Σ |q_i| w_i of a row,
|q A| ≤ (a_0 + a_1 τ) |q|, so that `|Y_0| e^{a_0 τ + a_1 τ²/2}` has coefficients that are no smaller than those of |Y|; and of a series
with the sum m(τ) and coefficients m_k ≥ 0 those beyond K add at most `ρ^{-K-1} m(ρ τ)`, ρ > 1.

What drives the rows on their way, or what they drive, is a matter of further components (`varying_courses`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import flint
from flint import arb, arb_mat, arb_poly, fmpq

from relaxations.checking.balls import spend
from relaxations.checking.reading import Undecided

RATIO, REACH = 8, 1.5  # ρ, and the length of a step times a_0
SWEEPS, LIGHTEST = 60, 2.0**-12  # of the iteration for the weights, and the least of these


@dataclass(frozen=True, slots=True)
class Series:
    """A power series in the time since a step's begin, cut off: what is left out of value and slope is in balls around 0."""

    polynomial: arb_poly
    left: arb
    steep: arb

    def over(self, a: arb, b: arb) -> tuple[arb, arb, arb, arb]:
        """The middle c of [a, b], the value there, and balls around slope and value on all of [a, b]."""
        spend(40)
        c = ((a + b) / 2).mid()
        x, moved = a.union(b).union(c) - c, self.polynomial(arb_poly([c, 1]))
        return c, moved[0] + self.left, moved.derivative()(x) + self.steep, moved(x) + self.left

    def integral(self, s: arb) -> arb:
        """From 0 to s."""
        return self.polynomial.integral()(s) + self.left * s

    def raised(self, level: arb) -> Series:
        """The series plus a constant."""
        return Series(self.polynomial + level, self.left, self.steep)

    def integrated(self, first: arb, length: arb) -> Series:
        """Its integral from `first` on, within a step of that length."""
        return Series(self.polynomial.integral() + first, arb(0, (abs(self.left) * length).upper()), self.left)


@dataclass(frozen=True, slots=True)
class Step:
    """Rows q Φ(0, t) from `begin` on, for so many seconds: the matrices of their series, those of A and B, and what is left out of each."""

    begin: fmpq
    length: fmpq
    rows: list[arb_mat]
    column: tuple[arb_mat, arb_mat]
    left: arb_mat  # of the rows
    beyond: arb  # of p = q Φ(0, t) B(t), for each row

    @property
    def costate(self) -> Series:
        """q Φ(0, t) B(t) of the one row that there is."""
        polynomial = arb_poly([product(self.rows, self.column, k)[0, 0] for k in range(len(self.rows))])
        return Series(polynomial, self.beyond, self.beyond * len(self.rows) / arb(self.length))

    def impulse(self, tau: arb) -> arb_mat:
        """q Φ(0, t) B(t)."""
        return (horner(self.rows, tau) + self.left) * (self.column[0] + self.column[1] * tau)

    def step(self, tau: arb) -> arb_mat:
        """Its integral from the begin of the step on."""
        terms = [product(self.rows, self.column, k) / (k + 1) for k in range(len(self.rows))]
        return horner(terms, tau) * tau + arb_mat(self.left.nrows(), 1, [self.beyond * tau] * self.left.nrows())

    def ramp(self, tau: arb) -> arb_mat:
        """The integral of that."""
        terms = [product(self.rows, self.column, k) / ((k + 1) * (k + 2)) for k in range(len(self.rows))]
        rest = [self.beyond * tau * tau / 2] * self.left.nrows()
        return horner(terms, tau) * tau * tau + arb_mat(self.left.nrows(), 1, rest)


def horner(series: Sequence[arb_mat], tau: arb) -> arb_mat:
    """The sum of a cut-off series of matrices."""
    value = series[-1]
    for coefficient in reversed(series[:-1]):
        value = value * tau + coefficient
    return value


def product(series: Sequence[arb_mat], linear: tuple[arb_mat, arb_mat], k: int) -> arb_mat:
    """Coefficient k of a series times a linear function."""
    return series[k] * linear[0] + series[k - 1] * linear[1] if k else series[0] * linear[0]


def weights(schedule: Any) -> list[arb]:
    """Positive weights for which the norms of all A are small: about the eigenvector of |A| for its largest eigenvalue."""
    n = len(schedule.B[0])
    size = [[max(abs(float(arb(a[i][j]))) for a in schedule.A) for j in range(n)] for i in range(n)]
    scale = max(map(max, size)) or 1.0
    found = [1.0] * n
    for _ in range(SWEEPS):
        moved = [sum(size[i][j] / scale * found[j] for j in range(n)) + 0.01 * found[i] for i in range(n)]
        found = [max(x / max(moved), LIGHTEST) for x in moved]
    return [arb(x) for x in found]


Kick = tuple[fmpq, Callable[[arb_mat], arb_mat]]  # at an instant the rows are others


def added(change: arb_mat) -> Callable[[arb_mat], arb_mat]:
    """The rows and what is added to them."""
    return lambda rows: rows + change


def steps(schedule: Any, start: arb_mat, end: arb, kicks: Sequence[Kick] = ()) -> Iterator[Step]:
    """From 0 until `end` is reached: enclosures of `start` Φ(0, t), changed by `kicks` at their instants, which ascend."""
    n, at, w, rows, waiting = len(schedule.B[0]), fmpq(0), weights(schedule), start, [*kicks][::-1]
    matrices = [(arb_mat(n, n, [x for row in a for x in row]), arb_mat(n, 1, b)) for a, b in zip(schedule.A, schedule.B, strict=True)]
    count = 8 + int((flint.ctx.prec + 20) / 3)
    while True:
        while waiting and waiting[-1][0] <= at:
            rows = waiting.pop()[1](rows)
        after = next((i for i, instant in enumerate(schedule.instants) if instant > at), None)
        if after is None:
            (A, B), room = matrices[-1], None
            rise, growth = arb_mat(n, n), arb_mat(n, 1)
        else:
            width = schedule.instants[after] - schedule.instants[after - 1]
            (A, B), (last, other) = matrices[after - 1 : after + 1]
            rise, growth = (last - A) / arb(width), (other - B) / arb(width)
            A, B = (here + change * arb(at - schedule.instants[after - 1]) for here, change in ((A, rise), (B, growth)))
            room = schedule.instants[after] - at
        if waiting and (room is None or waiting[-1][0] - at < room):
            room = waiting[-1][0] - at
        a_0, a_1 = (largest([weighed(matrix.tolist()[i], w) / w[i] for i in range(n)]) for matrix in (A, rise))
        # As long as the bound of what is left out allows; a power of 2, so that instants stay short.
        length = fmpq(2) ** 20
        while not (a_0 + a_1 * RATIO * arb(length) / 2) * arb(length) <= REACH:
            length /= 2
            if length < fmpq(2) ** -60:
                raise Undecided("the plant's matrices are too large to follow its transition")
        if room is not None and length >= room:
            length = room
        spend(count * (4 + n * n * rows.nrows() / 8))
        series = [rows]
        for k in range(count):
            series.append(product(series, (A, rise), k) / -(k + 1))
        far = arb(length) * RATIO * (1 + arb(2) ** -20)  # a hair beyond the step, too
        kept = (a_0 * far + a_1 * far * far / 2).exp() / arb(RATIO) ** (count + 1)
        sizes = [weighed(row, w) * kept for row in rows.tolist()]
        left = arb_mat(rows.nrows(), n, [arb(0, (size / w[j]).upper()) for size in sizes for j in range(n)])
        b, more = (largest([abs(x) / w[i] for i, x in enumerate(column.entries())]) for column in (B, growth))
        yield Step(at, length, series, (B, growth), left, arb(0, (largest(sizes) * (b + far * more)).upper()))
        rows, at = horner(series, arb(length)) + left, at + length
        if at >= end:
            return


def weighed(row: Sequence[arb], w: Sequence[arb]) -> arb:
    """Σ |q_i| w_i."""
    return sum((abs(x) * weight for x, weight in zip(row, w, strict=True)), arb(0))


def largest(numbers: Sequence[arb]) -> arb:
    """A bound of all of them."""
    found = arb(0)
    for number in numbers:
        found = found.max(number.upper())
    return found
