"""Our logs, read by the reader inside Foxglove and Lichtblick: the same numbers, to the last bit, as our own reading of them."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from reports.logs import read_log

HERE = Path(__file__).parent
pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(shutil.which("node") is None, reason="no Node on this machine"),
    pytest.mark.skipif(not (HERE / "node_modules" / "@mcap" / "core").is_dir(), reason="npm packages are not installed (make foreign)"),
]


def foreign(path: Path) -> dict:
    done = subprocess.run(["node", HERE / "read_log.mjs", path], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def logs(evidence: Path) -> dict[Path, dict]:
    paths = sorted((evidence / "runs").glob("*.mcap"))
    assert paths, "the study left no log"
    return {path: foreign(path) for path in paths}


def test_every_signal_is_read_to_the_last_bit(logs: dict[Path, dict]) -> None:
    for path, read in logs.items():
        for signal in read_log(path).signals:
            topic = read["topics"][signal.topic]
            assert topic["logTimes"] == topic["publishTimes"]
            assert [int(t) for t in topic["logTimes"]] == np.rint(signal.times * 1e9).astype(int).tolist(), (path.name, signal.topic)
            times, *columns = np.array(topic["rows"], dtype=float).reshape(len(signal.times), -1).T
            np.testing.assert_array_equal(times, signal.times)
            np.testing.assert_array_equal(np.array(columns).T, signal.values)


def test_fields_carry_names_units_and_variables(logs: dict[Path, dict]) -> None:
    for path, read in logs.items():
        for signal in read_log(path).signals:
            topic = read["topics"][signal.topic]
            assert topic["fields"] == ["seconds", *signal.names], (path.name, signal.topic)
            for name, unit, variable in zip(signal.names, signal.units, signal.variables, strict=True):
                assert topic["metadata"][f"{name}.unit"] == unit
                assert topic["metadata"][f"{name}.variable"] == variable


def test_expected_topics_are_there(logs: dict[Path, dict]) -> None:
    for path, read in logs.items():
        assert {"/command/u", "/plant/input", "/plant/output", "/plant/state", "/limits", "/verdict"} <= set(read["topics"]), path.name


def test_metadata_begin_with_the_run_and_end_with_the_verdict(logs: dict[Path, dict]) -> None:
    for path, read in logs.items():
        own = read_log(path)
        assert (read["order"][0], read["order"][-1]) == ("suite.run", "suite.verdict"), path.name
        assert read["metadata"]["suite.run"] == dict(own.run)
        assert own.verdict is not None
        assert read["metadata"]["suite.verdict"] == dict(own.verdict)


def test_attachments_are_whole(logs: dict[Path, dict]) -> None:
    for path, read in logs.items():
        own = read_log(path)
        assert {name: base64.b64decode(data) for name, data in read["attachments"].items()} == dict(own.attachments), path.name
        assert "study.toml" in own.attachments


def test_a_flipped_byte_is_noticed(logs: dict[Path, dict], tmp_path: Path) -> None:
    """The foreign reader checks our checksums: the reading above was not luck."""
    content = bytearray(next(iter(logs)).read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    done = subprocess.run(["node", HERE / "read_log.mjs", damaged], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
