"""From the sections as written to the study as meant: names looked up in the plant, defaults filled in, the task itself examined."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, TypeVar

from fmus.confinement import MEBIBYTE, Confinement
from fmus.errors import FmuError
from relaxations.commands import Command
from relaxations.errors import ManeuverError, PlantError
from relaxations.plants import LinearPlant
from relaxations.robust.moved import Move
from relaxations.robust.moved import axis as moved_axis
from suite import schema
from suite.errors import ABSENT, Mistake
from suite.plants import linear_plant
from suite.quantity_names import Quantity, UnitKind, parse_quantity
from suite.respecting import ROUNDING, complaints
from suite.starts import mistakes as start_mistakes
from suite.starts import run_mistakes
from suite.study import GRID, CommandRequest, Limits, Maneuver, Plant, Requirement, Simulation, Study, Uncertainty
from suite.study_cancelling import understand_cancelling
from suite.study_file import printable
from suite.study_form import profile
from suite.study_plant import PlantNames, description, understand_plant
from suite.study_rules import contradictions, unsupported
from suite.study_shaper import read_command, understand_shaper
from suite.study_units import convert_units

TRIED = 200  # plants of one axis that are built to see whether they exist: 0.5 ms each
PURE_UNITS = {"1", "-", "–"}
Item = TypeVar("Item")


def understand(data: Mapping[str, Any], file: Path, source: bytes) -> tuple[Study | None, list[Mistake]]:
    """The study in a parsed file, or None and everything that is wrong with it, in the order of the sections."""
    data, unit_mistakes, conversions = convert_units(data, lambda: description(data, file.parent))
    written, mistakes = schema.read_sections(data)
    wrong = {mistake.path for mistake in mistakes}
    mistakes += [mistake for mistake in unsupported(data) if mistake.path not in wrong]
    mistakes += contradictions(written)
    plant, names = None, None
    if written.plant is not None:
        plant, names, more = understand_plant(written.plant, file.parent)
        mistakes += more
    if written.simulation is not None:
        _interface(plant, written.simulation.interface, mistakes)
        if plant is not None and plant.fmu is not None and written.simulation.step is not None:
            plant = replace(plant, source=replace(plant.fmu, step=float(written.simulation.step)))
    requirements = tuple(
        _requirement(item, i, plant, names, bool(written.uncertainty), mistakes) for i, item in _items(written.requirement)
    )
    uncertainties = tuple(_uncertainty(item, i, names, mistakes) for i, item in _items(written.uncertainty))
    command = _command(written.command, file.parent, names, mistakes) if written.command else None
    if command is not None and command.given is not None and written.command is not None and written.limits is not None:
        _within(command.given, written.command.file, written.limits, plant, mistakes)
    if plant is not None and written.maneuver is not None and written.limits is not None:
        linear = _task(plant, _maneuver(written.maneuver), written.limits, mistakes)
        axes = [(i, axis) for i, axis in enumerate(uncertainties, 1) if axis is not None]
        _box(plant, [(i, axis) for i, axis in axes if not axis.moves_a_root], mistakes)
        _roots(plant, linear, axes, mistakes)
    # A value whose unit is wrong is still text, which is refused once more where a number is wanted.
    spoilt = [mistake.path for mistake in unit_mistakes]
    mistakes = unit_mistakes + [m for m in mistakes if not any(path == m.path or path.startswith(f"{m.path}[") for path in spoilt)]
    if mistakes or plant is None or command is None or not (written.maneuver and written.limits and written.simulation and written.keep):
        return None, _in_order(mistakes)
    length = written.limits.tail_length
    sensitivity = {name: (pair.shift, pair.residual) for name, pair in (written.limits.zero_sensitivity or {}).items()}
    study = Study(
        title=written.title or printable(file.stem),
        file=file,
        source=source,
        plant=plant,
        maneuver=_maneuver(written.maneuver),
        limits=Limits(
            *written.limits.input,
            None if length is None else (length.time, length.within),
            sensitivity,
            written.limits.sample_time,
            written.limits.fuel,
            written.limits.pulse_width,
            written.limits.pulses,
            written.limits.deflection or {},
            written.limits.rate,
        ),
        command=command,
        simulation=_simulation(written.simulation),
        uncertainties=tuple(axis for axis in uncertainties if axis is not None),
        requirements=tuple(requirement for requirement in requirements if requirement is not None),
        keep_logs=written.keep.logs,
        notes=tuple(_notes(written.command, uncertainties)),
        conversions=conversions,
    )
    return study, []


def _items(items: tuple[Item | None, ...]) -> list[tuple[int, Item]]:
    return [(i, item) for i, item in enumerate(items, 1) if item is not None]


def _in_order(mistakes: list[Mistake]) -> list[Mistake]:
    """Sorted by section, each mistake once."""
    sections = ["title", *schema.KEYS]

    def rank(mistake: Mistake) -> tuple[int, int]:
        section, item = re.fullmatch(r"([^.\[]*)(?:\[(\d+)\])?.*", mistake.path, flags=re.DOTALL).groups()  # type: ignore[union-attr]
        return (sections.index(section) if section in sections else -1, int(item or 0))

    unique = {(mistake.path, mistake.message): mistake for mistake in mistakes}
    return sorted(unique.values(), key=rank)


def _maneuver(written: schema.Maneuver) -> Maneuver:
    return Maneuver(written.displacement, written.initial_state, written.scale)


def _task(plant: Plant, maneuver: Maneuver, limits: schema.Limits, mistakes: list[Mistake]) -> LinearPlant | None:
    """The limits contain the input at both rests, and the plant is one that can rest: the linear one, if it can be told."""
    lower, upper = limits.input
    rest = plant.initial_input
    if not lower <= rest <= upper:
        mistakes.append(Mistake("limits.input", [lower, upper], f"must contain the input at the initial rest, {rest}"))
    if plant.fmu is not None and (not plant.fmu.by_twin or plant.schedule is not None):
        if maneuver.initial_state is not None and plant.schedule is not None:
            mistakes.extend(run_mistakes(plant, maneuver))
        elif maneuver.initial_state is not None:
            mistakes.append(
                Mistake("maneuver.initial_state", ABSENT, "needs a linear plant whose states are known: an FMU's twin, or numbers")
            )
        return None  # only running its code, which reading a study does not, can tell
    try:
        linear = linear_plant(plant)
        final = Fraction(rest) + linear.rest_input(Fraction(maneuver.displacement))
    except PlantError as problem:
        mistakes.append(Mistake("plant", ABSENT, str(problem)))
        return None
    mistakes.extend(start_mistakes(plant, maneuver, linear))
    if final != rest and limits.fuel is not None:
        hold = float(final - Fraction(rest))
        why = f"belongs to a plant that rests without input; holding this one at its target takes {hold:.10g} for ever"
        mistakes.append(Mistake("limits.fuel", limits.fuel, why))
    if final != rest and not lower <= final <= upper:
        mistakes.append(
            Mistake("limits.input", [lower, upper], f"must contain the input that holds the plant at its final rest, {float(final):.10g}")
        )
    return linear


def _roots(plant: Plant, linear: LinearPlant | None, axes: list[tuple[int, Uncertainty]], mistakes: list[Mistake]) -> None:
    """Modes and zeros that are uncertain exist, and their ranges contain the nominal plant; they do not go with an FMU's own parameters."""
    moving = [(item, axis) for item, axis in axes if axis.moves_a_root]
    for item, axis in axes if plant.fmu is not None and moving else ():
        if not axis.moves_a_root:
            why = f"is a parameter of the FMU, and {moving[0][1].parameter} belongs to its linear plant: a box is of one kind"
            mistakes.append(Mistake(f"uncertainty[{item}].parameter", axis.parameter, why))
    if linear is None:
        return
    for item, axis in moving:
        try:
            moved_axis(linear, axis.parameter, Fraction(axis.lower), Fraction(axis.upper))
        except ManeuverError as problem:
            mistakes.append(Mistake(f"uncertainty[{item}]", ABSENT, str(problem)))


def _box(plant: Plant, axes: list[tuple[int, Uncertainty]], mistakes: list[Mistake]) -> None:
    """Every sample of each axis by itself is a plant: no mass is zero. Of very fine grids only the ends are tried."""
    if plant.fmu is None or not plant.fmu.by_twin or plant.schedule is not None:
        return
    for item, axis in axes:
        for value in axis.values if axis.samples <= TRIED else (axis.lower, axis.upper):
            try:
                linear_plant(plant, {axis.parameter: value})
            except PlantError as problem:
                place = f"at {axis.parameter} = {float(value):.10g}"
                mistakes.append(Mistake(f"uncertainty[{item}].range", [axis.lower, axis.upper], f"{place}: {problem}"))
                break


def _command(written: schema.Command, folder: Path, names: PlantNames | None, mistakes: list[Mistake]) -> CommandRequest | None:
    start = written.start or Decimal(0)
    if written.kind == "file":
        if written.file is None:
            return None
        given = read_command(written.file, folder, "command.file", mistakes)
        return None if given is None else CommandRequest("file", start=start, file=(folder / written.file).expanduser(), given=given)
    if written.kind == "shaper":
        shaper = understand_shaper(written, folder, names, mistakes)
        return None if shaper is None else CommandRequest("shaper", start=start, shaper=shaper)
    if written.kind == "pole-zero":
        filtered = understand_cancelling(written, mistakes)
        with_tail = written.tail is not False
        return filtered and CommandRequest("pole-zero", written.robustness or 0, with_tail, start=start, cancelling=filtered)
    tolerance, final = (written.tolerance, written.final_tolerance) if written.robustness == "box" else (None, None)
    kind: Literal["time-optimal", "fuel-efficient"] = "fuel-efficient" if written.kind == "fuel-efficient" else "time-optimal"
    form = profile(written)
    return CommandRequest(
        kind, written.robustness or 0, bool(written.tail), tolerance, final, start, type=form, alpha=written.alpha or None
    )


def _within(command: Command, file: str | None, limits: schema.Limits, plant: Plant | None, mistakes: list[Mistake]) -> None:
    """A command that was given respects the limits too, up to the rounding of its own numbers."""
    lower, upper = map(float, limits.input)
    if plant is not None:
        found = complaints(command, limits, lower, upper, float(plant.initial_input))
        mistakes.extend(Mistake("command.file", file, complaint) for complaint in found)
    slack = ROUNDING * (upper - lower)
    least, most = command.extent()
    for level, limit, beyond in ((least, lower, least < lower - slack), (most, upper, most > upper + slack)):
        if beyond:
            mistakes.append(Mistake("command.file", file, f"the command reaches {level:.10g}, beyond limits.input, {limit:.10g}"))


def _interface(plant: Plant | None, asked: str | None, mistakes: list[Mistake]) -> None:
    if plant is None or plant.fmu is None or asked is None:
        return
    has = plant.fmu.archive.description.capabilities
    offered = {"co-simulation": has.co_simulation, "model-exchange": has.model_exchange}
    if offered[asked] is None:
        other = next(name for name in offered if name != asked)
        mistakes.append(Mistake("simulation.interface", asked, f'is not offered by the FMU; valid is "{other}"'))


def _simulation(written: schema.Simulation) -> Simulation:
    default = Simulation()
    confinement = Confinement(
        memory=default.confinement.memory if written.memory is None else written.memory * MEBIBYTE,
        step=None if written.step_timeout is None else float(written.step_timeout),
    )
    return Simulation(
        step=None if written.step is None else float(written.step),
        observe=None if written.observe is None else float(written.observe),
        timeout=default.timeout if written.timeout is None else float(written.timeout),
        seed=default.seed if written.seed is None else written.seed,
        interface=written.interface,
        confinement=confinement,
    )


def _uncertainty(written: schema.Uncertainty, item: int, names: PlantNames | None, mistakes: list[Mistake]) -> Uncertainty | None:
    path, parameter = f"uncertainty[{item}].parameter", written.parameter
    if names is None or written.range is None:
        return None
    if Move.of(parameter) is not None:
        return Uncertainty(parameter, *written.range, GRID if written.samples is None else written.samples)
    try:
        variable = names.parameter(parameter)
    except ValueError as problem:
        mistakes.append(Mistake(path, parameter, str(problem)))
        return None
    axis = Uncertainty(parameter, *written.range, GRID if written.samples is None else written.samples, variable.unit)
    try:
        for value in axis.values if axis.samples <= TRIED else (axis.values[0], axis.values[-1]):
            variable.within(value)
    except FmuError as problem:
        mistakes.append(Mistake(f"uncertainty[{item}].range", [axis.lower, axis.upper], str(problem)))
    return axis


def _requirement(
    written: schema.Requirement, item: int, plant: Plant | None, names: PlantNames | None, has_box: bool, mistakes: list[Mistake]
) -> Requirement | None:
    path, unit = f"requirement[{item}]", ""
    try:
        quantity = parse_quantity(written.quantity)
        if names is not None and quantity.variable is not None:
            name, unit = names.logged(quantity.variable)
            quantity = Quantity(quantity.name, variable=name)
    except ValueError as problem:
        mistakes.append(Mistake(f"{path}.quantity", written.quantity, str(problem)))
        return None
    if plant is None:
        return None
    unit = _unit(quantity.unit_kind, plant, unit)
    if written.unit is not None and (complaint := _unit_complaint(written.unit, unit, quantity, plant)):
        mistakes.append(Mistake(f"{path}.unit", written.unit, complaint))
    minimum, maximum = (None if limit is None else float(limit) for limit in (written.min, written.max))
    scope = written.scope or ("box" if has_box else "nominal")
    return Requirement(written.id, written.text or "", quantity, minimum, maximum, unit, scope)


def _unit(kind: UnitKind, plant: Plant, variable: str) -> str:
    """A quantity's unit; empty for pure numbers, and where the plant does not say."""
    match kind:
        case UnitKind.NONE:
            return ""
        case UnitKind.SECOND:
            return "s"
        case UnitKind.VARIABLE:
            return variable
        case UnitKind.INPUT:
            return plant.input_unit
        case UnitKind.INPUT_SECOND:
            return f"{plant.input_unit}·s" if plant.input_unit else ""
        case UnitKind.INPUT_PER_SECOND:
            return f"{plant.input_unit}/s" if plant.input_unit else ""


def _unit_complaint(asked: str, unit: str, quantity: Quantity, plant: Plant) -> str | None:
    """Why a requirement's unit is wrong: it is not the quantity's own, to which limits in other units have been converted by now."""
    if quantity.unit_kind is UnitKind.NONE:
        return None if asked.strip() in PURE_UNITS else f'{quantity} is a pure number; valid is "1", or no unit'
    if not unit:
        return f"the unit of {quantity} is not known ({'the FMU declares none' if plant.fmu else 'numbers have none'}); leave unit out"
    return None if _plain(asked) == _plain(unit) else f'{quantity} is measured in "{unit}", to which this cannot be converted'


def _plain(unit: str) -> str:
    """A unit with every sign for a product written as FMI does."""
    return re.sub(r"\s*[·⋅*.\s]\s*", ".", unit.strip())


def _notes(command: schema.Command | None, axes: Iterable[Uncertainty | None]) -> list[str]:
    if command is None or command.robustness == "box":
        return []
    unused = [
        f'{axis.parameter} changes nothing here: only robustness = "box" looks at plants whose modes or zeros are elsewhere'
        for axis in axes
        if axis is not None and axis.moves_a_root
    ]
    if command.kind in ("shaper", "pole-zero"):
        return unused
    return unused + [
        f'command.{key} changes nothing here: it belongs to robustness = "box", and this command brings the nominal plant exactly to rest'
        for key in ("tolerance", "final_tolerance")
        if getattr(command, key) is not None
    ]
