"""The main job: from a study to a verdict, with the evidence in one folder."""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmus.descriptions import Description
from fmus.variables import REAL_TYPES
from relaxations.bounds import Status
from reports import files
from suite import evidence
from suite.campaign import RunResult, Sample, carry_out, interface, samples, settle
from suite.design import Design, design, least_fuel_words, on_grid
from suite.errors import ABSENT, Mistake, StudyError
from suite.folders import LEDGER, check, prepare
from suite.ledger import Ledger
from suite.observations import Channel, Subject
from suite.progress import Progress
from suite.study import FmuPlant, Study
from suite.verdicts import Judgement, Verdict, judge, overall

MOST_RUNS = 100_000  # of one campaign; what lies between samples is not known better by more of them on one machine
MOST_POINTS = 2_000_000  # communication points of one run: its log is then a quarter of a gigabyte, and no viewer opens more
MOST_ELEMENTS = 64  # of an array that is logged though nobody asked: 100 kB a run; a requirement may name any element


@dataclass(frozen=True, slots=True)
class Verification:
    """The outcome: results as written, and where the evidence lies."""

    verdict: Verdict
    results: Mapping[str, Any]
    folder: Path
    report: Path


def verify(
    study: Study, folder: Path, *, jobs: int = 1, resume: bool = False, force: bool = False, progress: Progress | None = None
) -> Verification:
    """Design the study's command, run it on the FMU over the box, judge every requirement and write the evidence folder.

    Raises `StudyError` or `FolderError` before anything is written if the request cannot be carried out.
    """
    shown = progress or Progress()
    fmu = study.plant.fmu
    if fmu is None:
        raise refusal(study, "plant.fmu", "is missing: verify runs the command on an FMU (bound does not need one)")
    for item, axis in enumerate(study.uncertainties, 1):
        if axis.moves_a_root:
            why = f"{axis.parameter} belongs to the linear plant, and no FMU can be set to it: bound proves commands for such a box; "
            raise refusal(study, f"uncertainty[{item}].parameter", f"{why}runs are made over parameters of the FMU")
    check(folder, study, resume=resume, force=force)
    made = on_grid(study, design(study))
    planned = _planned(study, made)
    prepare(folder, study, resume=resume, force=force)
    files.write_atomically(folder / "study.toml", study.source)
    runs: tuple[RunResult, ...] = ()
    if made.command is not None:
        subject = _subject(study, fmu, made)
        shown.planned(len(planned))
        with Ledger(folder / LEDGER) as ledger:
            bracket = made.bound.lower, made.bound.upper
            runs = carry_out(study, subject, bracket, planned, folder, ledger, jobs, shown.finished)
    judgements = tuple(judge(requirement, [run.seen_by(requirement.quantity) for run in runs]) for requirement in study.requirements)
    verdict = overall([*(judgement.verdict for judgement in judgements), *(Verdict.ERROR for run in runs if not run.measured)])
    if made.command is None:
        impossible = made.bound.status is Status.IMPOSSIBLE
        verdict = Verdict.FAIL if impossible else Verdict.UNDECIDED
        least = "" if made.least is None else f"; {least_fuel_words(made.least, study.plant.input_unit)}"
        reason = f"{Status.IMPOSSIBLE.value} (see the certificate){least}" if impossible else made.bound.reason or "no command was found"
        judgements = tuple(replace(judgement, verdict=verdict, reason=reason) for judgement in judgements)
    if study.keep_logs == "worst":
        runs = _drop(folder, runs, judgements)
    results = evidence.collect(study, made, judgements, runs, verdict)
    report = evidence.write(folder, results, study, made, runs)
    return Verification(verdict, results, folder, report)


def refusal(study: Study, path: str, message: str) -> StudyError:
    """The error that says why a study that is right by itself cannot be verified."""
    return StudyError(str(study.file), [Mistake(path, ABSENT, message)])


def _planned(study: Study, made: Design) -> tuple[Sample, ...]:
    """The runs to be made; raises `StudyError` if they are too many or too long, or if a plant among them is unstable."""
    count = math.prod(axis.samples for axis in study.uncertainties)
    if count > MOST_RUNS:
        raise refusal(study, "uncertainty", f"the product of all axes has {count} samples; at most {MOST_RUNS} runs are made")
    planned = samples(study)
    if unstable := ", ".join([sample.name for sample in planned if sample.unstable][:5]):
        raise refusal(study, "plant", f"the plant is unstable (in {unstable}): an open-loop command means nothing on it; bound works")
    asks_for_rest = any(requirement.quantity.name in ("residual_vibration", "final_error") for requirement in study.requirements)
    for sample in planned:
        if made.command is None:
            break
        setting = settle(study, sample, made.command, (None, None))
        if (points := setting.stop / setting.step) > MOST_POINTS:
            grid = f"{points:.3g} communication points, one every {setting.step:.3g} s until {setting.stop:.6g} s"
            message = f"run {sample.name} would have {grid}; at most {MOST_POINTS} are taken: give a longer step, or a shorter observe"
            raise refusal(study, "simulation", message)
        observed, period = setting.stop - made.command.end, setting.facts.slowest_period
        if asks_for_rest and period is not None and observed < period:
            message = f"{observed:.6g} s are less than the slowest period of run {sample.name}, {period:.6g} s: its rest is not seen"
            raise refusal(study, "simulation.observe", message)
    return planned


def _subject(study: Study, fmu: FmuPlant, made: Design) -> Subject:
    assert made.command is not None
    description = fmu.archive.description
    named = [r.quantity.variable for r in study.requirements if r.quantity.variable and r.quantity.variable != "output"]
    outputs = dict.fromkeys([study.plant.output, *_reals(description, description.names("output")), *named])

    def channel(name: str) -> Channel:
        variable = description.find(name)
        return Channel(name, variable.unit, variable.causality)

    return Subject(
        version=importlib.metadata.version("slewcert"),
        study_sha256=study.sha256,
        fmu_sha256=fmu.archive.sha256,
        binary_sha256=fmu.archive.binary_sha256(interface(study)),
        command=made.command,
        limits=(float(study.limits.lower), float(study.limits.upper)),
        input=channel(study.plant.input),
        output=channel(study.plant.output),
        outputs=tuple(channel(name) for name in outputs),
        states=tuple(channel(name) for name in _reals(description, tuple(name for name, _ in description.states))),
        requirements=study.requirements,
        attachments={"study.toml": study.source, "modelDescription.xml": fmu.archive.description_xml},
    )


def _reals(description: Description, names: tuple[str, ...]) -> Iterator[str]:
    """The real numbers among the variables, arrays element by element; large arrays are left out."""
    for variable in map(description.find, names):
        if variable.type in REAL_TYPES and variable.size <= MOST_ELEMENTS:
            yield from variable.elements


def _drop(folder: Path, runs: tuple[RunResult, ...], judgements: tuple[Judgement, ...]) -> tuple[RunResult, ...]:
    """Remove the logs that nobody asked to keep: kept are the nominal run's, the worst of each requirement, and all that did not pass."""
    worst = {judgement.worst_run for judgement in judgements}
    kept = []
    for run in runs:
        if run.log is None or run.nominal or run.name in worst or run.verdict is not Verdict.PASS:
            kept.append(run)
        else:
            (folder / run.log).unlink(missing_ok=True)
            kept.append(replace(run, log=None))
    with Ledger(folder / LEDGER) as ledger:  # so that --resume does not make a run again whose log was not wanted
        for run in kept:
            ledger.amend(run.name, run.to_row())
    return tuple(kept)
