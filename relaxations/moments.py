"""Moments of a command at a plant's poles: the coordinates in which rest is a set of linear equations.

To every pole p of multiplicity m belong the functions of time to go `b_k(s) = s^k/k! e^{ps}`, k < m. A command u leaves the modes in the
state `M_k(t) = ∫_0^t b_k(t - τ) u(τ) dτ`, and an output with partial fractions Σ r_k/(s-p)^k reads `Σ r_k M_{k-1}(t)`. A conjugate pair
is one complex function, written as two real rows (real part, imaginary part). (../docs/theory.md, equation 1, in modal coordinates.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

from relaxations.plants import Partial, Pole

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def _chain(pole: complex, power: int, integrals: int, s: Reals) -> Complexes:
    """The `integrals`-fold integral from 0 of `s^power/power! e^{pole s}` at s ≥ 0, whose transform is `1/(σ^integrals (σ - pole)^(power+1))`.

    Near `pole s = 0` the recurrence cancels, so its power series `Σ_k C(power+k, k) pole^k s^n/n!`, n = power+k+integrals, is summed there.
    """
    if pole == 0:
        return (s ** (power + integrals) / factorial(power + integrals)).astype(complex)
    if integrals == 0:
        return s**power / factorial(power) * np.exp(pole * s)
    near = np.abs(pole) * s <= 1.0 + power
    result = np.empty(s.shape, dtype=complex)
    if near.any():
        x = s[near]
        term = (x ** (power + integrals) / factorial(power + integrals)).astype(complex)
        total = term.copy()
        for k in range(1, 40 + 4 * power):
            term = term * (pole * x) * ((power + k) / (k * (power + k + integrals)))
            total += term
        result[near] = total
    far = ~near
    if far.any():
        x = s[far]
        lower = _chain(pole, power - 1, integrals, x) if power else x ** (integrals - 1) / factorial(integrals - 1)
        result[far] = (_chain(pole, power, integrals - 1, x) - lower) / pole
    return result


def _product(pole: complex, rate: complex, a: int, b: int) -> Iterator[tuple[complex, int, complex]]:
    """`1/((σ-pole)^a (σ-rate)^b)` in partial fractions: (root, power of 1/(σ-root), coefficient)."""
    if pole == rate:
        yield pole, a + b, 1.0
        return
    for root, other, own, others in ((pole, rate, a, b), (rate, pole, b, a)):
        for i in range(1, own + 1):
            yield root, i, comb(others - 1 + own - i, others - 1) * (-1) ** (own - i) / (root - other) ** (others + own - i)


@dataclass(frozen=True, slots=True)
class Basis:
    """The functions b_k of a set of poles, as real rows: for each pole, for k < multiplicity, one row (real pole) or two (complex)."""

    poles: tuple[Pole, ...]

    @property
    def size(self) -> int:
        """Number of real rows n."""
        return sum(pole.multiplicity * (2 if pole.is_flexible else 1) for pole in self.poles)

    def rows(self, s: Sequence[float] | Reals, integrals: int = 0) -> Reals:
        """b(s) (integrals = 0), its integral (1) or double integral (2) from 0, at times to go s ≥ 0 [s]: shape (n, len(s))."""
        points = np.atleast_1d(np.asarray(s, dtype=float))
        return self.real(_chain(pole.value, k, integrals, points) for pole in self.poles for k in range(pole.multiplicity))

    def derivative(self, costate: Reals) -> Reals:
        """The costate of the derivative: `d/ds λᵀb(s) = λ'ᵀb(s)` with λ' = this. Shape (n,)."""
        result, at = np.zeros(self.size), 0
        for pole in self.poles:
            width = 2 if pole.is_flexible else 1
            block = costate[at : at + width * pole.multiplicity].reshape(pole.multiplicity, width)
            complexed = block[:, 0] - 1j * block[:, 1] if width == 2 else block[:, 0].astype(complex)  # λᵀb = Re Σ c_k b_k
            changed = complexed * pole.value + np.append(complexed[1:], 0.0)  # b_k' = p b_k + b_{k-1}
            out = np.stack([changed.real, -changed.imag], axis=1) if width == 2 else changed.real[:, None]
            result[at : at + width * pole.multiplicity] = out.ravel()
            at += width * pole.multiplicity
        return result

    def hold(self, level: float) -> Reals:
        """The moments at which holding `level` for ever is a rest: `level/(-p)^(k+1)`; 0 at the origin. Shape (n,)."""
        values = (
            np.array([0.0 if pole.is_rigid else level / (-pole.value) ** (k + 1)], dtype=complex)
            for pole in self.poles
            for k in range(pole.multiplicity)
        )
        return self.real(values)[:, 0]

    def real(self, values: Iterator[Complexes]) -> Reals:
        """Stack complex rows (one for each pole and k) as real rows."""
        stacked: list[Reals] = []
        chains = iter(values)
        for pole in self.poles:
            for _ in range(pole.multiplicity):
                row = next(chains)
                stacked.append(row.real)
                if pole.is_flexible:
                    stacked.append(row.imag)
        return np.array(stacked) if stacked else np.zeros((0, 0))

    def weights(self, partial: Partial) -> Reals:
        """The row w with `y = w M + D u` for an output in partial fractions over the same poles. Shape (n,)."""
        entries: list[float] = []
        for pole, residues in zip(self.poles, partial.residues, strict=True):
            for residue in residues:
                entries += [2 * residue.real, -2 * residue.imag] if pole.is_flexible else [residue.real]
        return np.array(entries)

    def tail(self, rate: complex, power: int, since: Reals) -> Complexes:
        """Moments (complex rows, one for each real row's chain) of the input `r^power e^{rate r}` acting from r = 0, at r = since."""
        chains = []
        for pole in self.poles:
            for k in range(pole.multiplicity):
                total = np.zeros(since.shape, dtype=complex)
                for root, i, coefficient in _product(pole.value, rate, k + 1, power + 1):
                    total += coefficient * factorial(power) * since ** (i - 1) / factorial(i - 1) * np.exp(root * since)
                chains.append(total)
        return np.array(chains)
