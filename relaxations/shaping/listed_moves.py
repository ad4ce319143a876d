"""A move for bands of different tolerances as one task: a list of plants of all bands, each weighted by what its own tolerance allows.

A machine that may swing by V_j |Δ|, its output multiplied by V_1/V_j, may swing by V_1 |Δ|; where that output comes to rest is no matter
of a box. So plants of all bands, however different their tolerances, are one list with one tolerance, which the checker knows. What no
command does for the list none does for the bands. The plants in which the list's command swings by more than they allow are added to it,
until there are none; that the command then keeps every band is proven over the whole of each.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from relaxations import certificates
from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError, ShaperError, SolverError
from relaxations.maneuvers import Problem, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Axis, Box, Listed, Place
from relaxations.robust.search import worst_places
from relaxations.robust.worst import worst_residual
from relaxations.shaping.bands import Band
from relaxations.shaping.moves import Move, family, left_over

FIRST = 7  # places of each band at first
ROUNDS = 10  # of adding plants
GRAIN = 10**9  # of a factor of the frequency: places are decimals
TIGHTER = (Fraction(1, 10**5), Fraction(1, 10**4))  # of the tolerances: what a command is designed below them, where it does not keep them
CLOSE = 1e-3  # relative: a bracket that is wider is not called proven


@dataclass(frozen=True, slots=True)
class OfPlants:
    """`bound`: the bracket, the upper side proven over all bands, with the certificate of the list; `plants`: how many it holds."""

    bound: Bound
    plants: int


def within_all(move: Move, bands: Sequence[Band]) -> OfPlants | None:
    """The fastest command that keeps every band within its own tolerance, with its proof; None if either side was not proven.

    Each band is about a machine with that mode alone, at the mode's damping.
    """
    own = [_of_band(move, band) for band in bands]
    places = [
        {_inside(posed, factor) for factor in np.linspace(band.low, band.high, FIRST)} for band, posed in zip(bands, own, strict=True)
    ]
    try:
        for _ in range(ROUNDS):
            found = minimum_time(_of_list(move, bands, own, places, Fraction(0)))
            if found.command is None or not _claims(found):
                return None
            more = [_beyond(posed, found.command) for posed in own]
            if not any(new - known for new, known in zip(more, places, strict=True)):
                break
            for known, new in zip(places, more, strict=True):
                known |= new
        else:
            return None
        kept = found if _keeps(move, bands, own, found.command) else None
        for less in TIGHTER if kept is None else ():
            tight = minimum_time(_of_list(move, bands, own, places, less))
            if tight.command is not None and _claims(tight) and _keeps(move, bands, own, tight.command):
                kept = tight
                break
    except (SolverError, ManeuverError, ShaperError):
        return None
    if kept is None or kept.upper is None:
        return None
    whole = found if kept is found else _joined(found, kept)
    wide = kept.upper > found.lower * (1.0 + CLOSE)
    reason = "the command is not proven to be as fast as the list of plants allows" if wide else None
    status = Status.BRACKETED if wide else Status.PROVED
    return OfPlants(replace(whole, status=status, reason=reason), sum(map(len, places)))


def _of_band(move: Move, band: Band) -> Problem:
    """One band alone, within its tolerance."""
    low, high = exact(repr(band.low)), exact(repr(band.high))
    axis = Axis("mode[1].frequency", min(max(Fraction(1), low), high), low, high)
    box = Box((axis,), family([band.mode], move.order), exact(repr(band.tolerance)))
    return problem([box.family.member(box.nominal)], move.maneuver(0, box))


def _of_list(move: Move, bands: Sequence[Band], own: Sequence[Problem], places: Sequence[set[Fraction]], less: Fraction) -> Problem:
    """The plants at all places, with tolerances that are `less` (relative) than asked."""
    first, plants = exact(repr(bands[0].tolerance)), dict[Place, LinearPlant]()
    for band, posed, where in zip(bands, own, places, strict=True):
        box = posed.maneuver.box
        assert box is not None
        weight = first / exact(repr(band.tolerance))
        for factor in sorted(where):
            above, below = box.family.written((factor,))
            place = exact(repr(band.mode.frequency)) * factor, exact(repr(band.mode.damping)), weight
            plants[place] = LinearPlant.from_transfer([weight * c for c in above], below)
    (nominal, plant), sides = next(iter(plants.items())), list(zip(*plants, strict=True))
    names = "frequency", "damping", "weight"
    axes = [Axis(name, at, min(side), max(side)) for name, at, side in zip(names, nominal, sides, strict=True)]
    return problem([plant], move.maneuver(0, Box(tuple(axes), Listed(tuple(plants.items())), first * (1 - less))))


def _beyond(posed: Problem, command: Command) -> set[Fraction]:
    """Where in its band a command swings by more than is allowed."""
    instants = np.array([*(segment.start for segment in command.segments), command.end])
    levels = np.array([segment.level for segment in command.segments]) - posed.rest
    return {_inside(posed, float(factor)) for (factor,) in worst_places(posed, instants, levels, 1.0)}


def _keeps(move: Move, bands: Sequence[Band], own: Sequence[Problem], command: Command) -> bool:
    """Whether it is *proven* to keep every band: by the envelope of what is left, or by its course."""
    for band, posed in zip(bands, own, strict=True):
        if left_over(move, command, [band], None)[1] > band.tolerance:
            left = worst_residual(posed, command)
            if left is None or left.tolerance > exact(repr(band.tolerance)):
                return False
    return True


def _joined(lower: Bound, upper: Bound) -> Bound:
    """The certificate of both: what keeps smaller tolerances keeps larger ones."""
    assert lower.certificate is not None
    assert upper.certificate is not None
    one, other = json.loads(lower.certificate), json.loads(upper.certificate)
    claim = {**one["claim"], "upper": other["claim"]["upper"]}
    whole = certificates.certificate(one["task"], claim, one["lower"], other["upper"])
    return replace(upper, lower=lower.lower, certificate=whole)


def _claims(bound: Bound) -> bool:
    """Whether its certificate claims both sides."""
    claim = json.loads(bound.certificate)["claim"] if bound.certificate is not None else {}
    return None not in (claim.get("lower"), claim.get("upper"))


def _inside(posed: Problem, factor: float) -> Fraction:
    """A decimal that is no farther out than the band."""
    box = posed.maneuver.box
    assert box is not None
    (axis,) = box.axes
    return min(max(Fraction(round(factor * GRAIN), GRAIN), axis.low), axis.high)
