"""The linearisation of a study's FMU, at its operating point or later in its motion: the one place where a study asks for it."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING

from suite.study import FmuPlant, Plant

if TYPE_CHECKING:
    from fmus.linearization import Linearization
    from fmus.workers import Worker

Value = Fraction | Decimal | float


def linearised(
    source: FmuPlant,
    plant: Plant,
    parameters: Mapping[str, Value],
    *,
    after: float = 0.0,
    step: float | None = None,
    worker: Worker | None = None,
) -> Linearization:
    """The FMU's linear plant with these parameters, where the study lets it settle and `after` more seconds with its input at rest.

    `step` [s] is the communication step on the way; None: what suits the plant. Raises what `fmus.linearization.linearize` raises.
    """
    from fmus.linearization import linearize  # here, because it brings along what runs FMUs

    return linearize(
        source.archive,
        plant.input,
        plant.output,
        {name: float(value) for name, value in parameters.items()},
        initial_state={name: float(value) for name, value in source.initial_state.items()},
        initial_input=float(plant.initial_input),
        settle=source.settle + after,
        step=step,
        method=source.method,
        probe=source.identification,
        worker=worker,
    )
