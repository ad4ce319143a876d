"""Benchmarks of runs: an aligned run against FMPy's `simulate_fmu`, and what a run costs before its first step. Times are never judged.

pytest -m benchmark tests/benchmarks/test_fmus_speed.py -s
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu

from fmus import compiled
from fmus.build import FmiVersion, build
from fmus.stepping import Experiment
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail

pytestmark = pytest.mark.benchmark
STEPS, STEP = 20_000, 1e-3
OUTPUTS = ("position_2", "position_1", "spring")
ALLOWED = 0.3e-3  # s of fixed cost that a run may have
PATIENCE = 60.0


def times(actions: list[Callable[[], object]], rounds: int) -> list[float]:
    """The least wall-clock seconds of each action, by turns, so that other work on the machine meets all of them."""
    taken = [[] for _ in actions]
    for _ in range(rounds):
        for seconds, action in zip(taken, actions, strict=True):
            begun = time.perf_counter()
            action()
            seconds.append(time.perf_counter() - begun)
    return [min(seconds) for seconds in taken]


def experiment(fmu: Path) -> Experiment:
    move = Command(8.0, (Segment(0.0, 1.0), Segment(4.0, -1.0)), Tail(0.0))
    return Experiment(fmu, "force", OUTPUTS, {"stiffness": 2.0}, 0.0, {}, move, stop=STEPS * STEP, step=STEP)


@pytest.fixture(params=["compiled", "ctypes"])
def worker(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    compiled.build()
    if request.param == "ctypes":
        monkeypatch.setattr(compiled, "found", lambda: None)
    with Worker() as one:
        yield one


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_aligned_run_against_simulate_fmu_and_its_fixed_cost(version: FmiVersion, worker: Worker, tmp_path: Path) -> None:
    path = build("two_mass", version)
    extract(str(path), unzipdir=str(tmp_path))
    description = read_model_description(str(tmp_path))
    instance = instantiate_fmu(str(tmp_path), description, "CoSimulation")
    # Rows exactly at the jumps, the value after them: what it needs to be right, with the jumps on communication points.
    signal = np.array([(0.0, 1.0), (4.0, 1.0), (4.0, -1.0), (8.0, -1.0), (8.0, 0.0)], dtype=[("time", float), ("force", float)])

    def theirs() -> np.ndarray:
        instance.reset()  # type: ignore[union-attr]
        return simulate_fmu(
            str(tmp_path),
            model_description=description,
            fmu_instance=instance,
            fmi_type="CoSimulation",
            stop_time=STEPS * STEP,
            step_size=STEP,
            output_interval=STEP,
            input=signal,
            output=list(OUTPUTS),
            start_values={"stiffness": 2.0},
        )

    asked = experiment(path)
    one = replace(asked, command=Command(0.0, (), Tail(1.0)), stop=1e-6, step=1e-6)  # a step that takes the FMU no time
    result, outcome = theirs(), worker.run(asked, PATIENCE)
    assert outcome.trajectory is not None
    assert len(outcome.trajectory.times) == STEPS + 1
    assert outcome.trajectory.values[-1, 0] == pytest.approx(result["position_2"][-1], abs=1e-6)

    reference, ours = times([theirs, lambda: worker.run(asked, PATIENCE)], 7)
    (fixed,) = times([lambda: worker.run(one, PATIENCE)], 500)
    loop = "compiled" if worker._child is not None and worker._child.loop else "ctypes"
    print(
        f"\nFMI {version}, {loop} loop, {STEPS} steps, {len(OUTPUTS)} outputs: {1e6 * (ours - fixed) / STEPS:.2f} µs a step, simulate_fmu "
        f"{1e6 * reference / STEPS:.2f} µs: {ours / reference:.3f} of it (at most 0.2 is wanted)\n"
        f"a run of one step on a live process: {1e3 * fixed:.3f} ms: {fixed / ALLOWED:.2f} of what it may cost"
    )
