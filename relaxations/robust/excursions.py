"""How far a named output goes in many plants of a box at once, in floating point: where to look, not what is true."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.robust.alignment import course, sharpened
from relaxations.robust.boxes import Family
from relaxations.robust.scans import LASTING, MOST, PER_PERIOD, Scan, Staircase

Reals = NDArray[np.float64]

STEPS, PARTS = 3, 800  # instants between two kicks of a command, and in a whole move, at least


@dataclass(frozen=True, slots=True)
class Excursions:
    """An output of plants at many places: poles and weights (`scan`), and the first terms of N/(D/s^r) at the origin (k, r + 2)."""

    scan: Scan
    origin: Reals
    rigid: int

    @staticmethod
    def of(family: Family, rigid: int, places: Reals, name: str) -> Excursions:
        """The named output of a family whose plants have `rigid` poles at the origin."""
        above, below = family.coefficients(places, name)
        above, below = above[:, ::-1], below[:, ::-1][:, rigid:]
        terms = np.zeros((len(places), rigid + 2))
        for i in range(rigid + 2):
            left = above[:, i].copy() if i < above.shape[1] else np.zeros(len(places))
            for k in range(1, min(i, below.shape[1] - 1) + 1):
                left -= terms[:, i - k] * below[:, k]
            terms[:, i] = left / below[:, 0]
        return Excursions(Scan.of(family, rigid, places, name), terms, rigid)

    def sizes(self, command: Staircase, periods: float, moment: float) -> Reals:
        """The largest |y| of each plant, during the move and some `periods` after it; `moment` is what brings the nominal one to rest."""
        poles, weights = self.scan.poles, self.scan.weights / self.scan.poles**command.order
        count = self.rigid + command.order
        rests, origin = self.origin[:, 0] * moment, self.origin[:, :count][:, ::-1]
        motions, moments = np.zeros(poles.shape, complex), np.zeros(count)
        largest, duration = np.abs(rests), float(command.to_go[0])
        for length, jump in zip(-np.diff(command.to_go), command.jumps[:-1], strict=True):
            motions = motions + jump
            moments[0] += jump
            parts = max(STEPS, math.ceil(PARTS * length / duration))
            step = np.exp(poles * (length / parts))
            shares = np.array([(length / parts) ** k / math.factorial(k) for k in range(count)])
            for _ in range(parts):
                motions = motions * step
                moments = np.array([moments[k::-1] @ shares[: k + 1] for k in range(count)])
                largest = np.maximum(largest, np.abs((weights * motions).real.sum(axis=1) + origin @ moments))
        return np.maximum(largest, self._after(weights * (motions + command.jumps[-1]), rests, periods))

    def _after(self, motions: NDArray[np.complex128], rests: Reals, periods: float) -> Reals:
        poles = self.scan.poles
        if not poles.shape[1]:
            return np.abs(rests)
        fastest, slowest = np.abs(poles).max(axis=1), np.abs(poles).min(axis=1)
        count = int(min(PER_PERIOD * periods * (fastest / slowest).max(), MOST)) + 3
        steps = 2 * np.pi * periods / slowest / (count - 1)
        values = rests[:, None] + course(motions, poles, np.arange(count) * steps[:, None])
        later = np.abs(values).argmax(axis=1) * steps
        where, _ = sharpened(motions, poles, later[:, None], steps)
        peaks = np.maximum(np.abs(values).max(axis=1), np.abs(rests[:, None] + course(motions, poles, where)).max(axis=1))
        lasting = (-poles.real <= LASTING * np.abs(poles)).all(axis=1)
        return np.where(lasting, np.abs(rests) + np.abs(motions).sum(axis=1), peaks)
