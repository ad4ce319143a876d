"""Specified insensitivity on samples: positive impulses at multiples of a sample time, on as few samples as keep the tolerances.

On given instants the least excess over the tolerances is one second-order cone program; where the residual between the frequencies and
dampings that it saw is above a tolerance, those are added. More samples hold what fewer do, for the vibration decays: the least number is
found by bisection, and that one less does not do is proven by the multipliers (relaxations.checking.durations).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relaxations import programs
from relaxations.checking.durations import none_on_samples
from relaxations.errors import ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.bands import Band, exceeded, sampled_demands
from relaxations.shaping.insensitive import implied
from relaxations.shaping.polishing import Demand, rows
from relaxations.shaping.sampled import Sampled, require_fine
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

MOST_SAMPLES = 2000
LONGER = 1.25  # times as many samples are tried next
ROUNDS = 12
SMALL = 1e-4  # tolerances that are sure to be told
PLAIN = 20.0  # times the largest tolerance is what a program counts in
FEW = (1e-3, 1e-5, 1e-7, 0.0)  # weights that make an impulse, tried in turn


def within_on_samples(bands: Sequence[Band], sample_time: float) -> Sampled:
    """The positive shaper of fewest samples that keeps every band, and how many it is proven to need.

    Raises `ShaperError` for no time and for too many samples, `ImpossibleShaperError` for samples that are too coarse, `SolverError`.
    """
    require_fine([band.mode for band in bands], sample_time)
    slowest = max(band.half_period for band in bands)
    if (some := slowest / sample_time) > MOST_SAMPLES:
        raise ShaperError(
            f"a sample time of {sample_time!r} s puts some {some:.4g} samples into the shaper; up to {MOST_SAMPLES} are searched, so from "
            f"{slowest / MOST_SAMPLES:.4g} s on; without a sample time the instants are free"
        )
    search = _Search(tuple(bands), sample_time, sampled_demands(bands))
    low, high = 0, max(math.ceil(some), 1)
    while (found := search.shaper(high)) is None:
        low, high = high, math.ceil(LONGER * high)
        if high > MOST_SAMPLES:
            raise SolverError(
                f"no shaper was found on up to {MOST_SAMPLES} samples of {sample_time!r} s; larger tolerances, narrower bands or a shorter "
                "sample time may be possible"
            )
    while high - low > 1:
        middle = (low + high) // 2
        if (better := search.shaper(middle)) is None:
            low = middle
        else:
            high, found = middle, better
    return Sampled(found, high if search.refuted(high - 1) else 0)


@dataclass
class _Search:
    """What is asked, and the demands so far."""

    bands: tuple[Band, ...]
    sample_time: float
    demands: list[Demand]

    def solve(self, instants: Reals) -> programs.ConeSolution:
        columns, radii = rows(self.demands, instants, float(instants[-1])), np.array([d.tolerance for d in self.demands])
        unit = min(1.0, PLAIN * float(radii.max()))
        try:
            found = programs.closest(columns / unit, radii / unit)
        except SolverError:
            least = min(band.tolerance for band in self.bands)
            raise SolverError(
                f"no program on samples tells a tolerance of {least!r} from none; {SMALL:g} and more are possible, zv-d:N leaves nothing "
                "at the mode, and without a sample time the tolerance is kept"
            ) from None
        return replace(found, excess=found.excess * unit)

    def shaper(self, samples: int) -> Shaper | None:
        """One on instants 0 to `samples`, or None if none was found."""
        instants = self.sample_time * np.arange(samples + 1.0)
        for _ in range(ROUNDS):
            solution = self.solve(instants)
            if solution.excess > 0.0:
                return None
            over: list[Demand] = []
            for least in FEW:
                kept = solution.weights >= least
                kept[-1] = True  # it tells when the residual is looked at
                weights = solution.weights if kept.all() else self.solve(instants[kept]).weights
                weights, places = weights / weights.sum(), np.flatnonzero(kept)
                over = exceeded(instants[places], weights, self.bands, 1.0)
                if not over and weights.min() > 0.0:
                    return Shaper(tuple(float((k - places[0]) * self.sample_time) for k in places), tuple(map(float, weights)))
            self.demands += over
        return None

    def refuted(self, samples: int) -> bool:
        """Whether it is proven that so many samples do not do."""
        if samples < 1:
            return True  # one impulse leaves all of the vibration
        try:
            solution = self.solve(self.sample_time * np.arange(samples + 1.0))
        except SolverError:
            return False
        conditions = [implied(self.bands, d, complex(y)) for d, y in zip(self.demands, solution.multipliers, strict=True)]
        return none_on_samples(exact(repr(self.sample_time)), samples, conditions)
