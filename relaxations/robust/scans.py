"""The residual that a command leaves over many places of a box at once, in floating point: where to look, not what is true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.robust.alignment import aligned, course, sharpened
from relaxations.robust.boxes import Family

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

PER_PERIOD = 48  # instants in a period of the fastest mode
MOST = 20_000  # instants for one plant
LASTING = 1e-9  # -Re p / |p|: with less, two modes meet at their worst at last, however long that takes
EARLY, PER_STEP = 4, 8  # steps after the command that are divided, and into how many parts
LATE = 1024  # tops of the largest mode at which several modes may meet
CHUNK = 1_000_000  # instants of all plants that are looked at together


@dataclass(frozen=True, slots=True)
class Staircase:
    """A command: times to go [s] of its jumps, the last one to its final value at 0, and their heights. One that is continuous has jumps
    of its slope instead: `order` 2."""

    to_go: Reals
    jumps: Reals
    order: int = 1

    @staticmethod
    def of(instants: Reals, levels: Reals, hold: float, ramps: bool = False) -> Staircase:
        """From levels on the grid of `instants` [s], or values at all nodes but the first, and the input afterwards."""
        if ramps:
            slopes = np.diff(levels, prepend=0.0) / np.diff(instants)
            return Staircase(instants[-1] - instants, np.diff(np.concatenate([[0.0], slopes, [0.0]])), 2)
        return Staircase(instants[-1] - instants, np.diff(np.concatenate([[0.0], levels, [hold]])))


@dataclass(frozen=True, slots=True)
class Scan:
    """Plants of a box at `places` (k, parameters): poles beside the origin with Im ≥ 0 and the weights N/D' of their motions, (k, n)."""

    places: Reals
    poles: Complexes
    weights: Complexes

    @staticmethod
    def of(family: Family, rigid: int, places: Reals, name: str | None = None) -> Scan:
        """The plants of a family whose poles at the origin are `rigid`, and the controlled output or a named one."""
        above, below = family.coefficients(places, name)
        trimmed = below[:, : below.shape[1] - rigid]
        order = trimmed.shape[1] - 1
        companion = np.zeros((len(places), order, order))
        companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
        if order:
            companion[:, 0, :] = -trimmed[:, 1:] / trimmed[:, :1]
        poles: Complexes = np.linalg.eigvals(companion).astype(np.complex128) if order else np.zeros((len(places), 0), np.complex128)
        slopes = below[:, :-1] * np.arange(below.shape[1] - 1, 0, -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = _valued(above, poles) / _valued(slopes, poles)
        counted = np.where(poles.imag > 0, 2.0, np.where(poles.imag < 0, 0.0, 1.0))
        # Plants that are unstable or drift are refused where they are met; here they must only not be in the way.
        sound = np.where(poles == 0.0, 1e-300, np.minimum(poles.real, 0.0) + 1j * poles.imag)
        # Of pairs one is enough, in columns that all plants fill: those with Im > 0 and the real ones, others behind them.
        order_of = np.argsort(poles.imag < 0.0, axis=1, kind="stable")[:, : np.count_nonzero(poles.imag >= 0.0, axis=1).max(initial=0)]
        kept = np.nan_to_num(weights * counted, posinf=0.0, neginf=0.0)
        return Scan(places, np.take_along_axis(sound, order_of, axis=1), np.take_along_axis(kept, order_of, axis=1))

    def sizes(self, command: Staircase, periods: float, limit: float = np.inf) -> Reals:
        """The peak of each plant's residual, followed for so many `periods` of its slowest mode, and where several modes that add up to
        more than `limit` meet later; where modes last, their sum."""
        if not self.poles.shape[1]:
            return np.zeros(len(self.places))
        grown = np.exp(self.poles[:, :, None] * command.to_go)
        motions = self.weights / self.poles**command.order * (grown @ command.jumps)
        moduli = np.abs(motions)
        # A real pole that is faster than all modes is gone at once: it is looked at early, and not at all instants.
        swinging = np.where(self.poles.imag > 0.0, np.abs(self.poles), 0.0).max(axis=1)
        slowest = np.abs(self.poles).min(axis=1)
        fastest = np.where(swinging > 0.0, swinging, np.abs(self.poles).max(axis=1))
        count = int(min(PER_PERIOD * periods * (fastest / slowest).max(), MOST)) + 3
        steps = 2 * np.pi * periods / slowest / (count - 1)
        lasting = (-self.poles.real <= LASTING * np.abs(self.poles)).all(axis=1)
        peaks = np.where(lasting, moduli.sum(axis=1), 0.0)
        fading = np.flatnonzero(~lasting)
        for part in np.array_split(fading, int(len(fading) * count // CHUNK) + 1):
            peaks[part] = _peaks(motions[part], self.poles[part], steps[part], count)
        if len(fading) and np.count_nonzero(self.poles.imag > 0.0, axis=1).max() > 1:
            late = aligned(motions[fading], self.poles[fading], (steps * (count - 1))[fading], limit, LATE)[1]
            peaks[fading] = np.maximum(peaks[fading], late)
        return peaks


def _peaks(motions: Complexes, poles: Complexes, steps: Reals, count: int) -> Reals:
    """`max |Re Σ_j Z_j e^{p_j τ}|` over `count` instants from 0 on, and about the largest: (k,)."""
    shares = np.union1d(np.arange(count), np.arange(EARLY * PER_STEP) / PER_STEP)  # of a step
    values = course(motions, poles, shares * steps[:, None])
    later = shares[np.abs(values[:, 2:]).argmax(axis=1) + 2] * steps  # extremes may lie close together just after the command
    near = sharpened(motions, poles, np.stack([np.zeros(len(later)), steps, later], axis=1), steps)[1].max(axis=1)
    return np.maximum(np.abs(values).max(axis=1), near)


def _valued(coefficients: Reals, points: Complexes) -> Complexes:
    """Polynomials, highest power first, (k, n) at `points` (k, m), by Horner's rule."""
    total = np.zeros(points.shape, complex)
    for column in coefficients.T:
        total = total * points + column[:, None]
    return total
