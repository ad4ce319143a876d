"""The command of a study with a shaper: its reference, the shaper for the plant's modes, and the product of both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

from relaxations.commands import Command
from relaxations.courses import respects
from relaxations.errors import ImpossibleShaperError, PlantError, RelaxationsError, ShaperError
from relaxations.maneuvers import Problem
from relaxations.plants import LinearPlant
from relaxations.shaping.following import followed, following_move
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.references import rigid_move, rigid_problem, step
from relaxations.shaping.shapers import shape
from relaxations.shaping.streams import Schedule
from suite.errors import ABSENT, Mistake, StudyError
from suite.plants import plant_at
from suite.respecting import complaints
from suite.shaping import Shaping, assess
from suite.study import ShaperRequest, Study

ROUNDING = 1e-9  # of the distance between the limits


@dataclass(frozen=True, slots=True)
class Shaped:
    """The shaper with what is proven of it, what it shapes ("step", "rigid" or "file") and for how long [s], and the command.

    One that `follows` a varying mode is the shaper of the nominal plant only where the mode is the nominal one.
    """

    shaping: Shaping
    reference: str
    reference_time: float
    command: Command
    follows: bool = False


def shaped(study: Study, asked: ShaperRequest, plant: LinearPlant, posed: Problem) -> Shaped:
    """The study's shaped command, begun at once; raises `StudyError` where there is none, `ImpossibleShaperError` if there is no shaper."""
    request = asked.request
    if not request.modes:
        modes = tuple(Mode(pole.natural_frequency, pole.damping_ratio) for pole in plant.flexible for _ in range(pole.multiplicity))
        if not modes:
            raise _refused(study, "modes", "is missing, and the plant has no flexible mode that a shaper could be made for")
        request = replace(request, modes=modes)
    kind, reference = _reference(study, asked, plant, posed)
    try:
        shaping = assess(asked.kind, request, asked.damping)
    except ImpossibleShaperError:
        raise
    except RelaxationsError as problem:
        raise _refused(study, "shaper", str(problem), asked.kind) from None
    try:
        if asked.follow is None:
            command = shape(reference, shaping.shaper, float(study.plant.initial_input))
        else:
            reference, command = _following(study, asked, plant, posed, reference)
    except RelaxationsError as problem:
        raise _refused(study, "reference" if asked.follow is None else "follow", str(problem)) from None
    _within(study, asked, command, posed)
    return Shaped(shaping, kind, reference.maneuver_time, command, asked.follow is not None)


def _following(study: Study, asked: ShaperRequest, plant: LinearPlant, posed: Problem, reference: Command) -> tuple[Command, Command]:
    """The reference and what a shaper makes of it that follows the plant's modes."""
    assert asked.follow is not None
    parameter, times, values = asked.follow
    shapers = []
    for value in values:
        there = plant_at(study, {parameter: value})
        modes = tuple(Mode(pole.natural_frequency, pole.damping_ratio) for pole in there.flexible for _ in range(pole.multiplicity))
        if not modes:
            raise ShaperError(f"with {parameter} = {value} the plant has no flexible mode that a shaper could be made for")
        shapers.append(make(asked.kind, replace(asked.request, modes=modes)).shaper)
    schedule = Schedule(times, tuple(shapers))
    if plant.rigid_order or asked.reference == "rigid":
        return following_move(rigid_problem(plant, posed.maneuver), reference, schedule)
    return reference, followed(reference, schedule, float(study.plant.initial_input))


def _reference(study: Study, asked: ShaperRequest, plant: LinearPlant, posed: Problem) -> tuple[str, Command]:
    if isinstance(asked.reference, Command):
        return "file", asked.reference
    kind = asked.reference or ("rigid" if plant.rigid_order else "step")
    maneuver = posed.maneuver
    try:
        if kind == "step":
            return kind, step(plant, maneuver.displacement, Fraction(study.plant.initial_input))
        bound = rigid_move(plant, maneuver)
    except PlantError as problem:
        raise _refused(study, "reference", str(problem), kind) from None
    if bound.command is None:
        raise _refused(study, "reference", f"no move of the rigid part was found: {bound.reason or bound.status.value}", kind)
    return kind, bound.command


def _within(study: Study, asked: ShaperRequest, command: Command, posed: Problem) -> None:
    """Negative impulses may take the command beyond limits that its reference respects; a file may do so by itself.

    Fuel, samples, slopes, pulses and outputs are no demands that shapers are made by.
    """
    lower, upper = float(study.limits.lower), float(study.limits.upper)
    slack = ROUNDING * (upper - lower)
    least, most = command.extent()
    if least < lower - slack or most > upper + slack:
        reached = f"from {least:.10g} to {most:.10g}"
        why = f"the shaped command goes {reached}, beyond limits.input, [{lower:.10g}, {upper:.10g}]"
        hint = "a shaper without negative impulses keeps its reference's limits; or shape a slower command from a file"
        raise _refused(study, "shaper", f"{why}; {hint}", asked.kind)
    if wrong := list(complaints(command, study.limits, lower, upper, float(study.plant.initial_input))):
        hint = "a slower reference from a file, on whole samples if there is a sample time, and command.sample_time may do"
        raise _refused(study, "shaper", f"shaped, {'; '.join(wrong)}; {hint}", asked.kind)
    if posed.courses and not respects(posed.courses, command, float(study.plant.initial_input)):
        names = ", ".join(dict.fromkeys(course.name for course in posed.courses))
        why = f"the shaped command takes an output of the linear plant beyond limits.deflection ({names})"
        hint = "a longer shaper, a slower reference from a file, or a larger limit may do"
        raise _refused(study, "shaper", f"{why}; {hint}", asked.kind)


def _refused(study: Study, key: str, why: str, value: object = ABSENT) -> StudyError:
    return StudyError(str(study.file), [Mistake(f"command.{key}", value, why)])
