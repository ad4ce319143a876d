"""The main job: verdicts and exit codes of whole studies, what an FMU that fails leaves behind, and what may become of a folder."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from marks import slow
from small_studies import KEEP_ALL, SHIPPED, digests, results, run_table, small_study

from reports import logs, manifest
from suite.cli import main
from suite.errors import StudyError
from suite.loading import load_study
from suite.review import ReviewStatus, review
from suite.verification import MOST_POINTS, verify


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


# The shipped pair


def test_the_shipped_study_passes(verified: Path) -> None:
    found = results(verified)
    assert found["verdict"] == "pass"
    assert {requirement["verdict"] for requirement in found["requirements"]} == {"pass"}
    assert found["runs"] == {"total": 11, "passed": 11, "failed": 0, "errors": 0}
    residual = found["requirements"][0]
    assert (residual["id"], residual["worst_run"]) == ("SLEW-001", "0001")
    assert run_table(verified)["0001"]["parameters"] == {"stiffness": 0.7}
    assert 0.0498 < residual["value"] < 0.0499 + 1e-6, "the fastest command uses what its tolerance, 0.0499, allows"
    assert residual["margin"] == pytest.approx(0.05 - residual["value"], abs=1e-15)


def test_its_twin_differs_in_the_robustness_alone() -> None:
    lines = [(SHIPPED / name).read_text().splitlines() for name in ("two_mass.toml", "two_mass_fail.toml")]
    assert [pair for pair in zip(*lines, strict=True) if pair[0] != pair[1]] == [('robustness = "box"', "robustness = 0")]


def test_its_twin_fails_and_says_what_by_how_much_and_where(tmp_path: Path) -> None:
    done = run("verify", SHIPPED / "two_mass_fail.toml", "--out", tmp_path / "out", "--jobs", "2")
    assert done.exit_code == 1
    (failed,) = [entry for entry in results(tmp_path / "out")["requirements"] if entry["verdict"] != "pass"]
    assert (failed["id"], failed["verdict"], failed["worst_run"]) == ("SLEW-001", "fail", "0001")
    assert failed["value"] == pytest.approx(0.1394, rel=1e-3)
    sentence = "SLEW-001: residual_vibration is 0.139429 in run 0001, 0.0894 beyond the limit 0.05"
    assert failed["reason"] == sentence.removeprefix("SLEW-001: ")
    assert f"FAIL  {sentence}" in done.stdout
    assert "verdict: FAIL" in done.stdout
    assert str(tmp_path / "out" / "report.html") in done.stdout.replace("\n", "")
    assert results(tmp_path / "out")["runs"] == {"total": 11, "passed": 6, "failed": 5, "errors": 0}


# The evidence folder


def test_the_evidence_folder_is_complete(verified: Path) -> None:
    names = [f"runs/{name}.mcap" for name in run_table(verified)]
    expected = {*names, "runs/layout.json", "results.json", "report.html", "junit.xml", "study.toml", "ledger.sqlite", "manifest.json"}
    expected |= {"certificate.json", "plant/modelDescription.xml", "plant/twin.toml", "plant/hashes.json"}
    assert set(digests(verified)) == expected
    assert {status.status for status in manifest.check_manifest(verified)} == {manifest.FileState.OK}
    assert (verified / "study.toml").read_bytes() == (SHIPPED / "two_mass.toml").read_bytes()


def test_every_log_tells_what_the_table_tells(verified: Path) -> None:
    for name, row in run_table(verified).items():
        assert row["log"] == f"runs/{name}.mcap"
        assert hashlib.sha256((verified / row["log"]).read_bytes()).hexdigest() == row["sha256"]
        log = logs.read_log(verified / row["log"])
        assert log.verdict is not None
        assert (log.run["run"], log.run["status"], log.verdict["verdict"]) == (name, row["status"], row["verdict"])
        assert {"maneuver_time", "slowest_period", "step"} <= log.run.keys()
        assert {"study.toml", "modelDescription.xml", "command.json"} <= log.attachments.keys()
        topics = {signal.topic for signal in log.signals}
        assert log.signal("/plant/output").variables == ("position_2", "position_1", "spring"), "the controlled one first"
        assert set(log.signal("/plant/state").variables) == {"position_1", "position_2", "velocity_1", "velocity_2"}
        assert topics == {"/command/u", "/plant/input", "/plant/output", "/plant/state", "/linear/output", "/limits"}
        recorded = json.loads(log.verdict["quantities"])
        assert {quantity: entry["value"] for quantity, entry in row["quantities"].items()} == {
            quantity: entry["value"] for quantity, entry in recorded.items()
        }


def test_the_report_needs_no_network(verified: Path) -> None:
    page = (verified / "report.html").read_text(encoding="utf-8")
    assert "SLEW-001" in page
    assert page.count("<svg") >= 4
    assert not [mark for mark in ('src="http', 'href="http', "url(http", "@import") if mark in page]


def test_junit_has_a_case_for_each_requirement(verified: Path) -> None:
    cases = list(ElementTree.parse(verified / "junit.xml").iter("testcase"))
    assert [case.get("name") or "" for case in cases] == [entry["id"] for entry in results(verified)["requirements"]]
    assert not [child for case in cases for child in case if child.tag in ("failure", "error", "skipped")]


@pytest.mark.slow
@pytest.mark.parametrize("fmu", ["two_mass.fmi2", slow("two_mass.fmi3")])  # the latter is what `two_mass` means
def test_fmi_2_and_3_of_the_plant_give_the_same_results(tmp_path: Path, fmu: str, verified: Path) -> None:
    text = (SHIPPED / "two_mass.toml").read_text().replace('fmu = "two_mass"', f'fmu = "{fmu}"')
    file = tmp_path / "study.toml"
    file.write_text(text)
    verify(load_study(file), tmp_path / "out", jobs=2)
    for name, row in run_table(verified).items():
        for quantity, entry in row["quantities"].items():
            again = run_table(tmp_path / "out")[name]["quantities"][quantity]["value"]
            # The command has steps only, so both hold the same input; 1e-9 of the move is what FMU and linear plant agree to.
            assert again == pytest.approx(entry["value"], rel=1e-9, abs=1e-9), (name, quantity)


# Undecided


@pytest.mark.slow
def test_a_limit_within_the_numerical_error_is_undecided(tmp_path: Path) -> None:
    step = "[simulation]\nstep = 0.4"
    first = small_study(tmp_path, samples=2)
    first.write_text(first.read_text().replace("[simulation]", step))
    verify(load_study(first), tmp_path / "first")
    value = next(entry for entry in results(tmp_path / "first")["requirements"] if entry["id"] == "RESIDUAL")
    assert value["error"] > 1e-6, "the step is coarse on purpose"
    second = small_study(tmp_path, samples=2, limit=value["value"] + value["error"] / 2, name="second.toml")
    second.write_text(second.read_text().replace("[simulation]", step))
    done = run("verify", second, "--out", tmp_path / "second")
    assert done.exit_code == 3
    assert "UNDECIDED  RESIDUAL: " in done.stdout
    assert "within its numerical error" in done.stdout
    assert "verdict: UNDECIDED" in done.stdout
    assert review(tmp_path / "second").status is ReviewStatus.CONFIRMED


# Which logs are kept


@pytest.mark.slow
def test_by_default_the_nominal_log_and_the_worst_are_kept(tmp_path: Path) -> None:
    verify(load_study(small_study(tmp_path, samples=5)), tmp_path / "out")
    worst = next(entry["worst_run"] for entry in results(tmp_path / "out")["requirements"] if entry["id"] == "RESIDUAL")
    kept = {Path(path).stem for path in digests(tmp_path / "out", "runs/*.mcap")}
    assert kept == {"0000-nominal", worst}
    assert {name for name, row in run_table(tmp_path / "out").items() if row["log"]} == kept
    done = review(tmp_path / "out")
    assert done.status is ReviewStatus.CONFIRMED


@pytest.mark.slow
def test_every_log_of_a_run_that_did_not_pass_is_kept(tmp_path: Path) -> None:
    verify(load_study(small_study(tmp_path, samples=5, limit=0.05)), tmp_path / "out")
    rows = run_table(tmp_path / "out")
    failed = {name for name, row in rows.items() if row["verdict"] == "fail"}
    assert failed
    assert {Path(path).stem for path in digests(tmp_path / "out", "runs/*.mcap")} == {"0000-nominal", *failed}


@pytest.mark.slow
def test_all_logs_are_kept_where_asked(tmp_path: Path) -> None:
    verify(load_study(small_study(tmp_path, KEEP_ALL, samples=5)), tmp_path / "out")
    assert len(digests(tmp_path / "out", "runs/*.mcap")) == 5


# Refused before anything is written


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("observe = 12.0", "observe = 12.0\nstep = 1e-6"), f"at most {MOST_POINTS}"),
        (("observe = 12.0", "observe = 1e100"), f"at most {MOST_POINTS}"),
        (("observe = 12.0", "observe = 3"), "slowest period"),
        (("samples = 3", "samples = 1000000"), "samples"),
        (('output = "position_2"', 'output = "position_2"\nparameters = { stiffness = -1 }'), "unstable"),
        (("range = [0.8, 1.2]", "range = [-0.1, 1.2]"), "unstable"),
    ],
)
def test_what_cannot_be_run_is_refused_and_leaves_nothing(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    file = small_study(tmp_path)
    assert change[0] in file.read_text()
    file.write_text(file.read_text().replace(*change))
    done = run("verify", file, "--out", tmp_path / "out")
    assert (done.exit_code, done.stdout) == (2, "")
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_box_of_too_many_samples_is_refused(tmp_path: Path) -> None:
    axes = [f'[[uncertainty]]\nparameter = "{name}"\nrange = [0.9, 1.1]\nsamples = 50' for name in ("mass_1", "mass_2", "damping")]
    with pytest.raises(StudyError, match="375000 samples"):
        verify(load_study(small_study(tmp_path, *axes)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_plant_without_an_fmu_is_enough_for_bound_only(tmp_path: Path) -> None:
    from study_texts import RIGID

    file = tmp_path / "study.toml"
    file.write_text(RIGID)
    assert run("bound", file).exit_code == 0
    done = run("verify", file, "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "plant.fmu" in done.stderr
    assert not (tmp_path / "out").exists()


# Commands from a file, and delayed ones


def test_a_command_file_is_verified_like_any_other(tmp_path: Path) -> None:
    bound = json.loads(run("bound", small_study(tmp_path, samples=0), "--json").stdout)
    (tmp_path / "command.json").write_text(json.dumps(bound["command"]))
    file = small_study(tmp_path, '[command]\nkind = "file"\nfile = "command.json"\nstart = 1.5', samples=0, name="file.toml")
    done = run("verify", file, "--out", tmp_path / "out")
    assert done.exit_code == 0
    command = results(tmp_path / "out")["command"]
    assert command["maneuver_time"] == bound["command"]["maneuver_time"]
    assert command["segments"][0]["start"] == 1.5
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED


def test_a_command_file_beyond_the_limits_is_refused(tmp_path: Path) -> None:
    bound = json.loads(run("bound", small_study(tmp_path, samples=0), "--json").stdout)
    bound["command"]["segments"][1]["level"] = -1.25
    (tmp_path / "command.json").write_text(json.dumps(bound["command"]))
    done = run("verify", small_study(tmp_path, '[command]\nkind = "file"\nfile = "command.json"'), "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "-1.25" in done.stderr
    assert "limits.input" in done.stderr


def test_a_command_that_does_nothing_fails_without_a_traceback(tmp_path: Path) -> None:
    text = '{"format": "slewcert-command/1", "maneuver_time": 0.0, "segments": [], "tail": {"steady": 0.0}}'
    (tmp_path / "command.json").write_text(text)
    more = '[command]\nkind = "file"\nfile = "command.json"\n[[requirement]]\nid = "ERR"\nquantity = "final_error"\nmax = 0.01'
    done = run("verify", small_study(tmp_path, more, samples=0), "--out", tmp_path / "out")
    assert done.exit_code == 1
    entry = next(entry for entry in results(tmp_path / "out")["requirements"] if entry["id"] == "ERR")
    assert entry["value"] == 1.0, "it stays where it was"


def test_a_study_without_requirements_is_run(tmp_path: Path) -> None:
    text = small_study(tmp_path, samples=0).read_text()
    file = tmp_path / "bare.toml"
    file.write_text(text[: text.index("[[requirement]]")])
    done = run("verify", file, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["requirements"] == []
    assert "nothing was judged" in " ".join(results(tmp_path / "out")["notes"])
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED
