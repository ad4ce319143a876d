"""A filter's picture: what it makes of a step of the reference, and what the plant makes of that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reports.charts import INK, LIMIT, LINE, SECOND, panels


def filtered(
    name: str,
    times: ArrayLike,
    command: ArrayLike,
    output: ArrayLike,
    *,
    end: float,
    target: float,
    limits: tuple[float, float],
    input_label: str,
    output_label: str,
) -> str:
    """Input and output (n,) over `times` (n,) [s]; the last delay is at `end` [s], after which the input goes on along its tail."""
    t, u, y = (np.asarray(values, dtype=float) for values in (times, command, output))
    after = t >= end

    def fill(_: Any, axes: Sequence[Any]) -> None:
        above, below = axes
        above.plot(t[~after], u[~after], color=LINE, label="input")
        above.plot(t[after], u[after], color=SECOND, label="tail")
        room = 0.05 * (limits[1] - limits[0])
        for limit in limits:
            if u.min() - 3 * room <= limit <= u.max() + 3 * room:
                above.axhline(limit, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label=f"limit, {limit:g}")
        above.set_ylabel(input_label)
        below.plot(t, y, color=LINE, label="output")
        below.axhline(target, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label="target")
        below.set_ylabel(output_label)
        below.set_xlabel("time [s]")
        for one in axes:
            one.axvline(end, color=INK, linewidth=1.0, label=f"last delay, {end:.4f} s" if one is below else None)
            one.margins(x=0.01)
            one.legend(loc="best")

    return panels(name, 2, 5.6, fill, stacked=(1, 1))
