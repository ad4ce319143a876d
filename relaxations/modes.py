"""The modes of a linear plant: how fast, how damped, how much of each is in the output, and which states move in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.plants import LinearPlant, Pole

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

CONTOUR = 64  # points on a circle around a pole; the rule's error falls geometrically with them


@dataclass(frozen=True, slots=True)
class Mode:
    """A pole and what belongs to it.

    `uncertainty` [rad/s] is how far the pole may lie from where it is. `residues` are the coefficients of `1/(s - p)^k`, k = 1 …, in the
    output. `step_amplitude` is how far the mode takes the output after a unit step of the input (2|r/p| of a pair, |r/p| of a real pole);
    None for a repeated pole and at the origin. `participation` says how much of the mode is in each state: the diagonal of the projector
    onto it, which no choice of units changes, by magnitude and with the sum 1; empty if there are no states to name.
    """

    pole: Pole
    uncertainty: float
    residues: tuple[complex, ...]
    participation: tuple[float, ...]

    @property
    def kind(self) -> str:
        """ "rigid", "flexible" or "real"."""
        return "rigid" if self.pole.is_rigid else "flexible" if self.pole.is_flexible else "real"

    @property
    def time_constant(self) -> float | None:
        """-1 / Re p [s]: of the decay, negative if it grows; None if it does neither."""
        return -1.0 / self.pole.value.real if self.pole.value.real else None

    @property
    def step_amplitude(self) -> float | None:
        """See above."""
        if self.pole.is_rigid or self.pole.multiplicity > 1:
            return None
        return (2.0 if self.pole.is_flexible else 1.0) * abs(self.residues[0] / self.pole.value)


def modes(plant: LinearPlant, found: Complexes | None = None, spread: Reals | None = None, A: Reals | None = None) -> tuple[Mode, ...]:
    """The modes of the plant's controlled output by ascending frequency.

    `found` and `spread` (n,) are the poles as they were computed and their uncertainties (`relaxations.realization`), `A` (n, n) the matrix
    whose states take part in them.
    """
    if found is None or spread is None:
        found, spread = np.zeros(0, dtype=complex), np.zeros(0)
    table = []
    values = [pole.value for pole in plant.poles]
    for pole, residues in zip(plant.poles, plant.partial().residues, strict=True):
        near = np.argsort(np.abs(found - pole.value), kind="stable")[: pole.multiplicity]
        wide = max((abs(found[i] - pole.value) + spread[i] for i in near), default=0.0)
        table.append(Mode(pole, float(wide), residues, _participation(pole.value, values, A)))
    return tuple(table)


def _participation(pole: complex, poles: Sequence[complex], A: Reals | None) -> tuple[float, ...]:
    """The diagonal of `1/(2πi) ∮ (zI - A)⁻¹ dz` around the pole, normalised."""
    if A is None or not len(A):
        return ()
    eigenvalues = np.linalg.eigvals(A).astype(complex)
    every = [*poles, *(p.conjugate() for p in poles)]
    mine = eigenvalues[[abs(z - pole) <= min(abs(z - p) for p in every) + 1e-12 * abs(z) for z in eigenvalues]]
    others = eigenvalues[[abs(z - pole) > min(abs(z - p) for p in every) + 1e-12 * abs(z) for z in eigenvalues]]
    inner = float(np.abs(mine - pole).max(initial=0.0))
    outer = float(np.abs(others - pole).min(initial=2.0 * max(abs(pole), inner, 1.0)))
    if inner >= outer:
        return ()
    radius = math.sqrt(max(inner, 1e-2 * outer) * outer)
    total = np.zeros(len(A), dtype=complex)
    for angle in 2j * math.pi * (np.arange(CONTOUR) + 0.5) / CONTOUR:
        turn = radius * np.exp(angle)
        total += turn * np.diag(np.linalg.inv((pole + turn) * np.eye(len(A)) - A))
    shares = np.abs(total)
    return tuple((shares / shares.sum()).tolist()) if shares.sum() > 0.0 else ()
