"""The report as one HTML page that needs nothing else: no network, no script, fit for print. The only module that imports jinja2.

Everything that a study says is text: it is escaped, and the page's own policy forbids scripts and requests altogether.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, StrictUndefined, Template
from markupsafe import Markup

from reports import formatting
from reports.errors import RecordError
from reports.files import write_atomically

MOST_RUNS = 200
MOST_SEGMENTS = 60

_VERDICTS = {"pass": ("PASS", "✓"), "fail": ("FAIL", "✕"), "undecided": ("UNDECIDED", "?"), "error": ("ERROR", "!")}
_BOUNDS = {
    "proved": ("Proved", "No admissible command is faster than the lower side; the command below takes the time of the upper side."),
    "bracketed": ("Bracketed", "The minimum time lies between these two numbers, but at least one of them stands without a proof."),
    "impossible": ("Impossible", "No command within the limits performs this task."),
}


def write_page(path: str | os.PathLike[str], results: Mapping[str, Any], charts: Mapping[str, str]) -> None:
    """Write `render(results, charts)` atomically. Raises `RecordError`, `OSError`."""
    write_atomically(path, render(results, charts).encode("utf-8", "replace"))


def render(results: Mapping[str, Any], charts: Mapping[str, str]) -> str:
    """The page for `results` (slewcert-results/1); `charts` are captions and SVG texts made by `reports.charts`.

    Raises `RecordError` for results that call themselves passed while a requirement is not, or that this version does not know.
    """
    if results.get("format") != "slewcert-results/1":
        raise RecordError(f'results have "format": "slewcert-results/1"; these have {results.get("format")!r}')
    if results["verdict"] == "pass" and any(r["verdict"] != "pass" for r in results["requirements"]):
        raise RecordError("the results contradict themselves: the verdict is pass, but not every requirement's")
    template, css = _template("page.html.j2")
    return template.render(
        css=css,
        r=results,
        verdict=_verdict(results["verdict"]),
        lead=_lead(results),
        requirements=[_requirement(r) for r in results["requirements"]],
        bound=_bound(results["bound"]),
        command=_command(results["command"]),
        shaper=_shaper(results.get("shaper")),
        task=_task(results),
        runs=_runs(results),
        units=[{**u, "value": formatting.with_unit(formatting.number(u["value"]), u["unit"])} for u in results.get("units", ())],
        charts={caption: Markup(svg) for caption, svg in charts.items()},  # their labels are escaped
    )


def render_comparison(record: Mapping[str, Any], charts: Mapping[str, str]) -> str:
    """The page for `record` (slewcert-comparison/1) and its charts."""
    template, css = _template("comparison.html.j2")
    minimum = record["minimum_time"]
    return template.render(
        css=css,
        r=record,
        requirements=[
            {**asked, "limit": formatting.with_unit(formatting.bounds(asked), asked["unit"])} for asked in record["requirements"]
        ],
        commands=[{**row, "verdict": _verdict(row["verdict"]), "cells": _cells(record, row)} for row in record["commands"]],
        minimum=None if minimum is None else (_BOUNDS.get(minimum["status"], (str(minimum["status"]), ""))[0], minimum),
        charts={caption: Markup(svg) for caption, svg in charts.items()},  # their labels are escaped
    )


def render_fuel(
    *, title: str, record: Mapping[str, Any], choices: Sequence[Mapping[str, Any]], how_to: Sequence[str], charts: Mapping[str, str]
) -> str:
    """The page of a sweep of budgets: its `record` (docs/schemas.md), the prudent choices, how a point becomes a study, and its charts."""
    template, css = _template("fuel.html.j2")
    return template.render(
        css=css,
        title=title,
        r=record,
        choices=choices,
        how_to=how_to,
        charts={caption: Markup(svg) for caption, svg in charts.items()},  # their labels are escaped
    )


def _cells(record: Mapping[str, Any], row: Mapping[str, Any]) -> list[dict[str, Any] | None]:
    """A value and a verdict for each requirement; None where a command was not asked for it."""
    cells: list[dict[str, Any] | None] = []
    for asked in record["requirements"]:
        found = row["requirements"].get(asked["id"])
        value = (
            None
            if found is None
            else formatting.quantity(asked["quantity"], found["value"], found["verdict"], (asked["min"], asked["max"]))
        )
        cells.append(None if found is None else {"value": value, "verdict": _verdict(found["verdict"])})
    return cells


@cache
def _template(name: str) -> tuple[Template, Markup]:
    """A template of ours with its filters, and the style sheet; compiled once, which takes as long as ten pages."""
    folder = files("reports")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    environment.filters |= {
        "number": formatting.number,
        "exact": formatting.exact,
        "at_least": formatting.at_least,
        "at_most": formatting.at_most,
        "with_unit": formatting.with_unit,
        "anchor": _anchor,
        "link": _link,
    }
    css = Markup((folder / "page.css").read_text(encoding="utf-8"))  # our own file
    return environment.from_string((folder / name).read_text(encoding="utf-8")), css


def _verdict(verdict: str) -> dict[str, str]:
    """How a verdict looks; one that this version does not know looks like an error."""
    word, mark = _VERDICTS.get(verdict, (str(verdict).upper(), "!"))
    return {"word": word, "mark": mark, "kind": verdict if verdict in _VERDICTS else "error"}


def _lead(results: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    requirements = results["requirements"]
    if results["bound"]["status"] == "impossible":
        return "The task is impossible: no command within the limits performs it. Nothing was run."
    if not requirements:
        return "The study states no requirement: nothing was judged."
    named = {kind: [r["id"] for r in requirements if _verdict(r["verdict"])["kind"] == kind] for kind in _VERDICTS}
    if results["verdict"] == "pass":
        return "The requirement holds." if len(requirements) == 1 else f"All {len(requirements)} requirements hold."
    parts = []
    for kind, words in (("fail", "not met"), ("error", "not judged, because of errors"), ("undecided", "undecided")):
        if named[kind]:
            parts.append(f"{words}: {', '.join(named[kind])}")
    sentence = "; ".join(parts) or "see the runs below"
    return f"{len(named['pass'])} of {len(requirements)} requirements hold. {formatting.sentence(sentence)}."


def _requirement(r: Mapping[str, Any]) -> dict[str, Any]:
    value = formatting.quantity(r["quantity"], r["value"], r["verdict"], (r["min"], r["max"]))
    error, si = r["error"], r.get("si")
    return {
        "id": r["id"],
        "text": r["text"],
        "quantity": r["quantity"],
        "scope": r["scope"],
        "limit": formatting.with_unit(formatting.bounds(r), r["unit"]),
        "value": formatting.with_unit(value, r["unit"]),
        "si_limit": formatting.with_unit(formatting.bounds(si), si["unit"]) if si else "",
        "si_value": formatting.with_unit(formatting.number(si["value"], (si["min"], si["max"])), si["unit"]) if si else "",
        "error": f"± {formatting.number(error, digits=2)}" if error else "",
        "margin": formatting.number(r["margin"], (0.0,), digits=3),
        "verdict": _verdict(r["verdict"]),
        "worst_run": r["worst_run"],
        "reason": formatting.sentence(r["reason"]),
    }


def _bound(bound: Mapping[str, Any]) -> dict[str, Any]:
    times = bound["maneuver_time"] or {"lower": None, "upper": None}
    # A status this version does not know is shown as it is, and never as proved.
    word, sentence = _BOUNDS.get(bound["status"], (str(bound["status"]), ""))
    common, low, high = formatting.bracket(times["lower"], times["upper"])
    return {
        "kind": bound["status"] if bound["status"] in _BOUNDS else "bracketed",
        "word": word,
        "sentence": sentence,
        "reason": formatting.sentence(bound.get("reason")),
        "times": bound["maneuver_time"],
        "common": common,
        "lower": low,
        "upper": high,
        "gap": formatting.number(formatting.gap(times["lower"], times["upper"]), (0.0,), digits=2),
        "switches": bound["switches"],
        "fuel": bound["fuel"],
        "certificate": bound["certificate"],
    }


def _command(command: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if command is None:
        return None
    segments = command["segments"]
    end = (segments[0]["start"] if segments else 0.0) + command["maneuver_time"]
    stops = [s["start"] for s in segments[1:]] + [end]
    rows = [{**s, "stop": stop, "duration": stop - s["start"]} for s, stop in zip(segments, stops, strict=False)]
    return {"rows": rows[:MOST_SEGMENTS], "left_out": len(rows[MOST_SEGMENTS:]), "end": end, "tail": command["tail"]}


def _shaper(shaper: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The shaper of the command, and what is proven of it."""
    if shaper is None:
        return None
    reference = shaper["reference"]
    lasting = f", which takes {formatting.number(reference['maneuver_time'])} s,"
    what = {"step": "a step", "rigid": f"the fastest move of the rigid part{lasting}", "file": f"the command of a file{lasting}"}
    damping = shaper["damping"]
    damped = "" if damping is None else f" and damping ratios from {formatting.number(damping[0])} to {formatting.number(damping[1])}"
    modes = (f"{formatting.number(m['frequency'])} rad/s with damping {formatting.number(m['damping'])}" for m in shaper["modes"])
    return {
        **shaper,
        "reference": what.get(reference["kind"], str(reference["kind"])),
        "modes": ", ".join(modes),
        "impulses": list(zip(shaper["times"], shaper["amplitudes"], strict=True)),
        "least": shaper["least_duration"],
        "bands": [
            "mode {}: {} to {} of the unshaped vibration, over frequencies from {} to {} times the modelled one{}".format(
                band["mode"], *map(formatting.exact, band["worst_residual"]), *map(formatting.number, band["frequency"]), damped
            )
            for band in shaper["bands"]
        ],
    }


def _task(results: Mapping[str, Any]) -> dict[str, str]:
    """What was asked, in words."""
    plant, task = results["plant"], results["task"]
    given, taken = plant["input"], plant["output"]
    low, high = (formatting.number(x) for x in task["input_limits"])
    rest = {"state": "at rest in every state", "output": "output at rest, the input may still decay"}
    sampled = {"Sample time": formatting.with_unit(formatting.number(task["sample_time"]), "s")} if task.get("sample_time") else {}
    begins = task.get("initial_state")
    named = begins.items() if isinstance(begins, Mapping) else enumerate(begins or [], 1)
    begun = ", ".join(f"{name}: {formatting.number(x)}" for name, x in named)
    how = "rest to rest" if begins is None else f"to rest; it begins away from rest by {begun}"
    return {
        "Move": f"{taken['name']} by {formatting.with_unit(formatting.number(task['displacement']), taken['unit'])}, {how}",
        "Input limits": f"{given['name']} from {low} to {formatting.with_unit(high, given['unit'])}",
        **sampled,
        "At rest": rest.get(task["rest"], str(task["rest"])),
        "Robustness": "as far as the shaper goes" if results.get("shaper") else _robustness(task["robustness"]),
    }


def _robustness(robustness: object) -> str:
    match robustness:
        case 0:
            return "none: for the nominal plant"
        case 1:
            return "one further zero at each flexible mode"
        case int():
            return f"{robustness} further zeros at each flexible mode"
        case "box":
            return "for every plant of the uncertainty box"
        case _:
            return str(robustness)


def _runs(results: Mapping[str, Any]) -> dict[str, Any]:
    """The run table; of many runs those that somebody will look for."""
    table: Sequence[Mapping[str, Any]] = results["run_table"]
    worst = {r["worst_run"] for r in results["requirements"] if r["worst_run"]}
    first = [row for row in table if row["nominal"] or row["verdict"] != "pass" or row["run"] in worst]
    chosen = {row["run"] for row in first[:MOST_RUNS]}
    for row in table:
        if len(chosen) >= MOST_RUNS:
            break
        chosen.add(row["run"])
    shown = [row for row in table if row["run"] in chosen]
    names = list(dict.fromkeys(name for row in shown for name in row["quantities"]))
    parameters = list(dict.fromkeys(name for row in shown for name in row["parameters"]))
    rows = []
    for row in shown:
        cells = [row["quantities"].get(name) for name in names]
        rows.append(
            {
                "run": row["run"],
                "nominal": row["nominal"],
                "worst_of": [r["id"] for r in results["requirements"] if r["worst_run"] == row["run"]],
                "parameters": [formatting.number(row["parameters"].get(name)) for name in parameters],
                "quantities": [
                    formatting.NOTHING if cell is None else formatting.quantity(name, cell["value"], row["verdict"])
                    for name, cell in zip(names, cells, strict=True)
                ],
                "status": row["status"],
                "detail": row["detail"],
                "verdict": _verdict(row["verdict"]),
                "log": row["log"],
            }
        )
    return {"rows": rows, "names": names, "parameters": parameters, "left_out": len(table) - len(rows), "shown": chosen}


def _anchor(run: str) -> str:
    """A run's place in the page."""
    return "run-" + re.sub(r"[^A-Za-z0-9_.-]+", "-", run)


def _link(path: str) -> str:
    """A file of the evidence folder as a link: always relative, whatever the path says."""
    return "./" + quote(path)
