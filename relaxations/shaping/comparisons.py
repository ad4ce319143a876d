"""How short other shapers of the same family could be: what is proven of a shaper's duration, and in which words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction

from relaxations.errors import ImpossibleShaperError, ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.at_once import decaying, positive_at_once
from relaxations.shaping.bounded import bounded
from relaxations.shaping.humps import Humped
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import specified
from relaxations.shaping.least_durations import Remnant, least_duration, least_with_derivatives
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Least, Made, Request
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import VANISHED, left

# Beyond them a least duration is not searched for: doubles cannot tell the conditions apart.
MOST_DERIVATIVES, MOST_CONDITIONS = 11, 30
TOLD = 4.0  # e-folds of decay up to which programs in doubles come first
SAME = 1.0 - 1e-5  # of a tolerance: humps are designed a hair below it
LARGEST_SUM = 1e9  # of a bound of partial sums
WHOLE = 1e-9  # partial sums this close to a whole number are it
ONE_MODE = "the least duration is that of one mode's zeros alone: with those of all nothing more was proven"
UNPROVEN = "no least duration: with damping so near 1 what tells shorter sequences apart is lost in rounding"


def rounded_down(number: Fraction) -> float:
    """The double that is printed as a decimal no larger than the number."""
    nearest = float(number)
    return nearest if exact(repr(nearest)) <= number else math.nextafter(nearest, -math.inf)


def order_of(zeros: Sequence[tuple[Mode, int]]) -> str:
    """What vanishes, in words."""
    return "zero vibration" + (f" and {zeros[0][1]} derivative(s) of it" if zeros[0][1] else "")


def compared(shaper: Shaper | None, zeros: Sequence[tuple[Mode, int]]) -> Made:
    """The shaper, or the shortest one, with the proof for positive shapers of these zeros."""
    among, modes, counts = f"positive shapers with {order_of(zeros)}", tuple(mode for mode, _ in zeros), [count for _, count in zeros]
    lower = max(least_with_derivatives(mode, count) for mode, count in zeros)
    if len(set(zeros)) == 1:
        return Made(shaper or derivative_shaper(*zeros[0]), Least(lower, among, modes))
    if shaper is not None and (max(counts) > MOST_DERIVATIVES or sum(counts) + len(counts) > MOST_CONDITIONS):
        return Made(shaper, Least(lower, among, modes), notes=(ONE_MODE,))
    try:
        shortest, proven = shortest_of(zeros)
    except SolverError:
        if shaper is None:
            raise
        return Made(shaper, Least(lower, among, modes), notes=(ONE_MODE,))
    notes = (ONE_MODE,) if proven is None else ()
    return Made(shaper or shortest, Least(max(lower, proven or 0.0), among, modes), notes=notes)


def shortest_of(zeros: Sequence[tuple[Mode, int]]) -> tuple[Shaper, float | None]:
    """The shortest positive shaper, of as many derivatives at every mode, and the least duration [s], *proven*; None if it was not.

    In doubles, or where modes decay by more than these tell, in as many digits as that takes. Raises `SolverError`.
    """
    different_zeros = list(dict.fromkeys(zeros))
    trouble = None
    if decaying(different_zeros) > TOLD:
        try:
            return positive_at_once(different_zeros)
        except SolverError as problem:
            trouble = problem
    try:
        found = specified([], different_zeros)
    except SolverError:
        if trouble is not None:
            raise trouble from None
        raise
    exact = all(left(found.shaper, mode, count) <= VANISHED for mode, count in zeros)
    if exact and found.lower is not None:
        return found.shaper, found.lower
    with suppress(SolverError):
        return positive_at_once(different_zeros)
    return found.shaper, found.lower


def least_of(lower: float | None, among: str, zeros: Sequence[Mode] = ()) -> Least | None:
    """None if nothing was proven."""
    return None if lower is None else Least(lower, among, tuple(zeros))


def with_negative(shaper: Shaper, remnants: Sequence[Remnant], what: str) -> Least | None:
    """How short anything could be whose negative parts sum to no more than this shaper's do."""
    below = [-amplitude for amplitude in shaper.amplitudes if amplitude < 0.0] + [-p.gain for p in shaper.pulses if p.height < 0.0]
    negative = math.fsum(below)
    among = f"shapers with {what} whose negative amplitudes sum to at most {negative!r}" if below else f"positive shapers with {what}"
    zeros = [remnant.mode for remnant in remnants if not remnant.tolerance]
    lower = least_duration(remnants, negative, shaper.duration)
    if lower is None and len(remnants) > 1:  # with one of them, then
        lower = max((least_duration([remnant], negative, shaper.duration) or 0.0 for remnant in remnants), default=0.0) or None
    return least_of(lower, among, zeros if len(zeros) == len(remnants) else ())


def sums_of(shaper: Shaper) -> tuple[float, float]:
    """The least and the largest of its partial sums, 0 included; whole numbers where they are but for rounding."""
    sums = [0.0, *itertools.accumulate(shaper.amplitudes)]
    low, high = (float(round(x)) if abs(x - round(x)) <= WHOLE else x for x in (min(sums), max(sums)))
    return low, max(high, 1.0)


def different(modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """Each mode once: what leaves nothing of it leaves nothing of another just like it; a plant with both asks for a derivative more."""
    return tuple(dict.fromkeys(modes))


def within_sums(zeros: Sequence[Mode], sums: tuple[float, float], derivatives: int, what: str) -> Least | None:
    """How short any sequence with partial sums in these bounds could be; where that is not proven with all zeros, with one of them."""
    modes, lower = different(zeros), None
    for some in (modes, *(([mode] for mode in modes) if len(modes) > 1 else ())):
        with suppress(ShaperError, SolverError):
            lower = max(lower or 0.0, bounded(some, *bounds_of(sums), derivatives).lower or 0.0) or None
        if lower is not None and some is modes:
            break
    return least_of(lower, summed(sums, what), zeros)


def summed(sums: tuple[float, float], what: str) -> str:
    """The family in words."""
    return f"sequences with partial sums in [{sums[0]:g}, {sums[1]:g}] and {what}"


def bounds_of(sums: tuple[float, float]) -> tuple[Fraction, Fraction]:
    """Exactly; raises `ImpossibleShaperError` where no shaper has such partial sums, `ShaperError` where they are too large."""
    low, high = (exact(repr(bound)) for bound in sums)
    if not (low <= 0 and high >= 1):
        raise ImpossibleShaperError(
            f"partial sums begin at 0 and end at 1, so no shaper has them within [{sums[0]}, {sums[1]}]; "
            "bounds are at most 0 and at least 1"
        )
    if max(-low, high) > LARGEST_SUM:
        raise ShaperError(
            f"partial sums from {sums[0]:g} to {sums[1]:g}: bounds beyond {LARGEST_SUM:g} are of impulses so large that doubles, which "
            "round them, leave more of a mode than nothing"
        )
    return low, high


def ripples(humped: Sequence[Humped], request: Request) -> tuple[str, ...]:
    """Where humps are lower than the tolerance."""
    return tuple(
        f"mode {number}: humps of {one.ripple:.4g}, the largest made at this damping; the tolerance is kept all the more"
        for number, one in enumerate(humped, 1)
        if one.ripple < SAME * request.tolerance
    )


def humps_of(number: int) -> str:
    """The kind with so many humps."""
    return "ei" if number == 1 else f"{number}-hump-ei"


def own(humped: Sequence[Humped], modes: Sequence[Mode]) -> str:
    """The zeros of humped shapers, as factors of their modes' frequencies."""
    factors = [[f"{zero.frequency / mode.frequency:.6g}" for zero in one.zeros] for one, mode in zip(humped, modes, strict=True)]
    parts = [" and ".join([", ".join(those[:-1]), those[-1]] if those[1:] else those) for those in factors]
    if len(parts) == 1:
        return f"its {'zeros' if len(factors[0]) > 1 else 'zero'}, at {parts[0]} of the frequency"
    return "its zeros, at " + "; ".join(f"{part} of mode {number}'s frequency" for number, part in enumerate(parts, 1))
