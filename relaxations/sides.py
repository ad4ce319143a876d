"""The sides of a bracket: what is proposed to the checker, and counts only when it accepts it.

A costate proposes a lower side, a program's solution, repaired, an upper one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations import certificates, programs
from relaxations.bounds import Bound, Settings, Status, extended, ramped
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.duality import Costate, lower_bound, slid
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem
from relaxations.presses import smoothed, touching
from relaxations.prices import Prices
from relaxations.refinement import Extremal
from relaxations.repair import SNAP, Repaired, exact, repair
from relaxations.sampling import MISSED

Reals = NDArray[np.float64]

FINER = (1, 4, 16, 64)
"""Factors of the grid's density, tried in turn while the gap is too wide."""

MARGINS = (2e-14, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Relative distance of a lower claim from the floating-point bound: the closest one that the checker accepts is claimed."""

FOLLOWED = (1e-8, 1e-7, 3e-7, 1e-6, 2e-6, 4e-6, 1e-5, 1e-4, 1e-3)
"""Those where the floating-point bound comes from a grid."""

RADII = (1e-22, 1e-14, 1e-10, 1e-8)
"""Radii of Krawczyk's test relative to the maneuver time."""


@dataclass(frozen=True, slots=True)
class Side:
    """A proven side: the claim and its witness."""

    claim: Fraction
    witness: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Proof:
    """What has been proven so far; the upper side with its command and number of switches (None: a staircase).

    `content` is the certificate of both sides, where they were proven together; `final` says that no finer grid finds a better upper side.
    """

    lower: Side | None = None
    upper: Side | None = None
    command: Command | None = None
    switches: int | None = None
    content: bytes | None = None
    final: bool = False

    @property
    def gap(self) -> float:
        """Relative width; infinite if a side is missing."""
        if self.lower is None or self.upper is None:
            return np.inf
        if self.lower.claim == self.upper.claim:
            return 0.0
        return float(self.upper.claim / self.lower.claim - 1) if self.lower.claim else np.inf

    def better(self, other: Proof) -> Proof:
        """The better side of each."""
        if self.lower is None and self.upper is None:
            return other
        lower = max((side for side in (self.lower, other.lower) if side), key=lambda side: side.claim, default=None)
        first = other.upper is None or (self.upper is not None and self.upper.claim <= other.upper.claim)
        above = self if first else other
        return Proof(lower, above.upper, above.command, above.switches, final=above.final)


def concluded(task: dict[str, Any], proof: Proof, found: Bound, seconds: float) -> Bound:
    """The bracket with what was proven of it."""
    lower, upper = proof.lower, proof.upper
    content = proof.content or (certificate(task, lower, upper) if lower or upper else None)
    missing = [name for name, side in (("lower", lower), ("upper", upper)) if side is None]
    reason = None if not missing else f"not proven: the {' and the '.join(missing)} side" + (f"; {found.reason}" if found.reason else "")
    return replace(
        found,
        status=Status.BRACKETED if missing else Status.PROVED,
        lower=rounded(lower.claim, -np.inf) if lower else found.lower,
        upper=rounded(upper.claim, np.inf) if upper else found.upper,
        command=proof.command if upper else found.command,
        switches=proof.switches if upper else found.switches,
        reason=reason,
        seconds=seconds,
        certificate=content,
    )


def closing(
    problem: Problem,
    task: dict[str, Any],
    settings: Settings,
    look: Callable[[Settings, float | None], Bound],
    prove: Callable[[Bound, Settings], Proof],
    enough: Callable[[int, Proof], bool],
    near: float | None,
    begun: float,
) -> Bound:
    """What is looked for and proven on finer and finer grids, until it is `enough` (factor of their density, proof) or no command is found.

    `near` is a guess at the minimum time [s]. Where the numerics fail altogether the bracket is [0, –].
    """
    proof, found, count, trouble = Proof(), None, 0, None
    for factor in FINER:
        finer = settings.finer(factor)
        try:
            looked = look(finer, found.upper if found else near)
        except SolverError as met:
            trouble = met
            continue
        count += looked.programs
        found = looked if found is None or (found.switches is None and looked.switches is not None) else found
        proof = proof.better(prove(looked, finer))
        if looked.upper is None or enough(factor, proof):
            break
    seconds = time.perf_counter() - begun
    if found is None:
        nothing = np.zeros(problem.size)
        return Bound(Status.BRACKETED, 0.0, None, nothing, None, None, f"no bracket was found: {trouble}", count, seconds)
    return concluded(task, proof, replace(found, programs=count), seconds)


def rounded(exact: Fraction, towards: float) -> float:
    """The nearest double that is not on the unsafe side of an exact bound."""
    nearest = float(exact)
    unsafe = Fraction(nearest) > exact if towards < 0 else Fraction(nearest) < exact
    return float(np.nextafter(nearest, towards)) if unsafe else nearest


def certificate(task: dict[str, Any], lower: Side | None, upper: Side | None) -> bytes:
    """The certificate of these sides."""
    claim = {"lower": lower and certificates.text(lower.claim), "upper": upper and certificates.text(upper.claim), "impossible": None}
    return certificates.certificate(task, claim, lower and lower.witness, upper and upper.witness)


def accepted(task: dict[str, Any], lower: Side | None = None, upper: Side | None = None) -> bytes | None:
    """The certificate of these sides, if the checker proves it."""
    content = certificate(task, lower, upper)
    return content if check(content).outcome is Outcome.PROVED else None


def lower_side(problem: Problem, task: dict[str, Any], dual: Extremal | programs.GridSolution | Costate, near: float) -> Side | None:
    """The lower side of a costate in doubles: the closest claim that is accepted."""
    whole, price = extended(problem, dual.costate, dual.tail_multipliers), dual.price(problem)
    value, prices = max(((lower_bound(*whole, near, price, one), one) for one in _variants(problem, dual, whole)), key=lambda pair: pair[0])
    witness = certificates.costate_witness(problem, problem.modal(dual.costate), dual.tail_multipliers, prices)
    followed = prices.pressed or prices.ramps  # p was integrated on a grid then
    margins = FOLLOWED if followed else MARGINS
    step, claims = problem.maneuver.sample_time, [Fraction(value * (1.0 - margin)) for margin in margins]
    if step is not None:
        claims = [problem.on_grid(value) - k * step for k in (0, 1)]
    for claim in claims if value > 0.0 else ():
        side = Side(claim, witness)
        if accepted(task, lower=side):
            return side
    return None


def _variants(problem: Problem, dual: Extremal | programs.GridSolution | Costate, whole: tuple[Problem, Reals]) -> Iterator[Prices]:
    """The multipliers as they are; those of a grid with its pattern taken out of them too: any are valid."""
    yield dual.prices
    if not isinstance(dual, programs.GridSolution) or problem.maneuver.sample_time is not None:
        return
    cell = float(np.diff(dual.program.instants).max())
    smooth = replace(dual.prices, pressed=smoothed(dual.prices.pressed)) if dual.prices.pressed else dual.prices
    touched = replace(dual.prices, pressed=touching(dual.prices.pressed)) if dual.prices.pressed else dual.prices
    if dual.prices.pressed:
        yield smooth
        yield touched
    if dual.prices.ramps:
        yield slid(*whole, dual.maneuver_time, dual.prices, cell)
    if dual.prices.ramps and dual.prices.pressed:
        yield slid(*whole, dual.maneuver_time, smooth, cell)
        yield slid(*whole, dual.maneuver_time, touched, cell)


def landed(problem: Problem, task: dict[str, Any], solution: programs.GridSolution, snap: float = SNAP) -> Proof | None:
    """The upper side of a program's solution, repaired; None if that is not accepted."""
    tie = problem.maneuver.sample_time is not None and solution.fraction > 1.0 - MISSED  # the minimum may be a whole number of samples
    fixed = (exact(solution) if tie else None) or (repair(solution, snap) if solution.reaches else None)
    if fixed is None:
        return None
    names = certificates.tail_unknowns(problem)
    free = [*(["level", i, 0] for i in fixed.free_levels), *(names[i] for i in fixed.free_tail)]
    tail = certificates.tail_chains(problem, fixed.tail)
    duration, starts = problem.on_grid(fixed.maneuver_time), [problem.on_grid(start) for start in fixed.starts]
    witness = certificates.command_witness(duration, starts, fixed.levels, tail, free, fixed.radius)
    side = Side(duration, witness)
    return Proof(None, side, staircase_of(problem, fixed)) if accepted(task, upper=side) else None


def instant_proof(problem: Problem, task: dict[str, Any], found: Bound) -> Proof:
    """T* = 0: a tail alone, from the first instant on; that no time is less than 0 needs no costate."""
    tail = certificates.tail_chains(problem, found.tail)
    size = float(np.abs(found.tail).max(initial=0.0)) or 1.0
    lower = Side(Fraction(0), certificates.costate_witness(problem, found.costate))
    for radius in RADII[2:]:
        side = Side(Fraction(0), certificates.command_witness(0.0, [], [], tail, certificates.tail_unknowns(problem), radius * size))
        if accepted(task, lower, side):
            return Proof(lower, side, found.command, 0)
    return Proof(lower)


def staircase_of(problem: Problem, fixed: Repaired) -> Command:
    """The command of a repaired solution, in doubles."""
    if problem.sloped:
        levels = np.array([float(level - problem.maneuver.rest) for level in fixed.levels])
        return ramped(problem, np.append(fixed.starts, fixed.maneuver_time), levels, fixed.tail)
    segments = tuple(Segment(float(s), float(v)) for s, v in zip(fixed.starts, fixed.levels, strict=True))
    duration = rounded(problem.on_grid(fixed.maneuver_time), np.inf)
    return Command(duration, segments, Tail(problem.absolute(problem.hold), problem.tail.terms(fixed.tail)))
