"""The campaign: the command on the FMU, once for the nominal plant and once for every sample of the box, each run judged and logged."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from fmus.errors import FmuError
from fmus.plans import interface_of
from fmus.stepping import Experiment, Interface, Outcome, RunStatus
from fmus.stepping import samples as steps
from fmus.workers import Worker
from relaxations.commands import Command, Tail
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.transitions import VaryingPlant
from relaxations.varying_response import varying_response
from reports import logs
from reports.files import sha256
from reports.records import RunLog
from suite.design import grid_step
from suite.ledger import Ledger
from suite.observations import Setting, Subject, observe, record, thinned, with_verdict
from suite.plants import nominal_value, plant_at
from suite.quantities import UNDAMPED, Facts, Observation, evaluate, window
from suite.quantity_names import Quantity, parse_quantity
from suite.starts import required_start, run_states
from suite.study import FmuPlant, Requirement, Study
from suite.varying import study_plant
from suite.verdicts import Measured, RunVerdict, Verdict, judge_run, overall

ALWAYS = tuple(map(parse_quantity, ("residual_vibration", "final_error", "overshoot", "peak_input", "model_mismatch")))
"""Quantities that every run reports, asked for or not."""

STEPS_PER_PERIOD, STEPS_PER_WINDOW = 50, 1000
RUNS = "runs"


@dataclass(frozen=True, slots=True)
class Sample:
    """A run to be made: name, parameter values of the box (exact), and the linear plant at these values (of one that varies the final
    one, and all of it)."""

    name: str
    nominal: bool
    parameters: Mapping[str, Fraction]
    plant: LinearPlant
    varying: VaryingPlant | None = None

    @property
    def unstable(self) -> bool:
        """Whether an open-loop command means nothing on it; one that varies may grow by what counts as undamped."""
        grows = any(pole.damping_ratio < -UNDAMPED for pole in self.plant.poles)
        return self.plant.is_unstable and (self.varying is None or grows)


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run came to. `log` is its path within the evidence folder (None: not kept), `measured` is empty unless the run finished.

    `simulation` tells communication step, stop time, slowest period [s], whether the modes decay within the observed window, and the
    FMU's interface.
    """

    name: str
    nominal: bool
    parameters: Mapping[str, Fraction]
    status: RunStatus
    detail: str
    verdict: Verdict
    measured: Mapping[str, Measured]
    simulation: Mapping[str, float | bool | str | None]
    log: str | None
    sha256: str

    def seen_by(self, quantity: Quantity) -> RunVerdict:
        """This run as a requirement on `quantity` sees it."""
        return RunVerdict(self.name, self.nominal, self.measured.get(str(quantity)), self.detail)

    def to_row(self) -> dict[str, object]:
        """As plain data, for the ledger."""
        return {
            "name": self.name,
            "nominal": self.nominal,
            "parameters": {name: str(value) for name, value in self.parameters.items()},
            "status": self.status.name,
            "detail": self.detail,
            "verdict": self.verdict.value,
            "measured": {name: [value.value, value.error] for name, value in self.measured.items()},
            "simulation": dict(self.simulation),
            "log": self.log,
            "sha256": self.sha256,
        }

    @staticmethod
    def from_row(row: Mapping[str, object]) -> RunResult:
        """The inverse of `to_row`."""
        data: dict = dict(row)
        return RunResult(
            data["name"],
            data["nominal"],
            {name: Fraction(value) for name, value in data["parameters"].items()},
            RunStatus[data["status"]],
            data["detail"],
            Verdict(data["verdict"]),
            {name: Measured(*pair) for name, pair in data["measured"].items()},
            data["simulation"],
            data["log"],
            data["sha256"],
        )


def samples(study: Study) -> tuple[Sample, ...]:
    """The nominal plant first, then the full product of the parameters' grids; a sample equal to the nominal plant is not made twice."""
    names = [axis.parameter for axis in study.uncertainties]
    usual = {name: nominal_value(study, name) for name in names}
    made = [Sample("0000-nominal", True, usual, plant_at(study, usual), study_plant(study, usual))]
    for values in itertools.product(*(axis.values for axis in study.uncertainties)) if names else ():
        chosen = dict(zip(names, values, strict=True))
        if chosen != usual:
            made.append(Sample(f"{len(made):04d}", False, chosen, plant_at(study, chosen), study_plant(study, chosen)))
    return tuple(made)


def settle(study: Study, sample: Sample, command: Command, bracket: tuple[float | None, float | None]) -> Setting:
    """Communication step and observed window of a run, from the modes of its own plant."""
    modes = tuple((pole.natural_frequency, pole.damping_ratio) for pole in sample.plant.flexible)
    rates = tuple(pole.value.real for pole in sample.plant.real)
    observed, slowest, decayed = window(modes, rates, command.maneuver_time)
    if study.simulation.observe is not None:
        decayed = decayed and study.simulation.observe >= observed
        observed = study.simulation.observe
    stop = command.end + observed
    grid = grid_step(study)
    step = study.simulation.step or natural_step([frequency for frequency, _ in modes], stop)
    if grid is not None:
        step, stop = grid, steps(stop, grid) * grid
    displacement, scale = float(study.maneuver.displacement), study.maneuver.given_scale
    facts = Facts(
        displacement, float(study.plant.initial_input), 0.0, modes, slowest, decayed, *bracket, None if scale is None else float(scale)
    )
    return Setting(sample.name, sample.nominal, sample.parameters, facts, step, stop, interface(study))


def natural_step(frequencies: Sequence[float], stop: float) -> float:
    """The communication step [s] for modes of these frequencies [rad/s] in a run until `stop` [s]."""
    periods = [2 * math.pi / frequency / STEPS_PER_PERIOD for frequency in frequencies]
    return min([*periods, stop / STEPS_PER_WINDOW])


def interface(study: Study) -> Interface:
    """The FMU's interface that runs use."""
    assert study.plant.fmu is not None
    has = study.plant.fmu.archive.description.capabilities
    return "co-simulation" if interface_of(has, study.simulation.interface) == "co_simulation" else "model-exchange"


def carry_out(
    study: Study,
    subject: Subject,
    bracket: tuple[float | None, float | None],
    planned: Sequence[Sample],
    folder: Path,
    ledger: Ledger,
    jobs: int,
    finished: Callable[[RunResult], None] = lambda result: None,
) -> tuple[RunResult, ...]:
    """Make every planned run that the ledger does not hold yet, `jobs` at a time; the results come in the order of the samples.

    A log is on disk before its row is in the ledger. `finished` is called after each run, in the order in which they end.
    """
    (folder / RUNS).mkdir(exist_ok=True)
    lock, stopping, workers, local = threading.Lock(), threading.Event(), [], threading.local()

    def worker() -> Worker:
        if not hasattr(local, "worker"):
            local.worker = Worker(study.simulation.confinement)
            with lock:
                workers.append(local.worker)
        return local.worker

    def one(sample: Sample) -> RunResult:
        if stopping.is_set():
            raise CancelledError
        setting = settle(study, sample, subject.command, bracket)
        identity = run_id(study, subject, setting)
        with lock:
            known = ledger.find(identity)
        if known is not None:
            result = RunResult.from_row(known)
            if _intact(folder, result):
                finished(result)
                return result
        result = run(study, subject, sample, setting, worker(), folder)
        if stopping.is_set():
            raise CancelledError  # its process was ended from here, which says nothing about the FMU
        with lock:
            ledger.add(identity, result.name, result.verdict.value, result.to_row())
        finished(result)
        return result

    try:
        with ThreadPoolExecutor(jobs, thread_name_prefix="run") as pool:
            futures = [pool.submit(one, sample) for sample in planned]
            try:
                return tuple(future.result() for future in futures)
            except BaseException:
                stopping.set()
                for future in futures:
                    future.cancel()
                while wait(futures, 0.1).not_done:  # an FMU that hangs would hold us until its time is up
                    for each in workers:
                        each.close()
                raise
    finally:
        for each in workers:
            each.close()


def _intact(folder: Path, result: RunResult) -> bool:
    if result.log is None:  # the run passed, and its log was not wanted
        return True
    path = folder / result.log
    return path.is_file() and sha256(path) == result.sha256


def run_id(study: Study, subject: Subject, setting: Setting) -> str:
    """A hash of everything that determines a run's log."""
    parts = [
        subject.version,
        subject.study_sha256,
        subject.fmu_sha256,
        json.dumps(subject.command.to_dict()),
        setting.name,
        json.dumps({name: str(value) for name, value in sorted(setting.parameters.items())}),
        repr((setting.step, setting.stop, setting.interface, study.simulation.seed)),
    ]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def run(study: Study, subject: Subject, sample: Sample, setting: Setting, worker: Worker, folder: Path) -> RunResult:
    """One run with the check of its numerical error, measured, judged and logged."""
    fmu = study.plant.fmu
    assert fmu is not None
    parameters = {name: float(value) for name, value in {**fmu.parameters, **sample.parameters}.items()}
    experiment = Experiment(
        fmu=fmu.archive.path,
        input=study.plant.input,
        outputs=subject.variables,
        parameters=parameters,
        initial_input=float(study.plant.initial_input),
        initial_state=run_states(study.plant, study.maneuver),
        command=subject.command,
        stop=setting.stop,
        step=setting.step,
        interface=interface(study),
        settle=fmu.settle,
    )
    begin = required_start(study, sample.plant, sample.parameters)
    if begin is not None:
        setting = replace(setting, facts=replace(setting.facts, rests=_rests(subject, fmu, worker, experiment, study.simulation.timeout)))
    whole, outcome = _simulate(subject, sample, setting, worker, experiment, study.simulation.timeout, begin)
    measured: dict[str, Measured] = {}
    if outcome.status is RunStatus.FINISHED and grid_step(study) is not None:
        run = observe(whole)
        measured = measure(run, thinned(run), quantities(subject.requirements, sample.nominal))
    elif outcome.status is RunStatus.FINISHED:
        halved, check = _simulate(subject, sample, setting, worker, experiment.refined(), study.simulation.timeout, begin)
        if check.status is RunStatus.FINISHED:
            measured = measure(observe(whole), observe(halved), quantities(subject.requirements, sample.nominal))
        else:
            outcome = replace(outcome, status=check.status, detail=f"with half the communication step: {check.detail}")
            whole = replace(whole, run={**whole.run, "status": check.status.name.lower(), "detail": outcome.detail})
    verdict = run_verdict(subject.requirements, sample.nominal, measured)
    path = folder / RUNS / f"{setting.name}.mcap"
    logs.write_log(path, with_verdict(whole, verdict, measured))
    name = f"{RUNS}/{path.name}"
    return RunResult(
        name=setting.name,
        nominal=sample.nominal,
        parameters=sample.parameters,
        status=outcome.status,
        detail=outcome.detail,
        verdict=verdict,
        measured=measured,
        simulation={
            "step": setting.step,
            "stop": setting.stop,
            "slowest_period": setting.facts.slowest_period,
            "decayed": setting.facts.decayed,
            "interface": setting.interface,
        },
        log=name,
        sha256=sha256(path),
    )


def _simulate(
    subject: Subject,
    sample: Sample,
    setting: Setting,
    worker: Worker,
    experiment: Experiment,
    timeout: float,
    begin: tuple[Fraction, ...] | None = None,
) -> tuple[RunLog, Outcome]:
    try:
        outcome = worker.run(experiment, timeout)
    except FmuError as problem:  # the study was checked, but a file can vanish, a process fail to start: the other runs go on
        outcome = Outcome(RunStatus.FAILED, str(problem), None, 0.0)
    trajectory = outcome.trajectory
    if trajectory is None or not len(trajectory.times):
        return record(subject, setting, replace(outcome, trajectory=None), np.zeros(0)), outcome
    controlled = subject.variables.index(subject.output.variable)
    rest = float(trajectory.values[0, controlled])
    if begin is not None and setting.facts.rests is not None:
        rest = setting.facts.rests[subject.output.variable]
    setting = replace(setting, facts=replace(setting.facts, rest_output=rest), step=experiment.step)
    # A run's output at a jump of the input is that before it (`fmus.stepping.Trajectory`): with feed-through that is another number.
    entry = setting.facts.rest_input
    if sample.varying is None:
        linear = rest + response(sample.plant, subject.command, trajectory.times, rest=entry, before=True, begin=begin)
    else:
        linear = rest + varying_response(sample.varying, subject.command, trajectory.times, entry, before=True, begin=begin)
    return record(subject, setting, outcome, linear), outcome


def _rests(subject: Subject, fmu: FmuPlant, worker: Worker, experiment: Experiment, timeout: float) -> dict[str, float] | None:
    """Every logged variable at the initial rest, of a run that begins elsewhere; None if the FMU fails there (the run itself tells)."""
    still = Command(0.0, (), Tail(experiment.initial_input))
    at_rest = {name: float(value) for name, value in fmu.initial_state.items()}
    try:
        outcome = worker.run(replace(experiment, command=still, initial_state=at_rest, stop=experiment.step), timeout)
    except FmuError:
        return None
    if outcome.trajectory is None or not len(outcome.trajectory.times):
        return None
    return {name: float(x) for name, x in zip(subject.variables, outcome.trajectory.values[0], strict=True)}


def quantities(requirements: Sequence[Requirement], nominal: bool) -> tuple[Quantity, ...]:
    """What a run measures: what always is, and what the requirements that look at it name."""
    asked = [r.quantity for r in requirements if nominal or r.scope == "box"]
    return tuple({str(quantity): quantity for quantity in (*ALWAYS, *asked)}.values())


def measure(run: Observation, other: Observation, wanted: Sequence[Quantity]) -> dict[str, Measured]:
    """Each quantity with its numerical error: twice the change from `run` to the refined run (which bounds a first-order error).

    Of an FMU that takes no other steps, to the run with every second point left out.
    """
    measured = {}
    for quantity in wanted:
        value, again = evaluate(run, quantity), evaluate(other, quantity)
        error = 0.0 if value == again else 2 * abs(value - again)
        measured[str(quantity)] = Measured(value, error)
    return measured


def run_verdict(requirements: Sequence[Requirement], nominal: bool, measured: Mapping[str, Measured]) -> Verdict:
    """One run's verdict on all requirements that look at it; ERROR if nothing could be measured."""
    if not measured:
        return Verdict.ERROR
    return overall(list(_judged(requirements, nominal, measured)))


def _judged(requirements: Sequence[Requirement], nominal: bool, measured: Mapping[str, Measured]) -> Iterator[Verdict]:
    for requirement in requirements:
        if nominal or requirement.scope == "box":
            yield judge_run(requirement, measured[str(requirement.quantity)])
