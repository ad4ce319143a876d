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
from itertools import pairwise
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from relaxations import certificates, programs
from relaxations.bounds import Bound, Settings, Status, bracket, contacts, cut, instants
from relaxations.commands import Command, Segment, Tail
from relaxations.courses import respects
from relaxations.energy import LONGER, energy_time
from relaxations.errors import ManeuverError, SolverError
from relaxations.maneuvers import Maneuver, Problem, TargetSet, sensible_pulses
from relaxations.moments import Basis
from relaxations.polishing import Polished, polish
from relaxations.prices import Prices
from relaxations.ramps import rate_of
from relaxations.refinement import Extremal, outline
from relaxations.repair import pivots, repair
from relaxations.sampling import sampled_bracket
from relaxations.sides import RADII, Proof, Side, accepted, closing, lower_side, rounded
from relaxations.tails import TailSpace
from relaxations.transitions import Transition, VaryingPlant
from relaxations.varying_courses import varying_courses

Reals = NDArray[np.float64]

BEYOND = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""How far beyond the minimum time (relative) a repaired command may go."""

FINEST = 16  # times the grid's density that are tried at most

ENOUGH, GOOD, COURSED = 1e-12, 1e-7, 1e-5
"""Gaps at which the search ends: of a regular optimum; on finer grids; with limits on outputs or slopes."""

CLOSE = 1e-7  # of α, where these are limited: closer to the root is closer than the grid

FARTHEST = 1e4  # times the plant's own time scale, or the schedule's length


def varying_problem(plant: VaryingPlant, maneuver: Maneuver) -> Problem:
    """The equations and limits of a maneuver of a varying plant; input deviations count from the final rest, in either direction of time.

    `maneuver.initial` are deviations of the plant's own states from the first rest. Raises `ManeuverError` if there is nothing to move, for
    what this kind of plant is not moved with, and if the limits exclude the input at either rest; `PlantError` without a rest that lasts.
    """
    limits = maneuver.limits
    refused = {
        "an output rest (tail), for the zeros along which its input would decay vary too": maneuver.tail
        or maneuver.tail_length is not None
        or bool(maneuver.zero_sensitivity),
        "further zeros (robustness), for a plant that varies has no frequency in which its residual could be flat": bool(
            maneuver.robustness
        ),
        "a box: each of its plants needs a schedule of its own (relaxations.varying_boxes)": maneuver.box is not None,
    }
    if any(refused.values()):
        asked = ", nor with ".join(name for name, given in refused.items() if given)
        raise ManeuverError(f"a plant that varies is not moved with {asked}")
    sensible_pulses(maneuver)
    if maneuver.displacement == 0 and maneuver.initial is None:
        raise ManeuverError("the displacement is 0: there is nothing to move")
    if maneuver.sample_time is not None and not maneuver.sample_time > 0:
        raise ManeuverError(f"a sample time is more than 0, not {float(maneuver.sample_time)!r} s")
    begin = maneuver.initial or (Fraction(0),) * plant.order
    if len(begin) != plant.order:
        raise ManeuverError(f"an initial state has {plant.order} numbers, not {len(begin)}")
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
    away = [s - x for s, x in zip(state, begin, strict=True)]
    if not any(away):
        raise ManeuverError("the plant is at its final rest already: there is nothing to move")
    rate = rate_of(maneuver)
    transition = Transition(plant)
    lower, upper = float(limits.lower - final), float(limits.upper - final)
    return Problem(
        lower,
        upper,
        float(-held),  # where the input begins
        (TargetSet(cast("Basis", transition), np.array([float(x) for x in away])),),  # it has what a grid's program asks of a basis
        (plant.final,),
        replace(maneuver, rest=final),
        TailSpace((), np.zeros((plant.order, 0)), upper, -lower),
        float(final),
        None if limits.fuel is None else float(limits.fuel),
        varying_courses(plant, limits, state, begin),
        None if rate is None else (-rate[1], -rate[0]),
        notes=plant.final.notes,
        transition=transition,
    )


def resampled(problem: Problem, step: Fraction) -> Problem:
    """The same of a plant that varies with a sample time [s]."""
    assert problem.transition is not None
    plant, maneuver = problem.transition.plant, problem.maneuver
    return varying_problem(plant, replace(maneuver, rest=maneuver.rest - plant.rest(maneuver.displacement)[1], sample_time=step))


def varying_time(problem: Problem, task: dict[str, Any], settings: Settings, near: float | None, begun: float) -> Bound:
    """Bracket the least maneuver time and prove both sides where that is possible; `near` is a guess at it [s]."""
    gridded = problem.maneuver.sample_time is not None
    if not gridded and problem.rate is None and not problem.bang_bang:
        with suppress(SolverError):
            free = bracket(problem.eased, settings, near or _guess(problem, settings))
            enough_fuel = problem.fuel is None or (free.command is not None and free.command.fuel(problem.rest) <= problem.fuel)
            if free.command is not None and enough_fuel and respects(problem.courses, free.command, problem.rest):
                first = varying_time(problem.eased, task, settings, free.upper, begun)  # the proof is of the whole task
                if first.status is Status.PROVED:
                    return first
    limited = bool(problem.courses) or problem.rate is not None
    if limited:
        settings = replace(settings.finer(4 if problem.sloped else 2), tolerance=max(settings.tolerance, CLOSE))

    def look(finer: Settings, near: float | None) -> Bound:
        looked = (sampled_bracket if gridded else bracket)(problem, finer, near or _guess(problem, settings))
        return replace(looked, command=None if looked.command is None else turned(problem, looked.command))

    def enough(factor: int, proof: Proof) -> bool:
        late = limited and factor > 1 and (problem.rate is not None or proof.upper is None)  # finer grids gain little
        done = proof.gap <= (COURSED if limited else ENOUGH) or (factor > 1 and proof.gap <= GOOD)
        return gridded or late or done or factor >= FINEST

    return closing(problem, task, settings, look, lambda looked, finer: _prove(problem, task, looked, finer), enough, near, begun)


def _guess(problem: Problem, settings: Settings) -> float:
    """A little more than what the command's energy alone needs [s]."""
    assert problem.transition is not None
    plant = problem.transition.plant
    pace = plant.pace or 1.0 / float(plant.instants[-1] or 1)
    scale = max(1.0 / pace, float(plant.instants[-1]))
    return LONGER * energy_time(problem, lambda horizon: instants(problem, horizon, settings), 1.0 / pace, FARTHEST * scale) or scale


def turned(problem: Problem, command: Command) -> Command:
    """A command backwards in time."""
    starts, end = [segment.start for segment in command.segments], command.end
    tail = Tail(problem.absolute(0.0))
    if not starts:
        return replace(command, tail=tail)
    ends = [*starts[1:], end]
    pieces = [
        (end - after, segment.level + segment.slope * (after - segment.start), 0.0 - segment.slope)
        for segment, after in zip(command.segments, ends, strict=True)
    ]
    return Command(command.maneuver_time, tuple(Segment(*piece) for piece in reversed(pieces)), tail)


def _prove(problem: Problem, task: dict[str, Any], found: Bound, settings: Settings) -> Proof:
    """Both sides of one bracket: of the extremal if there is one, else of the grid."""
    gridded = problem.maneuver.sample_time is not None
    proof, extremal = Proof(), None if gridded or not problem.switched else found.dual
    if isinstance(extremal, programs.GridSolution) and found.upper is not None:
        extremal = outline(problem, extremal.costate, extremal.maneuver_time, contacts(problem, extremal), extremal.fuel)
    if isinstance(extremal, Extremal) and (polished := polish(problem, extremal)) is not None:
        proof = _regular(problem, task, extremal, polished)
    if isinstance(found.dual, Extremal) and not gridded and proof.upper is None:
        dual = found.dual
        proof = proof.better(arcs_proven(problem, task, dual.exact_levels, [0.0, *dual.switches_to_go], dual.maneuver_time, 1e-14))
    above: programs.GridSolution | None = None
    if proof.upper is None and found.upper is not None:
        for grid, inside in _grids(problem, found, settings):
            try:
                above = cut(problem, grid, inside)
            except SolverError:
                continue
            if (landed := _landed(problem, task, above)) is not None:
                proof = proof.better(landed)
                break
    if proof.lower is None:
        for dual in (found.dual, above):
            if dual is not None:
                posed = replace(dual.problem, maneuver=problem.maneuver)
                proof = proof.better(Proof(lower_side(posed, task, dual, dual.maneuver_time if found.upper is None else found.upper)))
    return proof


def _grids(problem: Problem, found: Bound, settings: Settings) -> Iterator[tuple[Reals, float]]:
    """Grids a little beyond a bracket's upper side, and by what fraction limits on outputs are tightened on each."""
    assert found.upper is not None
    if problem.maneuver.sample_time is None:
        beyonds = BEYOND if not problem.courses and problem.rate is None else BEYOND[-4:]
        yield from ((instants(problem, found.upper * (1.0 + beyond), settings), beyond / 4.0) for beyond in beyonds)
    elif found.above is not None:
        samples = found.above.program.instants
        count, stride = len(samples) - 1, round(samples[1] / float(problem.maneuver.sample_time))
        yield from ((problem.samples(count + more, stride), BEYOND[0] / 4.0) for more in (0, 1, 2))


def _regular(problem: Problem, task: dict[str, Any], extremal: Extremal, polished: Polished) -> Proof:
    """Both sides of a regular optimum, claimed a double below and a double above the duration."""
    middle = float(polished.maneuver_time)
    witness = certificates.costate_witness(problem, polished.costate, (), Prices(polished.fuel))
    lower: Side | None = Side(Fraction(float(np.nextafter(middle, 0.0))), witness)
    lower = lower if lower and accepted(task, lower=lower) else None
    starts = [Fraction(0), *(polished.maneuver_time - start for start in reversed(polished.starts[1:]))]
    upper = arcs_proven(problem, task, extremal.exact_levels, starts, polished.maneuver_time, None)
    return replace(upper, lower=lower)


def arcs_proven(
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
    duration, count, rest = problem.on_grid(fixed.maneuver_time), len(fixed.starts), problem.maneuver.rest
    begins = [problem.on_grid(float(start)) for start in fixed.starts]
    starts = [duration - end for end in reversed([*begins[1:], duration])]
    if problem.sloped:  # a node's value is where a segment begins, whichever way it goes
        first = rest - problem.transition.plant.rest(problem.maneuver.displacement)[1] if problem.transition else rest
        levels = (first, *fixed.levels[:0:-1])
        free: list[list[Any]] = [["level", count - i, 0] for i in reversed(fixed.free_levels)]
    else:
        levels = fixed.levels[::-1]
        free = [["level", count - 1 - i, 0] for i in reversed(fixed.free_levels)]
    side = Side(duration, certificates.command_witness(duration, starts, levels, [], free, fixed.radius))
    if not accepted(task, upper=side):
        return None
    values, ends = [*map(float, levels), float(rest)], [*starts[1:], duration]
    slopes = (
        [(b - a) / float(t - s) for (a, b), s, t in zip(pairwise(values), starts, ends, strict=True)] if problem.sloped else [0.0] * count
    )
    segments = tuple(Segment(float(s), v, slope) for s, v, slope in zip(starts, values, slopes, strict=False))
    return Proof(None, side, Command(rounded(duration, np.inf), segments, Tail(problem.absolute(0.0))))
