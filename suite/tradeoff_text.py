"""A trade-off as cells of text and as a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import ROUND_CEILING, Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from relaxations.bounds import Bound
from reports.files import write_atomically
from suite.plants import nominal_value
from suite.study import Study
from suite.sweeps import stairs
from suite.table_text import BRACKET, bracket_cells
from suite.tradeoffs import Point, Tradeoff, TradeoffError

if TYPE_CHECKING:
    from reports.tradeoff_charts import Sweep

MOST_RANGES = 3  # parameters whose ranges are shown in the table
NAMES = {0: "fastest for the nominal plant", 1: "with a further zero", 2: "with two further zeros"}


def drawable(path: Path) -> None:
    """Raises `TradeoffError` for a picture of another format than SVG."""
    if path.suffix != ".svg":
        raise TradeoffError(f"--plot {path}: the picture is an SVG, so its name ends in .svg")


def headings(study: Study) -> tuple[str, ...]:
    """Of the table: tolerance, width, a parameter's range each, and the bracket."""
    shown = [f"{axis.parameter}{f' [{axis.unit}]' if axis.unit else ''}" for axis in study.uncertainties[:MOST_RANGES]]
    return ("residual ≤", *(("box",) if study.uncertainties else ()), *shown, *BRACKET[1:])


def cells(point: Point) -> tuple[str, ...]:
    """A row of the table."""
    ranges = [f"{low:.6g} to {high:.6g}" for _, low, high in point.ranges[:MOST_RANGES]]
    width = (f"× {float(point.width):.6g}",) if point.ranges else ()
    bracket = ("–", "–", "–", "refused", "–") if point.bound is None else bracket_cells(point.bound)[1:]
    return (percent(point.tolerance), *width, *ranges, *bracket)


def lines(done: Tradeoff) -> Iterator[str]:
    """What stands below the table: the usual commands, reasons, notes."""
    where = "in the study's box" if done.study.uncertainties else "of the nominal plant"
    for command in done.usual:
        left = "" if command.worst is None else f"; it leaves at most {percent(command.worst.tolerance)} {where}: proved"
        yield f"{NAMES[command.robustness]}: {_sides(command.bound)}{left}"
    for point in done.points:
        reason = point.refused or (point.bound.reason if point.bound is not None else None)
        if reason:
            yield f"{percent(point.tolerance)}{f', box × {float(point.width):g}' if point.ranges else ''}: {point.status}: {reason}"
    for note in done.notes:
        yield f"note: {note}"


def percent(value: Fraction) -> str:
    """A fraction of the displacement in per cent, five digits, rounded up."""
    number = Decimal(value.numerator) * 100 / Decimal(value.denominator)
    digits = number.quantize(Decimal(1).scaleb(number.adjusted() - 4), ROUND_CEILING)
    return f"{digits.normalize():f} %"


def draw(done: Tradeoff, path: Path) -> None:
    """The picture to a file."""
    write_atomically(path, picture(done).encode())


def picture(done: Tradeoff) -> str:
    """Minimum time against the tolerance, and against the width of the box, as SVG text that needs no page around it."""
    from reports.charts import Limit, standalone
    from reports.tradeoff_charts import tradeoff

    tolerances = [100.0 * float(point.tolerance) for point in done.tolerances]
    axes = ", ".join(f"{axis.parameter} {axis.lower:g} to {axis.upper:g} {axis.unit}".rstrip() for axis in done.study.uncertainties)
    given = f"{axes}" if len(done.study.uncertainties) in (1, 2) else "the study's ranges" if axes else "the nominal plant"
    sweeps = [_sweep("residual vibration allowed [% of the move]", f"For {given}", done.tolerances, tolerances, done.own, -1)]
    if done.widths:
        label, scale = _width(done.study)
        widths = [scale * float(point.width) for point in done.widths]
        told = f"With a residual of at most {percent(done.tolerance)}"
        sweeps.append(_sweep(label, told, done.widths, widths, next(point for point in done.widths if point.width == 1), 1))
    marked = {
        f"{NAMES[command.robustness]}: {command.bound.upper:.5g} s, leaves ≤ {percent(command.worst.tolerance)}": (
            100.0 * float(command.worst.tolerance),
            command.bound.upper,
        )
        for command in done.usual
        if command.worst is not None and command.bound.upper is not None
    }
    first = done.usual[0].bound.upper
    reference = None if first is None else Limit(first, f"nominal plant alone, exactly at rest: {first:.5g} s")
    title = done.study.title or done.study.file.stem
    return standalone(tradeoff(f"{title}: minimum time, tolerance and box", sweeps, reference=reference, commands=marked))


def _sweep(label: str, title: str, points: tuple[Point, ...], values: list[float], own: Point, asks_more: int) -> Sweep:
    from reports.tradeoff_charts import Sweep

    def sides(point: Point) -> tuple[float, float]:
        if point.bound is None or point.status == "impossible":
            return math.nan, math.nan
        return point.bound.lower, math.nan if point.bound.upper is None else point.bound.upper

    lower, upper = zip(*map(sides, points), strict=True)
    between = [(math.nan if low is None else low, math.nan if high is None else high) for low, high in stairs(points, asks_more)]
    states = [point.status for point in points]
    return Sweep(
        label, title, values, lower, upper, states, between, [point is own for point in points].index(True), logarithmic=asks_more < 0
    )


def _width(study: Study) -> tuple[str, float]:
    """What the width is called, and by what it is multiplied: per cent of the nominal values, where the ranges are that to both sides."""
    shares = set()
    for axis in study.uncertainties:
        nominal = nominal_value(study, axis.parameter)
        shares |= {(abs(Fraction(end) - nominal) / abs(nominal) if nominal else None) for end in (axis.lower, axis.upper)}
    names = ", ".join(axis.parameter for axis in study.uncertainties)
    if len(shares) == 1 and (share := shares.pop()) is not None:
        return f"range of {names} to both sides [± %]", 100.0 * float(share)
    return f"range of {names} [times the study's]", 1.0


def _sides(bound: Bound) -> str:
    lower, upper = (("–", "–") if bound.upper is None else bracket_cells(bound)[1:3]) if bound.lower or bound.upper else ("–", "–")
    return f"[{lower}, {upper}] s: {bound.status.name.lower()}"
