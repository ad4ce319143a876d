"""What a shaper is convolved with in a maneuver: a step to the new rest input, or the fastest move of the machine as if it were rigid.

Convolution is linear: a shaper of sum 1 leaves the displacement as it is and, with positive impulses, the limits as well.
"""

from __future__ import annotations

from fractions import Fraction

from relaxations.bounds import Bound
from relaxations.commands import Command, Tail
from relaxations.errors import PlantError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact, fraction
from relaxations.proofs import minimum_time


def rigid_part(plant: LinearPlant) -> LinearPlant:
    """The plant without its flexible modes and zeros, with the same displacement for every command that leaves all modes at rest.

    `N(0) / (D_m/∏(-p)) / (s^m ∏(s - p))` with the m poles at the origin and the real poles p (as doubles), D_m the coefficient of s^m in D.
    Raises `PlantError` if nothing is left.
    """
    if not plant.rigid_order and not plant.real:
        raise PlantError('the plant has flexible modes only: it has no rigid part to move; a "step" is its reference')
    origin, real = plant.rigid_order, [exact(repr(pole.value.real)) for pole in plant.real for _ in range(pole.multiplicity)]
    gain = fraction(plant.numerators[plant.output](0)) / fraction(plant.denominator.coeffs()[origin])
    for pole in real:
        gain *= -pole
    return LinearPlant.from_zeros_poles([], [Fraction(0)] * origin + real, gain)


def rigid_problem(plant: LinearPlant, maneuver: Maneuver) -> Problem:
    """The same move of the rigid part, within the same limits on the input. Raises `PlantError`."""
    limits = Limits(maneuver.limits.lower, maneuver.limits.upper)
    return problem([rigid_part(plant)], Maneuver(maneuver.displacement, limits, maneuver.rest))


def rigid_move(plant: LinearPlant, maneuver: Maneuver) -> Bound:
    """The minimum time of the rigid part within the maneuver's limits on the input, its proof, and the command. Raises `PlantError`."""
    return minimum_time(rigid_problem(plant, maneuver))


def step(plant: LinearPlant, displacement: Fraction, rest: Fraction) -> Command:
    """The input jumps to what holds the plant at its new rest, absolute; `rest` is the input before.

    Raises `PlantError` for a plant with a rigid body, which is held anywhere by the same input.
    """
    if plant.rigid_order:
        raise PlantError('the plant has a rigid body, which a step does not bring to rest; its reference is "rigid"')
    return Command(0.0, (), Tail(float(rest + plant.rest_input(displacement))))
