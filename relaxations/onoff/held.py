"""The minimum time of pulses one way, then the other: bracketed and proven for that family of commands, and what holding the form costs.

Where the fastest command of all happens to be of the form both sides are its own. Elsewhere the lower side is a cover of all changes of
sign (`relaxations.onoff.families`), the upper one the command at the best of them: its switches, or where they are fewer than the equations
(a node of the fuel) its levels too, a hair longer.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations import certificates
from relaxations.bounds import Bound, Settings, Status
from relaxations.checking.claims import check
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ManeuverError, ShortHorizonError, SolverError
from relaxations.maneuvers import Problem
from relaxations.onoff.duals import Dual, Looks, largest_fraction
from relaxations.onoff.families import Fastest, Node, cover, fastest
from relaxations.plants import LinearPlant, fraction
from relaxations.repair import pivots
from relaxations.sides import Proof, Side, accepted, concluded, rounded
from relaxations.thrusters import Pulsed, admissible, pulsed_commands
from relaxations.thrusting import thrust

Reals = NDArray[np.float64]

MARGINS = (1e-9, 1e-7, 1e-6, 1e-5, 1e-4)  # how far beneath the shortest command that was found a lower side is tried (relative)
LONGER = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)  # … beyond it a command with other levels
THIN = 1e-6  # of the duration: an arc so thin is none
AGAIN = 3  # searches, each from a change of sign that the one before had overlooked
STEPS = 8  # of Newton's method on the levels
TRIED = 12  # commands of pulses


def towards(plant: LinearPlant, displacement: Fraction) -> int:
    """The side ±1 of the first pulses: they push to where the plant is to go. Raises `ManeuverError` if no such form can do it."""
    order = plant.rigid_order
    if not order:
        raise ManeuverError(
            "positive pulses, then negative pulses (type = 1) move a plant that has a rigid-body mode: "
            "this one is held at its target by an input"
        )
    if order > 2:
        raise ManeuverError(
            f"with {order} integrators the sign of the input has to change at least {order - 1} time(s): pulses one way, then the other "
            "(type = 1) cannot do it"
        )
    highest = plant.partial().residues[0][-1].real
    return 1 if (displacement > 0) == (highest > 0) else -1


def in_form(problem: Problem, command: Command) -> bool:
    """Whether a command's levels are of the form that is held."""
    along, changed = problem.maneuver.limits.held, False
    for segment in command.segments:
        value = along * (segment.level - problem.rest)
        changed = changed or value < 0.0
        if segment.slope or (changed and value > 0.0):
            return False
    return True


def held_time(
    problem: Problem,
    task: dict[str, Any],
    settings: Settings,
    near: float | None,
    begun: float,
    solved: Callable[[Problem, Settings, float | None], Bound],
) -> Bound:
    """The bracket of commands of the form, of pulses that are wide and few enough if these are limited; `solved` brackets all commands."""
    maneuver = problem.maneuver
    limits = maneuver.limits
    free = replace(problem, maneuver=replace(maneuver, limits=replace(limits, held=0, pulse_width=None, pulses=None)))
    first = solved(free, settings, near)
    if first.status is Status.IMPOSSIBLE:
        return first
    fitting = first.command is not None and in_form(problem, first.command) and (not limits.pulsed or admissible(problem, first.command))
    lower, upper = _sides(first)
    general = Proof(lower if lower and accepted(task, lower=lower) else None)
    if fitting and upper and accepted(task, upper=upper):
        proof = replace(general, upper=upper, command=first.command, switches=first.switches)
        return replace(concluded(task, proof, first, time.perf_counter() - begun), free=(first.lower, first.upper))
    found: Fastest | None = None
    reason = None
    try:
        found, proof = _searched(problem, task, first)
    except (SolverError, np.linalg.LinAlgError) as trouble:
        proof, reason = Proof(), f"the search for the change of sign failed: {trouble}"
    proof = replace(proof, lower=proof.better(general).lower)
    if found is None:
        reason = reason or "no command of the form was found"
    elif limits.pulsed and (proof.command is None or not admissible(problem, proof.command)):
        proof, reason = Proof(proof.lower), "no command of the form with such pulses was found"
        for candidate in [one for one in pulsed_commands(problem, found.maneuver_time) if _of_form(problem, one)][:TRIED]:
            if (proven := thrust(problem, task, candidate)) is not None:
                proof = replace(proven, lower=proof.lower)
                break
    blank = replace(first, upper=None, command=None, switches=None, reason=reason)
    if found is not None and not limits.pulsed:
        blank = replace(blank, lower=first.lower, upper=found.maneuver_time, command=_command(problem, found), reason=reason)
    return replace(concluded(task, proof, blank, time.perf_counter() - begun), free=(first.lower, first.upper))


def _sides(first: Bound) -> tuple[Side | None, Side | None]:
    """The sides that a bracket of all commands has proven."""
    if first.certificate is None:
        return None, None
    content, known = json.loads(first.certificate), check(first.certificate).certificate
    claims = (known.claim.lower, known.claim.upper) if known else (None, None)
    pairs = zip(claims, (content["lower"], content["upper"]), strict=True)
    lower, upper = (None if claim is None else Side(fraction(claim), witness) for claim, witness in pairs)
    return lower, upper


def _searched(problem: Problem, task: dict[str, Any], first: Bound) -> tuple[Fastest | None, Proof]:
    """The shortest command of the family that is found, and what is proven of both sides."""
    along, start = problem.maneuver.limits.held, first.lower or 1.0
    found = fastest(problem, along, start)
    if found is None:
        return None, Proof()
    nodes, claim = None, 0.0
    margins = iter(MARGINS)
    for _ in range(AGAIN * len(MARGINS)):
        margin = next(margins, None)
        if margin is None:
            break
        claim = found.maneuver_time * (1.0 - margin)
        if claim <= first.lower:  # the bound of all commands says as much
            break
        try:
            looks = Looks.of(problem, claim, along)
            nodes = cover(looks)
        except SolverError:
            continue
        if isinstance(nodes, Dual):
            nodes = None
            continue
        side = Side(Fraction(claim), _witness(problem, nodes))
        if accepted(task, lower=side):
            return found, replace(_upper(problem, task, found), lower=side)
        nodes = None
    return found, _upper(problem, task, found)


def _witness(problem: Problem, nodes: list[Node]) -> dict[str, Any]:
    return certificates.changes_witness(problem, [(node.at, node.costate, node.price) for node in nodes])


def arcs(found: Fastest) -> tuple[Reals, Reals]:
    """Starts [s] and levels (deviations) of the command, in order of time, without arcs that are too thin to be any."""
    end, dual = found.maneuver_time, found.dual
    kept: list[tuple[float, float]] = []  # time to go of the end, level
    for edge, level, width in zip(dual.edges[1:], dual.levels, np.diff(dual.edges), strict=True):
        if width <= THIN * end:
            continue
        if kept and kept[-1][1] == level:
            kept.pop()
        kept.append((float(edge), float(level)))
    kept.reverse()
    return np.array([0.0, *(end - edge for edge, _ in kept[1:])]), np.array([level for _, level in kept])


def _levels(problem: Problem, levels: Reals) -> list[Fraction]:
    """The absolute levels that full thrust and rest are."""
    limits, rest = problem.maneuver.limits, problem.maneuver.rest
    return [limits.upper if level > 0.0 else limits.lower if level < 0.0 else rest for level in levels]


def _command(problem: Problem, found: Fastest) -> Command:
    starts, levels = arcs(found)
    exact = _levels(problem, levels)
    segments = tuple(Segment(float(start), float(level)) for start, level in zip(starts, exact, strict=True))
    return Command(found.maneuver_time, segments, Tail(problem.absolute(problem.hold)))


def _upper(problem: Problem, task: dict[str, Any], found: Fastest) -> Proof:
    """The command at the best change of sign: exact switches if there are enough of them, else a little longer with other levels."""
    starts, levels = arcs(found)
    pulsed = Pulsed(found.maneuver_time, starts, tuple(_levels(problem, levels)))
    landed = _landed(problem, pulsed) if len(levels) >= problem.size else None
    if landed is not None and (proof := thrust(problem, task, landed)) is not None:
        return proof
    for beyond in LONGER:
        try:
            looks = Looks.of(problem, found.maneuver_time * (1.0 + beyond), found.looks.along)
            dual = largest_fraction(looks, found.dual.windows, problem.fuel, found.dual)
        except (ShortHorizonError, SolverError):
            continue
        if dual.value > 1.0 and (proof := _levelled(problem, task, Fastest(looks, dual))) is not None:
            return proof
    return Proof()


def _landed(problem: Problem, pulsed: Pulsed) -> Pulsed | None:
    """Its switches and duration corrected until it lands to rounding, by the least change; within the budget, if there is one."""
    levels = np.array([float(level - problem.maneuver.rest) for level in pulsed.levels])
    instants = np.append(pulsed.starts, pulsed.maneuver_time)
    jumps, budget = np.diff(levels, prepend=0.0), problem.fuel or np.inf
    tight = np.abs(levels) @ np.diff(instants) > budget * (1.0 - 1e-6)
    scale = np.abs(problem.rows(np.linspace(0.0, instants[-1], 65), 1)).max(axis=1) * np.abs(levels).max()
    for _ in range(STEPS):
        to_go = instants[-1] - instants
        table = problem.rows(to_go, 1)
        missed = (table[:, :-1] - table[:, 1:]) @ levels - problem.target
        by_start = problem.rows(to_go[:-1]) * jumps  # the moments by the duration; by a start minus its column
        slopes = np.hstack([-by_start[:, 1:], by_start.sum(axis=1, keepdims=True)]) / scale[:, None]
        right = missed / scale
        if tight:
            burnt = np.abs(levels)
            slopes = np.vstack([slopes, np.append(burnt[:-1] - burnt[1:], burnt[-1]) / budget])
            right = np.append(right, burnt @ np.diff(instants) / budget - (1.0 - 2e-13))
        instants[1:] -= np.linalg.lstsq(slopes, right, rcond=None)[0]
        if not np.all(np.diff(instants) > 0.0):
            return None
    return Pulsed(float(instants[-1]), instants[:-1], pulsed.levels)


def _levelled(problem: Problem, task: dict[str, Any], found: Fastest) -> Proof | None:
    """A command that reaches more than the target, its levels divided by as much: levels and switches are the unknowns."""
    starts, levels = arcs(found)
    n, size, end = len(levels), problem.size, found.maneuver_time
    levels = levels / found.dual.value
    values = np.concatenate([starts[1:], levels])
    sides = np.concatenate([np.minimum(np.diff(np.append(starts, end))[:-1], np.diff(np.append(starts, end))[1:]) / 4, np.zeros(n)])
    upper = np.where(levels > 0.0, problem.upper - levels, levels - problem.lower)
    sides[n - 1 :] = np.where(levels == 0.0, 0.0, np.minimum(np.abs(levels), upper) / 2)
    scale = np.abs(problem.rows(np.linspace(0.0, end, 65), 1)).max(axis=1) * np.abs(levels).max()
    chosen: NDArray[np.intp] | None = None
    for _ in range(STEPS):
        instants, heights = np.concatenate([[0.0], values[: n - 1], [end]]), values[n - 1 :]
        table, b = problem.rows(end - instants, 1), problem.rows(end - instants[1:-1])
        slopes = np.hstack([-b * np.diff(heights), table[:, :-1] - table[:, 1:]]) / scale[:, None]
        missed = ((table[:, :-1] - table[:, 1:]) @ heights - problem.target) / scale
        if chosen is None:
            if np.count_nonzero(sides) < size:
                return None
            chosen = np.sort(pivots(slopes * np.sqrt(sides))[:size])
        values = values.copy()
        values[chosen] -= np.linalg.lstsq(slopes[:, chosen], missed, rcond=None)[0]
    assert chosen is not None
    names = [["start", int(i) + 1, 0] if i < n - 1 else ["level", int(i) - n + 1, 0] for i in chosen]
    begins, heights = np.concatenate([[0.0], values[: n - 1]]), values[n - 1 :]
    absolute = [problem.maneuver.rest + Fraction(float(height)) for height in heights]
    for radius in (1e-13, 1e-12, 1e-11, 1e-10):
        witness = certificates.command_witness(end, list(begins), absolute, [], names, radius * end)
        side = Side(Fraction(end), witness)
        if accepted(task, upper=side):
            segments = tuple(Segment(float(start), float(level)) for start, level in zip(begins, absolute, strict=True))
            command = Command(rounded(side.claim, np.inf), segments, Tail(problem.absolute(problem.hold)))
            return Proof(None, side, command, n - 1)
    return None


def _of_form(problem: Problem, pulsed: Pulsed) -> bool:
    segments = tuple(Segment(float(start), float(level)) for start, level in zip(pulsed.starts, pulsed.levels, strict=True))
    return in_form(problem, Command(pulsed.maneuver_time, segments, Tail(problem.absolute(problem.hold))))
