"""Random tasks with several limits at once, each tight enough to matter, with numbers of few digits."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from independent import StateSpace
from independent_limits import Limited
from numpy.typing import NDArray
from problems import transfer, two_mass

from relaxations.initial import from_output
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time


@dataclass(frozen=True)
class Limiting:
    """A task: the problem, and what tells the independent program the same."""

    problem: Problem
    names: tuple[str, ...]

    def other(self, looks: int) -> Limited:
        """The same for HiGHS."""
        asked, maneuver = self.problem, self.problem.maneuver
        return Limited(
            asked.plants[0],
            float(maneuver.displacement),
            asked.lower,
            asked.upper,
            asked.fuel,
            asked.rate,
            {name: float(limit) for name, limit in maneuver.limits.deflection.items()},
            [float(x) for x in maneuver.initial or ()],
            None if maneuver.sample_time is None else float(maneuver.sample_time),
            looks,
        )


def few(value: float) -> Fraction:
    """A number near `value` with three digits."""
    return Fraction(f"{value:.3g}")


def plants(rng: np.random.Generator) -> tuple[LinearPlant, str]:
    """A plant, and the name of an output to be limited."""
    match rng.integers(5):
        case 0:
            return two_mass(1, f"{rng.uniform(0.5, 3):.3g}", f"{rng.choice([0.0, 0.1]):.3g}"), "spring"
        case 1:
            return transfer([1], [1, 0, 0])(), "output_rate"
        case 2:
            return transfer([1], [1, f"{rng.uniform(0.2, 2):.3g}", 0])(), "output_rate"
        case 3:
            return transfer([1], [1, f"{rng.uniform(0.05, 0.5):.3g}", 1])(), "output_rate"
        case _:
            return transfer([1], [1, "0.3", f"{rng.uniform(1, 3):.3g}", 0])(), "output_rate"


NAMES = ("fuel", "deflection", "rate", "sample_time", "start")


@cache
def limiting(seed: int, must: tuple[str, ...] = ()) -> Limiting:
    """Two limits or more, the names in `must` among them."""
    rng = np.random.default_rng([2026, 11, seed])
    plant, output = plants(rng)
    names = {*must, *(name for name in NAMES if rng.random() < 0.45)}
    names |= {NAMES[i] for i in rng.permutation(len(NAMES))[: max(2 - len(names), 0)]}
    displacement = few(rng.uniform(0.1, 0.6) if plant.rest_input(Fraction(1)) else rng.uniform(0.5, 3))
    if plant.rest_input(Fraction(1)):
        names.discard("fuel")
    start = None
    if "start" in names:
        begins: NDArray[np.float64] = rng.uniform(-0.4, 0.4, plant.order)
        start = from_output(plant, [few(x) for x in begins])
    low, high = few(-rng.uniform(0.8, 1.6)), few(rng.uniform(0.8, 1.6))
    if plant.rest_input(Fraction(1)):
        low, high = Fraction(-3), Fraction(3)
    free = minimum_time(problem([plant], Maneuver(displacement, Limits(low, high), initial=start)))
    assert free.command is not None
    time = free.command.maneuver_time
    model, fuel, deflection, rate, step = StateSpace.of(plant, output), None, {}, None, None
    if "deflection" in names:
        begin = np.array([float(x) for x in start[::-1]]) if start else np.zeros(plant.order)
        times = np.linspace(0.0, time, 201)
        course = model.states(free.command, times) @ model.C + [float(model.C @ model.step(t)[0] @ begin) for t in times]
        least = max(abs(course[0]), abs(course[-1])) * 1.05
        deflection = {output: max(few(rng.uniform(0.6, 0.95) * float(np.abs(course).max())), few(least))}
    if "fuel" in names:
        fuel = few(rng.uniform(0.85, 0.98) * free.command.fuel())
    if "rate" in names:
        rate = few(-rng.uniform(6, 20) / time), few(rng.uniform(6, 20) / time)
    if "sample_time" in names:
        step = few(time / rng.uniform(12, 40))
    limits = Limits(low, high, fuel, deflection=deflection, rate=rate)
    asked = problem([plant], Maneuver(displacement, limits, sample_time=step, initial=start))
    return Limiting(asked, tuple(sorted(names)))
