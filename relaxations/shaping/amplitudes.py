"""What doubles hold of amplitudes: the smallest one of a kind falls with damping, and up to which damping it is still a number."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import cast

from scipy.optimize import brentq

LEAST = math.log10(sys.float_info.min)  # decimal logarithm: below it doubles have fewer digits, and then none
MOST_DECAY = 500.0  # r: in half a period less is left than doubles hold
DIGITS = 1e9


def decay_per_radian(damping: float) -> float:
    """r = ζ/√(1 - ζ²), to rounding however near ζ is to 1: in a half period a mode falls to e^{-rπ} of itself."""
    return damping / math.sqrt((1.0 - damping) * (1.0 + damping))


def left_in_half_a_period(damping: float) -> float:
    """K = e^{-rπ}."""
    return math.exp(-math.pi * decay_per_radian(damping))


def smallest_of_derivatives(damping: float, derivatives: int) -> float:
    """Decimal logarithm of the last amplitude, (K/(1 + K))^n of n impulses but one."""
    folds = math.pi * decay_per_radian(damping)
    return -(derivatives + 1) * (folds + math.log1p(math.exp(-folds))) / math.log(10.0)


def named(derivatives: int) -> str:
    """The kind with so many derivatives."""
    return f"zv{'d' * derivatives}" if derivatives < 3 else f"zv-d:{derivatives}"


def largest_damping(smallest: Callable[[float], float]) -> float:
    """The largest damping, rounded down, at which the decimal logarithm of an amplitude, `smallest`, which falls, is that of a double."""
    found = brentq(lambda r: smallest(_damping(r)) - LEAST, 0.0, MOST_DECAY, xtol=1e-9)
    damping = math.floor(DIGITS * _damping(float(cast(float, found)))) / DIGITS
    while damping > 0.0 and smallest(damping) < LEAST:
        damping = math.floor(DIGITS * damping - 1.0) / DIGITS
    return max(damping, 0.0)


def _damping(decay: float) -> float:
    return decay / math.hypot(1.0, decay)


def too_small(name: str, damping: float, smallest: Callable[[float], float]) -> str:
    """Why there is no such shaper in doubles, and up to which damping there is."""
    return (
        f"{name} at a damping of {damping!r} has an amplitude below 1e{math.ceil(smallest(damping))}, doubles hold 1e{math.ceil(LEAST)}; "
        f"up to a damping of {largest_damping(smallest):.9g} it is possible, with fewer zeros beyond that; such a mode hardly vibrates: it "
        "may be left out"
    )
