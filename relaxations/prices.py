"""The multipliers of all limits but the input's and a tail's: each is one more term of the lower side (../docs/theory.md, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.presses import Press
from relaxations.ramps import Ramp

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prices:
    """Of the fuel μ ≥ 0 [1/input unit · s], of named outputs, of the slope (where it is on a limit), and of the input's steps from sample
    to sample (the last one, to the final rest, first); or that of where a continuous input is when a tail begins, alone. `after` the move:
    of what a tail does to the slope (None) or to an output, (name, instant [s], μ⁺, μ⁻)."""

    fuel: float | Fraction = 0.0
    pressed: tuple[Press, ...] = ()
    ramps: tuple[Ramp, ...] = ()
    steps: tuple[float, ...] = ()
    after: tuple[tuple[str | None, float, float, float], ...] = ()


NONE = Prices()
