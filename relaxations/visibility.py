"""Modes that an output does not see."""

from __future__ import annotations

from relaxations.errors import ManeuverError
from relaxations.plants import LinearPlant, roots


def visible(plant: LinearPlant) -> LinearPlant:
    """The plant as its output sees it; raises `ManeuverError` if a mode that the output cannot see does not decay."""
    numerator = plant.numerators[plant.output]
    common = numerator.gcd(plant.denominator)
    if common.degree() <= 0:
        return plant
    lasting = [pole.value for pole in roots(common) if pole.value.real >= 0]
    if lasting:
        shown = ", ".join(f"{value:.6g}" for value in lasting)
        raise ManeuverError(f"hidden modes: the output cannot see {shown}, which do not decay; state rest (tail = false) includes them")
    note = f"{common.degree()} hidden modes decay unseen by the output and were dropped from the output rest"
    lead = common / common.leading_coefficient()
    return LinearPlant(plant.denominator / lead, {plant.output: numerator / lead}, plant.output, (*plant.notes, note))
