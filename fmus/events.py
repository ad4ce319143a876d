"""What is said between an importer and an FMU about steps and events, in the words of no FMI version."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class Interruption:
    """A step that was not simply done: how far it came (time [s]), and what the FMU wants.

    `event`: event mode; `terminate`: the end of the run; `discarded`: a shorter step.
    """

    reached: float
    event: bool = False
    terminate: bool = False
    discarded: bool = False


@dataclass(slots=True)
class Discrete:
    """What the FMU says at the end of an event: what has changed, whether it wants to end the run, and its next time event [s]."""

    again: bool = False
    terminate: bool = False
    nominals_changed: bool = False
    states_changed: bool = False
    next_event: float = math.inf


@dataclass(slots=True)
class Steps:
    """How a co-simulation of FMI 3.0 is to take its steps: with event mode, ending early, asking for the inputs `required` on the way.

    `supply` is then called with the time [s] that they are wanted for, and sets them.
    """

    event_mode: bool = False
    early_return: bool = False
    required: tuple[int, ...] = ()
    supply: Callable[[float], None] | None = None
