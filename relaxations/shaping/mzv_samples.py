"""`mzv` on samples: the span of the free one, zero vibration, and of all positive sequences the one least sensitive to frequency.

On the instants kh within three quarters of the damped period, with `Σ A_k e^{κω kh} = 0`, A ≥ 0 and `Σ A = 1`, the residual's slope

    ω dV/dω = ω |Σ A_k kh e^{κω(kh - T)}|

is made least: a convex program whose optimum has an impulse at 0, one at the end and one or two between. Its active set comes of
non-negative least squares; on it the equations are then solved to rounding. Undamped, with free instants, the optimum is `mzv` itself: the
lower hull of the curve (cos φ, φ sin φ), |φ| ≤ 3π/4 about the middle, is the chord from the middle to the ends.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.optimize import nnls

from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.shaping.amplitudes import too_small
from relaxations.shaping.impulses import SPAN, require_mzv, smallest_of_mzv
from relaxations.shaping.modes import Mode
from relaxations.shaping.sampled import MOST_SAMPLES
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

FIRM = 1e5  # times the slope's weight is that of the equations while the active set is looked for
WHOLE = 1e-12  # relative: a span that is a whole number of samples, but for rounding, holds the last one
NOTHING = 1e-12  # of equations of order one, solved to rounding


def mzv_on_samples(mode: Mode, sample_time: float) -> Shaper:
    """That sequence at multiples of `sample_time` [s].

    Raises `ShaperError` for no sample time, too many samples, and amplitudes that doubles do not hold, `ImpossibleShaperError` where the
    span holds too few samples, `SolverError`.
    """
    if not 0.0 < sample_time < math.inf:
        raise ShaperError(f"a sample time is positive and finite, not {sample_time!r} s")
    require_mzv(mode)
    span = 2.0 * SPAN * mode.half_period
    if span > MOST_SAMPLES * sample_time:
        raise ShaperError(
            f"a sample time of {sample_time!r} s puts some {span / sample_time:.4g} samples into the span of mzv; at most {MOST_SAMPLES} "
            f"are searched, so from {span / MOST_SAMPLES:.4g} s on; without a sample time the instants are free"
        )
    samples = math.floor(span / sample_time * (1.0 + WHOLE))
    found = _least_slope(mode, sample_time, samples) if samples else None
    if found is None and samples > 1:
        raise SolverError(
            f"no mzv was found on {samples} samples of {sample_time!r} s at a damping of {mode.damping!r}; zv, and mzv without a sample "
            "time, are possible"
        )
    if found is None:
        raise ImpossibleShaperError(
            f"a sample time of {sample_time!r} s is too coarse for mzv at {mode.frequency:.6g} rad/s: three quarters of the damped period, "
            f"{span:.6g} s, hold {samples + 1} sample(s), on which no positive impulses leave nothing; up to {span / 2.0:.6g} s it is "
            f"possible, and zv up to {mode.half_period:.6g} s"
        )
    kept = np.flatnonzero(found)
    if found[kept].min() < sys.float_info.min:
        raise ShaperError(too_small("mzv", mode.damping, smallest_of_mzv))
    return Shaper(tuple(float((k - kept[0]) * sample_time) for k in kept), tuple(map(float, found[kept])))


def _least_slope(mode: Mode, sample_time: float, samples: int) -> Reals | None:
    """Amplitudes at instants 0 to `samples`, (samples + 1,), or None if none are positive and leave nothing.

    In units of what is left of an impulse of an undamped mode, `A e^{ζωt}`, all are of order one.
    """
    instants = sample_time * np.arange(samples + 1.0)
    turns = np.exp(1j * mode.frequency * mode.direction.imag * instants).astype(np.complex128)
    decay = np.exp(-mode.frequency * mode.damping * instants)
    slopes = ((instants / instants[-1] - 0.5) * turns).astype(np.complex128)
    equations, slope, aim = np.vstack([turns.real, turns.imag, decay]), np.vstack([slopes.real, slopes.imag]), np.array([0.0, 0.0, 1.0])
    try:
        weights, _ = nnls(np.vstack([FIRM * equations, slope]), np.append(FIRM * aim, [0.0, 0.0]))
    except RuntimeError:  # too many iterations
        return None
    kept = np.flatnonzero(weights > 0.0)
    while len(kept):
        table, along = equations[:, kept], slope[:, kept]
        sizes = np.linalg.lstsq(table, aim, rcond=None)[0]
        free = null_space(table)
        if free.shape[1]:
            sizes = sizes - free @ np.linalg.lstsq(along @ free, along @ sizes, rcond=None)[0]
        if np.abs(table @ sizes - aim).max() > NOTHING:
            return None
        if sizes.min() > 0.0:
            found = np.zeros(samples + 1)
            found[kept] = sizes * decay[kept]
            return found
        kept = kept[sizes > 0.0]
    return None
