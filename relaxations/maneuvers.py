"""The task: from rest to rest, for one or several plants that share a command.

A `Problem` is what everything downstream works on: limits on the deviation of the input and, for every plant, a `TargetSet` of linear
equations on that plant's moments at the end of the move. Robustness by further zeros is a plant with poles of higher multiplicity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import NDArray

from relaxations.courses import Course, courses_of
from relaxations.errors import ManeuverError
from relaxations.frames import Frame
from relaxations.initial import at_rest, moments, moved
from relaxations.limits import Limits
from relaxations.moments import Basis
from relaxations.plants import LinearPlant, Pole
from relaxations.ramps import hats, rate_of
from relaxations.robust.boxes import Box, at
from relaxations.robust.residuals import Residuals, Sample
from relaxations.tails import Aspect, TailLength, TailSpace, caps, passed, sloping, tail_columns, turning
from relaxations.transitions import Transition
from relaxations.visibility import visible

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Maneuver:
    """Move the output by `displacement` (output units) from the rest at input `rest`, within `limits`; exact numbers.

    `robustness` further zeros are placed at every flexible mode, or as many as a mapping says: `{"mode[1]": 1, "real[2]": 1}`
    (flexible modes by ascending frequency, real poles by ascending magnitude). With `tail` only the output has to rest, and the input may
    decay along the stable zeros; `tail_length` (time [s] after the move, fraction of the nearer limit's distance from the final rest input)
    limits how long. `zero_sensitivity` limits what a tail moves the output if a zero is not quite where it should be: (shift, residual) by
    the name of a zero, `zero[i]` by ascending magnitude, both fractions, of the zero's magnitude and of the displacement. With a
    `sample_time` h [s] the input is constant on each [kh, (k+1)h), and the move lasts a whole number of them. A plant that is not at rest
    begins at `initial` (`relaxations.initial`): the displacement, which may then be 0, counts from the rest at input `rest` all the same.
    """

    displacement: Fraction
    limits: Limits
    rest: Fraction = Fraction(0)
    robustness: int | Mapping[str, int] = 0
    tail: bool = False
    tail_length: tuple[Fraction, Fraction] | None = None
    zero_sensitivity: Mapping[str, tuple[Fraction, Fraction]] = field(default_factory=dict)
    box: Box | None = None
    sample_time: Fraction | None = None
    initial: tuple[Fraction, ...] | None = None


@dataclass(frozen=True, slots=True)
class TargetSet:
    """Where one plant must be when the move ends: `M(T) = target`, in the rows of `basis`; target has shape (n,)."""

    basis: Basis
    target: Reals


@dataclass(frozen=True, slots=True)
class Problem:
    """One command for a list of plants: deviations `lower ≤ u - u_0 ≤ upper` (input units), `hold` that of the final rest.

    `plants` and `maneuver` are the exact data that the floating-point rest was made from. With a `frame` all equations are written in its
    coordinates (`relaxations.conditioning`).
    """

    lower: float
    upper: float
    hold: float
    sets: tuple[TargetSet, ...]
    plants: tuple[LinearPlant, ...]
    maneuver: Maneuver
    tail: TailSpace
    rest: float = 0.0
    fuel: float | None = None
    courses: tuple[Course, ...] = ()
    rate: tuple[float, float] | None = None
    residuals: Residuals | None = None
    begin: Reals | None = None  # moments of an initial state
    notes: tuple[str, ...] = field(default=())
    frame: Frame | None = None
    transition: Transition | None = None  # of a plant that varies (`relaxations.varying`): t then stands where time to go does

    @property
    def bang_bang(self) -> bool:
        """Whether the input's limits alone shape the command: it is then on one of them nearly everywhere."""
        return self.residuals is None and self.fuel is None and not self.courses and self.rate is None

    @property
    def sloped(self) -> bool:
        """Whether the input is continuous: its slope is limited. (With a sample time its steps are, and it is constant in between.)"""
        return self.rate is not None and self.maneuver.sample_time is None

    @property
    def switched(self) -> bool:
        """Whether the command is on a limit of the input or, where fuel has a price, at rest nearly everywhere: switch times say it all."""
        return self.residuals is None and not self.courses and self.rate is None

    @property
    def eased(self) -> Problem:
        """The same without the limits that a bang-bang command may happen to respect."""
        return replace(self, fuel=None, courses=())

    def table(self, instants: Reals) -> Reals:
        """The moments at the end of the grid of a unit level in each cell, or of a unit value at each node but the first: (size, N)."""
        if self.sloped:
            return hats(self.rows, instants)
        integrated = self.rows(instants[-1] - instants, 1)
        return integrated[:, :-1] - integrated[:, 1:]

    @property
    def size(self) -> int:
        """Number of real equations of all target sets together."""
        return sum(target.basis.size for target in self.sets)

    @property
    def poles(self) -> set[complex]:
        """All poles, those of the samples of a box too."""
        bases = [own.basis for own in self.sets] + [sample.basis for sample in (self.residuals.samples if self.residuals else ())]
        return {pole.value for basis in bases for pole in basis.poles}

    @property
    def target(self) -> Reals:
        """All target sets' right-hand sides in one column."""
        return self.frame.target if self.frame else np.concatenate([np.zeros(0), *(target.target for target in self.sets)])

    def aim(self, times: Reals) -> tuple[Reals, Reals]:
        """What the command's moments must be at the end of moves of these durations [s], and their derivative by it: (size, len(times))."""
        target = self.target[:, None]
        if self.begin is None:
            return np.repeat(target, len(times), axis=1), np.zeros((self.size, len(times)))
        course, change = moved(self.sets[0].basis, self.begin, times)
        return target - course, -change

    def aimed(self, time: float) -> Reals:
        """What the command's moments must be after a move of `time` [s]: (size,)."""
        return self.target if self.begin is None else self.aim(np.array([time]))[0][:, 0]

    def rows(self, s: Sequence[float] | Reals, integrals: int = 0) -> Reals:
        """All target sets' `b(s)`, or its integrals from 0, stacked: shape (size, len(s))."""
        points = np.atleast_1d(np.asarray(s, dtype=float))
        if self.frame is None:
            tables = [target.basis.rows(points, integrals) for target in self.sets]
            return tables[0] if len(tables) == 1 else np.vstack([np.zeros((0, len(points))), *tables])
        rows, beyond = self.frame.rows(points, integrals), points > self.frame.horizon
        if beyond.any():  # with few digits only: to look over the edge
            rows[:, beyond] = self.frame.outside @ np.vstack([target.basis.rows(points[beyond], integrals) for target in self.sets])
        return rows

    def modal(self, costate: Reals) -> tuple[Fraction, ...] | Reals:
        """The costate of the moments themselves, where a frame is in use: exact numbers of many digits."""
        return self.frame.modal(costate) if self.frame else costate

    def samples(self, count: int, stride: int = 1) -> Reals:
        """The instants [s] at which the input may change, 0 to `count` times `stride` sample times: each the double nearest to it."""
        step = (self.maneuver.sample_time or Fraction(0)) * stride
        return np.array([float(k * step) for k in range(count + 1)])

    def on_grid(self, time: float) -> Fraction:
        """The exact instant [s] that a double stands for: a whole number of sample times, if there is one."""
        step = self.maneuver.sample_time
        return Fraction(time) if step is None else round(Fraction(time) / step) * step

    def absolute(self, deviation: float) -> float:
        """The input itself, in input units: adding the rest must not round a level beyond its limit."""
        limits = self.maneuver.limits
        return min(max(deviation + self.rest, float(limits.lower)), float(limits.upper))

    def derivative(self, costate: Reals) -> Reals:
        """Costate of ds-derivative of `p(s) = λᵀ b(s)`."""
        if self.frame:
            return costate @ self.frame.slopes
        parts = np.split(costate, np.cumsum([target.basis.size for target in self.sets])[:-1])
        return np.concatenate([target.basis.derivative(part) for target, part in zip(self.sets, parts, strict=True)])


def extra_zeros(plant: LinearPlant, robustness: int | Mapping[str, int]) -> dict[complex, int]:
    """How many further zeros each pole gets, by the pole; raises `ManeuverError` for modes that are not the plant's."""
    named = {f"mode[{i}]": pole for i, pole in enumerate(plant.flexible, 1)} | {f"real[{i}]": pole for i, pole in enumerate(plant.real, 1)}
    if isinstance(robustness, Mapping):
        unknown = sorted(set(robustness) - set(named))
        if unknown:
            raise ManeuverError(f"robustness names {', '.join(unknown)}; this plant has {', '.join(named) or 'no such mode'}")
        wanted = dict(robustness)
    else:
        wanted = {name: robustness for name, pole in named.items() if pole.is_flexible}
    wrong = {name: count for name, count in wanted.items() if count < 0}
    if wrong:
        raise ManeuverError(f"robustness counts further zeros, 0 or more: {wrong}")
    return {named[name].value: count for name, count in wanted.items()}


def target_set(plant: LinearPlant, maneuver: Maneuver) -> TargetSet:
    """State rest of one plant after the move, with the further zeros asked for.

    Off the origin the moments equal those of holding u_ss for ever; at the origin all vanish but the highest, which carries the
    displacement.
    """
    extra = extra_zeros(plant, maneuver.robustness)
    basis = Basis(tuple(Pole(pole.value, pole.multiplicity + extra.get(pole.value, 0)) for pole in plant.poles))
    hold = float(plant.rest_input(maneuver.displacement))
    target = basis.hold(hold)
    if plant.rigid_order:  # poles are sorted by magnitude: the origin's rows come first
        highest = plant.partial().residues[0][-1].real
        target[plant.rigid_order - 1] = float(maneuver.displacement) / highest
    return TargetSet(basis, target)


def problem(plants: Sequence[LinearPlant], maneuver: Maneuver) -> Problem:
    """The equations and limits of a maneuver of one or more plants under one command.

    Raises `ManeuverError` if there is nothing to move or the limits exclude the input at either rest, `PlantError` without a rest state.
    """
    if maneuver.displacement == 0 and maneuver.initial is None:
        raise ManeuverError("the displacement is 0: there is nothing to move")
    if maneuver.tail:
        if len(plants) != 1:
            raise ManeuverError("an output rest is a matter of one plant: a tail hides in the zeros of that plant only")
        plants, whole = [visible(plant) for plant in plants], plants[0]
        if maneuver.initial is not None and plants[0].order != whole.order:
            raise ManeuverError(
                "an initial state moves modes that the output cannot see: state rest (tail = false) brings them to rest too"
            )
    if maneuver.tail_length is not None and not (maneuver.tail and maneuver.tail_length[0] >= 0 and 0 < maneuver.tail_length[1] <= 1):
        raise ManeuverError("a tail length (time from 0 on, fraction from 0 to 1) needs an output rest, tail = true")
    sampling, begin = _sampling(plants, maneuver), _begin(plants, maneuver)
    sensible_pulses(maneuver)
    _sensible_form(maneuver)
    holds = {plant.rest_input(maneuver.displacement) for plant in plants}
    if len(holds) != 1:
        raise ManeuverError(f"the plants share one command and so one final rest input, but ask for {sorted(map(float, holds))}")
    (hold,) = holds
    low, high = maneuver.limits.lower, maneuver.limits.upper
    for where, value in (("initial", maneuver.rest), ("final", maneuver.rest + hold)):
        if not low <= value <= high:
            raise ManeuverError(
                f"the input at the {where} rest is {float(value)!r}, outside the limits [{float(low)!r}, {float(high)!r}]: "
                "the plant could not stay at rest there"
            )
    fuel = maneuver.limits.fuel
    if fuel is not None and not fuel > 0:
        raise ManeuverError(f"a fuel budget is more than 0, not {float(fuel)!r}")
    if fuel is not None and hold != 0:
        raise ManeuverError(
            f"a fuel budget belongs to a plant that rests without input: this one is held at its target by {float(hold)!r}, "
            "which would use fuel for ever"
        )
    sets, residuals = tuple(target_set(plant, maneuver) for plant in plants), None
    courses, rate = courses_of(plants, maneuver, begin), rate_of(maneuver)
    if maneuver.box is not None:
        sets, residuals = _boxed(plants, maneuver, maneuver.box, float(hold), courses)
    stable = tuple(zero for zero in plants[0].zeros if zero.value.real < 0) if maneuver.tail else ()
    zeros, limited = caps(plants[0], stable, _sensitivities(plants[0], maneuver), maneuver.displacement)
    final = maneuver.rest + hold
    length = None if maneuver.tail_length is None else TailLength(*map(float, maneuver.tail_length))
    columns, aspects = tail_columns(tuple(own.basis for own in sets), zeros), _aspects(plants[0], zeros, courses, rate)
    tail = TailSpace(zeros, columns, float(high - final), float(final - low), length, limited, aspects)
    return Problem(
        float(low - maneuver.rest),
        float(high - maneuver.rest),
        float(hold),
        sets,
        tuple(plants),
        maneuver,
        tail,
        float(maneuver.rest),
        None if fuel is None else float(fuel),
        courses,
        rate,
        residuals,
        begin,
        (*(note for plant in plants for note in plant.notes), *sampling),
    )


def sensible_pulses(maneuver: Maneuver) -> None:
    """Raise `ManeuverError` unless limits of pulses make sense."""
    limits = maneuver.limits
    if limits.pulse_width is not None and not limits.pulse_width > 0:
        raise ManeuverError(f"a pulse width is more than 0, not {float(limits.pulse_width)!r} s")
    if limits.pulses is not None and limits.pulses < 1:
        raise ManeuverError(f"a command has at least one pulse, not {limits.pulses}")
    if limits.pulsed and (maneuver.tail or maneuver.sample_time is not None):
        raise ManeuverError(
            "limits of pulses belong to a state rest, at any instants: no tail, which decays (thrusters are on or off), and no sample "
            "time, for which of the finitely many commands of three levels on samples rest is an integer program, which is not there"
        )


def _sensible_form(maneuver: Maneuver) -> None:
    """Raise `ManeuverError` where a form is held that does not go with the task."""
    other = maneuver.tail or maneuver.box or maneuver.sample_time is not None or maneuver.initial is not None
    if maneuver.limits.held and (other or maneuver.limits.rate is not None or maneuver.limits.deflection):
        raise ManeuverError("pulses one way, then the other (type = 1) lead from rest to state rest of one plant, at any instants")


def _begin(plants: Sequence[LinearPlant], maneuver: Maneuver) -> Reals | None:
    """The moments that a plant which is not at rest begins with."""
    start = maneuver.initial
    if start is None:
        return None
    if len(plants) != 1 or maneuver.box is not None:
        raise ManeuverError("an initial state is one plant's: where the other plants of a box would begin it does not say")
    if maneuver.robustness and maneuver.robustness != 0:
        raise ManeuverError(
            "an initial state does not go with further zeros: they make what is left flat in a mode's frequency, and what the initial "
            "state would be at another frequency is not known"
        )
    (plant,) = plants
    if len(start) != plant.order:
        raise ManeuverError(f"an initial state has {plant.order} numbers, not {len(start)}")
    if start == at_rest(plant, maneuver.displacement):
        raise ManeuverError("the plant is at its final rest already: there is nothing to move")
    return moments(plant, Basis(plant.poles), start)


def _sampling(plants: Sequence[LinearPlant], maneuver: Maneuver) -> list[str]:
    """What to know of a sample time: modes that are faster than it."""
    step = maneuver.sample_time
    if step is None:
        return []
    if not step > 0:
        raise ManeuverError(f"a sample time is more than 0, not {float(step)!r} s")
    if maneuver.tail:
        raise ManeuverError(
            "an output rest (tail = true) needs an input that decays after the move, not one that is constant over each sample"
        )
    halves = {math.pi / pole.natural_frequency for plant in plants for pole in plant.flexible}
    return [
        f"the sample time of {float(step):.6g} s is longer than half the period of a mode, {half:.6g} s: "
        "the bracket is about such commands all the same, but much is lost by it"
        for half in sorted(halves)
        if step > half
    ]


def _aspects(plant: LinearPlant, zeros: Sequence[Pole], courses: Sequence[Course], rate: tuple[float, float] | None) -> tuple[Aspect, ...]:
    """What else of a tail is limited: the input's slope, and named outputs, about where they come to rest."""
    if not zeros:
        return ()
    slope = [Aspect(None, turning(zeros, sloping), rate[1], -rate[0])] if rate else []
    seen = [
        one for one in courses if plant.numerators[one.name] % plant.numerators[plant.output]
    ]  # not the controlled output's derivatives
    outputs = [
        Aspect(one.name, turning(zeros, partial(passed, plant, one.name)), one.limit - one.final, one.limit + one.final) for one in seen
    ]
    return (*slope, *outputs)


def _boxed(
    plants: Sequence[LinearPlant], maneuver: Maneuver, box: Box, hold: float, courses: Sequence[Course]
) -> tuple[tuple[TargetSet, ...], Residuals]:
    """The target at the origin, which is that of the nominal plant and zero velocity in all, and the residuals of the samples."""
    if len(plants) != 1 or maneuver.tail or maneuver.robustness:
        raise ManeuverError("a box is about one nominal plant's state rest: no tail, no further zeros")
    (plant,) = plants
    rigid = plant.rigid_order
    basis, target = Basis(tuple(pole for pole in plant.poles if pole.is_rigid)), np.zeros(rigid)
    if rigid:
        target[-1] = float(maneuver.displacement) / plant.partial().residues[0][-1].real
    samples, allowed = [], float(box.tolerance * abs(maneuver.displacement))
    for place in box.looked:
        one = box.family.member(place)
        if one.rigid_order != rigid:
            counts = f"{rigid} in the nominal one, {one.rigid_order} {at(place)}"
            raise ManeuverError(f"the plants of a box have the same number of poles at the origin, not {counts}")
        samples.append(Sample.of(place, one, hold, (allowed, allowed)))
        samples += [Sample.of(place, one, hold, (c.limit + c.final, c.limit - c.final), c.name) for c in courses if c.place == place]
    return (TargetSet(basis, target),) if rigid else (), Residuals(tuple(samples), allowed)


def _sensitivities(plant: LinearPlant, maneuver: Maneuver) -> dict[complex, tuple[Fraction, Fraction]]:
    """What is asked of a tail at zeros that may be elsewhere, by their values; raises `ManeuverError` for those that have no tail."""
    asked, named = maneuver.zero_sensitivity, {f"zero[{i}]": zero.value for i, zero in enumerate(plant.zeros, 1)}
    if asked and not maneuver.tail:
        raise ManeuverError("sensitivity to a zero's place is a matter of the tail: it needs an output rest, tail = true")
    without = sorted(name for name in asked if name not in named or named[name].real >= 0)
    if without:
        stable = {name: value for name, value in named.items() if value.real < 0}
        usable = [f"{name} ({value.real:.6g}{f' ± {value.imag:.6g} j' if value.imag else ''})" for name, value in stable.items()]
        raise ManeuverError(f"a tail decays along {', '.join(usable) or 'no zero'} of this plant, not along {', '.join(without)}")
    wrong = [name for name, (shift, residual) in asked.items() if not (shift > 0 and residual >= 0)]
    if wrong:
        raise ManeuverError(f"a shift of {', '.join(wrong)} is more than 0, a residual 0 or more")
    return {named[name]: sensitivity for name, sensitivity in asked.items()}
