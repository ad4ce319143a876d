"""What `slewcert fmus inspect` tells, as plain data (docs/schemas.md) and as the rows of its tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from fmus.archives import Fmu
from fmus.inspection import Inspection
from fmus.terminals import Terminal
from fmus.variables import Unit, Variable

ORDER = ("input", "output", "structuralParameter", "parameter", "calculatedParameter", "local", "independent", "constant")


def inspection_record(found: Inspection) -> dict[str, Any]:
    """The object of `fmus inspect --json`."""
    fmu, has = found.fmu, found.fmu.description
    return {
        "file": str(fmu.path),
        "sha256": fmu.sha256,
        "binary_sha256": next((digest for _, _, digest in _loaded(fmu)), None),
        "libraries": {name: {"member": member, "sha256": digest} for name, member, digest in _loaded(fmu)},
        "fmi_version": has.fmi_version,
        "model": has.model_name,
        "tool": has.tool,
        "interfaces": {name: dict(attributes) for name, attributes in has.interfaces},
        "host": found.host,
        "binaries": {folder: list(files) for folder, files in found.binaries},
        "sources": list(found.sources),
        "twin": fmu.twin is not None,
        "default_step": has.default_step,
        "default_tolerance": has.default_tolerance,
        "states": list(has.state_names),
        "variables": [_variable(v) for v in has.variables],
        "units": [_unit(unit) for unit in has.units],
        "terminals": [_terminal(terminal) for terminal in found.terminals],
        "prevents": list(found.obstacles),
        "notes": list(found.notes),
    }


def _loaded(fmu: Fmu) -> Iterator[tuple[str, str, str]]:
    """What a run here loads for each interface, the usual one first: the interface's name in FMI, the member, its SHA-256."""
    for name, interface in (("CoSimulation", "co_simulation"), ("ModelExchange", "model_exchange")):
        if (found := fmu.binary(interface)) is not None:
            yield name, *found


def _variable(v: Variable) -> dict[str, Any]:
    start = list(v.starts) if v.dimensions else v.start
    return {
        "name": v.name,
        "causality": v.causality,
        "variability": v.variability,
        "type": v.type,
        "unit": v.unit,
        "display_unit": v.display_unit,
        "start": start if not isinstance(start, float) or math.isfinite(start) else None,
        "dimensions": list(v.dimensions),
        "shape": list(v.shape),
        "min": v.minimum,
        "max": v.maximum,
        "nominal": v.nominal,
        "items": dict(v.items),
        "derivative_of": v.derivative_of,
        "description": v.description,
    }


def _unit(unit: Unit) -> dict[str, Any]:
    return {
        "name": unit.name,
        "base": dict(unit.exponents) if unit.defined else None,
        "factor": unit.factor,
        "offset": unit.offset,
        "display": [{"name": d.name, "factor": d.factor, "offset": d.offset} for d in unit.display],
    }


def _terminal(terminal: Terminal) -> dict[str, Any]:
    return {
        "name": terminal.name,
        "matching": terminal.matching,
        "kind": terminal.kind,
        "description": terminal.description,
        "members": [{"variable": m.variable, "name": m.name, "kind": m.kind} for m in terminal.members],
        "terminals": [_terminal(inner) for inner in terminal.terminals],
    }


def summary(found: Inspection) -> Iterator[tuple[str, str]]:
    """Name and value of everything that is one line."""
    fmu, has = found.fmu, found.fmu.description
    yield "model", has.model_name + (f", made by {has.tool}" if has.tool else "")
    yield "FMI", has.fmi_version
    yield "SHA-256", fmu.sha256
    for interface, member, digest in _loaded(fmu):
        yield "its binary", f"{digest} ({interface}, {member})"
    for name, attributes in has.interfaces:
        able = [key for key, value in attributes if value in ("true", "1")]
        able += [f"{key} = {value}" for key, value in attributes if value not in ("true", "1", "false", "0") and key != "modelIdentifier"]
        yield name, ", ".join(able) or "no further capability"
    yield "binaries", ", ".join(folder for folder, _ in found.binaries) or "none"
    yield "sources", f"{len(found.sources)} files" if found.sources else "none"
    if has.default_step is not None:
        yield "default step", f"{has.default_step:g} s"
    yield "states", str(len(has.state_names))


def variable_rows(found: Inspection) -> list[tuple[str, str, str, str, str, str]]:
    """Name, causality, variability, type, start value and unit of every variable; inputs, outputs and parameters first."""
    variables = sorted(found.fmu.description.variables, key=lambda v: ORDER.index(v.causality) if v.causality in ORDER else len(ORDER))
    return [(v.name, v.causality, v.variability, v.kind, _start(v), _unit_words(v)) for v in variables]


def _start(v: Variable) -> str:
    if v.dimensions:
        return f"{v.starts[0]:g}, …" if len(set(v.starts)) > 1 else f"{v.starts[0]:g}" if v.starts else ""
    if isinstance(v.start, float) and v.type == "Boolean":
        return "true" if v.start else "false"
    if isinstance(v.start, float):
        name = next((name for name, number in v.items if number == v.start), "")
        return f"{v.start:g}" + (f" ({name})" if name else "")
    return "" if v.start is None else f'"{v.start}"'


def _unit_words(v: Variable) -> str:
    return v.unit + (f" (shown in {v.display_unit})" if v.display_unit and v.display_unit != v.unit else "")


def terminal_lines(terminals: tuple[Terminal, ...], indent: str = "") -> Iterator[str]:
    """One line a terminal: its name, how it is matched, its members."""
    for terminal in terminals:
        members = ", ".join(m.variable if m.name in ("", m.variable) else f"{m.name} = {m.variable}" for m in terminal.members)
        kind = ", ".join(filter(None, (terminal.kind, terminal.matching)))
        yield f"{indent}{terminal.name} ({kind}): {members or 'no variables'}" + (
            f"; {terminal.description}" if terminal.description else ""
        )
        yield from terminal_lines(terminal.terminals, indent + "  ")
