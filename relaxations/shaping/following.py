"""A shaper that follows a mode which varies while the machine moves: the shaped command in closed form, and the move that goes with it.

    u(t) = Σ_i A_i(t) r(t - t_i(t)),   A_i and t_i linear between the instants of a schedule, Σ A_i = 1

(Singer and Seering, claims 25 and 26). Of a reference r that switches between levels u is piecewise linear: it jumps where r does, at t
with t - t_i(t) at one of its switches, and nowhere else, whatever the schedule does. Unlike a convolution this keeps the displacement only
nearly; `following_move` therefore moves the switches of r until the rigid part rests where it should (Newton's method: as many durations
as equations).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ShaperError, SolverError
from relaxations.maneuvers import Problem
from relaxations.response import moments
from relaxations.shaping.streams import Schedule

Reals = NDArray[np.float64]

CLOSED = 1e-12  # of the target
STEPS = 20
DIFFERENCE = 1e-7  # of a duration


def followed(reference: Command, schedule: Schedule, rest: float = 0.0) -> Command:
    """What the varying shaper makes of a command of constant levels; `rest` is the input before its start.

    Raises `ShaperError` for slopes and tails, and for a mode that changes so fast that impulses would overtake each other.
    """
    if reference.tail.terms or any(segment.slope for segment in reference.segments):
        raise ShaperError("a shaper that follows a schedule takes references of constant levels, without slopes and tails")
    instants = np.array(schedule.instants)
    times = schedule.at(instants)[0]  # (impulses, schedule)
    switches = np.array([*(segment.start for segment in reference.segments), reference.end])
    levels = np.array([rest, *(segment.level for segment in reference.segments), reference.tail.steady])
    arrivals = []
    for row in times:
        # What acts at t left the reference at t - t_i(t), which has to grow.
        left = instants - row
        if np.any(np.diff(left) <= 0.0):
            raise ShaperError("the mode changes so fast that the reference would be read backwards; a schedule changes more slowly")
        at = np.interp(switches, left, instants)
        at = np.where(switches < left[0], switches + row[0], np.where(switches > left[-1], switches + row[-1], at))
        arrivals.append(at)
    end = max(at[-1] for at in arrivals)
    points = np.unique(np.concatenate([*arrivals, instants[(instants > 0.0) & (instants < end)]]))
    points = points[np.append(True, np.diff(points) > 1e-12 * end)]
    middles = (points[:-1] + points[1:]) / 2.0
    acting = np.array([levels[np.searchsorted(at, middles, side="right")] for at in arrivals])  # (impulses, pieces)
    heads, tails = schedule.at(points[:-1])[1], schedule.at(points[1:])[1]
    first, last = (heads * acting).sum(axis=0), (tails * acting).sum(axis=0)
    slopes = (last - first) / np.diff(points)
    segments = tuple(Segment(float(t), float(a), float(b)) for t, a, b in zip(points[:-1], first, slopes, strict=True))
    return Command(float(points[-1] - points[0]), segments, Tail(reference.tail.steady))


def following_move(rigid: Problem, reference: Command, schedule: Schedule) -> tuple[Command, Command]:
    """The reference with its switches moved so that what the varying shaper makes of it is a move of the `rigid` part, and that.

    Raises `ShaperError` as `followed` does, and if the reference has fewer switches than the rigid part has equations, `SolverError`.
    """
    target, rest = rigid.sets[0], rigid.rest
    starts = np.array([*(segment.start for segment in reference.segments), reference.end])
    size = target.basis.size
    durations: Reals = np.diff(starts).astype(np.float64)
    if len(durations) < size:
        raise ShaperError(f"the reference switches {len(durations)} times, its end included; following a schedule takes at least {size}")

    def moved(durations: Reals) -> Command:
        at = np.concatenate([[starts[0]], starts[0] + np.cumsum(durations)])
        kept = tuple(Segment(float(t), segment.level) for t, segment in zip(at, reference.segments, strict=False))
        return Command(float(at[-1] - at[0]), kept, reference.tail)

    def missed(durations: Reals) -> Reals:
        command = followed(moved(durations), schedule, rest)
        return moments(target.basis, command, command.end, rest) - target.target

    scale = max(float(np.abs(target.target).max()), 1e-300)
    for _ in range(STEPS):
        value = missed(durations)
        if np.abs(value).max() <= CLOSED * scale:
            reference = moved(durations)
            return reference, followed(reference, schedule, rest)
        nudges = DIFFERENCE * durations
        table = np.array([(missed(durations + nudge) - value) / nudge.sum() for nudge in np.diag(nudges)]).T
        durations = (durations - np.linalg.lstsq(table, value, rcond=None)[0]).astype(np.float64)
        if durations.min() <= 0.0:
            break
    raise SolverError("no move of the rigid part goes with this schedule; let the mode change less during the move")
