"""Families of plants: transfer functions whose coefficients are polynomials in the parameters of a box, derived exactly.

    G(s) = C adj(sI - A) B / det(sI - A) + D       (Faddeev and LeVerrier), entries of A, B, C, D rational in the parameters

Modes that the input can excite nowhere in the box are dropped, as in a single plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import Ordering, fmpq, fmpq_mpoly_ctx

from relaxations.plants import fraction
from relaxations.robust.boxes import Family, Polynomial


@dataclass(frozen=True, slots=True)
class Ratio:
    """A quotient of two polynomials in the parameters, in lowest terms, the denominator monic: what a plant's entries are evaluated in."""

    numerator: Any
    denominator: Any

    @staticmethod
    def of(numerator: Any, denominator: Any) -> Ratio:
        """Reduced; raises `ZeroDivisionError` if the denominator is 0."""
        if denominator == 0:
            raise ZeroDivisionError
        common = numerator.gcd(denominator) * denominator.leading_coefficient()
        return Ratio(numerator / common, denominator / common)

    def __add__(self, other: Ratio) -> Ratio:
        return Ratio.of(self.numerator * other.denominator + other.numerator * self.denominator, self.denominator * other.denominator)

    def __sub__(self, other: Ratio) -> Ratio:
        return self + -other

    def __mul__(self, other: Ratio) -> Ratio:
        return Ratio.of(self.numerator * other.numerator, self.denominator * other.denominator)

    def __truediv__(self, other: Ratio) -> Ratio:
        return Ratio.of(self.numerator * other.denominator, self.denominator * other.numerator)

    def __pow__(self, exponent: int) -> Ratio:
        if exponent < 0:
            return Ratio.of(self.denominator, self.numerator) ** -exponent
        return Ratio(self.numerator**exponent, self.denominator**exponent)

    def __neg__(self) -> Ratio:
        return Ratio(-self.numerator, self.denominator)


@dataclass(frozen=True, slots=True)
class Parameters:
    """The names of a box's parameters, and numbers and parameters as `Ratio`."""

    names: tuple[str, ...]

    @property
    def _context(self) -> Any:
        return fmpq_mpoly_ctx.get((*(f"x{i}" for i in range(len(self.names))), "s"), Ordering.lex)

    def constant(self, number: Fraction) -> Ratio:
        """A number."""
        context = self._context
        return Ratio(context.constant(fmpq(number.numerator, number.denominator)), context.constant(1))

    def parameter(self, name: str) -> Ratio:
        """A parameter itself."""
        context = self._context
        return Ratio(context.gen(self.names.index(name)), context.constant(1))

    def family(
        self,
        A: Sequence[Sequence[Ratio]],
        B: Sequence[Ratio],
        C: Sequence[Ratio],
        D: Ratio,
        outputs: Mapping[str, Sequence[Ratio]] | None = None,
        name: str = "output",
    ) -> Family:
        """The family of `C (sI - A)⁻¹ B + D`, of the controlled output's `name`, and of further `outputs`, rows like C by their names."""
        n, one, zero = len(A), self.constant(Fraction(1)), self.constant(Fraction(0))
        # det(sI - A) = Σ c_k s^k and adj(sI - A) B = Σ s^(n-k) M_k B with M_1 = I, M_k = A M_{k-1} + c_{n-k+1} I, c_{n-k} = -tr(A M_k)/k
        power, characteristic, states = [[one if i == j else zero for j in range(n)] for i in range(n)], [one], []
        for k in range(1, n + 1):
            states.append([_sum([row[j] * B[j] for j in range(n)], zero) for row in power])
            moved = [[_sum([A[i][m] * power[m][j] for m in range(n)], zero) for j in range(n)] for i in range(n)]
            c = _sum([moved[i][i] for i in range(n)], zero) * self.constant(Fraction(-1, k))
            characteristic.append(c)
            power = [[moved[i][j] + c if i == j else moved[i][j] for j in range(n)] for i in range(n)]
        found = {name: [D * characteristic[0]]} | {key: [zero] for key in outputs or {}}
        for key, row in {**(outputs or {}), name: C}.items():
            through = D if key == name else zero
            pairs = zip(states, characteristic[1:], strict=True)
            found[key] += [_sum([row[j] * state[j] for j in range(n)], through * c) for state, c in pairs]
        return self._reduced(found, name, characteristic, [[state[j] for state in states] for j in range(n)])

    def _reduced(
        self, outputs: Mapping[str, Sequence[Ratio]], name: str, characteristic: Sequence[Ratio], states: Sequence[Sequence[Ratio]]
    ) -> Family:
        """Without denominators in the parameters, and without what the characteristic polynomial and all states' numerators share."""
        context = self._context
        s, whole = context.gen(len(self.names)), context.constant(1)
        for entry in [*(x for output in outputs.values() for x in output), *characteristic, *(x for state in states for x in state)]:
            whole = whole * entry.denominator / whole.gcd(entry.denominator)  # all of them monic: no factor piles up

        def joined(coefficients: Sequence[Ratio]) -> Any:
            total = context.constant(0)
            for coefficient in coefficients:  # the highest power first
                total = total * s + coefficient.numerator * (whole / coefficient.denominator)
            return total

        below, above, common = joined(characteristic), {key: joined(output) for key, output in outputs.items()}, joined(characteristic)
        for state in states:
            common = common.gcd(joined(state))
        below, above = below / common, {key: numerator / common for key, numerator in above.items()}
        shared = context.constant(0)
        for coefficient in [*self._coefficients(below), *(c for numerator in above.values() for c in self._coefficients(numerator))]:
            shared = shared.gcd(coefficient)  # a factor of parameters alone, from the denominators
        written = {key: self._written(numerator / shared) for key, numerator in above.items()}
        others = tuple((key, numerator) for key, numerator in written.items() if key != name)
        return Family(written[name], self._written(below / shared), others, name)

    def _coefficients(self, polynomial: Any) -> list[Any]:
        """Of powers of s, the highest first, as polynomials in the parameters."""
        context, terms = self._context, polynomial.to_dict()
        degree = max((powers[-1] for powers in terms), default=0)
        return [context.from_dict({(*p[:-1], 0): c for p, c in terms.items() if p[-1] == k}) for k in range(degree, -1, -1)]

    def _written(self, polynomial: Any) -> tuple[Polynomial, ...]:
        found = []
        for coefficient in self._coefficients(polynomial):
            terms = sorted(coefficient.to_dict().items(), reverse=True)
            found.append(tuple((fraction(c), tuple(int(p) for p in powers[:-1])) for powers, c in terms))
        return tuple(found)


def _sum(terms: Sequence[Ratio], zero: Ratio) -> Ratio:
    total = zero
    for term in terms:
        total = total + term
    return total
