"""An FMU that fails, in whatever way: the run is an error that is named, nothing else is lost, and nothing passes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from fault_plants import FAULT_TIME, FAULTS, build_fault
from marks import slow
from small_studies import results, run_table, small_study

from fmus.stepping import Experiment, Outcome
from fmus.workers import Worker
from reports import logs
from suite import campaign
from suite.cli import main
from suite.loading import load_study
from suite.review import ReviewStatus, review
from suite.verdicts import Verdict
from suite.verification import verify


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


MESSAGES = {
    "abort": ("crashed", "SIGABRT"),
    "discard": ("discard", "Discard"),
    "error": ("error", "Error"),
    "fatal": ("fatal", "Fatal"),
    "hang": ("hung", "no answer within"),
    "leak": ("memory", "of the 256 MiB that it may have"),
    "nan": ("not_finite", "nan"),
    "quit": ("exited", "exit code"),
    "segfault": ("crashed", "SIGSEGV"),
    "terminate": ("terminated", ""),
    "warning": ("warning", "the warning that was asked for"),
}


def test_every_fault_is_known_here() -> None:
    assert set(FAULTS) - set(MESSAGES) == {"flood", "fill", "fixed_step"}, (
        "the first only prints, the second fills the disk, the third wants a grid"
    )


@pytest.mark.parametrize("fault", [fault if fault in ("leak", "segfault") else slow(fault) for fault in sorted(MESSAGES)])
def test_an_fmu_that_fails_is_an_error_that_names_the_run_and_no_pass(tmp_path: Path, fault: str) -> None:
    file = small_study(tmp_path, samples=2, fmu=str(build_fault(fault)))
    if fault == "hang":
        file.write_text(file.read_text().replace("timeout = 20", "timeout = 0.5"))
    if fault == "leak":
        file.write_text(file.read_text().replace("timeout = 20", "timeout = 20\nmemory = 256"))
    done = run("verify", file, "--out", tmp_path / "out", "--jobs", "2", "--json")
    assert done.exit_code == 3
    record = json.loads(done.stdout)
    assert record["verdict"] == "error"
    assert record["runs"] == {"total": 3, "passed": 0, "failed": 0, "errors": 3}
    assert [(entry["verdict"], entry["worst_run"], entry["value"]) for entry in record["requirements"]] == [
        ("error", "0000-nominal", None)
    ] * 2
    status, words = MESSAGES[fault]
    rows = run_table(tmp_path / "out")
    assert {(row["status"], row["verdict"]) for row in rows.values()} == {(status, "error")}
    for name, row in rows.items():
        assert words in row["detail"]
        assert f"run {name}: " in done.stderr
        log = logs.read_log(tmp_path / "out" / f"runs/{name}.mcap")
        assert log.verdict == {"verdict": "error", "quantities": "{}"}
        if fault != "warning":  # it reaches the end
            assert log.signal("/plant/output").times[-1] == pytest.approx(FAULT_TIME, abs=0.1), "as far as it got"
    cases = list(ElementTree.parse(tmp_path / "out" / "junit.xml").iter("testcase"))
    assert [[child.tag for child in case if child.tag in ("failure", "error")] for case in cases] == [["error"]] * 2
    assert "run 0000-nominal could not be finished" in results(tmp_path / "out")["requirements"][0]["reason"]
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED, "what is recorded is what happened"


def test_one_run_that_crashes_costs_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crashing = build_fault("segfault")

    class Treacherous(Worker):
        def run(self, experiment: Experiment, timeout: float) -> Outcome:
            bad = experiment.parameters["stiffness"] == pytest.approx(0.9)
            return super().run(replace(experiment, fmu=crashing) if bad else experiment, timeout)

    monkeypatch.setattr(campaign, "Worker", Treacherous)
    done = run("verify", small_study(tmp_path, samples=5), "--out", tmp_path / "out", "--jobs", "1")
    assert done.exit_code == 3
    verdicts = {name: row["verdict"] for name, row in run_table(tmp_path / "out").items()}
    assert verdicts == {"0000-nominal": "pass", "0001": "pass", "0002": "error", "0003": "pass", "0004": "pass"}
    assert "ERROR  RESIDUAL: run 0002 could not be finished: SIGSEGV" in done.stdout
    assert "5 in all, 4 passed, 0 failed, 1 in error" in done.stdout
    found = {entry["id"]: entry["verdict"] for entry in results(tmp_path / "out")["requirements"]}
    assert found == {"RESIDUAL": "error", "TIME": "pass"}, "TIME is about the nominal run only"


def test_a_fail_beside_an_error_is_a_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crashing = build_fault("segfault")

    class Treacherous(Worker):
        def run(self, experiment: Experiment, timeout: float) -> Outcome:
            return super().run(replace(experiment, fmu=crashing) if experiment.parameters["stiffness"] == 1.2 else experiment, timeout)

    monkeypatch.setattr(campaign, "Worker", Treacherous)
    done = run("verify", small_study(tmp_path, samples=2, limit=0.01), "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "run 0002 could not be finished: SIGSEGV" in done.stdout


def test_an_error_that_no_requirement_looks_at_is_one_still(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crashing = build_fault("segfault")

    class Treacherous(Worker):
        def run(self, experiment: Experiment, timeout: float) -> Outcome:
            return super().run(replace(experiment, fmu=crashing) if experiment.parameters["stiffness"] == 1.2 else experiment, timeout)

    monkeypatch.setattr(campaign, "Worker", Treacherous)
    file = small_study(tmp_path, samples=2)
    file.write_text(file.read_text().replace("max = 0.5", 'max = 0.5\nscope = "nominal"'))
    done = verify(load_study(file), tmp_path / "out")
    assert done.verdict is Verdict.ERROR
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED
