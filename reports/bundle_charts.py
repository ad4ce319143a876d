"""Charts of many runs of one command: every plant of a range on one another, commands side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reports import charts
from reports.charts import BAD, INK, LIMIT, LINE, SECOND

ROOM = 0.08  # of what is seen, above and below it


@dataclass(frozen=True, slots=True)
class Run:
    """Times (n,) [s] and output (n,) of a run, whether it is the nominal plant's, and whether it failed a requirement."""

    times: ArrayLike
    output: ArrayLike
    nominal: bool
    failed: bool


@dataclass(frozen=True, slots=True)
class Bundle:
    """The runs of one command, and when its move ends [s]."""

    label: str
    runs: Sequence[Run]
    end: float


def bundles(
    name: str,
    shown: Sequence[Bundle],
    *,
    target: float,
    output_label: str,
    since: float | None = None,
    until: float,
    tolerance: float | None = None,
) -> str:
    """The output of every run until `until` [s], a panel for each command, with one vertical axis; up to three commands.

    The picture begins at `since` [s], and is as high as what comes after the ends of the moves; without, it shows all. `target` as the
    output is; `tolerance`, if given, is how far from it the output may be.
    """

    def fill(figure: Any, panels: Sequence[Any]) -> None:
        low, high = target, target
        labels: dict[str, Any] = {}
        for axes, bundle in zip(panels, shown, strict=True):
            axes.axhline(target, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label="target", zorder=1)
            if tolerance is not None:
                for side, label in ((-1.0, None), (1.0, "allowed")):
                    axes.axhline(target + side * tolerance, color=LIMIT, linewidth=1.0, linestyle=(0, (1, 1.5)), label=label, zorder=1)
                low, high = min(low, target - tolerance), max(high, target + tolerance)
            for run in sorted(bundle.runs, key=lambda run: run.nominal):  # the nominal plant lies above the others
                t, y = np.asarray(run.times, dtype=float), np.asarray(run.output, dtype=float)
                seen = (t >= (since or 0.0)) & (t <= until)
                colour, label = (BAD, "fails a requirement") if run.failed else (LINE, "another plant of the range")
                width = 0.8
                if run.nominal:
                    colour, label, width = (SECOND, "nominal plant", 1.8)
                axes.plot(t[seen], y[seen], color=colour, linewidth=width, label=label, alpha=1.0 if run.nominal else 0.75)
                if since is not None:
                    seen &= t >= bundle.end
                low, high = min(low, float(y[seen].min(initial=low))), max(high, float(y[seen].max(initial=high)))
            axes.axvline(bundle.end, color=INK, linewidth=0.8, linestyle=":", label="end of the move")
            axes.set_title(bundle.label, loc="left")
            axes.set_xlabel("time [s]")
            axes.set_xlim(since or 0.0, until)
            labels |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        room = ROOM * max(high - low, 1e-12)
        panels[0].set_ylim(low - room, high + room)
        panels[0].set_ylabel(output_label)
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=3)

    return charts.panels(name, len(shown), 3.6, fill)


def every_run(
    shown: Sequence[Bundle], *, target: float, displacement: float, output_label: str, until: float, tolerance: float | None
) -> Mapping[str, str]:
    """Two charts for up to three commands: the output, and its distance from the target after the moves [% of the move]."""
    ends = [bundle.end for bundle in shown]
    until = min(until, max(float(np.asarray(run.times)[-1]) for bundle in shown for run in bundle.runs))
    names = ", ".join(bundle.label for bundle in shown)
    whole, after = f"Every plant of the range: {names}", f"Every plant of the range after the move: {names}"
    relative = [
        Bundle(
            bundle.label,
            [Run(run.times, 100.0 * (np.asarray(run.output) - target) / displacement, run.nominal, run.failed) for run in bundle.runs],
            bundle.end,
        )
        for bundle in shown
    ]
    share = None if tolerance is None else 100.0 * tolerance
    return {
        whole: bundles(whole, shown, target=target, output_label=output_label, until=until),
        after: bundles(after, relative, target=0.0, output_label="from target [% of move]", since=min(ends), until=until, tolerance=share),
    }
