"""Fuels at which one pulse either way is all that a flexible machine needs, in closed form (docs/theory.md, section 5).

The second pulse begins a whole number n of periods after the first one and is its mirror image, so it takes back the vibration that the
first one made. Two pulses of width w at the limit u, t = 2πn/ω apart, move a body of mass M by Δ = u w t/M:

    U_n = 2 u w = M ω |Δ| / (n π),     T_n = 2πn/ω + U_n / (2 u)

With less fuel a second pair of pulses appears, and the time jumps: these are the nodes of the curve of time against fuel (Singhose, Singh
and Seering 1999, equation 33, whose factor is off).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from relaxations.maneuvers import Problem
from relaxations.plants import fraction

MOST = 50  # nodes: those of less fuel are of no use to anybody


@dataclass(frozen=True, slots=True)
class Node:
    """The n-th node: `fuel` [input units · s], `maneuver_time` [s], and when the second pulse begins [s]."""

    number: int
    fuel: float
    maneuver_time: float
    second: float


def reason_against(problem: Problem) -> str | None:
    """Why the closed form does not hold for a plant or its limits; None if it does: one body, one mode without damping, equal limits."""
    (plant, *others), maneuver = problem.plants, problem.maneuver
    limits, flexible = maneuver.limits, plant.flexible
    if others or maneuver.initial is not None or problem.transition is not None:
        return "the move is one plant's, from rest"
    if plant.rigid_order != 2 or plant.real:
        return "the plant is a mass (two poles at the origin, no real ones beside them)"
    if len(flexible) != 1 or flexible[0].multiplicity != 1:
        return f"the plant has one flexible mode, not {len(flexible) if len(flexible) != 1 else 'a repeated one'}"
    if flexible[0].value.real != 0.0:
        return f"the mode has no damping, not {flexible[0].damping_ratio:.3g}"
    if limits.upper - maneuver.rest != maneuver.rest - limits.lower:
        return "the limits are as far from the input at rest on both sides"
    if limits.rate is not None or limits.deflection or maneuver.sample_time is not None:
        return "the input jumps at any time: no limits of slopes or outputs, no sample time"
    return None


def farthest(problem: Problem) -> Fraction | None:
    """The displacement (output units) up to which there is a first node: then the pulses meet. None where `reason_against` has a reason."""
    if reason_against(problem) is not None:
        return None
    second = 2.0 * math.pi / problem.plants[0].flexible[0].natural_frequency
    return Fraction(problem.upper * second**2) * abs(_gain(problem))


def _gain(problem: Problem) -> Fraction:
    """1/M: of a mass, what its output's acceleration is to the input."""
    (plant,) = problem.plants
    return fraction(plant.numerators[plant.output](0)) / fraction(plant.denominator.coeffs()[2])


def nodes(problem: Problem, least: float, most: float) -> tuple[Node, ...]:
    """The nodes with fuels from `least` to `most`, most fuel first; none where `reason_against` has a reason."""
    if reason_against(problem) is not None:
        return ()
    omega, upper = problem.plants[0].flexible[0].natural_frequency, problem.upper
    first = omega * abs(float(problem.maneuver.displacement / _gain(problem))) / math.pi
    found = []
    for n in range(1, MOST + 1):
        fuel, second = first / n, 2.0 * math.pi * n / omega
        if fuel < least:
            break
        if fuel <= most and fuel <= 2.0 * upper * second:  # the first pulse ends before the second one begins
            found.append(Node(n, fuel, second + fuel / (2.0 * upper), second))
    return tuple(found)
