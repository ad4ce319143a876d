"""Which delayed terms of a filter are steps and which carry its poles: the parametrisations, by name.

    last          steps, and the poles alone on the last delay             (Singh 2012, parametrisation 1: (4), (32), (43), (49))
    first         the poles alone on the undelayed term, then steps        (parametrisation 2: (17))
    K             the poles alone on delay number K, steps elsewhere
    every         the poles on every term, steps on none
    …+step        the terms with poles are steps as well                   (last+step: parametrisation 3, (27), and (57))
    …+free        the numerators over those poles are free, one degree less than the denominator; else they are constants

Without zeros that could be cancelled every term is a step: a traditional shaper, its modes solved for together.
"""

from __future__ import annotations

from dataclasses import dataclass

from relaxations.cancelling.conditions import Conditions, Part
from relaxations.errors import ShaperError

DEFAULT = "last"


@dataclass(frozen=True, slots=True)
class Form:
    """A structure with `delays` L: `carriers`, the numbers of the terms with poles, that are steps as well (`step`), numerators `free`."""

    delays: int
    carriers: tuple[int, ...]
    step: bool = False
    free: bool = False

    @staticmethod
    def named(name: str, delays: int) -> Form:
        """The form of that name; raises `ShaperError` with what would be valid."""
        place, *options = name.split("+")
        if delays < 1:
            raise ShaperError(f"a filter has at least one delay, not {delays}")
        if place in ("last", "first", "every"):
            carriers = {"last": (delays,), "first": (0,), "every": tuple(range(delays + 1))}[place]
        elif place.isdecimal() and int(place) <= delays:
            carriers = (int(place),)
        else:
            raise ShaperError(
                f'{place!r} names no delayed term; the poles stand on "last", "first", "every" or one of 0 to {delays}, and each of these '
                'may be followed by "+step" and "+free"'
            )
        if wrong := [option for option in options if option not in ("step", "free")] or options[:-1] * (len(set(options)) < len(options)):
            raise ShaperError(f'{name!r}: after the place of the poles stand "+step", "+free", or both, not {wrong[0]!r}')
        return Form(delays, carriers, "step" in options, "free" in options)

    def parts(self, conditions: Conditions) -> tuple[Part, ...]:
        """The unknowns that enter linearly, by delay, steps first."""
        powers = range(conditions.order if self.free else min(conditions.order, 1))
        found = []
        for delay in range(self.delays + 1):
            carries = delay in self.carriers and len(powers) > 0
            if not carries or self.step:
                found.append(Part(delay))
            if carries:
                found += [Part(delay, power) for power in powers]
        return tuple(found)
