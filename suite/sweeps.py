"""What all sweeps of minimum times share: where to look for the next one, which sides are proven, what is known between two points."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from relaxations.bounds import Bound, Status
from relaxations.robust.worst import WorstResidual
from reports.files import write_atomically


class Bracketed(Protocol):
    """A point of a sweep: what is known of it, and the sides [s] that are proven."""

    @property
    def status(self) -> str:
        """`proved`, `bracketed`, `impossible`, `refused`."""
        ...

    @property
    def lower(self) -> float | None:
        """The proven lower side [s]."""
        ...

    @property
    def upper(self) -> float | None:
        """The proven upper side [s]."""
        ...


def stairs(points: Sequence[Bracketed], asks_more: int) -> list[tuple[float | None, float | None]]:
    """What is proven of the minimum time between each point and the next: (lower, upper), None where nothing is.

    `asks_more` is 1 if the later points ask for more, -1 if the earlier ones do. Between two points the task asks for at least what the
    easier one asks for, and for no more than the harder one does. Infinite below an impossible one: there is no time.
    """
    count, found = len(points), []
    for i in range(count - 1):
        easier, harder = (points[: i + 1], points[i + 1 :]) if asks_more > 0 else (points[i + 1 :], points[: i + 1])
        below = [float("inf") if p.status == "impossible" else p.lower for p in easier]
        above = [p.upper for p in harder]
        known = [x for x in below if x is not None], [x for x in above if x is not None]
        found.append((max(known[0], default=None), min(known[1], default=None)))
    return found


def extrapolated(last: Sequence[tuple[Fraction, float]], value: Fraction) -> float | None:
    """A guess at the minimum time [s] at `value`, by the line through the last two points (value, minimum time); None without any."""
    if not last:
        return None
    (before, early), (after, late) = last[-2:] if len(last) > 1 else (last[-1], last[-1])
    if before == after:
        return late
    guess = late + (late - early) / float(after - before) * float(value - after)
    return guess if guess > late / 2 else late


def claimed(bound: Bound) -> set[str]:
    """Which sides a bound's certificate claims, "lower" or "upper"."""
    if bound.certificate is None:
        return set()
    return {side for side, value in json.loads(bound.certificate)["claim"].items() if side != "impossible" and value is not None}


def sides(bound: Bound | None) -> dict[str, float | None] | None:
    """The member `maneuver_time` of a point in JSON; null where there is none."""
    return None if bound is None or bound.status is Status.IMPOSSIBLE else {"lower": bound.lower, "upper": bound.upper}


def kept(folder: Path | None, name: str, proven: Bound | WorstResidual | None) -> Path | None:
    """The file in `folder` that a proof was written to, `NAME.certificate.json`; None without either."""
    if folder is None or proven is None or proven.certificate is None:
        return None
    file = folder / f"{name}.certificate.json"
    write_atomically(file, proven.certificate)
    return file
