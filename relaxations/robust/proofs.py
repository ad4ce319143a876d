"""A robust task proven: the lower side by the samples of its box, the upper one by a command that the checker follows over all of it."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from relaxations.bounds import NOT_PROVEN, Bound, Settings, Status, staircase
from relaxations.commands import Command, Tail
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem
from relaxations.repair import SNAP, repair, zoomed
from relaxations.robust.boxes import Listed
from relaxations.robust.search import Sampled, at_rest_at_once, keeps, minimum, within
from relaxations.sides import FINER, Proof, concluded, instant_proof, landed, lower_side

HELD = (2e-5, 6e-5, 3e-4)
"""How far beyond it a command may go that is to hold in a whole box."""

MANY = 3
"""So many parameters multiply the cells that a check looks at until it gives up: where it does so on one grid, no finer one is tried."""

SLOPED = 4
"""How many times as dense the grid is where the input's slope is limited: ramps begin and end between its nodes."""

SNAPS = (1e-4, 1e-5, 1e-6)

ROBUST = 1e-4
"""The gap that ends it."""


def robust_time(problem: Problem, task: dict[str, Any], settings: Settings, near: float | None, begun: float) -> Bound:
    """Both sides of a robust task, on finer and finer grids; `near` is a guess at its minimum time [s]."""
    if at_rest_at_once(problem):
        command, nothing = Command(0.0, (), Tail(problem.absolute(problem.hold))), np.zeros(0)
        found = Bound(Status.BRACKETED, 0.0, 0.0, nothing, command, 0, NOT_PROVEN, 0, 0.0)
        return concluded(task, instant_proof(problem, task, found), found, time.perf_counter() - begun)
    proof, found, count, trouble = Proof(), None, 0, ""
    settings = settings.finer(SLOPED) if problem.sloped else settings
    switched = not problem.courses and problem.rate is None  # nearly: but for the cells in which it changes
    for factor in FINER:
        finer = settings.finer(1 if switched else factor)
        try:
            if switched and found is not None and found.solution is not None:
                found = replace(found, shares=zoomed(found.solution) / found.solution.maneuver_time)
            found = minimum(problem, finer, found, near)
            count += found.programs
            if found.solution is None:
                break
            upper, tightened = _held(task, found, finer)
            count += tightened.programs
        except SolverError as met:
            trouble = str(met)
            break
        lower = lower_side(found.problem, task, found.solution, found.solution.maneuver_time)
        proof, found = proof.better(upper).better(Proof(lower)), replace(found, problem=tightened.problem, looks=tightened.looks)
        if proof.gap <= ROBUST or (proof.upper is None and (factor > 1 or _many(found.problem))):
            break
    dual = found and (found.solution or found.below)
    if dual is not None and not dual.reaches:
        trouble = f"no command was found: at T = {dual.maneuver_time:.6g} s the grid reaches {dual.fraction:.3g} of the target"
    reason = trouble or "no command found is proven to keep the tolerance between the plants that were looked at"
    command = None if found is None or found.solution is None else staircase(found.problem, found.solution)
    upper = None if command is None else command.maneuver_time
    costate = np.zeros(problem.size) if dual is None else dual.costate
    bound = Bound(Status.BRACKETED, 0.0, upper, costate, command, None, reason, count, 0.0, dual=dual)
    return sampled(concluded(task, proof, bound, time.perf_counter() - begun), problem)


def sampled(done: Bound, problem: Problem) -> Bound:
    """A bracket that is proven, of a box whose plants are known at some places only: both sides are about these."""
    box = problem.maneuver.box
    if done.status is not Status.PROVED or box is None or not isinstance(box.family, Listed):
        return done
    known = f"sampled: both sides are proven for the {len(box.family.plants)} plants of the box that are known"
    return replace(done, status=Status.BRACKETED, reason=f"{known}; the lower one holds for the whole box then, the upper one only there")


def _snap(found: Sampled) -> float:
    """The largest distance from a limit, of the range, at which levels may be put on it: the fewer there are, the less is to be checked."""
    assert found.solution is not None
    for snap in SNAPS:
        fixed = repair(found.solution, snap)
        if fixed is not None and keeps(found.problem, fixed):
            return snap
    return SNAP


def _many(posed: Problem) -> bool:
    """Whether a box has many parameters, and is no list of plants."""
    box = posed.maneuver.box
    return box is not None and len(box.axes) >= MANY and not isinstance(box.family, Listed)


def _held(task: dict[str, Any], found: Sampled, settings: Settings) -> tuple[Proof, Sampled]:
    """The upper side of a robust task: a command whose residual is proven over the whole box, as little beyond the minimum as works."""
    for beyond in HELD:
        found, clean = within(found, beyond, settings)
        assert found.solution is not None
        if clean and (proof := landed(found.problem, task, found.solution, _snap(found))) is not None:
            return proof, found
    return Proof(), found
