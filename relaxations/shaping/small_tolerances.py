"""Specified insensitivity where the tolerance is too small for programs in doubles: humped shapers, solved in as many digits as it takes.

Undamped a humped shaper is the shortest positive one of its own range; with damping it is a little longer. So the one with the fewest
humps whose range, as a ratio of its ends, holds the band is scaled to begin where the band does. Beyond the humps that are solved come
shapers with derivatives, which any number of them is known of. None shorter than the bound of a larger tolerance keeps a smaller one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bands import Band, exceeded
from relaxations.shaping.humps import LEAST_TOLERANCE, MOST_HUMPS, extra_insensitive
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import Shortest, specified
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import insensitive_range
from relaxations.shaping.shapers import Shaper

DERIVATIVES = (13, 16, 20, 25, 32, 40, 50, 64)
INSIDE = 1e-7  # relative: how much lower than the band begins a range does
LARGER = (1e-4, 1e-3, 1e-2)  # tolerances whose bounds are tried in turn
SMALL, SMALLEST = 1e-3, 1e-7  # tolerances of which programs may fail, and do


def within(bands: Sequence[Band]) -> Shortest:
    """The shortest positive shaper for the bands; for one of a small tolerance, where no program does, one that is near it.

    Raises `SolverError`.
    """
    least = min((band.tolerance for band in bands), default=1.0)
    if len(bands) == 1 and least < SMALLEST:
        return within_small(bands[0])
    try:
        return specified(bands)
    except SolverError:
        if len(bands) == 1 and least < SMALL:
            return within_small(bands[0])
        if least < SMALL:
            raise SolverError(
                f"a tolerance of {least!r} is too small for one solution of several bands; {SMALL!r} and more are possible, and "
                "without --simultaneous one shaper for each mode, convolved"
            ) from None
        raise


def within_small(band: Band) -> Shortest:
    """A positive shaper that keeps the band's tolerance, with the least duration of a larger one.

    Raises `SolverError` where none of those above does.
    """
    ranged = band.damped[0] < band.damped[1]  # humps are at one damping
    at = Mode(1.0, sum(band.damped) / 2.0 if ranged else band.mode.damping)
    for one in _candidates(at, band.tolerance, 0 if ranged else MOST_HUMPS):
        unit = band.mode.frequency * (band.low + band.high) / 2.0  # what is 1 rad/s there
        if not ranged:
            low, high = insensitive_range(one.times, one.amplitudes, 1.0, at.damping, band.tolerance)
            if not 0.0 < low < high or high / low * (1.0 - INSIDE) < band.high / band.low:
                continue
            unit = band.mode.frequency * band.low / low * (1.0 - INSIDE)
        shaper = Shaper(tuple(t / unit for t in one.times), one.amplitudes)
        if not exceeded(np.array(shaper.times), np.array(shaper.amplitudes), [band], 1.0):
            return Shortest(shaper, _lower(band))
    raise SolverError(
        f"no shaper was found that keeps {band.tolerance!r} from {band.low:g} to {band.high:g} of the frequency, damping "
        f"{band.damped[0]:g} to {band.damped[1]:g}; narrower bands, one damping, and tolerances from {LEAST_TOLERANCE!r} on are possible"
    )


def _candidates(mode: Mode, tolerance: float, most_humps: int) -> Iterator[Shaper]:
    if tolerance >= LEAST_TOLERANCE:
        for humps in range(1, most_humps + 1):
            try:
                yield extra_insensitive(mode, tolerance, humps).shaper
            except (SolverError, ShaperError):
                break
    for number in DERIVATIVES:
        yield derivative_shaper(mode, number)


def _lower(band: Band) -> float | None:
    for tolerance in LARGER:
        if tolerance > band.tolerance:
            try:
                found = specified([replace(band, tolerance=tolerance)]).lower
            except SolverError:
                continue
            if found is not None:
                return found
    return None
