"""Studies that hold the form of pulses one way, then the other: what they mean, what they do not go with, what is printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from suite.cli import main

STUDY = """
[plant]
numerator = [1.0]
denominator = [{denominator}]
[maneuver]
displacement = 5.0
[limits]
input = [-1.0, 1.0]
{limits}
[command]
{command}
"""
SPRING = "1.0, 0.0, 2.0, 0.0, 0.0"


def bound(tmp_path: Path, command: str, limits: str = "", denominator: str = SPRING, more: str = "", code: int = 0) -> str:
    file = tmp_path / "study.toml"
    file.write_text(STUDY.format(command=command, limits=limits, denominator=denominator) + more)
    result = CliRunner().invoke(main, ["bound", str(file), "--json", "--certificate", str(tmp_path / "proof.json")])
    assert result.exit_code == code, result.output
    return result.stdout if code == 0 else result.output


@pytest.mark.slow
def test_a_fuel_efficient_command_says_what_its_form_costs(tmp_path: Path) -> None:
    record = json.loads(bound(tmp_path, 'kind = "fuel-efficient"\nrobustness = 1'))
    assert record["status"] == "proved"
    assert record["maneuver_time"]["lower"] <= 7.7210011332 <= record["maneuver_time"]["upper"] + 1e-9
    assert record["free"]["lower"] <= 7.6653904418 <= record["free"]["upper"] + 1e-9
    assert record["fuel"] == pytest.approx(5.3497460, abs=1e-6)
    levels = [segment["level"] for segment in record["command"]["segments"]]
    assert levels == [1.0, 0.0, 1.0, -1.0, 0.0, -1.0]
    checked = CliRunner().invoke(main, ["check", str(tmp_path / "proof.json"), "--study", str(tmp_path / "study.toml")])
    assert checked.exit_code == 0
    assert "The claim is about inputs of this form alone." in checked.output


@pytest.mark.slow
def test_a_study_of_any_form_is_another_study(tmp_path: Path) -> None:
    bound(tmp_path, 'kind = "fuel-efficient"\nrobustness = 1')
    (tmp_path / "study.toml").write_text(STUDY.format(command="robustness = 1", limits="", denominator=SPRING))
    checked = CliRunner().invoke(main, ["check", str(tmp_path / "proof.json"), "--study", str(tmp_path / "study.toml")])
    assert checked.exit_code == 1
    assert "differs" in checked.output


def test_a_form_within_a_budget_and_with_few_pulses(tmp_path: Path) -> None:
    record = json.loads(bound(tmp_path, "type = 1", "fuel = 4.0\npulses = 4"))
    assert record["maneuver_time"]["lower"] <= 8.1107317945 + 1e-9
    assert record["maneuver_time"]["upper"] >= 8.1107317945 - 1e-9
    assert record["status"] == "proved"


REFUSED = {
    "command.type": ('kind = "fuel-efficient"\ntype = 2', "", "", "which is type 1"),
    "limits.fuel": ('kind = "fuel-efficient"', "fuel = 4.0", "", "without a budget"),
    "limits.sample_time": ("type = 1", "sample_time = 0.1", "", "at any instants"),
    "limits.rate": ("type = 1", "rate = [-1.0, 1.0]", "", "at any instants"),
    "limits.deflection": ("type = 1", "deflection = { output_rate = 1.0 }", "", "at any instants"),
    "command.tail": ("type = 1\ntail = true", "", "", "state rest"),
    "command.kind": ('kind = "fuel-efficient"\nalpha = 0.1', "", "", "any form"),
    "limits.pulses": ("type = 1", "pulses = 1", "", "takes 2 pulses"),
}


@pytest.mark.parametrize("path", REFUSED)
def test_what_a_form_does_not_go_with_is_refused(tmp_path: Path, path: str) -> None:
    command, limits, more, word = REFUSED[path]
    told = bound(tmp_path, command, limits, more=more, code=2)
    assert path in told
    assert word in told


@pytest.mark.parametrize(("denominator", "word"), [("8.0, 0.0, 0.1", "rigid-body mode"), ("1.0, 0.0, 0.0, 0.0", "3 integrators")])
def test_plants_that_the_form_cannot_move_are_refused(tmp_path: Path, denominator: str, word: str) -> None:
    for key, place in (("type = 1", "command.type"), ('kind = "fuel-efficient"', "command.kind")):
        told = bound(tmp_path, key, denominator=denominator, code=2)
        assert place in told
        assert word in told.replace("\n", " ")
