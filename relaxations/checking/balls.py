"""The plant in balls: roots with exact multiplicities, exponential polynomials, moments. Everything returned encloses the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import comb, factorial
from typing import cast

import flint
from flint import acb, arb, fmpq, fmpq_poly

from relaxations.checking.reading import Malformed, PlantData, Task


class Inconclusive(Exception):
    """Ball arithmetic cannot decide at this precision or within the cap on subdivision."""


class Refuted(Exception):
    """An inequality that the claim rests on is proven false for the given witness."""


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Work with `bits` bits inside the block: python-flint's precision is global."""
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        yield
    finally:
        flint.ctx.prec = before


@dataclass(frozen=True, slots=True)
class Root:
    """A root with Im ≥ 0 in a ball that holds no other; `flexible` stands for a conjugate pair."""

    value: acb
    multiplicity: int
    flexible: bool

    @property
    def at_origin(self) -> bool:
        """Exactly 0."""
        return bool(self.value.is_zero())


def roots(polynomial: fmpq_poly) -> tuple[Root, ...]:
    """All distinct roots with Im ≥ 0 and their exact multiplicities (square-free factorisation, then certified isolation)."""
    found = []
    isolated = cast("list[tuple[acb, int]]", polynomial.complex_roots() if polynomial.degree() > 0 else [])
    for value, multiplicity in isolated:
        if value.imag.is_zero():
            found.append(Root(value, multiplicity, False))
        elif value.imag > 0:
            found.append(Root(value, multiplicity, True))
        elif not value.imag < 0:
            raise Inconclusive("a root is not told from its conjugate at this precision")
    if sum(root.multiplicity * (2 if root.flexible else 1) for root in found) != max(polynomial.degree(), 0):
        raise Inconclusive("not every root was isolated")
    return tuple(found)


def stable_zeros(numerator: fmpq_poly) -> tuple[Root, ...]:
    """The zeros strictly left of the imaginary axis; a zero on the axis is recognised exactly, never by a small real part."""
    mirrored = fmpq_poly([c * (-1) ** k for k, c in enumerate(numerator.coeffs())])
    common = numerator.gcd(mirrored)
    symmetric = roots(common) if common.degree() > 0 else ()
    on_axis = [root for root in symmetric if root.value.real.is_zero()]
    left = []
    for root in roots(numerator):
        if root.value.real < 0:
            left.append(root)
        elif not root.value.real > 0 and not any(root.value.overlaps(other.value) for other in on_axis):
            raise Inconclusive("a zero is not told from the imaginary axis at this precision")
    return tuple(left)


def tail_room(task: Task, rest: fmpq, time: fmpq) -> tuple[fmpq, fmpq]:
    """How far above and below the final rest input the tail may be, `time` seconds after the move; exact."""
    above, below = task.upper_limit - task.initial_input - rest, task.initial_input + rest - task.lower_limit
    if task.tail_length is not None and time >= task.tail_length[0]:
        tight = task.tail_length[1] * min(above, below)
        return min(above, tight), min(below, tight)
    return above, below


@dataclass(frozen=True, slots=True)
class Plant:
    """A plant's roots (robustness zeros included in the multiplicities), its rest input and its highest rigid-body residue, exact."""

    roots: tuple[Root, ...]
    rest_input: fmpq
    rigid_target: fmpq  # the moment that carries the displacement: Δ over the coefficient of 1/s^m
    zeros: tuple[Root, ...]

    @property
    def size(self) -> int:
        """Number of real moment equations."""
        return sum(root.multiplicity * (2 if root.flexible else 1) for root in self.roots)

    def target(self, root: Root, k: int) -> acb:
        """The moment M_k at `root` from which the plant stays at rest under the final rest input."""
        if root.at_origin:
            return acb(self.rigid_target) if k == root.multiplicity - 1 else acb(0)
        return acb(self.rest_input) / (-root.value) ** (k + 1)

    def tail(self, root: Root, k: int, zero: acb, power: int) -> acb:
        """What `r^power/power! e^{zero r}` after the move adds to that moment: `(-1)^l C(k+l, l) / (z - p)^(k+l+1)`."""
        return comb(k + power, power) * (-1) ** power / (zero - root.value) ** (k + power + 1)


def plant(data: PlantData, task: Task) -> Plant:
    """The plant of a task; raises `Malformed` if the task has no rest state or refuses the output rest."""
    numerator, denominator = fmpq_poly(list(data.numerator)), fmpq_poly(list(data.denominator))
    zeros: tuple[Root, ...] = ()
    if task.output_rest:
        if numerator.gcd(denominator).degree() > 0:
            raise Malformed("under output rest numerator and denominator have no common factor")
        zeros = stable_zeros(numerator)
    found = roots(denominator)
    rigid = next((root.multiplicity for root in found if root.at_origin), 0)
    static = numerator(fmpq(0))
    if static == 0:
        raise Malformed("the plant has a zero at the origin: there is no rest state")
    lowest = denominator.coeffs()[rigid]
    rest = fmpq(0) if rigid else task.displacement * lowest / static
    for value in (task.initial_input, task.initial_input + rest):
        if not task.lower_limit <= value <= task.upper_limit:
            raise Malformed("the limits exclude the input at a rest")
    return Plant(_with_zeros(found, data.zeros), rest, task.displacement * lowest / static if rigid else fmpq(0), zeros)


def _with_zeros(found: tuple[Root, ...], extra: dict[str, int]) -> tuple[Root, ...]:
    """Further zeros at mode[i] (flexible, by ascending magnitude) and real[i]; magnitudes must be told apart for that."""
    result = {id(root): root for root in found}
    for kind, flexible in (("mode", True), ("real", False)):
        family = [root for root in found if root.flexible is flexible and not root.at_origin]
        family.sort(key=lambda root: float(abs(root.value).mid()))
        for i, root in enumerate(family, 1):
            count = extra.get(f"{kind}[{i}]", 0)
            neighbours = family[max(i - 2, 0) : i - 1] + family[i : i + 1]
            # Counting all of a kind alike needs no order.
            alike = len({extra.get(f"{kind}[{j}]", 0) for j in range(1, len(family) + 1)}) == 1
            if count and not alike and any(abs(root.value).overlaps(abs(other.value)) for other in neighbours):
                raise Inconclusive("two modes have the same frequency: their order is not defined")
            result[id(root)] = Root(root.value, root.multiplicity + count, root.flexible)
        if unknown := [
            name for name in extra if name.startswith(f"{kind}[") and name not in {f"{kind}[{i}]" for i in range(1, len(family) + 1)}
        ]:
            raise Malformed(f"the plant has no {unknown[0]}")
    if unknown := [name for name in extra if not name.startswith(("mode[", "real["))]:
        raise Malformed(f"no mode is called {unknown[0][:40]}")
    return tuple(result.values())


def impulse(value: acb, multiplicity: int, s: arb) -> list[acb]:
    """b_k(s) = s^k/k! e^{ps} for k < multiplicity."""
    growth = (value * s).exp()
    return [growth * s**k / factorial(k) for k in range(multiplicity)]


def step(root: Root, s: arb) -> list[acb]:
    """S_k(s) = ∫_0^s b_k for k < multiplicity, by integration by parts: S_k = (b_k - S_{k-1}) / p."""
    if root.at_origin:
        return [acb(s ** (k + 1) / factorial(k + 1)) for k in range(root.multiplicity)]
    below, result = acb(1), []
    for value in impulse(root.value, root.multiplicity, s):
        below = (value - below) / root.value
        result.append(below)
    return result


def nearest(choices: Sequence[Root], near: tuple[fmpq, fmpq]) -> Root:
    """The root nearest to a point: any choice keeps a proof sound, a wrong one only fails to prove."""
    point = complex(float(arb(near[0]).mid()), float(arb(near[1]).mid()))
    return min(choices, key=lambda root: abs(complex(float(root.value.real.mid()), float(root.value.imag.mid())) - point))
