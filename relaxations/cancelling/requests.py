"""A request for a pole-zero cancelling filter, and the filter that answers it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_poly

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.designs import at_delays, design
from relaxations.cancelling.forms import DEFAULT, Form
from relaxations.cancelling.prefilters import Prefilter, cascade
from relaxations.cancelling.sampled import on_samples
from relaxations.cancelling.structures import Bounds, Structure
from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.plants import LinearPlant, Pole
from relaxations.shaping.shapers import ShaperTerm


@dataclass(frozen=True, slots=True)
class Request:
    """A filter with so many `delays` L, of a `form` (`relaxations.cancelling.forms`).

    `robustness` further zeros of G_f stand at each flexible mode, or as many as a mapping says. `zeros` [1/s] are those of the plant that
    are cancelled (None: all left of the imaginary axis; empty: a traditional shaper). `instants` [s] are the delays themselves, ascending
    from more than 0, where they are given; with a `sample_time` [s] they are whole samples.
    """

    delays: int = 1
    form: str = DEFAULT
    robustness: int | Mapping[str, int] = 0
    zeros: Sequence[complex] | None = None
    bounds: Bounds = field(default_factory=Bounds)
    instants: tuple[float, ...] | None = None
    sample_time: float | None = None

    def structure(self, plant: LinearPlant, unit: float = 1.0) -> Structure:
        """The unknowns and equations, of a plant whose time is in units of `unit` [s].

        Raises `ShaperError`, `PlantError`, `ManeuverError`.
        """
        conditions = Conditions.of(plant, self.robustness, self.zeros)
        return Structure(conditions, Form.named(self.form, self.delays), self.bounds, unit=unit)


@dataclass(frozen=True, slots=True)
class Units:
    """Powers of two in which a plant's roots and static gain are of order one: everything scales exactly. Seconds, and input per output."""

    time: float
    gain: float

    @staticmethod
    def of(conditions: Conditions) -> Units:
        """Those of the geometric mean of its roots, and of what its gain asks of a filter."""
        logarithms = [math.log2(abs(root.value)) for root in (*conditions.poles, *conditions.zeros)]
        mean = sum(logarithms) / len(logarithms) if logarithms else 0.0
        time = 2.0 ** -round(mean)
        return Units(time, 2.0 ** round(math.log2(abs(conditions.target)) - conditions.rigid * math.log2(time)))

    def plant(self, plant: LinearPlant) -> LinearPlant:
        """The plant's output in them: `gain G(s/time)`."""
        time, gain = Fraction(self.time), Fraction(self.gain)
        order = plant.order

        def scaled(polynomial: fmpq_poly, factor: Fraction) -> fmpq_poly:
            powers = [factor * time ** (order - k) for k in range(order + 1)]  # times time^order: the denominator stays monic
            return fmpq_poly([c * fmpq(x.numerator, x.denominator) for c, x in zip(polynomial.coeffs(), powers, strict=False)])

        numerators = {plant.output: scaled(plant.numerators[plant.output], gain)}
        return LinearPlant(scaled(plant.denominator, Fraction(1)), numerators, plant.output)

    def request(self, request: Request) -> Request:
        """What is asked, in them."""
        given, per = request.bounds, 1.0 / self.gain

        def sized(pair: tuple[float, float] | None) -> tuple[float, float] | None:
            return None if pair is None else (pair[0] * per, pair[1] * per)

        length = None if given.length is None else (given.length[0] / self.time, given.length[1] * per)
        return replace(
            request,
            zeros=None if request.zeros is None else tuple(zero * self.time for zero in request.zeros),
            bounds=Bounds(sized(given.gains), sized(given.levels), given.monotone, length),
            instants=None if request.instants is None else tuple(instant / self.time for instant in request.instants),
            sample_time=None if request.sample_time is None else request.sample_time / self.time,
        )

    def back(self, made: Prefilter) -> Prefilter:
        """The filter in seconds and the plant's own units."""
        terms = tuple(
            ShaperTerm(t.start * self.time, t.rate / self.time, t.power, t.coefficient * self.gain / self.time ** (t.power + 1))
            for t in made.terms
        )
        return Prefilter(tuple(x * self.time for x in made.delays), tuple(x * self.gain for x in made.gains), terms)


def cancelling(plant: LinearPlant, request: Request) -> Prefilter:
    """The filter between a reference and the plant's input after which the plant's output is at rest from the last delay on.

    Raises `PlantError` for plants that no filter suits (unstable ones, zeros at the origin, or asked to be cancelled and not left of the
    axis), `ShaperError` for what cannot satisfy the conditions, `ImpossibleShaperError` where nothing was found.
    """
    given = request.structure(plant)  # what is wrong with it is told in its own units
    if request.instants is not None and request.sample_time is not None:
        raise ShaperError("the delays are given, or chosen from samples: not both")
    if request.sample_time is not None and not 0.0 < request.sample_time < math.inf:
        raise ShaperError(f"a sample time is positive and finite, not {request.sample_time!r} s")
    instants = request.instants or ()
    if request.instants is not None and (
        len(instants) != request.delays or any(not a < b < math.inf for a, b in zip((0.0, *instants), instants, strict=False))
    ):
        raise ShaperError(f"{request.delays} delays ascend from more than 0 s; given are {', '.join(map(repr, instants))}")
    if given.contradiction is not None:
        raise ImpossibleShaperError(given.contradiction)
    units = Units.of(given.conditions)
    scaled = units.request(request)
    structure = scaled.structure(units.plant(plant), units.time)
    if scaled.sample_time is not None:
        return units.back(on_samples(structure, scaled.sample_time))
    if scaled.instants is not None:
        return units.back(at_delays(structure, np.array([0.0, *scaled.instants])))
    return units.back(design(structure))


def staged(plant: LinearPlant, stages: Sequence[tuple[str, float | None]]) -> tuple[Prefilter, ...]:
    """Filters of two steps for one pole each, `mode[i]` or `real[i]`, with a delay [s] or None for half a period: a cascade (62).

    All have static gain 1; `cascaded` joins them. Raises `ShaperError` for poles that the plant lacks, and for a real one without a delay.
    """
    conditions = Conditions.of(plant, zeros=())
    named = {f"mode[{i}]": pole for i, pole in enumerate(plant.flexible, 1)} | {f"real[{i}]": pole for i, pole in enumerate(plant.real, 1)}
    made = []
    for name, delay in stages:
        if name not in named:
            raise ShaperError(f"the plant has no {name}; it has {', '.join(named) or 'no such pole'}")
        pole = Pole(named[name].value, 1)
        if not pole.is_flexible and delay is None:
            raise ShaperError(f"{name} is cancelled by two steps with any delay, the later one the smaller the gains: give the delay")
        alone = Structure(replace(conditions, poles=(pole,), rigid=0, target=1.0), Form.named("last", 1))
        made.append(design(alone) if delay is None else at_delays(alone, np.array([0.0, delay])))
    return tuple(made)


def cascaded(filters: Sequence[Prefilter]) -> Prefilter:
    """All of them one after the other; of none a gain of 1."""
    whole = Prefilter((0.0,), (1.0,))
    for one in filters:
        whole = cascade(whole, one)
    return whole
