"""The command of a study with a pole-zero cancelling filter: a step of the reference, filtered, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from relaxations.cancelling.answers import residual, zero_sensitivities
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling
from relaxations.cancelling.structures import Bounds
from relaxations.commands import Command
from relaxations.errors import ImpossibleShaperError, ManeuverError, PlantError, RelaxationsError
from relaxations.maneuvers import Problem
from relaxations.plants import LinearPlant
from relaxations.response import response
from suite.errors import ABSENT, Mistake, StudyError
from suite.study import CancellingRequest, Study

ROUNDING = 1e-9  # of a limit
LASTING, LOOKS = 20.0, 4001  # time constants after the move that outputs are looked at for, and instants, during it and in all


@dataclass(frozen=True, slots=True)
class Cancelled:
    """The filter, its form, and the command that it makes of the displacement.

    `residual`: the largest |G_f| at a pole that it cancels, of the sum of its gains' sizes: rounding.
    """

    prefilter: Prefilter
    form: str
    command: Command
    residual: float

    def to_dict(self) -> dict[str, Any]:
        """The object `prefilter` of `bound --json` and of an evidence folder's results (docs/schemas.md)."""
        return {
            **self.prefilter.to_dict(),
            "form": self.form,
            "duration": self.prefilter.duration,
            "gain": self.prefilter.gain,
            "poles": [[pole.real, pole.imag] for pole in self.prefilter.poles],
            "residual": self.residual,
        }


def request_of(study: Study, asked: CancellingRequest, plant: LinearPlant) -> Request:
    """What a study asks of a filter, for a displacement of 1; raises `StudyError`."""
    displacement, limits, rest = float(study.maneuver.displacement), study.limits, float(study.plant.initial_input)

    def scaled(pair: tuple[float, float], shift: float = 0.0) -> tuple[float, float]:
        low, high = sorted((end - shift) / displacement for end in pair)
        return low, high

    length = None
    if limits.tail_length is not None:
        final = rest + float(plant.rest_input(Fraction(study.maneuver.displacement)))
        near = min(float(limits.upper) - final, final - float(limits.lower)) / abs(displacement)
        length = float(limits.tail_length[0]), float(limits.tail_length[1]) * near
    bounds = Bounds(
        None if asked.gains is None else scaled(asked.gains),
        scaled((float(limits.lower), float(limits.upper)), rest),
        asked.monotone,
        length,
    )
    zeros = None
    if asked.zeros is not None:
        beyond = [number for number in asked.zeros if not 1 <= number <= len(plant.zeros)]
        if beyond:
            raise _refused(study, "zeros", f"zero[{beyond[0]}] does not exist: the plant has {len(plant.zeros)} distinct zeros")
        chosen = [plant.zeros[number - 1] for number in asked.zeros]
        zeros = tuple(zero.value for zero in chosen for _ in range(zero.multiplicity))
    sample_time = asked.sample_time
    if sample_time is None and limits.sample_time is not None:
        sample_time = float(limits.sample_time)
    robustness = study.command.robustness
    assert robustness != "box"
    return Request(asked.delays, asked.form, robustness, zeros, bounds, asked.instants, sample_time)


def cancelled(study: Study, asked: CancellingRequest, plant: LinearPlant, posed: Problem) -> Cancelled:
    """The study's filtered command, begun at once; raises `StudyError` where there is none, `ImpossibleShaperError` if none was found."""
    rest = float(study.plant.initial_input)
    request = request_of(study, asked, plant)
    try:
        prefilter = cancelling(plant, request)
    except ImpossibleShaperError:
        raise
    except (PlantError, ManeuverError) as problem:
        raise _refused(study, "zeros" if asked.zeros else "kind", str(problem)) from None
    except RelaxationsError as problem:
        raise _refused(study, "delays", str(problem), asked.delays) from None
    displacement = Fraction(study.maneuver.displacement)
    try:
        command = prefilter.command(float(displacement), rest, float(plant.rest_input(displacement)))
    except RelaxationsError:
        why = "poles before the last delay let the input decay while it goes on stepping, which a command file cannot hold"
        raise _refused(study, "form", f'{why}; the filter itself can: slewcert prefilter STUDY. Valid here is "last"', asked.form) from None
    _within(study, plant, posed, prefilter, command)
    return Cancelled(prefilter, asked.form, command, residual(request.structure(plant).conditions, prefilter))


def _within(study: Study, plant: LinearPlant, posed: Problem, prefilter: Prefilter, command: Command) -> None:
    """The limits that the filter's equations do not know: fuel, outputs, and what a tail does if a zero is elsewhere."""
    budget, rest = study.limits.fuel, float(study.plant.initial_input)
    if budget is not None and (fuel := command.fuel(rest)) > float(budget) * (1.0 + ROUNDING):
        raise _refused(study, "delays", f"the filtered command uses {fuel:.10g} of fuel, more than limits.fuel, {budget}")
    left = zero_sensitivities(plant, prefilter)
    for name, (shift, most) in study.limits.zero_sensitivity.items():
        if (found := float(shift) * left.get(name, 0.0)) > float(most) * (1.0 + ROUNDING):
            why = f"{name} elsewhere by {shift} of its magnitude moves the output by {found:.6g} of the displacement, more than {most}"
            raise _refused(study, "delays", f"{why} (limits.zero_sensitivity); more delays leave room for a smaller tail")
    if posed.courses:
        slowest = max((1.0 / abs(root.value) for root in (*plant.poles, *plant.zeros) if root.value), default=1.0)
        times = np.union1d(np.linspace(0.0, command.end + LASTING * slowest, LOOKS), np.linspace(0.0, command.end, LOOKS))
        for course in posed.courses:
            largest = float(np.abs(response(plant, command, times, course.name, rest)).max())
            if largest > course.limit * (1.0 + ROUNDING):
                why = f"under the filtered command {course.name} strays by {largest:.6g}, more than limits.deflection, {course.limit:.6g}"
                raise _refused(study, "delays", f"{why}; more delays, or narrower limits.input, make it gentler")


def _refused(study: Study, key: str, why: str, value: object = ABSENT) -> StudyError:
    return StudyError(str(study.file), [Mistake(f"command.{key}", value, why)])
