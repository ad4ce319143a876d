"""`slewcert fuel --time`: known digits both ways, certificates that say so, times that are too short, options and studies refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from small_studies import SPRING_STUDY

from relaxations.checking.claims import Outcome, check
from suite.cli import main


def run(folder: Path, *arguments: object, more: str = "") -> Result:
    file = folder / "study.toml"
    file.write_text(f"{SPRING_STUDY}fuel = 1.0\n{more}\n")
    return CliRunner().invoke(main, ["fuel", str(file), *(str(argument) for argument in arguments)], catch_exceptions=False)


def test_the_least_fuel_at_a_minimum_time_is_its_budget(tmp_path: Path) -> None:
    result = run(tmp_path, "--time", 8.1107317945, "--json", "--certificates", tmp_path / "proofs")  # within a budget of 4; of 1 it is not
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert record["status"] == "proved"
    lower, upper = record["least_fuel"]["lower"], record["least_fuel"]["upper"]
    assert lower <= 4.0 + 2e-10  # ten digits of the time are given
    assert upper >= 4.0 - 2e-10
    assert upper - lower <= 2e-8
    assert record["fuel"] <= upper * (1 + 1e-12)  # summed in doubles, switch by switch; the certificate has it exactly
    assert all(check(Path(file).read_bytes()).outcome is Outcome.PROVED for file in record["certificates"])
    assert len(record["certificates"]) == 2
    assert record["command"] is not None


def test_too_short_a_time_is_impossible_and_says_the_least(tmp_path: Path) -> None:
    result = run(tmp_path, "--time", 6)
    assert result.exit_code == 1
    assert "impossible" in result.stdout
    assert "the minimum time is at least 6.66" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "more", "words"),
    [
        (("--time", 8, "--points", 200), "", "--points"),
        (("--time", 8, "--from", 1, "--no-held"), "", "--from, --held"),
        (("--time", 0), "", "more than 0"),
        (("--time", "nan"), "", "more than 0"),
        (("--time", 8), "rate = [-1.0, 1.0]", "limits.rate"),
        (("--time", 8), "sample_time = 0.1", "limits.sample_time"),
        (("--time", 8), "[command]\ntail = true", "command.tail"),
    ],
)
def test_what_makes_no_sense_is_told(tmp_path: Path, arguments: tuple[object, ...], more: str, words: str) -> None:
    result = run(tmp_path, *arguments, more=more)
    assert result.exit_code == 2
    assert words in result.output
