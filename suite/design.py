"""From a study to the command: the plant, the problem, the bracket of the minimum time, and the command that is verified."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import ROUND_FLOOR
from fractions import Fraction

from fmus import plans
from fmus.errors import FmuError
from fmus.stepping import require_multiples
from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError, PlantError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.onoff.enough import TooLittle, too_little
from relaxations.onoff.held import towards
from relaxations.onoff.weights import Weighted
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.varying import resampled, varying_problem
from suite.cancelled import Cancelled, cancelled
from suite.errors import ABSENT, Mistake, StudyError
from suite.plants import box, nominal_plant
from suite.rounding import outward
from suite.shaped import Shaped, shaped
from suite.starts import required_start
from suite.study import Study
from suite.varying import study_plant
from suite.weighing import status, weighed

KEYS = {"file": "file", "shaper": "shaper", "pole-zero": "delays"}
"""The key of [command] that a kind's command comes from."""


@dataclass(frozen=True, slots=True)
class Design:
    """What a study comes to: the linear plant, the problem it poses, the bracket, and the command (None if none was found).

    `sampled` is where the command comes from if the FMU's step size forces it onto a grid: the bracket of such commands, of `step` [s].
    `weighed` is the least cost, where fuel has a price; `short` the most fuel that is proven to be too little, where the study's budget is.
    """

    plant: LinearPlant
    problem: Problem
    bound: Bound
    command: Command | None
    sampled: Bound | None = None
    step: float | None = None
    shaped: Shaped | None = None
    cancelled: Cancelled | None = None
    weighed: Weighted | None = None
    short: TooLittle | None = None

    @property
    def least(self) -> float | None:
        """What every command needs of fuel, proven, where the study's budget is too little for any."""
        return None if self.short is None else self.short.below

    @property
    def samples(self) -> int | None:
        """How many steps the command on the FMU's grid takes."""
        if self.sampled is None or self.sampled.upper is None or self.step is None:
            return None
        return round(self.sampled.upper / self.step)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know about the command."""
        if self.shaped is not None and self.command is not None:
            return (self._told_of(self.shaped),)
        if self.weighed is not None:
            return (self._told_of_cost(self.weighed),)
        if self.bound.free is not None:
            return (_told_of_form(self.bound),)
        if self.cancelled is not None and self.command is not None:
            return (self._told_of_filter(self.cancelled),)
        if self.sampled is None or self.sampled.upper is None or self.bound.lower <= 0.0:
            return ()
        time, least = self.sampled.upper, round(self.sampled.lower / (self.step or 1.0))
        proven = self.sampled.status is Status.PROVED
        return (
            f"The FMU takes communication steps of {self.step:.9g} s only: the command is one of {self.samples} such samples and takes "
            f"{time:.9g} s, {time - self.bound.lower:.3g} s ({time / self.bound.lower - 1.0:.2%}) more than the lower bound. "
            f"That no command of fewer than {least} samples does is {'proven' if proven else 'computed, not proven'}.",
        )

    def _told_of(self, shaped: Shaped) -> str:
        """That the command is another one than the bracket's."""
        assert self.command is not None
        time, lower = self.command.maneuver_time, self.bound.lower
        more = ""
        if lower > 0.0:
            more = f", {abs(time / lower - 1.0):.2%} {'more' if time >= lower else 'less'} than the lower bound"
            more += "" if time >= lower else ", so it cannot leave the linear plant at rest"
        what = {"step": "a step", "rigid": "the fastest move of the rigid part", "file": "a command file"}[shaped.reference]
        how = f"{shaped.shaping.kind}, following the mode" if shaped.follows else shaped.shaping.kind
        return (
            f"The command is {what}, shaped ({how}); it takes {time:.9g} s{more}. It is measured; proven is what stands "
            "with its shaper, and the bracket, which is about the fastest of all commands."
        )

    def _told_of_cost(self, found: Weighted) -> str:
        """That the command is another one than the bracket's, and what is proven of it."""
        low, high = ("–" if side is None else f"{side:.12g}" for side in (found.lower, found.upper))
        return (
            f"The command is that of the least cost T + {float(found.price):g} · fuel, between {low} and {high} s ({status(found)}, by a "
            "certificate of its own), not the fastest one; the bracket is about the fastest of all commands."
        )

    def _told_of_filter(self, made: Cancelled) -> str:
        """That the command is another one than the bracket's, but for the same task."""
        count, time, lower = len(made.prefilter.delays) - 1, made.prefilter.duration, self.bound.lower
        more = f", {time / lower - 1.0:.2%} more than the lower bound" if lower > 0.0 else ""
        delays = f"{count} delay{'s' * (count > 1)}"
        return (
            f'The command is a step through a pole-zero cancelling filter of {delays}, form "{made.form}"; it takes {time:.9g} s{more}. '
            "It is the shortest of its form that was found; proven is the bracket, of all commands within the limits."
        )


def least_fuel_words(least: float, unit: str) -> str:
    """What every command needs of fuel, in words."""
    return f"every command needs {outward(least, ROUND_FLOOR)} {unit or 'input'}·s or more, however long it takes (proved)"


def _enough_pulses(study: Study, plant: LinearPlant) -> None:
    """Raise `StudyError` where there are fewer pulses than integrators: no command has them, whatever its time."""
    pulses, order = study.limits.pulses, plant.rigid_order
    if pulses is None or pulses >= order or study.maneuver.initial_state is not None or study.plant.schedule is not None:
        return
    why = f"cannot bring a plant with {order} integrators from rest to rest: its input changes sign at least {order - 1} time(s)"
    raise StudyError(str(study.file), [Mistake("limits.pulses", pulses, f"{why}, which takes {order} pulses")])


def _told_of_form(bound: Bound) -> str:
    """What family the bracket is about, and what holding the form costs."""
    about = "The bracket is about commands whose pulses go towards the target first, and then against it (type 1), and no others"
    assert bound.free is not None
    lower, upper = bound.free
    if bound.upper is None or upper is None or not upper > 0.0:
        return f"{about}."
    least, most = max(bound.lower - upper, 0.0), max(bound.upper - lower, 0.0)
    if most <= 1e-9 * upper:
        return f"{about}; the fastest of all commands is one of them, so the form costs nothing."
    span = f"{least:.6g} to {most:.6g} s ({least / upper:.2%} to {most / upper:.2%})"
    return f"{about}; the fastest of all takes {lower:.9g} to {upper:.9g} s, so the form costs {span}."


def _held(study: Study, plant: LinearPlant) -> int:
    """The side ±1 of the first pulses, where the form is held; raises `StudyError` if the plant cannot be moved so."""
    if study.command.type != 1:
        return 0
    try:
        return towards(plant, Fraction(study.maneuver.displacement))
    except ManeuverError as refused:
        efficient = study.command.kind == "fuel-efficient"
        place, value = ("command.kind", study.command.kind) if efficient else ("command.type", 1)
        raise StudyError(str(study.file), [Mistake(place, value, str(refused))]) from None


def pose(study: Study, plant: LinearPlant) -> Problem:
    """The equations and limits that the study asks of `plant`; raises `StudyError` if the maneuver is refused."""
    _enough_pulses(study, plant)
    limits, length, robust = study.limits, study.limits.tail_length, study.command.robustness
    maneuver = Maneuver(
        Fraction(study.maneuver.displacement),
        Limits(
            Fraction(limits.lower),
            Fraction(limits.upper),
            None if limits.fuel is None else Fraction(limits.fuel),
            None if limits.pulse_width is None else Fraction(limits.pulse_width),
            limits.pulses,
            {plant.output if name == study.plant.output else name: Fraction(limit) for name, limit in limits.deflection.items()},
            limits.rate and (Fraction(limits.rate[0]), Fraction(limits.rate[1])),
            _held(study, plant),
        ),
        Fraction(study.plant.initial_input),
        0 if robust == "box" else robust,
        study.command.tail,
        None if length is None else (Fraction(length[0]), Fraction(length[1])),
        {name: (Fraction(shift), Fraction(residual)) for name, (shift, residual) in study.limits.zero_sensitivity.items()},
        box=box(study, plant) if robust == "box" else None,
        sample_time=None if study.limits.sample_time is None else Fraction(study.limits.sample_time),
        initial=required_start(study, plant),
    )
    try:
        varying = study_plant(study)
        return problem([plant], maneuver) if varying is None else varying_problem(varying, maneuver)
    except ManeuverError as refused:
        raise StudyError(str(study.file), [Mistake("maneuver", ABSENT, str(refused))]) from None
    except PlantError as refused:
        raise StudyError(str(study.file), [Mistake("plant.schedule", ABSENT, str(refused))]) from None


def design(study: Study) -> Design:
    """Bracket the study's minimum time and choose the command, begun at `command.start`: the bracket's own, a shaped one, or a file's."""
    plant = nominal_plant(study)
    posed = pose(study, plant)
    bound = minimum_time(posed)
    asked = study.command.shaper
    made = None if asked is None or bound.status is Status.IMPOSSIBLE else shaped(study, asked, plant, posed)
    filtered = None
    if study.command.cancelling is not None and bound.status is not Status.IMPOSSIBLE:
        filtered = cancelled(study, study.command.cancelling, plant, posed)
    alpha, found = study.command.alpha, None
    if alpha is not None and bound.status is not Status.IMPOSSIBLE:
        found = weighed(study, posed, Fraction(alpha))
    short = too_little(posed) if bound.status is Status.IMPOSSIBLE else None
    own = made or filtered or found
    command = own.command if own is not None else study.command.given or bound.command
    if command is not None and study.command.start:
        if not command.segments:
            why = "the command is a tail alone, without a segment whose start could be shifted; leave it out"
            raise StudyError(str(study.file), [Mistake("command.start", study.command.start, why)])
        command = command.shifted(float(study.command.start))
    return Design(plant, posed, bound, command, shaped=made, cancelled=filtered, weighed=found, short=short)


def grid_step(study: Study) -> float | None:
    """The step [s] that all communication points are multiples of; None if the FMU takes any steps.

    Raises `StudyError` if the study's own step does not fit, or nobody names one.
    """
    fmu, asked = study.plant.fmu, study.simulation.step
    if fmu is None:
        return None
    try:
        return plans.grid_step(fmu.archive.description, study.simulation.interface, asked)
    except plans.Misfit as problem:
        value = ABSENT if asked is None else asked
        raise StudyError(str(study.file), [Mistake("simulation.step", value, f"does not suit the FMU: {problem}")]) from None


def on_grid(study: Study, made: Design) -> Design:
    """The design that the FMU can follow: where it takes steps of one size only, the fastest command on that grid, found before any run.

    Raises `StudyError` if there is none, or if the command that was given is not on the grid.
    """
    step, asked = grid_step(study), study.limits.sample_time
    if step is None or made.command is None:
        return made
    if asked is not None:
        samples = Fraction(asked) / Fraction(repr(step))
        if samples.denominator != 1:
            why = f"is no multiple of the FMU's communication step, {step!r} s, and it takes steps of that size only"
            raise StudyError(str(study.file), [Mistake("limits.sample_time", asked, why)])
    given = study.command.kind in KEYS
    try:
        if study.command.start:
            require_multiples([float(study.command.start)], step)
        if given or asked is not None:
            require_multiples(made.command.breakpoints, step)
            return made
    except FmuError as trouble:
        place = f"command.{KEYS[study.command.kind]}" if given else "command.start"
        why = f"the FMU takes communication steps of one size only, but {trouble}"
        raise StudyError(str(study.file), [Mistake(place, ABSENT, why)]) from None
    if made.weighed is not None:
        why = f"the FMU takes communication steps of {step!r} s only: the least cost of commands on samples is not known"
        raise StudyError(str(study.file), [Mistake("command.alpha", study.command.alpha, why)])
    try:
        grid = Fraction(repr(step))
        varies = made.problem.transition is not None
        posed = resampled(made.problem, grid) if varies else problem([made.plant], replace(made.problem.maneuver, sample_time=grid))
        sampled = minimum_time(posed)
    except ManeuverError as refused:
        why = f"the FMU takes communication steps of {step!r} s only: {refused}"
        raise StudyError(str(study.file), [Mistake("command", ABSENT, why)]) from None
    if sampled.command is None:
        why = f"the FMU takes communication steps of {step!r} s only: {sampled.reason or sampled.status.value}"
        raise StudyError(str(study.file), [Mistake("command", ABSENT, why)])
    return replace(made, command=sampled.command.shifted(float(study.command.start)), sampled=sampled, step=step)
