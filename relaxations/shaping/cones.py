"""The shortest sequences that leave nothing of several modes, however much these decay: the least T at which a curve's cone holds a vector.

Positive impulses, of which the first is at 0, and dips of partial sums that begin at 1 are both measures y ≥ 0 on [0, T] with

    ∫ y t^j e^{pt} = b,   j = 0 … n at every zero p = κω,     b = -1, 0, … (impulses),   (-1)^{j+1} j!/p^{j+1} (dips)

as many real equations m as there are numbers in m/2 points, the last of them at T. Their terms differ by as much as the modes decay, so
that programs in doubles do not tell them apart. Here the simplex method, in as many digits as the decay takes, finds on which columns of a
grid b first is a positive sum; these point to the exact places, which Newton's method solves for, together with the multipliers: there may
be more than m/2. That none is shorter is proven elsewhere (relaxations.shaping.touching).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial, perm

from flint import acb, arb, arb_mat

from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import CLOSED, Vector, ordered, solved
from relaxations.shaping.simplex import cheapest
from relaxations.shaping.vanishing import possible

BITS = 192
PER_TURN, CELLS = 24, 64  # columns in a damped period of the fastest mode, and in all at least
MOST_COLUMNS = 3000
LONGER = 1.4  # times as many columns are tried next
MOST_FOLDS = 5000.0  # of decay: more digits than a proof takes
NEWTON, LONGEST = 40, 0.5  # steps of Newton's method, and of its unknowns
REFINED, WIDE = 8, 3  # times as many columns, for so many about each that counts

Zeros = Sequence[tuple[Mode, int]]


@dataclass(frozen=True, slots=True)
class Points:
    """Instants [s], ascending, and sizes of y: of impulses relative to the first one, of dips their integrals [s]."""

    instants: tuple[arb, ...]
    sizes: tuple[arb, ...]


def bits_of(zeros: Zeros) -> int:
    """How many tell all terms apart while a positive shaper of all zeros, one after the other, lasts."""
    whole = sum((count + 1) * mode.half_period for mode, count in zeros)
    rates = [mode.damping * mode.frequency for mode, _ in zeros]
    return (
        BITS
        + 16 * sum(count + 1 for _, count in zeros)
        + math.ceil(4.0 * min((max(rates) - min(rates)) * whole, MOST_FOLDS) / math.log(2.0))
    )


def shortest(zeros: Zeros, dips: bool = False) -> Points:
    """The points of the least T. Raises `SolverError` where they are not found."""
    with precision(bits_of(zeros)):
        cone = _Cone(zeros, dips)
        step = cone.longest / max(CELLS, math.ceil(PER_TURN * cone.longest * cone.fastest / (2.0 * math.pi)))
        high = math.ceil(cone.longest / step)  # what all shapers take, one after the other
        low, columns = 0, [step * k for k in range(MOST_COLUMNS + 1)][0 if dips else 1 :]
        while (found := cone.combined(columns[:high])) is None:
            low, high = high, math.ceil(LONGER * high)
            if high > len(columns):
                raise SolverError(
                    f"no sequence for {len(zeros)} zeros was found on {len(columns)} instants; {possible([mode for mode, _ in zeros])}"
                )
        found, near = _fewest(cone, columns, low, high, found), step
        for _ in range(3):
            exact = cone.exact(_merged(found.weights, near), found.multipliers)
            if exact is not None:
                return exact
            steps = [near * k / REFINED for k in range(-WIDE * REFINED, WIDE * REFINED + 1)]
            first = 0.0 if dips else near / REFINED
            fine = sorted({max(place + step, first) for place, _ in found.weights for step in steps})
            best = cone.combined(fine)
            if best is None:
                break
            found, near = _fewest(cone, fine, 0, len(fine), best), near / REFINED
    raise SolverError(f"a sequence for {len(zeros)} zeros at once was found on a grid only; {possible([mode for mode, _ in zeros])}")


Weights = list[tuple[float, arb]]


@dataclass(frozen=True, slots=True)
class _Sum:
    """Columns' places with their weights, and multipliers: of a function of the curve that is ≥ 0 on all columns but the last."""

    weights: Weights
    multipliers: list[arb]


def _fewest(cone: _Cone, columns: Sequence[float], low: int, high: int, found: _Sum) -> _Sum:
    """On as few columns from the first one on as do: `high` of them do, `low` do not."""
    while high - low > 1:
        middle = (low + high) // 2
        better = cone.combined(columns[:middle])
        if better is None:
            low = middle
        else:
            high, found = middle, better
    return cone.combined(columns[:high], last=True) or found


def _merged(weights: Weights, near: float) -> Weights:
    """Columns that follow each other stand for one point between them."""
    groups: list[Weights] = []
    for place, weight in sorted(weights, key=lambda pair: pair[0]):
        if groups and place - groups[-1][-1][0] <= 1.5 * near:
            groups[-1].append((place, weight))
        else:
            groups.append([(place, weight)])
    sums = [sum((w for _, w in group), arb(0)) for group in groups]
    return [(float(sum((t * w for t, w in group), arb(0)) / total), total) for group, total in zip(groups, sums, strict=True)]


class _Cone:
    """The curve, in units of time of the slowest half period, at the precision that is set."""

    def __init__(self, zeros: Zeros, dips: bool) -> None:
        self.unit = max(mode.half_period for mode, _ in zeros)
        self.longest = 1.05 * sum((count + 1) * mode.half_period for mode, count in zeros) / self.unit
        self.fastest = max(math.pi / mode.half_period for mode, _ in zeros) * self.unit
        self.dips = dips
        self.rows: list[tuple[acb, int]] = []
        self.aim: list[acb] = []
        for mode, count in zeros:
            zeta = arb(mode.damping)
            rate = arb(mode.frequency) * arb(self.unit) * acb(zeta, (1 - zeta * zeta).sqrt())
            self.rows += [(rate, power) for power in range(count + 1)]
            if dips:
                self.aim += [(-1) ** (j + 1) * factorial(j) / rate ** (j + 1) for j in range(count + 1)]
            else:
                self.aim += [acb(0) if j else acb(-1) for j in range(count + 1)]

    def column(self, place: float | arb) -> list[acb]:
        """v(t), complex."""
        t = arb(place)
        return [t**power * (rate * t).exp() for rate, power in self.rows]

    def combined(self, places: Sequence[float], last: bool = False) -> _Sum | None:
        """Weights of a positive sum of these columns that is b, none but those of a basis; None if there is none.

        `last`: with the least weight on the last column, so that the others are near the places where the shortest has its points.
        """
        columns = [_parts(self.column(place)) for place in places]
        sizes = [max(map(abs, column)) for column in columns]
        sides = [-1 if number < 0 else 1 for number in _parts(self.aim)]
        signed = [
            [side * entry / size for side, entry in zip(sides, column, strict=True)] for column, size in zip(columns, sizes, strict=True)
        ]
        table = arb_mat(signed).transpose().mid()
        aim = arb_mat([[abs(number)] for number in _parts(self.aim)]).mid()
        found = cheapest(table, aim, [0] * (len(places) - 1) + [int(last)])
        if found is None:
            return None
        weights = [(places[k], weight / sizes[k]) for k, weight in found.weights]
        return _Sum(weights, [-side * price for side, price in zip(sides, found.multipliers, strict=True)])

    def exact(self, near: Weights, multipliers: Sequence[arb]) -> Points | None:
        """Newton's method from there; None if it does not lead to as many points.

        Unknown are places t_k, logarithms of weights and multipliers c, of which the function f = c · v touches 0 at the points and
        vanishes at the last: at most m/2 points are told by b alone, of more the places that make T least are told by f.
        """
        n, m = len(near), 2 * len(self.rows)
        if n < len(self.rows):
            return None
        start = [weight.log() for _, weight in near]
        terms = [[abs(weight * entry) for entry in self.column(place)] for place, weight in near]
        scales = [(sum((term[i] for term in terms), arb(0)) + abs(self.aim[i])).mid() for i in range(m // 2)]
        begun = [c * scales[i // 2] for i, c in enumerate(multipliers)]
        largest = max(abs(c) for c in begun)
        begun = [(c / largest).mid() for c in begun]
        length = sum((c * c for c in begun), arb(0)).mid()

        def system(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
            places, weights, c = x[:n], [size.exp() for size in x[n : 2 * n]], x[2 * n :]
            courses = [self._course(t, scales) for t in places]
            values: Vector = []
            rows: list[Vector] = []
            for i in range(m):
                parts = [weight * course[0][i] for weight, course in zip(weights, courses, strict=True)]
                moved = [weight * course[1][i] for weight, course in zip(weights, courses, strict=True)]
                aim = self.aim[i // 2] / scales[i // 2]
                values.append(sum(parts, arb(0)) - (aim.imag if i % 2 else aim.real))
                rows.append([*moved, *parts, *[arb(0)] * (m + 1)])
            for order in (0, 1):  # of f, at all points, and of f', at all but the last
                for k, course in enumerate(courses[: n - order]):
                    unit = start[k].exp().mid()
                    at, slope = (unit * sum((a * b for a, b in zip(c, course[order + j], strict=True)), arb(0)) for j in (0, 1))
                    values.append(at)
                    row = [arb(0)] * (2 * n + m + 1)
                    row[k] = slope
                    row[2 * n : 2 * n + m] = [unit * entry for entry in course[order]]
                    rows.append(row)
            values.append(sum((a * b for a, b in zip(c, begun, strict=True)), arb(0)) - length)
            rows.append([*[arb(0)] * (2 * n), *begun, arb(0)])
            return values, rows

        found = solved(system, [*(arb(t) for t, _ in near), *start, *begun, arb(0)], None, CLOSED, NEWTON, LONGEST)
        if found is None or not ordered(found[:n][::-1]):
            return None
        unit = arb(self.unit)
        return Points(tuple(t * unit for t in found[:n]), tuple(size.exp() * (unit if self.dips else 1) for size in found[n : 2 * n]))

    def _course(self, t: arb, scales: Sequence[arb]) -> list[list[arb]]:
        """v(t), v'(t) and v''(t), (re, im) of each row, divided by `scales`."""
        orders: list[list[arb]] = [[], [], []]
        for (rate, power), scale in zip(self.rows, scales, strict=True):
            motion = (rate * t).exp() / scale
            for order, found in enumerate(orders):
                whole = sum((comb(order, k) * perm(power, k) * t ** (power - k) * rate ** (order - k)
                             for k in range(min(order, power) + 1)), acb(0)) * motion  # fmt: skip
                found += [whole.real, whole.imag]
        return orders


def _parts(numbers: Sequence[acb]) -> list[arb]:
    return [part for number in numbers for part in (number.real.mid(), number.imag.mid())]
