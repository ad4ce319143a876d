"""`slewcert shaper --reference FILE --shaped FILE`: commands, splines, tables of samples; spline files where command files are read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_shaper_command import run

from relaxations.commands import Command, Segment, Tail
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.shapers import shape
from relaxations.shaping.splines import Spline, shape_spline
from suite.errors import Mistake
from suite.shaping import mode_of
from suite.study_shaper import read_command

MODE = ("--mode", "1.0Hz:0.05")
SHAPER = derivative_shaper(mode_of("1.0Hz:0.05"), 1)
POINTS = [[0.0, 0.0], [0.5, 0.3], [1.2, 0.9], [2.0, 1.0]]
FILES = {
    "spline": '{"format": "slewcert-spline/1", "points": [[0, 0], [0.5, 0.3], [1.2, 0.9], [2, 1]]}',
    "samples": "t,x\n0,0\n0.1,0.4\n0.2,0.8\n0.3,1\n",
    "command": json.dumps(Command(1.0, (Segment(0.0, 1.0), Segment(0.4, 0.5, 1.0)), Tail(0.5)).to_dict()),
}
MOVE = Spline.through([t for t, _ in POINTS], [y for _, y in POINTS])


@pytest.mark.parametrize("kind", FILES)
def test_a_reference_is_shaped_in_closed_form(kind: str, tmp_path: Path):
    reference, shaped = tmp_path / ("r.csv" if kind == "samples" else "r.json"), tmp_path / "shaped.json"
    reference.write_text(FILES[kind])
    done = run("zvd", *MODE, "--reference", reference, "--shaped", shaped, "--json")
    assert done.exit_code == 0, done.stderr
    told, at = json.loads(done.stdout)["shaped"], np.linspace(-0.3, 4.0, 301)
    assert (told["kind"], told["reference"], told["file"]) == (kind, str(reference), str(shaped))
    assert f"shaped {kind}" in run("zvd", *MODE, "--reference", reference, "--shaped", shaped).stdout
    if kind == "command":
        assert Command.from_json(shaped.read_text()) == shape(Command.from_json(FILES[kind]), SHAPER)
        return
    mine = MOVE if kind == "spline" else Spline.through([0, 0.1, 0.2, 0.3], [0, 0.4, 0.8, 1], degree=1)
    found = Spline.from_json(shaped.read_text())
    assert found(at) == pytest.approx(shape_spline(mine, SHAPER)(at), abs=1e-14)
    assert told["communication_points"] == len(found.communication_points) == 3 * len(mine.communication_points)
    assert (told["from"], told["until"], told["degree"]) == (0.0, pytest.approx(mine.knots[-1] + SHAPER.duration), mine.degree)


def test_a_table_has_every_knot_and_both_sides_of_a_jump(tmp_path: Path):
    reference, shaped = tmp_path / "r.json", tmp_path / "shaped.csv"
    reference.write_text(json.dumps(Spline(np.array([0.0, 1.0]), np.array([[1.0, 0.0, 1.0]])).to_dict()))
    assert run("zv", *MODE, "--reference", reference, "--shaped", shaped).exit_code == 0
    rows = np.array([[float(x) for x in line.split(",")] for line in shaped.read_text().splitlines()[1:]])
    expected = shape_spline(Spline.from_json(reference.read_text()), derivative_shaper(mode_of("1.0Hz:0.05")))
    twice = np.flatnonzero(np.diff(rows[:, 0]) == 0.0)
    assert rows[twice, 0] == pytest.approx(expected.jumps(0)[0])
    assert rows[twice + 1, 1] - rows[twice, 1] == pytest.approx(expected.jumps(0)[1])
    assert set(expected.knots.tolist()) <= set(rows[:, 0].tolist())
    late = np.delete(rows, twice, axis=0)
    assert late[:, 1] == pytest.approx(expected(late[:, 0]), abs=1e-12)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--reference", "c.json"], ["--reference goes with --shaped"]),
        (["--shaped", "o.json"], ["--shaped goes with --reference"]),
        (["--reference", "c.json", "--shaped", "o.txt"], ["must end in .json", ".csv"]),
        (["--reference", "c.json", "--shaped", "o.csv"], ["what becomes of a command is a command"]),
        (["--reference", "l.json", "--shaped", "o.json"], ['"format" None', "slewcert-spline/1", "slewcert-command/1"]),
        (["--reference", "no.csv", "--shaped", "o.json"], ["no.csv", "line 3", "'x'"]),
        (["--reference", "words", "--shaped", "o.json"], ["JSON", ".csv"]),
        (["--reference", "bytes.json", "--shaped", "o.json"], ["bytes.json is no text file"]),
    ],
)
def test_mistakes_are_named(words: list[str], told: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.json").write_text(FILES["command"])
    (tmp_path / "l.json").write_text("[1]")
    (tmp_path / "words").write_text("words")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe")
    (tmp_path / "no.csv").write_text("t,x\n0,1\n1,two\n")
    done = run("zv", *MODE, *words)
    assert done.exit_code == 2
    assert [word for word in told if word not in done.stderr] == []
    assert not (tmp_path / "o.json").exists()


def test_a_study_reads_a_spline_file_as_lines_that_are_close_to_it(tmp_path: Path):
    (tmp_path / "move.json").write_text(FILES["spline"])
    wrong: list[Mistake] = []
    command, at = read_command("move.json", tmp_path, "command.reference", wrong), np.linspace(0.0, 3.0, 3001)
    assert command is not None
    assert wrong == []
    assert np.abs(command(at) - MOVE(at)).max() <= 3e-6
    assert command.maneuver_time == 2.0
    assert read_command("bad.json", tmp_path, "command.reference", wrong) is None
    (tmp_path / "bad.json").write_text('{"format": "slewcert-spline/1", "points": [[0, 0]]}')
    assert read_command("bad.json", tmp_path, "command.reference", wrong) is None
    assert "two points" in str(wrong[-1])
