"""The shaper: a filter that turns any reference into one that a flexible machine follows without vibration.

Its impulse response is a sequence of impulses and, if it makes use of the plant's zeros or real poles, decaying terms beside them:

    h(t) = Σ A_i δ(t - t_i) + Σ Re(c τ^k e^{pτ}),   τ = t - start ≥ 0,   ∫ h dt = 1

or a sequence of pulses of finite duration in place of impulses (Singer and Seering, claims 3 to 6).

In the s-plane that is a sum of e^{-s start}/(s - p)^n (n = 0: an impulse; p = 0, n = 1: the edge of a pulse), and so is a command.
Convolution is the product, in partial fractions again: shapers for several modes are joined, and commands shaped, in closed form.
"""

from __future__ import annotations

import itertools
import json
import math
import operator
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol, TypeVar

from relaxations.commands import Command, Segment, Tail, TailTerm
from relaxations.errors import ShaperError
from relaxations.response import jumps

FORMAT = "slewcert-shaper/1"
GAIN_TOLERANCE = 1e-6  # how far the static gain may be from 1: files with six digits are shapers too
SAME_INSTANT = 1e-14  # of the duration: sums of the same instants in another order differ by rounding
NARROWEST = 1e-6  # of the impulses' duration: doubles then hold a pulse's width to ten digits
MOST = 1e150  # of the sum of the amplitudes' sizes: squares of what they leave are doubles
N = TypeVar("N", float, Fraction)


@dataclass(frozen=True, slots=True)
class ShaperTerm:
    """`Re(coefficient · τ^power · e^{rate τ})`, τ = t - `start` ≥ 0 [s]; rate in 1/s; of a pair one term, the one with Im(rate) > 0."""

    start: float
    rate: complex
    power: int
    coefficient: complex

    @property
    def gain(self) -> float:
        """Its integral, `Re(c k! / (-p)^(k+1))`."""
        return (self.coefficient * math.factorial(self.power) / (-self.rate) ** (self.power + 1)).real

    def to_dict(self) -> dict[str, Any]:
        """An entry of `terms` in files of shapers and filters (docs/schemas.md)."""
        pair = {name: [value.real, value.imag] for name, value in (("rate", self.rate), ("coefficient", self.coefficient))}
        return {"start": self.start, "rate": pair["rate"], "power": self.power, "coefficient": pair["coefficient"]}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> ShaperTerm:
        """The inverse of `to_dict`; raises `KeyError`, `TypeError` or `ValueError` for what is malformed."""
        return ShaperTerm(float(data["start"]), complex(*data["rate"]), operator.index(data["power"]), complex(*data["coefficient"]))


@dataclass(frozen=True, slots=True)
class Pulse:
    """`height` [1/s] from `start` [s] on for `width` [s]."""

    start: float
    width: float
    height: float

    @property
    def gain(self) -> float:
        """Its integral."""
        return self.width * self.height


class Convolvable(Protocol):
    """What is convolved: impulses and decaying terms, or pulses, of any static gain."""

    @property
    def times(self) -> tuple[float, ...]:
        """Instants of the impulses [s]."""
        ...

    @property
    def amplitudes(self) -> tuple[float, ...]:
        """Their sizes."""
        ...

    @property
    def terms(self) -> tuple[ShaperTerm, ...]:
        """Decaying terms."""
        ...

    @property
    def pulses(self) -> tuple[Pulse, ...]:
        """Pulses."""
        ...

    @property
    def duration(self) -> float:
        """When the last of them acts, begins or ends [s]."""
        ...


@dataclass(frozen=True, slots=True)
class Shaper:
    """Impulses of `amplitudes` at `times` [s] and decaying `terms`, or `pulses` alone; the first of them acts at 0, the static gain is 1.

    Raises `ShaperError`, which names everything that is wrong.
    """

    times: tuple[float, ...]
    amplitudes: tuple[float, ...]
    terms: tuple[ShaperTerm, ...] = ()
    pulses: tuple[Pulse, ...] = ()

    def __post_init__(self) -> None:
        if problems := list(self._mistakes()):
            raise ShaperError("; ".join(problems))

    @property
    def duration(self) -> float:
        """When its last impulse acts, its last term begins or its last pulse ends [s]."""
        return max((*self.times, *(term.start for term in self.terms), *(pulse.start + pulse.width for pulse in self.pulses)))

    @property
    def gain(self) -> float:
        """The static gain: amplitudes and integrals of the terms and pulses."""
        return math.fsum((*self.amplitudes, *(part.gain for part in (*self.terms, *self.pulses))))

    @property
    def excitation(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """What a mode sees: jumps at instants [s], of the impulses' integral (order 0) or of the pulses' height [1/s] (order 1)."""
        return self._excitation(float)

    @property
    def exact_excitation(self) -> tuple[tuple[Fraction, ...], tuple[Fraction, ...], int]:
        """The same with exact numbers: where a pulse ends is no double."""
        return self._excitation(Fraction)

    def _excitation(self, number: Callable[[float], N]) -> tuple[tuple[N, ...], tuple[N, ...], int]:
        if not self.pulses:
            return tuple(map(number, self.times)), tuple(map(number, self.amplitudes)), 0
        edges: dict[N, N] = defaultdict(lambda: number(0.0))
        for pulse in self.pulses:
            start, width, height = number(pulse.start), number(pulse.width), number(pulse.height)
            edges[start] += height
            edges[start + width] -= height
        times = sorted(time for time, jump in edges.items() if jump)
        return tuple(times), tuple(edges[time] for time in times), 1

    def _mistakes(self) -> Iterator[str]:
        if len(self.times) != len(self.amplitudes):
            yield f"a shaper has one amplitude for each time; there are {len(self.times)} times and {len(self.amplitudes)} amplitudes"
        numbers = [x for t in self.terms for x in (t.start, t.rate.real, t.rate.imag, t.coefficient.real, t.coefficient.imag)]
        numbers += [x for pulse in self.pulses for x in (pulse.start, pulse.width, pulse.height)]
        if not all(map(math.isfinite, (*self.times, *self.amplitudes, *numbers))):
            yield "a shaper holds finite numbers only"
            return
        sizes = sum(map(abs, self.amplitudes)) + sum(abs(pulse.height) * pulse.width for pulse in self.pulses)
        if sizes > MOST:
            yield f"sizes of impulses sum to at most {MOST:g}, not to {sizes:g}"
        for before, after in itertools.pairwise(self.times):
            if not before < after:
                yield f"impulses stand in strictly ascending order: {after!r} s follows {before!r} s"
        if self.pulses and (self.times or self.terms):
            yield "a shaper has impulses and terms, or pulses alone"
        yield from (f"a pulse lasts, this one for {pulse.width!r} s" for pulse in self.pulses if not pulse.width > 0.0)
        starts = [*self.times, *(term.start for term in self.terms), *(pulse.start for pulse in self.pulses)]
        if not starts or min(starts) != 0.0:
            yield f"a shaper begins at 0 s; {f'this one at {min(starts)!r} s' if starts else 'this one is empty'}"
        growing = [term for term in self.terms if not (term.rate.real < 0.0 and term.power >= 0)]
        yield from (f"a shaper's term decays: rate {term.rate!r} with power {term.power} does not" for term in growing)
        if starts and not growing and abs(self.gain - 1.0) > GAIN_TOLERANCE:
            what = "integrals of the pulses" if self.pulses else f"amplitudes{' and integrals of the terms' if self.terms else ''}"
            yield f"{what} sum to 1, not to {self.gain!r}"

    def to_dict(self) -> dict[str, Any]:
        """The shaper file as plain data (`slewcert-shaper/1`)."""
        pulses = [{"start": p.start, "width": p.width, "height": p.height} for p in self.pulses]
        return {
            "format": FORMAT,
            "times": list(self.times),
            "amplitudes": list(self.amplitudes),
            "terms": [term.to_dict() for term in self.terms],
            **({"pulses": pulses} if pulses else {}),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Shaper:
        """The inverse of `to_dict`; further members are left alone. Raises `ShaperError` naming what is malformed."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
            raise ShaperError(f'a shaper file has "format": "{FORMAT}"; this one has {found!r}')
        try:
            return Shaper(
                tuple(float(t) for t in data["times"]),
                tuple(float(a) for a in data["amplitudes"]),
                tuple(map(ShaperTerm.from_dict, data.get("terms", ()))),
                tuple(Pulse(float(p["start"]), float(p["width"]), float(p["height"])) for p in data.get("pulses", ())),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as problem:
            raise ShaperError(f"malformed shaper file: {type(problem).__name__} {problem}") from None

    @staticmethod
    def from_json(text: str) -> Shaper:
        """Read a shaper file's text."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as problem:
            raise ShaperError(f"a shaper file is JSON: {problem}") from None
        return Shaper.from_dict(data)


def convolve(first: Shaper, second: Shaper) -> Shaper:
    """One after the other: what is left unexcited by either is left unexcited by both."""
    if first.pulses and second.pulses:
        raise ShaperError("pulses convolved with pulses are no pulses; convolve the impulses first, then make pulses of them")
    parts = _product(_parts_of(first), _parts_of(second), first.duration + second.duration)
    if first.pulses or second.pulses:
        if first.terms or second.terms:
            raise ShaperError("pulses convolved with decaying terms are neither")
        return _pulsed(parts)
    impulses, terms = _impulses_and_terms(parts)
    return Shaper(tuple(impulses), tuple(impulses.values()), terms)


def convolved(first: Convolvable, second: Convolvable) -> tuple[dict[float, float], tuple[ShaperTerm, ...]]:
    """Impulses and terms of one after the other, of any static gain, without pulses."""
    return _impulses_and_terms(_product(_parts_of(first), _parts_of(second), first.duration + second.duration))


def _impulses_and_terms(parts: _Parts) -> tuple[dict[float, float], tuple[ShaperTerm, ...]]:
    impulses = sorted((part.start, weight.real) for part, weight in parts.items() if part.order == 0)
    return dict(impulses), tuple(ShaperTerm(part.start, part.rate, part.order - 1, value) for part, value in _real_terms(parts))


def as_pulses(shaper: Shaper, width: float) -> Shaper:
    """Each impulse drawn out to a pulse of `width` [s], of the same integral: what it leaves at rest stays there.

    Raises `ShaperError` for a width that is not positive or next to nothing, and for a shaper with terms.
    """
    if not 0.0 < width < math.inf:
        raise ShaperError(f"a pulse's width is positive and finite, not {width!r} s")
    if shaper.terms or shaper.pulses:
        raise ShaperError("pulses are made of impulses alone")
    if width < (least := NARROWEST * shaper.duration):
        raise ShaperError(
            f"a pulse of {width!r} s among impulses that take {shaper.duration:.6g} s ends where doubles do not tell: at least "
            f"{1.00001 * least:.6g} s is possible; one so narrow is an impulse, which is what is made without a width"
        )
    return Shaper((), (), (), tuple(Pulse(t, width, a / width) for t, a in zip(shaper.times, shaper.amplitudes, strict=True)))


def _pulsed(parts: _Parts) -> Shaper:
    """Edges (order 1) as pulses that follow each other."""
    edges = sorted((part.start, weight.real) for part, weight in parts.items())
    height, pulses = 0.0, []
    largest = max(abs(jump) for _, jump in edges)
    for (start, jump), (end, _) in itertools.pairwise(edges):
        height += jump
        if abs(height) > 1e-12 * largest:
            pulses.append(Pulse(start, end - start, height))
    return Shaper((), (), (), tuple(pulses))


def shape(command: Command, shaper: Convolvable, rest: float = 0.0) -> Command:
    """What the shaper makes of the command, exactly; `rest` is the input before the command's start (input units).

    Raises `ShaperError` if exponentials run before the last switch: segments and one tail cannot hold that (a running filter can).
    """
    parts = _product(_parts_of_command(command, rest), _parts_of(shaper), command.end + shaper.duration)
    if curved := [part.start for part in parts if not part.rate and part.order > 2]:
        raise ShaperError(
            f"pulses make a parabola of a slope, from {min(curved)!r} s on, which segments cannot hold; shape a command of constant levels"
        )
    instants = sorted({part.start for part in parts})
    terms = list(_real_terms(parts))
    end = instants[-1]
    if early := [part.start for part, _ in terms if part.start < end]:
        raise ShaperError(
            f"the shaped command has decaying terms from {min(early)!r} s on and goes on switching until {end!r} s, "
            "which segments and a tail cannot hold; export the shaper as an FMU to run it on this reference"
        )
    segments, level, slope, since = [], rest, 0.0, 0.0
    for instant in instants:
        level += slope * (instant - since) + parts.get(_Part(instant, 0j, 1), 0j).real
        slope += parts.get(_Part(instant, 0j, 2), 0j).real
        since = instant
        segments.append(Segment(instant, level, slope))
    tail = Tail(level, tuple(TailTerm(part.rate, part.order - 1, value) for part, value in terms))
    return Command(end - instants[0], tuple(segments[:-1]), tail)


@dataclass(frozen=True, slots=True)
class _Part:
    """e^{-s start}/(s - rate)^order: an impulse (order 0, rate 0), else `τ^(order-1)/(order-1)! e^{rate τ}`."""

    start: float
    rate: complex
    order: int


_Parts = dict[_Part, complex]


def _parts_of(shaper: Convolvable) -> _Parts:
    impulses = {_Part(time, 0j, 0): complex(amplitude) for time, amplitude in zip(shaper.times, shaper.amplitudes, strict=True)}
    edges = [
        (_Part(time, 0j, 1), complex(jump)) for p in shaper.pulses for time, jump in ((p.start, p.height), (p.start + p.width, -p.height))
    ]
    return _summed([*impulses.items(), *edges, *_conjugates((t.start, t.rate, t.power, t.coefficient) for t in shaper.terms)])


def _parts_of_command(command: Command, rest: float) -> _Parts:
    polygon = [(_Part(float(at), 0j, order), complex(jump)) for at, *both in jumps(command, rest) for order, jump in enumerate(both, 1)]
    return _summed([*polygon, *_conjugates((command.end, t.rate, t.power, t.coefficient) for t in command.tail.terms)])


def _conjugates(terms: Iterable[tuple[float, complex, int, complex]]) -> Iterator[tuple[_Part, complex]]:
    """Re(z) = (z + conj z)/2: both halves of each term."""
    for start, rate, power, coefficient in terms:
        half = coefficient * math.factorial(power) / 2
        yield _Part(start, rate, power + 1), half
        yield _Part(start, rate.conjugate(), power + 1), half.conjugate()


def _summed(parts: Iterable[tuple[_Part, complex]]) -> _Parts:
    total: _Parts = defaultdict(complex)
    for part, weight in parts:
        if weight:
            total[part] += weight
    return dict(total)


def _product(left: _Parts, right: _Parts, duration: float) -> _Parts:
    pairs = list(itertools.product(left.items(), right.items()))
    same = _one_instant([a.start + b.start for (a, _), (b, _) in pairs], SAME_INSTANT * duration)
    return _summed(
        (_Part(same[a.start + b.start], rate, order), x * y * weight)
        for (a, x), (b, y) in pairs
        for rate, order, weight in _partial_fractions(a.rate, a.order, b.rate, b.order)
    )


def _one_instant(instants: Iterable[float], tolerance: float) -> dict[float, float]:
    """For each instant the first one that cannot be told from it."""
    first, same = -math.inf, {}
    for instant in sorted(set(instants)):
        first = instant if instant - first > tolerance else first
        same[instant] = first
    return same


def _partial_fractions(p: complex, m: int, q: complex, n: int) -> Iterator[tuple[complex, int, complex]]:
    """1/((s-p)^m (s-q)^n) as a sum of weight/(s - rate)^order, in triples (rate, order, weight)."""
    if m == 0 or n == 0 or p == q:
        yield p if m else q, m + n, 1 + 0j
        return
    for pole, count, other, others in ((p, m, q, n), (q, n, p, m)):
        for order in range(1, count + 1):
            left = count - order  # the Taylor coefficient of (s - other)^-others at the pole
            yield pole, order, (-1) ** left * math.comb(others - 1 + left, left) / (pole - other) ** (others + left)


def _real_terms(parts: _Parts) -> Iterator[tuple[_Part, complex]]:
    """The decaying terms with their coefficients, of a conjugate pair the half above the axis, by start, rate and power."""
    decaying = [(part, weight) for part, weight in parts.items() if part.rate and part.rate.imag >= 0.0]
    for part, weight in sorted(decaying, key=lambda item: (item[0].start, item[0].rate.real, item[0].rate.imag, item[0].order)):
        value = 2 * weight if part.rate.imag else complex(weight.real)
        yield part, value / math.factorial(part.order - 1)
