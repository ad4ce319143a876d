"""Impulses drawn out to pulses of one width and the same integrals: what is left unexcited stays so, and how short such pulses could be.

What impulses leave of a mode, `F = Σ A_i e^{p(t_i - t_n)}`, p = κω, is `F (1 - e^{-pw})/(pw)` of pulses of width w, seen from their end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relaxations.errors import SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.insensitive import specified
from relaxations.shaping.requests import Least, Made
from relaxations.shaping.shapers import as_pulses

CLEAR = 1e-3  # of a pulse's own factor: one that is smaller leaves nearly nothing of the mode by itself
OF_IMPULSES = "no least duration: that of the impulses says nothing of pulses, which by themselves leave less of a mode"
LOOKS = 1001, 401  # frequencies and dampings of a band at which the factor is computed
ROUNDING = 1e-9


def drawn_out(made: Made, width: float, bands: Sequence[Band]) -> Made:
    """Pulses of `width` [s] in place of the impulses; `bands` are those that these keep, as the shortest positive ones that do.

    Of zeros where the factor is not 0 pulses need the impulses' least duration and their width; near 0 (a width of whole periods of a mode
    without damping) nothing is claimed. Of tolerances V they need that of impulses within V over the least factor of the band.
    """
    least, zeros = None, made.least.zeros if made.least else ()
    if made.least and zeros and np.abs(_factor([mode.frequency * mode.direction * width for mode in zeros])).min() > CLEAR:
        least = Least(math.nextafter(made.least.duration + width, 0.0), f"{made.least.among}, as pulses of one width")
    elif made.least and bands:
        lower = _least_of_impulses([(band, least_factor(band, width)) for band in bands])
        if lower is not None:
            least = Least(math.nextafter(lower + width, 0.0), f"{made.least.among}, as pulses of one width")
    notes = (*made.notes, OF_IMPULSES) if made.least and not least else made.notes
    return Made(as_pulses(made.shaper, width), least, made.ranges, notes)


def _least_of_impulses(bands: Sequence[tuple[Band, float]]) -> float | None:
    if any(factor <= band.tolerance for band, factor in bands):
        return None
    try:
        return specified([replace(band, tolerance=band.tolerance / factor) for band, factor in bands]).lower
    except SolverError:
        return None


def least_factor(band: Band, width: float) -> float:
    """A lower bound of `|(1 - e^{-pw})/(pw)|` over the band.

    That is `|∫_0^1 e^{-pws} ds|`, whose slope by pw is at most 1/2: between two looks it falls by no more than a quarter of their distance,
    along a curve that is less than a fifth longer than its chord.
    """
    frequencies, dampings = np.linspace(*band.ends, LOOKS[0]), np.linspace(*band.damped, LOOKS[1] if band.dampings else 1)
    kappa = dampings + 1j * np.sqrt(1.0 - dampings**2)
    at = width * np.multiply.outer(kappa, frequencies)
    steps = [float(np.abs(np.diff(at, axis=axis)).max()) if at.shape[axis] > 1 else 0.0 for axis in (0, 1)]
    return float(np.abs(_factor(at)).min() - 0.3 * sum(steps)) - ROUNDING


def _factor(turns: ArrayLike) -> NDArray[np.complex128]:
    z = np.asarray(turns, dtype=np.complex128)
    return np.asarray(-np.expm1(-z) / z, dtype=np.complex128)
