"""The simplex method in as many digits as are set, for small programs whose numbers differ by more than doubles tell.

Balls serve as long floats; nothing is proven here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import flint
from flint import arb, arb_mat

from relaxations.errors import SolverError

PIVOTS = 20  # for each equation
TRIED = 24  # columns that may enter, of those that gain: evenly among them, for they are neighbours on a curve


@dataclass(frozen=True, slots=True)
class Vertex:
    """Columns of a basis with their weights > 0, and the multipliers of the equations: their prices exceed no column's cost."""

    weights: tuple[tuple[int, arb], ...]
    multipliers: tuple[arb, ...]


def cheapest(table: arb_mat, aim: arb_mat, costs: Sequence[int]) -> Vertex | None:
    """Weights ≥ 0 with `table weights = aim` ≥ 0, table (m, n), of the least cost; None if there are none.

    From artificial columns, of which as much as possible is driven out first. Raises `SolverError` where that does not end.
    """
    m, nothing = table.nrows(), arb(2) ** (-(flint.ctx.prec // 2))
    small = float(nothing)
    # Numbers of the aim that are 0 would let the basis go round in circles: none is.
    aim = arb_mat([[aim[i, 0] + arb(2) ** (-(flint.ctx.prec // 3)) * (1 + arb(i) / m)] for i in range(m)]).mid()
    basis, feasible = [-1] * m, False
    matrix = arb_mat([[arb(int(i == k)) for k in range(m)] for i in range(m)])
    for _ in range(PIVOTS * m):
        inverse = matrix.inv().mid()
        weights = (inverse * aim).mid()
        artificial = arb_mat([[arb(int(column < 0)) for column in basis]])
        feasible = feasible or bool((artificial * weights)[0, 0].mid() <= nothing)
        own = arb_mat([[arb(costs[column] if column >= 0 else 0) for column in basis]]) if feasible else artificial
        multipliers = (own * inverse).mid()
        gains = [float(price) - (cost if feasible else 0) for price, cost in zip((multipliers * table).entries(), costs, strict=True)]
        rising = [k for k, gain in enumerate(gains) if gain > small]
        if not rising:
            if not feasible:
                return None
            used = [(column, weights[i, 0]) for i, column in enumerate(basis) if column >= 0 and weights[i, 0] > nothing]
            return Vertex(tuple(used), tuple(multipliers.entries()))
        # Of neighbours on a curve all gain: the one that takes most off the cost, not the steepest, or the basis would creep along it.
        rising = rising[:: -(-len(rising) // TRIED)]
        falls = (inverse * arb_mat([[table[i, k] for k in rising] for i in range(m)])).mid()
        steps = []
        for place, k in enumerate(rising):
            ratios = [(float(weights[i, 0] / falls[i, place]), i) for i in range(m) if falls[i, place] > nothing]
            if ratios:
                length, leaving = min(ratios)
                steps.append((gains[k] * length, k, leaving))
        if not steps:
            return None
        _, best, leaving = max(steps)
        basis[leaving] = best
        for i in range(m):
            matrix[i, leaving] = table[i, best]
    raise SolverError(f"the simplex method did not end in {PIVOTS * m} steps")
