"""A filter of given structure: its unknowns, the course of what it makes of a unit step, and limits on that.

For given delays everything is linear in the gains and numerators: the equations (`conditions`), the levels and slopes of the reference.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from relaxations.cancelling.conditions import Conditions, Part
from relaxations.cancelling.forms import Form
from relaxations.cancelling.prefilters import Prefilter, integral
from relaxations.shaping.shapers import ShaperTerm

Reals = NDArray[np.float64]

DURING, AFTER = 8, 40  # instants at which terms are looked at: between two delays, and after the last one
NOTHING = 1e-14  # of the largest gain
FINER = 12  # times as many to see whether bounds are kept
LASTING = 14.0  # time constants of the slowest pole that are looked at, and four more for each power


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a filter's steps and its answer to a unit step of the reference are held within (input units per reference unit).

    `gains`: each step A_k; `levels`: the answer at all times; `monotone`: the answer never turns back, for a reference that rises.
    `length` (time [s], size): from so long after the last delay on, the answer is that close to its final value.
    """

    gains: tuple[float, float] | None = None
    levels: tuple[float, float] | None = None
    monotone: bool = False
    length: tuple[float, float] | None = None

    def __bool__(self) -> bool:
        return self.gains is not None or self.levels is not None or self.monotone or self.length is not None


@dataclass(frozen=True)
class Structure:
    """The unknowns that a form has for a plant's conditions, and what is asked of them."""

    conditions: Conditions
    form: Form
    bounds: Bounds = Bounds()
    finer: int = 1
    unit: float = 1.0  # [s] of its time: for messages

    @cached_property
    def fine(self) -> Structure:
        """The same, its bounds looked at more closely."""
        return replace(self, finer=FINER)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Gains and numerators, by delay."""
        return self.form.parts(self.conditions)

    @property
    def freedom(self) -> int:
        """Unknowns, delays included, less the equations."""
        return len(self.parts) + self.form.delays - self.conditions.size

    @property
    def counted(self) -> str:
        """How many unknowns and equations there are, in words."""
        poles = "the plant's poles, those of robustness, and the final value"
        return f"{len(self.parts)} gains and numerators for {self.conditions.size} equations ({poles})"

    @property
    def contradiction(self) -> str | None:
        """Why no filter at all can do it: one whose impulse response is never negative is positive at real s right of its poles."""
        slowest = max((zero.value.real for zero in self.conditions.zeros), default=-math.inf) if self.form.carriers else -math.inf
        real = [pole.value.real for pole in self.conditions.poles if not pole.is_flexible and pole.value.real > slowest]
        if not self.bounds.monotone or not (real or self.conditions.rigid):
            return None
        if not real:
            return "a monotone reference does not return to the input of a plant that rests without one"
        return f"a monotone reference does not cancel the plant's real pole at {real[0]:.6g} 1/s: no sum of positive steps vanishes there"

    @cached_property
    def units(self) -> tuple[tuple[ShaperTerm, ...], ...]:
        """The terms of each unit part that starts at 0; none of a step."""
        return tuple(() if part.power is None else self.conditions.terms(part.power, 1.0, 0.0) for part in self.parts)

    def filter(self, delays: Sequence[float] | Reals, unknowns: Reals) -> Prefilter:
        """The filter with these delays [s] and gains and numerators (parts,); a delay between on which nothing happens is left out."""
        gains, terms, size = [0.0] * len(delays), [], NOTHING * float(np.abs(unknowns).max())
        for part, value in zip(self.parts, unknowns, strict=True):
            if part.power is not None:
                terms += self.conditions.terms(part.power, float(value), float(delays[part.delay]))
            elif abs(value) > size:
                gains[part.delay] = float(value)
        last, begun = len(delays) - 1, {term.start for term in terms}
        used = [k for k in range(last + 1) if gains[k] or k in (0, last) or delays[k] in begun]
        return Prefilter(tuple(float(delays[k]) for k in used), tuple(gains[k] for k in used), joined(terms))

    @cached_property
    def _looks(self) -> tuple[tuple[int, float, float], ...]:
        """Where the answer is looked at: (number of the delay, fraction of the way to the next one, seconds after it)."""
        carried = [part.delay for part in self.parts if part.power is not None]
        first, found = min(carried, default=self.form.delays + 1), []
        for delay in range(self.form.delays):
            found += [(delay, x, 0.0) for x in (np.linspace(0.0, 1.0, DURING * self.finer) if delay >= first else [0.0])]
        after = [0.0]
        if carried and (zeros := self.conditions.zeros):
            slowest, most = min(-zero.value.real for zero in zeros), max(zero.multiplicity for zero in zeros)
            after = [0.0, *np.geomspace(1e-3, 1.0, AFTER * self.finer) * (LASTING + 4 * most) / slowest]
        if self.bounds.length is not None:
            after = sorted({*after, self.bounds.length[0]})
        return (*found, *((self.form.delays, 0.0, float(x)) for x in after))

    def answer(self, delays: Reals) -> tuple[Reals, Reals]:
        """At the looks: the answer to a unit step, and the slope that terms give it, for each unit part: shapes (looks, parts)."""
        ends = np.append(delays, delays[-1])
        at = np.array([delays[k] + x * (ends[k + 1] - delays[k]) + after for k, x, after in self._looks])
        acting = np.array([k for k, _, _ in self._looks])
        levels, slopes = np.zeros((len(at), len(self.parts))), np.zeros((len(at), len(self.parts)))
        for column, (part, unit) in enumerate(zip(self.parts, self.units, strict=True)):
            on, since = acting >= part.delay, np.maximum(at - delays[part.delay], 0.0)
            levels[:, column] = on * (1.0 if part.power is None else sum((integral(term, since) for term in unit), np.zeros(len(at))))
            for term in unit:
                slopes[:, column] += on * (term.coefficient * since**term.power * np.exp(term.rate * since)).real
        return levels, slopes

    @property
    def still(self) -> bool:
        """Whether the bounds are the same rows at all delays: nothing but steps changes before the last one."""
        return all(part.power is None or part.delay == self.form.delays for part in self.parts)

    @cached_property
    def _standing(self) -> tuple[Reals, Reals]:
        return self._stacked(np.arange(self.form.delays + 1.0))

    def limits(self, delays: Reals) -> tuple[Reals, Reals]:
        """What is asked beside the equations, as rows G (n, parts) and h (n,) with `G x ≥ h`."""
        return self._standing if self.still else self._stacked(delays)

    def _stacked(self, delays: Reals) -> tuple[Reals, Reals]:
        rows, sides = zip(*self._limits(delays), strict=True) if self.bounds else ((), ())
        if not rows:
            return np.zeros((0, len(self.parts))), np.zeros(0)
        return np.concatenate(rows), np.concatenate(sides)

    def bends(self, delays: Reals, unknowns: Reals) -> Reals:
        """How `G x - h` changes with each delay but the first, by differences: shape (n, L)."""
        if self.still:
            return np.zeros((len(self._standing[1]), self.form.delays))
        step, columns = 1e-6 * delays[-1], []
        for k in range(1, len(delays)):
            sides = []
            for shift in (step, -step):
                moved = delays.copy()
                moved[k] += shift
                rows, least = self._stacked(moved)
                sides.append(rows @ unknowns - least)
            columns.append((sides[0] - sides[1]) / (2 * step))
        return np.stack(columns, axis=1)

    def _limits(self, delays: Reals) -> Iterator[tuple[Reals, Reals]]:
        unit, bounds = np.eye(len(self.parts)), self.bounds
        steps = unit[[part.power is None for part in self.parts]]
        if bounds.gains is not None:
            yield steps, np.full(len(steps), bounds.gains[0])
            yield -steps, np.full(len(steps), -bounds.gains[1])
        levels, slopes = self.answer(delays) if bounds.levels or bounds.monotone or bounds.length else (unit[:0], unit[:0])
        if bounds.levels is not None:
            yield levels, np.full(len(levels), bounds.levels[0])
            yield -levels, np.full(len(levels), -bounds.levels[1])
        if bounds.monotone:
            moving = slopes[np.abs(slopes).max(axis=1) > 0.0]
            yield steps, np.zeros(len(steps))
            yield moving, np.zeros(len(moving))
        if bounds.length is not None:
            time, size = bounds.length
            late = levels[[k == self.form.delays and after >= time for k, _, after in self._looks]]
            final = np.array(
                [1.0 if part.power is None else sum(term.gain for term in unit) for part, unit in zip(self.parts, self.units, strict=True)]
            )
            yield late - final, np.full(len(late), -size)
            yield final - late, np.full(len(late), -size)


def joined(terms: Sequence[ShaperTerm]) -> tuple[ShaperTerm, ...]:
    """Terms of the same start, rate and power as one."""
    sums: dict[tuple[float, complex, int], complex] = {}
    for term in terms:
        key = term.start, term.rate, term.power
        sums[key] = sums.get(key, 0j) + term.coefficient
    return tuple(ShaperTerm(*key, value) for key, value in sums.items() if value)
