"""What a command of few pieces does to limits that hold at every instant, and its derivatives by their durations: cutting planes.

Two kinds of limits are watched: what the plants of a box keep after the move, at `since` [s] after it, and named outputs at times [s] from
the beginning of the move on. Of both only some instants are looked at, and more where a command exceeds a limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from relaxations.courses import Course, exceeded_places
from relaxations.maneuvers import Problem, problem
from relaxations.robust.residuals import Sample
from relaxations.robust.search import worst_places
from relaxations.varying_courses import VaryingCourse, flows

Reals = NDArray[np.float64]
Seen = dict[float, tuple[Reals, float]]

POINTS = 400  # of the move at which outputs are looked at
SAME = 1e-9  # of the move: instants that are so close are looked at once


@dataclass(frozen=True, slots=True)
class Watch:
    """Instants [s] after the move at which each sample of the box is looked at, and times [s] at which each course is."""

    problem: Problem
    after: tuple[Reals, ...]
    during: tuple[Reals, ...]
    seen: dict[str, Seen] = field(default_factory=dict, compare=False, repr=False)  # by course, what `_gone` knows of a plant that varies

    @staticmethod
    def of(posed: Problem) -> Watch:
        """Of residuals the first instants, of outputs none."""
        samples = posed.residuals.samples if posed.residuals else ()
        return Watch(posed, tuple(sample.looks() for sample in samples), tuple(np.zeros(0) for _ in posed.courses))

    def rooms(self, levels: Reals, durations: Reals) -> tuple[Reals, Reals]:
        """What is left of each limit on either side, as a fraction of it, and its derivatives: (k,) and (k, len(durations))."""
        values, slopes = [np.zeros(0)], [np.zeros((0, len(durations)))]
        samples = self.problem.residuals.samples if self.problem.residuals else ()
        for sample, since in zip(samples, self.after, strict=True):
            below, above = sample.room
            value, slope = _left(sample, since, levels, durations)
            values += [1.0 - value / above, 1.0 + value / below]
            slopes += [-slope / above, slope / below]
        for course, times in zip(self.problem.courses, self.during, strict=True):
            if len(times):
                value, slope = _gone(self.problem, course, times, levels, durations, self.seen.setdefault(course.name, {}))
                values += [1.0 - value / course.limit, 1.0 + value / course.limit]
                slopes += [-slope / course.limit, slope / course.limit]
        return np.concatenate(values), np.vstack(slopes)

    def further(self, levels: Reals, durations: Reals, share: float) -> Watch | None:
        """With the instants and the places of the box at which a command is beyond that `share` of a limit; None where it is not."""
        posed, instants = self.problem, np.concatenate([[0.0], np.cumsum(durations)])
        more, known = posed, 0
        if posed.residuals is not None and posed.maneuver.box is not None:
            worst, box = worst_places(posed, instants, levels, share), posed.maneuver.box
            more = problem(posed.plants, replace(posed.maneuver, box=replace(box, samples=tuple(dict.fromkeys([*box.samples, *worst])))))
            known = len(posed.residuals.samples)
        after, over = list(self.after), False
        if more.residuals is not None:
            after += [sample.looks() for sample in more.residuals.samples[known:]]
            over = len(more.residuals.samples) > known
            for k, sample in enumerate(more.residuals.samples):
                peaks, sizes = sample.peaks(sample.table(instants) @ levels - sample.rest, share)
                found = _added(after[k], peaks[sizes > share], float(instants[-1]))
                over, after[k] = over or len(found) > len(after[k]), found
        during = [*self.during, *(np.zeros(0) for _ in more.courses[len(self.during) :])]
        for number, time in _beyond(more, instants, levels, share):
            found = _added(during[number], np.array([time]), float(instants[-1]))
            over, during[number] = over or len(found) > len(during[number]), found
        return Watch(more, tuple(after), tuple(during), self.seen) if over else None


def _added(known: Reals, new: Reals, horizon: float) -> Reals:
    """Instants with those that are new among others."""
    fresh = [t for t in new if not len(known) or np.abs(known - t).min() > SAME * horizon]
    return np.concatenate([known, fresh])


def _left(sample: Sample, since: Reals, levels: Reals, durations: Reals) -> tuple[Reals, Reals]:
    """The residual of a sample, and its derivatives: a longer piece begins all that is before it earlier, seen from the end."""
    to_go, jumps = np.cumsum(durations[::-1])[::-1], np.diff(levels, prepend=0.0)
    moments, rows = sample.basis.rows(to_go, 1) @ jumps, sample.rows(since)
    return rows @ (moments - sample.rest), rows @ np.cumsum(sample.basis.rows(to_go) * jumps, axis=1)


def _gone(posed: Problem, course: Course, times: Reals, levels: Reals, durations: Reals, known: Seen) -> tuple[Reals, Reals]:
    """An output at times from the beginning, and its derivatives: a longer piece shifts all jumps after it.

    `known` keeps what no duration changes, by time.
    """
    instants = np.concatenate([[0.0], np.cumsum(durations)])
    final = 0.0 if posed.transition is not None else posed.hold
    value, kicks = np.zeros(len(times)), np.zeros((len(times), len(instants)))
    if isinstance(course, VaryingCourse):
        transition = posed.transition
        assert transition is not None
        jumps = np.append(levels, final) - np.append(0.0, levels)
        whole = transition.rows(np.append(instants, times), 1)
        moving = transition.rows(instants)
        for k, t in enumerate(times):
            row, resting = known[t] if t in known else known.setdefault(t, _seen(course, t))
            on = instants < t
            reached = ((whole[:, len(instants) + k][:, None] - whole[:, : len(instants)]) * jumps)[:, on].sum(axis=1)
            value[k] = row @ (reached - course.away) + resting
            kicks[k] = np.where(on, -(row @ moving) * jumps, 0.0)
    else:
        jumps = np.append(levels, final) - np.append(0.0, levels)
        since = times[:, None] - instants
        on, flat = since > 0.0, np.maximum(since, 0.0).ravel()
        reached, moving = ((course.weights @ course.basis.rows(flat, k)).reshape(since.shape) for k in (1, 0))
        value = course.free(times) + np.where(on, reached * jumps, 0.0).sum(axis=1)
        kicks = np.where(on, -moving * jumps, 0.0)
    later = np.cumsum(kicks[:, ::-1], axis=1)[:, ::-1]
    return value, later[:, 1:]


def _seen(course: VaryingCourse, time: float) -> tuple[Reals, float]:
    """c(t) Φ(t, 0), and c(t) x_ss."""
    n, row = len(course.rest), course.at(np.array([time]))[0]
    moved = flows(course.moving, course.instants, np.array([0.0, time]))[0][:n, :n] if time > 0.0 else np.eye(n)
    return row @ moved, float(row @ course.rest)


def _beyond(posed: Problem, instants: Reals, levels: Reals, share: float) -> Sequence[tuple[int, float]]:
    """Courses and times at which they are beyond that share of their limits."""
    if not posed.courses:
        return ()
    fine = np.union1d(instants, np.linspace(0.0, instants[-1], POINTS))
    values = levels[np.clip(np.searchsorted(instants, (fine[1:] + fine[:-1]) / 2) - 1, 0, len(levels) - 1)]
    if posed.transition is not None:  # its courses are written backwards in time
        found = exceeded_places(posed.courses, instants[-1] - fine[::-1], values[::-1], share)
        found[:, 1] = 1.0 - found[:, 1]
    else:
        found = exceeded_places(posed.courses, fine, values, share)
    kept: list[tuple[int, float]] = []
    for number, place in sorted((int(number), float(place)) for number, place in found):
        if not kept or kept[-1][0] != number or place - kept[-1][1] > 1.0 / POINTS * 4:
            kept.append((number, place))
    return [(number, place * float(instants[-1])) for number, place in kept]
