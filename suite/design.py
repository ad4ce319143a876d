"""From a study to the command: the plant, the problem, the bracket of the minimum time, and the command that is verified."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from suite.errors import ABSENT, Mistake, StudyError
from suite.plants import nominal_plant
from suite.study import Study


@dataclass(frozen=True, slots=True)
class Design:
    """What a study comes to: the linear plant, the problem it poses, the bracket, and the command (None if none was found)."""

    plant: LinearPlant
    problem: Problem
    bound: Bound
    command: Command | None


def pose(study: Study, plant: LinearPlant) -> Problem:
    """The equations and limits that the study asks of `plant`; raises `StudyError` if the maneuver is refused."""
    length = study.limits.tail_length
    maneuver = Maneuver(
        Fraction(study.maneuver.displacement),
        Limits(Fraction(study.limits.lower), Fraction(study.limits.upper)),
        Fraction(study.plant.initial_input),
        study.command.robustness,
        study.command.tail,
        None if length is None else (Fraction(length[0]), Fraction(length[1])),
        {name: (Fraction(shift), Fraction(residual)) for name, (shift, residual) in study.limits.zero_sensitivity.items()},
    )
    try:
        return problem([plant], maneuver)
    except ManeuverError as refused:
        raise StudyError(str(study.file), [Mistake("maneuver", ABSENT, str(refused))]) from None


def design(study: Study) -> Design:
    """Bracket the study's minimum time and choose the command: the bracket's own, or the one given as a file; begun at `command.start`."""
    plant = nominal_plant(study)
    posed = pose(study, plant)
    bound = minimum_time(posed)
    command = study.command.given or bound.command
    if command is not None and study.command.start:
        if not command.segments:
            why = "the command is a tail alone, without a segment whose start could be shifted; leave it out"
            raise StudyError(str(study.file), [Mistake("command.start", study.command.start, why)])
        command = command.shifted(float(study.command.start))
    return Design(plant, posed, bound, command)


def bound_record(bound: Bound, command: Command | None, rest: float, certificate: str | None = None) -> dict[str, object]:
    """The object that `slewcert bound --json` prints (docs/schemas.md); `rest` is the input at the initial rest."""
    impossible = bound.status is Status.IMPOSSIBLE
    found = {
        "status": bound.status.name.lower(),
        "maneuver_time": None if impossible else {"lower": bound.lower, "upper": bound.upper},
        "command": None if command is None else command.to_dict(),
        "switches": bound.switches,
        "fuel": None if command is None else command.fuel(rest),
        "certificate": certificate,
        "seconds": round(bound.seconds, 6),
    }
    return found if bound.reason is None else {**found, "reason": bound.reason}
