"""The bracket of commands of pulses, proven: below that of all commands, above the best one that is found (`relaxations.thrusters`)."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from relaxations.arcs import arc_witnesses
from relaxations.bounds import Bound
from relaxations.checking.claims import check
from relaxations.commands import Command, Segment, Tail
from relaxations.maneuvers import Problem
from relaxations.maneuvers import problem as pose
from relaxations.plants import fraction
from relaxations.programs import GridSolution
from relaxations.pulse_trees import Refutation
from relaxations.robust.proofs import sampled
from relaxations.sides import Proof, Side, accepted, concluded, rounded
from relaxations.thrusters import Pulsed, admissible, pulsed_commands, searched
from relaxations.thrusters_mirrored import mirrored_commands, mirrored_witnesses
from relaxations.varying import arcs_proven
from relaxations.watching import Watch

ROUNDS = 12  # of refuting again below a shorter command that was found on the way
TRIED = 12  # commands, the shortest ones, whose proof is tried
MARGINS = (1e-14, 1e-13, 1e-12)
DEGENERATE = "of those with fewer instants than equations only such are looked for as are their own image about the middle of the move"


def pulsed_time(problem: Problem, task: dict[str, Any], minimum: Callable[[Problem], Bound]) -> Bound:
    """Both sides, proven for this task; `minimum` brackets the task without limits of pulses."""
    maneuver = problem.maneuver
    free = replace(problem, maneuver=replace(maneuver, limits=replace(maneuver.limits, pulse_width=None, pulses=None)))
    first = minimum(free)
    sides: list[Side | None] = [None, None]
    if first.certificate is not None:
        content, known = json.loads(first.certificate), check(first.certificate).certificate
        claims = known and (known.claim.lower, known.claim.upper)
        written = zip(claims or (), (content["lower"], content["upper"]), strict=False)
        sides = [None if claim is None else Side(fraction(claim), witness) for claim, witness in written]
    lower, upper = sides
    proof = Proof(lower if lower and accepted(task, lower=lower) else None)
    if first.command is not None and admissible(problem, first.command) and upper and accepted(task, upper=upper):
        return concluded(task, replace(proof, upper=upper, command=first.command, switches=first.switches), first, 0.0)
    found: list[Pulsed] = []
    if first.upper is not None:
        found = [*pulsed_commands(_sampled(problem, first), first.lower, first.command), *mirrored_commands(problem, first.lower)]
    watch = Watch.of(problem)
    trees = Refutation(problem, task, lambda levels, durations, best: searched(problem, watch, levels, durations, best))
    for _ in range(ROUNDS):
        proof = _shortest(problem, task, found, proof)
        side, better = trees.closest(proof.lower, _seen_by_trees(problem, proof))
        proof = replace(proof, lower=side)
        if better is None:
            break
        found = [better]
    if proof.upper is not None:
        return sampled(concluded(task, proof, first, 0.0), problem)
    why = f"no command with such pulses was found; {DEGENERATE}" if first.upper is not None else first.reason
    return concluded(task, proof, replace(first, upper=None, command=None, switches=None, reason=why), 0.0)


def _seen_by_trees(problem: Problem, proof: Proof) -> float | None:
    """The time [s] of the shortest command that is known of what trees look at, which are moments and fuel: without limits of outputs."""
    above = float(proof.upper.claim) if proof.upper else None
    if not problem.courses or above is None:
        return above
    known = pulsed_commands(replace(problem, courses=()), float(proof.lower.claim)) if proof.lower else []
    return min([above, *(one.maneuver_time for one in known)])


def _shortest(problem: Problem, task: dict[str, Any], found: Sequence[Pulsed], proof: Proof) -> Proof:
    """With the upper side of the shortest command that is accepted, if one is shorter."""
    for one in sorted(found, key=lambda one: one.maneuver_time)[:TRIED]:
        if (proven := thrust(problem, task, one)) is not None:
            return replace(proven, lower=proof.lower)
    return proof


def _sampled(problem: Problem, first: Bound) -> Problem:
    """The problem with the places of its box that the command without limits of pulses needed."""
    box = problem.maneuver.box
    if box is None or not isinstance(first.dual, GridSolution) or (known := first.dual.problem.maneuver.box) is None:
        return problem
    return pose(problem.plants, replace(problem.maneuver, box=replace(box, samples=known.samples)))


def thrust(problem: Problem, task: dict[str, Any], found: Pulsed) -> Proof | None:
    """The upper side of a command of pulses."""
    if problem.transition is not None:
        for margin in MARGINS:
            proof = arcs_proven(problem, task, found.levels, list(found.starts), found.maneuver_time, margin)
            if proof.upper is not None:
                return proof
        return None
    arcs = arc_witnesses(problem, found.levels, found.maneuver_time, found.starts, np.zeros(0))
    for witness in mirrored_witnesses(problem, found) if found.mirrored else arcs:
        for margin in MARGINS:
            side = Side(Fraction(found.maneuver_time * (1.0 + margin)), witness)
            if accepted(task, upper=side):
                segments = tuple(Segment(float(start), float(level)) for start, level in zip(found.starts, found.levels, strict=True))
                command = Command(rounded(side.claim, np.inf), segments, Tail(problem.absolute(problem.hold)))
                return Proof(None, side, command, len(segments) - 1)
    return None
