"""Shapers on a live stream of samples: a filter with bounded memory, block by block the same as on the whole, to the last bit.

    y(t_n) = Σ_i A_i r(t_n - t_i),   t_n = nh,   r linear between samples and `rest` before the first

Decaying terms (relaxations.shaping.decays) are exact wherever they begin.
A shaper whose instants are multiples of the sample time (relaxations.shaping.sampled) is applied exactly; of others each impulse becomes
two neighbouring ones, which keeps its sum and its centre and changes its phasor by the order of (ωh)²/8 of it.
A varying shaper reads A_i and t_i from a schedule at t_n: they and r are continuous, and so is the output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relaxations.errors import ShaperError
from relaxations.shaping.decays import Decay
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Convolvable, Shaper

Reals = NDArray[np.float64]

ON_THE_GRID = 1e-9  # of a sample: instants that differ so little are multiples of the sample time


class Stream:
    """A shaper as a running filter of samples, `sample_time` [s] apart; `rest` is the reference before the first one.

    Also of a filter of any static gain (`relaxations.cancelling.prefilters`). Raises `ShaperError` for a time that is not positive.
    """

    def __init__(self, shaper: Convolvable, sample_time: float, rest: float = 0.0) -> None:
        _require(sample_time)
        taps: dict[int, float] = {}
        for delay, weight in _taps(shaper, sample_time):
            if weight:
                taps[delay] = taps.get(delay, 0.0) + weight
        self.taps = tuple(sorted(taps.items()))
        self._decays = [Decay(term, sample_time, *_split(term.start / sample_time), rest) for term in shaper.terms]
        last = max([0, *taps, *(decay.delay + 1 for decay in self._decays)])
        self._memory = np.full(last, float(rest))

    def __call__(self, block: ArrayLike) -> Reals:
        """The shaped samples (n,) of the next samples (n,) of the reference; n may be 0.

        Raises `ShaperError` for what is no row of finite numbers; the filter is then as it was before.
        """
        fresh = _samples(block)
        known = np.concatenate([self._memory, fresh])
        past, count = len(self._memory), len(fresh)
        shaped, part = np.zeros(count), np.empty(count)
        for delay, weight in self.taps:
            np.multiply(known[past - delay : past - delay + count], weight, out=part)
            shaped += part
        for decay in self._decays:
            now, before = (known[past - back : past - back + count] for back in (decay.delay, decay.delay + 1))
            shaped += decay(now, before)
        self._memory = known[count:]
        return shaped


@dataclass(frozen=True, slots=True)
class Schedule:
    """Which shaper acts when: `shapers` at ascending `instants` [s], in between both mixed impulse by impulse, at either end held.

    Where kinds change, the shaper of fewer impulses has further ones of amplitude 0 at its end: they grow from there.
    """

    instants: tuple[float, ...]
    shapers: tuple[Shaper, ...]

    def __post_init__(self) -> None:
        wrong = []
        if len(self.instants) != len(self.shapers) or not self.shapers:
            wrong.append(f"a schedule has one shaper for each instant; there are {len(self.instants)} and {len(self.shapers)}")
        if not all(map(math.isfinite, self.instants)) or any(b <= a for a, b in zip(self.instants, self.instants[1:], strict=False)):
            wrong.append(f"instants of a schedule ascend; these are {list(self.instants)}")
        if any(shaper.pulses for shaper in self.shapers):
            wrong.append("a schedule is made of impulses, not of pulses")
        if wrong:
            raise ShaperError("; ".join(wrong))

    @staticmethod
    def of(instants: Sequence[float], modes: Sequence[Mode], make: Callable[[Mode], Shaper]) -> Schedule:
        """A shaper of one kind for a mode that is known at some instants."""
        return Schedule(tuple(instants), tuple(map(make, modes)))

    def at(self, instants: ArrayLike) -> tuple[Reals, Reals]:
        """Times and amplitudes of the impulses (impulses, n) at `instants` (n,) [s]."""
        where = np.asarray(instants, dtype=float)
        most = max(len(shaper.times) for shaper in self.shapers)
        lasting = [(*s.times, *[s.times[-1]] * (most - len(s.times))) for s in self.shapers]
        growing = [(*s.amplitudes, *[0.0] * (most - len(s.times))) for s in self.shapers]
        times, amplitudes = (
            np.array([np.interp(where, self.instants, column) for column in zip(*numbers, strict=True)]) for numbers in (lasting, growing)
        )
        return times, amplitudes


class VaryingStream:
    """A filter as `Stream` is, whose shaper follows a schedule; time begins with the first sample."""

    def __init__(self, schedule: Schedule, sample_time: float, rest: float = 0.0) -> None:
        _require(sample_time)
        if any(shaper.terms for shaper in schedule.shapers):
            raise ShaperError("a schedule on a stream is made of impulses; a shaper with decaying terms runs as an FMU")
        self._schedule, self._step, self._count = schedule, sample_time, 0
        self._memory = np.full(math.ceil(max(s.duration for s in schedule.shapers) / sample_time) + 1, float(rest))

    def __call__(self, block: ArrayLike) -> Reals:
        """The shaped samples (n,) of the next samples (n,) of the reference; n may be 0. Raises `ShaperError` as `Stream` does."""
        fresh = _samples(block)
        known, past = np.concatenate([self._memory, fresh]), len(self._memory)
        here = np.arange(len(fresh))
        times, amplitudes = self._schedule.at((self._count + here) * self._step)
        shaped = np.zeros(len(fresh))
        for time, amplitude in zip(times, amplitudes, strict=True):
            delay = time / self._step
            whole = np.floor(delay)
            part, place = delay - whole, past + here - whole.astype(np.int64)
            shaped += amplitude * ((1.0 - part) * known[place] + part * known[place - 1])
        self._count += len(fresh)
        self._memory = known[len(fresh) :]
        return shaped


def _samples(block: ArrayLike) -> Reals:
    try:
        fresh = np.asarray(block, dtype=float)
    except (TypeError, ValueError) as problem:
        raise ShaperError(f"a block of samples is a row of numbers: {problem}") from None
    if fresh.ndim != 1:
        raise ShaperError(f"a block of samples is a row of numbers, of shape (n,), not {fresh.shape}; one sample is a block of one")
    if not np.isfinite(fresh).all():
        place = int(np.flatnonzero(~np.isfinite(fresh))[0])
        raise ShaperError(
            f"sample {place} of this block is {float(fresh[place])!r}: it would stay in the output as long as the shaper lasts"
        )
    return fresh


def _taps(shaper: Convolvable, sample_time: float) -> Iterator[tuple[int, float]]:
    """Whole samples of delay and weights; a pulse's are its integrals with the hats that make lines of samples."""
    for time, amplitude in zip(shaper.times, shaper.amplitudes, strict=True):
        whole, part = _split(time / sample_time)
        yield from ((whole, (1.0 - part) * amplitude), (whole + 1, part * amplitude))
    for pulse in shaper.pulses:
        begin, end = pulse.start / sample_time, (pulse.start + pulse.width) / sample_time
        for delay in range(math.floor(begin), math.ceil(end) + 1):
            yield delay, pulse.height * sample_time * (_hat(end - delay) - _hat(begin - delay))


def _hat(x: float) -> float:
    """The integral of max(0, 1 - |x|) up to x."""
    x = min(max(x, -1.0), 1.0)
    return 0.5 * (1.0 + x) ** 2 if x <= 0.0 else 1.0 - 0.5 * (1.0 - x) ** 2


def _split(delay: float) -> tuple[int, float]:
    """Whole samples, and the part of one that is left."""
    if abs(delay - round(delay)) <= ON_THE_GRID:
        return round(delay), 0.0
    return math.floor(delay), delay - math.floor(delay)


def _require(sample_time: float) -> None:
    if not 0.0 < sample_time < math.inf:
        raise ShaperError(f"a sample time is positive and finite, not {sample_time!r} s")
