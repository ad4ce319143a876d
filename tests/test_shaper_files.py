"""Files that `slewcert shaper` writes: all or none, each under a name of its own; and what is told of a command that is wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from suite.cli import main

ZVD = ("zvd", "--mode", "1Hz:0.05")


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["shaper", *map(str, words)], catch_exceptions=False)


def test_of_files_of_which_one_cannot_be_made_none_is_written(tmp_path: Path) -> None:
    first, second = tmp_path / "a.cfg", tmp_path / "a.g"
    done = run("custom", "--mode", "1Hz:0.05", "--impulses", "0:1.5,0.49:-0.5", "--export", first, "--export", second)
    assert done.exit_code == 2
    assert "last impulse that is positive" in done.stderr
    assert not list(tmp_path.iterdir())


def test_two_outputs_have_two_names(tmp_path: Path) -> None:
    same = tmp_path / "same.svg"
    done = run(*ZVD, "--save", same, "--plot", tmp_path / "." / "same.svg")
    assert done.exit_code == 2
    assert "--plot writes there" in done.stderr
    assert not same.exists()
    assert run(*ZVD, "--save", tmp_path / "a.json", "--export", tmp_path / "a.h", "--export", tmp_path / "a.h").exit_code == 0


def test_an_unusable_reference_is_told_with_the_other_mistakes(tmp_path: Path) -> None:
    broken = tmp_path / "move.json"
    broken.write_text("{")
    done = run("zvd", "--mode", "1Hz:nan", "--reference", broken, "--shaped", tmp_path / "shaped.json")
    assert done.exit_code == 2
    assert "2 mistakes" in done.stderr
    assert "--reference: " in done.stderr
    assert "damping" in done.stderr


@pytest.mark.parametrize("tolerance", ["0", "1", "nan", "-1"])
def test_a_tolerance_that_is_none_is_told_once(tolerance: str) -> None:
    done = run("ei", "--mode", "1Hz:0.05", "--tolerance", tolerance)
    assert done.exit_code == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "between 0 and 1" in done.stderr


@pytest.mark.parametrize("sums", ["-1e300:1e300", "0:2e9", "-2e9:1"])
def test_partial_sums_too_large_for_doubles_are_refused_at_once(sums: str) -> None:
    done = run("sums-zv", "--mode", "1Hz:0.05", f"--sums={sums}")
    assert done.exit_code == 2
    assert "bounds beyond 1e+09" in done.stderr


@pytest.mark.parametrize(("kind", "options"), [("ei", ()), ("um-ei", ()), ("sna-zv", ("--negative", "0.3"))])
def test_a_mode_given_twice_is_one_mode_where_one_solution_is_asked_for(kind: str, options: tuple[str, ...]) -> None:
    once, twice = (
        json.loads(run(kind, *["--mode", "1Hz:0.05"] * count, *options, "--simultaneous", "--json").stdout)["duration"] for count in (1, 2)
    )
    assert twice == once
    in_turn = json.loads(run(kind, *["--mode", "1Hz:0.05"] * 2, *options, "--json").stdout)["duration"]
    assert in_turn == pytest.approx(2 * once)


def test_ranges_are_of_the_modes_as_they_were_counted() -> None:
    done = run("ei", "--mode", "1Hz:0", "--mode", "1Hz:0", "--mode", "2.7Hz:0", "--tolerance", "0.2", "--sample-time", "0.1", "--json")
    assert [each["mode"] for each in json.loads(done.stdout)["ranges"]] == [1, 3]


@pytest.mark.parametrize(
    ("kind", "mode", "words"),
    [
        ("zvd", "40Hz:0.1", ()),
        ("zvd", "1Hz:0.05", ("a.cfg: Klipper takes a duration of 0.001 to 0.2 s; this is one of 1.001 s",)),
        (
            "zv-d:9",
            "40Hz:0.1",
            ("a.cfg: Klipper takes amplitudes of 0.001 and more", "a.g: RepRapFirmware takes up to 5 impulses; these are 11"),
        ),
    ],
)
def test_what_firmware_refuses_is_told(kind: str, mode: str, words: tuple[str, ...], tmp_path: Path) -> None:
    done = run(kind, "--mode", mode, "--export", tmp_path / "a.cfg", "--export", tmp_path / "a.g", "--export", tmp_path / "a.h")
    assert done.exit_code == 0
    assert all(word in done.stdout for word in words)
    assert done.stdout.count("note: ") == len(words)
    assert (tmp_path / "a.cfg").exists()


@pytest.mark.parametrize(
    ("bands", "told"),
    [
        (("0.9:1.1@0.1", "1.5:2@0.1"), ["tolerance, 10 %", "band, 0.9 to 1.1", "band, 1.5 to 2"]),
        (("0.9:1.1@0.02", "1.5:2@0.1"), ["tolerance, 2 %", "tolerance, 10 %", "band, 0.9 to 1.1", "band, 1.5 to 2"]),
    ],
)
def test_a_picture_shades_every_band_and_no_gap(bands: tuple[str, str], told: list[str], tmp_path: Path) -> None:
    words = [word for band in bands for word in ("--band", band)]
    assert run("zvd", "--mode", "1Hz:0.05", *words, "--plot", tmp_path / "p.svg").exit_code == 0
    picture = (tmp_path / "p.svg").read_text()
    assert sorted(re.findall(r"(?:tolerance|band), [^<]*", picture)) == sorted(told)
