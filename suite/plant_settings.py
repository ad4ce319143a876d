"""`plant.parameters` as meant: every value set on the FMU as one exact number, arrays element by element."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal

from fmus.descriptions import Description
from fmus.errors import DescriptionError
from fmus.variables import Value, Variable
from suite.errors import Mistake


def plant_settings(
    written: Mapping[str, object], description: Description, driven: str | None, mistakes: list[Mistake]
) -> tuple[Description, dict[str, Decimal]]:
    """The description with the sizes that structural parameters ask for, and the numbers by the names of single variables or elements.

    Truth values are 0 and 1, items of enumerations their numbers, lists the elements of arrays. What is wrong becomes a mistake.
    """
    path = "plant.parameters"
    structure: dict[str, Value] = {}
    for name, value in written.items():
        try:
            if description.find(name).causality == "structuralParameter":
                structure[name] = description.settable_parameter(name).within(_single(name, value))
        except DescriptionError as problem:
            mistakes.append(Mistake(f"{path}.{name}", value, str(problem)))
    try:
        description = description.resized(structure)
    except DescriptionError as problem:
        mistakes.append(Mistake(path, dict(written), str(problem)))
    found: dict[str, Decimal] = {}
    wrong = {mistake.path for mistake in mistakes}
    for name, value in written.items():
        if f"{path}.{name}" in wrong:
            continue
        try:
            for variable, single in _elements(description, name, value):
                if variable.name in found:
                    raise DescriptionError(f"{variable.name!r} is given twice")
                if variable.name == driven:
                    raise DescriptionError(f"{driven!r} is driven by the command; its value at rest is plant.initial.input")
                number = variable.within(single)
                found[variable.name] = number if isinstance(number, Decimal) else Decimal(number)  # type: ignore[arg-type] - no fraction comes in
        except DescriptionError as problem:
            mistakes.append(Mistake(f"{path}.{name}", value, str(problem)))
    return description, found


def _elements(description: Description, name: str, value: object) -> Iterator[tuple[Variable, Value]]:
    """Each single variable with its value."""
    whole = description.settable(name)
    if not whole.dimensions:
        yield whole, _single(name, value)
        return
    if not isinstance(value, tuple | list):
        first = whole.elements[0] if whole.size else f"{name}[1]"
        raise DescriptionError(f"{name!r} is of type {whole.kind}; give a list of its values, or name one element, such as {first}")
    flat = tuple(_flattened(name, value, whole.shape))
    for element, single in zip(whole.elements, flat, strict=True):
        yield description.find(element), single


def _flattened(name: str, value: object, shape: tuple[int, ...]) -> Iterator[Value]:
    if not shape:
        yield _single(name, value)
        return
    if not isinstance(value, tuple | list) or len(value) != shape[0]:
        size = f"{len(value)} values" if isinstance(value, tuple | list) else "a single value"
        raise DescriptionError(f"{name!r} has {size} where its shape {list(shape)} wants a list of {shape[0]}")
    for part in value:
        yield from _flattened(name, part, shape[1:])


def _single(name: str, value: object) -> Value:
    if not isinstance(value, bool | int | float | Decimal | str):
        raise DescriptionError(f"{name!r} is a single variable and takes no list")
    return value
