"""One command on one FMU, apart from any study: simulated, measured, logged, and on demand refined until the order of the error shows."""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from fmus.descriptions import Description
from fmus.plans import Misfit, grid_step, interface_of
from fmus.stepping import Experiment, Interface, LogLine, Outcome, RunStatus, samples
from fmus.workers import Worker
from relaxations.commands import Command
from relaxations.errors import PlantError
from relaxations.plants import LinearPlant
from relaxations.response import response
from reports import files, logs
from suite import schema
from suite.campaign import measure, natural_step
from suite.errors import Mistake, SuiteError
from suite.observations import Channel, Setting, Subject, observe, record, thinned, with_verdict
from suite.plants import linear_plant
from suite.quantities import Facts, window
from suite.quantity_names import Quantity
from suite.rounding import number
from suite.sources import read_command
from suite.study import FmuPlant, Plant
from suite.study_plant import open_plant, understand_plant
from suite.study_units import plain_values
from suite.values import number as sane
from suite.verdicts import Measured, Verdict

REFINEMENTS = 4  # of a convergence study
LOOSE = 1e-7  # tolerance at which that of model exchange begins
ROUNDING = 1e-13  # of the largest output: changes below this say nothing about an order


class SimulationError(SuiteError):
    """The FMU, the command file or a name in the request cannot be used."""


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked: names as on the command line; None: chosen from the FMU and the command. Times in seconds.

    Parameters are numbers in the FMU's units, or carry one ("500 N/km").
    """

    fmu: str
    command: Path
    input: str
    output: str
    parameters: Mapping[str, Decimal | str]
    stop: float | None = None
    step: float | None = None
    interface: Interface | None = None
    timeout: float = 60.0


@dataclass(frozen=True, slots=True)
class Refinement:
    """One row of a convergence study: the output changes by at most `change` when `step` [s] and `tolerance` are refined.

    `order` is that of the error in the step (co-simulation) or in the tolerance (model exchange), None where rounding hides it.
    """

    step: float
    tolerance: float | None
    change: float
    order: float | None


@dataclass(frozen=True, slots=True)
class Simulated:
    """What came of it. `measured` holds final output, residual after the end (both output units) and peak input, each with its error."""

    status: RunStatus
    detail: str
    measured: Mapping[str, Measured]
    units: tuple[str, str]  # of input and output
    interface: Interface
    step: float
    stop: float
    points: int
    messages: tuple[LogLine, ...]
    convergence: tuple[Refinement, ...]
    log: Path | None

    def to_dict(self) -> dict[str, object]:
        """The object of `simulate --json` (docs/schemas.md)."""
        table = [{"step": r.step, "tolerance": r.tolerance, "change": r.change, "order": r.order} for r in self.convergence]
        return {
            "status": self.status.name.lower(),
            "detail": self.detail,
            "quantities": {name: {"value": number(value.value), "error": number(value.error)} for name, value in self.measured.items()},
            "interface": self.interface,
            "step": self.step,
            "stop": self.stop,
            "points": self.points,
            "messages": len(self.messages),
            "convergence": table or None,
            "log": None if self.log is None else str(self.log),
        }


def simulate(asked: Request, log: Path | None = None, convergence: bool = False) -> Simulated:
    """Simulate in a process of its own; the run's log is written to `log`, as far as it got.

    Raises `SimulationError` for a request that cannot be carried out, before anything is run.
    """
    command = read_command(asked.command)
    plant, fmu = _plant(asked)
    has = fmu.archive.description
    try:
        grid = grid_step(has, asked.interface, asked.step)
    except Misfit as problem:
        raise SimulationError(f"{fmu.archive.path.name}: {problem}") from None
    if convergence and grid is not None:
        raise SimulationError(f"{fmu.archive.path.name} takes communication steps of {grid!r} s only: there is nothing to refine")
    linear = _linear(plant)
    setting = _setting(asked, command, plant, fmu, linear, grid)
    subject = _subject(asked, command, plant, fmu)
    experiment = Experiment(
        fmu=fmu.archive.path,
        input=asked.input,
        outputs=subject.variables,
        parameters={name: float(value) for name, value in fmu.parameters.items()},
        initial_input=setting.facts.rest_input,
        initial_state={},
        command=command,
        stop=setting.stop,
        step=setting.step,
        interface=asked.interface,
    )
    if log is not None:
        files.ready(log)
    with Worker() as worker:
        outcome = worker.run(experiment, asked.timeout)
        finer = worker.run(experiment.refined(), asked.timeout) if grid is None and outcome.status.complete else outcome
        if outcome.status.complete and not finer.status.complete:
            outcome = replace(outcome, status=finer.status, detail=f"with half the communication step: {finer.detail}")
        done = outcome.status.complete
        exchange, column = setting.interface == "model-exchange", subject.variables.index(asked.output)
        table = tuple(_refinements(worker, experiment, exchange, column, asked.timeout)) if convergence and done else ()
    setting, whole = _log(subject, setting, outcome, linear)
    measured: dict[str, Measured] = {}
    if done:
        run = observe(whole)
        wanted = [Quantity("final", variable=asked.output), *([Quantity("residual_vibration")] if run.after.any() else [])]
        other = thinned(run) if grid is not None else observe(_log(subject, setting, finer, linear)[1])
        measured = measure(run, other, [*wanted, Quantity("peak_input")])
    if log is not None:
        logs.write_log(log, with_verdict(whole, Verdict.PASS if done else Verdict.ERROR, measured))
    return Simulated(
        outcome.status,
        outcome.detail,
        measured,
        (plant.input_unit, plant.output_unit),
        setting.interface,
        setting.step,
        setting.stop,
        0 if outcome.trajectory is None else len(outcome.trajectory.times),
        outcome.messages,
        table,
        log,
    )


def _plant(asked: Request) -> tuple[Plant, FmuPlant]:
    unopened: list[Mistake] = []  # told again where the plant is understood

    def describe() -> Description | None:
        fmu = open_plant(asked.fmu, Path(), unopened)
        return None if fmu is None else fmu.description

    parameters, wrong = plain_values(asked.parameters, describe)
    for name, value in parameters.items():
        try:
            if isinstance(value, Decimal):
                sane(value)
        except ValueError as problem:
            wrong.append(Mistake(f"plant.parameters.{name}", value, str(problem)))
            parameters[name] = Decimal(0)
    written = schema.Plant(fmu=asked.fmu, input=asked.input, output=asked.output, parameters=parameters or None)
    plant, _, mistakes = understand_plant(written, Path())
    told = {mistake.path for mistake in wrong}
    mistakes = [*wrong, *(mistake for mistake in mistakes if mistake.path not in told)]
    if mistakes or plant is None or plant.fmu is None:
        raise SimulationError("\n".join(str(mistake).removeprefix("plant.") for mistake in mistakes))
    return plant, plant.fmu


def _linear(plant: Plant) -> LinearPlant | None:
    """The linear plant if there is one: without, nothing is known of modes."""
    try:
        return linear_plant(plant)
    except PlantError:
        return None


def _setting(asked: Request, command: Command, plant: Plant, fmu: FmuPlant, linear: LinearPlant | None, grid: float | None) -> Setting:
    modes = tuple((pole.natural_frequency, pole.damping_ratio) for pole in linear.flexible) if linear else ()
    rates = tuple(pole.value.real for pole in linear.real) if linear else ()
    observed, slowest, decayed = window(modes, rates, command.maneuver_time)
    stop = asked.stop or command.end + (observed or 1.0)
    step = asked.step or natural_step([frequency for frequency, _ in modes], stop)
    if grid is not None:
        step, stop = grid, samples(stop, grid) * grid
    seen = stop - command.end
    if slowest is not None and seen < slowest:
        slowest = None  # not one period is seen: the last value stands for the rest
    facts = Facts(1.0, float(plant.initial_input), 0.0, modes, slowest, decayed and seen >= observed)
    used: Interface = "co-simulation"
    if interface_of(fmu.archive.description.capabilities, asked.interface) == "model_exchange":
        used = "model-exchange"
    return Setting("simulation", True, {}, facts, step, stop, used)


def _subject(asked: Request, command: Command, plant: Plant, fmu: FmuPlant) -> Subject:
    has = fmu.archive.description

    def channel(name: str) -> Channel:
        variable = has.find(name)
        return Channel(name, variable.unit, variable.causality)

    outputs = [name for name in dict.fromkeys([asked.output, *has.names("output")]) if has.find(name).is_real]
    return Subject(
        version=importlib.metadata.version("slewcert"),
        study_sha256="",
        fmu_sha256=fmu.archive.sha256,
        binary_sha256=fmu.archive.binary_sha256(interface_of(has.capabilities, asked.interface)),
        command=command,
        limits=(math.nan, math.nan),
        input=channel(asked.input),
        output=channel(asked.output),
        outputs=tuple(map(channel, outputs)),
        states=tuple(channel(name) for name, _ in has.states if has.find(name).is_real),
        requirements=(),
        attachments={"modelDescription.xml": fmu.archive.description_xml},
    )


def _log(subject: Subject, setting: Setting, outcome: Outcome, linear: LinearPlant | None) -> tuple[Setting, logs.RunLog]:
    trajectory = outcome.trajectory
    if trajectory is None:
        return setting, record(subject, setting, outcome, None)
    rest = float(trajectory.values[0, subject.variables.index(subject.output.variable)])
    setting = replace(setting, facts=replace(setting.facts, rest_output=rest))
    course = None if linear is None else rest + response(linear, subject.command, trajectory.times, rest=setting.facts.rest_input)
    return setting, record(subject, setting, outcome, course)


def _refinements(worker: Worker, experiment: Experiment, exchange: bool, column: int, timeout: float) -> Iterator[Refinement]:
    before: Outcome | None = None
    change, coarse = math.nan, replace(experiment, tolerance=LOOSE)
    for fine in _refined(coarse):
        outcome = worker.run(fine, timeout)
        if outcome.trajectory is None or not outcome.status.complete:
            return
        if before is not None and before.trajectory is not None:
            _, old, new = np.intersect1d(before.trajectory.times, outcome.trajectory.times, assume_unique=True, return_indices=True)
            last, values = change, outcome.trajectory.values[:, column]
            change = float(np.abs(before.trajectory.values[old, column] - values[new]).max())
            visible = change > ROUNDING * float(np.abs(values).max())
            base = coarse.tolerance / fine.tolerance if exchange else coarse.step / fine.step
            order = math.log(last / change) / math.log(base) if visible and math.isfinite(last) else None
            yield Refinement(coarse.step, coarse.tolerance if exchange else None, change, order)
        before, coarse = outcome, fine


def _refined(experiment: Experiment) -> Iterator[Experiment]:
    for _ in range(REFINEMENTS + 1):
        yield experiment
        experiment = experiment.refined()
