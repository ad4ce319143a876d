"""Deflection-limited shapers: the shaped step is spread so that no mode strays from it by more than a limit while it lasts.

A mode that is commanded to follow u deflects by |y - u|, y its response `ω²/(s² + 2ζωs + ω²) u`: by 1 under a unit step, by 1/2 under a ZV
shaper's. On instants kh the amplitudes of the shortest sequence with a smaller limit are a linear program: zero vibration and derivatives,
partial sums within bounds, the deflection within its limit just before and just after every instant. The least number of samples is found
by bisection, for waiting costs nothing. That the limit holds between the instants too is proven (relaxations.checking.deflections), and
that fewer samples do not do by the multipliers of the least excess over the conditions (relaxations.checking.sampled_deflections).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.checking.deflections import Deflection, largest_deflection
from relaxations.checking.sampled_deflections import Asked, Left, Strayed, none_on_samples
from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.fewest import fewest
from relaxations.shaping.modes import Mode
from relaxations.shaping.sampled_sums import amplitudes_within, on_samples
from relaxations.shaping.sensitivity import step_response
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

PER_HALF_PERIOD = 24  # samples of the fastest mode's half period, unless a sample time is given
INSIDE = 2e-3  # of the limit: how much closer it is kept on the instants, for what lies between them
MOST_SAMPLES = 600
LONGER = 1.25  # times as many samples are tried next
ZERO = 1e-9  # of a multiplier that is none
NO_EXCESS = 1e-7  # of equations of order one: with less nothing is refuted
LESS = (1, 2, 3, 5, 8, 13)  # samples fewer than found that are tried to be refuted


@dataclass(frozen=True, slots=True)
class Limited:
    """A shaper on samples of `step` [s], of which it is proven that at least so many are `needed` (0: nothing was proven)."""

    shaper: Shaper
    step: float
    needed: int


def deflection(shaper: Shaper, mode: Mode) -> Deflection:
    """The largest |y - u| of the mode under the shaped unit step, enclosed over all instants."""
    times, amplitudes, order = shaper.exact_excitation
    return largest_deflection(times, amplitudes, exact(repr(mode.frequency)), exact(repr(mode.damping)), order)


def deflection_limited(
    modes: Sequence[Mode], limit: float, sums: tuple[float, float] = (0.0, 1.0), derivatives: int = 0, sample_time: float | None = None
) -> Limited:
    """The shaper of fewest samples whose step deflects no mode by more than `limit`, *proven*, with zero vibration and `derivatives` of it.

    Raises `ShaperError` for a limit that is not positive, `ImpossibleShaperError` for samples that are too coarse, `SolverError`.
    """
    if not modes:
        raise ShaperError("a shaper needs at least one mode")
    if not 0.0 < limit < math.inf:
        raise ShaperError(f"a limit of deflection is a positive fraction of that under an unshaped step, not {limit!r}")
    fastest = min(mode.half_period for mode in modes)
    step = min(_scale(mode) for mode in modes) / PER_HALF_PERIOD if sample_time is None else sample_time
    if step > fastest / 2.0:
        raise ImpossibleShaperError(
            f"a sample time of {step!r} s is too coarse to see how far a mode is deflected; at most {fastest / 2.0:.6g} s would do, "
            "a quarter of the fastest mode's damped period"
        )
    slowest = max(mode.half_period for mode in modes)
    least = max(math.ceil(slowest / step / 4.0), 2)
    if 2 * least > MOST_SAMPLES:
        raise ShaperError(
            f"samples of {step:.4g} s are {slowest / step:.4g} in half a period of the slowest mode; at most {MOST_SAMPLES} in all are "
            f"searched, so a sample time from {slowest / MOST_SAMPLES:.4g} s on"
        )
    # An impulse deflects every mode by its own size: the limit holds before and after it, so none is larger than twice the limit.
    if 1.0 / (2.0 * limit) > MOST_SAMPLES:
        raise ShaperError(
            f"a deflection of {limit!r} takes {1.0 / (2.0 * limit):.4g} impulses at least, for none may be larger than twice the limit; "
            f"up to {MOST_SAMPLES} are searched, so limits from {1.0 / (2.0 * MOST_SAMPLES):.2g} on are possible"
        )
    found = fewest(lambda samples: _kept(modes, limit, sums, derivatives, step, samples), 2 * least, MOST_SAMPLES, LONGER, least)
    if found is None:
        raise SolverError(
            f"no shaper was found on up to {MOST_SAMPLES} samples of {step:.6g} s for a deflection of {limit!r}; a longer sample "
            "time or a larger limit needs fewer, and with much damping fewer derivatives may be possible"
        )
    high, shaper = found
    fewer = (high - less for less in LESS if high - less >= 1)
    needed = next((count + 1 for count in fewer if _refuted(modes, limit, sums, derivatives, step, count)), 0)
    return Limited(shaper, step, needed)


def _scale(mode: Mode) -> float:
    """Half a period [s], damped; of a mode of much damping, which hardly turns, that of the undamped one twice."""
    return min(mode.half_period, 2.0 * math.pi / mode.frequency)


def _kept(modes: Sequence[Mode], limit: float, sums: tuple[float, float], derivatives: int, step: float, samples: int) -> Shaper | None:
    """On so many samples, None if there is none; the limit is proven to hold between the instants too."""
    instants = step * np.arange(samples + 1)
    after, before = np.tri(samples + 1), np.tri(samples + 1, k=-1)
    moved = [np.array([step_response([t], [1.0], m.frequency, m.damping, instants) for t in instants]).T for m in modes]
    strays = np.vstack([y - u for y in moved for u in (after, before)])
    amplitudes = amplitudes_within(modes, sums, derivatives, step, samples, (strays, limit * (1.0 - INSIDE)))
    if amplitudes is None:
        return None
    shaper = on_samples(amplitudes, step)
    return shaper if all(deflection(shaper, mode).upper <= limit for mode in modes) else None


def _refuted(modes: Sequence[Mode], limit: float, sums: tuple[float, float], derivatives: int, step: float, samples: int) -> bool:
    """Whether it is proven that no sequence on so many samples keeps the limit on them and leaves nothing."""
    count, instants = samples + 1, step * np.arange(samples + 1)
    since = instants - instants[-1]
    powers = [(number, power) for number in range(len(modes)) for power in range(derivatives + 1)]
    rows = []
    for number, power in powers:
        z = (since / instants[-1]) ** power * np.exp(modes[number].frequency * modes[number].direction * since)
        rows += [z.real, z.imag]
    after, before = np.tri(count), np.tri(count, k=-1)
    looks, strays = [], []
    for number, mode in enumerate(modes):
        moved = np.array([step_response([t], [1.0], mode.frequency, mode.damping, instants) for t in instants]).T
        for later, u in ((True, after), (False, before)):
            looks += [(number, sample, later) for sample in range(count)]
            strays.append((moved - u) * u)
    # Impulses from partial sums: A_k = S_k - S_{k-1}, and S_n = 1.
    table = np.vstack([*rows, *strays])
    linear, constant = table[:, :-1] - table[:, 1:], table[:, -1]
    room = np.concatenate([np.zeros(len(rows)), np.full(len(looks), limit)])
    found = linprog(
        np.append(np.zeros(samples), 1.0),
        A_ub=np.hstack([np.vstack([linear, -linear]), -np.ones((2 * len(linear), 1))]),
        b_ub=np.concatenate([room - constant, room + constant]),
        bounds=[sums] * samples + [(0.0, None)],
        method="highs",
    )
    if found.status != 0 or found.fun <= NO_EXCESS:
        return False
    prices = -found.ineqlin.marginals
    weights = prices[: len(linear)] - prices[len(linear) :]
    pairs = weights[: len(rows)].reshape(-1, 2)
    left = [
        Left(number, power, (Fraction(float(a / instants[-1] ** power)), Fraction(float(b / instants[-1] ** power))))
        for (number, power), (a, b) in zip(powers, pairs, strict=True)
    ]
    strayed = [
        Strayed(mode, sample, later, Fraction(float(w)))
        for (mode, sample, later), w in zip(looks, weights[len(rows) :], strict=True)
        if abs(w) > ZERO
    ]
    exactly = tuple((exact(repr(mode.frequency)), exact(repr(mode.damping))) for mode in modes)
    bounds = exact(repr(sums[0])), exact(repr(sums[1]))
    asked = Asked(exactly, derivatives, exact(repr(step)), samples, exact(repr(limit)), bounds)
    return none_on_samples(asked, left, strayed)
