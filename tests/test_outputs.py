"""Output options: what a command reads is never replaced, and a folder that is a file is refused before anything is computed."""

from __future__ import annotations

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


@pytest.mark.parametrize(("command", "option"), [("fuel", "--out"), ("fuel", "--certificates"), ("tradeoff", "--certificates")])
def test_a_folder_that_is_a_file_is_refused_at_once(study: Path, command: str, option: str) -> None:
    taken = study.parent / "taken"
    taken.write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(main, [command, str(study), option, str(taken)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "taken' is a file" in done.stderr
    assert taken.read_text(encoding="utf-8") == "mine"
