"""A mode of a flexible machine: what a shaper has to know of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from relaxations.errors import ShaperError

SLOWEST, FASTEST = 1e-100, 1e100  # [rad/s]: squares of frequencies and of instants still fit a double


@dataclass(frozen=True, slots=True)
class Mode:
    """Natural (undamped) `frequency` ω [rad/s] and `damping` ratio ζ, 0 ≤ ζ < 1. Raises `ShaperError` naming whatever is outside."""

    frequency: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        wrong = []
        if not (0.0 < self.frequency < math.inf):
            wrong.append(f"a mode's frequency is positive and finite, not {self.frequency!r} rad/s")
        elif not SLOWEST <= self.frequency <= FASTEST:
            wrong.append(f"a mode's frequency lies between {SLOWEST:g} and {FASTEST:g} rad/s, {self.frequency!r} rad/s does not")
        if not (0.0 <= self.damping < 1.0):
            wrong.append(f"a mode's damping ratio is at least 0 and less than 1 (from 1 on it does not vibrate), not {self.damping!r}")
        if wrong:
            raise ShaperError("; ".join(wrong))

    @property
    def direction(self) -> complex:
        """κ = ζ + j√(1 - ζ²): an impulse at t leaves a vibration of phase and size e^{κωt}."""
        return complex(self.damping, math.sqrt(1.0 - self.damping**2))

    @property
    def pole(self) -> complex:
        """The pole above the real axis, -ζω + jω√(1 - ζ²) [1/s]."""
        return -self.frequency * self.direction.conjugate()

    @property
    def half_period(self) -> float:
        """Half the damped period, π/ω_d [s]."""
        return math.pi / (self.frequency * math.sqrt(1.0 - self.damping**2))

    @property
    def decay(self) -> float:
        """K = e^{-ζπ/√(1-ζ²)}: what is left of the vibration after half a damped period."""
        return math.exp(-self.damping * math.pi / math.sqrt(1.0 - self.damping**2))

    def scaled(self, factor: float) -> Mode:
        """The mode with its frequency multiplied by `factor`."""
        return Mode(self.frequency * factor, self.damping)
