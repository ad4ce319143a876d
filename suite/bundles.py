"""Every run of a campaign on one picture, from the logs that were kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.commands import Command
from reports import logs
from suite.observations import INPUT, observe

FEWEST, MOST = 3, 60  # runs that a picture is worth, and that it can show
SAMPLES = 1000  # of a curve
SEEN = 3.0  # times the longest move
BESIDE = 3  # commands in one picture


def drawings(folders: Mapping[str, tuple[Mapping[str, Any], Path]]) -> dict[str, str]:
    """Charts (SVG by title) of all runs of each command, (results, evidence folder) by its name; none where hardly any log was kept.

    Only campaigns whose runs were all kept are shown (`[keep] logs = "all"`): a choice of the worst would look like the whole.
    Raises what reading a log raises.
    """
    from reports.bundle_charts import Bundle, every_run

    chosen = {
        name: (results, folder)
        for name, (results, folder) in folders.items()
        if FEWEST <= len(results["run_table"]) <= MOST and all(run["log"] is not None for run in results["run_table"])
    }
    ends = {name: Command.from_dict(results["command"]).end for name, (results, _) in chosen.items()}
    until = SEEN * max(ends.values(), default=0.0)
    found: list[Bundle] = []
    target, scale, tolerance, label = 0.0, 1.0, None, ""
    for name, (results, folder) in chosen.items():
        bundle = _bundle(results["run_table"], folder, until)
        if bundle is None:
            continue
        runs, target, scale = bundle
        found.append(Bundle(name, runs, ends[name]))
        output = results["plant"]["output"]
        label = f"{output['name']} [{output['unit']}]" if output["unit"] else output["name"]
        tolerance = _tolerance(results)
    drawn: dict[str, str] = {}
    for first in range(0, len(found), BESIDE):
        shown = found[first : first + BESIDE]
        drawn |= every_run(shown, target=target, displacement=scale, output_label=label, until=until, tolerance=tolerance)
    return drawn


def _tolerance(results: Mapping[str, Any]) -> float | None:
    asked = [r["max"] for r in results["requirements"] if r["quantity"] == "residual_vibration" and r["max"] is not None]
    return min(asked, default=None)


def _bundle(table: Sequence[Mapping[str, Any]], folder: Path, until: float) -> tuple[list[Any], float, float] | None:
    from reports.bundle_charts import Run

    runs, target, scale = [], 0.0, 1.0
    for entry in table:
        log = logs.read_log(folder / entry["log"])
        if all(signal.topic != INPUT for signal in log.signals):  # it failed before its first point
            return None
        seen = observe(log)
        last = int(np.searchsorted(seen.times, until)) + 1
        keep = np.unique(np.linspace(0, min(last, len(seen.times)) - 1, SAMPLES).astype(int))
        runs.append(Run(seen.times[keep], seen.output[keep], entry["nominal"], entry["verdict"] != "pass"))
        target, scale = seen.target, seen.scale
    return runs, target, scale
