"""plant.toml: the variables of a plant, from which its model descriptions and its C header are generated."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fmus.errors import BuildError

Kind = Literal["time", "parameter", "input", "state", "derivative", "output"]

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
RESERVED = re.compile(
    "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|inline|int|long|register|restrict|return|"
    "short|signed|sizeof|static|struct|switch|typedef|union|unsigned|void|volatile|while|time|value|der_.*"
)
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
TOP = {"name", "title", "description", "domain", "version", "tangent", "step_hook", "variable_step", "experiment", "units", "size"}
TABLES: Mapping[str, frozenset[str]] = {
    "parameters": frozenset({"start", "unit", "description", "positive"}),
    "inputs": frozenset({"start", "unit", "description"}),
    "states": frozenset({"start", "unit", "description", "nominal", "output", "depends", "derivative_unit", "each"}),
    "outputs": frozenset({"unit", "description", "depends", "each"}),
}


@dataclass(frozen=True, slots=True)
class PlantVariable:
    """One variable. `reference` is its value reference, the same in FMI 2.0, FMI 3.0 and the C struct.

    `state` is, for a derivative, the reference of its state; `depends` are the references of the states and inputs that
    a derivative or output depends on, None when that is all of them. `array` is the name of the C array that it is an element of.
    """

    reference: int
    name: str
    kind: Kind
    unit: str
    description: str
    start: float | None = None
    nominal: float | None = None
    positive: bool = False
    boolean: bool = False
    is_output: bool = False
    state: int | None = None
    depends: tuple[int, ...] | None = None
    array: str = ""

    @property
    def field(self) -> str:
        """Its name in C, that of its array if it is in one: `der_x` for `der(x)`."""
        return (self.array or self.name).replace("(", "_").replace(")", "")


@dataclass(frozen=True, slots=True)
class Size:
    """The length of a plant's arrays, chosen when it is built: `name` is its macro in C (in capitals), `least` ≤ `value` ≤ `most`."""

    name: str
    value: int
    least: int
    most: int


@dataclass(frozen=True, slots=True)
class PlantFile:
    """A plant's description. `variables` stand in the order of their value references.

    `units` have exponents of the SI base units, or None where these are not known. `events`, `outputs_before` and `memory` (a header that
    declares the type `Memory`) are for what jumps by itself and remembers more than its states: see `fmus.blocks`.
    `source` is the C file of the equations, named after the plant without its size; `size` is None for a plant without arrays.
    """

    name: str
    title: str
    description: str
    version: str
    tangent: bool
    step_hook: bool
    variable_step: bool
    stop: float
    step: float
    units: Mapping[str, Mapping[str, float] | None]
    variables: tuple[PlantVariable, ...]
    interfaces: tuple[str, ...] = ("ModelExchange", "CoSimulation")
    events: bool = False
    outputs_before: bool = False
    input_derivatives: int = 5
    memory: str = ""
    domain: str = ""
    source: str = ""
    size: Size | None = None

    @property
    def asks(self) -> bool:
        """Whether its inputs can be set within a step (FMI 3.0): what remembers its inputs takes them at communication points."""
        return bool(self.of_kind("input")) and not self.memory

    def of_kind(self, kind: Kind) -> tuple[PlantVariable, ...]:
        """The variables of one kind, in order."""
        return tuple(v for v in self.variables if v.kind == kind)


def read_plant_file(path: Path, size: int | None = None) -> PlantFile:
    """Read and check a plant.toml, of a plant with arrays that of `size` (its own start value if None).

    Raises `BuildError` naming the key, its value and what would be valid.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BuildError(f"{path.parent} is no plant folder: it has no plant.toml") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise BuildError(f"{path}: {problem}") from None
    try:
        return _plant_file(data, size)
    except BuildError as problem:
        raise BuildError(f"{path}: {problem}") from None


def _plant_file(data: Mapping[str, Any], chosen: int | None) -> PlantFile:
    _check_keys("", data, TOP | TABLES.keys())
    for table, keys in TABLES.items():
        for name, entry in _table(data, table).items():
            _check_keys(f"{table}.{name}", _table(data[table], name), keys)
            if not IDENTIFIER.fullmatch(name) or RESERVED.fullmatch(name):
                raise BuildError(f"{table}.{name}: a variable's name is a C identifier, but no word of C, 'time', 'value' or 'der_…'")
            if entry.get("unit") not in data.get("units", {}):
                raise BuildError(f"{table}.{name}.unit = {entry.get('unit')!r} is not among [units]: {', '.join(data.get('units', {}))}")
    name = _text(data, "name")
    if not IDENTIFIER.fullmatch(name):
        raise BuildError(f"name = {name!r} is no model identifier (a letter, then letters, digits and underscores)")
    experiment = _table(data, "experiment")
    _check_keys("experiment", experiment, {"stop", "step"})
    stop, step = _number(experiment, "experiment.stop", 10.0), _number(experiment, "experiment.step", 0.01)
    if not 0.0 < step <= stop:
        raise BuildError(f"experiment: 0 < step <= stop is needed, but step = {step!r} s and stop = {stop!r} s")
    size = _size(data, chosen)
    return PlantFile(
        name=name if chosen is None else f"{name}_{chosen}",
        title=_text(data, "title", name),
        description=_text(data, "description", ""),
        version=_text(data, "version", "1.0.0"),
        tangent=_flag(data, "tangent", False),
        step_hook=_flag(data, "step_hook", False),
        variable_step=_flag(data, "variable_step", True),
        stop=stop,
        step=step,
        units={"s": {"s": 1}} | {unit: _base_units(unit, _table(data["units"], unit)) for unit in _table(data, "units")},
        variables=_variables({**data, **{table: _elements(_table(data, table), size) for table in ("states", "outputs")}}),
        domain=_text(data, "domain", ""),
        source=f"{name}.c",
        size=size,
    )


def _size(data: Mapping[str, Any], chosen: int | None) -> Size | None:
    table = _table(data, "size")
    if not table:
        if chosen is not None:
            raise BuildError(f"the plant has no [size], so it cannot be built with {chosen}")
        return None
    _check_keys("size", table, {"name", "start", "range"})
    name, bounds = _text(table, "name"), table.get("range")
    if not IDENTIFIER.fullmatch(name):
        raise BuildError(f"size.name = {name!r} is no name of a macro (a letter, then letters, digits and underscores)")
    if not (isinstance(bounds, list) and len(bounds) == 2 and all(type(n) is int for n in bounds) and 1 <= bounds[0] <= bounds[1]):
        raise BuildError(f"size.range = {bounds!r} must be two whole numbers, the least and the most")
    value = table.get("start") if chosen is None else chosen
    if type(value) is not int or not bounds[0] <= value <= bounds[1]:
        raise BuildError(f"{name} = {value!r}: from {bounds[0]} to {bounds[1]} are possible")
    return Size(name, value, *bounds)


def _elements(table: Mapping[str, Any], size: Size | None) -> dict[str, Any]:
    """The variables with their arrays taken apart: `x` with `each = true` is x_1, x_2 … x_size."""
    found: dict[str, Any] = {}
    for name, entry in table.items():
        if not _flag(entry, "each", False):
            found[name] = {**entry, "array": ""}
            continue
        if size is None:
            raise BuildError(f"{name}.each = true needs a table [size]: how many there are")
        for i in range(1, size.value + 1):
            found[f"{name}_{i}"] = {**entry, "array": name, "description": f"{_text(entry, 'description', '')} {i}".strip()}
    return found


def _variables(data: Mapping[str, Any]) -> tuple[PlantVariable, ...]:
    parameters, inputs, states, outputs = (_table(data, table) for table in TABLES)
    if not inputs or not states:
        raise BuildError("a plant has at least one input and one state")
    order = ["time", *parameters, *inputs, *states, *(f"der({x})" for x in states), *outputs]
    if len(set(order)) != len(order):
        raise BuildError(f"two variables are called {next(n for n in order if order.count(n) > 1)!r}")
    reference = {name: r for r, name in enumerate(order)}

    def depends(path: str, entry: Mapping[str, Any]) -> tuple[int, ...] | None:
        if "depends" not in entry:
            return None
        wrong = [name for name in entry["depends"] if name not in inputs and name not in states]
        if wrong:
            raise BuildError(f"{path}.depends: {wrong[0]!r} is no input or state: {', '.join([*inputs, *states])}")
        return tuple(sorted(reference[name] for name in entry["depends"]))

    def common(path: str, entry: Mapping[str, Any]) -> dict[str, Any]:
        return {"unit": entry["unit"], "description": _text(entry, "description", ""), "start": _number(entry, f"{path}.start", 0.0)}

    found = [PlantVariable(0, "time", "time", "s", "Simulated time")]
    for name, entry in parameters.items():
        start = common(f"parameters.{name}", entry)
        positive = _flag(entry, "positive", False)
        if positive and not start["start"] > 0.0:
            raise BuildError(f"parameters.{name}.start = {start['start']!r} must be positive")
        found.append(PlantVariable(reference[name], name, "parameter", positive=positive, **start))
    for name, entry in inputs.items():
        found.append(PlantVariable(reference[name], name, "input", **common(f"inputs.{name}", entry)))
    for name, entry in states.items():
        nominal = _number(entry, f"states.{name}.nominal", 1.0)
        if not nominal > 0.0:
            raise BuildError(f"states.{name}.nominal = {nominal!r} must be positive: it scales the integrator's tolerance")
        is_output = _flag(entry, "output", False)
        found.append(PlantVariable(reference[name], name, "state", nominal=nominal, is_output=is_output, array=entry["array"],
                                   depends=(reference[name],) if is_output else None, **common(f"states.{name}", entry)))  # fmt: skip
    for name, entry in states.items():
        unit = entry.get("derivative_unit")
        if unit not in data["units"]:
            raise BuildError(f"states.{name}.derivative_unit = {unit!r} is not among [units]: {', '.join(data['units'])}")
        array = entry["array"] and f"der({entry['array']})"
        found.append(PlantVariable(reference[f"der({name})"], f"der({name})", "derivative", unit, f"Derivative of {name}",
                                   state=reference[name], depends=depends(f"states.{name}", entry), array=array))  # fmt: skip
    for name, entry in outputs.items():
        found.append(PlantVariable(reference[name], name, "output", entry["unit"], _text(entry, "description", ""),
                                   is_output=True, depends=depends(f"outputs.{name}", entry), array=entry["array"]))  # fmt: skip
    return tuple(found)


def _check_keys(path: str, data: Mapping[str, Any], allowed: frozenset[str] | set[str]) -> None:
    for key in data:
        if key not in allowed:
            raise BuildError(f"unknown key {path + '.' if path else ''}{key}; known are {', '.join(sorted(allowed))}")


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise BuildError(f"{key} = {value!r} must be a table")
    return value


def _text(data: Mapping[str, Any], key: str, default: str | None = None) -> str:
    value = data.get(key, default)
    if not isinstance(value, str):
        raise BuildError(f"{key} = {value!r} must be a string")
    return value


def _flag(data: Mapping[str, Any], key: str, default: bool) -> bool:
    value = data.get(key, default)
    if not isinstance(value, bool):
        raise BuildError(f"{key} = {value!r} must be true or false")
    return value


def _number(data: Mapping[str, Any], path: str, default: float) -> float:
    value = data.get(path.rpartition(".")[2], default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise BuildError(f"{path} = {value!r} must be a finite number")
    return float(value)


def _base_units(unit: str, exponents: Mapping[str, Any]) -> Mapping[str, float]:
    _check_keys(f'units."{unit}"', exponents, {*BASE_UNITS, "factor", "offset"})
    return dict(exponents)
