"""Pulses of one height where modes all but decay while they last: from the impulses of the shortest, at any damping.

Against the growth e^{ζωt} by which later pulses count for more, all but the first ones are far narrower than the spacing of doubles. Pulses
of a height a, the first of them from 0 on, that leave nothing are

    Σ_k (e^{p e_k} - e^{p b_k}) = 0,   and its derivatives by p, at every zero p = κω,     a Σ_k (e_k - b_k) = 1

as many equations as there are edges but the first. At 1/a = 0 they are impulses, which are known at any damping (in closed form, or from
relaxations.shaping.cones); with 1/a they become wider, along a curve that is followed in as many digits as the decay takes
(relaxations.shaping.paths). None is shorter: let `f = Re Σ y_ij* z_ij` be 1 at all edges but the first and the last. Where
`a ∫ max(1 - f, 0) < 1` over a duration, none is as short (relaxations.checking.durations). More pulses than zeros need are told by f, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

from flint import acb, arb

from relaxations.checking.durations import none_of_pulses
from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.amplitudes import LEAST, named, smallest_of_derivatives, too_small
from relaxations.shaping.at_once import require_doubles
from relaxations.shaping.cones import Zeros, bits_of, shortest
from relaxations.shaping.depths import Rates, columns, dot, multipliers
from relaxations.shaping.dips import WIDTH, pulses_apart, too_close
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import Vector, followed
from relaxations.shaping.shapers import Pulse, Shaper
from relaxations.shaping.touching import conditions_of, row, solution

NARROW = 2.0**-10  # of a duration: from pulses so narrow impulses are not far
BITS = 192
SHORTER = (4e-16, 1e-13, 1e-11, 1e-9, 1e-7, 1e-5)  # relative: how much shorter is tried
FOLDS = 2.0  # times the decay is told, in digits


@dataclass(frozen=True, slots=True)
class PulseShaper:
    """A shaper, the least duration [s] of such pulses, *proven* (None: nothing was); on given intervals, how many of them are needed."""

    shaper: Shaper
    lower: float | None
    intervals: int = 0


def narrow_pulses(modes: Sequence[Mode], height: float, derivatives: int) -> PulseShaper:
    """The shortest pulses of one `height` [1/s] with so many derivatives at every mode. Raises `SolverError`."""
    zeros = [(mode, derivatives) for mode in modes]
    if len(zeros) == 1 and smallest_of_derivatives(modes[0].damping, derivatives) < LEAST:
        what = f"pulses-{named(derivatives)}"
        raise SolverError(too_small(what, modes[0].damping, lambda damping: smallest_of_derivatives(damping, derivatives)))
    require_doubles(zeros)
    whole = sum((derivatives + 1) * mode.half_period for mode in modes)  # the last pulses' widths are told from nothing
    folds = max(mode.damping * mode.frequency for mode in modes) * whole
    with precision(bits_of(zeros) + math.ceil(FOLDS * folds / math.log(2.0))):
        edges = _edges(zeros, *_impulses(zeros), 1 / arb(height))
        pulses = list(zip(edges[::2], edges[1::2], strict=True))
        if too_close(pulses, WIDTH):
            shaper = pulses_apart(zeros, pulses, height)
        else:
            instants = [(float(begin), float(end)) for begin, end in pulses]
            area = math.fsum(end - begin for begin, end in instants)
            shaper = Shaper((), (), (), tuple(Pulse(begin, end - begin, 1.0 / area) for begin, end in instants))
        return PulseShaper(shaper, _least(zeros, edges, height))


def _impulses(zeros: Zeros) -> tuple[Vector, Vector]:
    """Instants [s] from 0 on, and sizes of sum 1."""
    if len(zeros) == 1:
        ((mode, n),) = zeros
        zeta = arb(mode.damping)
        root = (1 - zeta * zeta).sqrt()
        decay = (-zeta * arb.pi() / root).exp()
        sizes = [math.comb(n + 1, k) * decay**k for k in range(n + 2)]
        instants = [k * arb.pi() / (arb(mode.frequency) * root) for k in range(n + 2)]
    else:
        points = shortest(zeros)
        sizes, instants = [arb(1), *points.sizes], [arb(0), *points.instants]
    whole = sum(sizes, arb(0))
    return instants, [size / whole for size in sizes]


def _edges(zeros: Zeros, instants: Vector, sizes: Vector, last: arb) -> Vector:
    """Where pulses of height 1/`last` begin and end [s], from the impulses on. Raises `SolverError`."""
    rates = []
    for mode, count in zeros:
        zeta = arb(mode.damping)
        rate = arb(mode.frequency) * acb(zeta, (1 - zeta * zeta).sqrt())
        rates += [(rate * instants[-1], power) for power in range(count + 1)]
    n, end = len(sizes), instants[-1]
    places = [instant / end for instant in instants]
    begun = [] if n == len(rates) + 1 else multipliers(rates, places[1:], sizes[1:])  # more pulses than zeros are told by f besides

    def edges_of(x: Vector, w: arb) -> Vector:
        widths = [(size + w).exp() for size in x[:n]]
        found = [arb(0), widths[0]]
        for middle, width in zip(x[n : 2 * n - 1], widths[1:], strict=True):
            found += [middle - width / 2, middle + width / 2]
        return found

    def system(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """x: logarithms of the pulses' integrals, middles of all but the first, multipliers and level; w: log 1/a. In units of the end."""
        edges = edges_of(x, w)
        values: Vector = []
        rows: list[Vector] = []
        for unit, power in rates:
            at = [edge**power * (unit * edge).exp() for edge in edges]
            slopes = [(power * edge ** max(power - 1, 0) + unit * edge**power) * (unit * edge).exp() for edge in edges]
            value, by_x, by_w = acb(0), [acb(0)] * (2 * n - 1), acb(0)
            for k in range(n):
                before, after = 2 * k, 2 * k + 1
                value += at[after] - at[before]
                width = edges[after] - edges[before]
                by_x[k] = width * (slopes[after] if k == 0 else (slopes[after] + slopes[before]) / 2)
                by_w += by_x[k]
                if k:
                    by_x[n + k - 1] = slopes[after] - slopes[before]
            largest = max((float(abs(entry).log()) for entry in by_x if abs(entry) > 0), default=0.0)
            scale = arb(-largest).exp()
            values += [scale * value.real, scale * value.imag]
            rows += [[scale * d.real for d in (*by_x, by_w)], [scale * d.imag for d in (*by_x, by_w)]]
        parts = [size.exp() for size in x[:n]]
        values.append(sum(parts, arb(-1)))
        rows.append([*parts, *[arb(0)] * n])
        if not begun:
            return values, rows
        rows = [[*row[:-1], *[arb(0)] * (len(begun) + 1), row[-1]] for row in rows]
        more, further = _touching(rates, x, edges, sizes)
        values += [*more, dot(x[2 * n - 1 : -1], begun) - dot(begun, begun)]
        return values, [*rows, *further, [*[arb(0)] * (2 * n - 1), *begun, arb(0), arb(0)]]

    def apart(x: Vector) -> bool:
        return all(before < after for before, after in pairwise(x[n : 2 * n - 1]))

    goal = (last / end).log()
    begin = min(arb(NARROW).log(), goal - 1)
    first = sizes[0] * begin.exp()
    start = [*(size.log() for size in sizes), *(place + first / 2 for place in places[1:]), *begun]
    if begun:
        start.append(dot(begun, columns(rates, first)[0]))
    path = followed(system, start, begin, goal, apart)
    if path is None or not path.goal:
        raise SolverError(_joined(1 / last))
    edges = edges_of(path.x, path.w)
    if not all(before < after for before, after in pairwise(edges)):
        raise SolverError(_joined(1 / last))
    return [(edge * end).mid() for edge in edges]


def _joined(height: arb) -> str:
    return (
        f"pulses of {float(height):.6g} 1/s were not followed from impulses (low ones join): higher ones, fewer modes at once and "
        "impulses (zv, with --pulse as pulses of one width) are possible"
    )


def _touching(rates: Rates, x: Vector, edges: Vector, sizes: Vector) -> tuple[Vector, list[Vector]]:
    """That f is the level at all edges but the first and the last; of a pulse between half the sum and the slope, times its integral."""
    n = len(sizes)
    c, level = x[2 * n - 1 : -1], x[-1]
    values: Vector = []
    rows: list[Vector] = []
    for k, size in enumerate(sizes):
        begin, end = edges[2 * k], edges[2 * k + 1]
        width = end - begin
        if k in (0, n - 1):
            at, slope = ([size * e for e in column] for column in columns(rates, end if k == 0 else begin))
            rise = dot(c, slope)
            by_middle, by_width = (None, rise * width) if k == 0 else (rise, -rise * width / 2)
            values.append(dot(c, at) - size * level)
            rows.append(_row(n, k, by_middle, by_width, at, -size))
            continue
        (at_begin, slope_begin), (at_end, slope_end) = ([[size * e for e in column] for column in columns(rates, t)] for t in (begin, end))
        one, other, rise, fall = (dot(c, column) for column in (at_begin, at_end, slope_begin, slope_end))
        slope_between = (other - one) / width
        values += [(one + other) / 2 - size * level, slope_between]
        mean = [(a + b) / 2 for a, b in zip(at_begin, at_end, strict=True)]
        by_c = [(b - a) / width for a, b in zip(at_begin, at_end, strict=True)]
        rows.append(_row(n, k, (rise + fall) / 2, (fall - rise) * width / 4, mean, -size))
        rows.append(_row(n, k, (fall - rise) / width, (rise + fall) / 2 - slope_between, by_c, arb(0)))
    return values, rows


def _row(n: int, k: int, by_middle: arb | None, by_width: arb, by_multipliers: Vector, by_level: arb) -> Vector:
    found = [arb(0)] * (2 * n - 1)
    found[k] = by_width
    if by_middle is not None:
        found[n + k - 1] = by_middle
    return [*found, *by_multipliers, by_level, by_width]


def _least(zeros: Zeros, edges: Vector, height: float) -> float | None:
    """The least duration [s], *proven*."""
    terms = [(mode, power) for mode, count in zeros for power in range(count + 1)]
    end = edges[-1]
    told = [edges[1], *edges[2:-1:2], *edges[3:-1:2]][: 2 * len(terms)]
    found = solution([row(terms, edge - end, 0) for edge in told], [arb(1)] * len(told))
    if not found:
        return None
    fastest = max(mode.damping * mode.frequency for mode, _ in zeros)
    bits = BITS + math.ceil(FOLDS * fastest * float(end - edges[1]) / math.log(2.0))
    for less in SHORTER:
        claimed = float(end) * (1.0 - less)
        if none_of_pulses(Fraction(claimed), conditions_of(terms, found), Fraction(height), Fraction(1), bits):
            return claimed
    return None
