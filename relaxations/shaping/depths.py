"""From points to dips: partial sums that begin at 1 and dip to a given depth, from dips so deep that they are all but points.

At 1/depth = 0 a dip is a point with an integral (relaxations.shaping.cones, relaxations.shaping.decayed). With 1/depth it becomes wider,
along a curve that is followed (relaxations.shaping.paths), at any damping and for any number of zeros. More dips than zeros are told by a
function `g = c · v` of the columns v = t^j e^{pt} besides: it is 0 where dips begin and end, but for the end of the last one.
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
from relaxations.shaping.touching import solution

DEEP = 2.0**-10  # of a duration: from dips so narrow points are not far


Rates = Sequence[tuple[acb, int]]


def widened(zeros: Zeros, instants: Sequence[arb], sizes: Sequence[arb], depth: Fraction) -> list[Dip]:
    """Of points [s] and the integrals [s] of dips there the dips of this depth, which leave nothing: ever wider ones from narrow ones on.

    Raises `SolverError`.
    """
    rates = []
    for mode, count in zeros:
        zeta = arb(mode.damping)
        rate = arb(mode.frequency) * acb(zeta, (1 - zeta * zeta).sqrt())
        rates += [(rate * instants[-1], power) for power in range(count + 1)]
    n, end, last = len(sizes), instants[-1], rational(depth)
    widest = max(sizes) / last
    deep = max(arb(1), (widest / (DEEP * end)))
    places, integrals = [at / end for at in instants], [size / end for size in sizes]
    begun = multipliers(rates, places, integrals) if n != len(rates) else []

    def system(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """x: middles, and logarithms of widths times depth, both in units of the end, multipliers; w: the logarithm of 1/depth."""
        values, rows = _closed(rates, x[: 2 * n], w)
        if not begun:
            return values, rows
        rows = [[*row[:-1], *[arb(0)] * len(begun), row[-1]] for row in rows]
        more, further = _touching(rates, x, w, integrals)
        values += [*more, sum((a * b for a, b in zip(x[2 * n :], begun, strict=True)), arb(0)) - sum((b * b for b in begun), arb(0))]
        return values, [*rows, *further, [*[arb(0)] * (2 * n), *begun, arb(0)]]

    goal = -arb(last).log()
    path = followed(system, [*places, *(size.log() for size in integrals), *begun], goal - deep.log(), goal)
    if path is None or not path.goal:
        if begun and widest < TOLD * end:
            return [((at - size / last / 2).mid(), (at + size / last / 2).mid()) for at, size in zip(instants, sizes, strict=True)]
        raise SolverError("dips were not followed to their depth")
    dips = []
    for middle, size in zip(path.x[:n], path.x[n : 2 * n], strict=True):
        half = (size + path.w).exp() / 2
        dips.append((((middle - half) * end).mid(), ((middle + half) * end).mid()))
    if not all(before[1] < after[0] for before, after in zip([(arb(0), arb(0)), *dips], dips, strict=False)):
        raise SolverError("dips overlap")
    return dips


def _edges(x: Vector, k: int, w: arb) -> tuple[arb, arb, arb]:
    """A dip's beginning, end and width."""
    n = len(x) // 2
    width = (x[n + k] + w).exp()
    return x[k] - width / 2, x[k] + width / 2, width


def _closed(rates: Rates, x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
    """That nothing is left."""
    n = len(x) // 2
    values: Vector = []
    rows: list[Vector] = []
    for unit, power in rates:
        value, by_x, by_w = acb(0 if power else 1), [acb(0)] * (2 * n), acb(0)
        for k in range(n):
            *edges, width = _edges(x, k, w)
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


def _touching(rates: Rates, x: Vector, w: arb, integrals: Sequence[arb]) -> tuple[Vector, list[Vector]]:
    """That g is 0 at the edges of dips, of each half the sum and the slope between them; times what the dip counts for."""
    n = len(integrals)
    c = x[2 * n :]
    values: Vector = []
    rows: list[Vector] = []
    for k, size in enumerate(integrals):
        begin, end, width = _edges(x[: 2 * n], k, w)
        (at_begin, slope_begin), (at_end, slope_end) = ([[size * e for e in column] for column in columns(rates, t)] for t in (begin, end))
        first, second, rise, fall = (dot(c, column) for column in (at_begin, at_end, slope_begin, slope_end))
        if k == n - 1:
            values.append(first)
            rows.append(_row(x, k, rise, -rise * width / 2, at_begin))
            continue
        slope = (second - first) / width
        values += [(first + second) / 2, slope]
        rows.append(_row(x, k, (rise + fall) / 2, (fall - rise) * width / 4, [(a + b) / 2 for a, b in zip(at_begin, at_end, strict=True)]))
        by_c = [(b - a) / width for a, b in zip(at_begin, at_end, strict=True)]
        rows.append(_row(x, k, (fall - rise) / width, (rise + fall) / 2 - slope, by_c))
    return values, rows


def _row(x: Vector, k: int, by_middle: arb, by_width: arb, by_multipliers: Vector) -> Vector:
    n = (len(x) - len(by_multipliers)) // 2
    row = [arb(0)] * (2 * n)
    row[k], row[n + k] = by_middle, by_width
    return [*row, *by_multipliers, by_width]


def columns(rates: Rates, t: arb) -> tuple[Vector, Vector]:
    """v and v', real and imaginary parts."""
    values = [t**power * (unit * t).exp() for unit, power in rates]
    slopes = [(arb(power) / t + unit) * value for (unit, power), value in zip(rates, values, strict=True)]
    return [part for z in values for part in (z.real, z.imag)], [part for z in slopes for part in (z.real, z.imag)]


def dot(one: Vector, other: Vector) -> arb:
    """The sum of products."""
    return sum((a * b for a, b in zip(one, other, strict=True)), arb(0))


def multipliers(rates: Rates, places: Sequence[arb], integrals: Sequence[arb]) -> Vector:
    """c, of a g that is 0 at the points and level at as many of them as it takes, of length 1. Raises `SolverError`."""
    parts = [[[size * e for e in column] for column in columns(rates, t)] for t, size in zip(places, integrals, strict=True)]
    rows = [at for at, _ in parts] + [slope for _, slope in parts[:-1]][: 2 * len(rates) - 1 - len(places)]
    found = solution([*rows, parts[-1][1]], [arb(0)] * len(rows) + [arb(-1)])
    if not found:
        raise SolverError("what tells dips that are more than zeros was not found")
    length = dot(found, found).sqrt()
    return [(c / length).mid() for c in found]
