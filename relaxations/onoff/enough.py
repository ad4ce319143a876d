"""The fuel that every command needs, however long it takes: the most that is proven to be too little.

A budget is too little where the checker accepts that no command within it does the move in any time (docs/theory.md, section 5). What is
proven of a budget holds of every smaller one, so the largest that is refuted is searched for by doubling and halving; each answer is the
checker's, so that the result is proven whatever the search did.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from relaxations.maneuvers import Problem
from relaxations.onoff.spent import within
from relaxations.proofs import impossibility

CLOSE = 1e-9  # relative: how far below the least budget that was not refuted the search ends
DOUBLINGS = 64  # of the problem's own budget, at most


@dataclass(frozen=True, slots=True)
class TooLittle:
    """Every command burns more than `budget` [input units · s]: `certificate` says that none within it does the move in any time."""

    budget: Fraction
    certificate: bytes

    @property
    def below(self) -> float:
        """The budget as a double, rounded down."""
        value = float(self.budget)
        return value if Fraction(value) <= self.budget else math.nextafter(value, -math.inf)


def too_little(problem: Problem) -> TooLittle | None:
    """The most fuel that is proven to be too little for the problem's move, its own budget being so.

    None where that budget is not refuted, where the move is impossible with any amount of fuel, and of plants that vary.
    """
    own = problem.maneuver.limits.fuel
    if own is None or problem.transition is not None or impossibility(within(problem, None)) is not None:
        return None
    content = impossibility(problem)
    if content is None:
        return None
    known, high = TooLittle(own, content), 2 * own
    for _ in range(DOUBLINGS):
        if (content := impossibility(within(problem, high))) is None:
            break
        known, high = TooLittle(high, content), 2 * high
    else:
        return None
    while high - known.budget > CLOSE * float(high):
        middle = Fraction(float(known.budget + high) / 2.0)
        if (content := impossibility(within(problem, middle))) is None:
            high = middle
        else:
            known = TooLittle(middle, content)
    return known
