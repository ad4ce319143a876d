"""The plant of a study that varies while it moves: matrices at the instants of its schedule, as written, or those of an FMU along its own
motion, linearised where it is at each of these instants with its input at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from fmus.errors import FmuError
from relaxations.errors import PlantError
from relaxations.transitions import VaryingPlant
from suite.linearised import linearised
from suite.study import FmuPlant, Plant, StateSpacePlant, Study

if TYPE_CHECKING:
    from fmus.linearization import Linearization

Value = Fraction | Decimal | float

REST = 1e-6  # of a natural size: what may move by itself of what the input moves
_known: dict[tuple[object, ...], VaryingPlant] = {}
MOST_KNOWN = 64


def varying_plant(plant: Plant, parameters: Mapping[str, Value] | None = None, outputs: Sequence[str] = ()) -> VaryingPlant | None:
    """The plant over its schedule, with some parameters changed, and of an FMU further `outputs`; None if it does not vary.

    Raises `PlantError` as `linear_plant` does.
    """
    schedule = plant.schedule
    if schedule is None:
        return None
    instants = (Decimal(0), *schedule.times)
    source = plant.source
    if isinstance(source, StateSpacePlant):
        A = (source.A, *(schedule.A or (source.A,) * len(schedule.times)))
        B = (source.B, *(schedule.B or (source.B,) * len(schedule.times)))
        C = (source.C, *(schedule.C or (source.C,) * len(schedule.times)))
        rows = {name: [row] * len(instants) for name, row in source.outputs.items()}
        return VaryingPlant.of(instants, A, B, C, [source.D] * len(instants), plant.output, rows)
    assert isinstance(source, FmuPlant)
    found = _followed(source, plant, {**source.parameters, **(parameters or {})}, instants)
    further = [name for name in outputs if name not in found.rows and name != "output_rate"]
    seen = {name: _followed(source, replace(plant, output=name), {**source.parameters, **(parameters or {})}, instants) for name in further}
    if jumping := [name for name, one in seen.items() if any(one.D)]:
        raise PlantError(f"{', '.join(jumping)} jumps with the input of {source.archive.path.name}, whose limits are its own")
    return replace(found, outputs={**found.outputs, **{name: one.C for name, one in seen.items()}}) if seen else found


def _followed(source: FmuPlant, plant: Plant, parameters: Mapping[str, Value], instants: tuple[Decimal, ...]) -> VaryingPlant:
    """`_along`, once for what is asked for again."""
    key = (
        *(source.archive.path, source.archive.sha256, plant.input, plant.output, plant.initial_input, source.settle, source.method),
        *(tuple(sorted(parameters.items())), tuple(sorted(source.initial_state.items())), instants),
    )
    if key not in _known:
        if len(_known) >= MOST_KNOWN:
            _known.clear()
        _known[key] = _along(source, plant, parameters, instants)
    return _known[key]


def study_plant(study: Study, parameters: Mapping[str, Value] | None = None) -> VaryingPlant | None:
    """`varying_plant` of a study's plant, with the outputs that the study limits."""
    return varying_plant(study.plant, parameters, tuple(study.limits.deflection))


def _along(fmu: FmuPlant, plant: Plant, parameters: Mapping[str, Value], instants: tuple[Decimal, ...]) -> VaryingPlant:
    from fmus.workers import Worker  # here, because it brings along what runs FMUs

    name = fmu.archive.path.name
    found: list[Linearization] = []
    try:
        with Worker() as worker:
            for instant in instants:
                one = linearised(fmu, plant, parameters, after=float(instant), step=fmu.step, worker=worker)
                if one.identification is not None:
                    raise PlantError(f"{name} shows no states: it can be identified at one instant, not followed along its motion")
                if found and one.states != found[0].states:
                    raise PlantError(f"the states of {name} change while it moves")
                late = abs(one.settled - fmu.settle - float(instant))
                if late > 1e-9 * max(1.0, float(instant)):
                    following = one.settled - fmu.settle
                    raise PlantError(
                        f"{float(instant):.9g} s is no communication point of {name}: the next one is at {following:.9g} s "
                        "(simulation.step chooses another step)"
                    )
                found.append(one)
    except FmuError as problem:
        raise PlantError(f"{name} cannot be linearised along its motion: {problem}") from None
    matrices = [[[float(x) for x in row] for row in one.A] for one in found]
    varying = VaryingPlant.of(
        *(instants, matrices, [one.B.tolist() for one in found], [one.C.tolist() for one in found], [one.D for one in found], plant.output),
        states=found[0].states,
    )
    moving = np.flatnonzero(np.any([one.B != 0.0 for one in found], axis=0))
    for one in found:  # the states that the input moves rest without it
        reached = np.zeros(len(one.states), dtype=bool)
        reached[moving] = True
        for _ in one.states:
            reached |= (one.A[:, reached] != 0.0).any(axis=1)
        natural = np.abs(np.column_stack([one.A, one.B])) @ one.sizes
        if abs(one.y - found[0].y) > REST * max(1.0, abs(found[0].y)):
            raise PlantError(
                f"the output {plant.output!r} of {name} changes by itself, from {found[0].y:.6g} to {one.y:.6g} in the first "
                f"{one.settled:.6g} s of a motion without its input: it does not begin at rest"
            )
        if np.any(np.abs(one.rates[reached]) > REST * natural[reached]):
            raise PlantError(f"{name} moves by itself what its input moves, {one.settled:.6g} s after it starts: it does not begin at rest")
    worst = max(one.error for one in found)
    told = f"the plant is {name} along its own motion, by {found[0].method} at {len(found)} instants (relative error about {worst:.1g})"
    return replace(varying, notes=(*varying.notes, told))
