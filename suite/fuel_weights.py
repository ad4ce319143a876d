"""From what weight of fuel on the first node costs less than its neighbours: α_crit of the cost `∫ (1 + α |u|) dt = T + α U`.

A little more fuel than that of the node, U_1, pays while `α < -dT/dU` just above U_1; a little less never does, for the time falls
there with an infinite slope. So α_crit is the slope of the minimum time on that side, here from T_1, in closed form, and two minimum times
that are proven (Singhose, Singh and Seering 1999, Fig. 10). It is measured. From `(T_2 - T_1)/(U_1 - U_2)` on the second node costs less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

from relaxations.bounds import Status
from relaxations.maneuvers import Problem, problem
from relaxations.proofs import minimum_time
from relaxations.transition_fuels import Node, farthest, nodes

NEAREST = 16  # parts of the farthest displacement that has a first node: the nearest is one of them, the others are equally spaced
BESIDE = Fraction(1, 10_000)  # of the node's fuel: where the minimum time is taken, and twice that
CLOSE = 1e-12  # gap of a time that tells a slope


@dataclass(frozen=True, slots=True)
class Weight:
    """α_crit [s per input unit · s] of a `displacement` (output units), and the node that it is about."""

    displacement: Fraction
    node: Node
    alpha: float

    def to_dict(self) -> dict[str, float]:
        """As `fuel --json` has it."""
        node = self.node
        return {"displacement": float(self.displacement), "fuel": node.fuel, "maneuver_time": node.maneuver_time, "alpha": self.alpha}


def critical_weights(posed: Problem) -> tuple[Weight, ...]:
    """α_crit of displacements up to the farthest that has a first node, and of the maneuver's own; none where there are no nodes."""
    end = farthest(posed)
    if end is None:
        return ()
    own = abs(posed.maneuver.displacement)
    asked = {end * k / NEAREST for k in range(1, NEAREST)} | ({own} if own < end else set())
    found = []
    for displacement in sorted(asked):
        weight = critical_weight(problem(posed.plants, replace(posed.maneuver, displacement=displacement)))
        if weight is not None:
            found.append(weight)
    return tuple(found)


def critical_weight(posed: Problem) -> Weight | None:
    """α_crit of one displacement; None without a first node, or where the times beside it are not proven closely."""
    first = next((node for node in nodes(posed, 0.0, float("inf")) if node.number == 1), None)
    if first is None:
        return None
    slopes, near = [], first.maneuver_time
    for part in (BESIDE, 2 * BESIDE):
        fuel = Fraction(first.fuel) * (1 + part)
        maneuver = posed.maneuver
        bound = minimum_time(problem(posed.plants, replace(maneuver, limits=replace(maneuver.limits, fuel=fuel))), near=near)
        if bound.status is not Status.PROVED or bound.upper is None or bound.gap is None or bound.gap > CLOSE:
            return None
        slopes.append((first.maneuver_time - bound.upper) / float(fuel - Fraction(first.fuel)))
        near = bound.upper
    return Weight(posed.maneuver.displacement, first, 2.0 * slopes[0] - slopes[1])
