"""The tail: after the move the input may decay along the plant's stable zeros, unseen by the output (../docs/theory.md, section 1).

A tail is `u_ss + Σ Re(c r^l/l! e^{zr})`, r the time since the end of the move, over the zeros z left of the imaginary axis and the powers
l below their multiplicity. Its real coefficients (one for a real zero, two for a complex pair) enter every equation linearly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import comb, factorial

import numpy as np
from flint import acb, acb_poly, arb, fmpq
from numpy.typing import NDArray

from relaxations.commands import TailTerm
from relaxations.moments import Basis
from relaxations.plants import ROOT_BITS, LinearPlant, Pole, precision, taylor

Reals = NDArray[np.float64]

LASTING = 12.0  # time constants of the slowest zero that a tail is looked at for: e^-12 of it is left
LOOKS = 400  # instants a tail is looked at, before the cutting planes
TURNS = 64  # tangents of the disc that a cap on a complex coefficient is, before the cutting planes
ASPECT = 1e-12  # of the room: what a slope or an output may be beyond it by rounding
FAN = np.concatenate([-(0.5 ** np.arange(20)), [0.0], 0.5 ** np.arange(20)])  # of further ones, in units of the angle between those


@dataclass(frozen=True, slots=True)
class TailLength:
    """From `time` [s] after the move on, the tail stays within the fraction `within` of the nearer limit's distance from the final rest."""

    time: float
    within: float


@dataclass(frozen=True, slots=True)
class Cap:
    """The coefficient of the highest power at the zero of number `zero` is at most `bound` in modulus (input units/s^l for the power l).

    Its real part, or both parts, stand `at` these places among the real coefficients. `sensitivity` is what it was asked by: shift and
    residual, exact (`cap_bound`).
    """

    zero: int
    at: tuple[int, ...]
    bound: float
    sensitivity: tuple[Fraction, Fraction]


@dataclass(frozen=True, slots=True)
class Aspect:
    """Something else that a tail does, and that is limited: to the input's slope (no name), or to the output `name`.

    It is a sum of the same functions as the tail, its coefficients `turned` c (n, n), within [-below, above] (its own units).
    """

    name: str | None
    turned: Reals
    above: float
    below: float


@dataclass(frozen=True, slots=True)
class Looks:
    """Where a program imposes the limits of a tail: at instants [s] after the move, and on its complex caps in directions [rad].

    And those of the courses of the move, at places (number of the course, fraction of the move): shape (k, 2).
    """

    instants: Reals
    turns: Reals
    moving: Reals = field(default_factory=lambda: np.zeros((0, 2)))

    def __or__(self, more: Looks) -> Looks:
        """Both of them."""
        moving = np.unique(np.concatenate([self.moving, more.moving]), axis=0)
        return Looks(np.union1d(self.instants, more.instants), np.union1d(self.turns, more.turns), moving)

    @property
    def count(self) -> int:
        """How many places."""
        return len(self.instants) + len(self.turns) + len(self.moving)

    def __bool__(self) -> bool:
        return self.count > 0


@dataclass(frozen=True, slots=True)
class Contact:
    """Where a tail is on a limit, and the multiplier μ ≥ 0 there.

    Without `cap`: `place` is an instant [s] after the move, the limit the upper (side 1) or lower (side -1) one of the input. In its course
    a tail touches it with slope zero at an instant that is unknown: the contact is `moving`. Else it is the cap of that number, and a
    complex coefficient is on it in the direction `place` [rad]: that moves too.
    """

    place: float
    side: int
    multiplier: float
    moving: bool = False
    cap: int | None = None


@dataclass(frozen=True, slots=True)
class TailStart:
    """A tail to start from: coefficients (n,), and where it touches its limits."""

    coefficients: Reals
    contacts: tuple[Contact, ...]


NO_TAIL = TailStart(np.zeros(0), ())


@dataclass(frozen=True, slots=True)
class TailSpace:
    """The tails that a problem allows: `zeros`, room above and below the final rest input (input units), `length` if it is limited, `caps`.

    `columns` (size, n): what each real coefficient adds to the moments that are asked for at the end of the move.
    """

    zeros: tuple[Pole, ...]
    columns: Reals
    above: float
    below: float
    length: TailLength | None = None
    caps: tuple[Cap, ...] = ()
    aspects: tuple[Aspect, ...] = ()

    @property
    def size(self) -> int:
        """Number of real coefficients n."""
        return sum(zero.multiplicity * (2 if zero.is_flexible else 1) for zero in self.zeros)

    def rows(self, since: Reals, derivative: int = 0) -> Reals:
        """The tail's deviation from the final rest input at `since` ≥ 0 [s] for each unit coefficient: shape (len(since), n).

        Or its first, second, … `derivative` by time [1/s, 1/s², …]: that of `r^l/l! e^{zr}` is `Σ_i C(d, i) z^{d-i} r^{l-i}/(l-i)! e^{zr}`.
        """
        r = np.atleast_1d(np.asarray(since, dtype=float))
        columns = []
        for zero in self.zeros:
            decay = np.exp(zero.value * r)
            chain = [r**power / factorial(power) * decay for power in range(zero.multiplicity)]
            for power in range(zero.multiplicity):
                lower = range(min(derivative, power) + 1)
                values = sum(comb(derivative, i) * zero.value ** (derivative - i) * chain[power - i] for i in lower) + 0j
                columns.append(values.real)
                if zero.is_flexible:
                    columns.append(-values.imag)
        return np.array(columns).T if columns else np.zeros((len(r), 0))

    def room(self, since: Reals) -> tuple[Reals, Reals]:
        """How far above and below the final rest input the tail may be at `since` [s]."""
        r = np.atleast_1d(np.asarray(since, dtype=float))
        above, below = np.full(r.shape, self.above), np.full(r.shape, self.below)
        if self.length is not None:
            late = r >= self.length.time
            tight = self.length.within * min(self.above, self.below)
            above[late], below[late] = np.minimum(above[late], tight), np.minimum(below[late], tight)
        return above, below

    @property
    def known(self) -> Reals:
        """Instants [s] at which the limits begin, or change: there a tail may be on one with any slope."""
        return np.unique([0.0] + ([self.length.time] if self.length is not None else [])) if self.zeros else np.zeros(0)

    def touching(self, contacts: Sequence[Contact], derivative: int = 0) -> Reals:
        """Rows e with `e c ≤ allowance` where a tail touches a limit, or their derivatives by the contacts' places: (len(contacts), n)."""
        rows = np.zeros((len(contacts), self.size))
        for k, contact in enumerate(contacts):
            if contact.cap is None:
                rows[k] = contact.side * self.rows(np.array([contact.place]), derivative)[0]
            else:
                turned = contact.place + derivative * np.pi / 2
                at = self.caps[contact.cap].at
                rows[k, at] = contact.side * np.array([np.cos(turned), np.sin(turned)])[: len(at)]
        return rows

    def allowance(self, contacts: Sequence[Contact]) -> Reals:
        """How far the tail may be where it touches its limits: room, or bound of a cap. Shape (len(contacts),)."""
        above, below = self.room(np.array([contact.place for contact in contacts]))
        rooms = zip(contacts, above, below, strict=True)
        return np.array([self.caps[c.cap].bound if c.cap is not None else up if c.side > 0 else down for c, up, down in rooms])

    def sizes(self, coefficients: Reals) -> Reals:
        """The moduli that caps bound."""
        return moduli(coefficients, [cap.at for cap in self.caps])

    def capped(self, cap: int, coefficients: Reals, multiplier: float) -> Contact:
        """The contact with a cap in the direction of a coefficient: of a real one on the side of its sign."""
        part = coefficients[list(self.caps[cap].at)]
        if len(part) == 1:
            return Contact(0.0, 1 if part[0] > 0.0 else -1, multiplier, cap=cap)
        return Contact(float(np.arctan2(part[1], part[0])), 1, multiplier, True, cap)

    def faces(self, turns: Reals) -> tuple[Reals, Reals]:
        """The caps as rows of a program, `|e c| ≤ room`: a real one is one, a complex one has a tangent in each of these directions.

        Every cap is measured in half the input's range, so that a small one is not lost among larger numbers.
        """
        half, rows = (self.above + self.below) / 2, []
        for cap in self.caps:
            for turn in turns if len(cap.at) == 2 else [0.0]:
                rows.append(np.zeros(self.size))
                rows[-1][list(cap.at)] = (half / cap.bound * np.array([np.cos(turn), np.sin(turn)]))[: len(cap.at)]
        return np.array(rows).reshape(len(rows), self.size), np.full(len(rows), half)

    def looks(self) -> Looks:
        """Where the limits are first imposed: dense at the beginning of the tail, as long as anything is left; caps all around."""
        if not self.zeros:
            return Looks(np.zeros(0), np.zeros(0))
        slowest = min(-zero.value.real for zero in self.zeros)
        most = max(zero.multiplicity for zero in self.zeros)
        last = (LASTING + 4 * most) / slowest
        instants = np.concatenate([[0.0], np.geomspace(1e-4 * last, last, LOOKS)])
        complex_caps = any(len(cap.at) == 2 for cap in self.caps)
        return Looks(np.union1d(instants, self.known), np.linspace(0.0, np.pi, TURNS, endpoint=False) if complex_caps else np.zeros(0))

    def peaks(self, coefficients: Reals) -> Reals:
        """Instants [s] at which a tail has its local extremes: where a limit may be exceeded between the looks."""
        looks = self.looks().instants
        if len(looks) < 3 or not self.size:
            return np.zeros(0)
        fine = np.unique(np.concatenate([looks, np.linspace(0.0, looks[-1], 20 * LOOKS)]))
        course = self.rows(fine) @ coefficients
        turns = np.flatnonzero((course[1:-1] - course[:-2]) * (course[2:] - course[1:-1]) <= 0.0) + 1
        left, middle, right = fine[turns - 1], fine[turns], fine[turns + 1]
        y0, y1, y2 = course[turns - 1], course[turns], course[turns + 1]
        rise, fall = (y1 - y0) / (middle - left), (y2 - y1) / (right - middle)
        bend = (fall - rise) / (right - left)
        with np.errstate(divide="ignore", invalid="ignore"):
            vertex = (left + middle) / 2 - rise / (2 * bend)
        return np.where(np.isfinite(vertex) & (vertex > left) & (vertex < right), vertex, middle)

    def exceeded(self, coefficients: Reals, pull: Reals | None = None) -> Looks:
        """Local extremes [s] at which a tail is beyond its limits, and directions [rad] for complex caps that it is beyond.

        At the optimum a coefficient lies in the direction in which its cap is `pull`ed: a fan of tangents, ever closer to that.
        """
        peaks = self.peaks(coefficients)
        course, (above, below) = self.rows(peaks) @ coefficients, self.room(peaks)
        beyond = [peaks[(course > above) | (course < -below)]]
        for aspect in self.aspects:
            tops = self.peaks(aspect.turned @ coefficients)
            course, slack = self.rows(tops) @ aspect.turned @ coefficients, ASPECT * (aspect.above + aspect.below)
            beyond.append(tops[(course > aspect.above + slack) | (course < -aspect.below - slack)])
        over = [cap.at for cap, size in zip(self.caps, self.sizes(coefficients), strict=True) if size > cap.bound and len(cap.at) == 2]
        towards = coefficients if pull is None else pull
        fans = [np.arctan2(towards[im], towards[re]) + np.pi / TURNS * FAN for re, im in over]
        return Looks(np.concatenate(beyond), np.mod(np.concatenate([np.zeros(0), *fans]), np.pi))

    def terms(self, coefficients: Reals) -> tuple[TailTerm, ...]:
        """The command's tail terms (whose powers have no factorial)."""
        terms, at = [], 0
        for zero in self.zeros:
            for power in range(zero.multiplicity):
                width = 2 if zero.is_flexible else 1
                part = coefficients[at : at + width]
                at += width
                value = complex(part[0], part[1]) if width == 2 else complex(part[0])
                if value:
                    terms.append(TailTerm(zero.value, power, value / factorial(power)))
        return tuple(terms)


def chains(zeros: Sequence[Pole], coefficients: Reals) -> list[list[complex]]:
    """The complex coefficients at every zero."""
    found, at = [], 0
    for zero in zeros:
        width = 2 if zero.is_flexible else 1
        parts = coefficients[at : at + width * zero.multiplicity].reshape(zero.multiplicity, width)
        at += width * zero.multiplicity
        found.append([complex(part[0], part[1] if width == 2 else 0.0) for part in parts])
    return found


def turning(zeros: Sequence[Pole], answer: Callable[[Pole, list[complex]], list[complex]]) -> Reals:
    """The real matrix that takes a tail's coefficients to what an `answer` makes of the chain at every zero."""
    size = sum(zero.multiplicity * (2 if zero.is_flexible else 1) for zero in zeros)
    columns = []
    for unit in np.eye(size):
        turned = [(zero, answer(zero, chain)) for zero, chain in zip(zeros, chains(zeros, unit), strict=True)]
        columns.append([part for zero, chain in turned for c in chain for part in (c.real, c.imag)[: 2 if zero.is_flexible else 1]])
    return np.array(columns).T.reshape(size, size)


def sloping(zero: Pole, chain: list[complex]) -> list[complex]:
    """The slope of `Σ c_l r^l/l! e^{zr}`."""
    return [zero.value * c + after for c, after in zip(chain, [*chain[1:], 0j], strict=True)]


def passed(plant: LinearPlant, name: str, zero: Pole, chain: list[complex]) -> list[complex]:
    """What an output makes of the same: `Σ_{k≥l} G^(k-l)(z)/(k-l)! c_k` is its coefficient l."""
    series = taylor(plant.numerators[name], plant.denominator, zero.value, len(chain))
    return [sum((g * c for g, c in zip(series, chain[at:], strict=False)), 0j) for at in range(len(chain))]


def moduli(coefficients: Reals, places: Sequence[tuple[int, ...]]) -> Reals:
    """Of the coefficients, one or a complex one's two parts, at each of these places."""
    return np.array([np.hypot.reduce(coefficients[list(at)]) for at in places])


def cap_bound(plant: LinearPlant, zero: acb, multiplicity: int, sensitivity: tuple[Fraction, Fraction], displacement: Fraction) -> arb:
    """How large a tail's highest coefficient c at a zero z may be, so that the output does not mind if the zero is elsewhere.

    A zero of multiplicity m that lies at z + d forces the motion `c d G^{(m)}(z)/(m-1)! e^{zr}` on the output, to first order in d. At most
    the fraction `residual` of the displacement it is for all |d| ≤ shift |z| if `|c| ≤ residual |Δ| (m-1)! / (shift |z| |G^{(m)}(z)|)`.
    """
    (shift, residual), numerator = sensitivity, plant.numerators[plant.output]
    for _ in range(multiplicity):
        numerator = numerator.derivative()
    slope = abs(acb_poly(numerator)(zero) / acb_poly(plant.denominator)(zero)) / factorial(multiplicity - 1)
    allowed = residual * abs(displacement) / shift
    return arb(fmpq(allowed.numerator, allowed.denominator)) / (abs(zero) * slope)


def caps(
    plant: LinearPlant, zeros: Sequence[Pole], sensitivities: Mapping[complex, tuple[Fraction, Fraction]], displacement: Fraction
) -> tuple[tuple[Pole, ...], tuple[Cap, ...]]:
    """The zeros that a tail may use, of those left of the axis, and the caps on its coefficients; sensitivities by the zero's value.

    Where no residual at all is allowed, the highest power is not used.
    """
    used: list[Pole] = []
    found: list[Cap] = []
    end = 0
    for zero in zeros:
        asked = sensitivities.get(zero.value)
        power = zero.multiplicity - (asked is not None and asked[1] == 0)
        if not power:
            continue
        used.append(Pole(zero.value, power))
        width = 2 if zero.is_flexible else 1
        end += width * power
        if asked is not None and asked[1] > 0:
            with precision(ROOT_BITS):
                bound = cap_bound(plant, acb(zero.value.real, zero.value.imag), power, asked, displacement)
            found.append(Cap(len(used) - 1, tuple(range(end - width, end)), float(bound.mid()), asked))
    return tuple(used), tuple(found)


def tail_columns(bases: tuple[Basis, ...], zeros: tuple[Pole, ...]) -> Reals:
    """What every real tail coefficient adds to the moments at the end of the move, shape (size, n).

    `r^l/l! e^{zr}` afterwards balances the moment `(-1)^l C(k+l, l) / (z-p)^(k+l+1)` at power k of the pole p.
    """
    columns = []
    for zero in zeros:
        for power in range(zero.multiplicity):
            for unit in (1.0, 1j) if zero.is_flexible else (1.0,):
                parts = []
                for basis in bases:
                    chains = []
                    for pole in basis.poles:
                        for k in range(pole.multiplicity):
                            factor = comb(k + power, power) * (-1) ** power
                            one = factor / (zero.value - pole.value) ** (k + power + 1)
                            other = factor / (zero.value.conjugate() - pole.value) ** (k + power + 1)
                            chains.append(np.array([(unit * one + np.conj(unit) * other) / 2], dtype=complex))
                    parts.append(basis.real(iter(chains))[:, 0])
                columns.append(np.concatenate(parts))
    size = sum(basis.size for basis in bases)
    return np.array(columns).T if columns else np.zeros((size, 0))
