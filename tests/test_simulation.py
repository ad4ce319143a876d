"""`slewcert simulate`: one command on one FMU, measured, logged, refined."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from event_plants import build_event_plant
from fault_plants import build_fault

from relaxations.commands import Command, Segment, Tail, TailTerm
from reports import logs
from suite.cli import main
from suite.observations import observe

BANG = Command(2.0, (Segment(0.0, 1.0), Segment(1.0, -1.0)), Tail(0.0))
NAMES = ("--input", "force", "--output", "position_2")
X = ("--input", "u", "--output", "x")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["simulate", *map(str, arguments)], catch_exceptions=False)


def record(done: Result) -> dict:
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.fixture
def command(tmp_path: Path) -> Path:
    return write(tmp_path / "command.json", BANG)


def write(path: Path, command: Command) -> Path:
    path.write_text(json.dumps(command.to_dict()))
    return path


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
def test_measures_and_logs(interface: str, command: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    found = record(run("two_mass", command, *NAMES, "--interface", interface, "--log", log, "--stop", "20", "--step", "0.1", "--json"))
    assert (found["status"], found["interface"], found["log"]) == ("finished", interface, str(log))
    assert (found["step"], found["stop"], found["points"]) == (0.1, 20.0, 201)
    # Both masses together move by 1 m; the second swings about that with (cos - 2 cos + cos) / 4 of the three jumps, ω = √2.
    amplitude = abs(1.0 - 2.0 * np.exp(1j * np.sqrt(2.0)) + np.exp(2j * np.sqrt(2.0))) / 4.0
    swing = found["quantities"]["residual_vibration"]
    assert swing["value"] == pytest.approx(amplitude, abs=max(swing["error"], 1e-6))
    assert swing["error"] < 1e-4
    assert found["quantities"]["peak_input"] == {"value": 1.0, "error": 0.0}
    phase = np.sqrt(2.0) * (20.0 - np.array([0.0, 1.0, 2.0]))
    exact = 0.5 + (np.cos(phase) @ [1.0, -2.0, 1.0]) / 4.0
    final = found["quantities"]["final(position_2)"]
    assert final["value"] == pytest.approx(exact, abs=1e-8)
    assert final["error"] < 1e-7
    kept = logs.read_log(log)
    assert kept.run["interface"] == interface
    assert observe(kept).command == BANG
    reviewed = CliRunner().invoke(main, ["review", str(log)])
    assert (reviewed.exit_code, "confirmed" in reviewed.stdout) == (0, True)


def test_the_window_and_the_step_come_from_the_linear_plant(command: Path) -> None:
    found = record(run("two_mass", command, *NAMES, "--json"))
    period = 2.0 * np.pi / np.sqrt(2.0)
    assert found["stop"] == pytest.approx(2.0 + 20.0 * period)
    assert found["step"] == pytest.approx(period / 50.0)
    stiffer = record(run("two_mass", command, *NAMES, "--parameter", "stiffness=4", "--json"))
    assert stiffer["step"] == pytest.approx(found["step"] / 2.0)


@pytest.mark.slow
def test_convergence_shows_the_order(tmp_path: Path) -> None:
    """Holding a decaying input has an error of fourth order in the step; that of model exchange is in proportion to the tolerance."""
    tailed = write(tmp_path / "tail.json", Command(0.0, (), Tail(0.0, (TailTerm(-1.0 + 2.0j, 0, 1.0 + 0.0j),))))
    path = build_event_plant(tmp_path, "FUSSY", "3.0")
    asked = (path, tailed, *X, "--parameter", "g=4", "--stop", "4", "--step", "0.5", "--convergence", "--json")
    table = record(run(*asked))["convergence"]
    assert [row["step"] for row in table] == [0.5, 0.25, 0.125, 0.0625]
    assert table[0]["order"] is None
    assert [row["order"] for row in table[1:3]] == pytest.approx([4.0, 4.0], abs=0.3)
    assert {row["tolerance"] for row in table} == {None}
    table = record(run(*asked, "--interface", "model-exchange"))["convergence"]
    assert [row["tolerance"] for row in table] == pytest.approx([1e-7, 1e-8, 1e-9, 1e-10])
    assert all(row["order"] == pytest.approx(0.9, abs=0.5) for row in table[1:])
    shown = run(*asked[:-1])
    assert "change when refined" in shown.stdout
    assert "4.0" in shown.stdout


def test_a_jump_between_points_converges_at_once(command: Path) -> None:
    odd = run("two_mass", write(command, BANG.shifted(0.0123)), *NAMES, "--stop", "6", "--step", "0.5", "--convergence", "--json")
    assert max(row["change"] for row in record(odd)["convergence"]) < 1e-11
    assert {row["order"] for row in record(odd)["convergence"]} == {None}, "rounding has no order"


def test_an_fmu_without_a_linear_plant_is_measured_by_its_last_value(tmp_path: Path) -> None:
    path = build_event_plant(tmp_path, "STIFF", "3.0", "CoSimulation")
    step = write(tmp_path / "step.json", Command(1.0, (Segment(0.0, 1.0),), Tail(1.0)))
    found = record(run(path, step, *X, "--parameter", "g=5", "--stop", "10", "--step", "0.05", "--json"))
    assert found["quantities"]["final(x)"]["value"] == pytest.approx(1.0 - np.exp(-10.0), abs=1e-9)
    assert found["quantities"]["residual_vibration"]["value"] == pytest.approx(np.exp(-1.0) - np.exp(-10.0), abs=1e-9)


def test_an_fmu_with_one_step_size_is_run_on_its_grid(command: Path) -> None:
    fixed = build_fault("fixed_step")
    found = record(run(fixed, command, *NAMES, "--stop", "9.98", "--json"))
    assert (found["step"], found["stop"], found["points"]) == (0.05, 10.0, 201)
    assert 0.0 < found["quantities"]["residual_vibration"]["error"] < 1e-3
    for arguments, words in ((("--convergence",), "nothing to refine"), (("--step", "0.02"), "no multiple")):
        refused = run(fixed, command, *NAMES, *arguments)
        assert refused.exit_code == 2
        assert words in refused.stderr


@pytest.mark.parametrize("fault", ["segfault", "terminate", "nan"])
def test_an_fmu_that_fails_is_exit_code_3_with_the_log_as_far_as_it_got(fault: str, command: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    done = run(build_fault(fault), command, *NAMES, "--stop", "5", "--log", log, "--json")
    assert done.exit_code == 3
    found = json.loads(done.stdout)
    assert found["status"] in ("crashed", "terminated", "not_finite")
    assert found["quantities"] == {}
    kept = logs.read_log(log)
    assert kept.verdict == {"verdict": "error", "quantities": "{}"}
    assert 0.5 < kept.signal("/plant/output").times[-1] <= 1.0
    shown = run(build_fault(fault), command, *NAMES, "--stop", "5")
    assert shown.exit_code == 3
    assert found["detail"] in shown.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fmu": "two_mas"}, 'did you mean "two_mass"'),
        ({"driven": "forc"}, "did you mean 'force'"),
        ({"moved": "force"}, "not output"),
        ({"more": ("--parameter", "stiffness")}, "NAME=VALUE"),
        ({"more": ("--parameter", "stiffness=nan")}, "finite"),
        ({"more": ("--parameter", "stifness=1")}, "stiffness"),
        ({"more": ("--parameter", "stiffness=2 kg")}, "N/m"),
        ({"more": ("--parameter", "stiffness=1e999999999")}, "magnitude between"),
        ({"more": ("--parameter", "stifness=2 N/m")}, "did you mean 'stiffness'"),
        ({"fmu": "two_mas", "more": ("--parameter", "stiffness=2 N/m")}, 'did you mean "two_mass"'),
        ({"more": ("--step", "0")}, "--step"),
        ({"more": ("--step", "nan")}, "valid are numbers above 0"),
        ({"text": "{}"}, "slewcert-command/1"),
        ({"text": "\xff"}, "JSON"),
    ],
)
def test_bad_input_is_told_and_nothing_is_written(changes: dict, words: str, command: Path, tmp_path: Path) -> None:
    if "text" in changes:
        command.write_text(changes["text"])
    log = tmp_path / "run.mcap"
    names = ("--input", changes.get("driven", "force"), "--output", changes.get("moved", "position_2"))
    done = run(changes.get("fmu", "two_mass"), command, *names, "--log", log, *changes.get("more", ()))
    assert done.exit_code == 2
    assert words in done.stderr
    assert not log.exists()


def test_all_mistakes_at_once(command: Path) -> None:
    done = run("two_mass", command, "--input", "forc", "--output", "position_3")
    assert done.exit_code == 2
    assert "forc" in done.stderr
    assert "position_3" in done.stderr


def test_a_parameter_may_have_a_unit(command: Path) -> None:
    found = [run("two_mass", command, *NAMES, "--json", "--parameter", f"stiffness={value}") for value in ("0.5", "500 N/km", "2")]
    plain, converted, other = (json.loads(done.stdout)["quantities"] for done in found)
    assert plain == converted != other
