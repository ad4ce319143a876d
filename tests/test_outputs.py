"""Output options: what a command reads is never replaced, and what cannot be written is refused before anything is computed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from suite.cli import main

STUDY = (
    "[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n[maneuver]\ndisplacement = 1\n"
    '[limits]\ninput = [-1, 1]\n[command]\nfile = "u.json"\n'
)
OPTIONS = [
    ("bound", "--certificate"),
    ("verify", "--out"),
    ("compare", "--out"),
    ("prefilter", "--save"),
    ("prefilter", "--plot"),
    ("tradeoff", "--plot"),
    ("tradeoff", "--certificates"),
    ("fuel", "--plot"),
    ("fuel", "--out"),
    ("fuel", "--certificates"),
    ("timing", "--plot"),
]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "one.toml"
    file.write_text(STUDY, encoding="utf-8")
    (tmp_path / "u.json").write_text("{}", encoding="utf-8")
    return file


@pytest.mark.parametrize(("command", "option"), OPTIONS)
@pytest.mark.parametrize("name", ["one.toml", "u.json", "link.svg"])
def test_what_is_read_is_not_replaced(study: Path, command: str, option: str, name: str) -> None:
    (study.parent / "link.svg").symlink_to(study)
    before = {path.name: path.read_bytes() for path in study.parent.iterdir()}
    done = CliRunner().invoke(main, [command, str(study), option, str(study.parent / name)], catch_exceptions=False)
    assert done.exit_code == 2
    assert option in done.stderr
    assert {path.name: path.read_bytes() for path in study.parent.iterdir()} == before


@pytest.mark.parametrize("option", ["--table", "--export"])
def test_several_values_are_all_looked_at(study: Path, option: str) -> None:
    if option == "--table":
        words = ["table", str(study), "--displacements", "1:2:2", "--export", str(study.parent / "a.h"), "--export", str(study)]
    else:
        words = ["shaper", "custom", "--impulses", str(study.parent / "u.json"), "--save", str(study.parent / "u.json")]
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 2
    assert "would overwrite a file that the command reads" in done.stderr


def test_another_file_that_exists_is_replaced(study: Path) -> None:
    kept = study.parent / "proof.json"
    kept.write_text("old", encoding="utf-8")
    study.write_text(STUDY.replace('[command]\nfile = "u.json"\n', ""), encoding="utf-8")
    done = CliRunner().invoke(main, ["bound", str(study), "--certificate", str(kept)], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    assert kept.read_text(encoding="utf-8").startswith("{")


@pytest.mark.parametrize(
    "words",
    [
        ("bound", "STUDY", "--certificate", "FOLDER"),
        ("table", "STUDY", "--displacements", "1:2:2", "--export", "FOLDER"),
        ("shaper", "zv", "--mode", "1Hz:0.1", "--export", "FOLDER"),
        ("shaper", "zv", "--mode", "1Hz:0.1", "--move", "1", "--input", "-1:1", "--command", "FOLDER"),
        ("shaper", "zv", "--mode", "1Hz:0.1", "--move", "1", "--input", "-1:1", "--certificate", "FOLDER"),
    ],
)
def test_a_folder_in_place_of_a_file_is_refused_before_anything(study: Path, words: tuple[str, ...]) -> None:
    folder = study.parent / "taken.cfg"
    folder.mkdir()
    named = [str({"STUDY": study, "FOLDER": folder}.get(word, word)) for word in words]
    done = CliRunner().invoke(main, named, catch_exceptions=False)
    assert done.exit_code == 2
    assert words[-2] in done.stderr
    assert "is a folder" in done.stderr or "is a directory" in done.stderr
    assert not any(folder.iterdir())


def test_the_proofs_of_several_studies_go_into_a_folder(study: Path) -> None:
    taken = study.parent / "taken"
    taken.write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(main, ["bound", str(study), str(study), "--certificate", str(taken)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "into a folder" in done.stderr
    assert taken.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("command", "option"),
    [("fuel", "--out"), ("fuel", "--certificates"), ("tradeoff", "--certificates"), ("compare", "--out"), ("verify", "--out")],
)
def test_a_folder_that_is_a_file_is_refused_at_once(study: Path, command: str, option: str) -> None:
    taken = study.parent / "taken"
    taken.write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(main, [command, str(study), option, str(taken)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "taken' is a file" in done.stderr
    assert taken.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_what_cannot_be_written_is_told_before_anything_is_computed(study: Path, command: str, option: str) -> None:
    (study.parent / "taken").write_text("mine", encoding="utf-8")
    (study.parent / "nowhere").symlink_to(study.parent / "absent")
    for name, why in (
        ("taken/deep/x.svg", "taken is not a folder"),
        ("nowhere/x.svg", "nowhere is not a folder"),
        ("a" * 300 + "/x.svg", "File name too long"),
    ):
        before = sorted(study.parent.iterdir())
        done = CliRunner().invoke(main, [command, str(study), option, str(study.parent / name)], catch_exceptions=False)
        assert done.exit_code == 2
        assert option in done.stderr
        assert why in done.stderr
        assert sorted(study.parent.iterdir()) == before


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_a_folder_without_permission_is_told_at_once(study: Path, command: str, option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*, dir: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(dir))

    monkeypatch.setattr("suite.outputs.tempfile.TemporaryFile", refused)
    done = CliRunner().invoke(main, [command, str(study), option, str(study.parent / "new" / "x.svg")], catch_exceptions=False)
    assert done.exit_code == 2
    assert "cannot be written (Permission denied)" in done.stderr
    assert not (study.parent / "new").exists()


def test_a_device_is_not_replaced(study: Path) -> None:
    pipe = study.parent / "pipe.svg"
    os.mkfifo(pipe)
    done = CliRunner().invoke(main, ["fuel", str(study), "--plot", str(pipe)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "neither a file nor a folder" in done.stderr
    assert pipe.is_fifo()


@pytest.mark.parametrize(("command", "option"), [one for one in OPTIONS if one[1] in ("--plot", "--save")])
def test_a_file_that_is_a_folder_is_refused_at_once(study: Path, command: str, option: str) -> None:
    done = CliRunner().invoke(main, [command, str(study), option, str(study.parent)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "is a directory" in done.stderr
