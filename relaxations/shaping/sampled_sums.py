"""Sequences on samples with partial sums within bounds that leave exactly nothing: a linear program, whose vertex is solved to rounding.

Amplitudes count in units that fall with the fastest decay of the modes, and partial sums by how far they are from the last one, 1, in
units of the impulse that comes next: so no equation is lost in the decay of its mode, and no dip from 1 that falls with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import fastest_decay

Reals = NDArray[np.float64]

FEASIBLE = 1e-9  # the program's own room
ZERO = 1e-9  # an amplitude that is none, in these units
ON_BOUND = 1e-7  # of a partial sum: so near a bound it is on it
CLOSED = 1e-12  # of the largest amplitude, in these units


def amplitudes_within(
    modes: Sequence[Mode],
    sums: tuple[float, float],
    derivatives: int,
    step: float,
    samples: int,
    limited: tuple[Reals, float] | None = None,
) -> Reals | None:
    """Those of the least `Σ |A|` at instants 0, `step` [s] … `samples` · step; None if there are none.

    Partial sums are in `sums` = (low ≤ 0, high ≥ 1), nothing is left of any mode, nor of so many derivatives. `limited`: rows (k, samples
    + 1) of quantities that are linear in the amplitudes, and what each is at most in size.
    """
    count, instants = samples + 1, step * np.arange(samples + 1)
    since, decay = instants - instants[-1], fastest_decay(modes)
    units = np.exp(-decay * instants)
    if not units[-1] > 0.0:
        return None
    rows = [units]
    for mode in modes:
        for power in range(derivatives + 1):
            z = (since / instants[-1]) ** power * np.exp((mode.frequency * mode.direction - decay) * instants)
            rows += [z.real, z.imag]
    equal, aim = np.array(rows), np.eye(len(rows))[0]
    following = np.triu(units / np.append(units[1:], units[-1])[:, None], k=1)[:-1]
    table, room = (np.zeros((0, count)), 0.0) if limited is None else limited
    above = np.vstack([table * units, -table * units, -following, following])
    bounds = np.concatenate([np.full(2 * len(table), room), (sums[1] - 1.0) / units[1:], (1.0 - sums[0]) / units[1:]])
    # The least sum of sizes: few impulses, and no more motion than is needed.
    found = linprog(
        np.concatenate([units, units]),
        A_ub=np.hstack([above, -above]),
        b_ub=bounds + FEASIBLE,
        A_eq=np.hstack([equal, -equal]),
        b_eq=aim,
        bounds=(0.0, None),
        method="highs-ipm",  # its simplex methods take minutes where samples are too few
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return _exact(found.x[:count] - found.x[count:], equal, units, sums) if found.status == 0 else None


def _exact(found: Reals, equal: Reals, units: Reals, sums: tuple[float, float]) -> Reals | None:
    """The program's amplitudes (`found` in `units`) with the equations met to rounding, and the bounds that partial sums meet exactly."""
    begins = np.flatnonzero(np.abs(found) > ZERO)
    if len(begins) < 2:
        return None
    own = units[begins]
    # Of each but the last partial sum: how far below 1 it is, in units of the impulse that ends it.
    depths = np.cumsum((found[begins] * own)[::-1])[::-1][1:] / own[1:]
    low, high = ((1.0 - bound) / own[1:] for bound in sums)
    on_low, on_high = np.abs(depths - low) <= ON_BOUND / own[1:], np.abs(depths - high) <= ON_BOUND
    depths = np.where(on_high, high, np.where(on_low, low, depths))
    # An impulse ends one level and begins the next: d_{k-1} - d_k, and the first one 1 - d_0.
    ends = np.vstack([np.zeros(len(depths)), np.eye(len(depths))]) - np.vstack([np.diag(own[1:] / own[:-1]), np.zeros(len(depths))])
    start = np.eye(len(begins))[0] / own[0]
    free = ~on_low & ~on_high
    conditions = equal[1:, begins]
    missed = conditions @ (start + ends @ depths)
    depths[free] -= np.linalg.lstsq(conditions @ ends[:, free], missed, rcond=None)[0]
    jumps = start + ends @ depths
    closed = np.abs(conditions @ jumps).max() <= CLOSED * max(1.0, float(np.abs(jumps).max()))
    if not closed or (depths < high).any() or (depths > low).any():
        return None
    amplitudes = np.zeros(len(units))
    amplitudes[begins] = jumps * own
    return amplitudes


def on_samples(amplitudes: Reals, step: float) -> Shaper:
    """The shaper of amplitudes at multiples of `step` [s]; those that are 0 are no impulses."""
    kept = np.flatnonzero(amplitudes)
    return Shaper(tuple(float((k - kept[0]) * step) for k in kept), tuple(map(float, amplitudes[kept])))
