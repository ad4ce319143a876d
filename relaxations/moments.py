"""Moments of a command at a plant's poles: the coordinates in which rest is a set of linear equations.

To every pole p of multiplicity m belong the functions of time to go `b_k(s) = s^k/k! e^{ps}`, k < m. A command u leaves the modes in the
state `M_k(t) = ∫_0^t b_k(t - τ) u(τ) dτ`, and an output with partial fractions Σ r_k/(s-p)^k reads `Σ r_k M_{k-1}(t)`. A conjugate pair
is one complex function, written as two real rows (real part, imaginary part). (../docs/theory.md, equation 1, in modal coordinates.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray

from relaxations.plants import Partial, Pole

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

NEGLIGIBLE = 1e-19  # of a series' first term: its sum is never so much smaller that this could be seen in a double


def _chain(pole: complex, power: int, integrals: int, s: Reals) -> Complexes:
    """The `integrals`-fold integral from 0 of `s^power/power! e^{pole s}` at s ≥ 0: transform `1/(σ^integrals (σ - pole)^(power+1))`.

    Near `pole s = 0` the recurrence cancels, so its power series `s^n/n! Σ_k (power+1)_k/(n+1)_k (pole s)^k/k!`, n = power + integrals, is
    summed there; for Re pole < 0 in Kummer's other form, `e^{pole s}` times the series in `-pole s`, whose terms do not cancel.
    """
    if pole == 0:
        return (s ** (power + integrals) / factorial(power + integrals)).astype(complex)
    if integrals == 0:
        return (s**power / factorial(power) * np.exp(pole * s)).astype(np.complex128)
    near = np.abs(pole) * s <= 1.0 + power
    result = np.empty(s.shape, dtype=complex)
    if near.any():
        x, mirrored = s[near], pole.real < 0
        first, rate = (integrals, -pole) if mirrored else (power + 1, pole)
        term = (x ** (power + integrals) / factorial(power + integrals)).astype(complex)
        if mirrored:
            term *= np.exp(pole * x)
        total, x = term.copy(), rate * x
        size, largest, k = 1.0, float(np.abs(x).max()), 0
        while size > NEGLIGIBLE:  # the factors fall: |pole s| ≤ 1 + power
            factor = (first + k) / ((power + integrals + 1 + k) * (k + 1))
            term = term * (x * factor)
            total += term
            size, k = size * largest * factor, k + 1
        result[near] = total
    far = ~near
    if far.any():
        x = s[far]
        lower = _chain(pole, power - 1, integrals, x) if power else x ** (integrals - 1) / factorial(integrals - 1)
        result[far] = (_chain(pole, power, integrals - 1, x) - lower) / pole
    return result


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
        if not self.poles:
            return np.zeros((0, len(points)))
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
        if not self.poles:
            return np.zeros(0)
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
        return np.array(stacked)

    def moves(self, since: Reals) -> Reals:
        """What unit moments become after `since` ≥ 0 [s] without input, `s^(k-l)/(k-l)! e^{ps}` of M_l in M_k: shape (n, n, len(since))."""
        found, at = np.zeros((self.size, self.size, len(since))), 0
        for pole in self.poles:
            width = 2 if pole.is_flexible else 1
            for shift in range(pole.multiplicity):
                chain = _chain(pole.value, shift, 0, since)
                for k in range(shift, pole.multiplicity):
                    i, j = at + width * k, at + width * (k - shift)
                    found[i, j] = chain.real
                    if width == 2:
                        found[i + 1, j], found[i, j + 1], found[i + 1, j + 1] = chain.imag, -chain.imag, chain.real
            at += width * pole.multiplicity
        return found

    def free(self, state: Reals, since: Reals) -> Reals:
        """What moments `state` (n,) become after `since` ≥ 0 [s] without input: shape (n, len(since))."""
        return np.einsum("ijs,j->is", self.moves(since), state)

    def weights(self, partial: Partial) -> Reals:
        """The row w with `y = w M + D u` for an output in partial fractions over the same poles. Shape (n,)."""
        entries: list[float] = []
        for pole, residues in zip(self.poles, partial.residues, strict=True):
            for residue in residues:
                entries += [2 * residue.real, -2 * residue.imag] if pole.is_flexible else [residue.real]
        return np.array(entries)

    def tail(self, rate: complex, power: int, since: Reals) -> Complexes:
        """Moments (complex rows, one for each real row's chain) of the input `r^power e^{rate r}` acting from r = 0, at r = since.

        Its transform `power!/((σ - pole)^(k+1) (σ - rate)^(power+1))` is a chain of one root seen from the other: no difference of nearly
        equal exponentials, however close the rate is to the pole. The slower exponential is taken out, so that nothing overflows.
        """
        chains = []
        for pole in self.poles:
            for k in range(pole.multiplicity):
                if pole.value.real >= rate.real:
                    chain = np.exp(pole.value * since) * _chain(rate - pole.value, power, k + 1, since)
                else:
                    chain = np.exp(rate * since) * _chain(pole.value - rate, k, power + 1, since)
                chains.append(factorial(power) * chain)
        return np.array(chains)
