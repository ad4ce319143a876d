"""Operating points other than the start: given, reached by settling, checked for rest; and FMUs that fail on the way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_fmus import linear_fmu, made_fmu, steps_only

from fmus.archives import Fmu, open_archive
from fmus.build import FmiVersion, build
from fmus.errors import LinearizationError
from fmus.linearization import linearize
from fmus.settling import rest
from fmus.stepping import Experiment, RunStatus
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail, TailTerm

G, F = 9.81, 0.4
PENDULUM = """
void plant_derivatives(Plant *p) { p->der_angle = p->speed; p->der_speed = -p->gravity * sin(p->angle) - p->friction * p->speed + p->u; }
void plant_outputs(Plant *p) { p->y = sin(p->angle); }
"""
TANGENT = """
void plant_tangent(const Plant *p, Plant *d) {
    d->der_angle = d->speed;
    d->der_speed = -p->gravity * SLOPE * d->angle - p->friction * d->speed + d->u;
    d->y = cos(p->angle) * d->angle;
}
"""


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def pendulum(tangent: str | None = None, version: FmiVersion = "3.0") -> Fmu:
    """With the slope of sin(angle) that its directional derivatives use; without them if that is None."""
    equations = PENDULUM if tangent is None else PENDULUM + TANGENT.replace("SLOPE", tangent)
    extra = "" if tangent is None else "tangent = true"
    parameters = {"gravity": G, "friction": F}
    return open_archive(made_fmu("pendulum", equations, {"angle": 0.0, "speed": 0.0}, parameters=parameters, extra=extra, version=version))


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("torque", [0.0, 4.905, -9.0])
@pytest.mark.parametrize("tangent", [None, "cos(p->angle)"])
def test_a_given_operating_point_in_closed_form(tangent: str | None, torque: float, version: FmiVersion, worker: Worker) -> None:
    angle = math.asin(torque / G)
    found = linearize(pendulum(tangent, version), "u", "y", initial_state={"angle": angle}, initial_input=torque, worker=worker)
    found.require_rest("pendulum")
    slope = math.cos(angle)
    expected = np.array([[0.0, 1.0, 0.0], [-G * slope, -F, 1.0], [slope, 0.0, 0.0]])
    matrix = np.block([[found.A, found.B[:, None]], [found.C[None, :], np.array([[found.D]])]])
    # Differences of a sine are good for ε^(2/3) or so, and their own estimate says how good.
    assert (np.abs(matrix - expected) <= (1e-14 if tangent else 1e-9)).all()
    assert (np.abs(matrix - expected) <= found.uncertainty + 1e-16).all()
    (pole,) = found.plant("y").plant.poles
    assert pole.value == pytest.approx(complex(-F / 2, math.sqrt(G * slope - F * F / 4)), rel=1e-9)


def test_an_operating_point_that_is_reached(worker: Worker) -> None:
    found = linearize(pendulum(), "u", "y", initial_input=4.905, settle=math.inf, worker=worker)
    found.require_rest("pendulum")
    assert found.x.tolist() == pytest.approx([math.pi / 6, 0.0], abs=2e-9)
    assert found.A[1, 0] == pytest.approx(-G * math.cos(math.pi / 6), rel=1e-8)
    assert 90.0 < found.settled < 130.0  # e^(-0.2 t) is a billionth after 104 s
    waited = linearize(pendulum(), "u", "y", initial_input=4.905, settle=150.0, worker=worker)
    assert waited.settled == 150.0
    assert waited.x.tolist() == pytest.approx([math.pi / 6, 0.0], abs=1e-11)


def test_a_point_that_is_no_rest_is_refused_and_the_nearest_one_told(worker: Worker) -> None:
    moving = linearize(pendulum(), "u", "y", initial_state={"angle": 0.5}, initial_input=4.905, worker=worker)
    with pytest.raises(LinearizationError, match=r"'speed' is 0\.20183\d?, .*nearest rest is about angle = 0\.52344") as refused:
        moving.require_rest("pendulum.fmu")
    assert refused.value.status is None, "the request is wrong, not the FMU"
    early = linearize(pendulum(), "u", "y", initial_input=4.905, settle=3.0, worker=worker)
    with pytest.raises(LinearizationError, match=r"pendulum\.fmu is not at rest after settling"):
        early.require_rest("pendulum.fmu")
    nearly = linearize(pendulum(), "u", "y", initial_state={"angle": 0.52359878}, initial_input=4.905, worker=worker)
    nearly.require_rest("pendulum.fmu")  # eight digits are good enough, and the imbalance says how good
    assert 1e-10 < nearly.imbalances.max() < 1e-8


@pytest.mark.slow
def test_an_input_with_which_nothing_rests(worker: Worker) -> None:
    drive = open_archive(linear_fmu("drive", [[0.0, 1.0], [0.0, 0.0]], [0.0, 1.0], [1.0, 0.0]))
    with pytest.raises(LinearizationError, match="rests nowhere near: give another input"):
        linearize(drive, "u", "y", initial_input=2.0, worker=worker).require_rest("drive.fmu")
    with pytest.raises(LinearizationError, match=r"does not come to rest with input 2\.0"):
        linearize(drive, "u", "y", initial_input=2.0, settle=math.inf, worker=worker)


def test_a_state_that_only_counts_is_no_unrest(worker: Worker) -> None:
    """A clock, or the energy used so far, moves for ever and moves nothing."""
    equations = (
        "void plant_derivatives(Plant *p) { p->der_x = p->u - p->x; p->der_clock = 1.0; }\nvoid plant_outputs(Plant *p) { p->y = p->x; }"
    )
    found = linearize(open_archive(made_fmu("clock", equations, {"x": 0.0, "clock": 0.0})), "u", "y", worker=worker)
    assert found.rates.tolist() == [0.0, 1.0]
    found.require_rest("clock.fmu")
    assert found.plant("y").plant.order == 1


def test_derivatives_that_are_wrong_are_found_out(worker: Worker) -> None:
    wrong = pendulum("1.01 * cos(p->angle)")
    found = linearize(wrong, "u", "y", worker=worker)
    assert found.method == "finite differences"
    assert "differ from differences of its own equations by 0.0099 of" in found.notes[0]
    assert found.A[1, 0] == pytest.approx(-G, rel=1e-9)
    believed = linearize(wrong, "u", "y", method="derivatives", worker=worker)
    assert believed.A[1, 0] == -1.01 * G
    assert "0.0099 of the largest entry" in believed.notes[0]


def test_methods_that_an_fmu_does_not_offer(tmp_path: Path, worker: Worker) -> None:
    with pytest.raises(LinearizationError, match="no directional derivatives; differences and identified are possible"):
        linearize(pendulum(), "u", "y", method="derivatives", worker=worker)
    silent = open_archive(steps_only(pendulum().path, tmp_path / "silent.fmu"))
    with pytest.raises(LinearizationError, match="no directional derivatives; identified is possible"):
        linearize(silent, "u", "y", method="derivatives", worker=worker)
    with pytest.raises(LinearizationError, match="no Model Exchange, which differences need; it can be identified"):
        linearize(silent, "u", "y", method="differences", worker=worker)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_derivatives_of_co_simulation_at_a_settled_point(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    path = pendulum("cos(p->angle)", version).path
    stepping = open_archive(steps_only(path, tmp_path / "stepping.fmu", derivatives=True))
    found = linearize(stepping, "u", "y", initial_input=4.905, settle=150.0, worker=worker)
    assert (found.method, found.settled) == ("directional derivatives", 150.0)
    assert found.A.tolist() == [[0.0, 1.0], [pytest.approx(-G * math.cos(math.pi / 6), rel=1e-11), -F]]
    assert found.rates.tolist() == pytest.approx([0.0, 0.0], abs=1e-11)


CRASHING = """
void plant_derivatives(Plant *p) { if (fabs(p->x) > LIMIT) FAULT; p->der_x = p->u - 2.0 * p->x; }
void plant_outputs(Plant *p) { p->y = p->x; }
"""


def crashing(limit: float, fault: str) -> Fmu:
    return open_archive(made_fmu("crashing", CRASHING.replace("LIMIT", repr(limit)).replace("FAULT", fault), {"x": 0.0}))


@pytest.mark.parametrize(("fault", "timeout"), [("abort()", 60.0), ("exit(0)", 60.0), ("for (;;) {}", 1.0)])
def test_an_fmu_that_crashes_a_little_way_off_is_linearised_by_smaller_steps(fault: str, timeout: float, worker: Worker) -> None:
    found = linearize(crashing(1e-3, fault), "u", "y", timeout=timeout, worker=worker)
    assert found.A.tolist() == [[pytest.approx(-2.0, rel=1e-10)]]
    assert "only smaller steps were taken" in found.notes[0]


def test_an_fmu_that_crashes_wherever_it_is_moved_is_survived(worker: Worker) -> None:
    with pytest.raises(LinearizationError, match=r"cannot be linearised: the FMU crashed its process: SIGABRT") as failed:
        linearize(crashing(0.0, "abort()"), "u", "y", worker=worker)
    assert failed.value.status is RunStatus.CRASHED
    assert linearize(pendulum(), "u", "y", worker=worker).method == "finite differences", "the next one works"


def test_a_domain_that_ends_is_no_crash(worker: Worker) -> None:
    """Beyond it the FMU gives NaN, which is no number to take a difference of."""
    found = linearize(crashing(1e-3, "{ p->der_x = 0.0 / 0.0; return; }"), "u", "y", worker=worker)
    assert found.A.tolist() == [[pytest.approx(-2.0, rel=1e-12)]]
    assert found.notes == ()


# Runs that settle first


def experiment(path: Path, **changes: Any) -> Experiment:
    command = Command(2.0, (Segment(0.25, 1.0), Segment(1.1, -1.0), Segment(1.9, 0.4)), Tail(0.5))
    usual = Experiment(path, "u", ("y",), {}, 0.5, {}, command, stop=6.0, step=0.25)
    return replace(usual, **changes)


MORTAL = """
void plant_derivatives(Plant *p) { p->der_x = p->u - p->x; }
void plant_outputs(Plant *p) { p->y = p->x; }
PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    return p->time > 3.0 ? PLANT_FATAL : PLANT_OK;
}
"""
LAGGING = ([[-2.0, 1.0], [0.0, -3.0]], [0.0, 3.0], [2.0, 0.0])  # y → u at rest


@pytest.mark.parametrize("settle", [20.0, 17.9, math.inf])
def test_a_run_that_settles_first_begins_at_rest(settle: float, worker: Worker) -> None:
    """The same as a run from that state, at the same times, jumps included."""
    path = linear_fmu("lagging", *LAGGING)
    settled = worker.run(experiment(path, settle=settle), 60.0).trajectory
    given = worker.run(experiment(path, initial_state={"x1": 0.25, "x2": 0.5}), 60.0).trajectory
    assert settled is not None
    assert given is not None
    np.testing.assert_array_equal(settled.times, given.times)
    np.testing.assert_array_equal(settled.input, given.input)
    np.testing.assert_allclose(settled.values, given.values, rtol=0.0, atol=1e-8)  # e^(-2·9) and less is left


@pytest.mark.parametrize(
    "command",
    [
        Command(1.0, (Segment(0.0, 1.0),), Tail(0.5)),
        Command(0.0, (), Tail(0.0, (TailTerm(-1.0 + 0.0j, 0, 0.7 + 0.0j),))),
    ],
)
def test_commands_of_every_form_can_wait(command: Command, worker: Worker) -> None:
    path = linear_fmu("lagging", *LAGGING)
    settled = worker.run(experiment(path, command=command, settle=25.0), 60.0).trajectory
    given = worker.run(experiment(path, command=command, initial_state={"x1": 0.25, "x2": 0.5}), 60.0).trajectory
    assert settled is not None
    assert given is not None
    np.testing.assert_allclose(settled.input, given.input, rtol=1e-12)
    np.testing.assert_allclose(settled.values, given.values, rtol=0.0, atol=1e-9)


def test_a_run_that_breaks_off_while_settling_has_nothing_to_show(worker: Worker) -> None:
    path = made_fmu("mortal", MORTAL, {"x": 0.0}, extra="step_hook = true")
    outcome = worker.run(experiment(path, settle=5.0), 60.0)
    assert (outcome.status, outcome.trajectory) == (RunStatus.FATAL, None)
    assert "while settling for 5 s" in outcome.detail
    with pytest.raises(LinearizationError, match="broke off while it settled"):
        rest(worker, open_archive(path), experiment(path, settle=5.0), 60.0)
    later = worker.run(experiment(path, settle=1.0), 60.0)
    assert later.status is RunStatus.FATAL
    assert later.trajectory is not None
    assert 1.9 < later.trajectory.times[-1] <= 2.25


def test_the_shipped_plant_rests_where_it_starts(worker: Worker) -> None:
    path = build("two_mass")
    point = Experiment(path, "force", ("position_2",), {}, 0.0, {}, Command(0.0, (), Tail(0.0)), 1.0, 0.05, settle=math.inf)
    time, values = rest(worker, open_archive(path), point, 60.0)
    assert time == 0.05
    assert set(values.values()) == {0.0}
