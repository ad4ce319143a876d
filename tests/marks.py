"""Which cases of a parametrised test are for the slow suite alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow(*values: Any, id: str | None = None) -> Any:
    """One case."""
    return pytest.param(*values, marks=pytest.mark.slow, id=id)


def first(quick: int, cases: Iterable[Any]) -> list[Any]:
    """All cases; the first `quick` of them are in the fast suite, too. A tuple is one case of several arguments."""
    cases = list(cases)
    return cases[:quick] + [slow(*case) if isinstance(case, tuple) else slow(case) for case in cases[quick:]]


def in_turn(names: Iterable[str], versions: tuple[str, str] = ("2.0", "3.0"), quick: int | None = None) -> list[Any]:
    """Every name with both versions; in the fast suite with one of them, in turn, and no more than the `quick` first names."""
    return [
        (name, version) if place % 2 == which and (quick is None or place < quick) else slow(name, version)
        for place, name in enumerate(names)
        for which, version in enumerate(versions)
    ]
