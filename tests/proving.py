"""What a bracket must be that is called proven: accepted by the checker, from both sides, and as narrow as that."""

from __future__ import annotations

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.maneuvers import Problem
from relaxations.proofs import minimum_time

_FOUND: dict[str, Bound] = {}


def found_once(asked: Problem) -> Bound:
    """`minimum_time`, of a problem that was asked before from memory; by what it says of itself, as its polynomials are no keys."""
    if repr(asked) not in _FOUND:
        _FOUND[repr(asked)] = minimum_time(asked)
    return _FOUND[repr(asked)]


def sides(found: Bound, gap: float) -> tuple[float, float]:
    """Both sides [s], at most `gap` apart (relative)."""
    assert found.status is Status.PROVED, found.reason
    assert found.certificate is not None
    assert found.upper is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.upper - found.lower <= gap * found.lower
    return found.lower, found.upper


def proven(asked: Problem) -> tuple[Bound, Command]:
    """The bracket, both sides of which the checker has accepted, and its command."""
    found = found_once(asked)
    assert found.command is not None
    sides(found, float("inf"))
    return found, found.command
