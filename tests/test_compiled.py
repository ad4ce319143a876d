"""The compiled stepping loop does what the one in Python does, to the bit: rows, messages, statuses, whatever the FMU does."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from array_plant import build_chain
from event_plants import build_event_plant
from fault_plants import FAULTS, build_fault
from marks import first
from test_events import EVENTS
from test_workers import BANG, PATIENCE, experiment

from fmus import compiled, compiling
from fmus.build import FmiVersion, build
from fmus.confinement import MEBIBYTE, Confinement
from fmus.stepping import Experiment, Outcome, RunStatus
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail, TailTerm

LIMITS = Confinement(memory=256 * MEBIBYTE, file_size=3 * MEBIBYTE)
SLOPES = Command(3.0, (Segment(0.3, 0.0, 0.5), Segment(1.3, 0.5, -0.5), Segment(2.3, 0.0)), Tail(0.0))
DECAY = Command(1.0, (Segment(0.0, 1.0),), Tail(0.0, (TailTerm(-2.0 + 1.0j, 0, 0.5 + 0.25j),)))
VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")


@pytest.fixture(scope="module")
def workers() -> Iterator[dict[str, Worker]]:
    """One that steps in C and one that steps in Python."""
    compiled.build()
    with Worker(LIMITS) as quick, pytest.MonkeyPatch.context() as patch, Worker(LIMITS) as slow:
        quick.run(experiment(build("two_mass")), PATIENCE)
        patch.setattr(compiled, "found", lambda: None)
        slow.run(experiment(build("two_mass")), PATIENCE)
        assert quick._child is not None
        assert slow._child is not None
        assert (quick._child.loop is None, slow._child.loop is None) == (False, True)
        patch.undo()  # a child that follows a failure would be another one: `both` sees to it
        yield {"compiled": quick, "interpreted": slow}


def both(workers: dict[str, Worker], asked: Experiment, monkeypatch: pytest.MonkeyPatch, patience: float = PATIENCE) -> Outcome:
    """The outcome, the same from both loops."""
    first = workers["compiled"].run(asked, patience)
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "found", lambda: None)
        second = workers["interpreted"].run(asked, patience)
    assert first.status is second.status
    if "MiB" not in first.detail:  # how much a process had is not the same twice
        assert first.detail == second.detail
    assert first.messages == second.messages
    assert (first.trajectory is None) == (second.trajectory is None)
    if first.trajectory is not None and second.trajectory is not None:
        np.testing.assert_array_equal(first.trajectory.times, second.trajectory.times)
        np.testing.assert_array_equal(first.trajectory.input, second.trajectory.input)
        np.testing.assert_array_equal(first.trajectory.values, second.trajectory.values)
    return first


def test_both_describe_the_same_structures() -> None:
    assert compiled.load(str(compiled.build())) is not None


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("command", [BANG, SLOPES, DECAY], ids=["jumps", "slopes", "tail"])
def test_commands(command: Command, version: FmiVersion, workers: dict[str, Worker], monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = both(workers, experiment(build("two_mass", version), command=command, step=0.013), monkeypatch)
    assert outcome.trajectory is not None
    assert len(outcome.trajectory.times) > 10.0 / 0.013


@pytest.mark.parametrize("name", first(6, FAULTS))
def test_faults(name: str, workers: dict[str, Worker], monkeypatch: pytest.MonkeyPatch) -> None:
    version = VERSIONS[FAULTS.index(name) % 2]  # all of them with both: in tests/test_fault_table.py, compiled
    both(workers, experiment(build_fault(name, version)), monkeypatch, 0.5 if name == "hang" else PATIENCE)


@pytest.mark.parametrize("version", first(1, VERSIONS))
@pytest.mark.parametrize("kind", ["BALL", "RELAY", "CLOCK", "KICK", "FUSSY"])
def test_events(kind: str, version: FmiVersion, tmp_path: Path, workers: dict[str, Worker], monkeypatch: pytest.MonkeyPatch) -> None:
    flags = EVENTS if version == "3.0" else {}
    path = build_event_plant(tmp_path, kind, version, **flags)
    parameters, state = (
        ({"g": 9.81, "e": 0.7, "slow": 0.1}, {"x": 1e-9, "v": 4.0}) if kind == "BALL" else ({"g": 2.0, "e": 0.5}, {"x": 0.1})
    )
    asked = Experiment(path, "u", ("x", "v", "count"), parameters, 0.0, state, BANG, 3.0, 0.1, "co-simulation")
    assert both(workers, asked, monkeypatch).trajectory is not None
    cut = both(workers, replace(asked, command=SLOPES, parameters={**parameters, "longest": 0.04}), monkeypatch)
    assert cut.trajectory is not None


def test_arrays_and_numbers_of_other_types(tmp_path: Path, workers: dict[str, Worker], monkeypatch: pytest.MonkeyPatch) -> None:
    chain = build_chain(tmp_path)
    push = Command(1.0, (Segment(0.0, 1.0), Segment(0.55, -1.0)), Tail(0.0))
    asked = Experiment(chain, "force[2]", ("x[3]", "x[1]"), {}, 0.0, {}, push, stop=2.0, step=0.1)
    outcome = both(workers, asked, monkeypatch)
    assert outcome.status is RunStatus.FINISHED
    mixed = ("moved[2]", "x[3]", "count", "gain", "material", "moved[1]", "v[1]", "stiffness[2]")
    outcome = both(workers, replace(asked, outputs=mixed), monkeypatch)
    assert outcome.status is RunStatus.FINISHED


def test_what_cannot_be_loaded_is_stepped_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Worker() as worker:
        expected = worker.run(experiment(build("two_mass")), PATIENCE)
    broken = tmp_path / "stepping.so"
    broken.write_bytes(b"no library")
    monkeypatch.setattr(compiled, "found", lambda: broken)
    with Worker() as worker:
        outcome = worker.run(experiment(build("two_mass")), PATIENCE)
    assert outcome.status is expected.status
    assert outcome.trajectory is not None
    assert expected.trajectory is not None
    np.testing.assert_array_equal(outcome.trajectory.values, expected.trajectory.values)


def test_a_library_of_another_version_is_refused(tmp_path: Path) -> None:
    text = compiled.SOURCE.read_bytes().replace(b"    int kind;\n", b"    int kind, more[2];\n")
    library = tmp_path / "stepping.so"
    library.write_bytes(compiling.compile_library("stepping", ["stepping.c"], {"stepping.c": text}))
    assert compiled.load(str(library)) is None
    assert ctypes.CDLL(str(library)).slewcert_steps is not None
