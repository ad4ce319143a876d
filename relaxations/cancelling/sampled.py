"""Filters whose delays are whole samples, cancelling exactly (Singh 2012, parametrisation 3).

With the delays on a grid only gains and numerators are left to satisfy the equations, so that there are at least as many of them; bounds
then say how short the filter may be. Steps on every sample are tried first: where these cannot do it, no few of them can.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from relaxations.cancelling.designs import UNBOUNDED, Found, natural_time, solved_at
from relaxations.cancelling.forms import Form
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.structures import Structure
from relaxations.errors import ImpossibleShaperError, ShaperError

LONGEST = 4.0  # times the plant's own time
ALL_AT_ONCE, ONE_BY_ONE = 200_000, 2_000  # choices of samples for the delays between the first and the last one
NEARLY = 1e-9  # of the gains: what keeps the bounds so nearly is looked at more closely
MOST = 4000  # samples that are looked at


def on_samples(structure: Structure, sample_time: float) -> Prefilter:
    """The filter of the least whole number of samples, of `sample_time` [s]; of several of them that of the least sum of |gains|.

    Raises `ShaperError` for what has too few gains, or no bounds; `ImpossibleShaperError` if none was found.
    """
    form = structure.form
    if not 0.0 < sample_time < math.inf:
        raise ShaperError(f"a sample time is positive and finite, not {sample_time!r} s")
    if len(structure.parts) < structure.conditions.size:
        raise ShaperError(
            f"{structure.counted}: with delays on samples there must be as many of the former, so at least "
            f"{form.delays + structure.conditions.size - len(structure.parts)} delays"
        )
    if not structure.bounds:
        raise ShaperError(f"{structure.counted} and any samples; {UNBOUNDED}")
    if structure.contradiction is not None:
        raise ImpossibleShaperError(structure.contradiction)
    last = math.ceil(LONGEST * natural_time(structure) / sample_time)
    if last > MOST:
        raise ShaperError(
            f"a filter may take {last} samples of {sample_time * structure.unit!r} s: more than {MOST} are not looked through"
        )
    for samples in range(_first(structure, sample_time, last), last + 1):
        found = _shortest(structure, sample_time, samples)
        if found is not None:
            return structure.filter(found.delays, found.unknowns)
    raise ImpossibleShaperError(
        f"no filter of this form with {form.delays} delays on samples of {sample_time * structure.unit!r} s was found up to "
        f"{last * sample_time * structure.unit:.6g} s within the bounds; one delay more, wider bounds or another form may do"
    )


def _first(structure: Structure, sample_time: float, last: int) -> int:
    """A number of samples below which steps on every sample cannot do it; a filter may wait, so that the longer ones can if one can."""
    low, high = structure.form.delays - 1, last
    waits = structure.form.carriers != (0,) or structure.conditions.order == 0
    if not waits or not _possible(structure, sample_time, high):
        return structure.form.delays
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _possible(structure, sample_time, middle) else (middle, high)
    return high


def _possible(structure: Structure, sample_time: float, samples: int) -> bool:
    last = structure.form.carriers == (structure.form.delays,)
    every = tuple(range(samples + 1))
    form = Form(samples, (samples,) if last else every, True, structure.form.free)
    dense = Structure(structure.conditions, form, structure.bounds)
    return solved_at(dense, np.array([k * sample_time for k in range(samples + 1)])) is not None


def _shortest(structure: Structure, sample_time: float, samples: int) -> Found | None:
    """The delays between, of a filter that takes this many samples, with the least sum of |gains|."""
    inner, steps = structure.form.delays - 1, np.array([part.power is None for part in structure.parts])
    count, square = math.comb(samples - 1, inner), len(structure.parts) == structure.conditions.size and structure.still
    most = ALL_AT_ONCE if square else ONE_BY_ONE
    if count > most:
        ways = f"{inner} delays among {samples - 1} samples can be chosen in {count} ways"
        raise ShaperError(f"{ways}, more than {most}: a longer sample time, or fewer delays")
    choices = np.array([(0, *between, samples) for between in itertools.combinations(range(1, samples), inner)]) * sample_time
    if square:
        choices = _promising(structure, choices, steps)
    best: tuple[float, Found] | None = None
    for delays in choices:
        found = solved_at(structure.fine, delays)
        if found is not None:
            size = float(np.abs(found.unknowns[steps]).sum())
            best = (size, found) if best is None or size < best[0] * (1 - 1e-9) else best
            if square:
                break
    return best and best[1]


def _promising(structure: Structure, choices: NDArray[np.float64], steps: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Those whose only gains keep the bounds, or nearly: all at once, the smaller gains first."""
    table, (rows, sides) = structure.conditions.table(structure.parts, choices), structure.limits(choices[0])
    unknowns = (np.linalg.pinv(table) @ structure.conditions.aim[:, None])[..., 0]
    sizes = np.abs(unknowns).max(axis=1, keepdims=True) + np.abs(sides)
    kept = np.flatnonzero((unknowns @ rows.T >= sides - NEARLY * sizes).all(axis=1))
    return choices[kept[np.argsort(np.abs(unknowns[kept][:, steps]).sum(axis=1), kind="stable")]]
