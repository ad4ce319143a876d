"""Where several modes stand at their tops together, long after a command: at instants that no grid would meet.

Modes that last, at frequencies without a common period, come together as closely as one likes, sooner or later (Kronecker): the largest
motion is the sum of their sizes. What is found here are instants that come close to that; each is a limit of the program like any other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

TOPS = {2: 4096, 3: 1 << 17}
"""Tops of the largest mode that are looked at, by the number of modes: the phases of the others are off by 1e-3 and 1e-2 then."""
MANY = 1 << 18  # of more modes
CLOSER = (1.0, 4.0, 16.0, 64.0)
CHUNK = 4_000_000  # instants of all plants that are looked at together


def tops(modes: int) -> int:
    """How many tops are looked at."""
    return TOPS.get(modes, MANY) if modes > 1 else 0


def course(motions: Complexes, poles: Complexes, times: Reals) -> Reals:
    """`Re Σ_j Z_j e^{p_j τ}` of plants (k, n) at instants (k, m): (k, m)."""
    total = np.zeros(times.shape)
    for z, p in zip(motions.T, poles.T, strict=True):
        turned = np.abs(z)[:, None] * np.cos(p.imag[:, None] * times + np.angle(z)[:, None])
        total += turned * np.exp(p.real[:, None] * times) if p.real.any() else turned
    return total


def sharpened(motions: Complexes, poles: Complexes, near: Reals, width: Reals) -> tuple[Reals, Reals]:
    """Extremes near instants (k, m), and their sizes, by parabolas through three points `width` (k,) apart, then closer ones."""
    for closer in CLOSER:
        step = (width / closer)[:, None]
        before, at, after = (course(motions, poles, near + shift * step) for shift in (-1.0, 0.0, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = np.nan_to_num((before - after) / (2 * (before - 2 * at + after)), posinf=0.0, neginf=0.0)
        near = np.maximum(near + np.clip(shift, -1, 1) * step, 0.0)
    return near, np.abs(course(motions, poles, near))


def aligned(motions: Complexes, poles: Complexes, window: Reals, limit: float, count: int) -> tuple[Reals, Reals]:
    """The instant after `window` (k,) [s] at which each plant's motion is largest, of `count` tops of its largest mode, and how large it is
    there; 0 where the sizes of what is left of all modes add up to no more than `limit`."""
    found, sizes = np.zeros(len(motions)), np.zeros(len(motions))
    left = np.abs(motions) * np.exp(poles.real * window[:, None])
    asked = np.flatnonzero(left.sum(axis=1) > limit) if count else np.zeros(0, dtype=np.intp)
    for part in np.array_split(asked, len(asked) * count // CHUNK + 1):
        if not len(part):
            continue
        z, p, rows = motions[part], poles[part], np.arange(len(part))
        main = np.where(p.imag != 0.0, left[part], -1.0).argmax(axis=1)
        omega, phase = p[rows, main].imag, np.angle(z[rows, main])
        turns = np.ceil((window[part] * omega + phase) / np.pi)[:, None] + np.arange(count)
        times = (turns * np.pi - phase[:, None]) / omega[:, None]
        best = times[rows, np.abs(course(z, p, times)).argmax(axis=1)]
        width = np.pi / (24.0 * np.abs(p).max(axis=1))
        where, large = sharpened(z, p, best[:, None], width)
        found[part], sizes[part] = where[:, 0], large[:, 0]
    return found, sizes
