"""The chart of a trade-off: minimum times side by side over what is asked for, and what is proven of them at the points and between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reports import charts
from reports.charts import BAD, FAINT, INK, LIMIT, LINE, SECOND, UNSURE, Limit
from reports.errors import RecordError

BESIDE = 4.0  # a command is marked up to this factor beyond the values of a sweep
MOST_TICKS = 12  # of a logarithmic axis, one at every value
ROUND = [m * 10.0**k for k in range(-12, 7) for m in (1, 2, 5)]  # where there are more values


@dataclass(frozen=True, slots=True)
class Sweep:
    """Minimum times over `values` (n,), ascending: both sides [s] (NaN: none), and what is known of each.

    `states` are "proved", "bracketed", "impossible" or "refused". `between` holds what is proven between each value and the next
    (lower, upper), (n - 1, 2) [s]; NaN: nothing, infinite: no time is enough. `own` is the place of the study's own value.
    """

    label: str
    title: str
    values: Sequence[float]
    lower: Sequence[float]
    upper: Sequence[float]
    states: Sequence[str]
    between: Sequence[tuple[float, float]]
    own: int
    logarithmic: bool = False


def tradeoff(name: str, sweeps: Sequence[Sweep], *, reference: Limit | None, commands: Mapping[str, tuple[float, float]]) -> str:
    """Minimum time over one or two quantities side by side: what is proven impossible is shaded, what is not proven is marked as such.

    `reference` is the time of the nominal plant alone; up to four `commands` (value of the first sweep, time [s]) are marked there,
    if they are near.
    """
    for one in sweeps:
        count = len(one.values)
        if not count == len(one.lower) == len(one.upper) == len(one.states) == len(one.between) + 1:
            given = f"{len(one.lower)} and {len(one.upper)} sides, {len(one.states)} states, {len(one.between)} gaps"
            raise RecordError(f"{count} values need as many sides and states, and {count - 1} gaps; given are {given}")
    known = [t for one in sweeps for t in (*one.lower, *one.upper) if np.isfinite(t)]
    known += [time for _, time in commands.values()] + ([] if reference is None else [reference.value])
    low, high = min(known, default=0.0), max(known, default=1.0)
    room = max(high - low, 1e-6 * high)
    floor, ceiling = low - 0.25 * room, high + 0.15 * room

    def fill(figure: Any, panels: Sequence[Any]) -> None:
        for axes, one in zip(panels, sweeps, strict=True):
            axes.set_ylim(floor, ceiling)
            _sweep(axes, one, floor, ceiling)
            if reference is not None:
                axes.axhline(reference.value, color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), label=reference.label, zorder=2)
            axes.set_xlabel(one.label)
            axes.set_title(one.title, loc="left")
        for marker, (label, (value, time)) in zip("svPd", commands.items(), strict=False):
            if sweeps[0].values[0] / BESIDE <= value <= sweeps[0].values[-1] * BESIDE:
                panels[0].plot(value, time, marker, color=SECOND, markersize=5.5, markeredgewidth=0, label=label, zorder=5)
        panels[0].set_ylabel("minimum time [s]")
        entries: dict[str, Any] = {}
        for axes in panels:
            entries |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=2)

    return charts.panels(name, len(sweeps), 4.4, fill)


def _sweep(axes: Any, one: Sweep, floor: float, ceiling: float) -> None:
    """One panel: what is proven, and the points."""
    x, lower, upper = np.array(one.values), np.array(one.lower), np.array(one.upper)
    edges = np.repeat(x, 2)[1:-1]
    below = np.repeat([min(pair[0], ceiling) if pair[0] == pair[0] else floor for pair in one.between], 2)
    above = np.repeat([pair[1] if pair[1] == pair[1] else ceiling for pair in one.between], 2)
    axes.fill_between(edges, floor, below, color=FAINT, alpha=0.8, linewidth=0, zorder=1, label="no command is this fast: proven")
    axes.fill_between(
        edges, below, np.maximum(above, below), color=FAINT, alpha=0.4, linewidth=0, zorder=1, label="not known between the points"
    )
    states = np.array(one.states)
    proven = states == "proved"
    axes.plot(x[proven], upper[proven], color=LINE, linewidth=1.0, zorder=3)
    marks = {
        "proved": ("o", LINE, "minimum time, proven from both sides"),
        "bracketed": ("D", UNSURE, "bracketed: not proven from both sides"),
    }
    for state, (marker, colour, label) in marks.items():
        chosen = (states == state) & np.isfinite(upper)
        if np.any(chosen):
            axes.vlines(x[chosen], lower[chosen], upper[chosen], color=colour, linewidth=2.0, zorder=4)
            look: dict[str, Any] = {} if state == "proved" else {"markerfacecolor": "none"}
            axes.plot(x[chosen], upper[chosen], marker, color=colour, markersize=4.5, label=label, zorder=4, **look)
    lost = {
        "X": (states == "impossible", "impossible in any time: proven", BAD, 0.96),
        "^": ((states == "bracketed") & ~np.isfinite(upper), "no command was found", UNSURE, 0.96),
        "x": (states == "refused", "no such task", INK, 0.03),
    }
    for marker, (chosen, label, colour, height) in lost.items():
        if np.any(chosen):
            places = np.full(int(chosen.sum()), height)
            axes.plot(x[chosen], places, marker, color=colour, markersize=6.0, transform=axes.get_xaxis_transform(), label=label, zorder=4)
    drawn = np.isfinite(upper[one.own])
    ring: dict[str, Any] = {} if drawn else {"transform": axes.get_xaxis_transform()}
    height = upper[one.own] if drawn else lost["x" if states[one.own] == "refused" else "X"][3]
    axes.plot(x[one.own], height, "o", color=INK, markersize=10.0, markerfacecolor="none", label="this study", zorder=5, **ring)
    if one.logarithmic:
        axes.set_xscale("log")
        ticks = x if len(x) <= MOST_TICKS else np.array([t for t in ROUND if x[0] <= t <= x[-1]])
        axes.set_xticks(ticks, [f"{value:g}" for value in ticks])
        axes.set_xticks([], minor=True)
    axes.margins(x=0.03)
