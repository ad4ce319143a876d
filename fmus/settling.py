"""Operating points that are reached by simulation: the FMU runs with its input at rest until it rests too, and only then is anything asked.

A run that settles first is an ordinary run whose command starts later (`preceded`), of which the beginning is cut off (`trimmed`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmus.archives import Fmu
from fmus.errors import LinearizationError
from fmus.plans import grid_step
from fmus.stepping import MERGE, Array, Experiment, Outcome, Trajectory
from relaxations.commands import Command, Segment, Tail

if TYPE_CHECKING:
    from fmus.workers import Worker

CHANGE = 1e-9  # of a variable's size: what may still move within the second half of the time for it to be called rest
BLOCK, BLOCKS = 256, 11  # communication steps of the first attempt, and how often they are doubled: half a million in the end


def preceded(experiment: Experiment) -> Experiment:
    """The same run beginning after `experiment.settle` seconds (rounded up to whole steps) at its initial input."""
    settle = whole_steps(experiment.settle, experiment.step)
    command, rest = experiment.command, Segment(settle, experiment.initial_input)
    later = tuple(Segment(s.start + settle, s.level, s.slope) for s in command.segments)
    if not later or later[0].start > settle:
        later = (rest, *later)
    moved = Command(command.end + settle - later[0].start, later, command.tail)
    return replace(experiment, command=moved, stop=experiment.stop + settle, settle=0.0)


def trimmed(outcome: Outcome, experiment: Experiment) -> Outcome:
    """What `preceded` came to, in the time of the command; a run that broke off while settling has no trajectory."""
    settle, whole = whole_steps(experiment.settle, experiment.step), outcome.trajectory
    messages = tuple(replace(line, time=line.time - settle) for line in outcome.messages)
    if whole is None or whole.times[-1] < settle:
        detail = f"{outcome.detail} (while settling for {settle:g} s)" if whole is not None else outcome.detail
        return replace(outcome, trajectory=None, detail=detail, messages=messages)
    first = int(np.searchsorted(whole.times, settle))
    kept = Trajectory(_since(whole.times[first:], settle, experiment), whole.input[first:].copy(), whole.values[first:].copy(), messages)
    return replace(outcome, trajectory=kept, messages=messages)


def _since(times: Array, settle: float, experiment: Experiment) -> Array:
    """The times counted from the end of settling, and without the rounding of that: regular points and breakpoints are what they were."""
    near, since = MERGE * experiment.step, times - settle
    regular = np.round(since / experiment.step) * experiment.step
    since = np.where(np.abs(since - regular) <= near, regular, since)
    fixed = np.unique([*experiment.command.breakpoints, experiment.stop])
    nearest = fixed[np.searchsorted((fixed[1:] + fixed[:-1]) / 2.0, since)]
    return np.where(np.abs(since - nearest) <= near, nearest, since)


def whole_steps(duration: float, step: float) -> float:
    """`duration` rounded up to a multiple of `step` [s]."""
    return math.ceil(duration / step - 1e-9) * step


def natural_step(fmu: Fmu) -> float:
    """The communication step that the FMU itself suggests [s]; a hundredth of a second if it suggests none."""
    has = fmu.description
    return grid_step(has, None, None) or has.default_step or 0.01


def _early(times: Array, values: Array, away: NDArray[np.intp], names: tuple[str, ...]) -> tuple[float, dict[str, float]]:
    """The first point from which on nothing changes any more, but not the start: there nothing has run yet."""
    first = min(int(away[-1]) + 1 if len(away) else 1, len(times) - 1)
    return float(times[first]), dict(zip(names, values[first].tolist(), strict=True))


def rest(worker: Worker, fmu: Fmu, experiment: Experiment, timeout: float) -> tuple[float, dict[str, float]]:
    """How long the FMU takes to settle [s] with its input at `initial_input`, and the values of states and outputs then.

    `experiment.settle` is the time to wait, infinite for: until no state and no output changes by more than a billionth of its size
    within the second half of the time. Raises `LinearizationError` if it never rests, or if the run breaks off.
    """
    has = fmu.description.resized(experiment.parameters)
    named = (*experiment.outputs, *has.state_names)
    logged = tuple(dict.fromkeys(name for name in named if has.find(name).is_number))
    step = experiment.step
    waiting = Command(0.0, (), Tail(experiment.initial_input))
    sizes = np.array([has.find(name).nominal for name in logged])
    moved, stop = dict.fromkeys(logged, 0.0), 0.0
    for doubling in range(BLOCKS + 1):
        stop = whole_steps(experiment.settle, step) if math.isfinite(experiment.settle) else BLOCK * 2**doubling * step
        outcome = worker.run(replace(experiment, outputs=logged, command=waiting, stop=stop, settle=0.0), timeout)
        if outcome.trajectory is None or not outcome.status.complete:
            raise LinearizationError(f"{fmu.path.name} broke off while it settled: {outcome.status.value}: {outcome.detail}")
        values = outcome.trajectory.values
        final = dict(zip(logged, values[-1].tolist(), strict=True))
        if math.isfinite(experiment.settle):
            return stop, final
        scale = np.maximum(np.abs(values[-1]), sizes)
        change = np.ptp(values[len(values) // 2 :], axis=0) / scale
        moved = dict(zip(logged, change.tolist(), strict=True))
        if max(moved.values()) <= CHANGE:
            away = np.flatnonzero((np.abs(values - values[-1]) > CHANGE * scale).any(axis=1))
            return _early(outcome.trajectory.times, values, away, logged)
    worst = max(moved, key=lambda name: moved[name])
    raise LinearizationError(
        f"{fmu.path.name} does not come to rest with input {experiment.initial_input!r}: within the second half of {stop:g} s "
        f"{worst!r} still changes by {moved[worst]:.2g} of its size; choose another input, or give the state at rest, or the time to settle"
    )
