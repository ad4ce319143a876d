"""The campaign: which runs are made, that nothing but the study decides what is in them, and that it goes on where it was cut short."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from marks import slow
from small_studies import KEEP_ALL, OBSERVED, digests, results, run_table, small_study

from fmus.stepping import Experiment, Outcome, RunStatus
from fmus.workers import Worker
from suite import campaign
from suite.campaign import RunResult, Sample, measure, run_id, samples, settle
from suite.design import Design, design
from suite.folders import LEDGER
from suite.ledger import Ledger, LedgerError
from suite.loading import load_study
from suite.progress import Progress
from suite.quantities import Observation
from suite.quantity_names import parse_quantity
from suite.review import ReviewStatus, review
from suite.study import Study
from suite.verdicts import Measured
from suite.verification import verify

PATIENCE = 60.0  # s; generous for a loaded machine
SAMPLES = 31  # of a campaign that is not over before it is interrupted, however busy the machine


def load(folder: Path, *more: str, **keys: Any) -> Study:
    return load_study(small_study(folder, *more, **keys))


def axis(parameter: str, lower: float, upper: float, count: int) -> str:
    return f'[[uncertainty]]\nparameter = "{parameter}"\nrange = [{lower}, {upper}]\nsamples = {count}'


# Which runs are made


def test_the_nominal_plant_comes_first_and_only_once(tmp_path: Path) -> None:
    made = samples(load(tmp_path, samples=5))
    assert [sample.name for sample in made] == ["0000-nominal", "0001", "0002", "0003", "0004"]
    assert [sample.nominal for sample in made] == [True, False, False, False, False]
    values = [sample.parameters["stiffness"] for sample in made]
    assert values == [1, Fraction("0.8"), Fraction("0.9"), Fraction("1.1"), Fraction("1.2")], "exact, and without the one in the middle"


def test_a_nominal_plant_beside_the_grid_is_a_run_more(tmp_path: Path) -> None:
    made = samples(load(tmp_path, samples=4))
    assert len(made) == 5
    assert [sample.parameters["stiffness"] for sample in made].count(Fraction(1)) == 1


def test_several_parameters_are_the_full_product(tmp_path: Path) -> None:
    made = samples(load(tmp_path, axis("mass_1", 0.9, 1.1, 2), axis("damping", 0.0, 0.1, 2), samples=3))
    places = [tuple(sample.parameters.values()) for sample in made]
    assert len(places) == len(set(places)) == 3 * 2 * 2 + 1, "the nominal masses are not on the grid"
    assert places[0] == (1, 1, 0)
    assert set(made[1].parameters) == {"stiffness", "mass_1", "damping"}
    assert [sample.name for sample in made[1:]] == [f"{i:04d}" for i in range(1, 13)]


def test_each_sample_has_its_own_linear_plant(tmp_path: Path) -> None:
    frequencies = [sample.plant.flexible[0].natural_frequency for sample in samples(load(tmp_path, samples=2))]
    assert frequencies == pytest.approx([2**0.5, 1.6**0.5, 2.4**0.5], rel=1e-12)


def test_without_uncertainty_there_is_one_run(tmp_path: Path) -> None:
    assert [sample.name for sample in samples(load(tmp_path, samples=0))] == ["0000-nominal"]


def test_the_nominal_value_is_the_studys_own(tmp_path: Path) -> None:
    file = small_study(tmp_path, samples=2)
    file.write_text(file.read_text().replace('output = "position_2"', 'output = "position_2"\nparameters = { stiffness = 0.8 }'))
    made = samples(load_study(file))
    assert [sample.parameters["stiffness"] for sample in made] == [Fraction("0.8"), Fraction("1.2")]


# Step and window


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Design]:
    study = load(tmp_path_factory.mktemp("designed"), samples=2)
    return study, design(study)


def test_step_and_window_come_from_the_runs_own_modes(designed: tuple[Study, Design]) -> None:
    study, made = designed
    assert made.command is not None
    free = replace(study, simulation=replace(study.simulation, observe=None))
    nominal, soft, _ = (settle(free, sample, made.command, (None, None)) for sample in samples(study))
    period = 2 * 3.141592653589793 / 2**0.5
    assert nominal.facts.slowest_period == pytest.approx(period)
    assert nominal.stop == pytest.approx(made.command.end + 20 * period)
    assert nominal.step == pytest.approx(period / 50), "less than a thousandth of the window"
    assert soft.stop - made.command.end == pytest.approx(20 * period / 0.8**0.5)


def test_the_study_may_choose_step_and_window(designed: tuple[Study, Design]) -> None:
    study, made = designed
    assert made.command is not None
    chosen = replace(study, simulation=replace(study.simulation, step=0.25))
    setting = settle(chosen, samples(study)[0], made.command, (1.0, 2.0))
    assert (setting.step, setting.stop) == (0.25, made.command.end + OBSERVED)
    assert (setting.facts.lower, setting.facts.upper) == (1.0, 2.0)
    late = settle(chosen, samples(study)[0], made.command.shifted(3.0), (None, None))
    assert late.stop == pytest.approx(setting.stop + 3.0), "the window begins when the move ends"


# Identity


def test_a_run_id_depends_on_everything_that_the_run_depends_on(tmp_path: Path, designed: tuple[Study, Design]) -> None:
    from suite.verification import _subject

    study, made = designed
    fmu = study.plant.fmu
    assert fmu is not None
    assert made.command is not None
    subject = _subject(study, fmu, made)
    first, second, _ = samples(study)

    def identity(study: Study = study, subject: Any = subject, sample: Sample = first) -> str:
        return run_id(study, subject, settle(study, sample, subject.command, (None, None)))

    again = load(tmp_path, samples=2)
    changed = [
        identity(sample=second),
        identity(subject=replace(subject, version="9.9.9")),
        identity(subject=replace(subject, study_sha256="0" * 64)),
        identity(subject=replace(subject, fmu_sha256="0" * 64)),
        identity(subject=replace(subject, command=made.command.shifted(1.0))),
        identity(replace(study, simulation=replace(study.simulation, seed=1))),
        identity(replace(study, simulation=replace(study.simulation, step=0.01))),
        identity(sample=replace(first, parameters={"stiffness": Fraction(1, 3)})),
    ]
    assert len({identity(), *changed}) == 1 + len(changed)
    assert identity(again) == identity(), "the same study in another folder"


# The numerical error


def test_the_error_is_twice_what_halving_the_step_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"overshoot": (1.0, 1.25), "settling_time(0.02)": (float("inf"), float("inf")), "fuel": (2.0, 2.0)}
    monkeypatch.setattr(campaign, "evaluate", lambda run, quantity: values[str(quantity)][run])
    whole: Any = 0
    halved: Any = 1
    found = measure(whole, halved, tuple(map(parse_quantity, values)))
    assert found == {
        "overshoot": Measured(1.0, 0.5),
        "settling_time(0.02)": Measured(float("inf"), 0.0),
        "fuel": Measured(2.0, 0.0),
    }
    assert Observation.__dataclass_fields__.keys() >= {"times", "output"}


# Independence of jobs, of order, of time


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A study file and its evidence, computed by one worker."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    file = small_study(folder, KEEP_ALL, samples=7)
    verify(load_study(file), folder / "out", jobs=1)
    return file, folder / "out"


EVIDENCE = ("results.json", "report.html", "junit.xml", "study.toml", "plant/*", "runs/*")


def evidence(folder: Path) -> dict[str, str]:
    """Digests of everything but ledger and manifest, whose rows come in the order in which runs end."""
    return {path: digest for pattern in EVIDENCE for path, digest in digests(folder, pattern).items()}


@pytest.mark.slow
def test_the_evidence_has_the_same_bytes_for_any_number_of_workers(uninterrupted: tuple[Path, Path], tmp_path: Path) -> None:
    file, folder = uninterrupted
    verify(load_study(file), tmp_path / "out", jobs=3)
    assert evidence(tmp_path / "out") == evidence(folder)
    assert len(run_table(folder)) == 7


# Going on


class Counting:
    """Stands for `campaign.run` and counts the runs that are really made."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._run = campaign.run

    def __call__(self, study: Study, subject: Any, sample: Sample, *rest: Any) -> RunResult:
        self.names.append(sample.name)
        return self._run(study, subject, sample, *rest)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counting:
    counting = Counting()
    monkeypatch.setattr(campaign, "run", counting)
    return counting


@pytest.fixture
def interrupted(uninterrupted: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """The study and a copy of its evidence, to be damaged."""
    import shutil

    file, folder = uninterrupted
    return file, Path(shutil.copytree(folder, tmp_path / "out"))


def rows(folder: Path, statement: str, *values: str) -> list[tuple[str]]:
    connection = sqlite3.connect(folder / LEDGER)
    try:
        found = connection.execute(statement, values).fetchall()
        connection.commit()
        return found
    finally:
        connection.close()


def forget_row(folder: Path, name: str) -> None:
    rows(folder, "DELETE FROM runs WHERE name = ?", name)


def remove_log(folder: Path, name: str) -> None:
    (folder / "runs" / f"{name}.mcap").unlink()


def damage_log(folder: Path, name: str) -> None:
    path = folder / "runs" / f"{name}.mcap"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("harm", [slow(forget_row), slow(remove_log), damage_log])
def test_resume_makes_what_is_missing_and_nothing_else(
    interrupted: tuple[Path, Path], uninterrupted: tuple[Path, Path], made: Counting, harm: Callable[[Path, str], None]
) -> None:
    file, folder = interrupted
    for name in ("0000-nominal", "0002", "0005"):
        harm(folder, name)
    shown: list[str] = []
    verify(load_study(file), folder, jobs=2, resume=True, progress=Progress(finished=lambda result: shown.append(result.name)))
    assert sorted(made.names) == ["0000-nominal", "0002", "0005"]
    assert sorted(shown) == sorted(run_table(folder)), "progress counts what was there, too"
    assert evidence(folder) == evidence(uninterrupted[1])


def test_resume_of_what_is_complete_makes_no_run(tmp_path: Path, made: Counting) -> None:
    """Even if logs of runs that passed were not kept: their rows tell what they came to."""
    study = load(tmp_path, samples=5)
    verify(study, tmp_path / "out")
    before = evidence(tmp_path / "out")
    assert len(digests(tmp_path / "out", "runs/*.mcap")) < 5
    made.names.clear()
    verify(study, tmp_path / "out", resume=True)
    assert made.names == []
    assert evidence(tmp_path / "out") == before


def test_resume_begins_where_nothing_was_begun(tmp_path: Path, made: Counting) -> None:
    verify(load(tmp_path, samples=2), tmp_path / "out", resume=True)
    assert len(made.names) == 3


def start(file: Path, folder: Path, *options: str) -> subprocess.Popen[str]:
    # what began the tests may ignore Ctrl-C, as shells let their background jobs do, and its children would, too
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from suite.cli import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "verify", str(file), "--out", str(folder), "--jobs", "2", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_logs(process: subprocess.Popen[str], folder: Path, count: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while len(list(folder.glob("runs/*.mcap"))) < count:
        assert process.poll() is None, f"ended before it could be interrupted: {process.communicate()}"
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends signals")
@pytest.mark.parametrize(
    ("sent", "code"),
    [
        pytest.param(signal.SIGKILL, -signal.SIGKILL, id="kill", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 130, id="ctrl-c"),
    ],
)
def test_a_campaign_that_was_ended_goes_on(tmp_path: Path, made: Counting, sent: signal.Signals, code: int) -> None:
    file = small_study(tmp_path, KEEP_ALL, samples=SAMPLES)
    file.write_text(file.read_text().replace(f"observe = {OBSERVED}", "observe = 30.0\nstep = 0.01"))
    process = start(file, tmp_path / "out")
    wait_for_logs(process, tmp_path / "out", 4)
    process.send_signal(sent)
    printed, said = process.communicate(timeout=PATIENCE)
    assert (process.returncode, printed) == (code, "")
    assert "Traceback" not in said
    assert review(tmp_path / "out").status is ReviewStatus.INCOMPLETE
    there = {name for (name,) in rows(tmp_path / "out", "SELECT name FROM runs")}
    assert len(there) >= 2
    done = verify(load_study(file), tmp_path / "out", jobs=2, resume=True)
    assert len(made.names) == SAMPLES - len(there)
    assert not there & set(made.names)
    assert done.results["runs"] == {"total": SAMPLES, "passed": SAMPLES, "failed": 0, "errors": 0}
    assert not list((tmp_path / "out").rglob("*.tmp"))
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED


def test_an_interrupted_campaign_does_not_wait_for_an_fmu_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fault_plants import build_fault

    study = load(tmp_path, fmu=str(build_fault("hang")), samples=3)

    def interrupt(result: RunResult) -> None:
        raise KeyboardInterrupt

    class Hasty(Worker):
        """The first run crashes at once, so that the interrupt comes while the others hang."""

        def run(self, experiment: Experiment, timeout: float) -> Outcome:
            if experiment.parameters["stiffness"] == 1.0:
                return Outcome(RunStatus.CRASHED, "SIGSEGV", None, 0.0)
            return super().run(experiment, timeout)

    began = time.monotonic()
    monkeypatch.setattr(campaign, "Worker", Hasty)
    with pytest.raises(KeyboardInterrupt):
        verify(study, tmp_path / "out", jobs=2, progress=Progress(finished=interrupt))
    assert time.monotonic() - began < 15.0, "the time-out of a run is 20 s"
    assert [name for (name,) in rows(tmp_path / "out", "SELECT name FROM runs")] == ["0000-nominal"], (
        "what was killed from here is no result"
    )


def test_what_hinders_one_run_is_that_runs_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fmus.errors import FmuError

    class Unlucky(Worker):
        def run(self, experiment: Experiment, timeout: float) -> Outcome:
            if float(experiment.parameters["stiffness"]) > 1.1:
                raise FmuError("the child process for the FMU did not start")
            return super().run(experiment, timeout)

    monkeypatch.setattr(campaign, "Worker", Unlucky)
    done = verify(load(tmp_path, samples=3), tmp_path / "out")
    assert done.results["runs"] == {"total": 3, "passed": 2, "failed": 0, "errors": 1}
    assert run_table(tmp_path / "out")["0002"]["detail"] == "the child process for the FMU did not start"
    assert results(tmp_path / "out")["verdict"] == "error"


def test_a_ledger_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    study = load(tmp_path, samples=0)
    verify(study, tmp_path / "out")
    (tmp_path / "out" / LEDGER).write_bytes(b"no database at all, but long enough to be looked at" * 100)
    with pytest.raises(LedgerError, match=LEDGER):
        verify(study, tmp_path / "out", resume=True)
    verify(study, tmp_path / "out", force=True)
    with Ledger(tmp_path / "out" / LEDGER) as ledger:
        assert ledger.find("0" * 64) is None
