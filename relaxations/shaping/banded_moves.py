"""A move and its shaper for bands of different tolerances: each is about a machine with that mode alone, over that band.

As a rule they are one task, a list of weighted plants (relaxations.shaping.listed_moves). Where that is not proven the command is that of a
box of one tolerance which is proven to keep all the others too, the fastest that was found; and no command is faster than the slowest of
those that keep one band alone, each with its own proof. Where one band asks for all the time both are the same.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from relaxations.bounds import Bound, Status
from relaxations.errors import ShaperError
from relaxations.shaping.bands import Band
from relaxations.shaping.listed_moves import within_all
from relaxations.shaping.moves import Move, hulls, left_over, within_bands

HALVINGS = 4  # of how far the narrow band of the smallest tolerance is widened until the others are kept
SAME = 1e-6  # relative: both sides of a bracket are the same


@dataclass(frozen=True, slots=True)
class Banded:
    """`bound`: the bracket, with the command's own certificate; `box`: the bands that it is about; `least`: the bound that the lower side
    is of, None where none was proven. `plants`: how many the certificate is about, all bands being one task; 0: the lower side is that of
    the band that asks for most time, alone.
    """

    bound: Bound
    box: tuple[Band, ...]
    least: Bound | None
    plants: int = 0


def within_each(move: Move, bands: Sequence[Band]) -> Banded:
    """The fastest command that was found to keep every band within its own tolerance, *proven*; and how fast any could be, *proven*.

    Raises `ShaperError` where no command was found, for bands that leave out the mode itself, too.
    """
    different = tuple(dict.fromkeys(bands))
    if (whole := within_all(move, different)) is not None:
        return Banded(whole.bound, different, whole.bound, whole.plants)
    alone = [within_bands(move, [band]) for band in dict.fromkeys(bands)]
    proven = [bound for bound in alone if _claims(bound, "lower")]
    least = max(proven, key=lambda bound: bound.lower, default=None)
    found: tuple[Bound, tuple[Band, ...]] | None = None
    for box in _together(bands):
        if (bound := _kept(move, box, bands)) is not None:
            found = bound, box
            break
    for box in _alone(bands):
        if (bound := _kept(move, box, bands)) is not None and (found is None or _faster(bound, found[0])):
            found = bound, box
    if found is None:
        raise ShaperError("no command was proven to keep bands of such different tolerances; one tolerance for all is possible")
    if len(hulls(bands)) == 1 and (least is None or found[0].upper != least.upper):
        found = _widened(move, bands, found)
    bound, box = found
    lower = 0.0 if least is None else least.lower
    same = bound.upper is not None and bound.upper <= lower * (1.0 + SAME)
    reason = None if same else "the least time is that of the band that asks for most, alone"
    return Banded(replace(bound, lower=lower, status=Status.PROVED if same else Status.BRACKETED, reason=reason), box, least)


def _claims(bound: Bound, side: str) -> bool:
    """Whether its certificate does."""
    return bound.certificate is not None and json.loads(bound.certificate)["claim"].get(side) is not None


def _faster(one: Bound, other: Bound) -> bool:
    return one.upper is not None and (other.upper is None or one.upper < other.upper)


def _together(bands: Sequence[Band]) -> Iterator[tuple[Band, ...]]:
    """All bands with each tolerance, the largest first: that takes the least time."""
    for tolerance in sorted({band.tolerance for band in bands}, reverse=True):
        yield tuple(replace(band, tolerance=tolerance) for band in hulls(bands))


def _alone(bands: Sequence[Band]) -> Iterator[tuple[Band, ...]]:
    """Of one mode each band by itself."""
    if len(hulls(bands)) == 1:
        yield from ((band,) for band in dict.fromkeys(bands))


def _kept(move: Move, box: Sequence[Band], bands: Sequence[Band]) -> Bound | None:
    """The command of a box, if it is proven to keep all bands."""
    bound = within_bands(move, box)
    if bound.command is None:
        return None
    own = box if _claims(bound, "upper") and len(box) == 1 else ()
    kept = all(any(_holds(one, band) for one in own) or left_over(move, bound.command, [band], None)[1] <= band.tolerance for band in bands)
    return bound if kept else None


def _holds(one: Band, other: Band) -> bool:
    return one.low <= other.low and other.high <= one.high and one.tolerance <= other.tolerance


def _widened(move: Move, bands: Sequence[Band], found: tuple[Bound, tuple[Band, ...]]) -> tuple[Bound, tuple[Band, ...]]:
    """Between the band of the smallest tolerance and all of them with that tolerance."""
    (whole,), narrow = hulls(bands), min(bands, key=lambda band: band.tolerance)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        share = (low + high) / 2.0
        ends = (round(a + share * (b - a), 6) for a, b in ((narrow.low, whole.low), (narrow.high, whole.high)))
        box = (replace(narrow, low=(first := next(ends)), high=max(first, next(ends))),)
        bound = _kept(move, box, bands)
        low, high = (share, high) if bound is None else (low, share)
        if bound is not None and _faster(bound, found[0]):
            found = bound, box
    return found
