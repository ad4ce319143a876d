"""What every run in the child process begins with and reports by: rows, messages, a fresh instance, initialisation."""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from fmus.accesses import Driven
from fmus.errors import CallFailed
from fmus.events import Steps
from fmus.instances import Instance, Log
from fmus.interfaces import Instance2, Instance3
from fmus.rows import Progress

MAX_MESSAGES = 1000
MAX_TEXT = 2000

Request = dict[str, Any]

_path = lru_cache(maxsize=16)(Path)  # the same few in run after run


class Messages:
    """Sends the FMU's log messages on as they come, at most `MAX_MESSAGES` a run."""

    def __init__(self, send: Callable[[Request], None]) -> None:
        """`send` takes one frame's message."""
        self._send = send
        self.number = 0
        self.count: ctypes.c_int64 | None = None
        self.times: array[float] = array("d")

    def restart(self) -> None:
        """The run begins again: what was said so far was about another one."""
        self._send({"restart": True})

    def begin(self, times: array[float], count: ctypes.c_int64 | None) -> None:
        """Start a run: a message's time is that of the last complete row."""
        self.number, self.times, self.count = 0, times, count

    def __call__(self, level: str, text: str) -> None:
        """Pass one message on."""
        self.number += 1
        if self.number > MAX_MESSAGES + 1:
            return
        row = max(self.count.value - 1, 0) if self.count is not None else 0
        time = self.times[row] if row < len(self.times) else 0.0
        if self.number == MAX_MESSAGES + 1:
            level, text = "warning", f"the FMU sent more than {MAX_MESSAGES} messages; the rest is dropped"
        cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + " …"
        self._send({"message": [time, level, cut]})


def create(request: Request, interface: str, log: Log, steps: Steps | None = None) -> Instance:
    """A fresh instance; its binary stays loaded from run to run.

    It costs a tenth of a millisecond and carries nothing over from the run before, which a reset only promises.
    """
    kind = Instance2 if request["fmi"] == 2 else Instance3
    instance = kind(_path(request["library"]), request["token"], request["name"], _path(request["resources"]), log)
    instance.instantiate(interface, steps)
    instance.log_trouble(request["log_categories"])
    return instance


def prepare(instance: Instance, request: Request) -> None:
    """Set structural parameters, parameters and start values, initialise with the inputs at rest."""
    instance.configure(request["structure"])
    for kind, reference, value in request["start"]:
        instance.set((kind, reference), value)
    instance.enter_initialization(request["stop"], request["tolerance"])
    for kind, reference, value in request["inputs"]:
        instance.set((kind, reference), value)
    driver(instance, request)(request["initial_input"])
    instance.exit_initialization()


def driver(instance: Instance, request: Request) -> Callable[[float], None]:
    """A fast function that sets the input that the command drives; if it is an array's element, its neighbours keep what they have."""
    return instance.setter(driven(instance, request))


def driven(instance: Instance, request: Request) -> Driven:
    """The input that the command drives."""
    kind, reference, *element = request["input"]
    return instance.driven(kind, reference, element, request["neighbours"])


def failed(problem: CallFailed, progress: Progress, times: array[float]) -> Request:
    """The reply for a call that an FMU answered by Discard, Error or Fatal."""
    status = problem.status.upper() if problem.status in ("Discard", "Error", "Fatal") else "FAILED"
    done = progress.count.value
    return {"status": status, "detail": f"{problem} ({f'after {times[done - 1]:.9g} s' if done else 'before the first point'})"}
