"""A layout for Foxglove and Lichtblick, so that a log opens as plots: input, output, states, messages and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from reports.files import json_bytes
from reports.records import OWN_TOPICS, Signal

_TOGETHER = (
    ("Input", ("/command/u", "/plant/input")),
    ("Output", ("/plant/output", "/linear/output")),
    ("States", ("/plant/state",)),
)
_CONSTANT = ("/limits",)  # one row, drawn as dots where the run begins: not worth a plot of its own
_MOST_CURVES = 12  # more cannot be told apart in one plot


def layout(signals: Sequence[Signal]) -> dict[str, Any]:
    """The layout of a log with these signals, as plain data."""
    given = {s.topic: s for s in signals}
    groups = [(title, [given.pop(t) for t in topics if t in given]) for title, topics in _TOGETHER]
    groups += [(topic.strip("/"), [signal]) for topic, signal in given.items() if topic not in _CONSTANT]
    panels: dict[str, dict[str, Any]] = {}
    for number, (title, members) in enumerate((g for g in groups if g[1]), start=1):
        panels[f"Plot!{number}"] = _plot(title, members)
    plots = list(panels)
    log, verdict = "RosOut!log", "RawMessages!verdict"
    panels[log] = {"searchTerms": [], "minLogLevel": 1, "topicToRender": OWN_TOPICS[0]}
    panels[verdict] = {"topicPath": OWN_TOPICS[1], "diffEnabled": False, "expansion": "all"}
    below = {"first": log, "second": verdict, "direction": "row", "splitPercentage": 65}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stacked([*plots, below]),
    }


def layout_bytes(signals: Sequence[Signal]) -> bytes:
    """The layout file: import it in the viewer ("Import from file")."""
    return json_bytes(layout(signals))


def _plot(title: str, signals: Sequence[Signal]) -> dict[str, Any]:
    paths = [
        {
            "value": f"{signal.topic}.{name}",
            "enabled": True,
            "timestampMethod": "receiveTime",
            "label": f"{variable or name} [{unit or '1'}]",
        }
        for signal in signals
        for name, variable, unit in zip(signal.names, signal.variables, signal.units, strict=True)
    ]
    return {
        "title": title,
        "paths": paths[:_MOST_CURVES],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


def _stacked(panels: Sequence[str | dict[str, Any]]) -> str | dict[str, Any]:
    """Panels one above the other, all of the same height."""
    if len(panels) == 1:
        return panels[0]
    return {"first": panels[0], "second": _stacked(panels[1:]), "direction": "column", "splitPercentage": 100 / len(panels)}
