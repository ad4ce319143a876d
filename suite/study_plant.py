"""The `[plant]` section as meant: which of its forms is used, whether it is complete, and what an FMU has to say about the names in it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from fmus.archives import Fmu, open_archive
from fmus.descriptions import Description, Variable
from fmus.errors import FmuError
from fmus.stepping import Probe
from suite import schema
from suite.errors import ABSENT, Mistake
from suite.plant_settings import plant_settings
from suite.study import FmuPlant, ModalPlant, Plant, RootsPlant, Schedule, Source, StateSpacePlant, TransferPlant
from suite.suggestions import did_you_mean

FORMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "fmu": (("fmu",), ()),
    "numerator, denominator": (("numerator", "denominator"), ()),
    "zeros, poles, gain": (("poles", "gain"), ("zeros",)),
    "A, B, C, D": (("A", "B", "C"), ("D",)),
    "modes, rigid": ((), ("modes", "rigid")),
}
"""Every form's necessary and optional keys."""


@dataclass(frozen=True, slots=True)
class PlantNames:
    """What requirements and uncertainties may name: an FMU's variables, or the outputs of a plant given as numbers."""

    description: Description | None
    outputs: tuple[str, ...]
    controlled: str
    driven: str = ""

    def logged(self, name: str) -> tuple[str, str]:
        """Name and unit of a variable that can be logged (`output` is the controlled one); raises `ValueError` with a sentence."""
        if self.description is None:
            if name not in self.outputs:
                raise ValueError(f'the plant has no output "{name}"{did_you_mean(name, self.outputs)}; it has {", ".join(self.outputs)}')
            return name, ""
        if name == "output" and "output" not in self.description.names():
            name = self.controlled
        try:
            return name, self.description.readable(name).unit
        except FmuError as problem:
            raise ValueError(str(problem)) from None

    def parameter(self, name: str) -> Variable:
        """The FMU's parameter, or constant input, that an uncertainty may speak of; raises `ValueError` with a sentence."""
        if self.description is None:
            raise ValueError(
                "names an FMU's parameter, but the plant is given as numbers; valid are mode[i].frequency, mode[i].damping, zero[i]"
            )
        try:
            variable = self.description.settable_parameter(name, self.driven)
        except FmuError as problem:
            raise ValueError(str(problem)) from None
        if variable.causality == "structuralParameter":
            raise ValueError("is a structural parameter: the plants of a range would differ in their variables; set it in plant.parameters")
        return variable


def understand_plant(written: schema.Plant, folder: Path) -> tuple[Plant | None, PlantNames | None, list[Mistake]]:
    """The plant, its names, and the mistakes in its section; paths of FMUs start from `folder`."""
    mistakes: list[Mistake] = []
    form = _form(written, mistakes)
    if form is None:
        return None, None, mistakes
    schedule = _schedule(written, form, mistakes)
    if form == "fmu":
        plant, names, mistakes = _fmu_plant(written, folder, mistakes)
        return plant and replace(plant, schedule=schedule), names, mistakes
    _refuse(
        written, ("parameters", "linearization", "identification"), "belongs to an FMU; here the numbers themselves are the plant", mistakes
    )
    for key in ("state", "settle"):
        value = getattr(written.initial, key, None)
        if value is not None:
            mistakes.append(Mistake(f"plant.initial.{key}", value, "belongs to an FMU; numbers are deviations from the operating point"))
    if form != "A, B, C, D":
        _refuse(written, ("outputs",), "holds rows of C, so it belongs to the form A, B, C, D", mistakes)
    source = _numbers(written, form, mistakes)
    output = written.output or "output"
    names = PlantNames(None, tuple(dict.fromkeys(("output", "output_rate", output, *(written.outputs or {})))), output)
    if mistakes or source is None:
        return None, names, mistakes
    initial_input = _initial_input(written, Decimal(0))
    return Plant(source, written.input or "input", output, initial_input=initial_input, schedule=schedule), names, mistakes


def _schedule(written: schema.Plant, form: str, mistakes: list[Mistake]) -> Schedule | None:
    """The schedule, and what is wrong with it: instants, who may have one, and the sizes of its matrices."""
    asked, place = written.schedule, "plant.schedule"
    if asked is None:
        return None
    if form not in ("fmu", "A, B, C, D"):
        mistakes.append(Mistake(place, ABSENT, "belongs to an FMU, or to the form A, B, C, D, whose matrices may vary"))
        return None
    if not asked.times or asked.times[0] <= 0 or any(b <= a for a, b in itertools.pairwise(asked.times)):
        mistakes.append(Mistake(f"{place}.times", list(asked.times), "must ascend from more than 0; at 0 the plant is as written"))
    tables: dict[str, tuple[Any, ...] | None] = {"A": asked.A, "B": asked.B, "C": asked.C}
    given = {name: table for name, table in tables.items() if table is not None}
    if form == "fmu":
        why = "belongs to a plant given as numbers; an FMU is linearised along its own motion"
        mistakes += [Mistake(f"{place}.{name}", ABSENT, why) for name in given]
        if written.initial is not None and written.initial.settle is True:
            why = "contradicts plant.schedule: where the FMU rests nothing varies any more; give the time to settle in seconds, if any"
            mistakes.append(Mistake("plant.initial.settle", True, why))
        if written.linearization in ("twin", "identified"):
            why = "contradicts plant.schedule: the FMU is linearised along its motion; valid are auto, derivatives, differences"
            mistakes.append(Mistake("plant.linearization", written.linearization, why))
        return Schedule(asked.times)
    if not given:
        mistakes.append(Mistake(place, ABSENT, "varies nothing: give A, B or C at these times, one matrix or row for each"))
    n = len(written.B or ())
    for name, table in given.items():
        if len(table) != len(asked.times):
            mistakes.append(Mistake(f"{place}.{name}", ABSENT, f"has {len(table)} items, and times has {len(asked.times)}: one for each"))
        rows = [row for matrix in table for row in matrix] if name == "A" else list(table)
        if any(len(row) != n for row in rows) or (name == "A" and any(len(matrix) != n for matrix in table)):
            mistakes.append(Mistake(f"{place}.{name}", ABSENT, f"has other sizes than plant.{name}, which belongs to {n} states"))
    return Schedule(asked.times, asked.A, asked.B, asked.C)


def description(data: Mapping[str, Any], folder: Path) -> Description | None:
    """The description of the FMU that a parsed study names; None if it names none, or one that cannot be used."""
    plant = data.get("plant")
    name = plant.get("fmu") if isinstance(plant, dict) else None
    fmu = open_plant(name, folder, []) if isinstance(name, str) and name else None
    return None if fmu is None else fmu.description


def _form(written: schema.Plant, mistakes: list[Mistake]) -> str | None:
    given = written.model_fields_set
    used = [name for name, (necessary, optional) in FORMS.items() if given & {*necessary, *optional}]
    if not used:
        mistakes.append(Mistake("plant", ABSENT, f"says nothing of the plant; valid is one of these: {' | '.join(FORMS)}"))
        return None
    if len(used) > 1:
        first = [next(key for key in (*FORMS[form][0], *FORMS[form][1]) if key in given) for form in used]
        mistakes.append(
            Mistake("plant", ABSENT, f"{' and '.join(first)} describe the plant in different forms; give one of these: {' | '.join(FORMS)}")
        )
        return None
    (form,) = used
    missing = [key for key in FORMS[form][0] if key not in given]
    mistakes.extend(Mistake(f"plant.{key}", ABSENT, f"is missing; this form of plant needs {', '.join(FORMS[form][0])}") for key in missing)
    return None if missing else form


def _refuse(written: schema.Plant, keys: tuple[str, ...], why: str, mistakes: list[Mistake]) -> None:
    mistakes.extend(Mistake(f"plant.{key}", value, why) for key in keys if (value := getattr(written, key)) is not None)


def _initial_input(written: schema.Plant, otherwise: Decimal) -> Decimal:
    return otherwise if written.initial is None or written.initial.input is None else written.initial.input


def _numbers(written: schema.Plant, form: str, mistakes: list[Mistake]) -> Source | None:
    match form:
        case "numerator, denominator":
            return TransferPlant(written.numerator or (), written.denominator or ())
        case "zeros, poles, gain":
            return RootsPlant(written.zeros or (), written.poles or (), written.gain or Decimal(0))
        case "modes, rigid":
            modes = tuple((mode.frequency, mode.damping, mode.gain) for mode in written.modes or ())
            return ModalPlant(written.rigid or Decimal(0), modes)
    matrix, column, row, outputs = written.A or (), written.B or (), written.C or (), written.outputs or {}
    n = len(matrix)
    lengths = (
        {f"A[{i}]": line for i, line in enumerate(matrix, 1)} | {"B": column, "C": row} | {f"outputs.{k}": v for k, v in outputs.items()}
    )
    for name, numbers in lengths.items():
        if len(numbers) != n:
            mistakes.append(Mistake(f"plant.{name}", numbers, f"has {len(numbers)} numbers; A has {n} rows, so valid are {n}"))
    taken = {"output", "output_rate", written.output}
    mistakes.extend(
        Mistake(f"plant.outputs.{name}", numbers, "is a name that exists already (the controlled output or its rate)")
        for name, numbers in outputs.items()
        if name in taken
    )
    return StateSpacePlant(matrix, column, row, written.D or Decimal(0), dict(outputs))


def _fmu_plant(written: schema.Plant, folder: Path, mistakes: list[Mistake]) -> tuple[Plant | None, PlantNames | None, list[Mistake]]:
    _refuse(written, ("outputs",), "belongs to the form A, B, C, D; an FMU has names of its own for its variables", mistakes)
    fmu = open_plant(written.fmu or "", folder, mistakes)
    if fmu is None:
        mistakes.extend(Mistake(f"plant.{key}", ABSENT, "is missing") for key in ("input", "output") if getattr(written, key) is None)
        return None, None, mistakes
    has, parameters = plant_settings(written.parameters or {}, fmu.description, written.input, mistakes)
    entry = variable("plant.input", written.input, has.drivable_input, has.names("input"), mistakes)
    output = variable("plant.output", written.output, lambda name: _real(has.find(name, "output")), has.names("output"), mistakes)
    states = _initial_state(written.initial, has, mistakes)
    method, identification = written.linearization or "auto", written.identification
    if method == "twin" and fmu.twin is None:
        why = "needs a linear twin in the FMU (resources/twin.toml), which has none; valid are auto, derivatives, differences, identified"
        mistakes.append(Mistake("plant.linearization", method, why))
    if identification is not None and method not in ("auto", "identified"):
        mistakes.append(
            Mistake("plant.identification", ABSENT, f'means nothing for linearization = "{method}"; it belongs to "identified"')
        )
    names = PlantNames(has, has.names("output"), written.output or "", written.input or "")
    if mistakes or entry is None or output is None:
        return None, names, mistakes
    start = Decimal(repr(entry.start)) if isinstance(entry.start, float) else Decimal(0)
    settle = None if written.initial is None else written.initial.settle
    source = FmuPlant(
        written.fmu or "",
        replace(fmu, description=has),
        parameters,
        states,
        math.inf if settle is True else float(settle or 0.0),
        method,
        None if identification is None else _probe(identification),
    )
    return Plant(source, entry.name, output.name, entry.unit, output.unit, _initial_input(written, start)), names, mistakes


def _probe(written: schema.Identification) -> Probe:
    step, amplitude = (None if value is None else float(value) for value in (written.step, written.amplitude))
    return Probe(step, written.samples, amplitude, written.order)


def _initial_state(initial: schema.Initial | None, has: Description, mistakes: list[Mistake]) -> dict[str, Decimal]:
    """Start values of states by their names; a list of them goes by the order of the FMU's states."""
    given = None if initial is None else initial.state
    if given is None:
        return {}
    if not isinstance(given, dict):
        names = [name for name, _ in has.states]
        if len(given) != len(names):
            listed = f": {', '.join(names)}" if names else "; name them in a table"
            mistakes.append(
                Mistake("plant.initial.state", given, f"has {len(given)} numbers, and the FMU shows {len(names)} states{listed}")
            )
            return {}
        given = dict(zip(names, given, strict=True))
    for name, value in given.items():
        variable(f"plant.initial.state.{name}", name, has.settable_state, (), mistakes, value)
    return dict(given)


def _real(variable: Variable) -> Variable:
    if not variable.is_real:
        hint = f"; name one element, such as {variable.elements[0]}" if variable.size and variable.dimensions else ""
        raise FmuError(f'"{variable.name}" is of type {variable.kind}; a controlled output is a single real number{hint}')
    return variable


def variable(
    path: str,
    name: str | None,
    find: Callable[[str], Variable],
    candidates: tuple[str, ...],
    mistakes: list[Mistake],
    value: object = None,
) -> Variable | None:
    """What `find` finds; else None and a mistake at `path` (about `value`, if that is not the name)."""
    if name is None:
        mistakes.append(Mistake(path, ABSENT, f"is missing; the FMU has {', '.join(candidates[:12]) or 'none'}"))
        return None
    try:
        return find(name)
    except FmuError as problem:
        mistakes.append(Mistake(path, name if value is None else value, str(problem)))
        return None


def open_plant(name: str, folder: Path, mistakes: list[Mistake], place: str = "plant.fmu") -> Fmu | None:
    """The FMU of that name: one shipped here, or a file; else None and a mistake at `place`."""
    from fmus import build  # knows the compiler; a plant given as numbers needs none

    shipped = build.shipped()
    choices = {*shipped, *(f"{plant}.fmi{major}" for plant in shipped for major in (2, 3))}
    try:
        if build.is_shipped(name):
            path = build.locate(name)
        else:
            path = (folder / name).expanduser()
            if not path.is_file():
                what = "a folder, not a file" if path.is_dir() else "no such file"
                hint = did_you_mean(name, choices)
                mistakes.append(Mistake(place, name, f"{path} is {what}, and the plants shipped here are {', '.join(shipped)}{hint}"))
                return None
        fmu = open_archive(path)
        fmu.require_platform("co_simulation" if fmu.description.capabilities.co_simulation else "model_exchange")
    except FmuError as problem:
        mistakes.append(Mistake(place, name, str(problem)))
        return None
    return fmu
