"""Benchmarks of shapers: each prints figures; times are never judged."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from relaxations.checking.worst import worst_residual
from relaxations.shaping.bands import Band
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import specified
from relaxations.shaping.modes import Mode
from relaxations.shaping.streams import Stream

pytestmark = pytest.mark.benchmark
MODE = Mode(2 * math.pi, 0.05)


def median(action: Callable[[], object], times: int) -> float:
    """Median wall-clock seconds of an action."""
    taken = []
    for _ in range(times):
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return statistics.median(taken)


def test_closed_form() -> None:
    print(f"\nZVD: {1e6 * median(lambda: derivative_shaper(MODE, 1), 2000):.1f} µs")


def test_specified_insensitivity_solved_and_proven() -> None:
    def solve() -> None:
        found = specified([Band(MODE, 0.8, 1.2, 0.05)]).shaper
        numbers = [Fraction(t) for t in found.times], [Fraction(a) for a in found.amplitudes]
        band = Fraction(8, 10) * Fraction(MODE.frequency), Fraction(12, 10) * Fraction(MODE.frequency)
        damping = Fraction(MODE.damping)
        worst_residual(*numbers, band, (damping, damping), relative=1e-10)

    solve()  # loads the solver
    print(f"\nSI over one band, solved, its duration and worst case proven: {median(solve, 9):.3f} s")


def test_stream() -> None:
    stream, block = Stream(derivative_shaper(MODE, 1), 1e-3), np.random.default_rng(1).normal(size=4096)
    print(f"\nthree impulses, blocks of 4096: {len(block) / median(lambda: stream(block), 2000) / 1e6:.0f} M samples/s")
