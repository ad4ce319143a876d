"""From a study to linear plants: the nominal one, and the one at any place in the box."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

from fmus.errors import FmuError
from fmus.twins import linear_plant as twin_plant
from fmus.twins import read_twin, twin_family
from relaxations.errors import ManeuverError, PlantError
from relaxations.plants import LinearPlant
from relaxations.robust.boxes import Axis, Box, Family, Listed
from relaxations.robust.moved import Move, moved, nominal
from relaxations.robust.moved import axis as moved_axis
from suite.errors import ABSENT, Mistake, StudyError
from suite.linearised import linearised
from suite.study import FmuPlant, ModalPlant, Plant, RootsPlant, StateSpacePlant, Study, TransferPlant
from suite.varying import varying_plant

Value = Fraction | Decimal | float

MOST_LISTED = 200  # linearisations of an FMU for one box: each takes a child process a moment


def nominal_plant(study: Study) -> LinearPlant:
    """The plant with the study's own parameters; raises `StudyError` at `plant` if there is no linear plant that can be used."""
    return plant_at(study, {})


def plant_at(study: Study, parameters: Mapping[str, Value]) -> LinearPlant:
    """The plant with some parameters changed (each in its own unit); raises `StudyError` as `nominal_plant` does."""
    try:
        return linear_plant(study.plant, parameters)
    except PlantError as problem:
        place = "".join(f" at {name} = {float(value):.10g}" for name, value in parameters.items())
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, f"{problem}{place}")]) from problem


def linear_plant(plant: Plant, parameters: Mapping[str, Value] | None = None) -> LinearPlant:
    """The linear plant in exact numbers: as written, or an FMU's twin with `parameters` over the study's own; of one that varies the final
    one.

    An FMU without a twin, or as the study asks, is linearised where it starts or has settled, in a child process.
    Raises `PlantError` if it is improper, has a zero at the origin, is not moved by the input … (the message says which).
    """
    changed = dict(parameters or {})
    source = plant.source
    if plant.schedule is not None:
        varying = varying_plant(plant, changed)
        assert varying is not None
        return varying.final
    if changed and not isinstance(source, FmuPlant):
        raise PlantError(f"a plant given as numbers has no parameter {', '.join(changed)}")
    match source:
        case TransferPlant():
            return LinearPlant.from_transfer(source.numerator, source.denominator)
        case RootsPlant():
            return LinearPlant.from_zeros_poles(source.zeros, source.poles, source.gain)
        case ModalPlant():
            return LinearPlant.from_modes(source.rigid, source.modes)
        case StateSpacePlant():
            return LinearPlant.from_state_space(source.A, source.B, source.C, source.D, source.outputs)
        case FmuPlant():
            return _twin(source, plant, {**source.parameters, **changed})


def box(study: Study, nominal: LinearPlant) -> Box:
    """The plants over the study's whole box, of which `nominal` is one; raises `StudyError` if it is none.

    Uncertain modes and zeros are those of the linear plant, whatever it comes from. By an FMU's linear twin the plants are one family in
    closed form. Without, those of the study's grid are linearised one by one, each in a child process, and nothing is known between them.
    """
    source = study.plant.source
    if any(axis.moves_a_root for axis in study.uncertainties):
        return _moved(study, nominal)
    assert isinstance(source, FmuPlant)  # numbers have no other parameters
    names = [axis.parameter for axis in study.uncertainties]
    try:
        axes = tuple(
            Axis(axis.parameter, nominal_value(study, axis.parameter), Fraction(axis.lower), Fraction(axis.upper))
            for axis in study.uncertainties
        )
        if source.by_twin:
            assert source.archive.twin is not None
            family = twin_family(source.archive.twin, study.plant.output, names, source.parameters, [*study.limits.deflection])
        else:
            family = _listed(study, tuple(axis.nominal for axis in axes), nominal)
        return _box(study, axes, family)
    except ManeuverError as problem:
        raise StudyError(str(study.file), [Mistake("uncertainty", ABSENT, str(problem))]) from problem
    except FmuError as problem:
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, str(problem))]) from problem


def _box(study: Study, axes: tuple[Axis, ...], family: Family | Listed) -> Box:
    final = study.command.final_tolerance
    return Box(axes, family, Fraction(study.command.tolerance or 0), final_tolerance=None if final is None else Fraction(final))


def _moved(study: Study, nominal: LinearPlant) -> Box:
    mistakes, axes = [], []
    for item, axis in enumerate(study.uncertainties, 1):
        try:
            axes.append(moved_axis(nominal, axis.parameter, Fraction(axis.lower), Fraction(axis.upper)))
        except ManeuverError as problem:
            mistakes.append(Mistake(f"uncertainty[{item}]", ABSENT, str(problem)))
    if mistakes:
        raise StudyError(str(study.file), mistakes)
    return _box(study, tuple(axes), moved(nominal, axes))


def _listed(study: Study, usual: tuple[Fraction, ...], nominal: LinearPlant) -> Listed:
    places = list(itertools.product(*(axis.values for axis in study.uncertainties)))
    if len(places) > MOST_LISTED:
        why = f"would linearise the FMU at {len(places)} places, one by one; at most {MOST_LISTED} are, so ask for fewer samples"
        raise StudyError(str(study.file), [Mistake("command.robustness", "box", why)])
    names = [axis.parameter for axis in study.uncertainties]
    others = ((place, plant_at(study, dict(zip(names, place, strict=True)))) for place in places if place != usual)
    return Listed(((usual, nominal), *others))


def nominal_value(study: Study, parameter: str) -> Fraction:
    """An uncertain parameter's nominal value: the study's, else the FMU's start value; that of a root in the nominal plant."""
    if Move.of(parameter) is not None:
        return nominal(nominal_plant(study), parameter)
    fmu = study.plant.fmu
    assert fmu is not None
    if parameter in fmu.parameters:
        return Fraction(fmu.parameters[parameter])
    start = fmu.archive.description.find(parameter).start
    return Fraction(repr(start)) if isinstance(start, float) else Fraction(start or 0)


def _twin(fmu: FmuPlant, plant: Plant, parameters: Mapping[str, Value]) -> LinearPlant:
    if not fmu.by_twin:
        return _linearised(fmu, plant, parameters)
    assert fmu.archive.twin is not None
    try:
        twin = read_twin(fmu.archive.twin, parameters)
        if twin.input != plant.input:
            raise PlantError(f"the linear twin of {fmu.archive.path.name} describes the input {twin.input!r}, not {plant.input!r}")
        linear = twin_plant(twin, plant.output)
        near = "the linear plant is its motion near rest, and model_mismatch says how far the FMU is from it"
        note = f"{fmu.archive.path.name} is nonlinear: {near}"
        return replace(linear, notes=(*linear.notes, note)) if twin.nonlinear else linear
    except FmuError as problem:
        raise PlantError(str(problem)) from None


def _linearised(fmu: FmuPlant, plant: Plant, parameters: Mapping[str, Value]) -> LinearPlant:
    name = fmu.archive.path.name
    why = "as the study asks" if fmu.archive.twin is not None else "it brings no linear twin"
    try:
        # Where steps are of any size, what suits the plant is taken for it.
        found = linearised(fmu, plant, parameters, step=fmu.step if fmu.archive.description.capabilities.one_step else None)
        found.require_rest(name)
        linear = found.plant(plant.output).plant
    except FmuError as problem:
        raise PlantError(f"{name} cannot be linearised ({why}): {problem}") from None
    told = (f"the linear plant is that of {name} ({why}): {found.summary}", *found.notes)
    return replace(linear, notes=(*linear.notes, *told))
