"""Runs FMUs in a child process that may crash, exit, hang or print as it likes.

The parent owns the folder that the FMU is unpacked to, the clock and the process; the child (`fmus.isolated`) only drives
the FMU. Every way to fail is a `RunStatus`; bad input (no such variable, no binary for this machine) raises `FmuError`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from fmus.archives import Fmu, open_archive
from fmus.assignments import assignments, typed
from fmus.children import Answer, Child
from fmus.confinement import Confinement
from fmus.descriptions import Description
from fmus.errors import FmuError, LinearizationError
from fmus.plans import Misfit, Plan, plan
from fmus.rows import Rows
from fmus.settling import preceded, rest, trimmed
from fmus.stepping import Experiment, LogLine, Outcome, RunStatus, Trajectory
from fmus.variables import Value

RECYCLE = 500  # runs after which a child is replaced, so that what an FMU leaks stays bounded; costs 0.1 ms a run
PLANS = 4  # that are kept for the next run


class Worker:
    """One child process, kept alive from run to run and replaced after any failure. Not for several threads at once.

    with Worker() as worker:
        outcome = worker.run(experiment, timeout=60.0)
    """

    def __init__(self, confinement: Confinement | None = None) -> None:
        """No process is started before the first run; `confinement` limits it (None: the usual limits)."""
        self._confinement = confinement
        self._child: Child | None = None
        self._opened: dict[Path, tuple[tuple[int, int], Fmu]] = {}
        self._plans: dict[object, tuple[Description, Plan]] = {}

    def run(self, experiment: Experiment, timeout: float) -> Outcome:
        """Simulate; `timeout` [s] of wall-clock time covers loading, initialisation and all steps.

        Raises `FmuError` for bad input: no such FMU, variable or binary, a number that is not finite.
        """
        began = time.perf_counter()
        e, fmu = experiment, self._open(experiment.fmu)
        if experiment.settle:
            wait = experiment.settle if math.isfinite(experiment.settle) else rest(self, fmu, experiment, timeout)[0]
            experiment = replace(experiment, settle=wait)
            return trimmed(self.run(preceded(experiment), timeout), experiment)
        capabilities = fmu.description.capabilities
        try:
            planned = self._plan(fmu, e)
        except Misfit as problem:
            return Outcome(RunStatus.FAILED, f"{fmu.path.name}: {problem}", None, time.perf_counter() - began)
        request = _request(fmu, "run", planned.interface, e.input, e.outputs, e.parameters, e.initial_state, e.initial_input)
        request |= planned.request
        with self._ready(fmu) as child:
            child.rows.begin(len(planned.times), len(experiment.outputs))
            request["progress"], request["loop"] = child.rows.path, child.loop
            answer = child.ask(request, planned.columns, timeout)
            outcome = _outcome(answer, child.rows, planned, e.outputs, time.perf_counter() - began)
            if not outcome.status.complete:
                child.stop()
        if outcome.status is RunStatus.FAILED and capabilities.needs_execution_tool:
            return replace(outcome, detail=f"{outcome.detail} (this FMU needs its execution tool, {fmu.description.tool or 'unnamed'})")
        return outcome

    def jacobian(self, fmu: Fmu, experiment: Experiment, settings: Mapping[str, Any], timeout: float) -> dict[str, Any]:
        """The raw answer of the child to a linearisation (`fmus.jacobians`); raises `LinearizationError`.

        `settings`: `interface`, `directional` and `differences` (which methods), `largest` (step of the differences), and the operating
        point: `state` at `time` in model exchange, `settle` (number and size of steps) in co-simulation.
        """
        e, has = experiment, fmu.description.resized(experiment.parameters)
        request = _request(fmu, "linearize", settings["interface"], e.input, e.outputs, e.parameters, e.initial_state, e.initial_input)
        request |= {
            **settings,
            "stop": None,
            "states": [typed(has.find(name)) for name in has.state_names],
            "derivatives": [typed(has.find(name)) for name in has.rate_names],
            "names": [*has.state_names, e.input],
        }
        with self._ready(fmu) as child:
            answer = child.ask(request, b"", timeout)
            if answer.status is not RunStatus.FINISHED:
                child.stop()
                raise LinearizationError(f"{fmu.path.name} cannot be linearised: {answer.status.value}: {answer.detail}", answer.status)
        return answer.reply

    def close(self) -> None:
        """End the child and remove its folder; may be called from another thread, whose run then ends as if the FMU had crashed."""
        child, self._child = self._child, None
        if child is not None:
            child.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _plan(self, fmu: Fmu, e: Experiment) -> Plan:
        """The plan, which is the same for all runs of a campaign but their refinements."""
        key = e.input, e.initial_input, e.command, e.stop, e.step, e.interface, e.tolerance
        about, known = self._plans.pop(key, (None, None))
        if known is None or about is not fmu.description:
            known = plan(fmu.description, e)
        self._plans[key] = fmu.description, known
        if len(self._plans) > PLANS:
            del self._plans[next(iter(self._plans))]
        return known

    def _open(self, path: Path) -> Fmu:
        try:
            state = path.stat()
        except OSError:
            return open_archive(path)  # which says what is wrong
        stamp = state.st_mtime_ns, state.st_size
        known = self._opened.get(path)
        if known is None or known[0] != stamp:
            known = self._opened[path] = stamp, open_archive(path)
        return known[1]

    @contextmanager
    def _ready(self, fmu: Fmu) -> Iterator[Child]:
        """A child that has this FMU unpacked; ended if anything is raised while it works."""
        child = self._child
        once = fmu.description.capabilities.once_per_process
        if child is not None and (not child.alive or child.runs >= RECYCLE or (once and child.runs)):
            self.close()
        child = self._child = self._child if self._child is not None else Child(self._confinement)
        try:
            child.unpack(fmu)
            child.runs += 1
            yield child
        except BaseException:
            self.close()
            raise


def simulate(experiment: Experiment, timeout: float = 60.0) -> Outcome:
    """One run in a child process of its own."""
    with Worker() as worker:
        return worker.run(experiment, timeout)


def _outcome(answer: Answer, rows: Rows, planned: Plan, outputs: tuple[str, ...], seconds: float) -> Outcome:
    times, width = planned.times, len(outputs)
    count, content = rows.content()
    count = min(max(count, 0), len(times))  # a wild FMU may have written over it
    values = np.frombuffer(content, dtype=float)[: count * width].reshape(count, width)
    status, detail = answer.status, answer.detail
    if status in (RunStatus.HUNG, RunStatus.MEMORY, RunStatus.CRASHED, RunStatus.EXITED):
        detail += f", after {times[count - 1]:.9g} s" if count else ", before the first point"
    finite = np.isfinite(values)
    if not finite.all():
        count, column = (int(i) for i in np.argwhere(~finite)[0])
        status, detail = RunStatus.NOT_FINITE, f"{outputs[column]} is {values[count, column]} at {times[count]:.9g} s"
    messages = [LogLine(*m) for m in answer.messages]
    last = float(times[max(count - 1, 0)])
    messages += [LogLine(last, "output", line) for line in answer.printed.splitlines() if line.strip()]
    kept, logged = tuple(messages), planned.logged[planned.logged < count]
    trajectory = Trajectory(times[logged], planned.applied[logged], values[logged], kept) if count else None
    return Outcome(status, detail, trajectory, seconds, kept)


def _request(
    fmu: Fmu,
    kind: str,
    interface: str,
    input: str,
    outputs: tuple[str, ...],
    parameters: Mapping[str, Value],
    initial_state: Mapping[str, float],
    initial_input: float,
) -> dict[str, Any]:
    description = fmu.description.resized(parameters)
    if not outputs:
        raise FmuError("name at least one output to log")
    return {
        "kind": kind,
        "sha256": fmu.sha256,
        "fmi": description.major,
        "library": fmu.require_platform(interface),
        "token": description.guid,
        "name": getattr(description.capabilities, interface),
        "log_categories": description.log_categories,
        "tolerance": description.default_tolerance,
        "outputs": [typed(description.readable(name)) for name in outputs],
        **assignments(description, parameters, initial_state, input, initial_input),
    }
