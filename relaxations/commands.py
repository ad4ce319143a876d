"""The command: what the actuator is told, as a function of time.

A command is a chain of segments (constant or sloping) that lasts `maneuver_time` seconds from its first segment's start,
followed by a tail. Before the first segment the input rests at its initial value, which the command does not know.
"""

from __future__ import annotations

import cmath
import itertools
import json
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relaxations.errors import CommandError

FORMAT = "slewcert-command/1"


@dataclass(frozen=True, slots=True)
class Segment:
    """`level + slope (t - start)` from `start` [s] to the next segment's start; level in input units, slope in input units per second."""

    start: float
    level: float
    slope: float = 0.0


@dataclass(frozen=True, slots=True)
class TailTerm:
    """`Re(coefficient · r^power · e^{rate r})`, r the time since the end of the segments [s]; a pair is one term, Im(rate) > 0."""

    rate: complex
    power: int
    coefficient: complex


@dataclass(frozen=True, slots=True)
class Tail:
    """The input from the end of the segments on: `steady` (input units, absolute) plus decaying terms."""

    steady: float
    terms: tuple[TailTerm, ...] = ()

    def __call__(self, since: ArrayLike) -> NDArray[np.float64]:
        """Input at `since` ≥ 0 [s] after the end of the segments."""
        r = np.asarray(since, dtype=float)
        total = np.full(r.shape, self.steady)
        for term in self.terms:
            total = total + (term.coefficient * r**term.power * np.exp(term.rate * r)).real
        return total


@dataclass(frozen=True, slots=True)
class Piece:
    """The input from `start` [s] on, until the next piece: `level + slope r + Σ Re(c r^power e^{rate r})` with r = t - start.

    The formula is smooth beyond both ends, so that an integrator may look there. Called with one time, in plain numbers: it is what a
    right-hand side asks for thousands of times.
    """

    start: float
    level: float
    slope: float = 0.0
    terms: tuple[TailTerm, ...] = ()

    @property
    def constant(self) -> bool:
        """Whether the input stands still."""
        return self.slope == 0.0 and not self.terms

    def __call__(self, time: float) -> float:
        """The input at `time` [s]."""
        r = time - self.start
        value = self.level + self.slope * r
        for term in self.terms:
            value += (term.coefficient * r**term.power * cmath.exp(term.rate * r)).real
        return value


@dataclass(frozen=True, slots=True)
class Command:
    """A finite move followed by a tail (`../docs/task.md`, command file).

    `maneuver_time` is the duration T [s] of the segments; their first start shifts them, not T. Inputs are absolute.
    """

    maneuver_time: float
    segments: tuple[Segment, ...]
    tail: Tail

    def __post_init__(self) -> None:
        if not self.segments and self.maneuver_time != 0.0:
            raise CommandError(f"a command without segments has maneuver_time 0, not {self.maneuver_time!r}")
        numbers = [self.maneuver_time, self.tail.steady]
        numbers += [x for s in self.segments for x in (s.start, s.level, s.slope)]
        numbers += [x for t in self.tail.terms for x in (t.rate.real, t.rate.imag, t.coefficient.real, t.coefficient.imag)]
        if not all(map(math.isfinite, numbers)):
            raise CommandError("a command holds finite numbers only")
        if self.maneuver_time < 0.0:
            raise CommandError(f"maneuver_time must not be negative, is {self.maneuver_time!r}")
        starts = [s.start for s in self.segments]
        for before, after in itertools.pairwise(starts):
            if not before < after:
                raise CommandError(f"segments must start in strictly ascending order: {after!r} follows {before!r}")
        if starts and not (starts[0] >= 0.0 and starts[-1] <= self.end):
            raise CommandError(f"segments must start within [0, {self.end!r}]: they run from {starts[0]!r} to {starts[-1]!r}")
        for term in self.tail.terms:
            if term.rate.real >= 0.0 or term.power < 0:
                raise CommandError(f"a tail term decays: rate {term.rate!r} (power {term.power}) does not")

    @property
    def start(self) -> float:
        """When the move begins [s]."""
        return self.segments[0].start if self.segments else 0.0

    @property
    def end(self) -> float:
        """When the move ends and the tail begins [s]."""
        return self.start + self.maneuver_time

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Every instant at which level or slope may change, the start and the end of the move included, ascending [s]."""
        return tuple(sorted({*(s.start for s in self.segments), self.start, self.end}))

    def __call__(self, times: ArrayLike, rest: float = 0.0) -> NDArray[np.float64]:
        """The input at `times` [s]; at a jump the value after it. `rest` is the input before the start."""
        t = np.asarray(times, dtype=float)
        starts = np.array([s.start for s in self.segments])
        index = np.searchsorted(starts, t, side="right") - 1
        table = np.array([(s.start, s.level, s.slope) for s in self.segments] or [(0.0, rest, 0.0)])
        start, level, slope = table[np.maximum(index, 0)].T
        moving = np.where(index < 0, rest, level + slope * (t - start))
        return np.where(t >= self.end, self.tail(np.maximum(t - self.end, 0.0)), moving)

    def pieces(self, rest: float = 0.0) -> tuple[Piece, ...]:
        """The input from t = 0 on as smooth pieces, ascending: rest, segments, tail. Together they are `self(t, rest)`."""
        waiting = (Piece(0.0, rest),) if self.start > 0.0 else ()
        moving = tuple(Piece(s.start, s.level, s.slope) for s in self.segments if s.start < self.end)
        return *waiting, *moving, Piece(self.end, self.tail.steady, 0.0, self.tail.terms)

    def fuel(self, rest: float = 0.0) -> float:
        """`∫ |u - rest| dt` over the segments (input units times second), exact for piecewise linear u; the tail's fuel is apart."""
        total = 0.0
        ends = (*(s.start for s in self.segments[1:]), self.end)
        for segment, end in zip(self.segments, ends, strict=False):  # without segments nothing is moved before the tail
            width = end - segment.start
            first = segment.level - rest
            last = first + segment.slope * width
            if first * last >= 0.0:
                total += abs(first + last) / 2 * width
            else:  # the input crosses its rest value inside the segment: two triangles
                total += (first**2 + last**2) / (2 * abs(segment.slope))
        return total

    def extent(self) -> tuple[float, float]:
        """Least and greatest input from the start of the move on: ends of the segments, and the tail on a grid until it has decayed."""
        starts = [segment.start for segment in self.segments]
        levels: list[float] = []
        for segment, end in zip(self.segments, [*starts[1:], self.end], strict=False):  # of no segments there is no first start
            levels += [segment.level, segment.level + segment.slope * (end - segment.start)]
        slowest = min((-term.rate.real for term in self.tail.terms), default=1.0)
        levels += self.tail(np.linspace(0.0, 20.0 / slowest, 2001)).tolist()  # until nothing is left of its slowest term
        return min(levels), max(levels)

    def shifted(self, delay: float) -> Command:
        """The same command, beginning `delay` [s] later."""
        segments = tuple(Segment(s.start + delay, s.level, s.slope) for s in self.segments)
        return Command(self.maneuver_time, segments, self.tail)

    def to_dict(self) -> dict[str, Any]:
        """The command file as plain data (`slewcert-command/1`)."""
        return {
            "format": FORMAT,
            "maneuver_time": self.maneuver_time,
            "segments": [{"start": s.start, "level": s.level, "slope": s.slope} for s in self.segments],
            "tail": {
                "steady": self.tail.steady,
                "terms": [
                    {"rate": [t.rate.real, t.rate.imag], "power": t.power, "coefficient": [t.coefficient.real, t.coefficient.imag]}
                    for t in self.tail.terms
                ],
            },
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Command:
        """The inverse of `to_dict`; raises `CommandError` naming what is malformed."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
            raise CommandError(f'a command file has "format": "{FORMAT}"; this one has {found!r}')
        try:
            return Command(
                float(data["maneuver_time"]),
                tuple(Segment(float(s["start"]), float(s["level"]), float(s.get("slope", 0.0))) for s in data["segments"]),
                Tail(
                    float(data["tail"]["steady"]),
                    tuple(
                        TailTerm(complex(*t["rate"]), operator.index(t["power"]), complex(*t["coefficient"]))
                        for t in data["tail"].get("terms", ())
                    ),
                ),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as problem:
            raise CommandError(f"malformed command file: {type(problem).__name__} {problem}") from None

    @staticmethod
    def from_json(text: str) -> Command:
        """Read a command file's text."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as problem:  # numbers of thousands of digits and nesting without end are refused too
            raise CommandError(f"a command file is JSON: {problem}") from None
        return Command.from_dict(data)
