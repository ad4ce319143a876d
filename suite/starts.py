"""Plants that begin elsewhere than at rest: what `maneuver.initial_state` means for each form of plant, and for an FMU's runs.

Its numbers are deviations from the operating point, where the input is the one at rest: of the states of a state space, by order; of those
of an FMU's linear twin, by name or order; of a plant without states of its own (polynomials, roots, modes) the output and its derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction

from fmus.descriptions import Description
from fmus.errors import FmuError
from fmus.twins import TwinMatrices, read_twin
from relaxations.errors import ManeuverError, PlantError
from relaxations.initial import from_output, from_state
from relaxations.plants import LinearPlant
from relaxations.transitions import VaryingPlant
from suite.errors import Mistake, StudyError
from suite.study import FmuPlant, Maneuver, Plant, StateSpacePlant, Study
from suite.varying import study_plant, varying_plant

Value = Fraction | Decimal | float
PLACE = "maneuver.initial_state"


def start(
    plant: Plant, maneuver: Maneuver, linear: LinearPlant, parameters: Mapping[str, Value] | None = None
) -> tuple[Fraction, ...] | None:
    """Where the plant (an FMU's with these parameters over the study's own) begins, in the coordinates of `relaxations.initial`.

    None at rest. Raises `ManeuverError` with a sentence.
    """
    given, source = maneuver.initial_state, plant.source
    if given is None:
        return None
    if isinstance(source, FmuPlant):
        twin = _twin(source, parameters)
        named = _named(given, twin.states)
        return from_state(linear, twin.A, twin.B, [named.get(name, Decimal(0)) for name in twin.states])
    if isinstance(given, Mapping):
        raise ManeuverError("the states of a plant given as numbers have no names: give a list")
    if isinstance(source, StateSpacePlant):
        if len(given) != len(source.B):
            raise ManeuverError(f"has {len(given)} numbers; A has {len(source.B)} rows, so valid are {len(source.B)}")
        return from_state(linear, source.A, source.B, given)
    return from_output(linear, given)


def varying_start(plant: Plant, maneuver: Maneuver, varying: VaryingPlant) -> tuple[Fraction, ...] | None:
    """Where a plant that varies begins, in its own states; None at rest. Raises `ManeuverError` with a sentence."""
    given = maneuver.initial_state
    if given is None:
        return None
    if isinstance(given, Mapping) and plant.fmu is None:
        raise ManeuverError("the states of a plant given as numbers have no names: give a list")
    if plant.fmu is not None and plant.fmu.settle:
        raise ManeuverError("contradicts plant.initial.settle: an FMU that settles first begins at rest")
    try:
        return varying.begun(given)
    except PlantError as problem:
        raise ManeuverError(str(problem)) from None


def _twin(source: FmuPlant, parameters: Mapping[str, Value] | None = None) -> TwinMatrices:
    if source.archive.twin is None or not source.by_twin:
        raise ManeuverError("needs an FMU with a linear twin (resources/twin.toml), whose states are known by name")
    if source.settle:
        raise ManeuverError("contradicts plant.initial.settle: an FMU that settles first begins at rest")
    try:
        return read_twin(source.archive.twin, {**source.parameters, **(parameters or {})})
    except FmuError as problem:
        raise ManeuverError(str(problem)) from None


def _named(given: Mapping[str, Decimal] | tuple[Decimal, ...], states: tuple[str, ...]) -> dict[str, Decimal]:
    if not isinstance(given, Mapping):
        if len(given) != len(states):
            raise ManeuverError(f"has {len(given)} numbers; the states are {', '.join(states)}")
        return dict(zip(states, given, strict=True))
    if unknown := [name for name in given if name not in states]:
        raise ManeuverError(f"names {', '.join(unknown)}; the states are {', '.join(states)}")
    return dict(given)


def mistakes(plant: Plant, maneuver: Maneuver, linear: LinearPlant) -> list[Mistake]:
    """What is wrong with a study's initial state, in words; of an FMU also that a state cannot be set."""
    given = maneuver.initial_state
    if given is None:
        return []
    shown = dict(given) if isinstance(given, Mapping) else list(given)
    try:
        if plant.schedule is not None:
            varying = varying_plant(plant)
            assert varying is not None
            varying_start(plant, maneuver, varying)
        else:
            start(plant, maneuver, linear)
        if plant.fmu is not None:
            run_states(plant, maneuver)
    except (ManeuverError, FmuError) as problem:
        return [Mistake(PLACE, shown, str(problem))]
    return []


def run_mistakes(plant: Plant, maneuver: Maneuver) -> list[Mistake]:
    """What of it is wrong for an FMU's runs, where only running it tells its linear plant."""
    given = maneuver.initial_state
    shown = given if given is None else dict(given) if isinstance(given, Mapping) else list(given)
    try:
        if plant.fmu is not None and plant.fmu.settle:
            raise ManeuverError("contradicts plant.initial.settle: an FMU that settles first begins at rest")
        run_states(plant, maneuver)
    except (ManeuverError, FmuError) as problem:
        return [Mistake(PLACE, shown, str(problem))]
    return []


def run_states(plant: Plant, maneuver: Maneuver) -> dict[str, float]:
    """The start values of an FMU's states for a run: those of its operating point and the deviations from it.

    Raises `FmuError` for a state that cannot be set.
    """
    fmu = plant.fmu
    assert fmu is not None
    at_rest = {name: float(value) for name, value in fmu.initial_state.items()}
    if maneuver.initial_state is None:
        return at_rest
    has = fmu.archive.description
    states = has.state_names if plant.schedule is not None else _twin(fmu).states
    deviations = {name: value for name, value in _named(maneuver.initial_state, states).items() if value}
    return at_rest | {name: at_rest.get(name, _start(has, name)) + float(value) for name, value in deviations.items()}


def _start(has: Description, name: str) -> float:
    value = has.settable_state(name).start
    return float(value) if isinstance(value, float) else 0.0


def required_start(study: Study, linear: LinearPlant, parameters: Mapping[str, Value] | None = None) -> tuple[Fraction, ...] | None:
    """`start` of a study, or `varying_start`; raises `StudyError`."""
    try:
        if study.plant.schedule is not None:
            varying = study_plant(study, parameters)
            assert varying is not None
            return varying_start(study.plant, study.maneuver, varying)
        return start(study.plant, study.maneuver, linear, parameters)
    except ManeuverError as problem:
        raise StudyError(str(study.file), [Mistake(PLACE, "", str(problem))]) from None
