"""The worst residual of a shaper over a band, *proven* in balls (relaxations.checking.worst)."""

from __future__ import annotations

from fractions import Fraction

from relaxations.checking.worst import Worst, worst_residual
from relaxations.shaping.bands import Band
from relaxations.shaping.shapers import Shaper


def worst_over(shaper: Shaper, band: Band, closely: float) -> Worst:
    """Enclosed to `closely` of itself or of the tolerance, over the decimals of the band's ends and dampings."""
    times, amplitudes, order = shaper.exact_excitation
    low, high = band.dampings or (band.mode.damping, band.mode.damping)
    ends = [Fraction(repr(factor)) * Fraction(repr(band.mode.frequency)) for factor in (band.low, band.high)]
    return worst_residual(
        times,
        amplitudes,
        (ends[0], ends[1]),
        (Fraction(repr(low)), Fraction(repr(high))),
        relative=closely,
        absolute=closely * band.tolerance,
        order=order,
    )
