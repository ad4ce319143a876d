"""Which budgets of which kinds of commands a sweep looks at."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal, InvalidOperation
from fractions import Fraction

from relaxations.bounds import Bound
from relaxations.maneuvers import Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.shaping.references import rigid_part
from relaxations.spending import least_fuel
from relaxations.transition_fuels import Node, nodes, reason_against
from suite.design import pose
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.fuel_records import Kind, Settings
from suite.plants import nominal_plant
from suite.study import Study

DEFAULT_KINDS = ("rb", "zv", "zvd")
KIND = re.compile(r"rb|zv(d*)")
MOST_ZEROS, MOST_POINTS, POINTS = 6, 2000, 200
EASY = 1  # flexible modes: of more of them a proof of what is held in a form takes long
SPARING = 7  # without --from: the most that any of the kinds burns, divided by this
MORE = 1.02  # times the fuel that every command needs: with hardly more than that a move takes for ever
FINE = 60  # budgets: of fewer a picture shows the steps between them
DIGITS = 4  # of a node's fuel where it is written as a budget, rounded up
MOST_HIGHER = 1000.0


class FuelError(SuiteError):
    """The budgets, the kinds or the files that are asked for make no sense."""


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
    held: bool = True
    weights: bool = True

    @property
    def count(self) -> int:
        """How many minimum times."""
        return len(self.budgets) * len(self.posed) + (sum(kind.zeros is not None for kind, _ in self.posed) if self.held else 0)


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
    *,
    held: bool | None = None,
    weights: bool = True,
) -> Plan:
    """Choose the budgets; without a word commands are `held` in a form where that does not take long.

    Raises `StudyError` for a study that burns no fuel, or for ever, `FuelError` for options that make no sense.
    """
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
    needed = max((least_fuel(problem_) or 0.0 for _, problem_ in posed), default=0.0)
    low = low or max(_up(float(high) / SPARING, 2), _up(MORE * needed, 3) if needed else Fraction(0))
    if not low < high:
        raise FuelError(f"--from {written(low)} --to {written(high)}: the sweep goes from less fuel to more")
    budgets = set(spread(low, high, count))
    against = reason_against(posed[-1][1])
    if against is not None and plant.flexible:
        notes.append(f"nodes are known in closed form where {against}; prudent choices are knees of the sampled curves")
    if held is None and not (held := len(plant.flexible) <= EASY):
        notes.append(f"commands held in the form of pulses one way, then the other, are left out, with {len(plant.flexible)} modes: --held")
    if count < FINE:
        why = "between two budgets the bound that is proven is that of the larger one, so that it looks like stairs"
        notes.append(f"{why}, and switches stand apart: more --points draw both finer (now {count})")
    known = [(_up(node.fuel, DIGITS), node) for node in nodes(posed[-1][1], float(low), float(high))]
    known = [(fuel, node) for fuel, node in known if low <= fuel <= high]
    own = study.limits.fuel
    budgets |= {fuel for fuel, _ in known} | {fuel for fuel in asked if low <= fuel <= high}
    budgets |= {Fraction(own)} if own is not None and low <= own <= high else set()
    for fuel in asked:
        if not low <= fuel <= high:
            raise FuelError(f"--show {written(fuel)} is outside the sweep, {written(low)} to {written(high)}")
    if study.command.type == 1:
        notes.append("the sweep is one of commands of any form, not of the study's own")
    if study.command.robustness != 0:
        notes.append("the kinds replace the study's own robustness")
    return Plan(study, plant, posed, free, tuple(sorted(budgets)), tuple(asked), tuple(known), chosen, tuple(notes), held, weights)


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
    command = replace(study.command, kind="time-optimal", type=2, robustness=kind.zeros or 0, tolerance=None, final_tolerance=None)
    whole = pose(replace(study, command=command, limits=replace(study.limits, fuel=None), uncertainties=()), plant)
    if kind.zeros is not None or not plant.flexible:
        return whole
    maneuver, rigid = whole.maneuver, rigid_part(plant)
    known = {name: limit for name, limit in maneuver.limits.deflection.items() if name == "output_rate"}
    limits = replace(maneuver.limits, deflection=known)
    return problem([rigid], Maneuver(maneuver.displacement, limits, maneuver.rest, sample_time=maneuver.sample_time))


def _up(value: float, digits: int) -> Fraction:
    """A decimal of so many digits, not less."""
    exact = Decimal(value)
    return Fraction(exact.quantize(Decimal(1).scaleb(exact.adjusted() + 1 - digits), ROUND_CEILING))
