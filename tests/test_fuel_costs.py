"""`slewcert fuel --alpha`: a known node, a certificate that another process checks, options and studies refused."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from small_studies import SPRING_STUDY, small_study

from suite.cli import main

RIGID = """
[plant]
numerator = [1.0]
denominator = [1.0, 0.0, 0.0]
[maneuver]
displacement = 1.0
[limits]
input = [-1.0, 2.0]
"""


def run(folder: Path, *arguments: object, text: str = RIGID) -> Result:
    file = folder / "study.toml"
    file.write_text(text)
    return CliRunner().invoke(main, ["fuel", str(file), *(str(argument) for argument in arguments)], catch_exceptions=False)


def test_the_least_cost_of_a_mass_and_its_certificate_in_another_process(tmp_path: Path) -> None:
    result = run(tmp_path, "--alpha", 1, "--json", "--certificates", tmp_path / "proofs")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert record["status"] == "proved"
    assert record["cost"]["lower"] <= 11**0.5 * (1 + 1e-15)
    assert record["cost"]["upper"] >= 11**0.5 * (1 - 1e-15)
    assert record["cost"]["upper"] / record["cost"]["lower"] - 1.0 <= 1.1e-9
    assert record["maneuver_time"] + record["fuel"] == pytest.approx(record["cost"]["upper"], rel=1e-14)
    assert len(record["switch_times"]) == 2
    assert record["extremal"]
    assert record["extremal_prices"] == pytest.approx([1.0, 1.0], rel=1e-4)
    command = [sys.executable, "-m", "suite", "check", record["certificate"], "--json"]
    checked = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert checked["status"] == "proved"
    assert checked["price"] == "1"
    assert checked["maneuver_time"] is None
    differs = CliRunner().invoke(main, ["check", record["certificate"], "--study", str(tmp_path / "study.toml")])
    assert differs.exit_code == 1  # the study weighs no fuel
    assert "another price of fuel" in differs.output


@pytest.mark.slow
def test_text_says_the_bracket_the_check_and_the_command(tmp_path: Path) -> None:
    text = run(tmp_path, "--alpha", "1").stdout
    assert "least cost ∫(1 + 1·|u|) dt: [3.3166" in text
    assert "proved" in text
    assert "dead-zone check (maximum principle): passed" in text


@pytest.mark.parametrize(
    ("arguments", "more", "words"),
    [
        (("--alpha", 1, "--points", 200), "", "--points"),
        (("--alpha", 1, "--time", 8), "", "--time asks for one move, --alpha"),
        (("--alpha", 0), "", "more than 0"),
        (("--alpha", "dear"), "", "price of fuel"),
        (("--alpha", "nan"), "", "price of fuel"),
        (("--alpha", 1), "rate = [-1.0, 1.0]", "limits.rate"),
        (("--alpha", 1), "pulses = 2", "limits.pulses"),
        (("--alpha", 1), "[command]\ntype = 1", "command.type"),
        (("--alpha", 1), "[command]\ntail = true", "command.tail"),
    ],
)
def test_what_makes_no_sense_is_told(tmp_path: Path, arguments: tuple[object, ...], more: str, words: str) -> None:
    result = run(tmp_path, *arguments, text=SPRING_STUDY + f"\n{more}\n")
    assert result.exit_code == 2
    assert words in result.output


PRICED = "[command]\nalpha = 1.0\n"


@pytest.mark.slow
def test_a_study_with_a_price_is_bound_and_its_certificate_matches(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(RIGID + PRICED)
    proof = tmp_path / "proof.json"
    result = CliRunner().invoke(main, ["bound", str(file), "--json", "--certificate", str(proof)], catch_exceptions=False)
    record = json.loads(result.stdout)
    assert record["maneuver_time"]["upper"] == pytest.approx(3**0.5)  # the fastest: √(2Δ(a + b)/(ab))
    assert record["weighted"]["cost"]["lower"] <= 11**0.5 * (1 + 1e-15)
    assert record["weighted"]["cost"]["upper"] >= 11**0.5 * (1 - 1e-15)
    assert record["weighted"]["maneuver_time"] > record["maneuver_time"]["upper"]
    assert record["weighted"]["fuel"] < record["fuel"]
    cost = record["weighted"]["certificate"]
    assert cost == str(tmp_path / "proof.cost.json")
    for path in (str(proof), cost):
        assert CliRunner().invoke(main, ["check", path, "--study", str(file)]).exit_code == 0
    file.write_text(RIGID + PRICED.replace("1.0", "1.1"))
    assert CliRunner().invoke(main, ["check", cost, "--study", str(file)]).exit_code == 1
    text = CliRunner().invoke(main, ["bound", str(file)]).stdout
    assert "least cost ∫(1 + 1.1·|u|) dt" in text


@pytest.mark.slow
def test_a_study_with_a_price_runs_its_command_on_the_fmu(tmp_path: Path) -> None:
    file = small_study(tmp_path, PRICED, samples=0)
    folder = tmp_path / "out"
    done = CliRunner().invoke(main, ["verify", str(file), "--out", str(folder), "--json"], catch_exceptions=False)
    assert done.exit_code in (0, 1)
    found = json.loads((folder / "results.json").read_text())
    weighted = found["weighted"]
    assert found["command"] == weighted["command"]
    assert weighted["certificate"] == "certificate.cost.json"
    assert CliRunner().invoke(main, ["check", str(folder / "certificate.cost.json"), "--study", str(file)]).exit_code == 0
    assert CliRunner().invoke(main, ["review", str(folder)]).exit_code == 0
    node = 6.6936737286 + 4.5015815808  # T and U of the first node in closed form: a price of 1 s per N·s is above the critical one
    assert weighted["cost"]["upper"] == pytest.approx(node, rel=1e-7)
    assert weighted["cost"]["lower"] == pytest.approx(node, rel=1e-7)


@pytest.mark.parametrize(
    ("more", "path"),
    [
        ("fuel = 4.0\n[command]\nalpha = 0.5", "limits.fuel"),
        ("rate = [-1.0, 1.0]\n[command]\nalpha = 0.5", "limits.rate"),
        ("pulses = 2\n[command]\nalpha = 0.5", "limits.pulses"),
        ("sample_time = 0.1\n[command]\nalpha = 0.5", "limits.sample_time"),
        ("[command]\nalpha = 0.5\ntail = true", "command.tail"),
        ("[command]\nalpha = 0.5\ntype = 1", "command.type"),
        ('[command]\nalpha = 0.5\nkind = "fuel-efficient"', "command.kind"),
        ("[command]\nalpha = -0.5", "command.alpha"),
        ('[command]\nalpha = 0.5\nkind = "shaper"\nshaper = "zv"', "command.alpha"),
    ],
)
def test_what_a_price_does_not_go_with_is_told(tmp_path: Path, more: str, path: str) -> None:
    file = tmp_path / "study.toml"
    file.write_text(f"{SPRING_STUDY}{more}\n")
    result = CliRunner().invoke(main, ["bound", str(file)])
    assert result.exit_code == 2
    assert path in result.output
