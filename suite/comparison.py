"""`slewcert compare`: several commands for the same machine side by side, from their evidence folders; studies are verified first.

With `--shaper` one study stands for several: each is the study with another `command.shaper`, on the same runs and requirements.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.commands import Command
from relaxations.errors import RelaxationsError
from reports import charts, files, logs, manifest, pages
from reports.errors import LogError, ManifestError, RecordError
from suite import bundles
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.evidence import RESULTS
from suite.observations import observe
from suite.study import Study
from suite.study_file import parse, read_source
from suite.study_meaning import understand
from suite.verification import verify

FORMAT = "slewcert-comparison/1"
RECORD, PAGE = "comparison.json", "comparison.html"
SAME = ("displacement", "input_limits")  # members of the task in which all agree
SHAPER_LINE = re.compile(r'(?m)^(shaper\s*=\s*)(?:"[^"\n]*"|\'[^\'\n]*\')')
SAMPLES = 4000  # of a curve in a picture
SEEN = 2.0  # times the longest move, as much as a picture shows


class ComparisonError(SuiteError):
    """What was given cannot be compared."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The record as written, and where the page lies."""

    record: dict[str, Any]
    page: Path


def variants(file: Path, kinds: Sequence[str]) -> list[tuple[str, Study]]:
    """The study once with each shaper, with the kinds as names; raises `StudyError`."""
    source = read_source(file)
    text, data = source.decode("utf-8"), parse(file, source)
    if data.get("command", {}).get("kind") != "shaper":
        raise StudyError(str(file), [Mistake("command.kind", data.get("command", {}).get("kind", ABSENT), 'must be "shaper" to vary it')])
    made = []
    for kind in dict.fromkeys(kinds):
        changed = SHAPER_LINE.sub(lambda found, kind=kind: f"{found[1]}{json.dumps(kind)}", text).encode()
        wanted = {**data, "command": {**data["command"], "shaper": kind}}
        if parse(file, changed) != wanted:
            raise StudyError(
                str(file), [Mistake("command.shaper", data["command"].get("shaper"), "must stand on a line of its own to be varied")]
            )
        study, mistakes = understand(wanted, file, changed)
        if study is None or mistakes:
            raise StudyError(str(file), mistakes)
        made.append((kind, study))
    return made


def named_studies(paths: Sequence[Path], kinds: Sequence[str]) -> tuple[list[tuple[str, Study]], list[tuple[str, Path]]]:
    """Studies that are to be verified and folders that are there already, each with its name in the comparison."""
    studies: list[tuple[str, Study]] = []
    folders: list[tuple[str, Path]] = []
    for path in paths:
        if path.is_dir():
            folders.append((path.name, path))
        elif kinds:
            studies += [(kind if len(paths) == 1 else f"{path.stem} {kind}", study) for kind, study in variants(path, kinds)]
        else:
            source = read_source(path)
            study, mistakes = understand(parse(path, source), path, source)
            if study is None or mistakes:
                raise StudyError(str(path), mistakes)
            studies.append((path.stem, study))
    if kinds and not studies:
        raise ComparisonError("--shaper varies a study, and no study is given")
    names = [name for name, _ in (*studies, *folders)]
    if len(names) < 2:
        raise ComparisonError(
            "a comparison has at least two commands: name several studies or evidence folders, or one study and several --shaper"
        )
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ComparisonError(f"{', '.join(twice)}: two of the same name; rename one of the folders or studies")
    return studies, folders


def compare(
    paths: Sequence[Path],
    kinds: Sequence[str],
    out: Path,
    *,
    jobs: int = 1,
    force: bool = False,
    about: Callable[[str], None] = lambda name: None,
) -> Comparison:
    """Verify the studies into folders within `out`, and write the page that compares them with each other and with the folders given.

    Raises `ComparisonError`, `StudyError`, `FolderError`.
    """
    studies, folders = named_studies(paths, kinds)
    kept = dict(folders)
    _require_alike({name: _asked(study) for name, study in studies})  # before an hour of runs
    for name, study in studies:
        about(name)
        kept[name] = verify(study, out / re.sub(r"[^A-Za-z0-9_.-]+", "-", name), jobs=jobs, force=force).folder
    order = [*(name for name, _ in studies), *(name for name, _ in folders)]
    found = {name: _results(kept[name]) for name in order}
    _require_same(found)
    record = _record(found, kept, out)
    out.mkdir(parents=True, exist_ok=True)
    files.write_atomically(out / RECORD, files.json_bytes(record))
    drawings = _drawings(found, kept)
    files.write_atomically(out / PAGE, pages.render_comparison(record, drawings).encode())
    return Comparison(record, out / PAGE)


def _results(folder: Path) -> dict[str, Any]:
    try:
        changed = [status.path for status in manifest.check_manifest(folder) if str(status.status) != "ok"]
        results = json.loads((folder / RESULTS).read_bytes())
    except (ManifestError, OSError, ValueError, RecursionError) as problem:
        raise ComparisonError(f"{folder} is no evidence folder that slewcert finished: {problem}") from None
    if changed:
        raise ComparisonError(f"{folder} is not as it was written: {', '.join(changed)}")
    return results


def _asked(study: Study) -> dict[str, Any]:
    """Of a study what must be the same in all."""
    return {
        "output": study.plant.output,
        "displacement": float(study.maneuver.displacement),
        "input_limits": [float(study.limits.lower), float(study.limits.upper)],
    }


def _require_same(found: dict[str, dict[str, Any]]) -> None:
    """Only commands for one task can be compared: plant, output, move and limits."""
    _require_alike(
        {
            name: {
                "plant": results["plant"]["name"],
                "output": results["plant"]["output"],
                **{key: results["task"][key] for key in SAME},
            }
            for name, results in found.items()
        }
    )


def _require_alike(tasks: dict[str, dict[str, Any]]) -> None:
    (first, task), *others = tasks.items() or [("", {})]
    for name, other in others:
        for what, value in task.items():
            if value != other[what]:
                raise ComparisonError(f"{first} and {name} are about another {what.replace('_', ' ')}: {value!r} and {other[what]!r}")


def _record(found: dict[str, dict[str, Any]], kept: dict[str, Path], out: Path) -> dict[str, Any]:
    first = next(iter(found.values()))
    rows = []
    for name, results in found.items():
        bound, command, shaper = results["bound"], results["command"], results.get("shaper")
        lower = (bound["maneuver_time"] or {}).get("lower")
        time = None if command is None else command["maneuver_time"]
        nominal = next((run for run in results["run_table"] if run["nominal"]), None)
        rows.append(
            {
                "name": name,
                "command": results["task"]["kind"],
                "shaper": None
                if shaper is None
                else {key: shaper[key] for key in ("kind", "duration", "least_duration", "worst_residual", "insensitivity")},
                "maneuver_time": time,
                "over_lower_bound": None if not (time and lower) else time / lower - 1.0,
                "nominal": {} if nominal is None else {key: value["value"] for key, value in nominal["quantities"].items()},
                "worst": _worst(results),
                "requirements": {r["id"]: {"value": r["value"], "verdict": r["verdict"]} for r in results["requirements"]},
                "verdict": results["verdict"],
                "evidence": _relative(kept[name], out),
            }
        )
    asked: dict[str, dict[str, Any]] = {}
    for results in found.values():
        for requirement in results["requirements"]:
            asked.setdefault(
                requirement["id"], {key: requirement[key] for key in ("id", "text", "quantity", "min", "max", "unit", "scope")}
            )
    bounds = {name: results["bound"] for name, results in found.items()}
    same = len({json.dumps(bound["maneuver_time"]) for bound in bounds.values()}) == 1
    return {
        "format": FORMAT,
        "version": first["version"],
        "title": first["title"],
        "plant": {key: first["plant"][key] for key in ("name", "input", "output")},
        "task": {key: first["task"][key] for key in SAME},
        "uncertainty": first["uncertainty"],
        "minimum_time": {"status": next(iter(bounds.values()))["status"], **(first["bound"]["maneuver_time"] or {})} if same else None,
        "requirements": list(asked.values()),
        "commands": rows,
    }


def _worst(results: dict[str, Any]) -> dict[str, float | None]:
    """The largest value of each quantity over all runs."""
    names = dict.fromkeys(name for run in results["run_table"] for name in run["quantities"])
    worst: dict[str, float | None] = {}
    for name in names:
        values = [run["quantities"][name]["value"] for run in results["run_table"] if name in run["quantities"]]
        worst[name] = None if None in values else max(values)
    return worst


def _relative(folder: Path, out: Path) -> str:
    try:
        return folder.resolve().relative_to(out.resolve()).as_posix()
    except ValueError:
        return folder.resolve().as_posix()


def _drawings(found: dict[str, dict[str, Any]], kept: dict[str, Path]) -> dict[str, str]:
    """The nominal runs on one another, and each quantity of the box over each of its axes."""
    drawings: dict[str, str] = {}
    curves: dict[str, tuple[Any, Any, Any]] = {}
    target, scale = 0.0, 1.0
    end = max((Command.from_dict(results["command"]).end for results in found.values() if results["command"] is not None), default=0.0)
    for name, results in found.items():
        nominal = next((run for run in results["run_table"] if run["nominal"] and run["log"] is not None), None)
        if nominal is None:
            continue
        try:
            run = observe(logs.read_log(kept[name] / nominal["log"]))
        except (LogError, RecordError, RelaxationsError, LookupError, ValueError, TypeError) as problem:
            raise ComparisonError(f"{kept[name] / nominal['log']}: {problem}") from None
        last = min(int(np.searchsorted(run.times, SEEN * end)) + 1, len(run.times))
        stride = max(last // SAMPLES, 1)
        at = np.union1d(np.arange(0, last, stride), np.flatnonzero(np.diff(run.input, append=run.input[-1]) != 0.0) + 1)
        at = at[at < last]
        curves[name] = run.times[at], run.input[at], run.output[at]
        target, scale = run.target, run.scale
    entry, output = (next(iter(found.values()))["plant"][key] for key in ("input", "output"))
    if curves:
        title = "Commands and responses of the nominal plant"
        labels = [f"{signal['name']} [{signal['unit']}]" if signal["unit"] else signal["name"] for signal in (entry, output)]
        drawings[title] = charts.responses(
            title, curves, end=end, target=target, displacement=scale, command_label=labels[0], output_label=labels[1]
        )
    for axis in next(iter(found.values()))["uncertainty"]:
        lines = {}
        for name, results in found.items():
            others = [other["parameter"] for other in results["uncertainty"] if other["parameter"] != axis["parameter"]]
            nominal = next((run for run in results["run_table"] if run["nominal"]), None)
            chosen = [
                (run["parameters"][axis["parameter"]], run["quantities"]["residual_vibration"]["value"])
                for run in results["run_table"]
                if nominal is not None
                and axis["parameter"] in run["parameters"]
                and all(run["parameters"][other] == nominal["parameters"][other] for other in others)
                and run["quantities"].get("residual_vibration", {}).get("value") is not None
            ]
            if chosen:
                lines[name] = tuple(zip(*sorted(chosen), strict=True))
        if lines:
            title = f"Residual vibration over {axis['parameter']}"
            label = f"{axis['parameter']} [{axis['unit']}]" if axis["unit"] else axis["parameter"]
            drawings[title] = charts.sweeps(title, lines, parameter_label=label, quantity_label="residual vibration / move")
    try:
        return drawings | bundles.drawings({name: (results, kept[name]) for name, results in found.items()})
    except (LogError, RecordError, RelaxationsError, LookupError, ValueError, TypeError) as problem:
        raise ComparisonError(f"a log of the evidence cannot be read: {problem}") from None
