"""«Did you mean»: the nearest of the names that would have been valid."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """The valid name most like `name`, or None if none is like it; case does not count."""
    by_folded = {candidate.casefold(): candidate for candidate in valid}
    found = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return by_folded[found[0]] if found else None


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """` (did you mean "…"?)`, or nothing."""
    found = nearest(name, valid)
    return "" if found is None else f' (did you mean "{found}"?)'
