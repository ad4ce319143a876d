"""Digital shapers: impulses at whole samples that leave exactly nothing, with positive amplitudes, in as few samples as that takes.

On the instants kh a positive sequence with `Σ A_k (kh)^j e^{κω kh} = 0` is a point of the convex hull of the columns: non-negative least
squares says whether 0 is one, and its active set holds as many impulses as there are equations. Longer grids hold the shorter ones, so the
least number of samples is found by bisection; that one less does not do is proven by a plane with all of its columns on one side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from relaxations import programs
from relaxations.checking.durations import none_on_samples
from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.fewest import fewest
from relaxations.shaping.modes import Mode
from relaxations.shaping.polishing import Demand, rows, vanishing
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import fastest_decay, possible

Reals = NDArray[np.float64]

NOTHING = 1e-12  # of what all impulses would leave together: equations of order one, solved to rounding
FAINT = (0.0, 1e-9)  # of the largest: with fewer impulses than equations (1 and 3 Hz in half a second) the others are rounding
MOST_SAMPLES = 4096
LONGER = 1.5  # times as many samples are tried next


@dataclass(frozen=True, slots=True)
class Sampled:
    """A shaper, and the number of sample times that it is proven to need at least."""

    shaper: Shaper
    needed: int


def sampled(zeros: Sequence[tuple[Mode, int]], sample_time: float) -> Sampled:
    """The shortest positive shaper at multiples of `sample_time` [s] with zero vibration and so many derivatives at each mode.

    Raises `ShaperError` for no time, `ImpossibleShaperError` for a sample time above half a damped period of a mode,
    `SolverError` if `MOST_SAMPLES` are not enough.
    """
    if not zeros:
        raise ShaperError("a shaper needs at least one mode")
    require_fine([mode for mode, _ in zeros], sample_time)
    shaper, low = few(zeros, sample_time)
    return Sampled(shaper, low + 1 if _refuted(zeros, sample_time, low) else 0)


def few(zeros: Sequence[tuple[Mode, int]], sample_time: float) -> tuple[Shaper, int]:
    """That shaper, with as many impulses as there are equations, and the most samples on which none was found.

    Raises as `sampled`, but for modes and times that are none.
    """
    slowest = max(mode.half_period * (count + 1) for mode, count in zeros)
    high = math.ceil(slowest / sample_time)
    if high > MOST_SAMPLES:
        raise ShaperError(
            f"a sample time of {sample_time!r} s puts some {slowest / sample_time:.4g} samples into the shaper; at most {MOST_SAMPLES} are "
            f"searched, so from {slowest / MOST_SAMPLES:.4g} s on; without a sample time the instants are free"
        )
    least = fewest(lambda samples: _weights(zeros, sample_time, samples), high, MOST_SAMPLES, LONGER)
    if least is None:
        raise SolverError(f"no shaper was found on up to {MOST_SAMPLES} samples of {sample_time!r} s: {possible([m for m, _ in zeros])}")
    samples, found = least
    kept = np.flatnonzero(found)
    kept = kept - kept[0]
    return Shaper(tuple(float(k * sample_time) for k in kept), tuple(float(a) for a in found[found > 0.0])), samples - 1


def require_fine(modes: Sequence[Mode], sample_time: float) -> None:
    """Raises `ShaperError` for no time, `ImpossibleShaperError` for one above half a damped period of a mode."""
    if not 0.0 < sample_time < math.inf:
        raise ShaperError(f"a sample time is positive and finite, not {sample_time!r} s")
    if coarse := [mode for mode in modes if sample_time > mode.half_period]:
        least = min(mode.half_period for mode in coarse)
        raise ImpossibleShaperError(
            f"a sample time of {sample_time!r} s is too coarse for {', '.join(f'{mode.frequency:.6g} rad/s' for mode in coarse)}: "
            f"the samples tell a mode from slower ones up to half its damped period, {least:.6g} s"
        )


def _refuted(zeros: Sequence[tuple[Mode, int]], sample_time: float, samples: int) -> bool:
    """Whether it is proven that no positive amplitudes at instants 0 to `samples` leave nothing."""
    duration = max(samples, 1) * sample_time
    demands = [Demand(mode.frequency, mode.damping, 0.0, power, duration) for mode, count in zeros for power in range(count + 1)]
    columns = rows(demands, sample_time * np.arange(samples + 1.0), samples * sample_time)
    try:
        solution = programs.closest(columns, np.zeros(len(demands)))
    except SolverError:
        return False
    conditions = [vanishing(demand, complex(y)) for demand, y in zip(demands, solution.multipliers, strict=True)]
    return none_on_samples(exact(repr(sample_time)), samples, conditions)


def _weights(zeros: Sequence[tuple[Mode, int]], sample_time: float, samples: int) -> Reals | None:
    """Amplitudes at instants 0 to `samples`, or None if none are positive and leave nothing."""
    instants = np.arange(samples + 1) * sample_time
    since, rows, decay = instants - instants[-1], [], fastest_decay([mode for mode, _ in zeros])
    for mode, count in zeros:
        for power in range(count + 1):
            row = (since / instants[-1]) ** power * np.exp((mode.frequency * mode.direction - decay) * instants)
            rows += [row.real, row.imag]
    # Amplitudes in units of what they do to the mode that tells most of them: all columns are of order one, however different the
    # modes decay. A positive point of the hull of these directions is one of the columns' own.
    sizes = np.abs(rows).max(axis=0)
    if not sizes.min() > 0.0:
        return None
    table = np.vstack([rows / sizes, np.ones(samples + 1)])
    aim = np.zeros(len(table))
    aim[-1] = 1.0
    try:
        weights, _ = nnls(table, aim)
    except RuntimeError:  # too many iterations
        return None
    for faint in FAINT:
        kept = np.flatnonzero(weights > faint * weights.max())
        if not len(kept):
            return None
        # Once more on the active set alone, to rounding.
        exactly, *_ = np.linalg.lstsq(table[:, kept], aim, rcond=None)
        if exactly.min() > 0.0 and np.abs(table[:, kept] @ exactly - aim).max() <= NOTHING:
            found = np.zeros(samples + 1)
            found[kept] = exactly * np.exp(-decay * instants[kept]) / sizes[kept]
            return found / found.sum()
    return None
