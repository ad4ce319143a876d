"""The filter: a transfer function of delays with poles, between a reference and the input of a plant.

    G_f(s) = Σ_k e^{-s τ_k} [A_k + Σ_j c_kj l!/(s - z_j)^(l+1)],   0 = τ_0 < τ_1 < … < τ_L = T        (Singh 2012, (49))

Its zeros cancel the plant's poles, so that the output is at rest after T; its poles z_j are zeros of the plant, along which the input goes
on unseen by the output. For a plant that holds its output without input (poles at the origin) the static gain is 0: a reference in output
units is then followed all the same.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relaxations.commands import Command, Tail
from relaxations.errors import ShaperError
from relaxations.shaping.shapers import Pulse, Shaper, ShaperTerm, convolved, shape

FORMAT = "slewcert-prefilter/1"


@dataclass(frozen=True, slots=True)
class Prefilter:
    """Steps of `gains` A_k (input units per reference unit) after `delays` τ_k [s], and decaying `terms` of the impulse response.

    The first delay is 0, they ascend; each term starts at one of them (of a conjugate pair one term, `relaxations.shaping.shapers`).
    Raises `ShaperError`, which names everything that is wrong.
    """

    delays: tuple[float, ...]
    gains: tuple[float, ...]
    terms: tuple[ShaperTerm, ...] = ()

    def __post_init__(self) -> None:
        if problems := list(self._mistakes()):
            raise ShaperError("; ".join(problems))

    def _mistakes(self) -> Iterator[str]:
        if len(self.delays) != len(self.gains):
            yield f"a filter has one gain for each delay; there are {len(self.delays)} delays and {len(self.gains)} gains"
        numbers = [x for t in self.terms for x in (t.start, t.rate.real, t.rate.imag, t.coefficient.real, t.coefficient.imag)]
        if not all(map(math.isfinite, (*self.delays, *self.gains, *numbers))):
            yield "a filter holds finite numbers only"
            return
        if not self.delays or self.delays[0] != 0.0:
            yield f"a filter begins at 0 s{f', not at {self.delays[0]!r} s' if self.delays else ''}"
        for before, after in itertools.pairwise(self.delays):
            if not before < after:
                yield f"delays ascend: {after!r} s follows {before!r} s"
        for term in self.terms:
            if term.start not in self.delays:
                yield f"a term starts at one of the delays, not at {term.start!r} s"
            if not (term.rate.real < 0.0 and term.power >= 0):
                yield f"a filter is stable: rate {term.rate!r} with power {term.power} does not decay"

    @property
    def duration(self) -> float:
        """The last delay T [s]: a plant whose poles and zeros are cancelled has its output at rest from then on."""
        return self.delays[-1]

    @property
    def poles(self) -> tuple[complex, ...]:
        """The distinct poles, of a conjugate pair the one with Im > 0 [1/s]."""
        return tuple(sorted({term.rate for term in self.terms}, key=lambda rate: (abs(rate), rate.imag)))

    @property
    def gain(self) -> float:
        """The static gain G_f(0)."""
        return math.fsum((*self.gains, *(term.gain for term in self.terms)))

    @property
    def size(self) -> float:
        """The sum of the sizes of its gains, and of its terms' shares of the static gain: what rounding is compared with."""
        return math.fsum((*map(abs, self.gains), *(abs(term.gain) for term in self.terms)))

    # What `relaxations.shaping.shapers` needs of whatever it convolves with.

    @property
    def times(self) -> tuple[float, ...]:
        """Delays of the gains that are not 0 [s]."""
        return tuple(delay for delay, gain in zip(self.delays, self.gains, strict=True) if gain)

    @property
    def amplitudes(self) -> tuple[float, ...]:
        """Those gains."""
        return tuple(gain for gain in self.gains if gain)

    @property
    def pulses(self) -> tuple[Pulse, ...]:
        """None."""
        return ()

    def __call__(self, s: ArrayLike, derivative: int = 0) -> NDArray[np.complex128]:
        """G_f, or a derivative of it by s, at complex s [1/s]."""
        at = np.asarray(s, dtype=complex)
        total = np.zeros(at.shape, dtype=complex)
        for delay, gain in zip(self.delays, self.gains, strict=True):
            total += gain * (-delay) ** derivative * np.exp(-delay * at)
        for term in self.terms:
            order, delayed = term.power + 1, np.exp(-term.start * at)
            for rate, weight in ((term.rate, term.coefficient / 2), (term.rate.conjugate(), term.coefficient.conjugate() / 2)):
                for i in range(derivative + 1):  # Leibniz: i derivatives fall on 1/(s - rate)^order
                    falling = (-1) ** i * math.factorial(order + i - 1) / (at - rate) ** (order + i)
                    total += weight * math.comb(derivative, i) * (-term.start) ** (derivative - i) * falling * delayed
        return total

    def scaled(self, factor: float) -> Prefilter:
        """The same, its gains and terms times `factor`."""
        terms = tuple(replace(term, coefficient=term.coefficient * factor) for term in self.terms)
        return Prefilter(self.delays, tuple(gain * factor for gain in self.gains), terms)

    def shaper(self) -> Shaper:
        """The shaper of static gain 1 that it is; raises `ShaperError` if its static gain is 0."""
        if abs(self.gain) <= 1e-12 * self.size:
            raise ShaperError("the filter's static gain is 0 (the plant has a rigid body): it is no shaper, whose gain is 1")
        one = self.scaled(1.0 / self.gain)
        return Shaper(one.times, one.amplitudes, one.terms)

    def command(self, displacement: float, rest: float = 0.0, hold: float | None = None) -> Command:
        """What it makes of a step of the reference by `displacement`: input units, absolute; `rest` is the input before.

        The input ends at `rest` + `hold` (None: as the static gain has it). Raises `ShaperError` where terms start before the last delay:
        segments and one tail do not hold that.
        """
        done = shape(Command(0.0, (), Tail(displacement)), self)
        raised = tuple(replace(segment, level=segment.level + rest) for segment in done.segments)
        steady = rest + (done.tail.steady if hold is None else hold)
        return Command(done.maneuver_time, raised, Tail(steady, done.tail.terms))

    def reference(self, times: ArrayLike) -> NDArray[np.float64]:
        """What it makes of a unit step of the reference, at `times` [s]: the input, its rest taken off."""
        t = np.asarray(times, dtype=float)
        total = np.zeros(t.shape)
        for delay, gain in zip(self.delays, self.gains, strict=True):
            total = total + gain * (t >= delay)
        for term in self.terms:
            since = np.maximum(t - term.start, 0.0)
            total = total + integral(term, since) * (t >= term.start)
        return total

    def to_dict(self) -> dict[str, Any]:
        """Plain data (`slewcert-prefilter/1`)."""
        terms = [term.to_dict() for term in self.terms]
        return {"format": FORMAT, "delays": list(self.delays), "gains": list(self.gains), "terms": terms}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Prefilter:
        """The inverse of `to_dict`; further members are left alone. Raises `ShaperError` naming what is malformed."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
            raise ShaperError(f'a filter file has "format": "{FORMAT}"; this one has {found!r}')
        try:
            terms = tuple(map(ShaperTerm.from_dict, data.get("terms", ())))
            return Prefilter(tuple(map(float, data["delays"])), tuple(map(float, data["gains"])), terms)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as problem:
            raise ShaperError(f"malformed filter file: {type(problem).__name__} {problem}") from None

    @staticmethod
    def from_json(text: str) -> Prefilter:
        """Read a filter file's text."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as problem:
            raise ShaperError(f"a filter file is JSON: {problem}") from None
        return Prefilter.from_dict(data)


def integral(term: ShaperTerm, since: NDArray[np.float64]) -> NDArray[np.float64]:
    """`∫_0^since` of a term of the impulse response, closed form: `Re c l!/(-z)^(l+1) [1 - e^{zr} Σ_{i≤l} (-z r)^i/i!]`."""
    z, whole = term.rate, math.factorial(term.power) / (-term.rate) ** (term.power + 1)
    series = sum(((-z * since) ** i / math.factorial(i) for i in range(term.power + 1)), np.zeros(since.shape, dtype=complex))
    return (term.coefficient * whole * (1.0 - np.exp(z * since) * series)).real.astype(np.float64)


def cascade(first: Prefilter, second: Prefilter) -> Prefilter:
    """One after the other: what either cancels both cancel."""
    impulses, terms = convolved(first, second)
    delays = sorted({*impulses, *(term.start for term in terms)} | {0.0})
    return Prefilter(tuple(delays), tuple(impulses.get(delay, 0.0) for delay in delays), terms)
