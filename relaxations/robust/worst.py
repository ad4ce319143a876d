"""What a command leaves in a box that it was not made for: the least tolerance that the checker proves of it, for every plant of the box.

The command is proposed as the upper side of the robust task, a few of its instants as unknowns; the tolerance begins a hair above the
largest residual that is found in floating point, and is raised until the checker accepts it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Decimal
from fractions import Fraction

import numpy as np

from relaxations import certificates
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem, problem
from relaxations.repair import pivots
from relaxations.robust.residuals import Sample
from relaxations.robust.scans import LASTING
from relaxations.robust.search import worst_places
from relaxations.sides import Side, accepted

ABOVE = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
"""How far above what is found (relative) the tolerance is, tried in turn."""

DIGITS = 7  # of the tolerance, rounded up
LEAST = Fraction(1, 10**9)  # tolerance: a residual that is 0 in the whole box is not told from this
NEAR = 1e-9  # of the range: a level so close to a limit is meant to be on it
RADII = (1e-12, 1e-10, 1e-8)  # of the maneuver time: how far the unknown instants may be from those written


@dataclass(frozen=True, slots=True)
class WorstResidual:
    """No plant of the box keeps more than `tolerance` of the displacement, which `certificate` proves; at least `found` is left somewhere,
    in floating point."""

    tolerance: Fraction
    found: float
    certificate: bytes


def worst_residual(posed: Problem, command: Command) -> WorstResidual | None:
    """Prove what a command of constant pieces leaves in the box of `posed`, whose tolerances do not matter; None if that is not proven.

    Raises `ManeuverError` without a box, and for a command with slopes, a tail or a later start.
    """
    box = posed.maneuver.box
    if box is None:
        raise ManeuverError("what a command leaves in a box needs a box")
    if command.tail.terms or command.start or any(segment.slope for segment in command.segments):
        raise ManeuverError("what a command leaves in a box is told of commands of constant pieces that begin at 0")
    instants = np.array([*(segment.start for segment in command.segments), command.end])
    levels = np.array([segment.level for segment in command.segments]) - posed.rest
    sizes = []
    for place in worst_places(posed, instants, levels, 0.0) or [box.nominal]:
        sample = Sample.of(place, box.family.member(place), posed.hold, (1.0, 1.0))
        moments = sample.table(instants) @ levels - sample.rest
        lasts = all(abs(pole.value.real) <= LASTING * abs(pole.value) for pole in sample.basis.poles)
        # Modes that last add up to the sum of their sizes at last; others are largest at some instant.
        sizes.append(float(np.abs(sample.motions(moments)).sum() if lasts else sample.peaks(moments, 0.0)[1].max()))
    found = max(sizes) / abs(float(posed.maneuver.displacement))
    for above in ABOVE:
        tolerance = max(_rounded_up(found * (1.0 + above)), LEAST)
        asked = problem(posed.plants, replace(posed.maneuver, box=replace(box, tolerance=tolerance, final_tolerance=None, samples=())))
        task = certificates.task(asked)
        for radius in RADII:
            side = Side(Fraction(command.end), _witness(asked, command, radius * command.end))
            if accepted(task, upper=side):
                claim = {"lower": None, "upper": certificates.text(side.claim), "impossible": None}
                return WorstResidual(tolerance, found, certificates.certificate(task, claim, None, side.witness))
    return None


def _rounded_up(value: float) -> Fraction:
    exact = Decimal(value)
    return Fraction(exact.quantize(Decimal(1).scaleb(exact.adjusted() + 1 - DIGITS), ROUND_CEILING)) if value else Fraction(0)


def _witness(posed: Problem, command: Command, radius: float) -> dict[str, object]:
    """The command as written, with as many unknown instants as there are moments at the origin."""
    limits, starts = posed.maneuver.limits, [segment.start for segment in command.segments]
    levels = [_level(segment.level, limits.lower, limits.upper) for segment in command.segments]
    jumps = np.diff([float(level) for level in levels])
    to_go = command.end - np.array(starts[1:])
    columns = np.array([jumps * to_go**k for k in range(posed.size)]).reshape(posed.size, len(jumps))
    free = sorted(int(i) + 1 for i in pivots(columns)[: posed.size]) if posed.size else []
    return certificates.command_witness(command.end, starts, levels, [], [["start", i, 0] for i in free], radius)


def _level(level: float, lower: Fraction, upper: Fraction) -> Fraction:
    """The limit that a level is meant to be on, or the level."""
    return next((limit for limit in (lower, upper) if abs(level - float(limit)) <= NEAR * float(upper - lower)), Fraction(level))
