"""What is set on an FMU before a run, in the order in which FMI allows it: structural parameters, start values, inputs.

FMI sets arrays as a whole. Of one that is only given in parts, the other elements keep the start values of modelDescription.xml.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmus.descriptions import Description
from fmus.errors import DescriptionError
from fmus.variables import Value, Variable


def assignments(
    description: Description, parameters: Mapping[str, Value], state: Mapping[str, float], input: str, at_rest: float
) -> dict[str, Any]:
    """The members `structure`, `start`, `inputs`, `input`, `neighbours` and `initial_input` of a request to the child process.

    `description` has the sizes that the structural parameters among `parameters` ask for (`Description.resized`). `parameters` may name
    inputs too, other than the one that the command drives. Raises `DescriptionError`: no such variable, or a value that it cannot have.
    """
    driven = description.drivable_input(input)
    found = [(description.settable_parameter(name), value) for name, value in parameters.items()]
    if any(variable.name == driven.name for variable, _ in found):
        raise DescriptionError(f"{input!r} is driven by the command; its value at rest is the initial input")
    states = [(description.settable_state(name), value) for name, value in state.items()]
    inputs = [pair for pair in found if pair[0].causality == "input"]
    whole = driven.element and description.find(driven.element.array)
    mates = [pair for pair in inputs if whole and pair[0].element and pair[0].element.array == whole.name]
    neighbours: list[float] = []
    if whole:
        neighbours = _composed(description, [*mates, (driven, at_rest)], whole)
    structure = [(v, x) for v, x in found if v.causality == "structuralParameter"]
    start = [(v, x) for v, x in found if v.causality == "parameter"] + states
    return {
        "structure": _settings(description, structure),
        "start": _settings(description, start),
        "inputs": _settings(description, [pair for pair in inputs if pair not in mates]),
        "input": typed(driven),
        "neighbours": neighbours,
        "initial_input": float(driven.number(at_rest)),
    }


def typed(variable: Variable) -> list[str | int]:
    """How the child process addresses a variable: type and value reference, of an array's element also the array's size and the place."""
    place = [variable.element.size, variable.element.place] if variable.element else []
    return [variable.type, variable.value_reference, *place]


def _settings(description: Description, pairs: list[tuple[Variable, Value]]) -> list[list[Any]]:
    """Type, value reference and value of each variable; the elements of an array together."""
    settings: list[list[Any]] = []
    arrays: dict[str, list[tuple[Variable, Value]]] = {}
    for variable, value in pairs:
        if variable.element is None:
            settings.append([variable.type, variable.value_reference, float(variable.number(value))])
        else:
            arrays.setdefault(variable.element.array, []).append((variable, value))
    for name, parts in arrays.items():
        whole = description.find(name)
        settings.append([whole.type, whole.value_reference, _composed(description, parts, whole)])
    return settings


def _composed(description: Description, parts: list[tuple[Variable, Value]], whole: Variable) -> list[float]:
    """All values of an array: its start values, with those of `parts` in their places."""
    given = {v.element.place: float(v.number(x)) for v, x in parts if v.element}
    missing = [name for place, name in enumerate(whole.elements) if place not in given]
    if missing and not whole.starts:
        raise DescriptionError(
            f"{description.model_name} gives no start values for the {whole.size} elements of {whole.name!r}; "
            f"set {', '.join(missing[:8])}{', …' if len(missing) > 8 else ''} too: an array is set as a whole"
        )
    return [given.get(place, whole.starts[place] if whole.starts else 0.0) for place in range(whole.size)]
