"""Co-simulation that is not simply stepped through: event mode, early return, inputs within a step, and steps that are discarded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from event_plants import build_event_plant
from test_exchange import bounces
from test_workers import PATIENCE, finished

from fmus.build import FmiVersion
from fmus.errors import DescriptionError
from fmus.stepping import Experiment, RunStatus
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail, TailTerm

EVENTS = {"hasEventMode": "true", "mightReturnEarlyFromDoStep": "true"}
VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
REST = Command(0.0, (), Tail(0.0))


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def run(path: Path, state: dict[str, float], command: Command = REST, stop: float = 3.0, step: float = 0.1, **more: float) -> Experiment:
    return Experiment(path, "u", ("x", "v", "count"), more, 0.0, state, command, stop, step, "co-simulation")


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_an_early_return_is_continued_from_where_it_ended(step: float, tmp_path: Path, worker: Worker) -> None:
    """Eleven bounces, of which several lie in one communication step."""
    path = build_event_plant(tmp_path, "BALL", "3.0", **EVENTS)
    outcome = worker.run(run(path, {"x": 1e-9, "v": 4.0}, step=step, g=9.81, e=0.7, slow=0.1), PATIENCE)
    done = finished(outcome)
    impacts, _ = bounces(4.0, 9.81, 0.7, 0.1)
    assert done.values[-1, 2] == len(impacts) == 11
    seen = [float(line.text.split()[-2]) for line in outcome.messages if line.text.startswith("event at")]
    np.testing.assert_allclose(seen, impacts, rtol=0.0, atol=2e-9)
    assert done.times.tolist() == [n * step for n in range(round(3.0 / step))] + [3.0], "rows at communication points only"


@pytest.mark.parametrize("flags", [EVENTS, {"hasEventMode": "true"}, {}])
def test_events_inside_and_outside_the_fmu_give_one_motion(flags: dict[str, str], tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "RELAY", "3.0", **flags)
    done = finished(worker.run(run(path, {"x": 0.0}, stop=10.05, g=1.0, e=0.5), PATIENCE))
    np.testing.assert_allclose(done.values[:, 0], 0.5 - np.abs((done.times - 0.5) % 2.0 - 1.0), rtol=0.0, atol=1e-9)
    assert done.values[-1, 2] == 10


@pytest.mark.parametrize("tick", [0.3, 0.07, 0.1])
def test_steps_end_at_announced_events(tick: float, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "CLOCK", "3.0", **EVENTS)
    done = finished(worker.run(run(path, {"x": 0.0}, g=tick), PATIENCE))
    exact = np.maximum(done.times[:, None] - np.arange(1, 60) * tick, 0.0).sum(axis=1)
    np.testing.assert_allclose(done.values[:, 0], exact, rtol=1e-9, atol=1e-9)


def test_a_jump_of_the_input_is_an_event(tmp_path: Path, worker: Worker) -> None:
    """A resting ball is lifted at the jump itself, which event mode alone can see (the indicator does not cross during a step)."""
    path = build_event_plant(tmp_path, "BALL", "3.0", **EVENTS)
    jump = Command(1.0, (Segment(0.53, 2.0),), Tail(2.0))
    done = finished(worker.run(run(path, {"x": 0.0, "v": -1e-3}, jump, stop=1.5, g=1.0, e=0.5, slow=0.1), PATIENCE))
    np.testing.assert_allclose(done.values[:, 0], np.maximum(done.times - 0.53, 0.0) ** 2 / 2.0, rtol=0.0, atol=1e-12)


def test_an_event_can_end_the_run(tmp_path: Path, worker: Worker) -> None:
    for flags in (EVENTS, {}):
        path = build_event_plant(tmp_path, "BALL", "3.0", **flags)
        outcome = worker.run(run(path, {"x": 1.0}, g=9.81, e=0.7, slow=-2.0), PATIENCE)
        assert outcome.status is RunStatus.TERMINATED
        assert outcome.trajectory is not None
        assert outcome.trajectory.times[-1] == pytest.approx(np.sqrt(2.0 / 9.81) * 2.4, abs=0.1)


def test_an_early_return_without_permission_is_an_error(tmp_path: Path, worker: Worker, monkeypatch: pytest.MonkeyPatch) -> None:
    path = build_event_plant(tmp_path, "BALL", "3.0", **EVENTS)
    opened = worker._open(path)
    calm = replace(opened.description.capabilities, event_mode=False, early_return=False)
    monkeypatch.setattr(worker, "_open", lambda _: replace(opened, description=replace(opened.description, capabilities=calm)))
    done = finished(worker.run(run(path, {"x": 1e-9, "v": 4.0}, g=9.81, e=0.7, slow=0.1), PATIENCE))
    assert done.values[-1, 2] == 11, "it was told not to, and does not"


TAILED = Command(0.5, (Segment(0.2, 0.0, 2.0),), Tail(0.1, (TailTerm(-1.0 + 2.0j, 0, 0.9 + 0.3j),)))


def test_an_input_that_is_asked_for_within_a_step_is_exact(tmp_path: Path, worker: Worker) -> None:
    """x'' = u - 4 x by Runge and Kutta's steps of 1 ms, inputs at their three instants; against the same in steps that hold or ask."""
    asking = build_event_plant(tmp_path, "FUSSY", "3.0", providesIntermediateUpdate="true")
    done = finished(worker.run(run(asking, {"x": 0.0}, TAILED, step=0.5, g=4.0), PATIENCE))
    exchanged = replace(run(asking, {"x": 0.0}, TAILED, step=0.5, g=4.0), interface="model-exchange", tolerance=1e-12)
    exact = finished(worker.run(exchanged, PATIENCE))
    np.testing.assert_allclose(done.values, exact.values, rtol=0.0, atol=1e-10)
    holding = build_event_plant(tmp_path, "FUSSY", "3.0")
    held = finished(worker.run(run(holding, {"x": 0.0}, TAILED, step=0.5, g=4.0), PATIENCE))
    difference = np.abs(held.values - exact.values).max()
    assert 1e-10 < difference < 1e-4, "what it asks for is used: holding gives less"


@pytest.mark.parametrize("version", VERSIONS)
def test_a_discarded_step_is_cut_until_it_is_taken(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    """In FMI 2.0 a step that was discarded can be repeated from a copy of the FMU's state only; this one insists on it."""
    path = build_event_plant(tmp_path, "FUSSY", version)
    outcome = worker.run(run(path, {"x": 1.0}, stop=1.0, g=4.0, longest=0.03), PATIENCE)
    done = finished(outcome)
    np.testing.assert_allclose(done.values[:, 0], np.cos(2.0 * done.times), rtol=0.0, atol=1e-10)
    cuts = [line.text for line in outcome.messages if line.level == "discard"]
    assert len(cuts) == 20, "two in each of the ten steps, and none of them told twice"
    assert cuts[0] == "a step of 0.1 s from 0 s was discarded: cut to 0.05 s"


def test_an_fmu_without_copies_is_asked_to_go_on_from_where_it_came_to(tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "FUSSY", "2.0", canGetAndSetFMUstate="false")
    outcome = worker.run(run(path, {"x": 1.0}, stop=1.0, g=4.0, longest=0.03), PATIENCE)
    assert outcome.status is RunStatus.ERROR, "this one refuses, as the standard allows"
    assert "fmi2DoStep returned Error" in outcome.detail


@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_is_cut_ten_times_and_no_more(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "FUSSY", version)
    outcome = worker.run(run(path, {"x": 1.0}, stop=1.0, g=4.0, longest=1e-9), PATIENCE)
    assert outcome.status is RunStatus.DISCARD
    assert sum(line.level == "discard" for line in outcome.messages) == 10
    assert outcome.trajectory is not None
    assert len(outcome.trajectory.times) == 1


def test_an_fmu_with_one_step_size_is_not_asked_for_less(tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "FUSSY", "3.0", canHandleVariableCommunicationStepSize="false")
    outcome = worker.run(run(path, {"x": 1.0}, stop=1.0, g=4.0, longest=0.03), PATIENCE)
    assert outcome.status is RunStatus.DISCARD
    assert outcome.messages == ()


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_for_co_simulation_only_has_no_model_exchange(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "RELAY", version, "CoSimulation")
    with pytest.raises(DescriptionError, match="offers Co-Simulation only"):
        worker.run(replace(run(path, {"x": 0.0}), interface="model-exchange"), PATIENCE)
