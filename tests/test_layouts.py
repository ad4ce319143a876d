"""The viewer's layout names only what the log holds."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from reports.layouts import layout, layout_bytes
from reports.records import Signal


def signal(topic: str, *names: str) -> Signal:
    count = len(names)
    return Signal(topic, np.zeros(1), names, ("m",) * count, ("output",) * count, names, np.zeros((1, count)))


SIGNALS = (
    signal("/command/u", "u"),
    signal("/plant/input", "force"),
    signal("/plant/output", "position_1", "position_2"),
    signal("/linear/output", "position_2"),
    signal("/plant/state", *(f"x{i}" for i in range(40))),
    signal("/limits", "lower", "upper"),
    signal("/own/thing", "a"),
)


def leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def test_every_path_exists_and_every_panel_is_placed() -> None:
    data = layout(SIGNALS)
    assert sorted(leaves(data["layout"])) == sorted(data["configById"])
    known = {f"{s.topic}.{n}" for s in SIGNALS for n in s.names}
    plots = {name: panel for name, panel in data["configById"].items() if name.startswith("Plot!")}
    paths = [[p["value"] for p in panel["paths"]] for panel in plots.values()]
    assert paths[:2] == [
        ["/command/u.u", "/plant/input.force"],
        ["/plant/output.position_1", "/plant/output.position_2", "/linear/output.position_2"],
    ]
    assert {p for group in paths for p in group} <= known
    assert max(map(len, paths)) == 12  # 40 states cannot be told apart
    assert paths[-1] == ["/own/thing.a"]
    assert data["configById"]["RosOut!log"]["topicToRender"] == "/suite/log"


def test_a_log_without_signals_has_a_layout_too() -> None:
    assert leaves(layout(())["layout"]) == ["RosOut!log", "RawMessages!verdict"]
    assert json.loads(layout_bytes(SIGNALS)) == layout(SIGNALS)
    assert layout_bytes(SIGNALS) == layout_bytes(SIGNALS)
