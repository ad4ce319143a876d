"""The linear plant of an FMU at an operating point, by Model Exchange.

ẋ = A (x - x_0) + B (u - u_0), y - y_0 = C (x - x_0) + D (u - u_0)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmus.archives import Fmu
from fmus.errors import LinearizationError
from fmus.stepping import Array
from fmus.workers import Worker


@dataclass(frozen=True, slots=True)
class Linearization:
    """State-space matrices with the point that they belong to; arrays are read-only.

    `A` (n, n), `B` (n,), `C` (n,), `D`; `states` names the rows. `x`, `u`, `y` are the operating point and `rates` the
    states' derivatives there, zero at an equilibrium. `method` is "directional derivatives" or "finite differences";
    `note` says why derivatives that the FMU promises were not used.
    """

    states: tuple[str, ...]
    A: Array
    B: Array
    C: Array
    D: float
    method: str
    x: Array
    u: float
    y: float
    rates: Array
    note: str = ""

    def __post_init__(self) -> None:
        for array in (self.A, self.B, self.C, self.x, self.rates):
            array.setflags(write=False)


def linearize(
    fmu: Fmu,
    input: str,
    output: str,
    parameters: Mapping[str, float] | None = None,
    *,
    initial_state: Mapping[str, float] | None = None,
    initial_input: float = 0.0,
    timeout: float = 60.0,
    worker: Worker | None = None,
) -> Linearization:
    """Linearise at the FMU's initial point, in a child process.

    Uses the FMU's directional derivatives, else central differences with a step of 6e-6 of the larger of value and nominal.
    Raises `LinearizationError` when the FMU fails or a matrix is not finite, `DescriptionError` without Model Exchange.
    """
    if worker is None:
        with Worker() as own:
            return linearize(
                fmu, input, output, parameters, initial_state=initial_state, initial_input=initial_input, timeout=timeout, worker=own
            )
    answer = worker.linearize(fmu, input, (output,), parameters or {}, initial_state or {}, initial_input, timeout)
    n = len(fmu.description.states)
    matrix = np.array(answer["rows"], dtype=float).reshape(n + 1, n + 1)
    point = np.array([*answer["x"], *answer["rates"], *answer["y"]], dtype=float)
    if not (np.isfinite(matrix).all() and np.isfinite(point).all()):
        raise LinearizationError(f"{fmu.path.name} gives a linear plant with entries that are not finite")
    return Linearization(
        states=tuple(name for name, _ in fmu.description.states),
        A=matrix[:n, :n].copy(),
        B=matrix[:n, n].copy(),
        C=matrix[n, :n].copy(),
        D=float(matrix[n, n]),
        method=answer["method"],
        x=np.array(answer["x"], dtype=float),
        u=float(initial_input),
        y=float(answer["y"][0]),
        rates=np.array(answer["rates"], dtype=float),
        note=answer["note"],
    )
