"""A move and its shaper: one after the other, and designed together, which for moves shorter than the shaper saves most.

The machine is a rigid body with modes, `1/s^r ∏ ω²/(s² + 2ζωs + ω²)`: its input an acceleration (r = 2) or a speed (r = 1), within limits.
One after the other is the fastest move of the rigid body convolved with the shaper. Together is the fastest of all commands that bring the
body to rest and leave as little of the modes as the shaper does: zeros are poles of the plant, with derivatives of higher multiplicity,
and a mode's band with a tolerance is a box of plants (`relaxations.proofs.minimum_time` in all three).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from relaxations.bounds import Bound
from relaxations.checking.worst import worst_residual
from relaxations.commands import Command
from relaxations.errors import ManeuverError, ShaperError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact, fraction
from relaxations.proofs import minimum_time
from relaxations.response import jumps
from relaxations.robust.boxes import Axis, Box, Family, Polynomial
from relaxations.shaping.bands import Band
from relaxations.shaping.commanded import plant_of
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper, shape

ROUNDING = 1e-9  # of the distance between the limits


@dataclass(frozen=True, slots=True)
class Move:
    """By `displacement`, the input within `lower` and `upper`; `order` 2: the input is an acceleration, 1: a speed. SI units or any others.

    Raises `ShaperError` naming what is wrong.
    """

    displacement: float
    lower: float
    upper: float
    order: int = 2

    def __post_init__(self) -> None:
        wrong = []
        if not (math.isfinite(self.displacement) and self.displacement != 0.0):
            wrong.append(f"a move is finite and not 0, not {self.displacement!r}")
        if not self.lower < self.upper:
            wrong.append(f"limits ascend, not from {self.lower!r} to {self.upper!r}")
        elif not self.lower <= 0.0 <= self.upper:
            wrong.append(f"limits hold 0, the input at rest, not [{self.lower!r}, {self.upper!r}]")
        if self.order not in (1, 2):
            wrong.append(f"the order is 2 (the input is an acceleration) or 1 (a speed), not {self.order!r}")
        if wrong:
            raise ShaperError("; ".join(wrong))

    def maneuver(self, robustness: int = 0, box: Box | None = None) -> Maneuver:
        """As a task."""
        limits = Limits.of(exact(repr(self.lower)), exact(repr(self.upper)))
        return Maneuver(exact(repr(self.displacement)), limits, robustness=robustness, box=box)

    def plant(self, modes: Sequence[Mode]) -> LinearPlant:
        """The rigid body with modes."""
        denominator = [Fraction(1)]
        numerator = [Fraction(1)]
        if modes:
            flexible = plant_of(modes)
            denominator = [fraction(c) for c in reversed(flexible.denominator.coeffs())]
            numerator = [fraction(flexible.numerators[flexible.output].coeffs()[0])]
        return LinearPlant.from_transfer(numerator, [*denominator, *[Fraction(0)] * self.order])


def rigid(move: Move) -> Bound:
    """The fastest move of the body without modes, with its proof."""
    return _solved(move, [], 0, None)


def in_turn(move: Move, command: Command, shaper: Shaper) -> Command | None:
    """The rigid body's command, shaped; None if negative impulses take it beyond the limits."""
    shaped = shape(command, shaper)
    least, most = shaped.extent()
    slack = ROUNDING * (move.upper - move.lower)
    return shaped if move.lower - slack <= least and most <= move.upper + slack else None


def with_zeros(move: Move, modes: Sequence[Mode], derivatives: int) -> Bound:
    """The fastest move that leaves nothing of the modes, nor so many derivatives of it; with its proof."""
    return _solved(move, modes, derivatives, None)


def within_bands(move: Move, bands: Sequence[Band]) -> Bound:
    """The fastest move after which the machine swings by at most the tolerance, a fraction of the move, over the box of all bands; proven.

    All are of one tolerance: that is about the output, to which every mode adds. Several bands of one mode are kept as one, from the lowest
    frequency to the highest (`hulls`). Raises `ShaperError` for other tolerances (relaxations.shaping.banded_moves has those), and for
    bands that leave out the mode itself.
    """
    whole = hulls(bands)
    wrong = [
        f"the band {band.low:g} to {band.high:g} leaves out the mode itself, which the move is designed about"
        for band in whole
        if not band.low <= 1.0 <= band.high
    ]
    if len(tolerances := sorted({band.tolerance for band in bands})) > 1:
        wrong.append(f"a move has one tolerance, that of its output, not {' and '.join(f'{one:g}' for one in tolerances)}")
    if wrong:
        raise ShaperError("; ".join(wrong))
    axes = [
        Axis(f"mode[{number}].frequency", Fraction(1), exact(repr(band.low)), exact(repr(band.high)))
        for number, band in enumerate(whole, 1)
    ]
    box = Box(tuple(axes), family([band.mode for band in whole], move.order), exact(repr(bands[0].tolerance)))
    return _solved(move, [band.mode for band in whole], 0, box)


def hulls(bands: Sequence[Band]) -> tuple[Band, ...]:
    """Of each mode one band, from the lowest frequency of its bands to the highest."""
    found: dict[Mode, Band] = {}
    for band in bands:
        known = found.get(band.mode, band)
        found[band.mode] = replace(known, low=min(known.low, band.low), high=max(known.high, band.high))
    return tuple(found.values())


def gaps(bands: Sequence[Band]) -> tuple[tuple[float, float], ...]:
    """Factors of the frequency between bands of one mode, which belong to none of them."""
    found = []
    for mode in dict.fromkeys(band.mode for band in bands):
        own = sorted((band.low, band.high) for band in bands if band.mode == mode)
        reach = own[0][1]
        for low, high in own[1:]:
            if low > reach:
                found.append((reach, low))
            reach = max(reach, high)
    return tuple(found)


def _solved(move: Move, modes: Sequence[Mode], derivatives: int, box: Box | None) -> Bound:
    try:
        return minimum_time(problem([move.plant(modes)], move.maneuver(derivatives, box)))
    except ManeuverError as refused:
        raise ShaperError(f"move and shaper together: {refused}") from None


def family(modes: Sequence[Mode], order: int) -> Family:
    """The frequencies times parameters f: `∏ f²ω² / (s^r ∏ (s² + 2ζωf s + f²ω²))`."""
    none = (0,) * len(modes)
    gain: Polynomial = ((Fraction(1), none),)
    denominator: list[Polynomial] = [gain]
    for number, mode in enumerate(modes):
        omega, zeta = exact(repr(mode.frequency)), exact(repr(mode.damping))
        once, twice = (tuple(power if k == number else 0 for k in range(len(modes))) for power in (1, 2))
        stiffness: Polynomial = ((omega**2, twice),)
        drag: Polynomial = ((2 * zeta * omega, once),) if zeta else ()
        longer: list[Polynomial] = [()] * (len(denominator) + 2)
        for place, terms in enumerate(denominator):
            for step, factor in enumerate((((Fraction(1), none),), drag, stiffness)):
                longer[place + step] = (*longer[place + step], *_times(terms, factor))
        denominator, gain = longer, _times(gain, stiffness)
    return Family((gain,), (*denominator, *[()] * order))


def _times(left: Polynomial, right: Polynomial) -> Polynomial:
    return tuple((a * b, tuple(m + n for m, n in zip(p, q, strict=True))) for a, p in left for b, q in right)


def left_over(move: Move, command: Command, bands: Sequence[Band], damping: tuple[float, float] | None) -> tuple[float, float]:
    """The largest envelope at the end of the move of any mode's vibration, as a fraction of the move, lies between these: proven in balls.

    Over every band of frequencies and the dampings (None: each mode's own), for a machine with that mode alone:
    `|Σ J_i e^{κω(t_i - T)}| / (ω^r √(1 - ζ²) |Δ|)` with the command's jumps J_i (r is one more for those of its slope).
    """
    levels = [(Fraction(float(at)), Fraction(float(level))) for at, level, _ in jumps(command) if level]
    slopes = [(Fraction(float(at)), Fraction(float(slope))) for at, _, slope in jumps(command) if slope]
    if levels and slopes:
        raise ShaperError("the command has jumps and slopes; what it leaves is enclosed of either alone")
    times, sizes = zip(*(levels or slopes), strict=True)
    order = move.order + (0 if levels else 1)
    lower = upper = 0.0
    for band in bands:
        low, high = damping or (band.mode.damping, band.mode.damping)
        frequencies = [Fraction(repr(factor)) * exact(repr(band.mode.frequency)) for factor in (band.low, band.high)]
        dampings = Fraction(repr(low)), Fraction(repr(high))
        found = worst_residual(times, sizes, (frequencies[0], frequencies[1]), dampings, order=order)
        least, most = (Fraction(x) / abs(exact(repr(move.displacement))) for x in (found.lower, found.upper))
        lower, upper = max(lower, float(least)), max(upper, float(most) / math.sqrt(1.0 - high**2))
    return lower * (1.0 - 1e-15), upper * (1.0 + 1e-14)
