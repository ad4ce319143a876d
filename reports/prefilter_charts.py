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
    final: float,
    target: float,
    limits: tuple[float, float],
    input_label: str,
    output_label: str,
) -> str:
    """Input and output (n,) over `times` (n,) [s]; the last delay is at `end` [s], one of them, after which the input goes along its tail
    to its `final` level."""
    t, u, y = (np.asarray(values, dtype=float) for values in (times, command, output))
    moving, after = t <= end, t >= end  # the jump at the last delay is still the steps'

    def fill(_: Any, axes: Sequence[Any]) -> None:
        above, below = axes
        above.set_title(name, loc="left")
        above.plot(t[moving], u[moving], color=LINE, label="input")
        if np.ptp(u[after]) > 0.0:
            above.plot(t[after], u[after], color=SECOND, label="tail")
            above.axhline(final, color=INK, linewidth=0.8, linestyle=(0, (1, 2)), label=f"final level, {final:g}", zorder=1)
        else:
            above.plot(t[after], u[after], color=LINE)
        for limit, label in zip(limits, (f"limits, {limits[0]:g} and {limits[1]:g}", None), strict=True):
            above.axhline(limit, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label=label, zorder=1)
        above.set_ylabel(input_label)
        below.plot(t, y, color=LINE, label="output")
        below.axhline(target, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label="target")
        below.set_ylabel(output_label)
        below.set_xlabel("time [s]")
        for one in axes:
            one.axvline(end, color=INK, linewidth=1.0, zorder=1, label=f"last delay, {end:.4f} s" if one is below else None)
            one.margins(x=0.01)
            one.legend(loc="best")

    return panels(name, 2, 5.6, fill, stacked=(1, 1))
