"""The review: every quantity computed again from the logged signals, every verdict judged again, compared with what was recorded."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

from fmus.descriptions import Description, read_description
from fmus.errors import FmuError
from relaxations.errors import RelaxationsError
from reports import files, logs, manifest
from reports.errors import LogError, ManifestError, RecordError
from reports.records import RunLog
from suite.campaign import RUNS, run_verdict
from suite.errors import SuiteError
from suite.evidence import RESULTS, settings
from suite.observations import COMMAND_FILE, measured_in, observe, requirements_in
from suite.quantities import evaluate
from suite.quantity_names import Quantity, parse_quantity
from suite.rounding import number
from suite.study import GRID, Requirement, Simulation, Uncertainty
from suite.study_file import parse
from suite.study_units import convert_units
from suite.verdicts import Judgement, Measured, RunVerdict, Verdict, judge, overall

MALFORMED = (
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    RecursionError,
    RelaxationsError,
    SuiteError,
)
"""What reading a record of the wrong shape may raise: whoever changed a file chose what is in it."""

STUDY, DESCRIPTION = "study.toml", "modelDescription.xml"
TOLERANCE = 1e-9  # relative: the same code on the same numbers differs by the last bits of another machine's library at most


class ReviewStatus(StrEnum):
    """What the review came to."""

    CONFIRMED = "confirmed"
    DIFFERS = "differs"
    TAMPERED = "tampered"
    INCOMPLETE = "incomplete"


@dataclass(frozen=True, slots=True)
class Row:
    """One requirement (or quantity): the recorded value, the one computed again, and the verdict computed again."""

    id: str
    recorded: float | None
    recomputed: float | None
    verdict: str

    def to_dict(self) -> dict[str, object]:
        """As `review --json` prints it."""
        return {"id": self.id, "recorded": number(self.recorded), "recomputed": number(self.recomputed), "verdict": self.verdict}


@dataclass(frozen=True, slots=True)
class Review:
    """The outcome: overall status, a row for each requirement, a status for each file, and what does not agree, in words."""

    status: ReviewStatus
    rows: tuple[Row, ...]
    files: tuple[tuple[str, str], ...]
    findings: tuple[str, ...]

    def to_dict(self) -> dict[str, object]:
        """The object of `review --json` (docs/schemas.md)."""
        files = [{"path": path, "status": status} for path, status in self.files]
        return {"status": str(self.status), "requirements": [row.to_dict() for row in self.rows], "files": files}


def agree(recorded: float, recomputed: float) -> bool:
    """Equal within `TOLERANCE` relative; what does not exist agrees with what does not exist."""
    if math.isnan(recorded) or math.isnan(recomputed):
        return math.isnan(recorded) and math.isnan(recomputed)
    if math.isinf(recorded) or math.isinf(recomputed):
        return recorded == recomputed
    # Values of 1e-12 and less of a move are rounding, in which no two machines agree.
    return abs(recorded - recomputed) <= TOLERANCE * max(abs(recorded), abs(recomputed)) + 1e-15


def review(path: Path) -> Review:
    """Review one log or an evidence folder. Raises `OSError` if there is nothing at `path`."""
    if path.is_dir():
        return _review_folder(path)
    try:
        log = logs.read_log(path)
    except (LogError, RecordError) as problem:
        return Review(ReviewStatus.TAMPERED, (), ((path.name, "changed"),), (str(problem),))
    if log.verdict is None:
        return Review(ReviewStatus.INCOMPLETE, (), ((path.name, "incomplete"),), (f"{path.name} ends before its verdict",))
    try:
        rows, findings, _ = _review_log(path.stem, log)
    except MALFORMED as problem:
        return Review(ReviewStatus.TAMPERED, (), ((path.name, "changed"),), (f"{path.name} is no log of a run: {problem!r}",))
    return Review(ReviewStatus.DIFFERS if findings else ReviewStatus.CONFIRMED, rows, ((path.name, "ok"),), findings)


def _review_log(name: str, log: RunLog) -> tuple[tuple[Row, ...], tuple[str, ...], dict[str, Measured]]:
    """Rows, findings and recomputed values of one complete log."""
    recorded = measured_in(log)
    assert log.verdict is not None
    findings: list[str] = []
    recomputed: dict[str, Measured] = {}
    if recorded:
        run = observe(log)
        for quantity, value in recorded.items():
            again = evaluate(run, parse_quantity(quantity))
            recomputed[quantity] = Measured(again, value.error)
            if not agree(value.value, again):
                findings.append(f"{name}: {quantity} is recorded as {value.value!r}, the signals give {again!r}")
    nominal = json.loads(log.run["nominal"])
    if not isinstance(nominal, bool):
        raise ValueError(f"nominal is {nominal!r}")
    simulated = not log.run["study_sha256"] and not requirements_in(log)  # by itself, for no study
    answered = {r.id: _question(r) for r in requirements_in(log)}
    if not simulated and _asked(_study(log.attachments[STUDY], log.attachments.get(DESCRIPTION)), log.run["output"]) != answered:
        findings.append(f"{name}: the study that the log holds has other requirements")
    requirements = [r for r in requirements_in(log) if nominal or r.scope == "box"]
    missing = [r.id for r in requirements if recorded and str(r.quantity) not in recorded]
    if missing:
        findings.append(f"{name}: no value is recorded for {', '.join(missing)}")
    verdict = Verdict.ERROR if missing else run_verdict(requirements, nominal, recomputed)
    if verdict.value != log.verdict["verdict"]:
        findings.append(f"{name}: the verdict is recorded as {log.verdict['verdict']}, the signals give {verdict.value}")
    rows = []
    for requirement in requirements:
        quantity = str(requirement.quantity)
        outcome = judge(requirement, [RunVerdict(name, nominal, recomputed.get(quantity), log.run["detail"])])
        rows.append(Row(requirement.id, _value(recorded.get(quantity)), _value(recomputed.get(quantity)), outcome.verdict.value))
    return tuple(rows), tuple(findings), recomputed


def _value(measured: Measured | None) -> float | None:
    return None if measured is None else measured.value


def _review_folder(folder: Path) -> Review:
    try:
        statuses = manifest.check_manifest(folder)
        results = json.loads((folder / RESULTS).read_bytes())
    except ManifestError as problem:
        missing = not (folder / manifest.NAME).is_file()
        return Review(ReviewStatus.INCOMPLETE if missing else ReviewStatus.TAMPERED, (), (), (str(problem),))
    except (OSError, ValueError, RecursionError) as problem:
        state = "missing" if isinstance(problem, OSError) else "changed"
        return Review(ReviewStatus.TAMPERED, (), ((RESULTS, state),), (f"{RESULTS} cannot be read: {problem}",))
    listed = tuple((status.path, str(status.status)) for status in statuses)
    tampered = [f"{path} is {status}" for path, status in listed if status != "ok"]
    try:
        rows, findings, incomplete = _review_results(folder, results)
        if not _is_as_written(folder, results):
            tampered.append(f"{manifest.NAME} is changed")
    except (*MALFORMED, OSError) as problem:
        return Review(ReviewStatus.TAMPERED, (), listed, (*tampered, f"{RESULTS} or a log is malformed: {problem!r}"))
    if tampered:
        status = ReviewStatus.TAMPERED
    elif findings:
        status = ReviewStatus.DIFFERS
    else:
        status = ReviewStatus.INCOMPLETE if incomplete else ReviewStatus.CONFIRMED
    return Review(status, rows, listed, (*tampered, *findings, *incomplete))


def _is_as_written(folder: Path, results: Mapping[str, Any]) -> bool:
    """Whether the manifest, which no manifest lists, says of settings and versions what the results say, byte by byte."""
    found = manifest.read_manifest(folder)
    study = parse(folder / STUDY, (folder / STUDY).read_bytes())
    expected = settings(results, study.get("simulation", {}).get("seed", Simulation().seed))
    told = {name: value for name, value in found.items() if name not in ("format", "files")}
    return told == expected and (folder / manifest.NAME).read_bytes() == files.json_bytes(found)


def _review_results(folder: Path, results: Mapping[str, Any]) -> tuple[tuple[Row, ...], list[str], list[str]]:
    findings: list[str] = []
    incomplete: list[str] = []
    seen: dict[str, dict[str, Measured]] = {}
    study = _study((folder / STUDY).read_bytes(), _described(folder))
    findings += _missing_runs(results, study)
    for entry in results["run_table"]:
        name = entry["run"]
        # Of a run whose log was not kept only the record is left: nothing can be computed again.
        seen[name] = {q: Measured(_real(v["value"]), _real(v["error"])) for q, v in entry["quantities"].items()}
        if entry["log"] is None:
            continue
        try:
            log = logs.read_log(folder / entry["log"])
        except (OSError, LogError, RecordError) as problem:
            findings.append(f"{name}: {problem}")
            continue
        if log.verdict is None:
            incomplete.append(f"{name}: the log ends before its verdict")
            continue
        _, differing, recomputed = _review_log(name, log)
        findings += [*differing, *(f"{name}: the log is about another {what}" for what in _about_another(folder, results, entry, log))]
        if log.verdict["verdict"] != entry["verdict"]:
            findings.append(f"{name}: the table says {entry['verdict']}, the log {log.verdict['verdict']}")
        for quantity, value in recomputed.items():
            told = seen[name].get(quantity)
            if told is None or not agree(told.value, value.value if math.isfinite(value.value) else math.inf):
                recorded = "absent" if told is None else repr(told.value)
                findings.append(f"{name}: {quantity} is {recorded} in the table, the signals give {value.value!r}")
        seen[name] = recomputed
    return _judge_again(study, results, seen, findings), findings, incomplete


def _about_another(folder: Path, results: Mapping[str, Any], entry: Mapping[str, Any], log: RunLog) -> Iterator[str]:
    """In what a log is not the one that the table speaks of."""
    facts, bracket = json.loads(log.run["facts"]), results["bound"]["maneuver_time"]
    parameters = {name: float(Fraction(value)) for name, value in json.loads(log.run["parameters"]).items()}
    agreeing = {
        "run": log.run["run"] == entry["run"] and entry["log"] == f"{RUNS}/{entry['run']}.mcap",
        "sample": parameters == entry["parameters"] and json.loads(log.run["nominal"]) is entry["nominal"],
        "end": log.run["status"] == entry["status"] and log.run["detail"] == entry["detail"],
        "study": log.run["study_sha256"] == results["study"]["sha256"] == files.sha256(folder / STUDY),
        "FMU": log.run["fmu_sha256"] == results["plant"]["sha256"],
        "command": json.loads(log.attachments[COMMAND_FILE]) == results["command"],
        "bracket": (facts["lower"], facts["upper"]) == (bracket["lower"], bracket["upper"]),
        "displacement": facts["displacement"] == results["task"]["displacement"],
    }
    return (what for what, agrees in agreeing.items() if not agrees)


def _missing_runs(results: Mapping[str, Any], study: Mapping[str, Any]) -> Iterator[str]:
    """What the run table leaves out of the study's box, and whether it was counted rightly."""
    table = results["run_table"]
    if results["command"] is None:
        return
    axes = [_axis(written) for written in study.get("uncertainty", [])]
    made = {tuple(entry["parameters"][axis.parameter] for axis in axes) for entry in table}
    asked = math.prod(axis.samples for axis in axes)
    there = asked <= len(made) and all(tuple(map(float, sample)) in made for sample in itertools.product(*(axis.values for axis in axes)))
    if not there:
        yield f"the study's box has {asked} samples, and not all of them are among the runs"
    if [entry["nominal"] for entry in table].count(True) != 1:
        yield "the nominal plant is not run once"
    verdicts = [entry["verdict"] for entry in table]
    counts = {"total": len(table), "passed": verdicts.count("pass"), "failed": verdicts.count("fail"), "errors": verdicts.count("error")}
    if counts != results["runs"]:
        yield f"the runs are counted as {results['runs']}, the table has {counts}"


def _axis(written: Mapping[str, Any]) -> Uncertainty:
    lower, upper = written["range"]
    return Uncertainty(written["parameter"], Decimal(lower), Decimal(upper), int(written.get("samples", GRID)))


def _judge_again(
    study: Mapping[str, Any], results: Mapping[str, Any], seen: Mapping[str, Mapping[str, Measured]], findings: list[str]
) -> tuple[Row, ...]:
    """Every requirement of the folder's own study, judged on the values of all runs."""
    asked = _asked(study, results["plant"]["output"]["name"])
    table = {entry["run"]: entry for entry in results["run_table"]}
    rows, judgements = [], []
    # Without a command nothing is run: a task that is impossible fails (its certificate is checked apart), of another nothing is decided.
    unrun = Verdict.FAIL if results["bound"]["status"] == "impossible" else Verdict.UNDECIDED
    for entry in results["requirements"]:
        requirement = _as_requirement(entry)
        if asked.pop(entry["id"], None) != _question(requirement):
            findings.append(f"{entry['id']}: the study asks for something else")
        quantity = str(requirement.quantity)
        runs = [RunVerdict(name, table[name]["nominal"], values.get(quantity), table[name]["detail"]) for name, values in seen.items()]
        judgement = judge(requirement, runs)
        if results["command"] is None:
            judgement = replace(judgement, verdict=unrun)
        judgements.append(judgement)
        rows.append(Row(entry["id"], entry["value"], _value(judgement.measured), judgement.verdict.value))
        findings += _compare(entry, judgement)
    findings += [f"{name}: the study asks for it, the results do not have it" for name in asked]
    broken = [Verdict.ERROR for values in seen.values() if not values]
    nothing = [unrun] if results["command"] is None else []
    verdict = overall([*(judgement.verdict for judgement in judgements), *broken, *nothing])
    if verdict.value != results["verdict"]:
        findings.append(f"the verdict is recorded as {results['verdict']}, the signals give {verdict.value}")
    return tuple(rows)


Question = tuple[str, float | None, float | None, str]
"""Quantity, limits and scope of a requirement."""


def _question(requirement: Requirement) -> Question:
    return str(requirement.quantity), requirement.minimum, requirement.maximum, requirement.scope


def _study(source: bytes, description: bytes | None) -> dict[str, Any]:
    """The study's table in plain numbers; units of variables are those of the FMU's `description` (modelDescription.xml)."""

    def described() -> Description | None:
        try:
            return None if description is None else read_description(description)
        except FmuError as problem:
            raise ValueError(str(problem)) from None

    return convert_units(parse(Path(STUDY), source), described)[0]


def _described(folder: Path) -> bytes | None:
    path = folder / "plant" / DESCRIPTION
    return path.read_bytes() if path.is_file() else None


def _asked(study: Mapping[str, Any], output: str) -> dict[str, Question]:
    """The requirements as the study's file has them, by their ids; `output` is the name of the controlled one."""
    asked: dict[str, Question] = {}
    for written in study.get("requirement", []):
        quantity = parse_quantity(written["quantity"])
        if quantity.variable == "output":
            quantity = Quantity(quantity.name, variable=output)
        lowest, highest = (None if written.get(key) is None else float(written[key]) for key in ("min", "max"))
        asked[written["id"]] = str(quantity), lowest, highest, written.get("scope") or ("box" if study.get("uncertainty") else "nominal")
    return asked


def _compare(entry: Mapping[str, Any], judgement: Judgement) -> Iterable[str]:
    if judgement.verdict.value != entry["verdict"]:
        yield f"{entry['id']}: the verdict is recorded as {entry['verdict']}, the signals give {judgement.verdict.value}"
    again = number(_value(judgement.measured))
    if (again is None) != (entry["value"] is None) or (again is not None and not agree(entry["value"], again)):
        yield f"{entry['id']}: the value is recorded as {entry['value']!r}, the signals give {again!r}"


def _as_requirement(entry: Mapping[str, Any]) -> Requirement:
    quantity = parse_quantity(entry["quantity"])
    return Requirement(entry["id"], entry["text"], quantity, entry["min"], entry["max"], entry["unit"], entry["scope"])


def _real(value: float | None) -> float:
    return math.inf if value is None else float(value)


__all__: Sequence[str] = ["Review", "ReviewStatus", "Row", "review"]
