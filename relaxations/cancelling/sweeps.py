"""Filters against one parameter: what becomes of their delays and gains, and where there is none."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from relaxations.cancelling.prefilters import Prefilter
from relaxations.errors import RelaxationsError


@dataclass(frozen=True, slots=True)
class Swept:
    """The filter at one value of the parameter; None: there is none, or none was found, and the `reason`."""

    value: float
    prefilter: Prefilter | None
    reason: str | None = None

    @property
    def duration(self) -> float:
        """The last delay [s]; NaN without a filter."""
        return math.nan if self.prefilter is None else self.prefilter.duration

    def step(self, delay: int) -> float:
        """The step after delay number `delay`, of the static gain (of a rigid body's filter, whose static gain is 0: itself)."""
        made = self.prefilter
        return math.nan if made is None or delay >= len(made.gains) else made.gains[delay] / _whole(made)

    def term(self, delay: int) -> float:
        """What the terms with poles come to that start after that delay, likewise."""
        made = self.prefilter
        return math.nan if made is None or delay >= len(made.delays) else share(made, made.delays[delay])


def share(made: Prefilter, start: float) -> float:
    """What the terms that start at an instant come to, of the filter's static gain."""
    return math.fsum(term.gain for term in made.terms if term.start == start) / _whole(made)


def _whole(made: Prefilter) -> float:
    return made.gain if abs(made.gain) > 1e-12 * made.size else 1.0


def sweep(pick: Callable[[float], Prefilter], values: Iterable[float]) -> tuple[Swept, ...]:
    """The filter that `pick` makes at each value; what it refuses there (`RelaxationsError`) is told."""
    found = []
    for value in values:
        try:
            found.append(Swept(value, pick(value)))
        except RelaxationsError as refused:
            found.append(Swept(value, None, str(refused)))
    return tuple(found)
