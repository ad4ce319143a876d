"""From a bracket in floating point to a theorem: certificates are proposed here, and count only when the checker accepts them.

bracket ──► extremal, 45 digits ──► certificate of both sides        where the optimum is regular
        ──► linear repair ──► certificate of the upper side          always
        ──► costate of the grid ──► certificate of the lower side    always
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import NDArray

from relaxations import certificates, programs
from relaxations.arcs import arc_witnesses
from relaxations.bounds import (
    CUTS,
    FLAT,
    NEAR,
    Bound,
    Settings,
    Status,
    bracket,
    contacts,
    cut,
    exponent_of,
    instants,
)
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.courses import respects
from relaxations.degenerate import beneath, settled
from relaxations.duality import Costate
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem
from relaxations.onoff.held import held_time
from relaxations.polishing import Polished, polish
from relaxations.prices import Prices
from relaxations.refinement import Extremal, outline
from relaxations.repair import SNAP, zoomed
from relaxations.robust.proofs import robust_time
from relaxations.robust.search import further, minimum
from relaxations.sampling import sampled_bracket
from relaxations.sides import Proof, Side, accepted, closing, concluded, instant_proof, landed, lower_side
from relaxations.spending import spending
from relaxations.thrusting import pulsed_time
from relaxations.varying import varying_time

Reals = NDArray[np.float64]

BEYOND = (1e-9, 1e-8, 1e-7, 3e-7, 1e-6, 1e-5, 3e-5, 1e-4)
"""How far beyond the minimum time (relative) a repaired command may go."""

CLOSEST, ZOOMS, ZOOMED = 1e-8, 4, (1e-9, 3e-9, 1e-8, 3e-8, 1e-7)
"""Gap above which that is tried on denser grids too; how often cells are cut where the command changes; how far beyond it may go then."""

SLOPED = (3e-7, 1e-6)
"""And where it is continuous."""

REGULAR, GOOD, LIMITED, COURSED = 1e-12, 1e-7, 1e-6, 1e-5
"""Gaps at which the search ends: of a regular optimum; on finer grids; with a budget of fuel or a box; with limits on courses or slopes."""

DENSE = 16  # times as dense a grid is the last one where courses are limited: on the next a program takes minutes
CLOSE = 1e-7  # of α, where courses or slopes are limited: closer to the root is closer than the grid


def minimum_time(problem: Problem, settings: Settings | None = None, near: float | None = None) -> Bound:
    """Bracket the least maneuver time and prove both sides where that is possible; `near` is a guess at it [s].

    The result is `PROVED` if the checker has accepted a certificate for both sides, `IMPOSSIBLE` if it has accepted one that no time
    suffices, else `BRACKETED` with the reason; a certificate then holds the side that was proven, if any. Where the
    numerics fail altogether the bracket is [0, –].
    """
    begun, chosen = time.perf_counter(), settings or Settings()
    task = certificates.task(problem)
    if problem.transition is not None and not problem.maneuver.limits.pulsed:
        return varying_time(problem, task, chosen, near, begun)
    if (content := impossibility(problem, task)) is not None:
        nothing = np.zeros(problem.size)
        return Bound(Status.IMPOSSIBLE, 0.0, None, nothing, None, None, None, 0, time.perf_counter() - begun, certificate=content)
    if problem.maneuver.limits.held:
        return held_time(problem, task, chosen, near, begun, minimum_time)
    if problem.maneuver.limits.pulsed:
        found = pulsed_time(problem, task, lambda free: minimum_time(free, chosen, near))
        return replace(found, seconds=time.perf_counter() - begun)
    if problem.residuals is not None:
        if not any(sample.basis.size for sample in problem.residuals.samples) and not problem.courses:
            problem = replace(problem, residuals=None)  # bodies alone: they are at rest together
        elif problem.maneuver.sample_time is None:
            return robust_time(problem, task, chosen, near, begun)
        else:
            asked = problem.maneuver  # without the samples and their steps: its places in the box serve here too
            without = replace(asked, sample_time=None, limits=replace(asked.limits, rate=None))
            free = minimum(replace(problem, rate=None, maneuver=without), chosen, guess=near)
            problem = replace(free.problem, rate=problem.rate, maneuver=replace(asked, box=free.problem.maneuver.box))
    gridded = problem.maneuver.sample_time is not None
    if problem.courses or problem.rate is not None:
        chosen = replace(chosen.finer(4 if problem.sloped else 2), tolerance=max(chosen.tolerance, CLOSE))
    look = sampled_bracket if gridded else bracket
    if not gridded and problem.eased.bang_bang and not problem.bang_bang and (first := _at_ease(problem, task, chosen)) is not None:
        return replace(first, seconds=time.perf_counter() - begun)
    gap = REGULAR if problem.bang_bang else COURSED if problem.courses or problem.rate else LIMITED

    def enough(factor: int, proof: Proof) -> bool:
        late = factor > 1 and (problem.rate is not None or (bool(problem.courses) and proof.upper is None))  # finer grids gain little
        late = late or (factor >= DENSE and bool(problem.courses))
        done = proof.gap <= gap or (factor > 1 and proof.gap <= GOOD) or (proof.final and proof.lower is not None)
        return gridded or late or done

    return closing(
        problem,
        task,
        chosen,
        lambda finer, near: look(problem, finer, near),
        lambda looked, finer: _prove(problem, task, looked, finer),
        enough,
        near,
        begun,
    )


def extremal_bound(problem: Problem, extremal: Extremal, to_go: Sequence[arb] | None = None) -> Bound:
    """The bracket of a command that is known to be extremal, no grid: `PROVED`, or `BRACKETED` if a side was not proven.

    `to_go`: times to go of its switches and its duration [s], where doubles do not tell them apart.
    """
    begun, task = time.perf_counter(), certificates.task(problem)
    polished = polish(problem, extremal, instants=to_go)
    proof = Proof() if polished is None else _regular(problem, task, extremal, polished)
    reached = extremal.maneuver_time
    found = Bound(Status.BRACKETED, 0.0, reached, extremal.costate, extremal.command(problem), len(extremal.switches_to_go), None, 0, 0.0)
    return concluded(task, proof, found, time.perf_counter() - begun)


def _at_ease(problem: Problem, task: dict[str, Any], settings: Settings) -> Bound | None:
    """The bound of the problem without its further limits, if its command respects them as it is; certified for the whole task."""
    try:
        found = bracket(problem.eased, settings)
    except SolverError:
        return None
    if found.command is None or not isinstance(found.dual, Extremal):
        return None
    if problem.fuel is not None and found.command.fuel(problem.rest) > problem.fuel:
        return None
    if not respects(problem.courses, found.command, problem.rest):
        return None
    proof = _prove(problem.eased, task, found, settings)
    return concluded(task, proof, found, 0.0) if proof.gap <= REGULAR else None


def _rests_on_a_limit(problem: Problem) -> bool:
    """Whether the input at a rest is itself a limit: the criteria of impossibility speak of no other task."""
    maneuver = problem.maneuver
    rests = {maneuver.rest, *(maneuver.rest + plant.rest_input(maneuver.displacement) for plant in problem.plants)}
    return not rests.isdisjoint((maneuver.limits.lower, maneuver.limits.upper))


def _prove(problem: Problem, task: dict[str, Any], found: Bound, settings: Settings) -> Proof:
    """Both sides of one bracket: of the extremal if there is one, else of the grid."""
    if found.upper == 0.0 and found.command is not None:
        return instant_proof(problem, task, found)
    proof, extremal = Proof(), None if problem.maneuver.sample_time is not None else found.dual
    problem = extremal.problem if extremal else problem
    if isinstance(extremal, programs.GridSolution) and found.upper is not None and problem.switched:
        # Where Newton's method in doubles failed, one in more digits may find its way from the grid.
        extremal = outline(problem, extremal.costate, extremal.maneuver_time, contacts(problem, extremal), extremal.fuel)
    if isinstance(extremal, Extremal) and (polished := polish(problem, extremal)) is not None:
        proof = _regular(problem, task, extremal, polished)
    if isinstance(extremal, Extremal) and extremal is found.dual and proof.upper is None:
        upper = _refined(problem, task, extremal, found)
        proof = Proof(proof.lower, upper, found.command if upper else None, found.switches if upper else None)
    if isinstance(extremal, Extremal) and proof.upper is None:
        proof = proof.better(settled(problem, task, extremal))
        if proof.upper is not None and proof.lower is None and problem.begin is not None:
            proof = proof.better(beneath(problem, task, float(proof.upper.claim), settings))
    above: programs.GridSolution | None = None
    if proof.upper is None and found.upper is not None:
        repaired, above = _repaired(problem, task, _grids(problem, found, settings))
        if repaired.upper is None or repaired.upper.claim > found.lower * (1.0 + CLOSEST):
            closer, nearer = _repaired(problem, task, _closer(problem, found, settings))
            repaired, above = repaired.better(closer), nearer or above
        proof = proof.better(repaired)
    if proof.lower is None:
        for dual in (found.dual, above):
            if dual is not None:
                posed = replace(dual.problem, maneuver=problem.maneuver)
                proof = proof.better(Proof(lower_side(posed, task, dual, _near(problem, found, dual))))
    return proof


def _near(problem: Problem, found: Bound, dual: Extremal | programs.GridSolution | Costate) -> float:
    """Where to look for the longest time that a dual refutes: of a plant that begins elsewhere than at rest, at its own."""
    return dual.maneuver_time if found.upper is None or problem.begin is not None else found.upper


def _regular(problem: Problem, task: dict[str, Any], extremal: Extremal, polished: Polished) -> Proof:
    """Both sides of a regular optimum, claimed a double below and a double above the duration."""
    middle = float(polished.maneuver_time)
    witness = certificates.costate_witness(problem, polished.costate, polished.multipliers, Prices(polished.fuel))
    lower: Side | None = Side(Fraction(float(np.nextafter(middle, 0.0))), witness)
    above = Fraction(float(np.nextafter(middle, np.inf)))
    for upper in arc_witnesses(problem, extremal.exact_levels[::-1], polished.maneuver_time, polished.starts, polished.tail):
        side = Side(above, upper)
        if content := accepted(task, lower, side):
            return Proof(lower, side, _bang_bang(problem, extremal, polished, above), len(polished.starts) - 1, content)
    return Proof(lower if lower and accepted(task, lower=lower) else None)


def _refined(problem: Problem, task: dict[str, Any], extremal: Extremal, found: Bound) -> Side | None:
    """The upper side of an extremal in doubles."""
    starts = np.concatenate([[0.0], extremal.maneuver_time - extremal.switches_to_go[::-1]])  # of the command some may have merged
    for witness in arc_witnesses(problem, extremal.exact_levels[::-1], extremal.maneuver_time, starts, found.tail):
        for margin in (1e-14, 1e-13, 1e-12):
            side = Side(Fraction(extremal.maneuver_time * (1.0 + margin)), witness)
            if accepted(task, upper=side):
                return side
    return None


def _bang_bang(problem: Problem, extremal: Extremal, polished: Polished, upper: Fraction) -> Command:
    arcs = {float(s): float(v) for s, v in zip(polished.starts, extremal.exact_levels[::-1], strict=True)}
    segments = tuple(Segment(start, level) for start, level in arcs.items())  # of arcs that a double cannot tell apart the last
    terms = problem.tail.terms(np.array([float(c) for c in polished.tail]))
    return Command(float(upper), segments, Tail(problem.absolute(problem.hold), terms))


def _closer(problem: Problem, found: Bound, settings: Settings) -> Iterator[tuple[Reals, float]]:
    """Grids a little beyond a bracket's lower side, very dense where the command changes, as `_grids` has them."""
    if not (problem.switched or problem.sloped) or problem.maneuver.sample_time is not None or not found.lower:
        return
    grid = instants(problem, found.lower, settings)
    with suppress(SolverError):
        for _ in range(ZOOMS):
            solution = cut(problem, grid, 0.0)
            exponent, off = exponent_of(solution), -math.log(max(solution.fraction, 1e-300))
            if exponent <= FLAT or abs(off / exponent) > NEAR:
                return
            grid = zoomed(solution) * math.exp(off / exponent)
        yield from (
            (grid * (1.0 + beyond), beyond / 4.0) for beyond in (ZOOMED[-1:] if problem.sloped else ZOOMED) + SLOPED * problem.sloped
        )


def _grids(problem: Problem, found: Bound, settings: Settings) -> Iterator[tuple[Reals, float]]:
    """Grids a little beyond a bracket's upper side, and by what fraction limits after the move are tightened on each."""
    assert found.upper is not None
    beyonds = BEYOND if problem.residuals is None and not problem.courses and problem.rate is None else BEYOND[-4:]
    if problem.maneuver.sample_time is None:
        yield from ((instants(problem, found.upper * (1.0 + beyond), settings), beyond / 4.0) for beyond in beyonds)
    elif found.above is not None:
        count, stride = len(found.above.program.instants) - 1, round(found.above.program.instants[1] / float(problem.maneuver.sample_time))
        for more in (0, 1, 2):
            yield from ((problem.samples(count + more, stride), beyond / 4.0) for beyond in (beyonds if problem.residuals else beyonds[:1]))


def _repaired(problem: Problem, task: dict[str, Any], grids: Iterator[tuple[Reals, float]]) -> tuple[Proof, programs.GridSolution | None]:
    """The upper side by linear repair, a little beyond the minimum time; with the program it came from."""
    solution: programs.GridSolution | None = None
    for grid, inside in grids:
        try:
            solution = cut(problem, grid, inside)
            for _ in range(CUTS if problem.residuals is not None else 0):
                if (more := further(problem, solution, inside)) is None:
                    break
                problem = more
                solution = cut(problem, grid, inside)
        except SolverError:
            continue
        for snap in (SNAP, 0.0)[: 2 if problem.residuals is None else 1]:
            if (proof := landed(problem, task, solution, snap)) is not None:
                return proof, solution
    return Proof(), solution


def impossibility(problem: Problem, task: dict[str, Any] | None = None) -> bytes | None:
    """A certificate, accepted by the checker, that no command does the task in any time; None if none was found."""
    asked = task or certificates.task(problem)
    for form, witness in _impossible(problem):
        content = certificates.certificate(asked, {"lower": None, "upper": None, "impossible": form}, witness, None)
        if check(content).outcome is Outcome.PROVED:
            return content
    return None


def _impossible(problem: Problem) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """Criteria by which a task may be impossible, each with its witness; they speak of no plant that varies."""
    if problem.transition is not None:
        return
    if problem.fuel is not None or _rests_on_a_limit(problem):
        yield from ((form, None) for form in ("face", "remainder", "fuel"))
    if any(abs(course.final) == course.limit for course in problem.courses):
        yield "overshoot", None
    if (asked := spending(problem)) is not None:
        costate, price, touched = asked
        yield "fuel", certificates.costate_witness(problem, costate, touched, Prices(price))
    box = problem.maneuver.box
    if box is not None and (place := box.beyond()) is not None:
        yield "final", certificates.place_witness(problem, place)
