"""The main job: from a study to a verdict, with the evidence in one folder."""

from __future__ import annotations

import importlib.metadata
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from reports import files, manifest
from suite import evidence
from suite.campaign import RunResult, carry_out, samples
from suite.design import Design, design
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.ledger import Ledger
from suite.observations import Channel, Subject
from suite.study import FmuPlant, Study
from suite.verdicts import Judgement, Verdict, judge, overall

LEDGER = "ledger.sqlite"
OURS = ("study.toml", LEDGER, manifest.NAME)
"""A folder with one of these is an evidence folder, and may be replaced or resumed."""


class FolderError(SuiteError):
    """The output folder cannot be used as asked."""


@dataclass(frozen=True, slots=True)
class Progress:
    """What a caller may show while it waits: `planned` runs in all, and each result as it comes."""

    planned: Callable[[int], None] = lambda count: None
    finished: Callable[[RunResult], None] = lambda result: None


@dataclass(frozen=True, slots=True)
class Verification:
    """The outcome: results as written, and where the evidence lies."""

    verdict: Verdict
    results: Mapping[str, Any]
    folder: Path
    report: Path


def verify(study: Study, folder: Path, *, jobs: int = 1, resume: bool = False, force: bool = False, progress: Progress | None = None) -> Verification:
    """Design the study's command, run it on the FMU over the box, judge every requirement and write the evidence folder.

    Raises `StudyError` or `FolderError` before anything is written if the request cannot be carried out.
    """
    shown = progress or Progress()
    fmu = study.plant.fmu
    if fmu is None:
        raise StudyError(str(study.file), [Mistake("plant.fmu", ABSENT, "is missing: verify runs the command on an FMU (bound does not need one)")])
    made = design(study)
    planned = samples(study)
    unstable = [sample.name for sample in planned if sample.plant.is_unstable]
    if unstable:
        message = f"the plant is unstable (in {', '.join(unstable[:5])}): an open-loop command means nothing on it; bound works"
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, message)])
    prepare(folder, study, resume=resume, force=force)
    files.write_atomically(folder / "study.toml", study.source)
    runs: tuple[RunResult, ...] = ()
    if made.command is not None:
        subject = _subject(study, fmu, made)
        shown.planned(len(planned))
        with Ledger(folder / LEDGER) as ledger:
            bracket = made.bound.lower, made.bound.upper
            runs = carry_out(study, subject, bracket, folder, ledger, jobs, shown.finished)
    judgements = tuple(judge(requirement, [run.seen_by(requirement.quantity) for run in runs]) for requirement in study.requirements)
    if made.command is None:
        judgements = tuple(replace(judgement, reason=made.bound.reason or "no command was found") for judgement in judgements)
    verdict = overall([*(judgement.verdict for judgement in judgements), *(Verdict.ERROR for run in runs if not run.measured)])
    if made.command is None:
        verdict = Verdict.UNDECIDED
    if study.keep_logs == "worst":
        runs = _drop(folder, runs, judgements)
    results = evidence.collect(study, made, judgements, runs, verdict)
    report = evidence.write(folder, results, study, made, runs)
    return Verification(verdict, results, folder, report)


def prepare(folder: Path, study: Study, *, resume: bool, force: bool) -> None:
    """Make the folder usable, or raise `FolderError`: what exists is kept unless it is ours and `resume` or `force` was asked for."""
    if folder.exists() and not folder.is_dir():
        raise FolderError(f"{folder} is a file; the evidence needs a folder of its own")
    if folder.is_dir() and any(folder.iterdir()):
        if not any((folder / name).is_file() for name in OURS):
            raise FolderError(f"{folder} is not empty and holds no evidence of ours: it is left alone; choose another --out")
        if resume:
            _resumable(folder, study)
        elif force:
            shutil.rmtree(folder)
        else:
            raise FolderError(f"{folder} exists: --resume continues its runs, --force replaces it, --out DIR writes elsewhere")
    folder.mkdir(parents=True, exist_ok=True)


def _resumable(folder: Path, study: Study) -> None:
    kept = folder / "study.toml"
    if kept.is_file() and kept.read_bytes() != study.source:
        raise FolderError(f"{folder} belongs to another study (its study.toml differs from {study.file}): use --force or another --out")


def _subject(study: Study, fmu: FmuPlant, made: Design) -> Subject:
    assert made.command is not None
    description = fmu.archive.description
    named = [r.quantity.variable for r in study.requirements if r.quantity.variable and r.quantity.variable != "output"]
    states = tuple(name for name, _ in description.states)
    outputs = dict.fromkeys([study.plant.output, *description.names("output"), *named])

    def channel(name: str) -> Channel:
        variable = description.find(name)
        return Channel(name, variable.unit, variable.causality)

    return Subject(
        version=importlib.metadata.version("slewcert"),
        study_sha256=study.sha256,
        fmu_sha256=fmu.archive.sha256,
        command=made.command,
        limits=(float(study.limits.lower), float(study.limits.upper)),
        input=channel(study.plant.input),
        output=channel(study.plant.output),
        outputs=tuple(channel(name) for name in outputs if name not in states and description.find(name).is_real),
        states=tuple(channel(name) for name in states if description.find(name).is_real),
        requirements=study.requirements,
        attachments={"study.toml": study.source, "modelDescription.xml": fmu.archive.description_xml},
    )


def _drop(folder: Path, runs: tuple[RunResult, ...], judgements: tuple[Judgement, ...]) -> tuple[RunResult, ...]:
    """Remove the logs that nobody asked to keep: kept are the nominal run's, the worst of each requirement, and all that did not pass."""
    worst = {judgement.worst_run for judgement in judgements}
    kept = []
    for run in runs:
        if run.nominal or run.name in worst or run.verdict is not Verdict.PASS:
            kept.append(run)
        else:
            (folder / run.log).unlink(missing_ok=True)
            kept.append(replace(run, log=None))
    return tuple(kept)
