"""Several modes of much damping at once: positive impulses, and dips of partial sums from 1, from the points of the shortest.

What the simplex method finds (relaxations.shaping.cones) becomes amplitudes in doubles; dips get their width, on a curve along which their
depth falls from very deep ones, which are all but points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction

import numpy as np
from flint import arb

from relaxations.bounds import Bound
from relaxations.errors import SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import exact, precision, rational
from relaxations.proofs import extremal_bound
from relaxations.refinement import Extremal
from relaxations.shaping.amplitudes import LEAST, decay_per_radian, smallest_of_derivatives
from relaxations.shaping.commanded import plant_of
from relaxations.shaping.cones import Zeros, bits_of, shortest
from relaxations.shaping.depths import widened
from relaxations.shaping.dips import Dip, drawn_apart, too_close
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.touching import least_of_dips, least_of_positive, least_up_to_one_of

LEAST_DECAY = 1e-32  # of a mode while the sequence lasts: with less the digits of certificates do not tell its switches
NEARLY, HALVINGS = 2.0, 60  # decimal digits by which amplitudes may differ from it; of a factor of the dampings


def decaying(zeros: Zeros) -> float:
    """By how many e-folds the mode that decays most does so in the half periods that a positive shaper of its own zeros takes."""
    return max((count + 1) * math.pi * decay_per_radian(mode.damping) for mode, count in zeros)


def positive_at_once(zeros: Zeros) -> tuple[Shaper, float | None]:
    """The shortest positive shaper of all zeros (mode, derivatives), and the least duration [s], *proven*; None if it was not.

    Derivatives are as many for all modes. Raises `SolverError`.
    """
    require_doubles(zeros)
    found = shortest(zeros)
    with precision(bits_of(zeros)):
        sizes = [arb(1), *found.sizes]
        whole = sum(sizes, arb(0))
        shaper = Shaper((0.0, *map(float, found.instants)), tuple(float(size / whole) for size in sizes))
    return shaper, least_of_positive([mode for mode, _ in zeros], shaper, zeros[0][1])


def require_doubles(zeros: Zeros) -> None:
    """Raises `SolverError`, saying what is possible, where the smallest amplitude is no double: it is nearly that of the convolution."""
    if (least := _smallest(zeros, 1.0)) >= LEAST + NEARLY:
        return
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if _smallest(zeros, middle) >= LEAST + NEARLY else (low, middle)
    raise SolverError(
        f"{len(zeros)} modes at once take an amplitude below 1e{math.ceil(least)}, doubles hold 1e{math.ceil(LEAST)}; dampings of "
        f"{math.floor(1e9 * low) / 1e9!r} times these are possible; modes like these hardly vibrate: they may be left out"
    )


def _smallest(zeros: Zeros, factor: float) -> float:
    """Decimal logarithm of the convolution's last amplitude at so many times the dampings."""
    return sum(smallest_of_derivatives(factor * mode.damping, count) for mode, count in zeros)


def dips_at_once(modes: Sequence[Mode], lower: Fraction, derivatives: int) -> tuple[Shaper, float | None]:
    """The sequence with partial sums in [lower, 1], lower ≤ 0, and the least duration [s], *proven*; None if it was not.

    Raises `SolverError`.
    """
    zeros = [(mode, derivatives) for mode in modes]
    require_doubles(zeros)
    found = shortest(zeros, dips=True)
    depth = 1 - lower
    folds = max(mode.damping * mode.frequency for mode in modes) * float(found.instants[-1])
    with precision(bits_of(zeros) + math.ceil(2.0 * folds / math.log(2.0))):  # widths are told from nothing
        dips = widened(zeros, found.instants, found.sizes, depth)
        if too_close(dips):
            shaper = drawn_apart(zeros, dips, rational(depth))
        else:
            edges = [edge for dip in dips for edge in dip]
            sizes = [-1.0 if k % 2 == 0 else 1.0 for k in range(len(edges))]
            shaper = Shaper((0.0, *map(float, edges)), (1.0, *(float(depth) * size for size in sizes)))
        if (exactly := least_of_dips(modes, dips, derivatives, lower)) is not None:
            return shaper, exactly
        proven = [least_up_to_one_of(modes, dips, derivatives)]
        fastest = max(mode.damping * mode.frequency for mode in modes)
        if math.exp(-fastest * shaper.duration) > LEAST_DECAY:
            with suppress(SolverError):
                bound = _extremal(modes, lower, derivatives, dips)
                proven.append(bound.lower if bound.certificate is not None else None)
    return shaper, max((low for low in proven if low is not None), default=None)


def _extremal(modes: Sequence[Mode], lower: Fraction, derivatives: int, dips: Sequence[Dip]) -> Bound:
    posed = problem([plant_of(modes)], Maneuver(exact(1), Limits.of(lower, 1), robustness=derivatives))
    end = dips[-1][1]
    to_go = [end - edge for edge in reversed([edge for dip in dips for edge in dip][:-1])] + [end]
    levels = np.array([posed.lower if k % 2 == 0 else posed.upper for k in range(len(to_go))])
    return extremal_bound(
        posed, Extremal(posed, float(end), np.array([float(t) for t in to_go[:-1]]), levels, np.zeros(posed.size), 0.0, 0), to_go
    )
