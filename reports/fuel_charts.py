"""Charts of minimum times against fuel: how long a move takes, when the thrusters switch, and what else a budget decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from reports import charts
from reports.charts import FAINT, FOURTH, INK, LIMIT, LINE, SECOND, UNSURE, Limit

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": INK, "linestyle": (0, (6, 2))},
    {"color": LINE, "linestyle": "-"},
    {"color": SECOND, "linestyle": (0, (5, 1.5, 1, 1.5))},
    {"color": FOURTH, "linestyle": (0, (1, 1.2))},
)
STROKES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1.2)))
HIGH, LOW, ALPHA = LINE, SECOND, 0.30  # of pulses, one side and the other
PANEL = 4.4, 3.5  # inches
MOST_STRIPS = 60  # budgets of one area: between them its edges are straight
JUMP = 0.12  # of the move's duration: a switch that moves farther from one budget to the next has jumped
NAMED, NUMBERED = 0.1, 0.035  # of the axis: room to the next node in which "n = 4" can be read, and the number alone
ROOM = 1.22  # times the largest value: how high an axis is, so that the legend has a place


class Panel(Protocol):
    """What draws itself into axes."""

    def draw(self, axes: Any) -> None:
        """Into these axes of matplotlib."""
        ...


Profile = tuple[Sequence[float], Sequence[int]]
"""Switches [s], from 0 to the end of the move, and on which side of its rest the input is between two of them (1, 0, -1)."""


@dataclass(frozen=True, slots=True)
class Marks:
    """Budgets that are marked in every panel: nodes by their numbers, and the study's own (None: it has none)."""

    nodes: Mapping[int, float]
    own: float | None = None

    def draw(self, axes: Any) -> None:
        """Vertical lines, numbered at the top where there is room."""
        low, high = axes.get_xlim()
        beyond = np.inf
        for number, fuel in sorted(self.nodes.items()):
            room, beyond = (beyond - fuel) / (high - low), fuel
            axes.axvline(fuel, color=LIMIT, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
            if room >= NUMBERED:
                name, above = f"n = {number}" if room >= NAMED else f"{number}", ("data", "axes fraction")
                axes.annotate(name, (fuel, 1.0), (3, -9), above, "offset points", fontsize=8, color=LIMIT)
        if self.own is not None:
            axes.axvline(self.own, color=INK, linewidth=0.8, linestyle=":", zorder=1)


@dataclass(frozen=True, slots=True)
class Times:
    """A kind's minimum times over `fuels` (n,), ascending: both sides [s] (NaN: none), "proved", "bracketed" or "impossible" each.

    `between` holds the lower side that is proven between each budget and the next, (n - 1,); NaN: nothing, infinite: no time is enough.
    """

    label: str
    fuels: Sequence[float]
    lower: Sequence[float]
    upper: Sequence[float]
    states: Sequence[str]
    between: Sequence[float]
    look: int


@dataclass(frozen=True, slots=True)
class SlewTimes:
    """Minimum time against fuel, a line a kind; what is proven too short even for the first kind is shaded.

    `held` are further lines (label, fuels, times) of commands that are held in a form, with the look of the kind they belong to.
    """

    curves: Sequence[Times]
    fuel: str
    marks: Marks
    title: str
    held: Sequence[tuple[str, Sequence[float], Sequence[float], int]] = ()

    def draw(self, axes: Any) -> None:
        """See above."""
        first = self.curves[0]
        known = np.array([t for one in self.curves for t in one.upper if np.isfinite(t)] or [1.0])
        floor, ceiling = max(known.min() - 0.2 * np.ptp(known), 0.0), known.max() + 0.06 * (np.ptp(known) or known.max())
        axes.set_ylim(floor, ceiling)
        edges = np.repeat(np.array(first.fuels), 2)[1:-1]
        below = np.repeat([min(t, ceiling) if t == t else floor for t in first.between], 2)
        told = f"too fast for any {first.label} command: proven"
        axes.fill_between(edges, floor, below, color=FAINT, alpha=0.8, linewidth=0, zorder=0, label=told)
        for one in self.curves:
            x, upper, states = np.array(one.fuels), np.array(one.upper), np.array(one.states)
            axes.plot(x, np.where(states == "proved", upper, np.nan), label=one.label, zorder=3, **LOOKS[one.look % 4])
            open_ = (states == "bracketed") & np.isfinite(upper)
            if open_.any():
                axes.plot(x[open_], upper[open_], "D", color=UNSURE, markersize=4.0, markerfacecolor="none", label="bracketed", zorder=4)
        for label, fuels, times, look in self.held:
            axes.plot(fuels, times, color=LOOKS[look % 4]["color"], linewidth=3.5, alpha=0.35, solid_capstyle="butt", label=label, zorder=2)
        self.marks.draw(axes)
        axes.set_title(self.title, loc="left")
        axes.set_xlabel(self.fuel)
        axes.set_ylabel("slew time [s]")
        axes.margins(x=0.02)
        _legend(axes)


@dataclass(frozen=True, slots=True)
class Lines:
    """Something that is measured of the commands against fuel, a line a kind: label, fuels, values, look."""

    curves: Sequence[tuple[str, Sequence[float], Sequence[float], int]]
    fuel: str
    quantity: str
    marks: Marks
    title: str
    logarithmic: bool = False

    def draw(self, axes: Any) -> None:
        """See above."""
        for label, fuels, values, look in self.curves:
            axes.plot(fuels, values, label=label, zorder=3, **LOOKS[look % 4])
        top = max((v for _, _, values, _ in self.curves for v in values if np.isfinite(v)), default=1.0)
        if self.logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(lambda value, place: f"{value:g}")
        else:
            axes.set_ylim(0.0, ROOM * top or 1.0)
        self.marks.draw(axes)
        axes.set_title(self.title, loc="left")
        axes.set_xlabel(self.fuel)
        axes.set_ylabel(self.quantity)
        axes.margins(x=0.02)
        _legend(axes, len(self.curves))


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Residual over relative frequency (n,), a line a command (label, values, look); commands of one kind have one colour."""

    factors: Sequence[float]
    curves: Sequence[tuple[str, Sequence[float], int]]
    quantity: str
    limit: Limit

    def draw(self, axes: Any) -> None:
        """See above."""
        seen: dict[int, int] = {}
        for label, values, look in self.curves:
            seen[look] = seen.get(look, 0) + 1
            axes.plot(self.factors, values, color=LOOKS[look % 4]["color"], linestyle=STROKES[seen[look] % 3 - 1], label=label, zorder=3)
        axes.axhline(self.limit.value, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label=self.limit.label)
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("true frequency / modelled frequency")
        axes.set_ylabel(self.quantity)
        axes.margins(x=0.01)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8, ncols=2)


@dataclass(frozen=True, slots=True)
class Profiles:
    """When the input is where, against fuel; None: not on or off. `names` are those of the limits."""

    fuels: Sequence[float]
    profiles: Sequence[Profile | None]
    names: tuple[str, str]
    fuel: str
    marks: Marks
    title: str

    def draw(self, axes: Any) -> None:
        """Budgets whose profiles have the same arcs, at nearly the same times, are one area."""
        seen: set[int] = set()
        rows = [(u, p) for u, p in zip(self.fuels, self.profiles, strict=True) if p is not None]
        groups = [(tuple(group[0][1][1]), group) for group in _alike(rows)]
        ends = [(group[0][0], group[-1][0]) for _, group in groups]
        for k, (sides, group) in enumerate(groups):
            stride = -(-len(group) // MOST_STRIPS)
            fuels, times = zip(*((u, p[0]) for u, p in (*group[:-1:stride], group[-1])), strict=True)
            x, edges = np.array([fuels[0], *fuels, fuels[-1]]), np.array([times[0], *times, times[-1]])
            if k > 0:  # two areas meet halfway between their budgets
                x[0] = (ends[k - 1][1] + fuels[0]) / 2
            if k < len(groups) - 1:
                x[-1] = (fuels[-1] + ends[k + 1][0]) / 2
            for i, side in enumerate(sides):
                if side:
                    label = {} if side in seen else {"label": self.names[0] if side > 0 else self.names[1]}
                    axes.fill_between(x, edges[:, i], edges[:, i + 1], color=HIGH if side > 0 else LOW, alpha=ALPHA, linewidth=0, **label)
                    seen.add(side)
            axes.plot(x, edges[:, 1:-1], color=INK, linewidth=0.7)
            axes.plot(x, edges[:, -1], color=INK, linewidth=1.4, **({} if 0 in seen else {"label": "end of the move"}))
            seen.add(0)
        self.marks.draw(axes)
        axes.set_ylim(bottom=0.0)
        axes.set_title(self.title, loc="left")
        axes.set_xlabel(self.fuel)
        axes.set_ylabel("time in the move [s]")
        axes.margins(x=0.02)
        _legend(axes)


def chart(name: str, panels: Sequence[Panel], columns: int = 1) -> str:
    """Panels in rows, as one picture."""
    rows = -(-len(panels) // columns)
    size = (7.6, 4.2) if columns == 1 and rows == 1 else (PANEL[0] * columns, PANEL[1] * rows)

    def fill(figure: Any, axes: Sequence[Any]) -> None:
        for panel, one in zip(panels, axes, strict=False):
            panel.draw(one)
            if one.get_yscale() == "linear":
                one.ticklabel_format(axis="y", useOffset=False)
        for one in axes[len(panels) :]:
            one.set_axis_off()

    return charts.grid(name, rows, columns, size, fill)


def _alike(rows: Sequence[tuple[float, Profile]]) -> list[list[tuple[float, Profile]]]:
    """Neighbours with the same arcs, none of which jumps: at a node two pulses meet and others part."""
    groups: list[list[tuple[float, Profile]]] = []
    for fuel, (times, sides) in rows:
        before = groups[-1][-1][1] if groups else None
        same = before is not None and tuple(before[1]) == tuple(sides)
        if before is None or not same or max(abs(a - b) for a, b in zip(before[0], times, strict=True)) > JUMP * times[-1]:
            groups.append([])
        groups[-1].append((fuel, (times, sides)))
    return groups


def _legend(axes: Any, columns: int = 1) -> None:
    """In the upper right corner, below the numbers of the nodes."""
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.95), fontsize=8, ncols=columns, borderaxespad=0.0)
