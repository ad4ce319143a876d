"""CVODE of SUNDIALS, a multistep integrator of variable order and step: the one module that knows scikit-sundae.

Adams' formulas (to order 12) follow undamped modes with a tenth of the error of backward differentiation (order 5), which is for stiff
systems: there, Adams' steps would stay as short as the fastest decay.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sksundae.cvode import CVODE

from fmus.errors import FmuError

Array = NDArray[np.float64]

# Of the relative tolerance, times a state's nominal size. Machines whose states are a millionth of their nominal (a stage that moves by
# micrometres, in metres) are followed as well as others, which take a fifth more steps for it.
ABSOLUTE = 1e-6


class IntegratorError(FmuError):
    """The integrator gives up; its words are the message."""


class Integrator:
    """Solves `ẋ = slopes(t, x)` from one accepted point to the next."""

    def __init__(self, slopes: Callable[[float, Array, Array], None], sizes: Array, tolerance: float, stiff: bool, largest: float) -> None:
        """`slopes(t, x, out)` fills `out`; `sizes` (n,) of the states; `largest` step [s], 0 for any."""

        self._cvode = CVODE(
            slopes,
            method="BDF" if stiff else "Adams",
            rtol=tolerance,
            atol=tolerance * ABSOLUTE * np.asarray(sizes, dtype=np.float64),
            max_step=largest,
        )
        self._time = 0.0

    def start(self, time: float, states: Array) -> None:
        """Forget everything and begin at `time` [s] with `states` (n,)."""
        self._time = time
        self._cvode.init_step(time, states)

    def step(self, stop: float) -> tuple[float, Array]:
        """One step, never beyond `stop` [s]: the time that it reached, and the states there."""
        while True:
            result = self._cvode.step(stop, method="onestep", tstop=stop)
            if result.status < 0:
                raise IntegratorError(str(result.message))
            if result.t > self._time:  # after `at` it first comes back to the end of the last step
                self._time = float(result.t)
                return self._time, result.y

    def at(self, time: float) -> Array:
        """The states within the last step, by its own polynomial."""
        result = self._cvode.step(time, method="normal")
        if result.status < 0:
            raise IntegratorError(str(result.message))
        return result.y
