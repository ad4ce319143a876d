"""Where kinds of shapers promise that nothing is left: these modes, and so many derivatives."""

from __future__ import annotations

from relaxations.shaping.comparisons import different
from relaxations.shaping.humps import extra_insensitive, unity_magnitude
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request


def all_modes(request: Request, number: int) -> tuple[tuple[Mode, ...], int]:
    """Every mode, and `number` derivatives."""
    return different(request.modes), number


def all_once(request: Request, number: int) -> tuple[tuple[Mode, ...], int]:
    """Every mode."""
    return different(request.modes), 0


def between_humps(request: Request, number: int) -> tuple[tuple[Mode, ...], int]:
    """Zeros between a mode's humps, those of the shaper that its own damping has."""
    return tuple(zero for mode in different(request.modes) for zero in extra_insensitive(mode, request.tolerance, number).zeros), 0


def between_unity_humps(request: Request, number: int) -> tuple[tuple[Mode, ...], int]:
    """The same with impulses 1, -1, 1 …."""
    return tuple(zero for mode in different(request.modes) for zero in unity_magnitude(mode, request.tolerance, number).zeros), 0
