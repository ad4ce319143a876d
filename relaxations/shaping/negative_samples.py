"""Digital shapers with negative impulses: on whole samples, on as few as do, with a proof that fewer do not.

Two families: impulses whose partial sums stay within bounds and that keep a tolerance over bands (what unity-magnitude humps are for:
impulses 1, -1, 1 ... of exact humps do not in general stand on samples), and zero vibration with negative impulses that sum to no more than
is given. Longer grids hold the shorter ones, so the least number of samples is found by bisection. The multipliers of the program on one
sample less make a function that refutes it on the samples (relaxations.checking.durations).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations import programs
from relaxations.checking.durations import none_on_samples, none_within_sums_on_samples
from relaxations.errors import ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.bands import Band, exceeded
from relaxations.shaping.fewest import fewest
from relaxations.shaping.modes import Mode
from relaxations.shaping.polishing import Demand, rows, vanishing
from relaxations.shaping.sampled import require_fine, sampled
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.sums_within import MISSED, Search
from relaxations.shaping.vanishing import left, possible

Reals = NDArray[np.float64]

MOST_SAMPLES = 1000
LONGEST = 12.0  # half periods of the slowest frequency
LONGER = 1.5  # times as many samples are tried next
NEARLY = 1e-9  # of levels: so close to a bound, or to each other, they are the same
FAINT = 1e-12  # an amplitude that is none
NOTHING = 1e-10  # of the largest term of what vanishes


def within_sums_on_samples(bands: Sequence[Band], lower: float, upper: float, sample_time: float) -> tuple[Shaper, int]:
    """Partial sums in [lower, upper], the tolerance over every band: such a sequence, and how many samples are proven to be needed (or 0).

    Raises `ShaperError` for a sample time that is none or too fine, `ImpossibleShaperError` for one that is too coarse.
    """
    require_fine([band.mode for band in bands], sample_time)
    _require_few(max(min(band.half_period, band.decayed) for band in bands), sample_time)
    longest = max(min(LONGEST * band.half_period, LONGER * band.decayed) for band in bands)
    most = min(math.ceil(longest / sample_time), MOST_SAMPLES)
    search = Search(tuple(bands), lower, upper)

    def one(samples: int) -> Shaper | None:
        excess, levels, _ = search.solved(samples * sample_time, samples)
        return _of_levels(levels, bands, (lower, upper), sample_time) if excess < -2.0 * MISSED * min(b.tolerance for b in bands) else None

    found = fewest(one, 2, most, LONGER)
    if found is None:
        raise SolverError(f"no sequence within these bounds was found on up to {most} samples that keeps every band; um-zv is possible")
    samples, shaper = found
    _, _, multipliers = search.solved((samples - 1) * sample_time, samples - 1) if samples > 1 else (0.0, np.zeros(0), np.zeros(0))
    refuted = samples <= 1 or none_within_sums_on_samples(
        exact(repr(sample_time)), samples - 1, search.conditions(multipliers), Fraction(lower), Fraction(upper)
    )
    return shaper, samples if refuted else 0


def negative_on_samples(modes: Sequence[Mode], negative: float, sample_time: float) -> tuple[Shaper, int]:
    """Zero vibration of all modes, negative impulses that sum to at most `negative`: a shaper, and how many samples it needs (or 0).

    Raises as `within_sums_on_samples`, and `SolverError`.
    """
    require_fine(modes, sample_time)
    _require_few(sum(mode.half_period for mode in modes), sample_time)
    positive = sampled([(mode, 0) for mode in modes], sample_time).shaper
    most = round(positive.duration / sample_time)
    found = fewest(lambda count: positive if count == most else _vanishing(modes, negative, sample_time, count), 2, most, LONGER)
    if found is None:
        raise SolverError(possible(modes))
    samples, shaper = found
    return shaper, samples if _refuted(modes, negative, sample_time, samples - 1) else 0


def _require_few(duration: float, sample_time: float) -> None:
    """Raises `ShaperError` where some `duration` [s] is more samples than are searched."""
    if duration > MOST_SAMPLES * sample_time:
        raise ShaperError(
            f"a sample time of {sample_time!r} s puts some {duration / sample_time:.4g} samples into the shaper; up to {MOST_SAMPLES} are "
            f"searched, so from {duration / MOST_SAMPLES:.4g} s on; without a sample time the instants are free"
        )


def _of_levels(levels: Reals, bands: Sequence[Band], bounds: tuple[float, float], sample_time: float) -> Shaper | None:
    """Jumps between levels; those that are nearly a bound, or the one before, are it, but for the last one, which says when it is over."""
    held: list[float] = []
    for level in map(float, levels):
        near = next((bound for bound in (*bounds, *held[-1:]) if abs(level - bound) <= NEARLY), level)
        held.append(min(max(near, bounds[0]), bounds[1]))
    if held and held[-1] == 1.0:
        held[-1] -= NEARLY
    jumps = np.diff(np.array(held), prepend=0.0, append=1.0)
    kept = np.flatnonzero(jumps)
    times = tuple(float((k - kept[0]) * sample_time) for k in kept)
    over = exceeded(np.array(times), jumps[kept], bands, 1.0)
    return None if over else Shaper(times, tuple(map(float, jumps[kept])))


def _vanishing(modes: Sequence[Mode], negative: float, sample_time: float, samples: int) -> Shaper | None:
    """Of a vertex, whose active set closes the equations to rounding."""
    count = samples + 1
    since = sample_time * (np.arange(count) - samples)
    rates = np.array([mode.frequency * mode.direction for mode in modes])[:, None]
    z = np.exp(rates * since).astype(np.complex128)
    table, ones = np.concatenate([np.ones((1, count)), z.real, z.imag]), np.ones(count)
    aim = np.eye(len(table))[0]
    below = np.concatenate([np.zeros(count), ones])
    found = linprog(below, A_ub=below[None, :], b_ub=[negative], A_eq=np.hstack([table, -table]), b_eq=aim, bounds=(0.0, None),
                    method="highs", options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10})  # fmt: skip
    if found.status != 0:
        return None
    rough = found.x[:count] - found.x[count:]
    kept = np.flatnonzero(np.abs(rough) > FAINT)
    sizes = rough[kept] + np.linalg.lstsq(table[:, kept], aim - table[:, kept] @ rough[kept], rcond=None)[0]
    if not len(kept) or -sizes[sizes < 0.0].sum() > negative * (1.0 + NEARLY):
        return None
    shaper = Shaper(tuple(float((k - kept[0]) * sample_time) for k in kept), tuple(map(float, sizes)))
    return shaper if all(left(shaper, mode) <= NOTHING for mode in modes) else None


def _refuted(modes: Sequence[Mode], negative: float, sample_time: float, samples: int) -> bool:
    if samples < 1:
        return True  # one impulse leaves all of the vibration
    demands = [Demand(mode.frequency, mode.damping, 0.0) for mode in modes]
    columns = rows(demands, sample_time * np.arange(samples + 1.0), samples * sample_time)
    try:
        solution = programs.closest(columns, np.zeros(len(demands)), negative)
    except SolverError:
        return False
    conditions = [vanishing(demand, complex(y)) for demand, y in zip(demands, solution.multipliers, strict=True)]
    return none_on_samples(exact(repr(sample_time)), samples, conditions, Fraction(negative))
