"""From a bracket in floating point to a theorem: certificates are proposed here, and count only when the checker accepts them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from relaxations import certificates, programs
from relaxations.bounds import Bound, Settings, Status, bracket, instants
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.duality import lower_bound
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem
from relaxations.repair import Repaired, repair

Reals = NDArray[np.float64]

MARGINS = (4e-15, 2e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Relative distance of a claim from the floating-point bound: the closest one that the checker accepts is claimed."""

RADII = (1e-10, 1e-8, 1e-12, 1e-6)
"""Radii of Krawczyk's test relative to the maneuver time."""

BEYOND = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""How far beyond the minimum time (relative) a repaired command may go."""


@dataclass(frozen=True, slots=True)
class Side:
    """A proven side: the claim and its witness."""

    claim: Fraction
    witness: dict[str, Any]


def minimum_time(problem: Problem, settings: Settings | None = None) -> Bound:
    """Bracket the least maneuver time and prove both sides where that is possible.

    The result is `PROVED` if the checker has accepted a certificate for both sides, `IMPOSSIBLE` if it has accepted one that no time
    suffices, else `BRACKETED` with the reason; a certificate then holds the side that was proven, if any. Raises `SolverError`.
    """
    begun = time.perf_counter()
    task = certificates.task(problem)
    for form in ("face", "remainder"):
        content = certificates.certificate(task, {"lower": None, "upper": None, "impossible": form}, None, None)
        if check(content).outcome is Outcome.PROVED:
            return Bound(Status.IMPOSSIBLE, 0.0, None, np.zeros(problem.size), None, None, None, 0, time.perf_counter() - begun, certificate=content)
    found = bracket(problem, settings)
    upper, command, switches, above = _upper(problem, task, found, settings or Settings())
    lower = _lower(problem, task, found, above)
    content = None
    if lower or upper:
        claim = {"lower": lower and certificates.text(lower.claim), "upper": upper and certificates.text(upper.claim), "impossible": None}
        content = certificates.certificate(task, claim, lower and lower.witness, upper and upper.witness)
        if check(content).outcome is not Outcome.PROVED:  # cannot be: both sides were accepted alone
            content, lower, upper = None, None, None
    missing = [name for name, side in (("lower", lower), ("upper", upper)) if side is None]
    reason = None if not missing else f"not proven: the {' and the '.join(missing)} side" + (f"; {found.reason}" if found.reason else "")
    return replace(
        found,
        status=Status.BRACKETED if missing else Status.PROVED,
        lower=_rounded(lower.claim, -np.inf) if lower else found.lower,
        upper=_rounded(upper.claim, np.inf) if upper else found.upper,
        command=command,
        switches=switches,
        reason=reason,
        seconds=time.perf_counter() - begun,
        certificate=content,
    )


def _rounded(exact: Fraction, towards: float) -> float:
    """The nearest double that is not on the unsafe side of an exact bound."""
    nearest = float(exact)
    unsafe = Fraction(nearest) > exact if towards < 0 else Fraction(nearest) < exact
    return float(np.nextafter(nearest, towards)) if unsafe else nearest


def _accepted(task: dict[str, Any], lower: Side | None = None, upper: Side | None = None) -> bool:
    claim = {"lower": lower and certificates.text(lower.claim), "upper": upper and certificates.text(upper.claim), "impossible": None}
    return check(certificates.certificate(task, claim, lower and lower.witness, upper and upper.witness)).outcome is Outcome.PROVED


def _lower(problem: Problem, task: dict[str, Any], found: Bound, above: programs.GridSolution | None) -> Side | None:
    """The best lower side: the refined costate, else those of the grid."""
    best: Side | None = None
    duals = [(found.costate, found.multipliers, found.price)]
    if above is not None and found.switches is None:
        duals.append((above.costate, above.tail_multipliers, above.price(problem)))
    if found.upper == 0.0:
        return Side(Fraction(0), certificates.costate_witness(problem, found.costate))
    for costate, multipliers, price in duals:
        near = found.upper if found.upper is not None else found.lower
        value = lower_bound(problem, costate, near, price)
        if value <= 0.0:
            continue
        witness = certificates.costate_witness(problem, costate, multipliers)
        for margin in MARGINS:
            side = Side(Fraction(value * (1.0 - margin)), witness)
            if best is not None and side.claim <= best.claim:
                break
            if _accepted(task, lower=side):
                best = side
                break
    return best


def _upper(
    problem: Problem, task: dict[str, Any], found: Bound, settings: Settings
) -> tuple[Side | None, Command | None, int | None, programs.GridSolution | None]:
    """The upper side: the refined command, else a repaired staircase; with the command, its switches, and the program it came from."""
    if found.command is None or found.upper is None:
        return None, found.command, found.switches, None
    if found.switches is not None:
        side = _refined(problem, task, found)
        if side is not None:
            return side, replace(found.command, maneuver_time=_rounded(side.claim, np.inf)), found.switches, None
    for beyond in BEYOND:
        horizon = found.upper * (1.0 + beyond)
        try:
            solution = programs.solve(programs.build(problem, instants(problem, horizon, settings)))
        except SolverError:
            continue
        if not solution.reaches:
            continue
        for fixed in _repaired(problem, solution):
            names = certificates.tail_unknowns(problem)
            free = [*(["level", i, 0] for i in fixed.free_levels), *(names[i] for i in fixed.free_tail)]
            tail = certificates.tail_chains(problem, fixed.tail)
            witness = certificates.command_witness(fixed.maneuver_time, fixed.starts, fixed.levels, tail, free, fixed.radius)
            side = Side(Fraction(fixed.maneuver_time), witness)
            if _accepted(task, upper=side):
                return side, _staircase(problem, fixed), None, solution
    return None, found.command, found.switches, None


def _repaired(problem: Problem, solution: programs.GridSolution) -> Iterator[Repaired]:
    for snap in (1e-7, 0.0):
        fixed = repair(problem, solution, snap)
        if fixed is not None:
            yield fixed


def _refined(problem: Problem, task: dict[str, Any], found: Bound) -> Side | None:
    """Exact switch times: the duration and as many switches as there are further equations are unknowns."""
    command = found.command
    assert command is not None and found.upper is not None
    count, starts = problem.size, np.array([s.start for s in command.segments])
    if command.maneuver_time == 0.0:
        return _instant(problem, task, found)
    if len(starts) + problem.tail.size < count:
        return None  # a degenerate optimum: fewer unknowns than equations
    lower, upper = problem.maneuver.limits.lower, problem.maneuver.limits.upper
    levels = [upper if s.level > float(lower + upper) / 2 else lower for s in command.segments]
    # As many unknowns as equations, the best conditioned ones; at an extremal the switches alone are singular, so the duration is one of
    # them, or a tail coefficient where the tail touches a limit.
    names: list[list[Any]] = [["time", 0, 0], *(["start", i, 0] for i in range(1, len(starts))), *certificates.tail_unknowns(problem)]
    jumps = np.diff([float(level - problem.maneuver.rest) for level in levels], prepend=0.0)
    slopes = found.upper * problem.rows(found.upper - starts) * jumps
    columns = np.hstack([slopes.sum(axis=1, keepdims=True), slopes[:, 1:], -problem.tail.columns * (float(np.abs(found.tail).max(initial=0.0)) or 1.0)])
    columns /= np.abs(columns).max(axis=1)[:, None]
    free = [names[i] for i in np.sort(qr(columns, pivoting=True, mode="r")[1][:count])]
    tail = certificates.tail_chains(problem, found.tail)
    for radius in RADII:
        witness = certificates.command_witness(found.upper, starts, levels, tail, free, radius * found.upper)
        for margin in MARGINS[:5]:
            side = Side(Fraction(found.upper * (1.0 + margin)), witness)
            if _accepted(task, upper=side):
                return side
    return None


def _instant(problem: Problem, task: dict[str, Any], found: Bound) -> Side | None:
    """T* = 0: a tail alone, from the first instant on."""
    tail = certificates.tail_chains(problem, found.tail)
    size = float(np.abs(found.tail).max())
    for radius in RADII:
        witness = certificates.command_witness(0.0, [], [], tail, certificates.tail_unknowns(problem), radius * size)
        side = Side(Fraction(0), witness)
        if _accepted(task, upper=side):
            return side
    return None


def _staircase(problem: Problem, fixed: Repaired) -> Command:
    segments = tuple(Segment(float(s), float(v)) for s, v in zip(fixed.starts, fixed.levels, strict=True))
    return Command(fixed.maneuver_time, segments, Tail(problem.absolute(problem.hold), problem.tail.terms(fixed.tail)))
