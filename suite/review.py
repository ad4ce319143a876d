"""The review: every quantity computed again from the logged signals, every verdict judged again, compared with what was recorded."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from reports import logs, manifest
from reports.errors import LogError, ManifestError, RecordError
from reports.records import RunLog
from suite.campaign import run_verdict
from suite.evidence import RESULTS, number
from suite.observations import measured_in, observe, requirements_in
from suite.quantities import evaluate
from suite.quantity_names import parse_quantity
from suite.verdicts import Judgement, Measured, RunVerdict, Verdict, judge, overall

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
        return {"status": str(self.status), "requirements": [row.to_dict() for row in self.rows], "files": files, "findings": list(self.findings)}


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
    except (KeyError, ValueError, TypeError) as problem:
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
    except (OSError, ValueError) as problem:
        return Review(ReviewStatus.TAMPERED, (), ((RESULTS, "missing"),), (f"{RESULTS} cannot be read: {problem}",))
    files = tuple((status.path, str(status.status)) for status in statuses)
    tampered = [f"{path} is {status}" for path, status in files if status != "ok"]
    try:
        rows, findings, incomplete = _review_results(folder, results)
    except (KeyError, ValueError, TypeError, AssertionError) as problem:
        return Review(ReviewStatus.TAMPERED, (), files, (*tampered, f"{RESULTS} or a log is malformed: {problem!r}"))
    if tampered:
        status = ReviewStatus.TAMPERED
    elif findings:
        status = ReviewStatus.DIFFERS
    else:
        status = ReviewStatus.INCOMPLETE if incomplete else ReviewStatus.CONFIRMED
    return Review(status, rows, files, (*tampered, *findings, *incomplete))


def _review_results(folder: Path, results: Mapping[str, Any]) -> tuple[tuple[Row, ...], list[str], list[str]]:
    findings: list[str] = []
    incomplete: list[str] = []
    seen: dict[str, dict[str, Measured]] = {}
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
        findings += differing
        if log.verdict["verdict"] != entry["verdict"]:
            findings.append(f"{name}: the table says {entry['verdict']}, the log {log.verdict['verdict']}")
        for quantity, value in recomputed.items():
            told = seen[name].get(quantity)
            if told is None or not agree(told.value, value.value if math.isfinite(value.value) else math.inf):
                findings.append(f"{name}: {quantity} is {'absent' if told is None else repr(told.value)} in the table, the signals give {value.value!r}")
        seen[name] = recomputed
    return *_judge_again(folder, results, seen, findings), incomplete


def _judge_again(
    folder: Path, results: Mapping[str, Any], seen: Mapping[str, Mapping[str, Measured]], findings: list[str]
) -> tuple[tuple[Row, ...], list[str]]:
    """Every requirement of the folder's own study, judged on the values of all runs."""
    from suite.study_file import parse

    asked = {r["id"]: r for r in parse(folder / "study.toml", (folder / "study.toml").read_bytes()).get("requirement", [])}
    table = {entry["run"]: entry for entry in results["run_table"]}
    rows, judgements = [], []
    for entry in results["requirements"]:
        study = asked.pop(entry["id"], None)
        if study is None or any(_real_or_none(study.get(key)) != entry[key] for key in ("min", "max")) or study["quantity"] != entry["quantity"]:
            findings.append(f"{entry['id']}: the study asks for something else")
        requirement = _as_requirement(entry)
        quantity = str(requirement.quantity)
        runs = [RunVerdict(name, table[name]["nominal"], values.get(quantity), table[name]["detail"]) for name, values in seen.items()]
        judgement = judge(requirement, runs)
        judgements.append(judgement)
        rows.append(Row(entry["id"], entry["value"], _value(judgement.measured), judgement.verdict.value))
        if results["command"] is not None:
            findings += _compare(entry, judgement)
    findings += [f"{name}: the study asks for it, the results do not have it" for name in asked]
    if results["command"] is not None:
        broken = [Verdict.ERROR for values in seen.values() if not values]
        verdict = overall([*(judgement.verdict for judgement in judgements), *broken])
        if verdict.value != results["verdict"]:
            findings.append(f"the verdict is recorded as {results['verdict']}, the signals give {verdict.value}")
    return tuple(rows), findings


def _compare(entry: Mapping[str, Any], judgement: Judgement) -> Iterable[str]:
    if judgement.verdict.value != entry["verdict"]:
        yield f"{entry['id']}: the verdict is recorded as {entry['verdict']}, the signals give {judgement.verdict.value}"
    again = number(_value(judgement.measured))
    if (again is None) != (entry["value"] is None) or (again is not None and not agree(entry["value"], again)):
        yield f"{entry['id']}: the value is recorded as {entry['value']!r}, the signals give {again!r}"


def _as_requirement(entry: Mapping[str, Any]) -> Any:
    from suite.study import Requirement

    quantity = parse_quantity(entry["quantity"])
    return Requirement(entry["id"], entry["text"], quantity, entry["min"], entry["max"], entry["unit"], entry["scope"])


def _real(value: float | None) -> float:
    return math.inf if value is None else float(value)


def _real_or_none(value: object) -> float | None:
    return None if value is None else float(str(value))


__all__: Sequence[str] = ["Review", "ReviewStatus", "Row", "review"]
