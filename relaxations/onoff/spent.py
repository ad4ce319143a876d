"""The least fuel of a move in a given time: a linear program whose certificate is that of the minimum time within a budget.

No command of at most T burns U or less where none within the budget U takes T or less, and one of at most T burns at most U' where one
within the budget U' does it in T. So the bracket [U, U'] of the least fuel at T is proven by two certificates about minimum times; the
minimum time within a budget is the root of the least fuel in T, and the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem
from relaxations.maneuvers import problem as pose
from relaxations.onoff.duals import Looks, Windows, least_fuel
from relaxations.proofs import minimum_time

MARGINS = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)  # relative distance from the computed least fuel at which a budget is tried
SCANNED, CLOSE, ROUNDS = 24, 1e-7, 60  # changes of sign looked at first, how well the best is searched [of the duration]


@dataclass(frozen=True, slots=True)
class FuelBound:
    """A bracket of the least fuel [input units · s] of moves of at most `maneuver_time` [s].

    `below` is the bracket of the minimum time within the budget `lower`: its certificate refutes the time. `above` is that within the
    budget `upper`, whose command takes no longer. A side is None where it is not proven.
    """

    maneuver_time: float
    computed: float
    lower: Fraction | None
    upper: Fraction | None
    below: Bound | None
    above: Bound | None

    @property
    def command(self) -> Command | None:
        """The command that burns no more than `upper`."""
        return None if self.above is None else self.above.command


def fuel_at(problem: Problem, maneuver_time: float) -> FuelBound:
    """Bracket the least fuel of a move of at most so many seconds, of the form that the problem holds; a budget of its own does not count.

    Raises `ManeuverError` where the time is too short for any amount of fuel.
    """
    if problem.courses or problem.rate is not None or problem.tail.size or problem.residuals is not None or problem.begin is not None:
        raise ManeuverError("the least fuel is that of a move from rest to state rest, within limits of the input alone")
    free = within(problem, None)
    computed = least_fuel_at(free, maneuver_time)
    if computed is None:
        fastest = minimum_time(free)
        raise ManeuverError(f"no command takes {maneuver_time!r} s, whatever the fuel: the minimum time is at least {fastest.lower!r} s")
    lower: Fraction | None = None
    upper: Fraction | None = None
    below: Bound | None = None
    above: Bound | None = None
    for margin in MARGINS:
        if lower is None:
            budget = Fraction(computed * (1.0 - margin))
            tried = minimum_time(within(problem, budget), near=maneuver_time)
            sure = tried.status is Status.IMPOSSIBLE or (tried.status is Status.PROVED and tried.lower >= maneuver_time)
            lower, below = (budget, tried) if sure else (None, None)
        if upper is None:
            budget = Fraction(computed * (1.0 + margin))
            tried = minimum_time(within(problem, budget), near=maneuver_time)
            sure = tried.status is Status.PROVED and tried.upper is not None and tried.upper <= maneuver_time
            upper, above = (budget, tried) if sure else (None, None)
        if lower is not None and upper is not None:
            break
    return FuelBound(maneuver_time, computed, lower, upper, below, above)


def within(problem: Problem, budget: Fraction | None) -> Problem:
    """The same move with another budget of fuel, or none."""
    maneuver = problem.maneuver
    return pose(problem.plants, replace(maneuver, limits=replace(maneuver.limits, fuel=budget)))


def least_fuel_at(problem: Problem, time: float) -> float | None:
    """The least fuel in floating point, over all changes of sign if a form is held; None if no command is as short."""
    along = problem.maneuver.limits.held
    looks = Looks.of(problem, time, along or 1)
    if not along:
        found = least_fuel(looks, Windows(0.0, time))
        return None if found is None else found.value

    def at(place: float) -> float:
        found = least_fuel(looks, Windows(place, place))
        return np.inf if found is None else found.value

    places = np.linspace(0.0, time, SCANNED + 2)[1:-1]
    values = np.array([at(float(place)) for place in places])
    k = int(np.argmin(values))
    if not np.isfinite(values[k]):
        return None
    low, high, middle, best = places[max(k - 1, 0)], places[min(k + 1, SCANNED - 1)], float(places[k]), float(values[k])
    for _ in range(ROUNDS):
        if high - low <= CLOSE * time:
            break
        other = (low + middle) / 2 if middle - low > high - middle else (middle + high) / 2
        value = at(float(other))
        if value < best:
            low, high, middle, best = (low, middle, other, value) if other < middle else (middle, high, other, value)
        elif other < middle:
            low = other
        else:
            high = other
    return best
