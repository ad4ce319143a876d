"""A request for a pole-zero cancelling filter, and the filter that answers it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.designs import at_delays, design
from relaxations.cancelling.forms import DEFAULT, Form
from relaxations.cancelling.prefilters import Prefilter, cascade
from relaxations.cancelling.sampled import on_samples
from relaxations.cancelling.structures import Bounds, Structure
from relaxations.errors import ShaperError
from relaxations.plants import LinearPlant, Pole


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

    def structure(self, plant: LinearPlant) -> Structure:
        """The unknowns and equations; raises `ShaperError`, `PlantError`, `ManeuverError`."""
        conditions = Conditions.of(plant, self.robustness, self.zeros)
        return Structure(conditions, Form.named(self.form, self.delays), self.bounds)


def cancelling(plant: LinearPlant, request: Request) -> Prefilter:
    """The filter between a reference and the plant's input after which the plant's output is at rest from the last delay on.

    Raises `PlantError` for plants that no filter suits (unstable ones, zeros at the origin, or asked to be cancelled and not left of the
    axis), `ShaperError` for what cannot satisfy the conditions, `ImpossibleShaperError` where nothing was found.
    """
    structure = request.structure(plant)
    if request.instants is not None and request.sample_time is not None:
        raise ShaperError("the delays are given, or chosen from samples: not both")
    if request.sample_time is not None:
        return on_samples(structure, request.sample_time)
    if request.instants is None:
        return design(structure)
    if len(request.instants) != request.delays or any(b <= a for a, b in zip((0.0, *request.instants), request.instants, strict=False)):
        raise ShaperError(f"{request.delays} delays ascend from more than 0 s; given are {', '.join(map(repr, request.instants))}")
    return at_delays(structure, np.array([0.0, *request.instants]))


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
