"""Studies whose runs are no plain co-simulation: by model exchange, and on the grid of an FMU with one step size."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from event_plants import build_event_plant
from fault_plants import build_fault
from small_studies import KEEP_ALL, results, run_table, small_study

from relaxations.commands import Command, Segment, Tail
from reports import logs
from suite.cli import main
from suite.loading import load_study
from suite.observations import observe

STEP = 0.05  # s; of the plant `fixed_step`


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


def change(file: Path, old: str, new: str) -> Path:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return file


def by(interface: str) -> tuple[str, str]:
    return "[simulation]", f'[simulation]\ninterface = "{interface}"'


@pytest.fixture(scope="module")
def on_a_grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grid")
    done = run("verify", small_study(folder, KEEP_ALL, fmu=str(build_fault("fixed_step"))), "--out", folder / "out")
    assert done.exit_code == 0, done.output
    (folder / "printed").write_text(done.stdout)
    return folder


@pytest.mark.slow
def test_the_design_is_on_the_grid_before_anything_runs_and_says_what_that_costs(on_a_grid: Path) -> None:
    found = results(on_a_grid / "out")
    assert found["grid"]["step"] == STEP
    assert found["grid"]["samples"] == 134
    assert found["grid"]["maneuver_time"] == {"lower": pytest.approx(6.7, rel=1e-15), "upper": pytest.approx(6.7, rel=1e-15)}
    assert run("check", on_a_grid / "out" / found["grid"]["certificate"]).exit_code == 0
    assert found["bound"]["status"] == "proved", "the bracket is that of commands that switch at any instant"
    assert found["bound"]["maneuver_time"]["upper"] == pytest.approx(6.66272842)
    command = Command.from_dict(found["command"])
    assert command.maneuver_time == pytest.approx(6.7)
    for point in command.breakpoints:
        assert point / STEP == pytest.approx(round(point / STEP), abs=1e-9)
    words = "takes 6.7 s, 0.0373 s (0.56%) more than the lower bound. That no command of fewer than 134 samples does is proven."
    assert any(words in note for note in found["notes"])
    assert words in (on_a_grid / "printed").read_text()
    assert words in (on_a_grid / "out" / "report.html").read_text()


@pytest.mark.slow
def test_runs_on_the_grid_have_points_there_only_and_measured_errors(on_a_grid: Path) -> None:
    rows = run_table(on_a_grid / "out")
    assert {row["status"] for row in rows.values()} == {"finished"}
    for row in rows.values():
        times = observe(logs.read_log(on_a_grid / "out" / row["log"])).times
        assert times.tolist() == [n * STEP for n in range(len(times))]
    nominal = rows["0000-nominal"]["quantities"]
    assert nominal["final_error"]["value"] < 1e-9, "the command on the grid lands"
    assert 0.0 < rows["0001"]["quantities"]["residual_vibration"]["error"] < 1e-5
    assert run("review", on_a_grid / "out").exit_code == 0
    assert run("check", on_a_grid / "out").exit_code == 0


@pytest.mark.slow
def test_model_exchange_verifies_what_co_simulation_does(tmp_path: Path) -> None:
    values = {}
    for interface in ("co-simulation", "model-exchange"):
        file = change(small_study(tmp_path, KEEP_ALL, samples=2, name=f"{interface}.toml"), *by(interface))
        done = run("verify", file, "--out", tmp_path / interface)
        assert done.exit_code == 0, done.output
        assert results(tmp_path / interface)["simulation"]["interface"] == interface
        assert f"<dd>{interface}, communication step" in (tmp_path / interface / "report.html").read_text()
        rows = run_table(tmp_path / interface)
        assert {logs.read_log(tmp_path / interface / row["log"]).run["interface"] for row in rows.values()} == {interface}
        values[interface] = {name: row["quantities"] for name, row in rows.items()}
        assert run("review", tmp_path / interface).exit_code == 0
    for name, quantities in values["co-simulation"].items():
        for quantity, exact in quantities.items():
            other = values["model-exchange"][name][quantity]
            # An error of the integrator, 1e-8 of the move over these two periods at most, and the sampling's, which both have.
            assert other["value"] == pytest.approx(exact["value"], abs=exact["error"] + other["error"] + 1e-8), quantity
            assert other["error"] < 1e-3


REFUSED = {
    "a step that is none": (("[simulation]", "[simulation]\nstep = 0.02"), "simulation.step", "no multiple of it"),
    "a tail": (("[simulation]", "[command]\ntail = true\n[simulation]"), "command", "needs an input that decays"),
    "a late start": (("[simulation]", "[command]\nstart = 0.32\n[simulation]"), "command.start", "changes at 0.32 s"),
    "a file": (('[simulation]', '[command]\nkind = "file"\nfile = "command.json"\n[simulation]'), "command.file", "changes at 1.03 s"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_the_grid_is_refused_before_anything_is_written(case: str, tmp_path: Path) -> None:
    replacement, place, words = REFUSED[case]
    off = Command(2.0, (Segment(0.0, 1.0), Segment(1.03, -1.0)), Tail(0.0))
    (tmp_path / "command.json").write_text(json.dumps(off.to_dict()))
    fmu = build_fault("fixed_step")
    file = change(small_study(tmp_path, samples=0, fmu=str(fmu)), *replacement)
    if case == "a tail":  # of this plant's first mass, whose zeros do not decay; of a damped one they do
        change(file, 'output = "position_2"', 'output = "position_1"\nparameters = { damping = 0.3 }')
    done = run("verify", file, "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert place in done.stderr
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_file_on_the_grid_is_run(tmp_path: Path) -> None:
    aligned = Command(2.0, (Segment(0.0, 1.0), Segment(1.05, -1.0)), Tail(0.0))
    (tmp_path / "command.json").write_text(json.dumps(aligned.to_dict()))
    file = small_study(tmp_path, samples=0, fmu=str(build_fault("fixed_step")), limit=9.0)
    change(file, "[simulation]", '[command]\nkind = "file"\nfile = "command.json"\n[simulation]')
    assert run("verify", file, "--out", tmp_path / "out").exit_code == 0
    assert results(tmp_path / "out")["grid"] is None


def oscillator(folder: Path, fmu: Path, *more: str) -> Path:
    """A study of x'' = u - 4 x that begins at rest."""
    lines = [f'[plant]\nfmu = "{fmu}"\ninput = "u"\noutput = "x"\nparameters = {{ g = 4 }}', "[maneuver]\ndisplacement = 0.2"]
    lines += ["[limits]\ninput = [-1, 1]", '[[requirement]]\nid = "R"\nquantity = "residual_vibration"\nmax = 0.01', *more]
    file = folder / "study.toml"
    file.write_text("\n".join(lines))
    return file


@pytest.mark.slow
def test_an_fmu_that_does_not_name_its_step_needs_one(tmp_path: Path) -> None:
    fmu = build_event_plant(tmp_path, "FUSSY", "3.0", canHandleVariableCommunicationStepSize="false")
    done = run("verify", oscillator(tmp_path, fmu), "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "does not say of which: give a step" in done.stderr
    done = run("verify", oscillator(tmp_path, fmu, "[simulation]\nstep = 0.1"), "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert results(tmp_path / "out")["grid"]["step"] == 0.1


@pytest.mark.slow
def test_an_fmu_for_model_exchange_only_is_verified(tmp_path: Path) -> None:
    fmu = build_event_plant(tmp_path, "FUSSY", "2.0", "ModelExchange")
    done = run("verify", oscillator(tmp_path, fmu), "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert results(tmp_path / "out")["simulation"]["interface"] == "model-exchange"


def test_an_interface_that_is_not_offered_is_a_mistake(tmp_path: Path) -> None:
    fmu = build_event_plant(tmp_path, "FUSSY", "2.0", "ModelExchange")
    done = run("verify", oscillator(tmp_path, fmu, '[simulation]\ninterface = "co-simulation"'))
    assert done.exit_code == 2
    assert 'simulation.interface = "co-simulation": is not offered by the FMU; valid is "model-exchange"' in done.stderr
    file = change(small_study(tmp_path), *by("modelexchange"))
    with pytest.raises(Exception, match="did you mean"):
        load_study(file)
