"""Shapers with negative impulses: the shortest sequence whose partial sums stay within two bounds, with a proof that none is shorter.

The shaped unit step is the partial sums. It is a command from rest to rest of the plant `∏ ω²/(s² + 2ζωs + ω²)` within these bounds as
actuator limits, so nothing new is needed: `relaxations.proofs.minimum_time` finds and proves the shortest one, for any modes at once and
with any number of derivatives. Bounds 0 and 1 give the unity-magnitude shapers 1, -1, 1 ….
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from relaxations.bounds import Bound
from relaxations.errors import ShaperError, SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import Exact, LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import possible


@dataclass(frozen=True, slots=True)
class BoundedShaper:
    """A shaper, and the proof of its duration: `bound.lower` [s] is the least of any such sequence."""

    shaper: Shaper
    bound: Bound


def plant_of(modes: Sequence[Mode]) -> LinearPlant:
    """`∏ ω²/(s² + 2ζωs + ω²)`, frequencies and dampings read as the decimals that they print as."""
    denominator = [Fraction(1)]
    for mode in modes:
        frequency, damping = exact(repr(mode.frequency)), exact(repr(mode.damping))
        longer = [*denominator, Fraction(0), Fraction(0)]
        for i, c in enumerate(denominator):
            longer[i + 1] += c * 2 * damping * frequency
            longer[i + 2] += c * frequency**2
        denominator = longer
    return LinearPlant.from_transfer([denominator[-1]], denominator)


def bounded(modes: Sequence[Mode], lower: Exact, upper: Exact, derivatives: int = 0) -> BoundedShaper:
    """The shortest shaper with partial sums in [lower, upper], with residual vibration and `derivatives` of it zero at every mode.

    Raises `ShaperError` unless lower ≤ 0 and upper ≥ 1, `SolverError` if no such shaper was found.
    """
    if not modes:
        raise ShaperError("a shaper needs at least one mode")
    if not (exact(lower) <= 0 and exact(upper) >= 1):
        raise ShaperError(f"partial sums go from 0 to 1, so their bounds are at most 0 and at least 1, not {lower} and {upper}")
    found = minimum_time(problem([plant_of(modes)], Maneuver(exact(1), Limits.of(lower, upper), robustness=derivatives)))
    if found.command is None:
        raise SolverError(f"no sequence with partial sums in [{lower}, {upper}] was found: {possible(modes)}")
    starts = [segment.start for segment in found.command.segments] + [found.command.maneuver_time]
    levels = [0.0, *(segment.level for segment in found.command.segments), 1.0]
    jumps = [(start, after - before) for start, before, after in zip(starts, levels[:-1], levels[1:], strict=True) if after != before]
    return BoundedShaper(Shaper(tuple(start for start, _ in jumps), tuple(jump for _, jump in jumps)), found)
