"""The minimum time of a plant that varies along a known schedule: its problem, and the bracket proven.

Seen from the beginning of the move (`relaxations.transitions`, equation 1') the problem is an ordinary one in which t stands where time to
go does: the same programs, refinement and polishing. Their commands come out backwards and are turned around here.

Waiting at the end is free, for the final rest is one at every instant; waiting at the beginning is not. So a time that is refuted refutes
all shorter ones, as ever.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from relaxations import certificates, programs
from relaxations.bounds import Bound, Settings, bracket, contacts, cut, instants
from relaxations.commands import Command, Segment, Tail
from relaxations.energy import LONGER, energy_time
from relaxations.errors import ManeuverError, SolverError
from relaxations.maneuvers import Maneuver, Problem, TargetSet
from relaxations.moments import Basis
from relaxations.polishing import Polished, polish
from relaxations.prices import Prices
from relaxations.refinement import Extremal, outline
from relaxations.repair import pivots, repair
from relaxations.sides import RADII, Proof, Side, accepted, closing, lower_side, rounded
from relaxations.tails import TailSpace
from relaxations.transitions import Transition, VaryingPlant

Reals = NDArray[np.float64]

BEYOND = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""How far beyond the minimum time (relative) a repaired command may go."""

FINEST = 16  # times the grid's density that are tried at most

ENOUGH, GOOD = 1e-12, 1e-7
"""Gaps at which the search ends: of a regular optimum; on finer grids."""

FARTHEST = 1e4  # times the plant's own time scale, or the schedule's length


def varying_problem(plant: VaryingPlant, maneuver: Maneuver) -> Problem:
    """The equations and limits of a maneuver of a varying plant; input deviations count from the final rest, in either direction of time.

    Raises `ManeuverError` if there is nothing to move, for limits that this kind of plant is not proven with, and if they exclude the
    input at either rest; `PlantError` without a rest that lasts.
    """
    limits = maneuver.limits
    refused = {
        "an output rest (tail)": maneuver.tail or maneuver.tail_length is not None or bool(maneuver.zero_sensitivity),
        "a box": maneuver.box is not None,
        "further zeros (robustness)": bool(maneuver.robustness),
        "a sample time": maneuver.sample_time is not None,
        "an initial state": maneuver.initial is not None,
        "limits on outputs (deflection)": bool(limits.deflection),
        "limits of the slope (rate)": limits.rate is not None,
        "limits of pulses": limits.pulsed,
    }
    if any(refused.values()):
        asked = ", ".join(name for name, given in refused.items() if given)
        raise ManeuverError(f"a plant that varies is moved from rest to rest within limits of its input and its fuel: not with {asked}")
    if maneuver.displacement == 0:
        raise ManeuverError("the displacement is 0: there is nothing to move")
    state, held = plant.rest(maneuver.displacement)
    final = maneuver.rest + held
    for where, value in (("initial", maneuver.rest), ("final", final)):
        if not limits.lower <= value <= limits.upper:
            raise ManeuverError(
                f"the input at the {where} rest is {float(value)!r}, outside the limits [{float(limits.lower)!r}, "
                f"{float(limits.upper)!r}]: the plant could not stay at rest there"
            )
    if limits.fuel is not None and (held != 0 or not limits.fuel > 0):
        raise ManeuverError("a fuel budget is more than 0, and belongs to a plant that rests without input")
    transition = Transition(plant)
    lower, upper = float(limits.lower - final), float(limits.upper - final)
    return Problem(
        lower,
        upper,
        0.0,
        (TargetSet(cast("Basis", transition), np.array([float(x) for x in state])),),  # it has what a grid's program asks of a basis
        (plant.final,),
        replace(maneuver, rest=final),
        TailSpace((), np.zeros((plant.order, 0)), upper, -lower),
        float(final),
        None if limits.fuel is None else float(limits.fuel),
        notes=plant.final.notes,
        transition=transition,
    )


def varying_time(problem: Problem, task: dict[str, Any], settings: Settings, near: float | None, begun: float) -> Bound:
    """Bracket the least maneuver time and prove both sides where that is possible; `near` is a guess at it [s]."""
    if problem.fuel is not None:
        with suppress(SolverError):
            free = bracket(problem.eased, settings, near or _guess(problem, settings))
            if free.command is not None and free.command.fuel(problem.rest) <= problem.fuel:  # enough: the proof is of the whole task
                return varying_time(problem.eased, task, settings, free.upper, begun)

    def look(finer: Settings, near: float | None) -> Bound:
        looked = bracket(problem, finer, near or _guess(problem, settings))
        return replace(looked, command=None if looked.command is None else turned(looked.command))

    def enough(factor: int, proof: Proof) -> bool:
        return proof.gap <= ENOUGH or factor >= FINEST or (factor > 1 and proof.gap <= GOOD)

    return closing(problem, task, settings, look, lambda looked, finer: _prove(problem, task, looked, finer), enough, near, begun)


def _guess(problem: Problem, settings: Settings) -> float:
    """A little more than what the command's energy alone needs [s]."""
    assert problem.transition is not None
    plant = problem.transition.plant
    pace = plant.pace or 1.0 / float(plant.instants[-1] or 1)
    scale = max(1.0 / pace, float(plant.instants[-1]))
    return LONGER * energy_time(problem, lambda horizon: instants(problem, horizon, settings), 1.0 / pace, FARTHEST * scale) or scale


def turned(command: Command) -> Command:
    """A command backwards in time."""
    starts, end = [segment.start for segment in command.segments], command.end
    if not starts:
        return command
    ends = [*starts[1:], end]
    pieces = reversed([(end - after, segment.level) for segment, after in zip(command.segments, ends, strict=True)])
    return Command(command.maneuver_time, tuple(Segment(start, level) for start, level in pieces), command.tail)


def _prove(problem: Problem, task: dict[str, Any], found: Bound, settings: Settings) -> Proof:
    """Both sides of one bracket: of the extremal if there is one, else of the grid."""
    proof, extremal = Proof(), found.dual
    if isinstance(extremal, programs.GridSolution) and found.upper is not None:
        extremal = outline(problem, extremal.costate, extremal.maneuver_time, contacts(problem, extremal), extremal.fuel)
    if isinstance(extremal, Extremal) and (polished := polish(problem, extremal)) is not None:
        proof = _regular(problem, task, extremal, polished)
    if isinstance(found.dual, Extremal) and proof.upper is None:
        dual = found.dual
        proof = proof.better(_upper(problem, task, dual.exact_levels, [0.0, *dual.switches_to_go], dual.maneuver_time, 1e-14))
    above: programs.GridSolution | None = None
    if proof.upper is None and found.upper is not None:
        for beyond in BEYOND:
            try:
                above = cut(problem, instants(problem, found.upper * (1.0 + beyond), settings), beyond / 4.0)
            except SolverError:
                continue
            if (landed := _landed(problem, task, above)) is not None:
                proof = proof.better(landed)
                break
    if proof.lower is None:
        for dual in (found.dual, above):
            if dual is not None:
                near = dual.maneuver_time if found.upper is None else found.upper
                proof = proof.better(Proof(lower_side(problem, task, dual, near)))
    return proof


def _regular(problem: Problem, task: dict[str, Any], extremal: Extremal, polished: Polished) -> Proof:
    """Both sides of a regular optimum, claimed a double below and a double above the duration."""
    middle = float(polished.maneuver_time)
    witness = certificates.costate_witness(problem, polished.costate, (), Prices(polished.fuel))
    lower: Side | None = Side(Fraction(float(np.nextafter(middle, 0.0))), witness)
    lower = lower if lower and accepted(task, lower=lower) else None
    starts = [Fraction(0), *(polished.maneuver_time - start for start in reversed(polished.starts[1:]))]
    upper = _upper(problem, task, extremal.exact_levels, starts, polished.maneuver_time, None)
    return replace(upper, lower=lower)


def _upper(
    problem: Problem,
    task: dict[str, Any],
    levels: Sequence[Fraction],
    starts: Sequence[Fraction | float],
    duration: Fraction | float,
    margin: float | None,
) -> Proof:
    """The upper side of a command on limits, forwards in time, claimed by that relative `margin`, or a double, above its duration."""
    claim = float(np.nextafter(float(duration), np.inf)) if margin is None else float(duration) * (1.0 + margin)
    for witness in _witnesses(problem, levels, starts, duration):
        side = Side(Fraction(claim), witness)
        if accepted(task, upper=side):
            arcs = {float(start): float(level) for start, level in zip(starts, levels, strict=True)}
            segments = tuple(Segment(start, level) for start, level in arcs.items())
            return Proof(None, side, Command(claim, segments, Tail(problem.absolute(0.0))), len(levels) - 1)
    return Proof()


def _witnesses(
    problem: Problem, levels: Sequence[Fraction], starts: Sequence[Fraction | float], duration: Fraction | float
) -> Iterator[dict[str, Any]]:
    """Witnesses, one for each radius: as many instants are unknowns as there are equations, the best conditioned ones."""
    if len(starts) < problem.size:
        return  # a degenerate optimum
    values = [float(level - problem.maneuver.rest) for level in levels]
    jumps = np.append(values[-1], -np.diff(values))
    columns = problem.rows([float(duration), *(float(start) for start in starts[1:])]) * jumps
    columns /= np.abs(columns).max(axis=1)[:, None]
    names: list[list[Any]] = [["time", 0, 0], *(["start", i, 0] for i in range(1, len(starts)))]
    free = [names[i] for i in np.sort(pivots(columns)[: problem.size])]
    for radius in RADII if isinstance(duration, Fraction) else RADII[2:]:
        yield certificates.command_witness(duration, starts, levels, [], free, radius * float(duration))


def _landed(problem: Problem, task: dict[str, Any], solution: programs.GridSolution) -> Proof | None:
    """The upper side of a program's solution, repaired and turned around; None if that is not accepted."""
    fixed = repair(solution) if solution.reaches else None
    if fixed is None:
        return None
    duration, count = Fraction(fixed.maneuver_time), len(fixed.starts)
    ends = [*(Fraction(float(start)) for start in fixed.starts[1:]), duration]
    starts, levels = [duration - end for end in reversed(ends)], fixed.levels[::-1]
    free: list[list[Any]] = [["level", count - 1 - i, 0] for i in reversed(fixed.free_levels)]
    side = Side(duration, certificates.command_witness(duration, starts, levels, [], free, fixed.radius))
    if not accepted(task, upper=side):
        return None
    segments = tuple(Segment(float(start), float(level)) for start, level in zip(starts, levels, strict=True))
    return Proof(None, side, Command(rounded(duration, np.inf), segments, Tail(problem.absolute(0.0))))
