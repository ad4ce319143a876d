"""The chart of timing errors: which instants of a command matter, and what their errors leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reports import charts
from reports.charts import FOURTH, INK, LIMIT, LINE, SECOND, Limit
from reports.errors import RecordError

COLOURS, STYLES = (LINE, SECOND, FOURTH, INK), "os^D"


@dataclass(frozen=True, slots=True)
class Curve:
    """One motion, in per cent of the move: `worst` and `rms` at each size of error (n,), `each` for a small error of each instant (m,)."""

    label: str
    worst: Sequence[float]
    rms: Sequence[float]
    each: Sequence[float]


def timing_errors(
    name: str,
    curves: Sequence[Curve],
    *,
    errors: Sequence[float],
    instants: Sequence[float],
    each: str,
    command: tuple[Sequence[float], Sequence[float], float],
    command_label: str,
    limit: Limit | None,
) -> str:
    """Three panels over one another: the command (instants of its steps, levels from them on, level at rest), what `each` (ms, µs) of an
    instant's error does, and what is left against the size of the errors [s], the worst and the root mean square, on logarithmic axes."""
    for curve in curves:
        if not (len(curve.worst) == len(curve.rms) == len(errors) and len(curve.each) == len(instants)):
            raise RecordError(f"{curve.label}: {len(errors)} sizes of error and {len(instants)} instants need as many values each")
    edges, levels, rest = command

    def fill(figure: Any, panels: Sequence[Any]) -> None:
        above, middle, below = panels
        span = edges[-1] - edges[0]
        times = [edges[0] - 0.03 * span, *edges, edges[-1] + 0.03 * span]
        above.step(times, [rest, *levels, levels[-1]], where="post", color=LINE, linewidth=1.2)
        above.set_ylabel(command_label)
        above.set_xlim(times[0], times[-1])
        middle.set_xlim(times[0], times[-1])
        above.tick_params(labelbottom=False)
        sizes = [size for curve in curves for size in curve.each]
        floor = max(min((size for size in sizes if size > 0.0), default=1.0), 1e-6 * max(sizes, default=1.0)) / 2
        for number, curve in enumerate(curves):
            colour, marker = COLOURS[number % 4], STYLES[number % 4]
            effects = np.array(curve.each)
            seen = effects > floor
            places = (np.array(instants) + (number - (len(curves) - 1) / 2) * 0.006 * span)[seen]  # beside one another
            middle.vlines(places, floor, effects[seen], color=colour, linewidth=1.3)
            middle.plot(places, effects[seen], marker, color=colour, markersize=3.5, label=curve.label)
            below.plot(errors, curve.worst, color=colour, linewidth=1.6, label=f"{curve.label}: no instant errs by more, worst: proven")
            below.plot(errors, curve.rms, color=colour, linestyle=(0, (5, 2)), linewidth=1.0, label=f"{curve.label}: this jitter, rms")
        middle.set_yscale("log")
        middle.set_ylim(bottom=floor)
        middle.set_ylabel(f"for each {each} [% of move]")
        middle.set_xlabel("time [s]")
        if limit is not None:
            below.axhline(limit.value, color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), label=limit.label)
        below.set_xscale("log")
        below.set_yscale("log")
        for axis in (middle.yaxis, below.xaxis, below.yaxis):
            axis.set_major_formatter(lambda value, place: f"{value:g}")
        below.set_xlabel("error of each instant [s]")
        below.set_ylabel("left at the end [% of move]")
        below.margins(x=0.01)
        figure.legend(*below.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return charts.panels(name, 3, 7.4, fill, stacked=(2.0, 2.6, 3.8))
