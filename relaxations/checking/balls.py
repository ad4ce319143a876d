"""The plant in balls: isolated roots with exact multiplicities, moments, exponential polynomials. Everything returned encloses the truth.

Rest after the move is `M = target + Σ c_j column_j` for the moments `M_{p,k} = ∫_0^T s^k/k! e^{ps} u(T - s) ds` of the command's deviation u
and the real coefficients c_j of its tail (docs/theory.md, equation 1). A complex moment counts as two real ones, (Re, -Im): coefficients
(re, im) of a costate then pair with it as `Re c M`, and those of a tail with its shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import flint
from flint import acb, acb_mat, acb_poly, arb, fmpq, fmpq_poly, fmpz

from relaxations.checking.reading import Chain, PlantData, Task, require

ORDER = 8  # of Taylor's formula
ISOLATION_BITS = 2048  # roots that these do not tell apart make a check inconclusive: it would cost too much
LARGEST_POLYNOMIAL = 2_000_000  # bits times degree

_work = {"left": 0.0}


class Inconclusive(Exception):
    """Neither proved nor refuted, at any precision."""


class Undecided(Inconclusive):
    """Ball arithmetic cannot decide at this precision."""


class Refuted(Exception):
    """An inequality that the claim rests on is proven false for the given witness."""


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Work with `bits` bits inside the block: python-flint's precision is global."""
    before, flint.ctx.prec = flint.ctx.prec, bits
    try:
        yield
    finally:
        flint.ctx.prec = before


def budget(units: float) -> None:
    """Allow so much work from now on, in units of about a microsecond: counted, so that every machine ends at the same place."""
    _work["left"] = units


def spend(units: float) -> None:
    """Count work; raises `Inconclusive` when the budget is spent."""
    _work["left"] -= units * (1 + flint.ctx.prec / 512)
    if _work["left"] < 0:
        raise Inconclusive("more work than a check may cost")


@dataclass(frozen=True, slots=True)
class Root:
    """A root with Im ≥ 0 in a ball that holds no other; `flexible` stands for a conjugate pair."""

    value: acb
    multiplicity: int
    flexible: bool

    @property
    def size(self) -> int:
        return self.multiplicity * (1 + self.flexible)

    def impulse(self, s: arb) -> list[acb]:
        """b_k(s) = s^k/k! e^{ps} for k < multiplicity."""
        spend(4 + 2 * self.multiplicity)
        values = [(self.value * s).exp()]
        for k in range(1, self.multiplicity):
            values.append(values[-1] * s / k)
        return values

    def step(self, s: arb) -> list[acb]:
        """S_k(s) = ∫_0^s b_k, by parts: S_k = (b_k - S_{k-1}) / p with S_{-1} = 1."""
        values, below = self.impulse(s), acb(1)
        for k, b in enumerate(values):
            values[k] = below = b * s / (k + 1) if self.value.is_zero() else (b - below) / self.value
        return values


def flat(roots: Sequence[Root], entries: Callable[[Root], Sequence[acb]]) -> list[arb]:
    """Complex numbers for every root and k < multiplicity as real ones: (Re, -Im), at a real root Re alone."""
    return [part for root in roots for entry in entries(root) for part in (entry.real, -entry.imag)[: 1 + root.flexible]]


def dot(xs: Sequence[arb], ys: Sequence[arb]) -> arb:
    """Σ x y."""
    return sum((x * y for x, y in zip(xs, ys, strict=True)), arb(0))


def placed(roots: Sequence[Root], chains: Sequence[Chain]) -> tuple[list[fmpq], list[tuple[int, Root]]]:
    """The numbers of chains in the flat order, and where each chain begins, with its root: the nearest one (a wrong one proves nothing)."""
    numbers, found = [fmpq(0)] * sum(root.size for root in roots), []
    for near, coefficients in chains:
        require(bool(roots), "coefficients of a tail that the task does not have")
        best = min(range(len(roots)), key=lambda i: float(abs(roots[i].value - acb(*near)).mid()))
        begin, root = sum(other.size for other in roots[:best]), roots[best]
        fits = len(coefficients) <= root.multiplicity and (root.flexible or not any(c[1] for c in coefficients))
        require(fits and (begin, root) not in found, "a root is named twice, or with other coefficients than its multiplicity allows")
        found.append((begin, root))
        for place, number in enumerate((part for c in coefficients for part in c[: 1 + root.flexible]), begin):
            numbers[place] = number
    return numbers, found


@lru_cache(maxsize=32)
def _isolated(coefficients: tuple[fmpz, ...], bits: int) -> tuple[tuple[acb, bool], ...]:
    """The roots with Im ≥ 0 of a square-free polynomial (lowest power first) to a relative 2^-bits, and whether each is one of a pair."""
    try:
        accuracy = arb(2) ** -bits / acb_poly(list(coefficients[::-1])).root_bound()
        balls = acb_poly(list(coefficients)).roots(tol=accuracy, maxprec=ISOLATION_BITS)
    except ValueError:
        raise Inconclusive("roots of the plant are too close to be told apart") from None
    # A root whose ball meets the real axis is real if the mirrored ball, which holds the mirrored root, meets no other one.
    if any(ball.imag.contains(0) and sum(ball.conjugate().overlaps(other) for other in balls) > 1 for ball in balls):
        raise Undecided("a root is not told from its conjugate at this precision")
    real = tuple((acb(ball.real), False) for ball in balls if ball.imag.contains(0))
    return real + tuple((ball, True) for ball in balls if ball.imag > 0)


def isolated(polynomial: fmpq_poly) -> tuple[Root, ...]:
    """All distinct roots with Im ≥ 0 and their exact multiplicities: square-free factorisation, then certified isolation."""
    whole = polynomial.numer()
    rigid = next(k for k, c in enumerate(whole.coeffs()) if c != 0)
    found = [Root(acb(0), rigid, False)] if rigid else []
    for factor, multiplicity in whole.right_shift(rigid).factor_squarefree()[1]:
        found += [Root(value, multiplicity, flexible) for value, flexible in _isolated(tuple(factor.coeffs()), flint.ctx.prec)]
    if sum(root.size for root in found) != polynomial.degree():
        raise Undecided("not every root was isolated")
    return tuple(found)


def stable(numerator: fmpq_poly) -> tuple[Root, ...]:
    """The zeros strictly left of the imaginary axis. Those on it are common to N(s) and N(-s), and counted there exactly."""
    common = numerator.gcd(fmpq_poly([c * (-1) ** k for k, c in enumerate(numerator.coeffs())]))
    squares = isolated(fmpq_poly(common.coeffs()[::2]))  # in w = s²: the common part is even, for N(0) is not 0
    on_axis = sum(not w.flexible and bool(w.value.real < 0) for w in squares)
    zeros = isolated(numerator)
    left = tuple(zero for zero in zeros if zero.value.real < 0)
    if len(zeros) != len(left) + on_axis + sum(bool(zero.value.real > 0) for zero in zeros):
        raise Undecided("a zero is not told from the imaginary axis at this precision")
    return left


def further(roots: Sequence[Root], data: PlantData) -> list[int]:
    """Further zeros at each root: mode[i] (flexible) and real[i] count by ascending magnitude, which must be clear where counts differ."""
    result, left = [0] * len(roots), dict(data.zeros)
    for kind, flexible in (("mode", True), ("real", False)):
        sizes = {i: abs(root.value) for i, root in enumerate(roots) if root.flexible is flexible and not root.value.is_zero()}
        counts = [left.pop(f"{kind}[{place}]", 0) for place in range(1, len(sizes) + 1)]
        for i, size in sizes.items():
            smaller, larger = sum(other < size for other in sizes.values()), sum(other > size for other in sizes.values())
            if len({*counts[smaller : len(sizes) - larger]}) > 1:
                raise Undecided("two modes have the same frequency: their order is not defined")
            result[i] = counts[smaller]
    require(not left, f"the plant has no {min(left, default='')[:40]!r}")
    return result


@dataclass(frozen=True, slots=True)
class System:
    """A task in balls; inputs are deviations from the initial rest, exact. `rigid` is the multiplicity of the pole at the origin."""

    task: Task
    roots: tuple[Root, ...]
    zeros: tuple[Root, ...]
    rigid: int
    rest: fmpq
    lower: fmpq
    upper: fmpq
    target: list[arb]
    columns: list[list[arb]]

    def room(self, time: fmpq) -> tuple[fmpq, fmpq]:
        """How far above and below the final rest input the tail may be, `time` seconds after the move."""
        above, below = self.upper - self.rest, self.rest - self.lower
        since, within = self.task.limits[1] or (time + 1, fmpq(1))
        share = within * min(above, below) if time >= since else max(above, below)
        return min(above, share), min(below, share)


def system(task: Task) -> System:
    """The task's equations; raises `Malformed` if it is no task: no rest within the limits, or hidden modes under output rest."""
    (data,) = task.plants
    numerator, denominator = (fmpq_poly(list(written[::-1])) for written in (data.numerator, data.denominator))
    for polynomial in (numerator, denominator):
        require(polynomial.numer().height_bits() * len(data.denominator) <= LARGEST_POLYNOMIAL, "the plant's numbers are too long")
    output = task.rest == "output"
    require(not output or numerator.gcd(denominator).degree() == 0, "under output rest numerator and denominator have no common factor")
    found = isolated(denominator)
    rigid = next((root.multiplicity for root in found if root.value.is_zero()), 0)
    ratio = task.displacement * denominator[rigid] / numerator[0]
    rest = fmpq(0) if rigid else ratio
    lower, upper = (limit - task.initial_input for limit in task.limits[0])
    require(lower <= min(0, rest) and max(0, rest) <= upper, "the limits exclude the input at a rest")
    roots = tuple(
        Root(root.value, root.multiplicity + extra, root.flexible) for root, extra in zip(found, further(found, data), strict=True)
    )
    zeros = stable(numerator) if output else ()
    spend(sum(zero.size for zero in zeros) * sum(root.size for root in roots))

    def target(root: Root) -> list[acb]:
        if root.value.is_zero():
            return [acb(0)] * (rigid - 1) + [acb(ratio)]
        return [acb(rest) / (-root.value) ** (k + 1) for k in range(root.multiplicity)]

    def column(zero: acb, power: int, unit: acb) -> list[arb]:
        """What `Re unit r^l/l! e^{zr}` after the move adds: `(-1)^l C(k+l, l) / (z - p)^(k+l+1)`, half for z and half for its conjugate."""

        def entries(root: Root) -> list[acb]:
            signs = [comb(k + power, power) * (-1) ** power for k in range(root.multiplicity)]
            halves = [(unit / 2, 1 / (zero - root.value)), (unit.conjugate() / 2, 1 / (zero.conjugate() - root.value))]
            return [sign * sum((half * x ** (k + power + 1) for half, x in halves), acb(0)) for k, sign in enumerate(signs)]

        return flat(roots, entries)

    units = (acb(1), acb(0, 1))
    columns = [column(z.value, power, unit) for z in zeros for power in range(z.multiplicity) for unit in units[: 1 + z.flexible]]
    return System(task, roots, zeros, rigid, rest, lower, upper, flat(roots, target), columns)


@dataclass(frozen=True, slots=True)
class Wave:
    """`Re Σ_roots Σ_k c_k s^k/k! e^{ps}`: a costate in time to go, a tail in time after the move. Row j of `rows` belongs to its derivative j."""

    roots: tuple[Root, ...]
    rows: acb_mat

    @staticmethod
    def of(roots: tuple[Root, ...], numbers: Sequence[arb | fmpq]) -> Wave:
        """From real coefficients in the flat order; d/ds turns c_k into p c_k + c_{k+1}."""
        rest = iter(numbers)
        rows = [[acb(next(rest), next(rest) if root.flexible else 0) for root in roots for _ in range(root.multiplicity)]]
        last = [(root.value, k + 1 < root.multiplicity) for root in roots for k in range(root.multiplicity)]
        for _ in range(ORDER):
            rows.append(
                [p * c + (after if chained else 0) for (p, chained), c, after in zip(last, rows[-1], [*rows[-1][1:], 0], strict=True)]
            )
        return Wave(roots, acb_mat(rows))

    def __call__(self, s: arb) -> list[arb]:
        """Its value and derivatives at s; over a ball of s balls around all their values there."""
        return [x.real for x in (self.rows * acb_mat([[x] for root in self.roots for x in root.impulse(s)])).entries()]

    def integral(self, s: arb) -> arb:
        """From 0 to s."""
        return (self.rows * acb_mat([[x] for root in self.roots for x in root.step(s)]))[0, 0].real

    def over(self, a: arb, b: arb) -> tuple[arb, arb, arb, arb]:
        """The middle c of [a, b], the value there, and balls around slope and value on all of [a, b], by Taylor's formula."""
        c, whole = ((a + b) / 2).mid(), a.union(b)
        x, terms = whole - c, [*self(c)[:-1], self(whole)[-1]]
        slope = value = terms[-1]
        for j in range(ORDER - 1, -1, -1):
            slope = terms[j] + x * slope / j if j else slope
            value = terms[j] + x * value / (j + 1)
        return c, terms[0], slope, value
