"""Comparisons: several shapers of one study, folders that are there, and what cannot be compared."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from small_studies import small_study

from suite.cli import main


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["compare", *map(str, words)], catch_exceptions=False)


def study(folder: Path, *more: str, name: str = "study.toml") -> Path:
    return small_study(folder, "[command]", *more, limit=0.05, name=name)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("compared")
    file = study(folder, 'kind = "shaper"', 'shaper = "zv"  # as it is')
    done = run(file, "--shaper", "none", "--shaper", "zv", "--shaper", "zvd", "--out", folder / "out", "--json")
    assert done.exit_code == 0, done.stderr
    return folder / "out", json.loads(done.stdout)


def test_every_shaper_has_its_evidence_and_its_row(made: tuple[Path, dict[str, Any]]):
    out, record = made
    assert [row["name"] for row in record["commands"]] == ["none", "zv", "zvd"]
    residuals = [row["worst"]["residual_vibration"] for row in record["commands"]]
    assert residuals == sorted(residuals, reverse=True)
    times = [row["maneuver_time"] for row in record["commands"]]
    assert times == sorted(times)
    assert record["commands"][0]["over_lower_bound"] < 0.0 < record["commands"][1]["over_lower_bound"]
    assert {row["requirements"]["RESIDUAL"]["verdict"] for row in record["commands"][:1]} == {"fail"}
    for row in record["commands"]:
        results = json.loads((out / row["evidence"] / "results.json").read_bytes())
        assert results["shaper"]["kind"] == row["name"]
        assert results["command"]["maneuver_time"] == row["maneuver_time"]
        assert f'shaper = "{row["name"]}"  # as it is' in (out / row["evidence"] / "study.toml").read_text()
        reviewed = CliRunner().invoke(main, ["review", str(out / row["evidence"])])
        assert reviewed.exit_code == 0, reviewed.output
    assert json.loads((out / "comparison.json").read_bytes()) == record
    page = (out / "comparison.html").read_text()
    for words in (
        "Comparison of 3 commands",
        "Residual vibration over stiffness",
        "Commands and responses of the nominal plant",
        "Least duration",
    ):
        assert words in page
    assert "<script" not in page


@pytest.mark.slow
def test_folders_are_compared_as_they_are(made: tuple[Path, dict[str, Any]], tmp_path: Path):
    out, record = made
    fastest = study(tmp_path, name="fastest.toml")
    done = run(fastest, out / "zvd", "--out", tmp_path / "both")
    assert done.exit_code == 0, done.stderr
    assert "fastest" in done.stdout
    assert "zvd" in done.stdout
    again = json.loads((tmp_path / "both" / "comparison.json").read_bytes())
    assert again["commands"][1]["maneuver_time"] == record["commands"][2]["maneuver_time"]
    assert again["commands"][0]["over_lower_bound"] == pytest.approx(0.0, abs=1e-12)


def test_what_cannot_be_compared_is_told(made: tuple[Path, dict[str, Any]], tmp_path: Path):
    out, _ = made
    file = study(tmp_path, 'kind = "shaper"', 'shaper = "zv"')
    other = study(tmp_path, name="other.toml")
    text = other.read_text()
    other.write_text(text.replace("displacement = 5.0", "displacement = 1.0"))
    for words, told in (
        ((file,), "at least two commands"),
        ((file, "--shaper", "zv", "--shaper", "zvf"), "there is no shaper 'zvf'"),
        ((other, "--shaper", "zv", "--shaper", "zvd"), 'must be "shaper" to vary it'),
        ((out / "zv", out / "zv"), "two of the same name"),
        ((out / "zv", other), "about another displacement"),
        ((out / "zv", tmp_path), "is no evidence folder"),
        ((out / "zv", out / "zvd", "--shaper", "zv"), "no study is given"),
    ):
        done = run(*words, "--out", tmp_path / "refused", "--force")
        assert done.exit_code == 2, words
        assert told in done.stderr, done.stderr
    (out / "none" / "junit.xml").write_text("changed")
    done = run(out / "zv", out / "none", "--out", tmp_path / "refused")
    assert done.exit_code == 2
    assert "is not as it was written: junit.xml" in done.stderr


def test_other_tasks_are_told_before_anything_is_run(tmp_path: Path):
    for name, displacement in (("near", "5.0"), ("far", "6.0")):
        file = study(tmp_path, name=f"{name}.toml")
        file.write_text(file.read_text().replace("displacement = 5.0", f"displacement = {displacement}"))
    refused = run(tmp_path / "near.toml", tmp_path / "far.toml", "--out", tmp_path / "out")
    assert refused.exit_code == 2
    assert "near and far are about another displacement: 5.0 and 6.0" in refused.stderr
    assert not (tmp_path / "out").exists()
