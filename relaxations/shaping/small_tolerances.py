"""Specified insensitivity where a tolerance is too small for programs in doubles: humped shapers, solved in as many digits as it takes.

Undamped a humped shaper is the shortest positive one of its own range; with damping it is a little longer. So the one with the fewest
humps whose range, as a ratio of its ends, holds the band is scaled to begin where the band does. Beyond the humps that are solved come
shapers with derivatives, which any number of them is known of. Several bands, and bands over a range of dampings, are kept by a shaper
convolved with itself (relaxations.shaping.roots), where that of one band alone does not keep them and is no shorter. None shorter than the
bound of a larger tolerance keeps a smaller one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce

from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.humps import LEAST_TOLERANCE, MOST_HUMPS, extra_insensitive
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import Shortest, specified
from relaxations.shaping.modes import Mode
from relaxations.shaping.roots import MANY, ROUNDED, keeps, keeps_in_balls, rooted
from relaxations.shaping.sensitivity import insensitive_range
from relaxations.shaping.shapers import Shaper, convolve

DERIVATIVES = (13, 16, 20, 25, 32, 40, 50, 64)
INSIDE = 1e-7  # relative: how much lower than the band begins a range does
LARGER = (1e-4, 1e-3, 1e-2)  # tolerances whose bounds are tried in turn
HUMPED = "a tolerance so small is kept by a humped shaper, near the shortest; the least duration is that of a larger tolerance"
OF_LARGER = "the least duration is that of larger tolerances: with these nothing was proven"
CONVOLVED = "tolerances so small are kept by a humped shaper for each band, one after the other; the least duration is that of larger ones"
ROOTED = (
    "tolerances so small are kept by a shaper convolved with itself, {} in a row, each the shortest of the roots of the tolerances; the "
    "least duration is that of larger tolerances"
)
NOISY = 1e-12  # a tolerance that doubles do not tell from a little more
SMALL, SMALLEST = 1e-3, 1e-7  # tolerances of which programs may fail, and do


def within(bands: Sequence[Band]) -> Shortest:
    """The shortest positive shaper for the bands; of small tolerances, where no program does, one that keeps them and is near it.

    Raises `SolverError`.
    """
    least = min((band.tolerance for band in bands), default=1.0)
    if least < SMALLEST:
        return within_small(bands)
    try:
        found = specified(bands)
    except SolverError:
        if least < SMALL:
            return within_small(bands)
        raise
    if found.lower is None and least < SMALL:
        return replace(found, lower=least_known(bands, own=False), note=OF_LARGER)
    return found


def within_small(bands: Sequence[Band]) -> Shortest:
    """A positive shaper that keeps the tolerances, the shortest that is known here of no more than `MANY` impulses, if there is one.

    Its least duration is that of larger tolerances.

    Raises `SolverError` where none of those above does.
    """
    different = tuple(dict.fromkeys(bands))
    known: list[tuple[Shaper, str]] = []
    each = [_humped(band) for band in different]
    made = [one for one in each if one is not None]
    known += [(one, HUMPED) for one in made if keeps(one, different)]
    if 1 < len(made) == len(each) and keeps(whole := reduce(convolve, made), different):
        known.append((whole, CONVOLVED))
    trouble = None
    if len(different) > 1 or not any(len(one.times) < DERIVATIVES[0] + 2 for one, _ in known):  # else humps do, and are shorter
        try:
            found = rooted(different)
            known.append((found.shaper, ROOTED.format(found.factors)))
        except SolverError as problem:
            trouble = problem
    if not known:
        least = min(different, key=lambda band: band.tolerance)
        others = f", with {len(different) - 1} more band(s)" if len(different) > 1 else ""
        raise SolverError(
            f"no shaper was found that keeps {least.tolerance!r} from {least.low:g} to {least.high:g} of the frequency, damping "
            f"{least.damped[0]:g} to {least.damped[1]:g}{others} ({trouble}); narrower bands, one damping, tolerances from "
            f"{LEAST_TOLERANCE!r} on, and zv-d:N, which leaves nothing at the mode, are possible"
        ) from None
    shaper, note = min(known, key=lambda pair: (len(pair[0].times) > MANY, pair[0].duration))
    return Shortest(shaper, least_known(different, own=False), note)


def least_known(bands: Sequence[Band], own: bool = True) -> float | None:
    """The least duration [s], *proven*, with these tolerances (if `own`), or, where one is small, with larger ones; None if it was not."""
    least = min(band.tolerance for band in bands)
    larger = [tolerance for tolerance in (LARGER if len(bands) == 1 else LARGER[1:]) if least < min(tolerance, SMALL)]
    for tolerance in [*([least] if own and least >= SMALLEST else []), *larger]:
        try:
            found = specified([replace(band, tolerance=max(band.tolerance, tolerance)) for band in bands]).lower
        except SolverError:
            continue
        if found is not None:
            return found
    return None


def _humped(band: Band) -> Shaper | None:
    """A humped shaper, or one with derivatives, whose range holds the band."""
    ranged = band.damped[0] < band.damped[1]  # humps are at one damping
    at = Mode(1.0, sum(band.damped) / 2.0 if ranged else band.mode.damping)
    unit = band.mode.frequency * (band.low + band.high) / 2.0  # what is 1 rad/s there
    tiny = band.tolerance < LEAST_TOLERANCE
    for one in _candidates(at, band.tolerance, 0 if ranged else MOST_HUMPS):
        for room in (0.0,) if ranged or tiny else (0.0, 2.0 * ROUNDED):
            if not ranged and not tiny:
                low, high = insensitive_range(one.times, one.amplitudes, 1.0, at.damping, band.tolerance - room)
                if not 0.0 < low < high or high / low * (1.0 - INSIDE) < band.high / band.low:
                    break
                unit = band.mode.frequency * band.low / low * (1.0 - INSIDE)
            shaper = Shaper(tuple(t / unit for t in one.times), one.amplitudes)
            if (not tiny and keeps(shaper, [band])) or (band.tolerance < NOISY and keeps_in_balls(shaper, band)):
                return shaper
    return None


def _candidates(mode: Mode, tolerance: float, most_humps: int) -> Iterator[Shaper]:
    if tolerance >= LEAST_TOLERANCE:
        for humps in range(1, most_humps + 1):
            try:
                yield extra_insensitive(mode, tolerance, humps).shaper
            except (SolverError, ShaperError):
                break
    for number in DERIVATIVES:
        yield derivative_shaper(mode, number)
