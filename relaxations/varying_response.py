"""The response of a varying plant to a command, by time stepping: for comparison with measured runs, where nothing is proven."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command
from relaxations.transitions import VaryingPlant

Reals = NDArray[np.float64]

RELATIVE, ABSOLUTE = 1e-10, 1e-12  # tolerances, the second relative to what the input moves in a unit of time


def varying_response(
    plant: VaryingPlant,
    command: Command,
    times: Reals,
    rest: float = 0.0,
    *,
    before: bool = False,
    begin: Sequence[Fraction] | None = None,
) -> Reals:
    """Deviation of the output from its first rest value at `times` [s], ascending; the input rests at `rest` before the command, and the
    states begin at deviations `begin` (none: at rest).

    Runge and Kutta's method of order 8, begun anew wherever the input jumps or the schedule has an instant.
    """
    instants = np.array([float(t) for t in plant.instants])
    from scipy.integrate import solve_ivp  # here: few plants vary, and it takes longer to load than a bound takes

    A, B, C, D = (np.array(which, dtype=float) for which in (plant.A, plant.B, plant.C, plant.D))

    def at(table: Reals, t: float) -> Reals:
        i = int(np.searchsorted(instants, t, side="right"))
        if i >= len(instants):
            return table[-1]
        share = (t - instants[i - 1]) / (instants[i] - instants[i - 1])
        return (1.0 - share) * table[i - 1] + share * table[i]

    edges = np.unique([0.0, *command.breakpoints, *instants, *(times[-1:])])
    edges = edges[edges <= max(float(times[-1]), 0.0)] if len(times) else edges
    state = np.zeros(plant.order) if begin is None else np.array([float(x) for x in begin])
    scale = float(np.abs(B).max()) or 1.0
    states = np.repeat(state[:, None], len(times), axis=1)
    for since, end in itertools.pairwise(edges):
        piece = [p for p in command.pieces(rest) if p.start <= since][-1]
        inside = np.flatnonzero((times > since) & (times <= end))
        wanted = np.unique(np.append(times[inside], end))
        found = solve_ivp(
            lambda t, x, piece=piece: at(A, t) @ x + at(B, t) * (piece(t) - rest),
            (since, end),
            state,
            method="DOP853",
            t_eval=wanted,
            rtol=RELATIVE,
            atol=ABSOLUTE * scale,
        )
        states[:, inside] = found.y[:, np.searchsorted(wanted, times[inside])]
        state = found.y[:, -1]
    u = command(np.nextafter(times, -np.inf) if before else times, rest) - rest
    return np.array([at(C, t) @ states[:, k] + at(D, t) * u[k] for k, t in enumerate(times)])
