"""Pulses of one height and variable duration, as an actuator makes them that is on or off (Singer and Seering, claims 3 to 6).

A sequence of pulses u(t), 0 ≤ u ≤ a, of integral 1 that leaves modes at rest is a command from rest to rest of the plant
`1/s ∏ ω²/(s² + 2ζωs + ω²)`, displacement 1: its fastest one is on-off, and `relaxations.proofs.minimum_time` finds and proves it. Pulses
that begin at given intervals only need more time: their durations solve the same equations, on as few intervals as do
(relaxations.shaping.pulse_intervals). Where modes decay much meanwhile the pulses are followed from impulses
(relaxations.shaping.narrow_pulses).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from flint import fmpq_poly

from relaxations.bounds import Status
from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact, fraction
from relaxations.proofs import minimum_time
from relaxations.shaping.at_once import decaying
from relaxations.shaping.bounded import MOST_EQUATIONS
from relaxations.shaping.commanded import plant_of
from relaxations.shaping.modes import Mode
from relaxations.shaping.narrow_pulses import PulseShaper, narrow_pulses
from relaxations.shaping.pulse_intervals import SHORTEST, Pulses, search
from relaxations.shaping.shapers import Pulse, Shaper
from relaxations.shaping.vanishing import require_told

HIGHEST = 1e8  # of a height, in pulses of the fastest mode's half period: instants are rounded to 1e-16 of it
WELL_TOLD, MOST_FOLDS = 4.0, 16.0  # of decay while impulses last: with more they are followed; programs in doubles tell so much
NEAR = 1e-6  # relative: so near its lower bound a sequence is the shortest
MORE, MOST = 12, 400  # intervals beyond the fewest that are tried, and intervals at all
MOST_BOXES = 1200  # of widths that are looked at, of all numbers of pulses


def pulsed(modes: Sequence[Mode], height: float, derivatives: int = 0) -> PulseShaper:
    """The shortest sequence of pulses of one `height` [1/s] with zero vibration and `derivatives` of it at every mode.

    Raises `ShaperError` for a height that is not positive or beyond what doubles hold, `SolverError` if no sequence was found.
    """
    if not modes:
        raise ShaperError("a shaper needs at least one mode")
    if not 0.0 < height < math.inf:
        raise ShaperError(f"the height of a pulse is positive and finite, not {height!r} 1/s")
    if height * min(mode.half_period for mode in modes) > HIGHEST:
        raise ShaperError(
            f"pulses of {height!r} 1/s last less than {1.0 / HIGHEST:g} of half a period, which instants in doubles do not hold; up to "
            f"{HIGHEST / min(mode.half_period for mode in modes):.4g} 1/s do, and impulses (zv) beyond"
        )
    if (equations := 2 * len(modes) * (derivatives + 1)) > MOST_EQUATIONS:
        raise ShaperError(
            f"{derivatives} derivatives of {len(modes)} mode(s) are {equations} equations at once; up to {MOST_EQUATIONS} are possible, "
            "and zv-d:N with --pulse, pulses of one width, takes any number"
        )
    followed, trouble = None, None
    if decaying([(mode, derivatives) for mode in modes]) > WELL_TOLD:
        try:
            followed = narrow_pulses(modes, height, derivatives)
        except SolverError as problem:
            trouble = problem
        if followed is not None and (followed.lower or 0.0) >= (1.0 - NEAR) * followed.shaper.duration:
            return followed
    try:
        require_told(modes, derivatives, MOST_FOLDS)
        return _fastest(modes, height, derivatives)
    except SolverError:
        if followed is not None:
            return followed
        if trouble is not None:
            raise trouble from None
        raise


def _fastest(modes: Sequence[Mode], height: float, derivatives: int) -> PulseShaper:
    """As a command's."""
    flexible = plant_of(modes)
    low = flexible.numerators[flexible.output].coeffs()[0]
    denominator = [fraction(c) for c in reversed((flexible.denominator * fmpq_poly([0, 1])).coeffs())]
    plant = LinearPlant.from_transfer([fraction(low)], denominator)
    limits = Limits.of(0, exact(repr(height)))
    bound = minimum_time(problem([plant], Maneuver(Fraction(1), limits, robustness=derivatives)))
    if bound.command is None:
        raise SolverError(f"no pulses of height {height!r} 1/s were found: {bound.reason or bound.status.value}")
    starts = [segment.start for segment in bound.command.segments]
    ends = [*starts[1:], bound.command.maneuver_time]
    # A repaired command holds a level in between where an on-off one would switch: its pulses have the heights that it has.
    on = [(s.start, end, s.level) for s, end in zip(bound.command.segments, ends, strict=True) if s.level > 1e-9 * height]
    first = on[0][0]
    area = math.fsum((end - start) * level for start, end, level in on)
    shaper = Shaper((), (), (), tuple(Pulse(a - first, b - a, level / area) for a, b, level in on))
    return PulseShaper(shaper, bound.lower if bound.status is Status.PROVED else None)


def at_intervals(modes: Sequence[Mode], height: float, interval: float, derivatives: int = 0) -> PulseShaper:
    """Pulses of one `height` [1/s] that begin at multiples of `interval` [s] and last as long as each needs, at most until the next begins.

    On as few intervals as do; `intervals` says how many are proven to be needed. Raises `ImpossibleShaperError` for intervals longer than
    half a period, `ShaperError`, `SolverError` if none were found.
    """
    if not 0.0 < interval < math.inf:
        raise ShaperError(f"an interval is positive and finite, not {interval!r} s")
    if coarse := [mode.half_period for mode in modes if interval > mode.half_period]:
        raise ImpossibleShaperError(f"pulses every {interval!r} s are too coarse: half a damped period is {min(coarse):.6g} s")
    require_told(modes, derivatives, MOST_FOLDS)
    free = pulsed(modes, height, derivatives)
    least = free.lower or free.shaper.duration
    fewest = max(math.ceil(least / interval - 1e-9), 1)
    if fewest > MOST:
        raise ShaperError(f"{fewest} intervals of {interval!r} s are more than {MOST}; longer intervals or higher pulses need fewer")
    needed = 0 if free.lower is None else math.ceil(Fraction(free.lower) / exact(repr(interval)))
    boxes, count = 0, fewest
    while count <= min(fewest + MORE, MOST) and boxes <= MOST_BOXES:
        found = search(Pulses(tuple(modes), height, interval, derivatives, count))
        if found.refuted:
            needed = count + 1
        if found.widths is not None:
            kept = np.flatnonzero(found.widths > SHORTEST * interval)
            first = kept[0] * interval
            area = float(found.widths[kept].sum()) * height
            pulses = tuple(Pulse(float(k * interval - first), float(found.widths[k]), height / area) for k in kept)
            return PulseShaper(Shaper((), (), (), pulses), free.lower, needed)
        boxes, count = boxes + found.boxes, count + 1
    raise SolverError(
        f"no pulses on {fewest} to {count - 1} intervals of {interval!r} s were found; shorter intervals may do, or a larger height, and "
        f"{free.shaper.duration:.6g} s without --sample-time"
    )
