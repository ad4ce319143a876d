"""A shaper is a command: its partial sums, the shaped unit step, are one from rest to rest of the plant `∏ ω²/(s² + 2ζωs + ω²)`."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from relaxations.commands import Command
from relaxations.plants import LinearPlant, exact
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper


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


def shaper_of(command: Command) -> Shaper:
    """The jumps of a command from 0 to 1."""
    starts = [segment.start for segment in command.segments] + [command.maneuver_time]
    levels = [0.0, *(segment.level for segment in command.segments), 1.0]
    jumps = [(start, after - before) for start, before, after in zip(starts, levels[:-1], levels[1:], strict=True) if after != before]
    return Shaper(tuple(start for start, _ in jumps), tuple(jump for _, jump in jumps))
