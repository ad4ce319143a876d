"""`slewcert prefilter --sweep` and `--compare`: closed forms point by point, the published cascade, what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from relaxations.cancelling.closed_forms import pole_last, step_and_pole_last
from relaxations.cancelling.sweeps import sweep
from relaxations.errors import ShaperError
from relaxations.shaping.modes import Mode
from suite.cli import main

MODE = Mode(1.0, 0.0)
TEXT = "[plant]\nnumerator = {}\ndenominator = {}\n[maneuver]\ndisplacement = {}\n[limits]\ninput = [{}]\n"


def run(*words: object) -> Any:
    return CliRunner().invoke(main, ["prefilter", *map(str, words)], catch_exceptions=False)


def found(*words: object) -> dict[str, Any]:
    done = run(*words, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def oscillator(tmp_path: Path) -> Path:
    file = tmp_path / "oscillator.toml"
    file.write_text(TEXT.format([1, 1], [1, 0, 1], 1.0, "-9, 9"))
    return file


@pytest.fixture
def pitch(tmp_path: Path) -> Path:
    file = tmp_path / "pitch.toml"
    file.write_text(TEXT.format([1.151, 0.1774], [1, 0.739, 2.072, 0.1774], 0.2, "-0.35, 0.35"))
    return file


def test_a_zero_that_moves_has_the_closed_form_at_each_place(oscillator: Path) -> None:
    points = found(oscillator, "--delays", 1, "--unbounded", "--sweep", "zero[1]=0.5:4:4")["points"]
    assert [point["value"] for point in points] == pytest.approx(np.linspace(0.5, 4.0, 4))
    for point in points:
        exact = pole_last(MODE, [-point["value"]])
        assert point["duration"] == pytest.approx(exact.duration, abs=1e-10)
        assert point["prefilter"]["gains"][0] == pytest.approx(exact.gains[0] / exact.gain, abs=1e-10)


def test_a_delay_that_is_given_has_the_closed_form_too(oscillator: Path) -> None:
    points = found(oscillator, "--delays", 1, "--form", "last+step", "--unbounded", "--sweep", "delay[1]=1:2.5:3")["points"]
    for point in points:
        exact = step_and_pole_last(MODE, [-1.0], point["value"])
        assert point["duration"] == point["value"]
        assert point["prefilter"]["gains"] == pytest.approx([gain / exact.gain for gain in exact.gains], abs=1e-10)


def test_a_frequency_scales_the_filter_and_where_there_is_none_it_is_said(oscillator: Path, tmp_path: Path) -> None:
    table, picture = tmp_path / "t.csv", tmp_path / "t.svg"
    done = run(oscillator, "--delays", 1, "--unbounded", "--sweep", "mode[1].frequency=0.5:2:3", "--csv", table, "--plot", picture)
    assert done.exit_code == 0
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [float(row["mode[1].frequency"]) for row in rows] == [0.5, 1.25, 2.0]
    for row in rows:
        w = float(row["mode[1].frequency"])
        assert float(row["duration"]) == pytest.approx(pole_last(Mode(w, 0.0), [-1.0]).duration, abs=1e-9)
        assert float(row["step[0]"]) + float(row["poles[1]"]) == pytest.approx(1.0)  # shares of the static gain
    assert ">delay 1<" in picture.read_text()
    narrow = oscillator.with_name("narrow.toml")
    narrow.write_text(TEXT.format([1, 1], [1, 0, 1], 1.0, "-1.4, 1.4"))
    done = run(narrow, "--delays", 1, "--form", "last+step", "--sweep", "delay[1]=0.5:2.3:3")
    assert done.exit_code == 0  # the shortest delay asks for 1.66
    assert "none at 1 of 3 values, the first 0.5" in done.stdout


def test_what_is_refused_in_a_sweep_stands_at_its_value() -> None:
    def pick(value: float) -> Any:
        if value > 1.0:
            raise ShaperError("too large")
        return pole_last(MODE, [-value])

    one, other = sweep(pick, [1.0, 2.0])
    assert one.reason is None
    assert one.step(0) + one.term(1) == pytest.approx(1.0)
    assert other.prefilter is None
    assert other.reason == "too large"
    assert np.isnan([other.duration, other.step(0), other.term(1)]).all()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--delays", 1, "--sweep", "zero[1]=2"), "NAME=FROM:TO:N"),
        (("--delays", 1, "--sweep", "zero[1]=2:1:5"), "FROM < TO"),
        (("--delays", 1, "--sweep", "zero[1]=1:2:1"), "N from 2"),
        (("--delays", 1, "--sweep", "zero[7]=1:2:3"), "zero[7]"),
        (("--delays", 1, "--sweep", "mass=1:2:3"), "names no root"),
        (("--delays", 2, "--sweep", "delay[1]=1:2:3"), "--instants"),
        (("--delays", 2, "--sweep", "delay[3]=1:2:3"), "has 2 delay(s)"),
        (("--delays", 1, "--csv", "t.csv"), "--sweep"),
        (("--delays", 1, "--sweep", "zero[1]=1:2:3", "--compare"), "two questions"),
        (("--delays", 1, "--sweep", "zero[1]=1:2:3", "--save", "f.json"), "--save"),
    ],
)
def test_what_makes_no_sense_is_told(oscillator: Path, words: tuple[object, ...], told: str) -> None:
    done = run(oscillator, *words)
    assert done.exit_code == 2
    assert told in done.stderr


@pytest.mark.slow
def test_the_published_designs_beside_each_other(pitch: Path, tmp_path: Path) -> None:
    picture = tmp_path / "c.svg"
    words = ("--delays", 1, "--form", "last+step", "--compare", "--gains", "-0.35:2", "--unbounded", "--plot", picture)
    record = found(pitch, *words)
    asked, concurrent, cascade = record["designs"]
    assert asked["duration"] == pytest.approx(2.3672493903, abs=6e-11)  # (58)
    assert concurrent["duration"] == pytest.approx(4.2744016911, abs=6e-11)  # (61)
    assert cascade["duration"] == pytest.approx(4.2744016911, abs=6e-11)  # (63), (64)
    first = cascade["prefilter"]["delays"][2]
    assert sorted(cascade["prefilter"]["delays"])[1:3] == pytest.approx([2.0004802, 2.2739214535], abs=1e-7)
    assert first == pytest.approx(2.2739214535, abs=1e-9)
    middle = record["factors"].index(1.0)
    for design in record["designs"]:
        for values in design["left"].values():
            assert values[middle] < 1e-9  # nothing is left of the plant that it is made for
    near, small = record["factors"].index(1.02), found(pitch, *words[:4])["zero_sensitivity"]["zero[1]"]
    assert asked["left"]["zero[1]"][near] == pytest.approx(0.02 * small, rel=0.05)  # to first order
    assert max(concurrent["left"]["zero[1]"]) < 1e-9  # steps alone know no zeros
    assert max(asked["left"]["mode[1]"]) > 0.01
    assert asked["input"][1] == pytest.approx(0.3190, abs=1e-3)
    for label in ("steps alone, cascade", "steps alone, concurrent"):
        assert f">{label}<" in picture.read_text()


@pytest.mark.slow
def test_a_rigid_body_has_no_cascade_and_the_table_says_so(tmp_path: Path) -> None:
    file = tmp_path / "rigid.toml"
    file.write_text(TEXT.format([1, 1], [1, 0, 1, 0], 1.0, "-9, 9"))
    done = run(file, "--delays", 2, "--compare")
    assert done.exit_code == 0
    assert "a rigid body has none" in done.stdout
