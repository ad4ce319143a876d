"""`slewcert timing`: what a study's command leaves if its instants are not quite kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations import timing
from relaxations.commands import Command
from relaxations.errors import CommandError
from relaxations.timing import Event, Motion
from relaxations.timing_worst import TIGHT, Worst, worst
from suite.design import design, on_grid
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.study import Study

Reals = NDArray[np.float64]

MOST_SAMPLES = 1_000_000
CLOSE = 1e-3  # relative: how closely the largest error that keeps a requirement is told
TAIL = 4.0  # standard deviations of jitter that must fit into half the shortest pulse


class TimingError(SuiteError):
    """Timing errors of which nothing can be said."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Thrusters open `on` and close `off` late; besides, instants err by at most `within`, and by `jitter` (standard deviation); all [s].

    `together`: one actuator makes every jump. `samples` draws of the jitter, from `seed`.
    """

    on: float = 0.0
    off: float = 0.0
    jitter: float = 0.0
    within: float = 0.0
    together: bool = False
    samples: int = 10_000
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Left:
    """What may be left of one motion, in the output's unit over second^`motion.unit`; amplitudes of flexible modes, else with sign.

    `planned` by the command as it is, `delayed` with the delays, `slopes` (n,) the derivatives of z there by each instant, `rms` and
    `drawn` (m,) under jitter, `worst` of bounded errors; None where they were not asked for.
    """

    motion: Motion
    planned: float
    delayed: float
    slopes: NDArray[np.complex128]
    rms: float | None
    drawn: Reals | None
    worst: Worst | None

    @property
    def per_second(self) -> float:
        """Root mean square for each second of jitter, to first order, of what jitter alone would leave."""
        return float(self.motion.factor * np.sqrt(np.sum(np.abs(self.slopes) ** 2)))

    @property
    def percentiles(self) -> dict[str, float]:
        """Of the sizes that were drawn: root mean square, what 95 % are below, and the largest; empty without jitter."""
        if self.drawn is None:
            return {}
        sizes = np.abs(self.drawn)
        return {"sampled_rms": float(np.sqrt(np.mean(sizes**2))), "p95": float(np.quantile(sizes, 0.95)), "largest": float(sizes.max())}

    def to_dict(self) -> dict[str, Any]:
        """A motion of `timing --json`."""
        record: dict[str, Any] = {
            "name": self.motion.name,
            "per_second_to_the": self.motion.unit,
            "planned": self.planned,
            "delayed": self.delayed,
            "derivatives": [[z.real * self.motion.factor, z.imag * self.motion.factor] for z in self.slopes.tolist()],
            "jitter": None,
            "worst": None,
        }
        if self.rms is not None:
            record["jitter"] = {"rms": self.rms, **self.percentiles}
        if self.worst is not None:
            record["worst"] = {"attained": self.worst.attained, "bound": self.worst.bound, "errors": self.worst.errors.tolist()}
        return record


@dataclass(frozen=True)
class Timing:
    """Everything asked of one study: the events as they happen, what is left of each motion, and notes."""

    study: Study
    asked: Asked
    command: Command
    planned: tuple[Event, ...]
    happening: tuple[Event, ...]
    left: tuple[Left, ...]
    notes: tuple[str, ...]

    @property
    def scale(self) -> float:
        """|Δ| in the output's unit."""
        return abs(float(self.study.maneuver.displacement))

    @property
    def flexible(self) -> tuple[Left, ...]:
        """The flexible modes."""
        return tuple(one for one in self.left if one.motion.flexible)

    @property
    def limit(self) -> tuple[str, float] | None:
        """The strictest requirement on the residual vibration: its id, and its limit as a fraction of the move."""
        found = [(r.maximum, r.id) for r in self.study.requirements if r.quantity.name == "residual_vibration" and r.maximum is not None]
        return (min(found)[1], min(found)[0]) if found else None

    def swinging(self, within: float) -> tuple[float, float]:
        """The flexible modes together after errors of at most `within` [s]: (attained by one of them alone, proven sum), of the move."""
        found = [worst(one.motion, self.happening, self.command.end, within) for one in self.flexible]
        return max((w.attained for w in found), default=0.0) / self.scale, math.fsum(w.bound for w in found) / self.scale

    @property
    def together(self) -> float | None:
        """The same bound for the errors that were asked about; None without modes or such errors."""
        bounds = [one.worst.bound for one in self.flexible if one.worst is not None]
        return math.fsum(bounds) / self.scale if bounds else None

    @property
    def most(self) -> float:
        """The largest error [s] for which the events keep their order."""
        free = timing.room(self.happening) / 2 * (1 - 1e-9)
        return free if math.isfinite(free) else self.command.maneuver_time / 2

    def ordered(self, error: float) -> bool:
        """Whether an error [s] is the largest that is looked at."""
        return error >= self.most

    @cached_property
    def allowed(self) -> float | None:
        """The largest error [s], to a thousandth, for which the modes together are proven to keep `limit`; 0 if they never do.

        At most `most`; None without such a requirement or without modes.
        """
        if self.limit is None or not self.flexible:
            return None
        low, high = 0.0, self.most
        if self.swinging(low)[1] > self.limit[1]:
            return 0.0
        if self.swinging(high)[1] <= self.limit[1]:
            return high
        guess = high
        while high - low > CLOSE * high:  # the bound is nearly proportional to the error: guess by that, and halve where it is not
            value = self.swinging(guess)[1]
            low, high = (guess, high) if value <= self.limit[1] else (low, guess)
            near = guess * self.limit[1] / value * (1 - CLOSE / 4) if value else high
            guess = near if low < near < high * (1 - CLOSE / 8) else (low + high) / 2
        return low

    def to_dict(self) -> dict[str, Any]:
        """The object of `timing --json` (docs/schemas.md)."""
        asked, limit = self.asked, self.limit
        return {
            "study": str(self.study.file),
            "maneuver_time": self.command.maneuver_time,
            "output": {"name": self.study.plant.output, "unit": self.study.plant.output_unit},
            "displacement": float(self.study.maneuver.displacement),
            "asked": {
                "on_delay": asked.on,
                "off_delay": asked.off,
                "jitter": asked.jitter,
                "within": asked.within,
                "reversals": "together" if asked.together else "apart",
                "samples": asked.samples,
                "seed": asked.seed,
            },
            "events": [
                {"instant": event.instant, "happens": late.instant, "jump": event.jump, "opens": event.opens}
                for event, late in zip(self.planned, self.happening, strict=True)
            ],
            "motions": [one.to_dict() for one in self.left],
            "modes_together": self.together,
            "allowed": None if limit is None else {"requirement": limit[0], "residual_vibration": limit[1], "within": self.allowed},
            "notes": list(self.notes),
        }


def study_timing(study: Study, asked: Asked) -> Timing:
    """Design the study's command and look at its instants; raises `StudyError`, `TimingError`."""
    if asked.together and asked.on != asked.off:
        raise TimingError(
            f"--on-delay {asked.on:g} --off-delay {asked.off:g}: with --reversals together one actuator makes every jump, and has one delay"
        )
    if study.maneuver.initial_state is not None:
        why = "the move begins elsewhere than at rest: what its timing leaves is not looked at"
        raise StudyError(str(study.file), [Mistake("maneuver.initial_state", ABSENT, why)])
    if study.plant.schedule is not None:
        why = "varies while it moves, and has no modes that timing could leave"
        raise StudyError(str(study.file), [Mistake("plant.schedule", ABSENT, why)])
    made = on_grid(study, design(study))
    if made.command is None:
        raise StudyError(str(study.file), [Mistake("command", ABSENT, f"there is none: {made.bound.reason or made.bound.status.value}")])
    command, rest = made.command, float(study.plant.initial_input)
    try:
        planned = timing.events(command, rest, together=asked.together)
        _require_sense(command, asked)
        happening, notes = timing.delayed(planned, asked.on, asked.off)
    except CommandError as refused:
        raise StudyError(str(study.file), [Mistake("command", ABSENT, str(refused))]) from None
    if not asked.together and all(event.opens is not None for event in happening) and not timing.pulses_left(happening):
        raise TimingError(
            f"--on-delay {asked.on:g} --off-delay {asked.off:g}: no pulse opens at all, since each is shorter than these delays differ: "
            "the plant stays at rest, and there is no timing to look at"
        )
    motions = timing.motions(made.plant, float(study.maneuver.displacement))
    if growing := [motion.name for motion in motions if motion.flexible and len(motion.coefficients) > 1]:
        why = f"{growing[0]} is a repeated pole: what it leaves may grow after the move, and timing is about simple flexible modes"
        raise StudyError(str(study.file), [Mistake("plant", ABSENT, why)])
    _require_room(happening, asked)
    errors = np.random.default_rng(asked.seed).normal(0.0, asked.jitter, (asked.samples, len(happening))) if asked.jitter else None
    found = [
        Left(
            motion,
            float(motion.size(np.array(timing.left(motion, planned, command.end)))),
            float(motion.size(np.array(timing.left(motion, happening, command.end)))),
            timing.derivatives(motion, happening, command.end),
            timing.root_mean_square(motion, happening, command.end, asked.jitter) if asked.jitter else None,
            None if errors is None else timing.sampled(motion, happening, command.end, errors),
            worst(motion, happening, command.end, asked.within) if asked.within else None,
        )
        for motion in motions
    ]
    more = [
        f"of {one.motion.name} the worst is told to {one.worst.bound / one.worst.attained - 1:.1%} only"
        for one in found
        if one.worst is not None and 0.0 < one.worst.attained < one.worst.bound / (1 + 2 * TIGHT)
    ]
    return Timing(study, asked, command, planned, happening, tuple(found), (*notes, *more))


def _require_sense(command: Command, asked: Asked) -> None:
    """Delays last no longer than the command."""
    longest = command.maneuver_time
    for option, delay in (("--on-delay", asked.on), ("--off-delay", asked.off)):
        if delay > longest:
            raise TimingError(f"{option} {delay:g}: a delay lasts no longer than the command, which takes {longest:.6g} s")


def _require_room(happening: Sequence[Event], asked: Asked) -> None:
    """Events of one thruster keep their order, else a sum over jumps is no command."""
    free = timing.room(happening)
    told = f"the shortest pulse or pause lasts {free:.6g} s, so that events would change their order"
    if asked.within and 2 * asked.within > free:
        raise TimingError(f"--within {asked.within:g}: {told}; at most {free / 2:.6g} s are looked at")
    if asked.jitter and 2 * TAIL * asked.jitter > free:
        raise TimingError(
            f"--jitter {asked.jitter:g}: {told}; at most {free / (2 * TAIL):.6g} s are looked at, {TAIL:g} of which are half of that"
        )
