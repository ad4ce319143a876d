"""Between a run and its log, in both directions: what is judged live is read back from the very record that is written.

Nothing reaches a quantity that is not in the log, so a reviewer who has only the log computes the same numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fmus.stepping import Interface, Outcome
from relaxations.commands import Command
from reports.records import Message, RunLog, Signal, field_names
from suite.quantities import Facts, Observation
from suite.quantity_names import parse_quantity
from suite.study import Requirement
from suite.verdicts import Measured, Verdict

Reals = NDArray[np.float64]

COMMAND, INPUT, OUTPUT, STATE, LINEAR, LIMITS = "/command/u", "/plant/input", "/plant/output", "/plant/state", "/linear/output", "/limits"
COMMAND_FILE = "command.json"
LEVELS = {"ok": "info", "warning": "warning", "discard": "warning", "error": "error", "fatal": "fatal", "output": "debug"}


@dataclass(frozen=True, slots=True)
class Channel:
    """A logged variable: the FMU's name for it, unit and causality."""

    variable: str
    unit: str
    causality: str


@dataclass(frozen=True, slots=True)
class Subject:
    """What all runs of a campaign have in common: names and units of what is logged, the command, limits, hashes, requirements."""

    version: str
    study_sha256: str
    fmu_sha256: str
    binary_sha256: str | None  # of the library that the runs load
    command: Command
    limits: tuple[float, float]
    input: Channel
    output: Channel
    outputs: tuple[Channel, ...]  # every logged output, the controlled one among them
    states: tuple[Channel, ...]  # an output that is a state is logged as both
    requirements: tuple[Requirement, ...]
    attachments: Mapping[str, bytes]

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all logged variables, each once, outputs first."""
        return tuple(dict.fromkeys(channel.variable for channel in (*self.outputs, *self.states)))


@dataclass(frozen=True, slots=True)
class Setting:
    """What one run was told: its name, parameter values (exact), facts, communication step and stop time [s], the FMU's interface."""

    name: str
    nominal: bool
    parameters: Mapping[str, Fraction]
    facts: Facts
    step: float
    stop: float
    interface: Interface = "co-simulation"


def record(subject: Subject, setting: Setting, outcome: Outcome, linear: Reals | None) -> RunLog:
    """The log of a run as far as it got; `linear` (n,) is the linear plant's output at the trajectory's times, output unit, if known."""
    run = {
        "run": setting.name,
        "nominal": json.dumps(setting.nominal),
        "version": subject.version,
        "study_sha256": subject.study_sha256,
        "fmu_sha256": subject.fmu_sha256,
        "binary_sha256": subject.binary_sha256 or "",
        "status": outcome.status.name.lower(),
        "detail": outcome.detail,
        "parameters": json.dumps({name: str(value) for name, value in setting.parameters.items()}),
        "maneuver_time": repr(subject.command.maneuver_time),
        "slowest_period": json.dumps(setting.facts.slowest_period),
        "step": repr(setting.step),
        "stop": repr(setting.stop),
        "interface": setting.interface,
        "input": subject.input.variable,
        "output": subject.output.variable,
        "facts": json.dumps(asdict(setting.facts)),
        "requirements": json.dumps([_requirement(requirement) for requirement in subject.requirements]),
    }
    attachments = {**subject.attachments, COMMAND_FILE: json.dumps(subject.command.to_dict(), indent=1).encode()}
    messages = tuple(Message(max(line.time, 0.0), LEVELS.get(line.level, "info"), line.text) for line in outcome.messages)
    trajectory = outcome.trajectory
    if trajectory is None:
        return RunLog(run, None, (), messages, attachments)
    times = trajectory.times
    asked = subject.command(times, setting.facts.rest_input)
    column = {name: i for i, name in enumerate(subject.variables)}

    def logged(channels: Sequence[Channel]) -> Reals:
        return trajectory.values[:, [column[channel.variable] for channel in channels]]

    signals = [
        _signal(COMMAND, times, [replace(subject.input, causality="local")], asked[:, None], names=("u",)),
        _signal(INPUT, times, [subject.input], trajectory.input[:, None]),
        _signal(OUTPUT, times, subject.outputs, logged(subject.outputs)),
        _signal(LIMITS, times[:1], [replace(subject.input, causality="local")] * 2, np.array([subject.limits]), names=("lower", "upper")),
    ]
    if linear is not None:
        signals.insert(3, _signal(LINEAR, times, [replace(subject.output, causality="local")], linear[:, None]))
    if subject.states:
        signals.append(_signal(STATE, times, subject.states, logged(subject.states)))
    return RunLog(run, None, tuple(signals), messages, attachments)


def observe(log: RunLog) -> Observation:
    """What quantities may look at, from a log alone; raises `LookupError` or `ValueError` if it is no log of a run."""
    facts = json.loads(log.run["facts"])
    facts["modes"] = tuple((frequency, damping) for frequency, damping in facts["modes"])
    variables: dict[str, Reals] = {}
    for signal in log.signals:
        for i, name in enumerate(signal.variables if signal.topic in (OUTPUT, STATE) else ()):
            if not np.array_equal(variables.setdefault(name, signal.values[:, i]), signal.values[:, i]):
                raise ValueError(f"{name} has other values as a state than as an output")
    applied = log.signal(INPUT)
    unknown = np.full(len(applied.times), np.nan)  # of a plant that gives no linear one
    output = variables[log.run["output"]]
    return Observation(
        times=applied.times,
        input=applied.values[:, 0],
        output=output,
        linear=next((signal.values[:, 0] for signal in log.signals if signal.topic == LINEAR), unknown),
        variables=MappingProxyType({"output": output, **variables}),
        command=Command.from_json(log.attachments[COMMAND_FILE].decode()),
        facts=Facts(**facts),
    )


def thinned(run: Observation) -> Observation:
    """The run with every second communication point left out, but for those at which the input changes, the end of the move and the last.

    Where an FMU takes steps of one size only, the distance from this measures what is not seen between the points.
    """
    keep = np.arange(len(run.times)) % 2 == 0
    keep[1:] |= run.input[1:] != run.input[:-1]
    keep |= run.after & ~np.append(False, run.after[:-1])
    keep[-1] = True
    variables = MappingProxyType({name: values[keep] for name, values in run.variables.items()})
    times, applied, output, linear = (signal[keep] for signal in (run.times, run.input, run.output, run.linear))
    return Observation(times, applied, output, linear, variables, run.command, run.facts)


def with_verdict(log: RunLog, verdict: Verdict, measured: Mapping[str, Measured]) -> RunLog:
    """The log completed by what was measured; only a complete log has this record."""
    quantities = {name: {"value": value.value, "error": value.error} for name, value in measured.items()}
    return replace(log, verdict={"verdict": verdict.value, "quantities": json.dumps(quantities)})


def measured_in(log: RunLog) -> dict[str, Measured]:
    """The values and numerical errors that a log's verdict records (infinite values as JSON's Infinity)."""
    if log.verdict is None:
        return {}
    recorded = json.loads(log.verdict["quantities"])
    return {name: Measured(float(entry["value"]), float(entry["error"])) for name, entry in recorded.items()}


def requirements_in(log: RunLog) -> tuple[Requirement, ...]:
    """The requirements that a log was judged by."""
    return tuple(Requirement(**{**entry, "quantity": parse_quantity(entry["quantity"])}) for entry in json.loads(log.run["requirements"]))


def _requirement(requirement: Requirement) -> dict[str, object]:
    return {
        "id": requirement.id,
        "text": requirement.text,
        "quantity": str(requirement.quantity),
        "minimum": requirement.minimum,
        "maximum": requirement.maximum,
        "unit": requirement.unit,
        "scope": requirement.scope,
    }


def _signal(topic: str, times: Reals, channels: Sequence[Channel], values: Reals, names: tuple[str, ...] | None = None) -> Signal:
    variables = tuple(channel.variable for channel in channels)
    units, causalities = tuple(c.unit for c in channels), tuple(c.causality for c in channels)
    return Signal(topic, times, names or field_names(variables), units, causalities, variables, values)
