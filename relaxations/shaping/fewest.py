"""On as few samples as do: what is found on some is found on more, for waiting costs nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

Found = TypeVar("Found")


def fewest(one: Callable[[int], Found | None], first: int, most: int, longer: float, low: int = 0) -> tuple[int, Found] | None:
    """The least number of samples above `low` for which `one` finds something, and that; None if it finds nothing on `most`.

    From `first` on `longer` times as many are tried next: far more than it takes would not do, for a mode decays meanwhile beyond what
    programs tell from nothing.
    """
    high = min(first, most)
    while (found := one(high)) is None:
        if high == most:
            return None
        low, high = high, min(max(high + 1, math.ceil(longer * high)), most)
    while high - low > 1:
        middle = (low + high) // 2
        better = one(middle)
        if better is None:
            low = middle
        else:
            high, found = middle, better
    return high, found
