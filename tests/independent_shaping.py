"""A second way to what a shaper does: convolution by quadrature, no partial fractions and no recursion."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.optimize import linprog

from relaxations.commands import Command
from relaxations.shaping.shapers import Shaper, ShaperTerm

Reals = NDArray[np.float64]
NODES, WEIGHTS = leggauss(40)  # exact to rounding for the smooth pieces that they meet here


def known_shapers() -> dict[str, Shaper]:
    """One of each kind: impulses, negative ones, several modes, terms with real and complex rates, a pure filter."""
    pole = 0.1774 / 1.151  # the pitch plant's zero, and its shaper of two impulses and a term
    first, second, coefficient = 0.2197918790, 0.0992515680, -0.0183477910
    gain = first + second + coefficient / pole
    delay = 2.3672493903
    pair = complex(-0.4, 3.0)
    rest = 1.0 - 0.25 - 0.35 - (complex(0.2, 0.1) / -pair).real
    filtered = [(0.0, 3**0.5 - 1), (1.5459306102, 3 - 3**0.5)]  # of start and amplitude, over s + 1
    return {
        "zv": Shaper((0.0, 0.5), (0.6, 0.4)),
        "negative": Shaper((0.0, 0.2, 0.4), (1.0, -1.0, 1.0)),
        "two modes": Shaper((0.0, 0.3, 0.7, 1.0), (0.3, 0.3, 0.2, 0.2)),
        "one impulse": Shaper((0.0,), (1.0,)),
        "pole-zero": Shaper(
            (0.0, delay), (first / gain, second / gain), (ShaperTerm(delay, complex(-pole), 0, complex(coefficient / gain)),)
        ),
        "pair": Shaper((0.0, 0.35, 0.8), (0.25, 0.35, rest), (ShaperTerm(0.35, pair, 0, complex(0.2, 0.1)),)),
        "repeated": Shaper((0.0,), (0.5,), (ShaperTerm(0.25, -4 + 0j, 1, 4 + 0j), ShaperTerm(0.25, -4 + 0j, 0, 1 + 0j))),
        "filter": Shaper((), (), tuple(ShaperTerm(at, -1 + 0j, 0, complex(c / 2)) for at, c in filtered)),
    }


def impulse_response(term: ShaperTerm, since: Reals) -> Reals:
    """One term of a shaper at `since` ≥ 0 [s] after its start."""
    return np.asarray((term.coefficient * since**term.power * np.exp(term.rate * since)).real, dtype=np.float64)


def shaped(shaper: Shaper, reference: Callable[[Reals], Reals], breaks: Sequence[float], time: float, rest: float = 0.0) -> float:
    """The shaped reference at `time` [s]; `reference` is smooth between the `breaks` and `rest` before the first of them."""
    total = rest + sum(a * (float(reference(np.array([time - t]))[0]) - rest) for t, a in zip(shaper.times, shaper.amplitudes, strict=True))
    for pulse in shaper.pulses:
        start, end = time - pulse.start - pulse.width, time - pulse.start
        marks = sorted({start, *(b for b in breaks if start < b < end), end})
        for a, b in itertools.pairwise(marks):
            at = (a + b) / 2 + (b - a) / 2 * NODES
            total += float((b - a) / 2 * WEIGHTS @ (reference(at) - rest)) * pulse.height
    for term in shaper.terms:
        end = time - term.start
        # short pieces: forty nodes resolve half a period and a decay of e^-1 each
        width = 1.0 / abs(term.rate)
        marks = sorted({*(b for b in breaks if b < end), end})
        for a, b in itertools.pairwise(marks):
            for left, right in _pieces(a, b, width):
                at = (left + right) / 2 + (right - left) / 2 * NODES
                total += float((right - left) / 2 * WEIGHTS @ (impulse_response(term, end - at) * (reference(at) - rest)))
    return total


def shaped_command(shaper: Shaper, command: Command, times: Sequence[float], rest: float = 0.0) -> Reals:
    """The shaped command at `times` [s], none of which is a switch."""
    return np.array([shaped(shaper, lambda t: command(t, rest), command.breakpoints, t, rest) for t in times])


def _pieces(a: float, b: float, width: float) -> list[tuple[float, float]]:
    marks = np.linspace(a, b, max(2, int(np.ceil((b - a) / width)) + 1))
    return list(itertools.pairwise(marks))


def shortest_positive(demands: Sequence[tuple[float, float, float]], cells: int, corners: int) -> float:
    """The shortest duration [s] of positive impulses on a grid of `cells` that keep (ω [rad/s], ζ, tolerance) each, to 1e-4 of it.

    A linear program in HiGHS: polygons of so many corners within the circles, bisection of the duration.
    """
    turns = np.exp(-2j * np.pi * np.arange(corners) / corners)

    def feasible(duration: float) -> bool:
        since = np.linspace(-duration, 0.0, cells + 1)
        rows, limits = [], []
        for omega, zeta, tolerance in demands:
            columns = np.exp(complex(zeta, np.sqrt(1.0 - zeta**2)) * omega * since)
            rows.append(np.real(turns[:, None] * columns))
            limits.append(np.full(corners, tolerance * np.cos(np.pi / corners)))
        ones = np.ones((1, cells + 1))
        return linprog(np.zeros(cells + 1), np.vstack(rows), np.concatenate(limits), ones, [1.0], method="highs").status == 0

    high = max(np.pi / omega for omega, _, _ in demands)
    while not feasible(high):
        high *= 1.5
    low = high / 1.5
    while high - low > 1e-4 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high
