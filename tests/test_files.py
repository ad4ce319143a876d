"""Files are whole or not there, and JSON holds only numbers that exist."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from reports.files import json_bytes, write_atomically


def test_a_file_is_replaced_whole_and_folders_are_made(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "c.json"
    write_atomically(path, b"old")
    write_atomically(path, b"new and longer")
    assert path.read_bytes() == b"new and longer"
    assert list(path.parent.iterdir()) == [path]


def test_nothing_is_left_of_an_interrupted_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(source: object, target: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("reports.files.os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "c.json", b"new")
    assert list(tmp_path.iterdir()) == []


def test_json_keeps_order_and_every_float() -> None:
    data = {"b": 0.1 + 0.2, "a": [5e-324, -0.0, 9.14867432411053], "Δ": None, "broken": "\ud800"}
    text = json_bytes(data).decode()
    assert json.loads(text) == data | {"broken": "?"}
    assert text.index('"b"') < text.index('"a"') < text.index('"Δ"')
    for missing in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            json_bytes({"a": missing})
