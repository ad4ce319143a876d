"""Pulses of one height and variable duration, as an actuator makes them that is on or off (Singer and Seering, claims 3 to 6).

A sequence of pulses u(t), 0 ≤ u ≤ a, of integral 1 that leaves modes at rest is a command from rest to rest of the plant
`1/s ∏ ω²/(s² + 2ζωs + ω²)`, displacement 1: its fastest one is on-off, and `relaxations.proofs.minimum_time` finds and proves it. Pulses
that begin at given intervals only need more time: their durations solve the same equations, on as few intervals as were found to do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import fmpq_poly
from numpy.typing import NDArray
from scipy.optimize import least_squares

from relaxations.bounded_shapers import plant_of
from relaxations.bounds import Bound
from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact, fraction
from relaxations.proofs import minimum_time
from relaxations.shaper_modes import Mode
from relaxations.shapers import Pulse, Shaper

Reals = NDArray[np.float64]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)  # of an interval, which is shorter than half a period
CLOSED = 1e-11  # of equations of order one
SHORTEST = 1e-9  # of an interval: a pulse that is none
MORE, MOST = 12, 400  # intervals beyond the fewest that are tried, and intervals at all


@dataclass(frozen=True, slots=True)
class PulseShaper:
    """A shaper, and the proof of the least duration of such pulses: `bound.lower` [s]."""

    shaper: Shaper
    bound: Bound


def pulsed(modes: Sequence[Mode], height: float, derivatives: int = 0) -> PulseShaper:
    """The shortest sequence of pulses of one `height` [1/s] with zero vibration and `derivatives` of it at every mode.

    Raises `ShaperError` for a height that is not positive, or if no sequence was found.
    """
    if not modes:
        raise ShaperError("a shaper needs at least one mode")
    if not 0.0 < height < math.inf:
        raise ShaperError(f"the height of a pulse is positive and finite, not {height!r} 1/s")
    flexible = plant_of(modes)
    low = flexible.numerators[flexible.output].coeffs()[0]
    denominator = [fraction(c) for c in reversed((flexible.denominator * fmpq_poly([0, 1])).coeffs())]
    plant = LinearPlant.from_transfer([fraction(low)], denominator)
    limits = Limits.of(0, exact(repr(height)))
    bound = minimum_time(problem([plant], Maneuver(Fraction(1), limits, robustness=derivatives)))
    if bound.command is None:
        raise ShaperError(f"no pulses of height {height!r} 1/s were found: {bound.reason or bound.status.value}")
    starts = [segment.start for segment in bound.command.segments]
    ends = [*starts[1:], bound.command.maneuver_time]
    # A repaired command holds a level in between where an on-off one would switch: its pulses have the heights that it has.
    on = [(s.start, end, s.level) for s, end in zip(bound.command.segments, ends, strict=True) if s.level > 1e-9 * height]
    first = on[0][0]
    area = math.fsum((end - start) * level for start, end, level in on)
    return PulseShaper(Shaper((), (), (), tuple(Pulse(a - first, b - a, level / area) for a, b, level in on)), bound)


def at_intervals(modes: Sequence[Mode], height: float, interval: float, derivatives: int = 0) -> PulseShaper:
    """Pulses of one `height` [1/s] that begin at multiples of `interval` [s] and last as long as each needs, at most until the next begins.

    Raises `ImpossibleShaperError` for intervals longer than half a period, `ShaperError`, `SolverError` if none were found.
    """
    if not 0.0 < interval < math.inf:
        raise ShaperError(f"an interval is positive and finite, not {interval!r} s")
    if coarse := [mode.half_period for mode in modes if interval > mode.half_period]:
        raise ImpossibleShaperError(f"pulses every {interval!r} s are too coarse: half a damped period is {min(coarse):.6g} s")
    free = pulsed(modes, height, derivatives)
    fewest = max(math.ceil(free.bound.lower / interval - 1e-9), 1)
    if fewest > MOST:
        raise ShaperError(f"{fewest} intervals of {interval!r} s are more than {MOST}; longer intervals or higher pulses need fewer")
    for count in range(fewest, min(fewest + MORE, MOST) + 1):
        widths = _widths(modes, height, interval, derivatives, count)
        if widths is not None:
            kept = np.flatnonzero(widths > SHORTEST * interval)
            first = kept[0] * interval
            area = float(widths[kept].sum()) * height
            pulses = tuple(Pulse(float(k * interval - first), float(widths[k]), height / area) for k in kept)
            return PulseShaper(Shaper((), (), (), pulses), free.bound)
    raise SolverError(f"no pulses on {fewest} to {fewest + MORE} intervals of {interval!r} s were found; others may do")


def _widths(modes: Sequence[Mode], height: float, interval: float, derivatives: int, count: int) -> Reals | None:
    """How long each of `count` pulses lasts, or None if no solution was found."""
    unit, end = modes[0].half_period, count * interval

    def rows(since: Reals) -> Reals:
        """Each condition's integrand at instants since the end (any shape), real parts and imaginary parts, shape (equations, …)."""
        table = [np.ones_like(since)]
        for mode in modes:
            for power in range(derivatives + 1):
                z = (since / end) ** power * np.exp(mode.frequency * mode.direction * since)
                table += [z.real, z.imag]
        return np.array(table)

    starts = np.arange(count) * interval - end

    def equations(widths: Reals) -> Reals:
        at = starts[:, None] + widths[:, None] * (NODES + 1.0) / 2.0
        total = (rows(at) * (WEIGHTS / 2.0)).sum(axis=2) @ widths * height
        total[0] -= 1.0
        total[1:] *= unit / end
        return total

    def jacobian(widths: Reals) -> Reals:
        table = rows(starts + widths) * height
        table[1:] *= unit / end
        return table

    if count * interval * height < 1.0:
        return None
    even = np.full(count, 1.0 / (count * height))
    found = least_squares(equations, even, jac=jacobian, bounds=(0.0, interval * (1.0 + 1e-12)), xtol=1e-15, ftol=1e-15, gtol=1e-15)  # type: ignore[arg-type]
    widths = np.clip(found.x, 0.0, interval)
    for _ in range(8):  # to rounding, with those that are at neither end
        inner = (widths > SHORTEST * interval) & (widths < interval * (1.0 - SHORTEST))
        missed = equations(widths)
        if np.abs(missed).max() <= CLOSED:
            return widths
        step = np.linalg.lstsq(jacobian(widths)[:, inner], -missed, rcond=None)[0]
        widths[inner] = np.clip(widths[inner] + step, 0.0, interval)
    return None
