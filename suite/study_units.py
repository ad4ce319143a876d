"""Values of a study that carry a unit, as in "5 mm": turned into plain numbers in the unit that their key stands for, before all else.

What that unit is follows from the key (a time is in seconds) or from the FMU's variable that the key is about. Everything later sees
plain numbers only.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from functools import cached_property
from typing import Any

from fmus.descriptions import Description
from fmus.errors import FmuError
from fmus.variables import REAL_TYPES, Unit, Variable, element_indices
from relaxations.robust.moved import Move
from suite import units
from suite.errors import Mistake
from suite.quantity_names import QUANTITIES, UnitKind, parse_quantity
from suite.study import Conversion
from suite.units import ONE, RADIAN_PER_SECOND, SECOND, Scale, UnitError

WRITTEN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*([^\s\d.].*?)\s*", re.DOTALL)
"""A number and a unit."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The unit of a key: its scale (None: the FMU does not say what it is), its name, and the FMU's own definition."""

    name: str
    scale: Scale | None
    difference: bool = True
    own: Unit | None = None


class _Units:
    """The units that a study's keys stand for."""

    def __init__(self, data: Mapping[str, Any], describe: Callable[[], Description | None]) -> None:
        self.plant = data["plant"] if isinstance(data.get("plant"), dict) else {}
        self._describe = describe

    @cached_property
    def description(self) -> Description | None:
        """The FMU's; None for a plant that is given as numbers."""
        if "fmu" not in self.plant:
            return None
        found = self._describe()
        if found is None:
            raise _Elsewhere("the FMU cannot be opened")
        return found

    @cached_property
    def known(self) -> Mapping[str, Unit]:
        """The units that the FMU defines, by name."""
        return {unit.name: unit for unit in self.description.units} if self.description else {}

    def of(self, name: object, difference: bool = True) -> Wanted:
        """A variable's unit."""
        if self.description is None:
            raise UnitError("the plant is given as numbers, which have no unit; give a plain number, in the plant's own units")
        variable = self._variable(str(name))
        if not variable.unit:
            raise UnitError(f'the FMU declares no unit for "{variable.name}"; give a plain number')
        own = self.known.get(variable.unit, Unit(variable.unit, (), defined=False))
        return Wanted(variable.unit, units.of_fmu(own), difference, own)

    def is_real(self, name: str) -> bool:
        """Whether text given for a variable can only be a number with a unit."""
        return self.description is None or self._variable(name).type in REAL_TYPES

    def _variable(self, name: str) -> Variable:
        assert self.description is not None
        parts = element_indices(name)
        whole = parts[0] if parts and name not in self.description.names() else name
        if whole == "output" and whole not in self.description.names():
            whole = str(self.plant.get("output"))
        try:
            return self.description.find(whole)
        except FmuError as problem:
            raise _Elsewhere(str(problem)) from None

    def per(self, wanted: Wanted, seconds: int) -> Wanted:
        """A variable's unit times a power of the second."""
        name = wanted.name + ("·s" if seconds > 0 else "/s")
        return Wanted(name, wanted.scale and wanted.scale.times(seconds, name))

    def quantity(self, item: Mapping[str, Any]) -> Wanted:
        """The unit of a requirement's quantity."""
        try:
            quantity = parse_quantity(str(item.get("quantity")))
        except ValueError as problem:
            raise _Elsewhere(str(problem)) from None
        match QUANTITIES[quantity.name].unit:
            case UnitKind.NONE:
                return Wanted("1", ONE)
            case UnitKind.SECOND:
                return Wanted("s", SECOND)
            case UnitKind.INPUT:
                return self.of(self.plant.get("input"), difference=False)
            case UnitKind.INPUT_SECOND:
                return self.per(self.of(self.plant.get("input")), 1)
            case UnitKind.INPUT_PER_SECOND:
                return self.per(self.of(self.plant.get("input")), -1)
            case UnitKind.VARIABLE:
                return self.of(quantity.variable, difference=quantity.name != "final")


class _Elsewhere(Exception):
    """The unit cannot be told because of a mistake that is reported where it was made."""


Finder = Callable[[_Units, Mapping[str, Any], str], Wanted]
"""From the table that holds a key, and the key, to its unit."""


def _second(u: _Units, table: Mapping[str, Any], key: str) -> Wanted:
    return Wanted("s", SECOND)


def _one(u: _Units, table: Mapping[str, Any], key: str) -> Wanted:
    return Wanted("1", ONE)


def _output(u: _Units, table: Mapping[str, Any], key: str) -> Wanted:
    return u.of(u.plant.get("output"))


def _input(u: _Units, table: Mapping[str, Any], key: str) -> Wanted:
    return u.of(u.plant.get("input"), difference=False)


def _axis(u: _Units, table: Mapping[str, Any], key: str) -> Wanted:
    parameter = str(table.get("parameter"))
    if Move.of(parameter) is not None:
        return Wanted("1", ONE)
    return u.of(parameter, difference=False)


PLACES: dict[str, Finder] = {
    # Every key that may carry a unit; "*" stands for the keys of a table, "[]" for the items of a list.
    "plant.modes.[].frequency": lambda u, table, key: Wanted("rad/s", RADIAN_PER_SECOND),
    "plant.modes.[].damping": _one,
    "plant.parameters.*": lambda u, table, key: u.of(key, difference=False),
    "plant.initial.input": _input,
    "plant.initial.state.*": lambda u, table, key: u.of(key, difference=False),
    "maneuver.displacement": _output,
    "maneuver.scale": _output,
    "maneuver.initial_state.*": lambda u, table, key: u.of(key),
    "limits.input": _input,
    "limits.fuel": lambda u, table, key: u.per(_input(u, table, key), 1),
    "limits.rate": lambda u, table, key: u.per(_input(u, table, key), -1),
    "limits.deflection.*": lambda u, table, key: u.of(key),
    "limits.sample_time": _second,
    "limits.pulse_width": _second,
    "limits.tail_length.time": _second,
    "limits.tail_length.within": _one,
    "command.start": _second,
    "command.instants": _second,
    "command.gains": lambda u, table, key: u.of(u.plant.get("input")),
    "command.tolerance": _one,
    "command.final_tolerance": _one,
    "simulation.step": _second,
    "simulation.observe": _second,
    "simulation.timeout": _second,
    "simulation.step_timeout": _second,
    "uncertainty.[].range": _axis,
    "uncertainty.[].distribution.lower": _axis,
    "uncertainty.[].distribution.upper": _axis,
    "uncertainty.[].distribution.mean": _axis,
    "uncertainty.[].distribution.deviation": lambda u, table, key: replace(_axis(u, table, key), difference=True),
    "requirement.[].min": lambda u, table, key: u.quantity(table),
    "requirement.[].max": lambda u, table, key: u.quantity(table),
}


def convert_units(
    data: Mapping[str, Any], describe: Callable[[], Description | None]
) -> tuple[dict[str, Any], list[Mistake], tuple[Conversion, ...]]:
    """The parsed study with plain numbers, the mistakes in its units, and what was converted.

    `describe` gives the FMU's description, None where it cannot be opened; it is called if a unit asks for it.
    """
    made = copy.deepcopy(dict(data))
    u = _Units(made, describe)
    mistakes: list[Mistake] = []
    conversions: list[Conversion] = []
    for item in made["requirement"] if isinstance(made.get("requirement"), list) else []:
        if isinstance(item, dict) and isinstance(item.get("unit"), str):
            _requirement_unit(u, item)
    found = [(place, spot) for place in PLACES for spot in _spots(made, place.split("."), "", made)]
    for place, spot in found:
        if not any(isinstance(leaf, str) for leaf in _leaves(spot.value)):
            continue
        if place == "plant.parameters.*" and not _numeric(u, spot.key):
            continue  # the name of an enumeration's item
        spot.table[spot.key] = _converted(u, PLACES[place], spot, spot.value, spot.path, mistakes, conversions)
    return made, mistakes, tuple(conversions)


def is_with_unit(text: str) -> bool:
    """Whether it is written as a number with a unit, such as "500 N/km"."""
    try:
        Decimal(text)
    except InvalidOperation:
        return WRITTEN.fullmatch(text) is not None
    return False


def plain_values(values: Mapping[str, Any], describe: Callable[[], Description | None]) -> tuple[dict[str, Any], list[Mistake]]:
    """Values for an FMU's variables given outside of a study, with or without units: as plain numbers, and the mistakes in them."""
    made, mistakes, _ = convert_units({"plant": {"fmu": "", "parameters": dict(values)}}, describe)
    return made["plant"]["parameters"], mistakes


def _numeric(u: _Units, name: str) -> bool:
    try:
        return u.is_real(name)
    except _Elsewhere:
        return False


@dataclass(frozen=True, slots=True)
class _Spot:
    """A key in its table; `outer` is the section or item that the table belongs to."""

    table: dict[str, Any]
    key: str
    path: str
    outer: Mapping[str, Any]

    @property
    def value(self) -> Any:
        return self.table[self.key]


def _spots(table: Any, keys: list[str], path: str, outer: Mapping[str, Any]) -> Iterator[_Spot]:
    head, *rest = keys
    if head == "[]":
        for i, item in enumerate(table if isinstance(table, list) else [], 1):
            yield from _spots(item, rest, f"{path}[{i}]", item if isinstance(item, dict) else {})
    elif isinstance(table, dict):
        for key in list(table) if head == "*" else [head] if head in table else []:
            inner = f"{path}.{key}".lstrip(".")
            if rest:
                yield from _spots(table[key], rest, inner, outer)
            else:
                yield _Spot(table, key, inner, outer)


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


def _converted(u: _Units, find: Finder, spot: _Spot, value: Any, path: str, mistakes: list[Mistake], conversions: list[Conversion]) -> Any:
    """The value with every text in it that is a number with a unit replaced; one whose unit is wrong stays, and is a mistake."""
    if isinstance(value, list):
        return [_converted(u, find, spot, item, f"{path}[{i}]", mistakes, conversions) for i, item in enumerate(value, 1)]
    match = WRITTEN.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return value
    try:
        wanted = find(u, spot.outer, spot.key)
        number = _number(Decimal(match[1]), match[2], wanted, u)
    except _Elsewhere:
        return _in_si(Decimal(match[1]), match[2])
    except UnitError as problem:
        mistakes.append(Mistake(path, value, str(problem)))
        return value
    conversions.append(Conversion(path, value.strip(), number, wanted.name))
    return number


def _in_si(value: Decimal, unit: str) -> Decimal:
    """Some number that stands for the value while the unit of its key cannot be told: no further mistake shall come of that."""
    try:
        return units.decimal(units.named(unit).factor * Fraction(value))
    except UnitError:
        return value


def _number(value: Decimal, unit: str, wanted: Wanted, u: _Units) -> Decimal:
    if _plain(unit) == _plain(wanted.name):
        return value
    if wanted.scale is None:
        raise UnitError(f'the FMU does not say what its unit "{wanted.name}" is; valid are this unit, and plain numbers')
    return units.convert(value, _scale(unit, wanted, u), wanted.scale, wanted.difference)


def _scale(name: str, wanted: Wanted, u: _Units) -> Scale:
    """A unit by its common name, else by what the FMU calls so."""
    try:
        return units.named(name)
    except UnitError:
        for shown in wanted.own.display if wanted.own and wanted.scale else ():
            if shown.name == name and (scale := units.shown_as(shown, wanted.scale)):  # type: ignore[arg-type] - not None here
                return scale
        if name in u.known and (scale := units.of_fmu(u.known[name])):
            return scale
        if wanted.scale is None:
            raise
        raise UnitError(f'"{name}" is no unit that is known; {units.examples(wanted.scale)}') from None


def _requirement_unit(u: _Units, item: dict[str, Any]) -> None:
    """Plain limits in a requirement's `unit`, if that is another one than the quantity's own: the same as limits that carry it."""
    try:
        wanted = u.quantity(item)
        if _plain(item["unit"]) in (_plain(wanted.name), "-", "–"):
            return
        _number(Decimal(1), item["unit"], wanted, u)
    except (UnitError, _Elsewhere):
        return  # the check of the unit says what is wrong
    for key in ("min", "max"):
        if isinstance(item.get(key), int | Decimal) and not isinstance(item[key], bool):
            item[key] = f"{item[key]} {item['unit']}"
    item["unit"] = wanted.name


def _plain(unit: str) -> str:
    """A unit with every sign for a product written as FMI does."""
    return re.sub(r"\s*[·⋅*.\s]\s*", ".", unit.strip())
