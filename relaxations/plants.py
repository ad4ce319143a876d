"""The linear plant, exact: rational transfer functions over one common denominator.

Every form in which a user may write a plant (polynomials, roots, matrices, modes) is turned into the same exact object, so that
multiplicities come from square-free factorisation and never from clustering floating-point roots (../docs/theory.md, "Poles").
The plant is written in deviations from its operating point; SI units, angles and frequencies in rad and rad/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import cast

import flint
from flint import acb, acb_poly, fmpq, fmpq_mat, fmpq_poly

from relaxations.errors import PlantError

Exact = Fraction | Decimal | int | float | str
"""A number as written: decimals and their strings are read exactly, floats as the binary fraction that they are."""
ComplexExact = Exact | Sequence[Exact]
"""A real number, or a pair (re, im)."""

ROOT_BITS = 192  # roots and residues are computed with this many bits and then rounded, so that every digit of a double is right


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Ball arithmetic with `bits` bits inside the block; python-flint's precision is global, so it is set here only."""
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        yield
    finally:
        flint.ctx.prec = before


def exact(number: Exact) -> Fraction:
    """`number` as a fraction; raises `PlantError` for NaN, infinity or text that is no number."""
    try:
        return Fraction(number)
    except (ValueError, OverflowError, ZeroDivisionError):
        raise PlantError(f"a plant holds finite numbers only, not {number!r}") from None


def rational(number: Fraction) -> fmpq:
    """A fraction as python-flint writes it."""
    return fmpq(number.numerator, number.denominator)


def _fmpq(number: Exact) -> fmpq:
    return rational(exact(number))


def fraction(number: fmpq) -> Fraction:
    """A python-flint rational as a `Fraction`."""
    return Fraction(int(number.p), int(number.q))


def _midpoint(ball: acb) -> complex:
    return complex(float(ball.real.mid()), float(ball.imag.mid()))


@dataclass(frozen=True, slots=True)
class Pole:
    """A root of the denominator with Im ≥ 0 (its conjugate is implied), with its exact multiplicity."""

    value: complex
    multiplicity: int

    @property
    def is_rigid(self) -> bool:
        """At the origin: a rigid-body mode."""
        return self.value == 0

    @property
    def is_flexible(self) -> bool:
        """Complex: one of a conjugate pair."""
        return self.value.imag != 0

    @property
    def natural_frequency(self) -> float:
        """|p| [rad/s]."""
        return abs(self.value)

    @property
    def damping_ratio(self) -> float:
        """ζ = -Re p / |p|; 0 for a rigid-body mode."""
        return (0.0 - self.value.real) / abs(self.value) if self.value else 0.0  # 0.0 - x: never -0.0


def _isolated(polynomial: fmpq_poly) -> list[tuple[acb, int]]:
    """Distinct roots with their multiplicities (the stub of python-flint says otherwise)."""
    return cast("list[tuple[acb, int]]", polynomial.complex_roots())


def roots(polynomial: fmpq_poly) -> tuple[Pole, ...]:
    """Distinct roots with Im ≥ 0, sorted by magnitude, each with its exact multiplicity; a part that is exactly zero is 0.0."""
    if polynomial.degree() < 1:
        return ()
    mirror = fmpq_poly([c * (-1) ** k for k, c in enumerate(polynomial.coeffs())])
    symmetric = polynomial.gcd(mirror)  # roots on the imaginary axis are common to D(s) and D(-s)
    found = []
    with precision(ROOT_BITS):
        for ball, multiplicity in _isolated(polynomial):
            value = _midpoint(ball)
            if value.imag < 0:
                continue
            on_axis = ball.real.contains(0) and symmetric.degree() > 0 and acb_poly(symmetric)(acb(0, ball.imag)).contains(0)
            found.append(Pole(complex(0.0, value.imag) if on_axis else value, multiplicity))
    return tuple(sorted(found, key=lambda pole: (abs(pole.value), pole.value.imag)))


def _residues(numerator: fmpq_poly, denominator: fmpq_poly, pole: acb, multiplicity: int) -> tuple[acb, ...]:
    """Coefficients r_1 … r_m of Σ r_k / (s - p)^k in the partial fractions of numerator/denominator."""
    shift = acb_poly([pole, 1])
    upper = acb_poly(numerator)(shift).coeffs() if numerator else []
    lower = acb_poly(denominator)(shift).coeffs()[multiplicity:]
    upper += [acb(0)] * (multiplicity - len(upper))
    lower += [acb(0)] * (multiplicity - len(lower))
    quotient: list[acb] = []
    for k in range(multiplicity):  # power series division
        quotient.append((upper[k] - sum((quotient[i] * lower[k - i] for i in range(k)), acb(0))) / lower[0])
    return tuple(reversed(quotient))  # the series' first term belongs to the highest power


def taylor(numerator: fmpq_poly, denominator: fmpq_poly, at: complex, count: int) -> tuple[complex, ...]:
    """The first `count` Taylor coefficients of numerator/denominator at a point that is no root of the denominator."""
    with precision(ROOT_BITS):
        shift, padding = acb_poly([acb(at.real, at.imag), 1]), [acb(0)] * count
        above, below = ([*acb_poly(p)(shift).coeffs(), *padding] for p in (numerator, denominator))
        series: list[acb] = []
        for k in range(count):
            series.append((above[k] - sum((series[i] * below[k - i] for i in range(k)), acb(0))) / below[0])
        return tuple(map(_midpoint, series))


@dataclass(frozen=True, slots=True)
class Partial:
    """An output in partial fractions: `D + Σ_i Σ_k residues[i][k-1] / (s - p_i)^k` (a conjugate pair counts twice, as 2 Re)."""

    residues: tuple[tuple[complex, ...], ...]
    feedthrough: float


@dataclass(frozen=True)
class LinearPlant:
    """Single input, named outputs: `y_r(s) = N_r(s) / D(s) u(s)`, D monic, N_r/D not reduced.

    Modes that the input cannot excite are dropped (see `notes`); modes that an output cannot see stay in D, because rest of the state
    includes them. `output` names the controlled output; `output_rate` is its time derivative where that is proper.
    """

    denominator: fmpq_poly
    numerators: Mapping[str, fmpq_poly]
    output: str = "output"
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "numerators", MappingProxyType(dict(self.numerators)))
        if self.denominator.degree() < 0:
            raise PlantError("the denominator is zero")
        for name, numerator in self.numerators.items():
            if numerator.degree() > self.denominator.degree():
                raise PlantError(
                    f"the transfer function to {name!r} is improper: its numerator has degree {numerator.degree()}, "
                    f"its denominator only {self.denominator.degree()}"
                )
        if not self.numerators[self.output]:
            raise PlantError(f"the input does not reach the output {self.output!r}: its transfer function is zero everywhere")

    # Constructors, one for each form of the study file.

    @staticmethod
    def from_transfer(numerator: Sequence[Exact], denominator: Sequence[Exact]) -> LinearPlant:
        """From polynomial coefficients, highest power of s first."""
        return LinearPlant._from_polynomials(
            fmpq_poly([_fmpq(c) for c in reversed(numerator)]), fmpq_poly([_fmpq(c) for c in reversed(denominator)])
        )

    @staticmethod
    def from_zeros_poles(zeros: Sequence[ComplexExact], poles: Sequence[ComplexExact], gain: Exact) -> LinearPlant:
        """From roots; complex ones as pairs (re, im), each with its conjugate."""
        numerator = _fmpq(gain) * _from_roots(zeros, "zeros")
        return LinearPlant._from_polynomials(numerator, _from_roots(poles, "poles"))

    @staticmethod
    def from_modes(rigid: Exact, modes: Sequence[tuple[Exact, Exact, Exact]]) -> LinearPlant:
        """`rigid/s² + Σ gain/(s² + 2ζωs + ω²)` from (frequency ω [rad/s], damping ζ, gain) of each mode.

        Modes of equal frequency and damping move as one: the input cannot excite them apart, so they become one with the sum of the gains.
        """
        gains: dict[tuple[Fraction, Fraction], Fraction] = {}
        for frequency, damping, gain in modes:
            mode = exact(frequency), exact(damping)
            if mode[0] <= 0:
                raise PlantError(f"a flexible mode's frequency is positive, not {float(mode[0])!r} (the rigid body is `rigid`)")
            gains[mode] = gains.get(mode, Fraction(0)) + exact(gain)
        numerator, denominator = fmpq_poly([_fmpq(rigid)]), fmpq_poly([0, 0, 1] if exact(rigid) else [1])
        for (omega, zeta), gain in gains.items():
            factor = fmpq_poly([_fmpq(omega * omega), _fmpq(2 * zeta * omega), 1])
            numerator = numerator * factor + _fmpq(gain) * denominator
            denominator = denominator * factor
        plant = LinearPlant._from_polynomials(numerator, denominator)
        twins = len(modes) - len(gains)
        note = f"{twins} of {len(modes)} modes repeat another's frequency and damping: the input moves them as one, so they were joined"
        return replace(plant, notes=(note,)) if twins else plant

    @staticmethod
    def _from_polynomials(numerator: fmpq_poly, denominator: fmpq_poly) -> LinearPlant:
        if not denominator:
            raise PlantError("the denominator is zero")
        lead = denominator.leading_coefficient()
        return LinearPlant(denominator / lead, _with_rate("output", {"output": numerator / lead}, denominator / lead))

    @staticmethod
    def from_state_space(
        A: Sequence[Sequence[Exact]],
        B: Sequence[Exact],
        C: Sequence[Exact],
        D: Exact = 0,
        outputs: Mapping[str, Sequence[Exact]] | None = None,
        name: str = "output",
    ) -> LinearPlant:
        """From `x' = A x + B u`, `y = C x + D u` (A n×n, B and C of length n) and further outputs as rows of length n.

        Uncontrollable modes are dropped by exact Krylov reduction and mentioned in `notes`.
        """
        n = len(B)
        rows = {**{key: (tuple(row), 0) for key, row in (outputs or {}).items()}, name: (tuple(C), D)}
        if len(A) != n or any(len(row) != n for row in A) or any(len(row) != n for row, _ in rows.values()):
            raise PlantError(f"A is n×n, B and every row of C have n numbers: A is {len(A)}×{len(A[0]) if A else 0}, B has {n}, C {len(C)}")
        system, vector = fmpq_mat([[_fmpq(x) for x in row] for row in A]), fmpq_mat([[_fmpq(x)] for x in B])
        krylov = [vector]
        while len(krylov) <= n:
            krylov.append(system * krylov[-1])
        order = fmpq_mat([[v[i, 0] for v in krylov[:n]] for i in range(n)]).rank()
        denominator = _annihilator(krylov[: order + 1])
        notes = () if order == n else (f"{n - order} of {n} modes cannot be excited by the input and were dropped",)
        numerators = {}
        for key, (row, through) in rows.items():
            markov = [sum((_fmpq(c) * v[i, 0] for i, c in enumerate(row)), fmpq(0)) for v in krylov[:order]]
            numerators[key] = _numerator(markov, denominator) + _fmpq(through) * denominator
        return LinearPlant(denominator, _with_rate(name, numerators, denominator), name, notes)

    # What the mathematics asks of a plant.

    @property
    def order(self) -> int:
        """Number of states that the input can move."""
        return self.denominator.degree()

    @cached_property
    def poles(self) -> tuple[Pole, ...]:
        """Distinct poles with Im ≥ 0, by ascending magnitude."""
        return roots(self.denominator)

    @cached_property
    def zeros(self) -> tuple[Pole, ...]:
        """Distinct zeros of the controlled output with Im ≥ 0, by ascending magnitude (those of hidden modes included)."""
        return roots(self.numerators[self.output])

    @property
    def rigid_order(self) -> int:
        """Multiplicity of the pole at the origin."""
        return next((pole.multiplicity for pole in self.poles if pole.is_rigid), 0)

    @property
    def flexible(self) -> tuple[Pole, ...]:
        """Flexible modes by ascending natural frequency: `mode[1]`, `mode[2]`, …"""
        return tuple(pole for pole in self.poles if pole.is_flexible)

    @property
    def real(self) -> tuple[Pole, ...]:
        """Real poles other than the origin by ascending magnitude: `real[1]`, `real[2]`, …"""
        return tuple(pole for pole in self.poles if not pole.is_flexible and not pole.is_rigid)

    @property
    def is_unstable(self) -> bool:
        """A pole lies right of the imaginary axis, or a flexible one on it repeats."""
        return any(p.value.real > 0 or (p.is_flexible and p.value.real == 0 and p.multiplicity > 1) for p in self.poles)

    def rest_input(self, displacement: Fraction) -> Fraction:
        """u_ss that holds the output `displacement` from the operating point (output units): `Δ D(0)/N(0)`, exact.

        Raises `PlantError` where no rest state exists: the plant has a zero at the origin.
        """
        at_origin = self.numerators[self.output](fmpq(0))
        if at_origin == 0:
            raise PlantError(
                f"the plant has a zero at the origin: its output {self.output!r} cannot be held away from its first rest value"
            )
        return displacement * fraction(self.denominator(fmpq(0))) / fraction(at_origin)

    def partial(self, output: str | None = None) -> Partial:
        """An output's partial fractions over `poles`; raises `PlantError` naming the outputs that exist."""
        name = self.output if output is None else output
        if name not in self.numerators:
            raise PlantError(f"the plant has no output {name!r}; it has {', '.join(sorted(self.numerators))}")
        numerator = self.numerators[name]
        through = numerator.coeffs()[self.order] if numerator.degree() == self.order else fmpq(0)
        with precision(ROOT_BITS):
            table = tuple(tuple(map(_midpoint, residues)) for _, residues in self.fractions(name))
        return Partial(table, float(fraction(through)))

    def fractions(self, output: str) -> tuple[tuple[acb, tuple[acb, ...]], ...]:
        """Balls that hold each of `poles`, and its residues r_1 … r_m in an output; asked for within `precision(ROOT_BITS)`."""
        numerator = self.numerators[output]
        through = numerator.coeffs()[self.order] if numerator.degree() == self.order else fmpq(0)
        proper = numerator - through * self.denominator
        balls = {_midpoint(ball): ball for ball, _ in _isolated(self.denominator)} if self.order else {}
        table = []
        for pole in self.poles:
            ball = min(balls.items(), key=lambda item: abs(item[0] - pole.value))[1]
            table.append((ball, _residues(proper, self.denominator, ball, pole.multiplicity)))
        return tuple(table)


def _from_roots(values: Sequence[ComplexExact], what: str) -> fmpq_poly:
    """The monic real polynomial with these roots; raises `PlantError` if a complex one lacks its conjugate."""
    polynomial = fmpq_poly([1])
    waiting: list[tuple[Fraction, Fraction]] = []
    for value in values:
        if isinstance(value, Sequence) and not isinstance(value, str):
            real, imaginary = (exact(part) for part in value)
        else:
            real, imaginary = exact(value), Fraction(0)
        if imaginary == 0:
            polynomial *= fmpq_poly([_fmpq(-real), 1])
        elif (real, -imaginary) in waiting:
            waiting.remove((real, -imaginary))
            polynomial *= fmpq_poly([_fmpq(real * real + imaginary * imaginary), _fmpq(-2 * real), 1])
        else:
            waiting.append((real, imaginary))
    if waiting:
        lonely = ", ".join(f"[{float(re)!r}, {float(im)!r}]" for re, im in waiting)
        raise PlantError(f"complex {what} come in conjugate pairs; without its conjugate: {lonely}")
    return polynomial


def _annihilator(krylov: Sequence[fmpq_mat]) -> fmpq_poly:
    """The monic polynomial of least degree r with p(A) B = 0, from the columns B, AB, …, A^r B."""
    order, n = len(krylov) - 1, krylov[0].nrows()
    if order == 0:
        return fmpq_poly([1])
    basis = fmpq_mat([[v[i, 0] for v in krylov[:order]] for i in range(n)])
    gram = basis.transpose() * basis  # invertible: the columns are independent over the rationals
    solution = gram.solve(basis.transpose() * krylov[order])
    return fmpq_poly([-solution[k, 0] for k in range(order)] + [1])


def _numerator(markov: Sequence[fmpq], denominator: fmpq_poly) -> fmpq_poly:
    """The polynomial part of `D(s) Σ h_i s^(-i-1)`."""
    coefficients, order = denominator.coeffs(), denominator.degree()
    return fmpq_poly([sum((coefficients[k + 1 + i] * markov[i] for i in range(order - k)), fmpq(0)) for k in range(order)])


def _with_rate(name: str, numerators: Mapping[str, fmpq_poly], denominator: fmpq_poly) -> dict[str, fmpq_poly]:
    """Add the names that exist in every form: `output`, and `output_rate` where it is proper."""
    numerator = numerators[name]
    every = {**numerators, "output": numerator}
    if numerator.degree() < denominator.degree():
        every["output_rate"] = fmpq_poly([0, 1]) * numerator
    return every
