"""`slewcert fuel`: the minimum time against the fuel that it may burn, for commands of several kinds, and what a user picks a budget by.

The kinds differ in what they leave at rest: the rigid body alone (`rb`), the flexible modes too (`zv`), and these with further zeros
(`zvd`, `zvdd` …). Every budget is a task of its own with a certificate of its own, and each search begins where those of its neighbours
ended. More fuel asks for less, so the minimum time can only fall: what is proven at the budgets bounds it between them too
(`sweeps.stairs`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal, InvalidOperation
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.shaping.references import rigid_part
from relaxations.shaping.sensitivity import residual
from relaxations.spending import least_fuel
from relaxations.transition_fuels import Node, nodes, reason_against
from suite.design import pose
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.plants import nominal_plant
from suite.quantities import Modes, command_insensitivity, step_impulses
from suite.study import Study
from suite.sweeps import claimed, extrapolated, kept, sides

DEFAULT_KINDS = ("rb", "zv", "zvd")
KIND = re.compile(r"rb|zv(d*)")
MOST_ZEROS, MOST_POINTS, POINTS = 6, 2000, 200
SPARING = 7  # without --from: the most that any of the kinds burns, divided by this
DIGITS = 4  # of a node's fuel where it is written as a budget, rounded up
LEVEL = 0.05  # at which insensitivity is measured unless said otherwise
HIGHER = 3.0  # times the highest frequency that is modelled: about where the mode is that nobody modelled
AROUND = np.linspace(0.8, 1.2, 81)  # times that: it may be anywhere there
MOST_HIGHER = 1000.0
BENT = 2.0  # a knee bends the curve this many times as much as the curve is bent before it bends the next time
CLEAR = 1e-9  # gap above which a point says nothing about the curve's bends


class FuelError(SuiteError):
    """The budgets, the kinds or the files that are asked for make no sense."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What a command leaves at rest: `zeros` further zeros at each flexible mode; None: flexible modes are left alone."""

    name: str
    zeros: int | None

    @property
    def title(self) -> str:
        """As it stands in texts and pictures."""
        return "rigid body" if self.zeros is None else self.name.upper()


@dataclass(frozen=True, slots=True)
class Pulses:
    """A command of three levels by its switches: `times` [s] from 0 to T, and on which side of the rest it is in between (1, 0, -1).

    `type` is 1 if all pulses of one side come first, 2 if they alternate; None of other commands.
    """

    times: tuple[float, ...]
    sides: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many pulses."""
        return sum(side != 0 for side in self.sides)

    @property
    def type(self) -> int:
        """See above."""
        signs = [side for side in self.sides if side]
        return 1 if sum(a != b for a, b in pairwise(signs)) <= 1 else 2


@dataclass(frozen=True, slots=True)
class Point:
    """The minimum time of one budget [input units · s], exact; its command's insensitivity, and what it leaves of an unmodelled mode."""

    fuel: Fraction
    bound: Bound
    pulses: Pulses | None = None
    burnt: float | None = None
    insensitivity: float | None = None
    higher_mode: float | None = None
    certificate: Path | None = None

    @property
    def status(self) -> str:
        """`proved`, `bracketed` or `impossible`."""
        return self.bound.status.name.lower()

    @property
    def lower(self) -> float | None:
        """The lower side [s], if it is proven."""
        return self.bound.lower if "lower" in claimed(self.bound) else None

    @property
    def upper(self) -> float | None:
        """The upper side [s], if it is proven."""
        return self.bound.upper if "upper" in claimed(self.bound) else None

    def to_dict(self) -> dict[str, Any]:
        """A point of `fuel --json`."""
        bound, pulses = self.bound, self.pulses
        record: dict[str, Any] = {
            "fuel": float(self.fuel),
            "status": self.status,
            "maneuver_time": sides(bound),
            "proven": {"lower": self.lower is not None, "upper": self.upper is not None},
            "burnt": self.burnt,
            "pulses": None if pulses is None else pulses.count,
            "type": None if pulses is None else pulses.type,
            "switch_times": None if pulses is None else list(pulses.times),
            "sides": None if pulses is None else list(pulses.sides),
            "insensitivity": self.insensitivity,
            "higher_mode": self.higher_mode,
            "certificate": None if self.certificate is None else str(self.certificate),
        }
        return record if bound.reason is None else {**record, "reason": bound.reason}


@dataclass(frozen=True, slots=True)
class Curve:
    """The points of one kind by ascending fuel; `free` is its fastest command without a budget, `least` [input units · s] the fuel that
    every command of it needs, whatever its time, where that is more than 0."""

    kind: Kind
    posed: Problem
    free: Point
    points: tuple[Point, ...]
    least: float | None = None

    @property
    def knees(self) -> tuple[Point, ...]:
        """Where a little less fuel suddenly costs much more time: the points at which the sampled curve bends most; measured."""
        return _knees([p for p in self.points if p.bound.upper is not None and (p.bound.gap or 0.0) <= CLEAR])

    @property
    def turns(self) -> tuple[tuple[Point, Point], ...]:
        """Neighbours of which one has pulses of one side first and the other has not."""
        pairs = zip(self.points, self.points[1:], strict=False)
        return tuple((a, b) for a, b in pairs if a.pulses and b.pulses and a.pulses.type != b.pulses.type)

    def at(self, fuel: Fraction) -> Point | None:
        """The point of this budget."""
        return next((point for point in self.points if point.fuel == fuel), None)

    def to_dict(self) -> dict[str, Any]:
        """A curve of `fuel --json`."""
        return {
            "kind": self.kind.name,
            "robustness": self.kind.zeros,
            "unlimited": self.free.to_dict() | {"fuel": None},
            "least_fuel": self.least,
            "points": [point.to_dict() for point in self.points],
            "knees": [float(point.fuel) for point in self.knees],
        }


@dataclass(frozen=True, slots=True)
class Choice:
    """A prudent budget: a little less would cost much more time. `node` is what it is by the closed form, None: a knee of the samples."""

    kind: Kind
    fuel: Fraction
    node: Node | None = None

    @property
    def why(self) -> str:
        """In words."""
        if self.node is None:
            return "knee of the curve (measured)"
        return f"node {self.node.number}: one pulse either way"

    def to_dict(self) -> dict[str, Any]:
        """A choice of `fuel --json`."""
        node = self.node
        told = None if node is None else {"number": node.number, "fuel": node.fuel, "maneuver_time": node.maneuver_time}
        return {"kind": self.kind.name, "robustness": self.kind.zeros, "fuel": float(self.fuel), "node": told}


@dataclass(frozen=True, slots=True)
class Settings:
    """What is measured of every command: insensitivity at `level`, the largest excitation around `higher` times the highest frequency."""

    level: float = LEVEL
    higher: float = HIGHER


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be bracketed: the problems of the kinds without a budget, their fastest commands, the budgets by ascending fuel."""

    study: Study
    plant: LinearPlant
    posed: tuple[tuple[Kind, Problem], ...]
    free: tuple[Bound, ...]
    budgets: tuple[Fraction, ...]
    shown: tuple[Fraction, ...]
    nodes: tuple[tuple[Fraction, Node], ...]
    settings: Settings
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many minimum times."""
        return len(self.budgets) * len(self.posed)


@dataclass(frozen=True, slots=True)
class FuelSweep:
    """The curves, the prudent choices, the budgets that are shown in full, and what a reader should know."""

    study: Study
    modes: Modes
    settings: Settings
    curves: tuple[Curve, ...]
    choices: tuple[Choice, ...]
    shown: tuple[Fraction, ...]
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Of fuel."""
        return f"{self.study.plant.input_unit or 'input'}·s"

    @property
    def impossible(self) -> bool:
        """Whether a budget is proven to be too small for a kind."""
        return any(point.status == "impossible" for curve in self.curves for point in curve.points)

    def curve(self, kind: Kind) -> Curve:
        """That of a kind."""
        return next(curve for curve in self.curves if curve.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """The object of `fuel --json` (docs/schemas.md)."""
        return {
            "study": str(self.study.file),
            "fuel_unit": self.unit,
            "modes": [{"frequency": frequency, "damping": damping} for frequency, damping in self.modes],
            "level": self.settings.level,
            "higher_mode": self.settings.higher,
            "curves": [curve.to_dict() for curve in self.curves],
            "choices": [choice.to_dict() for choice in self.choices],
            "shown": [float(fuel) for fuel in self.shown],
            "notes": list(self.notes),
            "seconds": round(self.seconds, 6),
        }


def kinds(names: Sequence[str]) -> tuple[Kind, ...]:
    """`rb`, `zv`, `zvd`, `zvdd` …, each once; raises `FuelError`."""
    found = []
    for name in dict.fromkeys(name.strip().lower() for name in names):
        match = KIND.fullmatch(name)
        zeros = None if match is None or match[1] is None else len(match[1])
        if match is None or (zeros or 0) > MOST_ZEROS:
            raise FuelError(f"--kind {name}: rb (rigid body), zv, zvd, zvdd … (a d for each further zero, {MOST_ZEROS} at most)")
        found.append(Kind(name, zeros))
    return tuple(found)


def budget(option: str, text: str | None) -> Fraction | None:
    """An amount of fuel [input units · s], more than 0; raises `FuelError`."""
    if text is None:
        return None
    try:
        value = Fraction(Decimal(text.strip()))
    except (InvalidOperation, ValueError, OverflowError):
        raise FuelError(f"{option} is an amount of fuel such as 3.5 (input unit · second), not {text!r}") from None
    if value == 0:
        raise FuelError(f"{option} 0: without fuel nothing moves; a budget is more than 0")
    if value < 0:
        raise FuelError(f"{option} {text}: a budget of fuel is more than 0")
    return value


def written(fuel: Fraction) -> str:
    """A budget as it stands in a study: every budget of a sweep is a decimal of few digits."""
    return f"{Decimal(fuel.numerator) / Decimal(fuel.denominator):f}"


def spread(least: Fraction, most: Fraction, count: int) -> tuple[Fraction, ...]:
    """`count` equally spaced budgets, both ends included, those between rounded to decimals that a study can be given."""
    step = (most - least) / (count - 1)
    place = Decimal(1).scaleb(math.floor(math.log10(step)) - 3)

    def rounded(value: Fraction) -> Fraction:
        return Fraction((Decimal(value.numerator) / Decimal(value.denominator)).quantize(place, ROUND_HALF_EVEN))

    return (least, *(rounded(least + step * i) for i in range(1, count - 1)), most)


def plan(
    study: Study,
    least: str | None = None,
    most: str | None = None,
    count: int = POINTS,
    names: Sequence[str] = DEFAULT_KINDS,
    shown: Sequence[str] = (),
    settings: Settings | None = None,
) -> Plan:
    """Choose the budgets; raises `StudyError` for a study that burns no fuel, or for ever, `FuelError` for options that make no sense."""
    low, high = budget("--from", least), budget("--to", most)
    wanted, asked = kinds(names), [found for text in shown if (found := budget("--show", text)) is not None]
    chosen = settings or Settings()
    if not 2 <= count <= MOST_POINTS:
        raise FuelError(f"--points {count}: from 2 to {MOST_POINTS}")
    if not 0.0 < chosen.level < 1.0:
        raise FuelError(f"--level {chosen.level:g}: a fraction of a step of the input, more than 0 and less than 1, such as 0.05")
    if not 1.0 < chosen.higher <= MOST_HIGHER:
        raise FuelError(f"--higher-mode {chosen.higher:g}: times the highest frequency, more than 1 and at most {MOST_HIGHER:g}, such as 3")
    _require(study)
    plant = nominal_plant(study)
    if not plant.rigid_order:
        hold = float(plant.rest_input(Fraction(study.maneuver.displacement)))
        why = f"has no rigid-body mode: an input of {hold:.6g} holds it at its target, which burns fuel for ever, so no budget is enough"
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, why)])
    notes = []
    if not plant.flexible:
        notes.append("the plant has no flexible mode: all kinds are the rigid body's")
        wanted = (Kind("rb", None),)
    posed = tuple((kind, _posed(study, plant, kind)) for kind in wanted)
    free = tuple(minimum_time(problem_) for _, problem_ in posed)
    burns = [bound.command.fuel(problem_.rest) for bound, (_, problem_) in zip(free, posed, strict=True) if bound.command is not None]
    if not burns:
        raise StudyError(str(study.file), [Mistake("maneuver", ABSENT, "no command of any kind was found, with as much fuel as it takes")])
    high = high or _up(max(burns), 3)
    low = low or _up(float(high) / SPARING, 2)
    if not low < high:
        raise FuelError(f"--from {written(low)} --to {written(high)}: the sweep goes from less fuel to more")
    budgets = set(spread(low, high, count))
    against = reason_against(posed[-1][1])
    if against is not None and plant.flexible:
        notes.append(f"nodes are known in closed form where {against}; prudent choices are knees of the sampled curves")
    known = [(_up(node.fuel, DIGITS), node) for node in nodes(posed[-1][1], float(low), float(high))]
    known = [(fuel, node) for fuel, node in known if low <= fuel <= high]
    own = study.limits.fuel
    budgets |= {fuel for fuel, _ in known} | {fuel for fuel in asked if low <= fuel <= high}
    budgets |= {Fraction(own)} if own is not None and low <= own <= high else set()
    for fuel in asked:
        if not low <= fuel <= high:
            raise FuelError(f"--show {written(fuel)} is outside the sweep, {written(low)} to {written(high)}")
    if study.command.robustness != 0:
        notes.append("the kinds replace the study's own robustness")
    return Plan(study, plant, posed, free, tuple(sorted(budgets)), tuple(asked), tuple(known), chosen, tuple(notes))


def _require(study: Study) -> None:
    """Raise `StudyError` unless the study moves a plant from rest to rest by its own commands."""
    mistakes = []
    if study.command.kind in ("shaper", "file"):
        mistakes.append(Mistake("command.kind", study.command.kind, "a sweep of budgets is one of commands that are designed"))
    if study.command.tail:
        mistakes.append(Mistake("command.tail", True, "on-off commands end; a tail, whose fuel no budget counts, decays"))
    if study.plant.schedule is not None:
        mistakes.append(Mistake("plant.schedule", ABSENT, "a plant that varies has no modes of its own to leave at rest or not"))
    if study.maneuver.initial_state is not None:
        mistakes.append(Mistake("maneuver.initial_state", ABSENT, "kinds of commands are compared on a move from rest"))
    if mistakes:
        raise StudyError(str(study.file), mistakes)


def _posed(study: Study, plant: LinearPlant, kind: Kind) -> Problem:
    """The task of one kind without a budget; raises `StudyError`."""
    command = replace(study.command, kind="time-optimal", robustness=kind.zeros or 0, tolerance=None, final_tolerance=None)
    whole = pose(replace(study, command=command, limits=replace(study.limits, fuel=None), uncertainties=()), plant)
    if kind.zeros is not None or not plant.flexible:
        return whole
    maneuver, rigid = whole.maneuver, rigid_part(plant)
    known = {name: limit for name, limit in maneuver.limits.deflection.items() if name == "output_rate"}
    limits = replace(maneuver.limits, deflection=known)
    return problem([rigid], Maneuver(maneuver.displacement, limits, maneuver.rest, sample_time=maneuver.sample_time))


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
        curves.append(Curve(kind, posed, unlimited, tuple(reversed(found)), least_fuel(posed)))
    done = tuple(curves)
    choices = _choices(planned, done)
    seconds = sum(point.bound.seconds for curve in done for point in (curve.free, *curve.points))
    shown = planned.shown or tuple(sorted({choice.fuel for choice in choices if choice.node} or {choice.fuel for choice in choices}))[-2:]
    return FuelSweep(planned.study, modes, planned.settings, done, choices, shown, seconds, planned.notes)


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


def _knees(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points at which the curve of time against fuel bends most, from more fuel to less."""
    bends = []
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        left, right = float(here.fuel - before.fuel), float(after.fuel - here.fuel)
        times = [point.bound.upper or 0.0 for point in (before, here, after)]
        bends.append(2.0 * ((times[0] - times[1]) / left - (times[1] - times[2]) / right) / (left + right))
    found, top, place, flat = [], 0.0, -1, 0.0
    for i in reversed(range(len(bends))):
        if bends[i] >= top and bends[i] > BENT * flat:
            top, place = bends[i], i
        elif place >= 0 and bends[i] * BENT < top:
            found.append(points[place + 1])
            top, place, flat = 0.0, -1, max(bends[i], 0.0)
        if place < 0:
            flat = min(flat, max(bends[i], 0.0))
    return tuple(found)


def _choices(planned: Plan, curves: Sequence[Curve]) -> tuple[Choice, ...]:
    """The nodes of ZV where they are known, and the knees of all other curves."""
    found: list[Choice] = []
    for curve in curves:
        if curve.kind.zeros == 0 and planned.nodes:
            found += [Choice(curve.kind, fuel, node) for fuel, node in planned.nodes]
        elif curve.kind.zeros is not None:
            found += [Choice(curve.kind, point.fuel) for point in curve.knees]
    return tuple(found)


def _up(value: float, digits: int) -> Fraction:
    """A decimal of so many digits, not less."""
    exact = Decimal(value)
    return Fraction(exact.quantize(Decimal(1).scaleb(exact.adjusted() + 1 - digits), ROUND_CEILING))
