"""A filter's picture: what it makes of a step of the reference, and what the plant makes of that; and curves of many filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reports.charts import FOURTH, INK, LIMIT, LINE, SECOND, panels, standalone

COLOURS = (LINE, SECOND, FOURTH, INK, LIMIT)
STYLES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (5, 2, 1, 2)), (0, (9, 3)))
Curves = Mapping[str, tuple[ArrayLike, ArrayLike]]


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


def families(
    name: str, *parts: tuple[str, str, Curves], most: Sequence[float | None] = (), level: float | None = None, steps: bool = False
) -> str:
    """Panels over one another: of each its axes' labels and curves; `most` is as high as an axis goes, `level` a line in the first one."""

    def fill(figure: Any, axes: Sequence[Any]) -> None:
        labels: dict[str, Any] = {}
        for number, (one, (across, up, curves)) in enumerate(zip(axes, parts, strict=True)):
            if level is not None and number == 0:
                one.axhline(level, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label="the shaper that leaves the zeros alone")
            for k, (label, (x, y)) in enumerate(curves.items()):
                draw = one.step if steps else one.plot
                more = {"where": "post"} if steps else {}
                draw(x, y, color=COLOURS[k % 5], linestyle=STYLES[k % 5], linewidth=1.4, label=label, **more)
            if number < len(most) and (limit := most[number]) is not None:
                one.set_ylim(-limit, limit)
            one.set_xlabel(across)
            one.set_ylabel(up)
            one.margins(x=0.01)
            labels |= dict(zip(*reversed(one.get_legend_handles_labels()), strict=True))
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=3)

    return standalone(panels(name, len(parts), 2.5 * len(parts) + 0.7, fill, stacked=[1.0] * len(parts)))
