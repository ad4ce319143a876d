"""Switching sequences whose impulses follow each other closer than doubles tell: dips of the partial sums that are drawn apart.

Partial sums that lie at 1 but for dips to a lower bound l are impulses 1, l - 1, 1 - l, …. Against the growth e^{ζωt} by which later
impulses count for more, a dip near the end of many half periods is far narrower than the spacing of doubles: its two impulses are one, and
nothing is left of it. But a lower dip that is as much wider does the same. So every edge that doubles do not tell well becomes a step of a
few billionths of the duration at an unknown height; of a narrow dip there are two such steps side by side. As many heights as equations,

    1 + Σ_steps h (e^{p b} - e^{p a}) = 0,   and its derivatives by p,   at every zero p

are solved exactly for the instants that doubles hold, in units that grow as fast as the impulses count. What rounding of the heights leaves
is 1e-16 of each zero's own terms, and the sequence is longer than the exact one by half a step or one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import acb, arb, arb_mat, fmpq

from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Pulse, Shaper

WIDTH = 2.0**-26  # of a step, of the duration: doubles tell it to 1e-8, and its height to 1e-16
TOLD = 2.0**-36  # of the duration: so far apart impulses are told by doubles
NARROW = 4.0  # widths: a dip that is no wider is two steps
BITS, BITS_EACH = 256, 24  # and for each dip

Zeros = Sequence[tuple[Mode, int]]
Dip = tuple[arb, arb]
"""Where it begins and ends [s]; both may be one."""


def too_close(dips: Sequence[Dip], told: float = TOLD) -> bool:
    """Whether doubles do not tell all edges well: `told` of the duration."""
    return bool(min(float(end - begin) for begin, end in dips) < told * float(dips[-1][1]))


def drawn_apart(zeros: Sequence[tuple[Mode, int]], dips: Sequence[Dip], depth: arb | fmpq | int = 1) -> Shaper:
    """The sequence with these zeros and so many derivatives, from dips that leave nothing of them; partial sums in [1 - depth, 1].

    There are as many dips as zeros, each counted as often as it is, or more: then heights differ from their own by as little, relative to
    it, as closes the equations. Raises `SolverError` where heights are none.
    """
    with precision(_bits(zeros, dips)):
        return _solved(zeros, dips, depth, _growth(zeros))


def _bits(zeros: Zeros, dips: Sequence[Dip]) -> int:
    rates = [mode.damping * mode.frequency for mode, _ in zeros]
    return BITS + BITS_EACH * len(dips) + math.ceil(4.0 * (max(rates) - min(rates)) * float(dips[-1][1]) / math.log(2.0))


def _growth(zeros: Zeros) -> float:
    """As fast heights count for more [1/s]."""
    rates = [mode.damping * mode.frequency for mode, _ in zeros]
    return (max(rates) + min(rates)) / 2.0


def _solved(zeros: Zeros, dips: Sequence[Dip], depth: arb | fmpq | int, growth: float) -> Shaper:
    last = float(dips[-1][1])
    drawn = _drawn(dips, depth, last)
    heights = _heights(zeros, drawn, depth, growth, last)
    # Of heights that are doubles: the sums come back to 1.
    exact = {0.0: Fraction(1)}
    for span, height in [*zip(drawn.steps, heights, strict=True), *((span, arb(depth)) for span in drawn.whole)]:
        for instant, sign in zip(span, (-1, 1), strict=True):
            exact[instant] = exact.get(instant, Fraction(0)) + sign * Fraction(float(height))
    jumps = {instant: float(exact[instant]) for instant in sorted(exact)}
    kept = {instant: jump for instant, jump in jumps.items() if jump}
    return Shaper(tuple(kept), tuple(kept.values()))


def pulses_apart(zeros: Zeros, pulses: Sequence[Dip], height: float) -> Shaper:
    """The same of pulses of one `height` [1/s], the first of them from 0 on: where it ends becomes a step, and all others as dips do.

    Their integrals sum to 1. Raises `SolverError` where heights are none.
    """
    (_, first), *later = pulses
    last = float(later[-1][1])
    width = WIDTH * last
    with precision(_bits(zeros, pulses)):
        drawn = _drawn(later, height, last)
        edge = float(first)
        begun = (edge - width / 2.0, edge + width / 2.0)
        drawn = _Drawn([begun, *drawn.steps], [arb(height) / 2, *drawn.own], [(0.0, begun[0]), *drawn.whole])
        heights = _heights(zeros, drawn, height, _growth(zeros), last, pulses=True)
    levels = sorted([*zip(drawn.steps, map(float, heights), strict=True), *((span, height) for span in drawn.whole)])
    return Shaper((), (), (), tuple(Pulse(begin, end - begin, level) for (begin, end), level in levels))


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Steps (begin, end) [s] of unknown heights, with the heights that they would have of themselves, and spans of the whole height."""

    steps: list[tuple[float, float]]
    own: list[arb]
    whole: list[tuple[float, float]]


def _drawn(dips: Sequence[Dip], depth: arb | fmpq | int | float, last: float) -> _Drawn:
    width = WIDTH * last
    steps: list[tuple[float, float]] = []
    own: list[arb] = []
    whole: list[tuple[float, float]] = []
    for begin, end in dips:
        wide = float(end - begin)
        if wide > NARROW * width:
            first, second = float(begin), float(end)
            steps += [(first - width / 2.0, first + width / 2.0), (second - width / 2.0, second + width / 2.0)]
            own += [arb(depth) / 2] * 2
            whole.append((first + width / 2.0, second - width / 2.0))
        else:
            middle, half = float((begin + end) / 2), max(width, wide)
            steps += [(middle - half, middle), (middle, middle + half)]
            own += [arb(depth) * (end - begin) / (2.0 * half)] * 2
    return _Drawn(steps, own, whole)


def _heights(zeros: Zeros, drawn: _Drawn, depth: arb | fmpq | int | float, growth: float, last: float, pulses: bool = False) -> list[arb]:
    """Heights of the steps in (0, depth): dips from 1, or pulses of integral 1."""
    steps = drawn.steps
    units = [growth * arb(end) for _, end in steps]
    rows, right = [], []
    for mode, derivatives in zeros:
        omega, zeta = arb(mode.frequency), arb(mode.damping)
        pole = omega * acb(zeta, (1 - zeta * zeta).sqrt())

        def edges(span: tuple[float, float], power: int, unit: arb, pole: acb = pole) -> acb:
            begin, end = map(arb, span)
            return (end / last) ** power * (pole * end - unit).exp() - (begin / last) ** power * (pole * begin - unit).exp()

        for power in range(derivatives + 1):
            columns = [edges(span, power, unit) for span, unit in zip(steps, units, strict=True)]
            fixed = sum((depth * edges(span, power, arb(0)) for span in drawn.whole), acb(0 if power or pulses else 1))
            rows += [[column.real for column in columns], [column.imag for column in columns]]
            right += [[-fixed.real], [-fixed.imag]]
    if pulses:
        rows.append([(arb(end) - arb(begin)) * (-unit).exp() for (begin, end), unit in zip(steps, units, strict=True)])
        right.append([1 - sum((depth * (arb(end) - arb(begin)) for begin, end in drawn.whole), arb(0))])
    try:
        own = [unit.exp() * height for unit, height in zip(units, drawn.own, strict=True)]
        found = _closing(arb_mat(rows), arb_mat(right), own)
    except ZeroDivisionError:
        raise SolverError("impulses that follow each other so closely were not told apart; fewer zeros are possible") from None
    heights = [found[k, 0].mid() * (-unit).exp() for k, unit in enumerate(units)]
    if min(begin for begin, _ in steps) <= 0.0 or not all(0 < height < depth for height in heights):
        raise SolverError("impulses that follow each other so closely were not told apart; fewer zeros are possible")
    return heights


def _closing(rows: arb_mat, right: arb_mat, own: Sequence[arb]) -> arb_mat:
    if rows.nrows() == rows.ncols():
        return rows.solve(right)
    m, n = rows.nrows(), rows.ncols()
    scaled = arb_mat([[rows[i, k] * own[k] for k in range(n)] for i in range(m)]).mid()
    missed = (right - scaled * arb_mat([[arb(1)] for _ in own])).mid()
    changes = scaled.transpose() * (scaled * scaled.transpose()).mid().solve(missed)
    return arb_mat([[own[k] * (1 + changes[k, 0])] for k in range(n)]).mid()
