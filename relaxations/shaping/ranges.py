"""Humps for several modes in one solution: the shortest shaper that keeps the tolerance over the range of each mode's own humped shaper.

The equations of `relaxations.shaping.humps` count humps of one mode; with several of them they have solutions that nobody wants (all zeros
of a fast mode at one place, for the shaper of the slow one does the rest), or none. What such a shaper is *for* is its range: the interval
of frequency about the mode in which the residual is at most the tolerance. Over the ranges of all modes the shortest shaper is that of
specified insensitivity. For one mode without damping it is the humped shaper itself, which is thereby proven to be the shortest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from relaxations.errors import SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.humps import Humped, extra_insensitive
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import insensitive_range

TOUCHED = 1e-9  # relative: humps reach the tolerance exactly, but for rounding
ENDLESS = 4.0  # times the frequency: as far as a range goes that has no end
GRAIN = 1e6  # ends are whole numbers of this part of the frequency, towards the inside: they are printed as they are meant


def humped_ranges(
    modes: Sequence[Mode], tolerance: float, humps: int, made: Callable[[Mode, float, int], Humped] = extra_insensitive
) -> tuple[Band, ...]:
    """Of each mode the range over which its own shaper with so many humps keeps `tolerance`; `made` makes it.

    With much damping a range has no end: it then goes to `ENDLESS` times the frequency. Raises `SolverError` where
    there is no such shaper.
    """
    bands = []
    for mode in modes:
        own = made(mode, tolerance, humps).shaper
        low, high = insensitive_range(own.times, own.amplitudes, mode.frequency, mode.damping, tolerance * (1.0 + TOUCHED))
        high = min(high, ENDLESS)
        if not 0.0 < low < high:
            raise SolverError(
                f"{humps} hump(s) of {tolerance!r} keep it from {low:.4g} to {high:.4g} of the frequency at a damping of {mode.damping!r}, "
                "which is no range that one solution for all modes could be made for; si takes any --band"
            )
        bands.append(Band(mode, math.ceil(low * GRAIN) / GRAIN, math.floor(high * GRAIN) / GRAIN, tolerance))
    return tuple(bands)
