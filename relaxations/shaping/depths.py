"""From points to dips: partial sums that begin at 1 and dip to a given depth, from dips so deep that they are all but points.

At 1/depth = 0 a dip is a point with an integral (relaxations.shaping.cones, relaxations.shaping.decayed). With 1/depth it becomes wider,
along a curve that is followed (relaxations.shaping.paths), at any damping and for any number of zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from flint import acb, arb

from relaxations.errors import SolverError
from relaxations.plants import rational
from relaxations.shaping.cones import Zeros
from relaxations.shaping.dips import TOLD, Dip
from relaxations.shaping.paths import Vector, followed

DEEP = 2.0**-10  # of a duration: from dips so narrow points are not far


def widened(zeros: Zeros, instants: Sequence[arb], sizes: Sequence[arb], depth: Fraction) -> list[Dip]:
    """Of points [s] and the integrals [s] of dips there the dips of this depth, which leave nothing: ever wider ones from narrow ones on.

    Raises `SolverError`.
    """
    rates = []
    for mode, count in zeros:
        zeta = arb(mode.damping)
        rate = arb(mode.frequency) * acb(zeta, (1 - zeta * zeta).sqrt())
        rates += [(rate, power) for power in range(count + 1)]
    end = instants[-1]
    last = rational(depth)
    widest = max(sizes) / last
    deep = max(arb(1), (widest / (DEEP * end)))
    if len(sizes) != len(rates):
        if not widest < TOLD * end:
            raise SolverError("dips that are more than zeros, and wide, were not followed to their depth")
        return [((at - size / last / 2).mid(), (at + size / last / 2).mid()) for at, size in zip(instants, sizes, strict=True)]

    def system(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """x: middles, and logarithms of widths times depth, both in units of the end; w: the logarithm of 1/depth."""
        n = len(rates)
        values: Vector = []
        rows: list[Vector] = []
        for rate, power in rates:
            unit = rate * end
            value, by_x, by_w = acb(0 if power else 1), [acb(0)] * (2 * n), acb(0)
            for k in range(n):
                width = (x[n + k] + w).exp()
                edges = x[k] - width / 2, x[k] + width / 2
                at = [edge**power * (unit * edge).exp() for edge in edges]
                slopes = [(arb(power) / edge + unit) * part for edge, part in zip(edges, at, strict=True)]
                jump = (-w).exp()
                value += jump * (at[1] - at[0])
                by_x[k] = jump * (slopes[1] - slopes[0])
                by_x[n + k] = jump * (slopes[1] + slopes[0]) * width / 2
                by_w += by_x[n + k] - jump * (at[1] - at[0])
            values += [value.real, value.imag]
            rows += [[*(d.real for d in by_x), by_w.real], [*(d.imag for d in by_x), by_w.imag]]
        return values, rows

    start = [*(at / end for at in instants), *((size / end).log() for size in sizes)]
    goal = -arb(last).log()
    path = followed(system, start, goal - deep.log(), goal)
    if path is None or not path.goal:
        raise SolverError("dips were not followed to their depth")
    n = len(rates)
    dips = []
    for middle, size in zip(path.x[:n], path.x[n:], strict=True):
        half = (size + path.w).exp() / 2
        dips.append((((middle - half) * end).mid(), ((middle + half) * end).mid()))
    if not all(before[1] < after[0] for before, after in zip([(arb(0), arb(0)), *dips], dips, strict=False)):
        raise SolverError("dips overlap")
    return dips
