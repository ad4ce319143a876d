"""Continuation: a solution known at one parameter is followed to another (shapers in closed form are known without damping)."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from relaxations.errors import SolverError

Reals = NDArray[np.float64]

LONGEST, SHORTEST = 0.02, 1e-6  # steps of the parameter
CLOSED = 1e-11  # of a residual whose terms are of order one: what is left is rounding
FARTHEST = 0.01  # from where the last step pointed to: a solution that is farther away may be another one


def continued(system: Callable[[Reals, float], Reals], start: Reals, end: float, begin: float = 0.0) -> Reals:
    """Solve `system(x, parameter) = 0` (as many equations as unknowns, of order one) at parameter `end`, from a solution near `begin`.

    Raises `SolverError` where the solution cannot be followed any further.
    """
    first = _solved(system, start, begin)
    if first is None:
        raise SolverError("Newton's method did not converge on the first solution")
    x, at, step, slope = first, begin, LONGEST, np.zeros_like(start)
    while at < end:
        step = min(step, end - at)
        aim = x + step * slope
        following = _solved(system, aim, at + step)
        if following is None or np.abs(following - aim).max() > FARTHEST * max(1.0, float(np.abs(x).max())):
            step /= 4.0
            if step < SHORTEST:
                raise SolverError(f"such a solution ends at {at:.4g} on the way to {end:.4g}")
            continue
        slope, x, at, step = (following - x) / step, following, at + step, min(1.5 * step, LONGEST)
    return x


def _solved(system: Callable[[Reals, float], Reals], start: Reals, parameter: float) -> Reals | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no progress: the residual below decides
        found = root(system, start, args=(parameter,), method="hybr", options={"xtol": 1e-14})
    return np.asarray(found.x) if np.abs(system(found.x, parameter)).max() <= CLOSED else None
