"""What is shipped: every plant with its domain, and the poles and zeros of its linear twin, without building anything."""

from __future__ import annotations

from dataclasses import dataclass

from fmus.build import PLANTS, shipped
from fmus.plant_files import Size, read_plant_file
from fmus.twins import linear_plant, read_twin, sized
from relaxations.plants import Pole


@dataclass(frozen=True, slots=True)
class Entry:
    """One plant, from its input to the first output of its twin, with the parameters that it starts with; units are the FMU's.

    `size` is what may be chosen in its name; `nonlinear` says that poles and zeros belong to small motions about its rest.
    """

    name: str
    title: str
    domain: str
    input: str
    input_unit: str
    output: str
    output_unit: str
    poles: tuple[Pole, ...]
    zeros: tuple[Pole, ...]
    nonlinear: bool
    size: Size | None


def catalogue() -> tuple[Entry, ...]:
    """Every plant shipped here, by name."""
    return tuple(map(entry, shipped()))


def entry(name: str) -> Entry:
    """One plant shipped here; raises `BuildError` or `DescriptionError` if its files are wrong."""
    plant = read_plant_file(PLANTS / name / "plant.toml")
    text = (PLANTS / name / "twin.toml").read_text(encoding="utf-8")
    twin = read_twin(sized(text, plant.size.value if plant.size else None))
    output = next(iter(twin.outputs))
    linear = linear_plant(twin, output)
    unit = {v.name: v.unit for v in plant.variables}
    return Entry(
        name=name,
        title=plant.title,
        domain=plant.domain,
        input=twin.input,
        input_unit=unit[twin.input],
        output=output,
        output_unit=unit[output],
        poles=linear.poles,
        zeros=linear.zeros,
        nonlinear=twin.nonlinear,
        size=plant.size,
    )
