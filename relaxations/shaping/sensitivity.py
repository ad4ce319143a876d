"""Residual vibration of an impulse sequence against a mode's frequency: the sensitivity curve and the insensitivity."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from relaxations.errors import ShaperError

Reals = NDArray[np.float64]

LONGEST = 10_000.0  # periods: the grid of relative frequencies then has five million points and more
FARTHEST = 10.0  # relative frequency at which the search for the interval's upper end stops


def residual(times: ArrayLike, amplitudes: ArrayLike, frequency: ArrayLike, damping: float, order: int = 0) -> Reals:
    """`V = |Σ A_i e^{(ζω + jω_d)(t_i - t_n)}|`, ω_d = ω √(1 - ζ²), at natural frequencies ω = `frequency` [rad/s], 0 ≤ ζ = `damping` < 1.

    Impulses A_i at instants t_i [s]; the unit of V is that of the amplitudes. Singer and Seering's residual (../docs/task.md). Of pulses
    A_i are the jumps at their edges, and V is divided by ω (`order` 1): the mode integrates them.
    """
    t, a = np.asarray(times, dtype=float), np.asarray(amplitudes, dtype=float)
    omega = np.atleast_1d(np.asarray(frequency, dtype=float))
    exponent = damping * omega + 1j * omega * np.sqrt(1.0 - damping**2)
    return np.abs(np.exp(np.multiply.outer(exponent, t - t[-1])) @ a) / omega**order


def _crossing(excess: Callable[[float], float], inside: float, outside: float) -> float:
    if excess(inside) >= 0.0:
        return inside
    if excess(outside) <= 0.0:  # of levels near rounding sums of many places and of one differ
        return outside
    return float(cast(float, brentq(excess, inside, outside, xtol=1e-14)))


def insensitivity(times: ArrayLike, amplitudes: ArrayLike, frequency: float, damping: float, level: float, order: int = 0) -> float:
    """Width of the connected interval of relative frequency around 1 in which `residual` is at most `level`; 0 if it is more at 1.

    Raises `ShaperError` for a sequence of more than `LONGEST` periods.
    """
    low, high = insensitive_range(times, amplitudes, frequency, damping, level, order)
    return high - low


def insensitive_range(
    times: ArrayLike, amplitudes: ArrayLike, frequency: float, damping: float, level: float, order: int = 0
) -> tuple[float, float]:
    """The ends of that interval, both 1 if the residual is more at 1. Raises `ShaperError` as `insensitivity` does."""
    duration = float(np.ptp(np.asarray(times, dtype=float)))

    def excess(relative: float) -> float:
        return float(residual(times, amplitudes, relative * frequency, damping, order)[0]) - level

    if excess(1.0) > 1e-12 * level:  # some shapers reach the level exactly at 1
        return 1.0, 1.0
    # The curve's finest feature has a width of about one over the number of periods that the sequence lasts.
    periods = duration * frequency / (2 * np.pi)
    if periods > LONGEST:
        raise ShaperError(f"the sequence lasts {periods:.6g} periods of the mode; its sensitivity is looked at up to {LONGEST:.6g}")
    stride = min(0.005, 0.02 / max(periods, 1e-3))

    def edge(end: float) -> float:
        end = max(end, 1e-9)  # at a frequency of 0 the edges of pulses are 0/0
        grid = np.linspace(1.0, end, int(np.ceil(abs(end - 1.0) / stride)) + 1)
        over = np.flatnonzero(residual(times, amplitudes, grid * frequency, damping, order) > level * (1 + 1e-12))
        if not len(over):
            return end
        first = over[0]
        return 1.0 if first == 0 else _crossing(excess, float(grid[first - 1]), float(grid[first]))

    low = edge(0.0)
    return (low if low > 1e-9 else 0.0), edge(FARTHEST)


def step_response(times: ArrayLike, amplitudes: ArrayLike, frequency: float, damping: float, instants: ArrayLike, order: int = 0) -> Reals:
    """What impulses (order 0) or edges of pulses (order 1) make of a unit step, seen by `ω²/(s² + 2ζωs + ω²)` at `instants` [s]."""
    since = np.subtract.outer(np.asarray(instants, dtype=float), np.asarray(times, dtype=float))
    kappa = complex(damping, np.sqrt(1.0 - damping**2))
    passed = np.maximum(since, 0.0)
    decayed = np.exp(-frequency * kappa.conjugate() * passed)
    moved = 1.0 - (kappa * decayed).imag / kappa.imag
    if order:
        moved = passed - (kappa * (1.0 - decayed) / (frequency * kappa.conjugate())).imag / kappa.imag
    return np.where(since >= 0.0, moved, 0.0) @ np.asarray(amplitudes, dtype=float)
