"""Limits of an FMU's process: memory, files, time a step, and the sandbox where there is one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from fault_plants import FAULT_TIME, build_fault
from small_studies import results, small_study
from test_workers import OUTPUTS, PATIENCE, children, experiment, finished, folders, needs_proc, wait_until

from fmus import confinement
from fmus.build import build
from fmus.confinement import MEBIBYTE, Confinement, choose_sandbox, missing
from fmus.errors import FmuError
from fmus.stepping import RunStatus
from fmus.workers import Worker
from suite.cli import main
from suite.errors import StudyError
from suite.loading import load_study

__all__ = ["folders"]  # a fixture

linux = pytest.mark.skipif(sys.platform != "linux", reason="other systems do not enforce it")
sandboxed = pytest.mark.skipif(missing() is not None, reason=f"no sandbox here: {missing()}")
SANDBOX = Confinement(sandbox="bwrap")


@linux
@pytest.mark.parametrize("sandbox", ["none", pytest.param("bwrap", marks=sandboxed)])
def test_a_leak_ends_at_the_limit_and_is_named(folders: Path, sandbox: str) -> None:
    with Worker(Confinement(memory=512 * MEBIBYTE, sandbox=sandbox)) as worker:  # type: ignore[arg-type]
        outcome = worker.run(experiment(build_fault("leak"), step=0.05), PATIENCE)
        assert outcome.status is RunStatus.MEMORY
        assert "of the 512 MiB that it may have, then SIGSEGV, after 1." in outcome.detail
        assert outcome.trajectory is not None
        assert FAULT_TIME <= outcome.trajectory.times[-1] < 1.5
        finished(worker.run(experiment(build("two_mass")), PATIENCE))


@linux
def test_a_crash_with_little_memory_is_just_a_crash() -> None:
    with Worker(Confinement(memory=512 * MEBIBYTE)) as worker:
        assert worker.run(experiment(build_fault("segfault")), PATIENCE).status is RunStatus.CRASHED


@linux
@pytest.mark.parametrize(("fault", "status"), [("segfault", "CRASHED"), ("abort", "CRASHED"), ("quit", "EXITED"), ("leak", "MEMORY")])
def test_the_size_of_whoever_runs_the_fmu_does_not_count(fault: str, status: str) -> None:
    ballast = np.ones(160 * MEBIBYTE // 8)  # a process is born with the peak of the one that starts it
    with Worker(Confinement(memory=128 * MEBIBYTE)) as worker:
        outcome = worker.run(experiment(build_fault(fault)), PATIENCE)
    assert outcome.status is RunStatus[status], outcome.detail
    assert ballast[-1] == 1.0


@linux
def test_a_file_ends_at_the_limit(folders: Path) -> None:
    with Worker(Confinement(file_size=3 * MEBIBYTE)) as worker:
        outcome = worker.run(experiment(build_fault("fill")), PATIENCE)
        assert outcome.status is RunStatus.ERROR
        assert "File too large" in outcome.detail
    assert list(folders.iterdir()) == []


def test_a_step_that_hangs_is_ended_long_before_the_run() -> None:
    with Worker(Confinement(step=0.4)) as worker:
        outcome = worker.run(experiment(build_fault("hang")), PATIENCE)
        assert outcome.status is RunStatus.HUNG
        assert outcome.detail == "a step took longer than 0.4 s, after 1 s"
        assert outcome.seconds < PATIENCE / 2
        finished(worker.run(experiment(build("two_mass")), PATIENCE))


@pytest.mark.slow
def test_a_run_of_many_short_steps_may_take_longer_than_one() -> None:
    with Worker(Confinement(step=0.5)) as worker:
        long = experiment(build_fault("flood"), step=0.01, stop=10.0)
        assert finished(worker.run(long, PATIENCE)).times[-1] == 10.0


def test_limits_that_make_no_sense_are_refused() -> None:
    with pytest.raises(FmuError, match="at least 64 MiB"):
        Confinement(memory=MEBIBYTE)
    with pytest.raises(FmuError, match="no sandbox 'jail'; valid are none, auto, bwrap"):
        Confinement(sandbox="jail")  # type: ignore[arg-type]


@pytest.fixture
def nothing_chosen() -> None:
    """The choice is the process's own."""
    choose_sandbox("none")


def test_a_sandbox_that_is_missing_is_an_error_if_it_was_asked_for_by_name(monkeypatch: pytest.MonkeyPatch, nothing_chosen: None) -> None:
    monkeypatch.setattr(confinement, "missing", lambda: "there is none")
    with pytest.raises(FmuError, match="the sandbox bwrap cannot be used: there is none"):
        choose_sandbox("bwrap")
    with Worker(SANDBOX) as worker, pytest.raises(FmuError, match="cannot be used"):
        worker.run(experiment(build("two_mass")), PATIENCE)
    with Worker(Confinement(sandbox="auto")) as worker:
        finished(worker.run(experiment(build("two_mass")), PATIENCE))


PEEK = """
import os, sys, socket
found = {
    "home": os.path.exists(sys.argv[1]),
    "write": os.access("/usr", os.W_OK) and not os.statvfs("/usr").f_flag & os.ST_RDONLY,
    "processes": len([p for p in os.listdir("/proc") if p.isdigit()]),
    "interfaces": [name for _, name in socket.if_nameindex()],
}
print(found)
"""


@sandboxed
def test_the_sandbox_shows_neither_files_nor_network_nor_processes(tmp_path: Path) -> None:
    secret, own = tmp_path / "secret", tmp_path / "own"
    own.mkdir()
    secret.write_text("mine")
    command = [sys.executable, "-c", PEEK, str(secret)]
    done = subprocess.run(confinement.wrapped(command, own, own, SANDBOX), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = eval(done.stdout)  # noqa: S307 - what our own script printed
    assert found == {"home": False, "write": False, "processes": 2, "interfaces": ["lo"]}


@sandboxed
@pytest.mark.parametrize(
    ("fault", "status", "words"),
    [
        ("abort", RunStatus.CRASHED, "SIGABRT, after 1 s"),
        ("segfault", RunStatus.CRASHED, "SIGSEGV, after 1 s"),
        ("quit", RunStatus.EXITED, "exit code 0, after 1 s"),
        ("hang", RunStatus.HUNG, "after 1 s"),
        ("error", RunStatus.ERROR, "the error that was asked for"),
    ],
)
def test_every_fault_is_the_same_in_the_sandbox(folders: Path, fault: str, status: RunStatus, words: str) -> None:
    with Worker(SANDBOX) as worker:
        outcome = worker.run(experiment(build_fault(fault)), 2.0 if fault == "hang" else PATIENCE)
        assert outcome.status is status
        assert words in outcome.detail
        finished(worker.run(experiment(build("two_mass")), PATIENCE))
    assert list(folders.iterdir()) == []


@sandboxed
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_sandbox_changes_no_number(version: str) -> None:
    fmu = build("two_mass", version)  # type: ignore[arg-type]
    with Worker(SANDBOX) as inside, Worker() as outside:
        one, other = (finished(worker.run(experiment(fmu), PATIENCE)) for worker in (inside, outside))
    np.testing.assert_array_equal(one.values, other.values)
    assert one.values.shape[1] == len(OUTPUTS)


@sandboxed
@needs_proc
def test_a_killed_parent_leaves_no_process_in_the_sandbox(tmp_path: Path) -> None:
    """What is left is an empty folder: the sandbox cannot remove the place at which it sees it."""
    script = (
        "from pathlib import Path; import test_workers as t; from fmus.confinement import choose_sandbox\nchoose_sandbox('bwrap')\n"
        f"t.simulate(t.experiment(Path({str(build_fault('hang'))!r})), 600.0)\n"
    )
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    parent = subprocess.Popen([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": path, "TMPDIR": str(tmp_path)})
    try:
        wait_until(lambda: bool(children(parent.pid)) and any(tmp_path.glob("slewcert-*/progress-*")))
        (child,) = children(parent.pid)
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: not Path(f"/proc/{child}").exists())
    assert [list(folder.iterdir()) for folder in tmp_path.iterdir()] == [[]]


def small(folder: Path, *lines: str) -> Path:
    file = small_study(folder, samples=0)
    file.write_text(file.read_text().replace("timeout = 20", "\n".join(("timeout = 20", *lines))))
    return file


def test_a_study_sets_the_limits_and_the_record_tells_them(tmp_path: Path) -> None:
    file = small(tmp_path, "step_timeout = 5", "memory = 300")
    done = CliRunner().invoke(main, ["verify", str(file), "--out", str(tmp_path / "out")], catch_exceptions=False)
    assert done.exit_code == 0
    limits = results(tmp_path / "out")["confinement"]
    assert limits == {"timeout": 20.0, "step_timeout": 5.0, "memory": 300 * MEBIBYTE, "file_size": 2**30, "sandbox": "none"}


@sandboxed
def test_the_command_line_asks_for_the_sandbox(tmp_path: Path) -> None:
    command = ["verify", str(small(tmp_path)), "--out", str(tmp_path / "out"), "--sandbox", "bwrap"]
    assert CliRunner().invoke(main, command, catch_exceptions=False).exit_code == 0
    assert results(tmp_path / "out")["confinement"]["sandbox"] == "bwrap"
    assert CliRunner().invoke(main, [*command[:-2], "--force"], catch_exceptions=False).exit_code == 0
    assert results(tmp_path / "out")["confinement"]["sandbox"] == "none"


def test_a_sandbox_that_is_not_there_is_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confinement, "missing", lambda: "there is none")
    done = CliRunner().invoke(main, ["verify", str(small(tmp_path)), "--sandbox", "bwrap"], catch_exceptions=False)
    assert done.exit_code == 2
    assert "the sandbox bwrap cannot be used: there is none" in done.stderr


@pytest.mark.parametrize(("line", "key"), [("memory = 10", "memory"), ("memory = 1.5", "memory"), ("step_timeout = 0", "step_timeout")])
def test_limits_of_a_study_are_checked(tmp_path: Path, line: str, key: str) -> None:
    with pytest.raises(StudyError, match=rf"simulation\.{key}"):
        load_study(small(tmp_path, line))


@pytest.mark.parametrize("command", ["verify", "bound", "simulate", "linearize"])
def test_every_command_that_runs_fmus_can_be_confined(command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(confinement, "missing", lambda: "there is no program bwrap")
    words = {
        "verify": [str(small(tmp_path)), "--out", str(tmp_path / "out")],
        "bound": [str(small(tmp_path))],
        "simulate": ["two_mass", str(tmp_path / "none.json"), "--input", "force", "--output", "position_2"],
        "linearize": ["two_mass", "--input", "force", "--output", "position_2"],
    }[command]
    done = CliRunner().invoke(main, [command, *words, "--sandbox", "bwrap"], catch_exceptions=False)
    assert done.exit_code == 2
    assert "the sandbox bwrap cannot be used: there is no program bwrap" in done.output
