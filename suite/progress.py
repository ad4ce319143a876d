"""What a long job tells whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from suite.campaign import RunResult


@dataclass(frozen=True, slots=True)
class Progress:
    """What a caller may show while it waits: `planned` runs in all, each result as it comes, and steps of other work."""

    planned: Callable[[int], None] = lambda count: None
    finished: Callable[[RunResult], None] = lambda result: None
    advance: Callable[[], None] = lambda: None
