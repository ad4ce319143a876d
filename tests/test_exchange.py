"""Model exchange: against analytic responses, co-simulation, FMPy's own solver, and by FMUs with events of every sort."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from event_plants import KINDS, build_event_plant
from fault_plants import FAULTS, build_fault
from fmpy.validation import validate_fmu
from marks import first, in_turn
from test_workers import BANG, EXPECTED, PATIENCE, experiment, finished, two_masses

from fmus.build import FmiVersion, build
from fmus.stepping import Experiment, RunStatus
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail, TailTerm

VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
REST = Command(0.0, (), Tail(0.0))
JUMPS = [(0.0, 1.0, 0.0), (1.0026783, -2.0, 0.0), (2.1089, 2.0, 0.0), (3.2151217, -2.0, 0.0), (4.2178, 1.0, 0.0)]
EXACT = 2e-9
"""Of motions of size 1 to 10: three periods at a tolerance of 1e-10 a step (measured: 8e-10)."""


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def run(path: Path, state: dict[str, float], command: Command = REST, stop: float = 3.0, **more: float) -> Experiment:
    outputs = ("x", "v", "count")
    return Experiment(path, "u", outputs, more, 0.0, state, command, stop, 0.1, "model-exchange")


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("step", [2.0, 0.5, 0.013])
def test_jumps_are_exact_at_any_step(version: FmiVersion, step: float, worker: Worker) -> None:
    done = finished(worker.run(experiment(build("two_mass", version), step=step, interface="model-exchange"), PATIENCE))
    np.testing.assert_allclose(done.values, two_masses(done.times, JUMPS, 2.0), rtol=0.0, atol=EXACT)
    np.testing.assert_array_equal(done.input, BANG(done.times))


@pytest.mark.parametrize("version", VERSIONS)
def test_slopes_and_tails_are_evaluated_inside_the_right_hand_side(version: FmiVersion, worker: Worker) -> None:
    sloped = Command(3.0, (Segment(0.3, 0.0, 0.5), Segment(1.3, 0.5, -0.5), Segment(2.3, 0.0)), Tail(0.0))
    wanted = experiment(build("two_mass", version), command=sloped, step=0.1, interface="model-exchange")
    done = finished(worker.run(wanted, PATIENCE))
    exact = two_masses(done.times, [(0.3, 0.0, 0.5), (1.3, 0.0, -1.0), (2.3, 0.0, 0.5)], 2.0)
    np.testing.assert_allclose(done.values, exact, rtol=0.0, atol=7e-9)
    tailed = Command(1.0, (Segment(0.2, 1.0),), Tail(0.1, (TailTerm(-1.0 + 2.0j, 1, 0.75 + 0.5j),)))
    mine = finished(worker.run(replace(wanted, command=tailed), PATIENCE))
    theirs = finished(worker.run(replace(wanted, command=tailed, interface="co-simulation", step=0.01), PATIENCE))
    common = np.isin(theirs.times, mine.times)
    np.testing.assert_allclose(mine.values[np.isin(mine.times, theirs.times)], theirs.values[common], rtol=0.0, atol=7e-9)


def test_the_error_follows_the_tolerance(worker: Worker) -> None:
    errors = []
    for tolerance in (1e-6, 1e-8, 1e-10, 1e-12):
        wanted = experiment(build("two_mass"), step=0.1, interface="model-exchange", tolerance=tolerance)
        done = finished(worker.run(wanted, PATIENCE))
        errors.append(np.abs(done.values - two_masses(done.times, JUMPS, 2.0)).max())
    assert (np.array(errors) < [1e-4, 1e-6, 1e-8, 1e-9]).all(), errors
    assert (np.diff(errors) < 0.0).all()


def test_a_machine_of_micrometres_is_followed_as_well(worker: Worker) -> None:
    """Its states are a millionth of their nominal size of 1."""
    small = Command(4.2178, tuple(replace(s, level=1e-6 * s.level) for s in BANG.segments), Tail(0.0))
    done = finished(worker.run(experiment(build("two_mass"), command=small, step=0.5, interface="model-exchange"), PATIENCE))
    # The absolute tolerance, 1e-16, is now of the order of the relative one.
    np.testing.assert_allclose(1e6 * done.values, two_masses(done.times, JUMPS, 2.0), rtol=0.0, atol=2e-8)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_s_own_solver_agrees(version: FmiVersion, worker: Worker) -> None:
    """A step input from the start is what its loop can be trusted with."""
    path = build("two_mass", version)
    held = Command(0.0, (), Tail(1.0))
    done = finished(worker.run(experiment(path, command=held, step=0.5, stop=5.0, interface="model-exchange"), PATIENCE))
    theirs = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", stop_time=5.0, output_interval=0.5, relative_tolerance=1e-10,
        start_values={"stiffness": 2.0, "force": 1.0}, output=["position_2", "position_1", "spring"],
    )  # fmt: skip
    rows = np.column_stack([theirs[name] for name in ("position_2", "position_1", "spring")])
    np.testing.assert_allclose(theirs["time"], done.times)
    np.testing.assert_allclose(done.values, rows, rtol=0.0, atol=1e-7)  # their absolute tolerance is 1e-10 too, but of order 5 only


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_event_plants_pass_validation(kind: str, version: FmiVersion, tmp_path: Path) -> None:
    assert validate_fmu(str(build_event_plant(tmp_path, kind, version))) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_s_own_solver_finds_the_same_events(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "BALL", version)
    done = finished(worker.run(run(path, {"x": 1.0}, stop=1.5, g=9.81, e=0.7, slow=0.1), PATIENCE))
    theirs = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", stop_time=1.5, output_interval=0.1, relative_tolerance=1e-8, record_events=False,
        start_values={"x": 1.0, "g": 9.81, "e": 0.7, "slow": 0.1}, output=["x", "count"],
    )  # fmt: skip
    np.testing.assert_allclose(done.values[:, 0], theirs["x"], rtol=0.0, atol=1e-6)
    assert done.values[:, 2].tolist() == theirs["count"].tolist()


@pytest.mark.parametrize(
    ("fault", "version"), in_turn(sorted({*FAULTS} - {"flood", "fixed_step", "leak", "fill"}), quick=4)
)  # the last two: limits of the process, whatever runs in it
def test_every_fault_is_a_status_here_too(fault: str, version: FmiVersion, worker: Worker) -> None:
    timeout = 1.5 if fault == "hang" else PATIENCE
    finished(worker.run(experiment(build("two_mass"), interface="model-exchange"), PATIENCE))  # has loaded the integrator
    outcome = worker.run(experiment(build_fault(fault, version), interface="model-exchange"), timeout)
    assert outcome.status is EXPECTED[fault][0]
    assert outcome.trajectory is not None
    assert outcome.trajectory.times[-1] >= 0.5, "the rows before the fault are kept"
    assert np.isfinite(outcome.trajectory.values).all()
    finished(worker.run(experiment(build("two_mass"), interface="model-exchange"), PATIENCE))


def bounces(speed: float, g: float, e: float, slow: float) -> tuple[list[float], float]:
    """Instants of the impacts of a ball thrown up from the ground at `speed`, until it rests; and when that is."""
    time, found = 0.0, []
    while speed >= slow:
        time += 2.0 * speed / g
        found.append(time)
        speed *= e
    return found, time


@pytest.mark.parametrize("version", VERSIONS)
def test_a_ball_bounces_at_the_right_instants_and_rests(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "BALL", version)
    outcome = worker.run(run(path, {"x": 1e-9, "v": 4.0}, g=9.81, e=0.7, slow=0.1), PATIENCE)
    done = finished(outcome)
    impacts, resting = bounces(4.0, 9.81, 0.7, 0.1)
    assert done.values[-1, 2] == len(impacts) == 11
    seen = [float(line.text.split()[-2]) for line in outcome.messages if line.text.startswith("state event")]
    np.testing.assert_allclose(seen, impacts, rtol=0.0, atol=2e-9)  # the height of 1e-9 m that it starts from
    after = done.times > resting
    assert after.any()
    assert np.abs(done.values[after, :2]).max() < 1e-80, "it stays on the ground"
    for time, row in zip(done.times, done.values, strict=True):
        k = int(np.searchsorted(impacts, time))
        since, speed = time - ([0.0, *impacts][k]), 4.0 * 0.7**k
        if k < len(impacts):
            assert row[0] == pytest.approx(speed * since - 9.81 / 2 * since**2, abs=1e-8)
            assert row[2] == k


@pytest.mark.parametrize("version", VERSIONS)
def test_an_input_can_cause_a_state_event(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    """A resting ball is lifted as soon as a ramp of the input exceeds the weight: an indicator of the input alone."""
    ramp = Command(2.0, (Segment(0.0, 0.0, 2.0),), Tail(4.0))
    path = build_event_plant(tmp_path, "BALL", version)
    done = finished(worker.run(run(path, {"x": 1e-9, "v": -1e-3}, ramp, g=1.0, e=0.5, slow=0.1), PATIENCE))
    lifted = np.maximum(done.times - 0.5, 0.0)  # x'' = 2 t - 1 from 0.5 s on, until the ramp ends at 2 s
    before = done.times <= 2.0
    np.testing.assert_allclose(done.values[before, 0], lifted[before] ** 3 / 3.0, rtol=0.0, atol=5e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_hysteresis_is_a_triangle_of_the_right_period(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "RELAY", version)
    done = finished(worker.run(run(path, {"x": 0.0}, stop=10.05, g=1.0, e=0.5), PATIENCE))
    triangle = np.abs((done.times - 0.5) % 2.0 - 1.0) - 0.5  # falls at first, reversed at ±0.5
    np.testing.assert_allclose(done.values[:, 0], -triangle, rtol=0.0, atol=1e-9)
    assert done.values[-1, 2] == 10


@pytest.mark.parametrize("version", VERSIONS)
def test_time_events_happen_when_they_are_announced(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "CLOCK", version)
    for tick in (0.3, 0.07, 0.1):  # the last one coincides with the communication points
        done = finished(worker.run(run(path, {"x": 0.0}, g=tick), PATIENCE))
        ticks = np.arange(1, 60) * tick
        exact = np.maximum(done.times[:, None] - ticks, 0.0).sum(axis=1)  # x' is the number of ticks so far
        np.testing.assert_allclose(done.values[:, 0], exact, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_completed_step_can_ask_for_event_mode_and_for_the_end(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "KICK", version)
    outcome = worker.run(run(path, {"x": 1.0}), PATIENCE)
    done = finished(outcome)
    assert set(done.values[done.times <= 0.5, 0]) == {1.0}
    assert done.values[-1, 0] == 2.0
    assert sum(line.text.startswith("step event") for line in outcome.messages) == 1
    ended = worker.run(run(path, {"x": 1.0}, slow=1.7), PATIENCE)
    assert ended.status is RunStatus.TERMINATED
    assert ended.trajectory is not None
    assert ended.trajectory.times[-1] >= 1.7


@pytest.mark.parametrize("version", first(1, VERSIONS))
def test_an_event_can_end_the_run(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    outcome = worker.run(run(build_event_plant(tmp_path, "BALL", version), {"x": 1.0}, g=9.81, e=0.7, slow=-2.0), PATIENCE)
    assert outcome.status is RunStatus.TERMINATED
    assert outcome.trajectory is not None
    second = np.sqrt(2.0 / 9.81) * (1.0 + 2.0 * 0.7)
    assert outcome.trajectory.times[-1] == pytest.approx(second, abs=0.1)


@pytest.mark.parametrize("version", first(1, VERSIONS[::-1]))
def test_events_that_keep_time_from_going_on_end_the_run(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    """A clock that ticks every 0 seconds."""
    outcome = worker.run(run(build_event_plant(tmp_path, "CLOCK", version), {"x": 0.0}, g=0.0), PATIENCE)
    assert outcome.status is RunStatus.FAILED
    assert "time does not go on" in outcome.detail


@pytest.mark.parametrize("version", first(1, VERSIONS))
def test_a_discarded_evaluation_is_tried_with_shorter_steps(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "FUSSY", version)
    outcome = worker.run(run(path, {"x": 1.0}, g=4.0, e=3.0), PATIENCE)
    done = finished(outcome)
    np.testing.assert_allclose(done.values[:, 0], np.cos(2.0 * done.times), rtol=0.0, atol=1e-8)
    assert [line.level for line in outcome.messages] == ["discard"] * 3
    stubborn = worker.run(run(path, {"x": 1.0}, g=4.0, e=1e9), PATIENCE)
    assert stubborn.status is RunStatus.DISCARD
    assert stubborn.trajectory is not None
    assert stubborn.trajectory.times[-1] == pytest.approx(1.0, abs=0.1)
    assert 10 <= sum(line.level == "discard" for line in stubborn.messages) <= 50, "ten times at one point, and on the way there"


@pytest.mark.parametrize("version", first(1, VERSIONS[::-1]))
def test_derivatives_that_are_no_numbers_end_the_run(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    outcome = worker.run(run(build_event_plant(tmp_path, "FUSSY", version), {"x": 1.0}, g=4.0, slow=2.0), PATIENCE)
    assert outcome.status is RunStatus.NOT_FINITE
    assert "derivative of continuous state 2 is nan" in outcome.detail
    assert outcome.trajectory is not None
    assert outcome.trajectory.times[-1] == pytest.approx(2.0, abs=0.1)


def test_a_stiff_plant_is_noticed_and_solved(tmp_path: Path, worker: Worker) -> None:
    outcome = worker.run(run(build_event_plant(tmp_path, "STIFF", "3.0"), {"x": 1.0, "v": 0.0}, g=1e5), PATIENCE)
    done = finished(outcome)
    np.testing.assert_allclose(done.values[:, 0], np.exp(-done.times), rtol=0.0, atol=1e-8)
    assert [line.text.partition(" s ")[2] for line in outcome.messages] == [
        "the plant proves stiff: from here on by backward differentiation"
    ]


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_for_model_exchange_only_runs_without_being_asked(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = build_event_plant(tmp_path, "RELAY", version, "ModelExchange")
    done = finished(worker.run(replace(run(path, {"x": 0.0}, g=1.0, e=0.5), interface=None), PATIENCE))
    assert done.values[-1, 2] == 3
