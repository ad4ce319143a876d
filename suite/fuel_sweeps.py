"""`slewcert fuel`: the minimum time against the fuel that it may burn, for commands of several kinds, and what a user picks a budget by.

The kinds differ in what they leave at rest: the rigid body alone (`rb`), the flexible modes too (`zv`), and these with further zeros
(`zvd`, `zvdd` …). Every budget is a task of its own with a certificate of its own, and each search begins where those of its neighbours
ended. More fuel asks for less, so the minimum time can only fall: what is proven at the budgets bounds it between them too
(`sweeps.stairs`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem, problem
from relaxations.onoff.held import towards
from relaxations.proofs import minimum_time
from relaxations.shaping.sensitivity import residual
from relaxations.spending import least_fuel
from suite.errors import Mistake, StudyError
from suite.fuel_plans import Plan, written
from suite.fuel_records import Choice, Curve, FuelSweep, Point, Pulses, Settings
from suite.fuel_weights import critical_weights
from suite.quantities import Modes, command_insensitivity, step_impulses
from suite.study import Study
from suite.sweeps import extrapolated, kept

MOST_HELD = 6  # budgets of one kind at which the form is held: a proof of it takes a second or more
AROUND = np.linspace(0.8, 1.2, 81)  # times where an unmodelled mode is looked for: it may be anywhere there


def sweep(planned: Plan, certificates: Path | None = None, advance: Callable[[], None] = lambda: None) -> FuelSweep:
    """Bracket every budget of every kind, from the most fuel down; proofs are written to the folder `certificates`.

    Raises `StudyError` for a budget that makes no sense for the study.
    """
    modes = tuple((pole.natural_frequency, pole.damping_ratio) for pole in planned.plant.flexible)
    curves = []
    for (kind, posed), free in zip(planned.posed, planned.free, strict=True):
        stem, found, near = f"{planned.study.file.stem}.{kind.name}", [], []
        for fuel in reversed(planned.budgets):
            bound = minimum_time(_with(planned.study, posed, fuel), near=extrapolated(near, fuel) or free.upper)
            if bound.upper is not None:
                near = [*near[-1:], (fuel, bound.upper)]
            point = _measured(Point(fuel, bound), posed, modes, planned.settings)
            found.append(replace(point, certificate=kept(certificates, f"{stem}.{written(fuel)}", bound)))
            advance()
        unlimited = _measured(Point(Fraction(0), free, certificate=kept(certificates, stem, free)), posed, modes, planned.settings)
        curve = Curve(kind, posed, unlimited, tuple(reversed(found)), least_fuel(posed))
        if planned.held and kind.zeros is not None:
            curve = _held(planned, curve, modes, certificates)
            advance()
        curves.append(curve)
    done = tuple(curves)
    choices = _choices(planned, done)
    more = [point for curve in done for point in (curve.efficient, *curve.held) if point is not None]
    seconds = sum(point.bound.seconds for point in (*more, *(one for curve in done for one in (curve.free, *curve.points))))
    shown = planned.shown or tuple(sorted({choice.fuel for choice in choices if choice.node} or {choice.fuel for choice in choices}))[-2:]
    zero = next((curve.posed for curve in done if curve.kind.zeros == 0), None)
    weights = critical_weights(zero) if planned.weights and zero is not None else ()
    return FuelSweep(planned.study, modes, planned.settings, done, choices, shown, seconds, planned.notes, weights)


def _held(planned: Plan, curve: Curve, modes: Modes, certificates: Path | None) -> Curve:
    """The curve with the commands of its kind whose pulses go one way first: without a budget, and where the fastest command is not so.

    What that command without a budget does not burn is of no use to the form, so no budget of more is looked at.
    """
    posed, stem = curve.posed, f"{planned.study.file.stem}.{curve.kind.name}.held"
    maneuver = posed.maneuver
    try:
        side = towards(posed.plants[0], maneuver.displacement)
        form = problem(posed.plants, replace(maneuver, limits=replace(maneuver.limits, held=side)))
    except ManeuverError:
        return curve
    bound = minimum_time(form)
    file = kept(certificates, stem, bound)
    efficient = _measured(Point(Fraction(0), bound, certificate=file), posed, modes, planned.settings)
    if efficient.burnt is None:
        return replace(curve, efficient=efficient)
    open_ = [point for point in curve.points if (point.pulses is None or point.pulses.type == 2) and point.fuel < efficient.burnt]
    chosen = open_ if len(open_) <= MOST_HELD else [open_[round(i * (len(open_) - 1) / (MOST_HELD - 1))] for i in range(MOST_HELD)]
    found = []
    for point in chosen:
        bound = minimum_time(_with(planned.study, form, point.fuel), near=point.bound.upper)
        file = kept(certificates, f"{stem}.{written(point.fuel)}", bound)
        found.append(_measured(Point(point.fuel, bound, certificate=file), posed, modes, planned.settings))
    return replace(curve, efficient=efficient, held=tuple(found))


def _with(study: Study, posed: Problem, fuel: Fraction) -> Problem:
    maneuver = posed.maneuver
    try:
        return problem(posed.plants, replace(maneuver, limits=replace(maneuver.limits, fuel=fuel)))
    except ManeuverError as refused:
        raise StudyError(str(study.file), [Mistake("limits.fuel", float(fuel), str(refused))]) from None


def _measured(point: Point, posed: Problem, modes: Modes, settings: Settings) -> Point:
    """The point with what is measured of its command."""
    command, rest = point.bound.command, posed.rest
    if command is None or point.bound.status is Status.IMPOSSIBLE:
        return point
    unit = max((abs(segment.level - rest) for segment in command.segments), default=0.0)
    impulses = step_impulses(command, rest, unit)
    if impulses is None or not modes:
        return replace(point, burnt=command.fuel(rest), pulses=None if impulses is None else _pulses(point.bound, posed))
    frequency, damping = modes[-1]
    higher = float(residual(*impulses, settings.higher * frequency * AROUND, damping).max())
    narrow = command_insensitivity(command, rest, unit, modes, settings.level)
    return replace(point, burnt=command.fuel(rest), pulses=_pulses(point.bound, posed), insensitivity=narrow, higher_mode=higher)


def _pulses(bound: Bound, posed: Problem) -> Pulses | None:
    """The switches of a command of three levels; None of another one."""
    command, limits = bound.command, posed.maneuver.limits
    assert command is not None
    named = {float(limits.upper): 1, float(limits.lower): -1, posed.rest: 0}
    if not command.segments or any(segment.level not in named or segment.slope for segment in command.segments):
        return None
    starts, on = [segment.start for segment in command.segments], [named[segment.level] for segment in command.segments]
    return Pulses((*starts, command.end), tuple(on))


def _choices(planned: Plan, curves: Sequence[Curve]) -> tuple[Choice, ...]:
    """The nodes of ZV where they are known, and the knees of all other curves."""
    found: list[Choice] = []
    for curve in curves:
        if curve.kind.zeros == 0 and planned.nodes:
            found += [Choice(curve.kind, fuel, node) for fuel, node in planned.nodes]
        elif curve.kind.zeros is not None:
            found += [Choice(curve.kind, point.fuel) for point in curve.knees]
    return tuple(found)
