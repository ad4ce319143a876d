"""What a co-simulation is asked and what it answers, and the grid of communication points that makes it exact.

The grid is the union of the regular points n·h and all the command's breakpoints, so that the input never jumps inside a step
(`fmus.inputs` says how it is told in between). An FMU that takes steps of one size only gets a grid of that size, or none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmus.errors import FmuError
from fmus.variables import Value
from relaxations.commands import Command

MERGE = 1e-9
"""Points closer than this part of the step are one point: no FMU resolves it, and a step of rounding noise may be refused."""

TOLERANCE = 1e-10
"""Relative tolerance of the integrator of model exchange: an undamped mode is then off by some 1e-9 of its amplitude a period."""

TIGHTER = 10.0
"""By how much a refined run of model exchange tightens that tolerance."""

MOST_POINTS = 20_000_000
"""Communication points that a run may have: their times, inputs and one output take a gigabyte."""

Array = NDArray[np.float64]
Interface = Literal["co-simulation", "model-exchange"]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One run, from 0 to `stop` [s] with regular communication points every `step` [s].

    `outputs` names the FMU's variables to log (outputs, states …). `parameters` and `initial_state` are set before
    initialisation, each in the variable's own unit; `initial_input` is the input at rest, before the command starts.
    `interface` None is co-simulation where the FMU offers it, else model exchange, which has a `tolerance` (relative).
    Before the run begins, the FMU settles for `settle` [s] at that input (infinite: until it rests); the log starts afterwards.
    """

    fmu: Path
    input: str
    outputs: tuple[str, ...]
    parameters: Mapping[str, Value]
    initial_input: float
    initial_state: Mapping[str, float]
    command: Command
    stop: float
    step: float
    interface: Interface | None = None
    tolerance: float = TOLERANCE
    settle: float = 0.0

    def refined(self) -> Experiment:
        """The run whose distance from this one measures its numerical error: half the communication step, and a tighter tolerance."""
        return replace(self, step=self.step / 2.0, tolerance=self.tolerance / TIGHTER)


@dataclass(frozen=True, slots=True)
class Probe:
    """What of an identification is laid down by the user: sampling time [s], samples, amplitude (input units), order; None: chosen."""

    step: float | None = None
    samples: int | None = None
    amplitude: float | None = None
    order: int | None = None


@dataclass(frozen=True, slots=True)
class LogLine:
    """A message of the FMU: simulated time [s], FMI status word in lower case ("output" for what it printed), text."""

    time: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class Trajectory:
    """What was logged. Arrays are read-only.

    `times` (n,) [s]; `input` (n,) the value applied from that instant on; `values` (n, outputs), at a jump of the input
    the values just before it. A run that broke off has the rows up to the last good communication point.
    """

    times: Array
    input: Array
    values: Array
    messages: tuple[LogLine, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.times, self.input, self.values):
            array.setflags(write=False)


class RunStatus(Enum):
    """How a run ended; the value is the sentence for people."""

    FINISHED = "the run finished"
    WARNING = "the run finished, but the FMU returned Warning"
    DISCARD = "the FMU discarded a step"
    ERROR = "the FMU returned Error"
    FATAL = "the FMU returned Fatal"
    NOT_FINITE = "a logged value is not a finite number"
    CRASHED = "the FMU crashed its process"
    EXITED = "the FMU ended its process"
    HUNG = "the FMU did not answer in time"
    STUCK = "the integrator could not go on"
    MEMORY = "the FMU used up the memory that it may have"
    TERMINATED = "the FMU asked to end the run early"
    FAILED = "the run could not be carried out"

    @property
    def complete(self) -> bool:
        """Whether the trajectory reaches the stop time."""
        return self in (RunStatus.FINISHED, RunStatus.WARNING)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The end of a run: status, what exactly happened, the trajectory as far as it got (None: no point), wall-clock seconds."""

    status: RunStatus
    detail: str
    trajectory: Trajectory | None
    seconds: float
    messages: tuple[LogLine, ...] = ()


def grid(start: float, stop: float, step: float, breakpoints: Iterable[float] = ()) -> Array:
    """Communication points [s]: start + n·step, united with the breakpoints between start and stop, and stop itself.

    Each is computed from n, never accumulated. Of points closer than `MERGE`·step the breakpoint stays (start and stop
    always do). Raises `FmuError` for a step that is not positive, a stop that is not after the start, or more than `MOST_POINTS` points.
    """
    if not (math.isfinite(step) and step > 0.0):
        raise FmuError(f"the communication step must be positive and finite, is {step!r} s")
    if not (math.isfinite(stop) and stop > start):
        raise FmuError(f"the run must stop after it starts: start {start!r} s, stop {stop!r} s")
    _require_few(stop - start, step)
    near = MERGE * step
    fixed = [start]
    for point in sorted(breakpoints):
        if fixed[-1] + near < point < stop - near:
            fixed.append(point)
    fixed.append(stop)
    kept: Array = np.array(fixed, dtype=np.float64)
    regular: Array = start + np.arange(1, math.floor((stop - start) / step) + 1, dtype=np.float64) * step
    after = np.searchsorted(kept, regular).clip(1, len(kept) - 1)
    distance = np.minimum(np.abs(regular - kept[after - 1]), np.abs(kept[after] - regular))
    return np.sort(np.concatenate([kept, regular[(distance > near) & (regular < stop)]], dtype=np.float64))


def step_sizes(times: Array) -> Array:
    """The size of each step [s], the last one never beyond the stop time by rounding."""
    sizes = np.diff(times)
    if times[-2] + sizes[-1] > times[-1]:
        sizes[-1] = np.nextafter(sizes[-1], 0.0)
    return sizes


def multiples(stop: float, step: float, breakpoints: Iterable[float] = ()) -> Array:
    """Communication points n·step [s] from 0 to the first one that is not before `stop`, for an FMU that takes no other steps.

    Raises `FmuError` naming the first breakpoint before the stop that is none of them.
    """
    _require_few(stop, step)
    require_multiples((point for point in breakpoints if point < stop), step)
    return np.arange(samples(stop, step) + 1, dtype=np.float64) * step


def _require_few(length: float, step: float) -> None:
    if length / step > MOST_POINTS:
        raise FmuError(f"{length:.6g} s in steps of {step:.6g} s are {length / step:.2g} communication points, more than {MOST_POINTS:,}")


def require_multiples(breakpoints: Iterable[float], step: float) -> None:
    """Raise `FmuError` naming the first breakpoint [s] that is no multiple of the step, up to rounding."""
    for point in sorted(breakpoints):
        if abs(point - round(point / step) * step) > MERGE * step:
            raise FmuError(f"the input changes at {point!r} s, which is no multiple of the step {step!r} s")


def samples(stop: float, step: float) -> int:
    """The least number of steps [s] that reach the stop time, up to rounding."""
    return max(math.ceil(stop / step - MERGE), 1)
