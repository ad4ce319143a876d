"""Sequences of one mode whose partial sums switch between two bounds, at any damping: no grid, both sides proven.

Zero vibration and n derivatives of it take 2n + 3 impulses `u, l - u, u - l, …, 1 - l` for partial sums in [l, u]; with 0 and 1 these are
1, -1, 1 …. Undamped they are known from programs, or for many derivatives from Newton's method that begins where fewer derivatives point
to; from there they are followed in damping in as many digits as it takes (relaxations.shaping.paths). That such a sequence is the shortest
within its bounds is proven as for any command (`relaxations.proofs.extremal_bound`): where doubles do not tell its impulses apart, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import flint
import numpy as np
from flint import arb, fmpq

from relaxations.bounds import Bound
from relaxations.errors import ShaperError, SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import exact, precision, rational
from relaxations.proofs import extremal_bound, minimum_time
from relaxations.refinement import Extremal
from relaxations.shaping.amplitudes import decay_per_radian, left_in_half_a_period
from relaxations.shaping.commanded import plant_of, shaper_of
from relaxations.shaping.decayed import DECAYED, points_of
from relaxations.shaping.depths import widened
from relaxations.shaping.dips import Dip, drawn_apart, too_close
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import CLOSED, Point, Vector, followed, ordered, solved
from relaxations.shaping.ripples import MultipleZero
from relaxations.shaping.shapers import Shaper

MOST = 20  # derivatives: with more fewer ones point elsewhere
SOME = 0.25  # damping from which on many derivatives are found from points, fewer steps away than undamped ones
PROGRAMMED = 6  # derivatives up to which programs in doubles find the undamped sequence
BITS, BITS_PER_DERIVATIVE = 256, 16
MOST_BITS = 1000  # a step of Newton's method smaller than by so many is no double
SOFT = 12.0  # how fast, on the way to the middle, one guess gives way to the other


@dataclass(frozen=True, slots=True)
class Switched:
    """Phases ψ before the last impulse (balls, the last is 0), and the impulses' sizes."""

    phases: tuple[arb, ...]
    given: tuple[fmpq, ...]


def switched(mode: Mode, lower: Fraction, upper: Fraction, derivatives: int) -> tuple[Shaper, Bound]:
    """The sequence within the bounds, and the bracket of its duration [s].

    Raises `ShaperError` for more than `MOST` derivatives, `SolverError` where it was not found.
    """
    if derivatives > MOST:
        raise ShaperError(f"{derivatives} derivatives: up to {MOST} are possible with negative impulses, zv-d:N takes any number")
    with precision(BITS + BITS_PER_DERIVATIVE * derivatives):
        found = phases_of(mode.damping, lower, upper, derivatives)
        shaper = in_doubles(mode, [(mode, derivatives)], found.phases, found.given)
        return shaper, _proven(mode, lower, upper, derivatives, found)


def phases_of(damping: float, lower: Fraction, upper: Fraction, derivatives: int) -> Switched:
    """At the precision that is set. Raises `SolverError`."""
    given = _sizes(lower, upper, derivatives)
    system = MultipleZero(given)
    if upper == 1 and left_in_half_a_period(damping) < DECAYED:
        end = _from_points(system, damping, derivatives, 1 - lower)
    else:
        end = _from_depths(system, damping, derivatives, 1 - lower) if upper == 1 and derivatives > PROGRAMMED and damping > SOME else None
        if end is None:
            start = solved(system, [*map(arb, _undamped(lower, upper, derivatives)[:-1]), arb(0)], None, CLOSED)
            end = None if start is None else Point(start[:-1], arb(0), True)
            if damping and start is not None:
                end = followed(system, start[:-1], arb(0), arb(damping), ordered)
    if end is None or not end.goal:
        written = "impulses 1, -1, 1 …" if (lower, upper) == (0, 1) else f"impulses of partial sums {float(lower):g} and {float(upper):g}"
        raise SolverError(f"{written} with {derivatives} derivative(s) were not found at damping {damping!r}; fewer are possible")
    return Switched((*end.x, arb(0)), given)


def _from_points(system: MultipleZero, damping: float, derivatives: int, depth: Fraction) -> Point | None:
    """Dips so narrow that they are all but points (relaxations.shaping.decayed), in as many digits as tell them."""
    folds = (derivatives + 1) * math.pi * decay_per_radian(damping)
    bits = max(flint.ctx.prec, BITS + math.ceil(4.0 * folds / math.log(2.0)))
    with precision(bits):
        points, sizes = points_of(damping, derivatives)
        zeta = arb(damping)
        root = (1 - zeta * zeta).sqrt()
        edges: Vector = []
        for point, size in zip(points, sizes, strict=True):
            half = size * (-zeta / root * point).exp() / rational(depth) / 2
            edges += [point - half, point + half]
        phases = [edges[-1] / root, *((edges[-1] - edge) / root for edge in edges[:-1])]
        found = solved(system, [*phases, zeta], None, 2.0 ** -min(bits / 2, MOST_BITS))
        return None if found is None or not ordered(found[:-1]) else Point(found[:-1], zeta, True)


def _from_depths(system: MultipleZero, damping: float, derivatives: int, depth: Fraction) -> Point | None:
    """From points, which are known at any but small damping, by the dips' depth; None where they are not followed."""
    folds = (derivatives + 1) * math.pi * decay_per_radian(damping)
    bits = max(flint.ctx.prec, BITS + 4 * BITS_PER_DERIVATIVE * derivatives + math.ceil(4.0 * folds / math.log(2.0)))
    with precision(bits), suppress(SolverError):
        zeta = arb(damping)
        root = (1 - zeta * zeta).sqrt()
        points, sizes = points_of(damping, derivatives)
        integrals = [size * (-zeta / root * point).exp() / root for point, size in zip(points, sizes, strict=True)]
        dips = widened([(Mode(1.0, damping), derivatives)], [point / root for point in points], integrals, depth)
        edges = [edge for dip in dips for edge in dip]
        phases = [edges[-1], *(edges[-1] - edge for edge in edges[:-1])]
        found = solved(system, [*phases, zeta], None, CLOSED)
        return None if found is None or not ordered(found[:-1]) else Point(found[:-1], zeta, True)
    return None


def in_doubles(mode: Mode, zeros: Sequence[tuple[Mode, int]], phases: Sequence[arb], given: Sequence[fmpq | int]) -> Shaper:
    """Impulses at phases ψ before the last one; where some follow each other closer than doubles tell they are drawn apart."""
    dips = dips_of(mode, phases)
    if given[0] == 1 and too_close(dips):
        with suppress(SolverError):
            return drawn_apart(zeros, dips, -given[1])
    return as_doubles(mode, phases, given)


def dips_of(mode: Mode, phases: Sequence[arb]) -> list[Dip]:
    """From the second to the third impulse, from the fourth to the fifth …: there partial sums that begin at 1 lie lower."""
    instants = [(phases[0] - phase) / arb(mode.frequency) for phase in phases[1:]]
    return list(zip(instants[::2], instants[1::2], strict=True))


def as_doubles(mode: Mode, phases: Sequence[arb], amplitudes: Sequence[arb | fmpq | int]) -> Shaper:
    """Impulses at phases ψ before the last one. Near critical damping some follow each other closer than doubles tell: they are one."""
    pairs: dict[float, float] = {}
    for phase, amplitude in zip(phases, amplitudes, strict=True):
        time = float((phases[0] - phase) / mode.frequency)
        pairs[time] = pairs.get(time, 0.0) + float(arb(amplitude))
    last = max(pairs)  # it stays, whatever is left of it: the residual is what is left then
    kept = {time: amplitude for time, amplitude in pairs.items() if amplitude or time == last}
    return Shaper(tuple(kept), tuple(kept.values()))


def _sizes(lower: Fraction, upper: Fraction, derivatives: int) -> tuple[fmpq, ...]:
    first, reach, last = (rational(x) for x in (upper, upper - lower, 1 - lower))
    return (first, *(reach if k % 2 else -reach for k in range(2 * derivatives + 1)), last)


@lru_cache(maxsize=64)
def _undamped(lower: Fraction, upper: Fraction, derivatives: int) -> tuple[float, ...]:
    if derivatives > PROGRAMMED:
        return _pointed_to(lower, upper, derivatives)
    found = minimum_time(problem([plant_of([Mode(1.0)])], Maneuver(exact(1), Limits.of(lower, upper), robustness=derivatives)))
    times = [] if found.command is None else list(shaper_of(found.command).times)
    if len(times) != 2 * derivatives + 3:
        raise SolverError(f"undamped impulses of {derivatives} derivatives with partial sums in [{lower}, {upper}] were not found")
    return tuple(times[-1] - t for t in times)


def _pointed_to(lower: Fraction, upper: Fraction, derivatives: int) -> tuple[float, ...]:
    """Where fewer derivatives point to: one derivative more puts two impulses into the middle.

    Seen from the beginning those of each number continue those of the one before, seen from the middle those of the last but one. The
    second impulse comes closer to the first by nearly the same factor each time.
    """
    one, two, three, four = (_undamped(lower, upper, derivatives - k) for k in (1, 2, 3, 4))
    begun = [[times[0] - t for t in times] for times in (one, two, three, four)]
    half = derivatives + 1
    middle = 2.0 * begun[1][half - 2] - begun[3][half - 4]
    times = [0.0, begun[0][1] ** 2 / begun[2][1]]
    for k in range(2, half + 1):
        first = 2.0 * begun[0][k] - begun[2][k] if k <= derivatives - 2 else 0.0
        from_middle = half - k
        last = 0.0
        if from_middle <= derivatives - 3:
            near, far = (begun[i][half - less] - begun[i][half - less - from_middle] for i, less in ((1, 2), (3, 4)))
            last = middle - (2.0 * near - far)
        share = 1.0 if k > derivatives - 2 else 0.0 if from_middle > derivatives - 3 else 1.0 / (1.0 + math.exp(-SOFT * (k / half - 0.5)))
        times.append((1.0 - share) * first + share * last)
    times += [2.0 * middle - t for t in reversed(times[:-1])]
    aim = [arb(times[-1] - t) for t in times[:-1]]
    found = solved(MultipleZero(_sizes(lower, upper, derivatives)), [*aim, arb(0)], None, CLOSED)
    if found is None or not ordered(found[:-1]):
        raise SolverError(f"impulses with {derivatives} derivatives were not found; fewer are possible")
    return (*map(float, found[:-1]), 0.0)


def _proven(mode: Mode, lower: Fraction, upper: Fraction, derivatives: int, found: Switched) -> Bound:
    posed = problem([plant_of([mode])], Maneuver(exact(1), Limits.of(lower, upper), robustness=derivatives))
    to_go = [phase / arb(mode.frequency) for phase in reversed(found.phases[:-1])]
    arcs = len(to_go)
    levels = np.array([posed.lower if k % 2 else posed.upper for k in range(arcs)][::-1])
    extremal = Extremal(posed, float(to_go[-1]), np.array([float(t) for t in to_go[:-1]]), levels, np.zeros(posed.size), 0.0, 0)
    return extremal_bound(posed, extremal, to_go)
