"""From results to the evidence folder: `results.json` is the single source of every number that the page and JUnit show."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.confinement import in_force
from relaxations.bounds import Bound
from relaxations.onoff.weights import Weighted
from relaxations.response import jumps
from relaxations.shaping.sensitivity import residual
from reports import charts, files, junit, layouts, logs, manifest, pages
from suite import bundles, weighing
from suite.bound_records import bound_record
from suite.campaign import RunResult, interface
from suite.checks import CERTIFICATE, COST, LEAST_FUEL, ON_GRID, trusted
from suite.design import Design, least_fuel_words
from suite.observations import INPUT, observe
from suite.quantities import Observation
from suite.quantity_names import UnitKind
from suite.rounding import number
from suite.shaped import Shaped
from suite.shaper_files import chart
from suite.study import Requirement, Study
from suite.study_file import printable
from suite.units import Scale, as_declared
from suite.verdicts import Judgement, Measured, Verdict, judge_run, limit

FORMAT = "slewcert-results/1"
RESULTS, REPORT, JUNIT, LAYOUT = "results.json", "report.html", "junit.xml", "layout.json"
SOLVERS = ("cvxpy", "clarabel", "numpy", "scipy", "fmpy", "scikit-sundae", "mcap", "python-flint")
BRACKETED = "The bracket of the minimum time is not proven on both sides: {reason}."
UNPROVEN = (
    "Requirements are judged by values measured on simulations of the FMU at samples of the box; between them nothing is known.",
    "The distance between the FMU and the linear plant of the proof (model_mismatch) is measured, not proven.",
)
NO_REQUIREMENT = "The study has no requirement: the command was run and measured, but nothing was judged."
TRUST_BASE = (
    "For the bracket: python-flint {flint}, CPython {python}, {lines} in the checker, which shares nothing with what solves.",
    "For the runs: the FMU's own binary and its solver, run in a process of its own.",
    "For the verdicts: the numerical error that a finer run shows; NumPy, and the quantities' definitions, which review applies again.",
)


def collect(study: Study, design: Design, judgements: Sequence[Judgement], runs: Sequence[RunResult], verdict: Verdict) -> dict[str, Any]:
    """`slewcert-results/1`: everything that was asked, found and judged, without clock times, so that equal runs give equal bytes."""
    fmu = study.plant.fmu
    assert fmu is not None
    certificate = None if design.bound.certificate is None else CERTIFICATE
    bound = bound_record(design.bound, design.bound.command, float(study.plant.initial_input), certificate)
    del bound["seconds"]
    if design.least is not None:
        bound["least_fuel"] = {"lower": design.least, "certificate": LEAST_FUEL}
    return {
        "format": FORMAT,
        "title": study.title,
        "version": importlib.metadata.version("slewcert"),
        "verdict": verdict.value,
        "study": {"file": printable(study.file.name), "sha256": study.sha256},
        "plant": {
            "name": fmu.name,
            "fmu": printable(fmu.archive.path.name),
            "sha256": fmu.archive.sha256,
            "binary_sha256": fmu.archive.binary_sha256(interface(study)),
            "libraries": dict(fmu.archive.digests),
            "fmi_version": fmu.archive.description.fmi_version,
            "tool": fmu.archive.description.tool,
            "input": {"name": study.plant.input, "unit": study.plant.input_unit},
            "output": {"name": study.plant.output, "unit": study.plant.output_unit},
            "parameters": {name: float(value) for name, value in fmu.parameters.items()},
            "poles": [[pole.value.real, pole.value.imag, pole.multiplicity] for pole in design.plant.poles],
            "modes": [{"frequency": pole.natural_frequency, "damping": pole.damping_ratio} for pole in design.plant.flexible],
        },
        "task": {
            "displacement": float(study.maneuver.displacement),
            "input_limits": [float(study.limits.lower), float(study.limits.upper)],
            "robustness": dict(study.command.robustness) if isinstance(study.command.robustness, Mapping) else study.command.robustness,
            "kind": study.command.kind,
            "start": float(study.command.start),
            "initial_state": _initial_state(study),
            "scale": float(study.maneuver.scale),
            "sample_time": None if study.limits.sample_time is None else float(study.limits.sample_time),
            "rest": "output" if study.command.tail else "state",
        },
        "bound": bound,
        "command": None if design.command is None else design.command.to_dict(),
        "shaper": None if design.shaped is None else _shaper(design.shaped),
        **({} if design.weighed is None else {"weighted": _weighted(study, design.weighed)}),
        **({} if design.cancelled is None else {"prefilter": design.cancelled.to_dict()}),
        "simulation": None if not runs else runs[0].simulation,
        "grid": None if design.sampled is None else _grid(design, design.sampled),
        "confinement": _confinement(study),
        "requirements": [_requirement(judgement, _si_scale(study, judgement.requirement)) for judgement in judgements],
        "runs": tally(runs),
        "run_table": [_run(result) for result in runs],
        "uncertainty": [
            {
                "parameter": axis.parameter,
                "unit": axis.unit,
                "values": [float(axis.lower), float(axis.upper)],
                "samples": axis.samples,
            }
            for axis in study.uncertainties
        ],
        "units": [{"path": c.path, "written": c.written, "value": float(c.value), "unit": c.unit} for c in study.conversions],
        "unproven": [*([BRACKETED.format(reason=design.bound.reason)] if design.bound.reason else []), *UNPROVEN],
        "trust_base": _trust_base(),
        "notes": [
            *study.notes,
            *_needed(study, design),
            *design.notes,
            *design.plant.notes,
            *([] if study.requirements else [NO_REQUIREMENT]),
        ],
        "environment": environment(),
    }


def _needed(study: Study, design: Design) -> Iterator[str]:
    """The fuel that every command needs, where the study has less."""
    if design.least is not None:
        yield f"limits.fuel is too little: {least_fuel_words(design.least, study.plant.input_unit)}."


def _weighted(study: Study, found: Weighted) -> dict[str, Any]:
    """The least cost, with the file that proves it."""
    return weighing.record(found, float(study.plant.initial_input), None if found.certificate is None else COST)


def _shaper(made: Shaped) -> dict[str, Any]:
    """The shaper of the command with what is proven of it, and what it shapes."""
    return {**made.shaping.to_dict(), "reference": {"kind": made.reference, "maneuver_time": made.reference_time}, "follows": made.follows}


def _grid(design: Design, sampled: Bound) -> dict[str, Any]:
    """What commands on the FMU's own grid can do."""
    times = {"lower": sampled.lower, "upper": sampled.upper}
    certificate = None if sampled.certificate is None else ON_GRID
    return {"step": design.step, "samples": design.samples, "maneuver_time": times, "certificate": certificate}


def _initial_state(study: Study) -> dict[str, float] | list[float] | None:
    """The deviation from rest that the plant begins with."""
    given = study.maneuver.initial_state
    if given is None:
        return None
    return {name: float(x) for name, x in given.items()} if isinstance(given, Mapping) else [float(x) for x in given]


def _confinement(study: Study) -> dict[str, Any]:
    """The limits of the FMU's processes."""
    limits = in_force(study.simulation.confinement)
    return {
        "timeout": study.simulation.timeout,
        "step_timeout": limits.step,
        "memory": limits.memory,
        "file_size": limits.file_size,
        "sandbox": limits.sandbox,
    }


def _trust_base() -> list[str]:
    flint, python = importlib.metadata.version("python-flint"), platform.python_version()
    return [line.format(flint=flint, python=python, lines=trusted()) for line in TRUST_BASE]


def environment() -> dict[str, str]:
    """Versions of what the numbers rest on."""
    versions = {name: importlib.metadata.version(name) for name in SOLVERS}
    return {"python": platform.python_version(), "platform": platform.machine(), **versions}


def tally(runs: Sequence[RunResult]) -> dict[str, int]:
    """Runs in all, and by verdict; an undecided run counts as none of these."""
    verdicts = [result.verdict.value for result in runs]
    return {"total": len(runs), "passed": verdicts.count("pass"), "failed": verdicts.count("fail"), "errors": verdicts.count("error")}


def _si_scale(study: Study, requirement: Requirement) -> Scale | None:
    """The unit of a requirement's quantity if it is the FMU's and no SI unit; None if there is nothing to add in SI."""
    fmu, kind = study.plant.fmu, requirement.quantity.unit_kind
    if fmu is None or kind in (UnitKind.NONE, UnitKind.SECOND):
        return None
    own = requirement.unit if kind is UnitKind.VARIABLE else study.plant.input_unit
    declared = next((as_declared(unit) for unit in fmu.archive.description.units if unit.name == own), None)
    if declared is None or declared.coherent:
        return None
    power = {UnitKind.INPUT_SECOND: 1, UnitKind.INPUT_PER_SECOND: -1}.get(kind)
    return declared if power is None else declared.times(power, requirement.unit)


def _requirement(judgement: Judgement, scale: Scale | None) -> dict[str, Any]:
    asked, measured = judgement.requirement, judgement.measured
    difference = asked.quantity.name not in ("final", "peak_input")

    def si(value: float | None) -> float | None:
        return None if value is None or scale is None else number(scale.si(value, difference))

    value = number(measured.value) if measured else None
    return {
        "id": asked.id,
        "text": asked.text,
        "quantity": str(asked.quantity),
        "scope": asked.scope,
        "min": asked.minimum,
        "max": asked.maximum,
        "unit": asked.unit,
        "value": value,
        "si": scale and {"value": si(value), "min": si(asked.minimum), "max": si(asked.maximum), "unit": scale.si_name},
        "error": number(measured.error) if measured else None,
        "limit": limit(asked, measured.value) if measured else (asked.maximum if asked.maximum is not None else asked.minimum),
        "margin": number(judgement.margin),
        "verdict": judgement.verdict.value,
        "worst_run": judgement.worst_run,
        "reason": judgement.reason,
    }


def _run(result: RunResult) -> dict[str, Any]:
    return {
        "run": result.name,
        "parameters": {name: float(value) for name, value in result.parameters.items()},
        "nominal": result.nominal,
        "status": result.status.name.lower(),
        "detail": result.detail,
        "verdict": result.verdict.value,
        "quantities": {name: {"value": number(m.value), "error": number(m.error)} for name, m in result.measured.items()},
        "log": result.log,
        "sha256": result.sha256,
    }


def write(folder: Path, results: Mapping[str, Any], study: Study, design: Design, runs: Sequence[RunResult]) -> Path:
    """Write everything but the logs (which are there) and close the folder with its manifest; returns the report's path."""
    fmu = study.plant.fmu
    assert fmu is not None
    files.write_atomically(folder / "study.toml", study.source)
    files.write_atomically(folder / "plant" / "modelDescription.xml", fmu.archive.description_xml)
    if fmu.archive.twin is not None:
        files.write_atomically(folder / "plant" / "twin.toml", fmu.archive.twin.encode())
    hashes = {key: results["plant"][key] for key in ("fmu", "sha256", "binary_sha256", "libraries")}
    files.write_atomically(folder / "plant" / "hashes.json", files.json_bytes(hashes))
    if design.bound.certificate is not None:
        files.write_atomically(folder / CERTIFICATE, design.bound.certificate)
    if design.weighed is not None and design.weighed.certificate is not None:
        files.write_atomically(folder / COST, design.weighed.certificate)
    if design.short is not None:
        files.write_atomically(folder / LEAST_FUEL, design.short.certificate)
    if design.sampled is not None and design.sampled.certificate is not None:
        files.write_atomically(folder / ON_GRID, design.sampled.certificate)
    files.write_atomically(folder / RESULTS, files.json_bytes(results))
    files.write_atomically(folder / JUNIT, junit.junit_bytes(results))
    kept = {result.name: folder / result.log for result in runs if result.log is not None}
    drawings = draw(results, design, study.requirements, kept) | bundles.drawings({study.file.stem: (results, folder)})
    files.write_atomically(folder / REPORT, pages.render(results, drawings).encode())
    if kept:
        layout = layouts.layout_bytes(logs.read_log(next(iter(kept.values()))).signals)
        files.write_atomically(folder / "runs" / LAYOUT, layout)
    manifest.write_manifest(folder, settings(results, study.simulation.seed))
    return folder / REPORT


def settings(results: Mapping[str, Any], seed: int) -> dict[str, object]:
    """What the manifest tells beside the files: versions, seed, hash of the FMU."""
    return {"slewcert": results["version"], "seed": seed, "environment": results["environment"], "fmu_sha256": results["plant"]["sha256"]}


def draw(results: Mapping[str, Any], design: Design, requirements: Sequence[Requirement], kept: Mapping[str, Path]) -> dict[str, str]:
    """The page's charts (SVG by title): the worst and the nominal run, the sweep of each requirement, the sensitivity of the command.

    `kept` holds the logs' paths by the runs' names.
    """
    drawings: dict[str, str] = {}
    chosen = dict.fromkeys([*(r["run"] for r in results["run_table"] if r["nominal"]), *(r["worst_run"] for r in results["requirements"])])
    for name in [name for name in chosen if name in kept][:4]:
        log = logs.read_log(kept[name])
        if all(signal.topic != INPUT for signal in log.signals):  # the run failed before its first point
            continue
        parameters = next(r["parameters"] for r in results["run_table"] if r["run"] == name)
        title = f"Run {name}" + "".join(f", {key} = {value:.6g}" for key, value in parameters.items())
        drawings[title] = _response_chart(title, results, observe(log), requirements)
    for axis in results["uncertainty"]:
        others = [other["parameter"] for other in results["uncertainty"] if other is not axis]
        for requirement in requirements:
            if requirement.scope == "box":
                drawings |= _sweep_chart(results, axis, others, requirement)
    if design.shaped is not None:
        drawings[f"Shaper {design.shaped.shaping.kind}"] = chart(design.shaped.shaping)
    rested = results["task"]["initial_state"] is None  # else the plant's own motion counts as much as the command
    rested = rested and design.problem.transition is None
    if rested and design.plant.flexible and design.command is not None and not any(segment.slope for segment in design.command.segments):
        drawings["Sensitivity of the command"] = _sensitivity_chart(design, results)
    return drawings


def _response_chart(title: str, results: Mapping[str, Any], run: Observation, requirements: Sequence[Requirement]) -> str:
    bounds = [r.maximum for r in requirements if r.quantity.name == "residual_vibration" and r.maximum is not None]
    entry, output = results["plant"]["input"], results["plant"]["output"]
    return charts.command_and_response(
        title,
        run.times,
        run.input,
        run.output,
        start=run.command.start,
        end=run.command.end,
        target=run.target,
        displacement=run.scale,
        command_label=f"{entry['name']} [{entry['unit']}]",
        output_label=f"{output['name']} [{output['unit']}]",
        input_limits=tuple(results["task"]["input_limits"]),
        linear=run.linear,
        tolerance=min(bounds, default=None),
    )


def _sweep_chart(results: Mapping[str, Any], axis: Mapping[str, Any], others: Sequence[str], requirement: Requirement) -> dict[str, str]:
    nominal = next((run for run in results["run_table"] if run["nominal"]), None)
    if nominal is None:  # nothing was run
        return {}
    quantity = str(requirement.quantity)
    line = [
        run
        for run in results["run_table"]
        if all(run["parameters"][other] == nominal["parameters"][other] for other in others)
        and run["quantities"].get(quantity, {}).get("value") is not None
    ]
    if not line:
        return {}
    line.sort(key=lambda run: run["parameters"][axis["parameter"]])
    scale, unit = (100.0, "% of move") if quantity in ("residual_vibration", "final_error", "overshoot") else (1.0, requirement.unit)
    bounds = [(which, value) for which, value in (("least", requirement.minimum), ("most", requirement.maximum)) if value is not None]
    title = f"{requirement.id}: {quantity} over {axis['parameter']}"
    return {
        title: charts.sweep(
            title,
            [run["parameters"][axis["parameter"]] for run in line],
            [scale * run["quantities"][quantity]["value"] for run in line],
            parameter_label=f"{axis['parameter']} [{axis['unit']}]",
            quantity_label=f"{quantity} [{unit}]" if unit else quantity,
            verdicts=[_mark(requirement, run["quantities"][quantity]) for run in line],
            errors=[scale * (run["quantities"][quantity]["error"] or 0.0) for run in line],
            limits=[charts.Limit(scale * value, f"{which} allowed") for which, value in bounds],
            nominal=nominal["parameters"][axis["parameter"]],
        )
    }


def _mark(requirement: Requirement, entry: Mapping[str, Any]) -> str:
    return judge_run(requirement, Measured(entry["value"], entry["error"] or 0.0)).value


def _sensitivity_chart(design: Design, results: Mapping[str, Any]) -> str:
    """The peak residual of each mode against its relative frequency: impulses through the mode's share of the output."""
    command = design.command
    assert command is not None
    table = jumps(command, design.problem.rest)
    factors = np.linspace(0.5, 1.5, 401)
    curves = {}
    partial = design.plant.partial()
    for pole, residues in zip(design.plant.poles, partial.residues, strict=True):
        if not pole.is_flexible:
            continue
        # Scaling a mode keeps its static gain, so the amplitude after a unit jump stays 2|r/p|.
        amplitude = 2 * abs(residues[0] / pole.value) / abs(results["task"]["displacement"])
        curve = residual(table[:, 0], table[:, 1], factors * pole.natural_frequency, pole.damping_ratio)
        curves[f"mode {len(curves) + 1}: {pole.natural_frequency:.4g} rad/s"] = 100.0 * amplitude * curve
    return charts.sensitivity("Sensitivity of the command", factors, curves)
