"""Tolerances too small for programs in doubles, over several bands: a shaper convolved with itself.

What a convolution leaves is the product of what its factors leave, `|F * F| = |F|²`, at every frequency and damping. So the shortest
positive shaper of the p-th roots of all tolerances, p times in a row, keeps the tolerances, whatever bands there are. With p as small as
programs tell, the shaper is a little longer than the shortest: of tolerances V by about (p - 1) log 2 / log(1/V) of itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from relaxations.errors import SolverError
from relaxations.shaping.bands import Band, exceeded
from relaxations.shaping.insensitive import specified
from relaxations.shaping.shapers import Shaper, convolve
from relaxations.shaping.worst_cases import worst_over

SURE = 1e-3  # a tolerance that programs are sure to tell
ROUNDED = 1e-15  # what instants and amplitudes in doubles leave, beside what is designed; twice that much is kept free
MORE = 3  # how many p are tried
TOLD = 1e-3  # of a tolerance: how closely what is left is enclosed where doubles do not tell it
MANY, TOO_MANY = 400, 2000  # impulses: of more another p is tried, and of the latter none is made


@dataclass(frozen=True, slots=True)
class Rooted:
    """The shaper, and how many factors it is of."""

    shaper: Shaper
    factors: int


def rooted(bands: Sequence[Band]) -> Rooted:
    """A positive shaper that keeps all bands. Raises `SolverError` with what the last program said."""
    inner = [replace(band, tolerance=band.tolerance - 2.0 * ROUNDED) for band in bands if band.tolerance > 4.0 * ROUNDED]
    if len(inner) < len(bands):
        raise SolverError(f"a tolerance of {min(b.tolerance for b in bands)!r} is that of rounding itself")
    first = max(2, math.ceil(math.log(min(band.tolerance for band in bands)) / math.log(SURE) - 1e-9))
    found: list[Rooted] = []
    trouble = SolverError("a shaper convolved with itself does not keep the tolerances")
    for factors in range(first, first + MORE):
        try:
            one = specified([replace(band, tolerance=band.tolerance ** (1.0 / factors)) for band in inner]).shaper
        except SolverError as problem:
            trouble = problem
            continue
        if math.comb(len(one.times) + factors - 1, factors) > TOO_MANY:
            continue
        whole = reduce(convolve, [one] * factors)
        if keeps(whole, bands):
            found.append(Rooted(whole, factors))
            if len(whole.times) <= MANY:
                break
    if not found:
        raise trouble
    return min(found, key=lambda one: len(one.shaper.times))


def keeps(shaper: Shaper, bands: Sequence[Band]) -> bool:
    """Whether it does, but for half of what rounding may add to it; of tolerances that are no more than that, *proven* in balls."""
    inner = [replace(band, tolerance=band.tolerance - ROUNDED / 2.0) for band in bands if band.tolerance > 2.0 * ROUNDED]
    if exceeded(np.array(shaper.times), np.array(shaper.amplitudes), inner, 1.0):
        return False
    tiny = [band for band in bands if band.tolerance <= 2.0 * ROUNDED]
    return all(keeps_in_balls(shaper, band) for band in tiny)


def keeps_in_balls(shaper: Shaper, band: Band) -> bool:
    """Whether it is *proven* to keep the band; its ends, where most is left as a rule, are looked at first."""
    parts = [*(replace(band, low=end, high=end) for end in (band.low, band.high)), band]
    return all(worst_over(shaper, part, TOLD).upper <= part.tolerance for part in parts)
