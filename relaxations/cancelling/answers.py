"""What a filter does to its plant: the output under a step of the reference, how long the tail is, what it does if a zero is elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
from flint import acb
from numpy.typing import ArrayLike, NDArray

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.prefilters import Prefilter
from relaxations.plants import ROOT_BITS, LinearPlant, precision
from relaxations.response import response
from relaxations.tails import cap_bound

Reals = NDArray[np.float64]

LASTING, LOOKS = 40.0, 4001  # time constants of the slowest pole that a tail is looked at for, and instants


def output(plant: LinearPlant, prefilter: Prefilter, times: ArrayLike, name: str | None = None) -> Reals:
    """An output's deviation under a unit step of the reference, at `times` [s], exact: what starts at each delay, added up."""
    t = np.asarray(times, dtype=float)
    total = np.zeros(t.shape)
    for delay, gain in zip(prefilter.delays, prefilter.gains, strict=True):
        own = tuple(replace(term, start=0.0) for term in prefilter.terms if term.start == delay)
        begun = t >= delay
        if begun.any() and (gain or own):
            total[begun] += response(plant, Prefilter((0.0,), (gain,), own).command(1.0), t[begun] - delay, name)
    return total


def residual(conditions: Conditions, prefilter: Prefilter) -> float:
    """The largest |G_f| at a pole that it cancels, of its size: rounding."""
    return max((abs(complex(prefilter(pole.value))) for pole in conditions.poles), default=0.0) / prefilter.size


def tail_length(prefilter: Prefilter, within: float) -> float:
    """From so long after the last delay on [s] the answer to a step stays within that fraction of its largest size from its final value."""
    if not prefilter.terms:
        return 0.0
    slowest = min(-rate.real for rate in prefilter.poles)
    since = np.linspace(0.0, LASTING / slowest, LOOKS)
    tail = prefilter.reference(prefilter.duration + since) - prefilter.gain
    largest = np.abs(prefilter.reference(np.union1d(prefilter.delays, prefilter.duration + since))).max()
    beyond = np.flatnonzero(np.abs(tail) > within * largest)
    return float(since[min(beyond[-1] + 1, LOOKS - 1)]) if len(beyond) else 0.0


def zero_sensitivities(plant: LinearPlant, prefilter: Prefilter) -> dict[str, float]:
    """What a zero that is elsewhere leaves: of the displacement, for a shift by its own magnitude, to first order, by `zero[i]`.

    A filter's pole z beside the zero z + d forces `c d G^(m)(z)/(m-1)! e^{zr}` on the output (`relaxations.tails.cap_bound`), c the
    coefficient of `r^(m-1)/(m-1)! e^{zr}` in the input, r after the last delay.
    """
    found = {}
    for number, zero in enumerate(plant.zeros, 1):
        own = [term for term in prefilter.terms if abs(term.rate - zero.value) <= 1e-9 * abs(zero.value)]
        if not own:
            continue
        power = max(term.power for term in own)
        highest = sum(
            math.factorial(power) * term.coefficient / term.rate * np.exp(term.rate * (prefilter.duration - term.start))
            for term in own
            if term.power == power
        )
        with precision(ROOT_BITS):
            most = cap_bound(plant, acb(zero.value.real, zero.value.imag), power + 1, (Fraction(1), Fraction(1)), Fraction(1))
            found[f"zero[{number}]"] = float(abs(highest)) / float(most.mid())
    return found
