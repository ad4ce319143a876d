"""A sweep of budgets as cells and lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from suite.fuel_plans import written
from suite.fuel_records import Choice, Curve, FuelSweep, Point
from suite.table_text import bracket_cells

MOST_ROWS = 16  # budgets of a table on a terminal; JSON and pictures have all of them


def headings(done: FuelSweep) -> tuple[str, ...]:
    """Of the table: fuel, and a kind's time, pulses and insensitivity each."""
    found = [f"fuel [{done.unit}]"]
    for curve in done.curves:
        found += [f"{curve.kind.title} [s]", "pulses"]
        found += ["insensitive"] if curve.kind.zeros is not None and done.modes else []
    return tuple(found)


def rows(done: FuelSweep) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Cells of the budgets that a terminal has room for, most fuel first, and whether a budget is a prudent choice, or the study's own."""
    fuels = [point.fuel for point in done.curves[0].points]
    stride = max(len(fuels) // MOST_ROWS, 1)
    own = None if done.study.limits.fuel is None else done.study.limits.fuel
    marked = {choice.fuel for choice in done.choices} | {*done.shown} | {fuel for fuel in fuels if own is not None and fuel == own}
    for i in reversed(range(len(fuels))):
        if fuels[i] in marked or i % stride == 0 or i == len(fuels) - 1:
            cells = [written(fuels[i])]
            for curve in done.curves:
                cells += _cells(curve, curve.points[i], done)
            yield tuple(cells), fuels[i] in marked


def _cells(curve: Curve, point: Point, done: FuelSweep) -> list[str]:
    time = {"impossible": "impossible"}.get(point.status) or ("–" if point.bound.upper is None else f"{point.bound.upper:.6f}")
    cells = [f"{time}{'' if point.status in ('proved', 'impossible') else ' ?'}", "–" if point.pulses is None else _shape(point)]
    if curve.kind.zeros is not None and done.modes:
        cells.append("–" if point.insensitivity is None else f"{100 * point.insensitivity:.3f} %")
    return cells


def _shape(point: Point) -> str:
    pulses = point.pulses
    assert pulses is not None
    return f"{pulses.count}, type {pulses.type}"


def lines(done: FuelSweep) -> Iterator[str]:
    """What stands below the table: the kinds without a budget, prudent choices, what is missing, notes, and how a point becomes a study."""
    for curve in done.curves:
        free = curve.free
        if free.burnt is not None:
            yield (
                f"{curve.kind.title}: with as much fuel as it takes {free.bound.upper:.6f} s and {free.burnt:.6f} {done.unit} "
                f"({free.status}); more is of no use"
            )
    for choice in done.choices:
        yield _choice(done, choice)
    for curve in done.curves:
        yield from _form(done, curve)
    own = next((weight for weight in done.weights if weight.displacement == abs(done.study.maneuver.displacement)), None)
    if own is not None:
        yield (
            f"ZV: by T + α·fuel more fuel than that of node 1 pays only below α_crit = {own.alpha:.6f} s per {done.unit} "
            "(from proven times beside the node)"
        )
    for curve in done.curves:
        yield from _turned(done, curve)
        short = [point for point in curve.points if point.status == "impossible"]
        if short:
            least = "" if curve.least is None else f": every command needs {curve.least:.6g} {done.unit} or more, however long it takes"
            yield f"{curve.kind.title}: {written(short[-1].fuel)} {done.unit} and less is too little, proven{least}"
        for point in curve.points:
            if point.bound.reason:
                yield f"{curve.kind.title}, {written(point.fuel)} {done.unit}: {point.status}: {point.bound.reason}"
    for note in done.notes:
        yield f"note: {note}"
    yield from how_to(done)


def _choice(done: FuelSweep, choice: Choice) -> str:
    point = done.curve(choice.kind).at(choice.fuel)
    assert point is not None
    _, lower, upper, *_ = bracket_cells(point.bound)
    exact = "" if choice.node is None else f" (exactly {choice.node.fuel:.10f} {done.unit}, {choice.node.maneuver_time:.10f} s)"
    return f"{choice.kind.title}, {written(choice.fuel)} {done.unit}: {choice.why}{exact}: [{lower}, {upper}] s: {point.status}"


def _form(done: FuelSweep, curve: Curve) -> Iterator[str]:
    """What the commands cost whose pulses go one way first."""
    efficient, costly = curve.efficient, curve.penalty
    if efficient is None or efficient.burnt is None or efficient.bound.upper is None or costly is None:
        return
    _, lower, upper, *_ = bracket_cells(efficient.bound)
    share, point = costly
    where = "without a budget" if point is efficient else f"at {written(point.fuel)} {done.unit}"
    what = 'fuel-efficient (kind = "fuel-efficient": pulses one way, then the other, as much fuel as it takes)'
    burns = f"{efficient.burnt:.6f} {done.unit}, [{lower}, {upper}] s: {efficient.status}"
    yield f"{curve.kind.title}, {what}: {burns}; holding this form costs at most {100 * share:.3f} %, {where}"


def _turned(done: FuelSweep, curve: Curve) -> Iterator[str]:
    for less, more in curve.turns:
        assert less.pulses is not None
        assert more.pulses is not None
        yield (
            f"{curve.kind.title}: the fastest command is of type {less.pulses.type} up to {written(less.fuel)} {done.unit}, of type "
            f"{more.pulses.type} from {written(more.fuel)} {done.unit} on (type 1: all pulses of one side come first)"
        )


def how_to(done: FuelSweep) -> tuple[str, ...]:
    """How a point becomes a study."""
    best = done.choices[0] if done.choices else None
    fuel = written(best.fuel) if best else written(done.curves[-1].points[-1].fuel)
    zeros = (best.kind.zeros if best else done.curves[-1].kind.zeros) or 0
    rigid = done.modes and any(curve.kind.zeros is None for curve in done.curves)
    return (
        f"to take a point: in the study fuel = {fuel} under [limits], robustness = {zeros} under [command] (ZV: 0, ZVD: 1, ZVDD: 2); "
        "then slewcert bound, or slewcert verify",
        *(["the rigid body's commands are there to compare with: they leave the modes swinging"] if rigid else []),
    )


def choice_records(done: FuelSweep) -> list[dict[str, Any]]:
    """The prudent choices as the page shows them."""
    found = []
    for choice in done.choices:
        point = done.curve(choice.kind).at(choice.fuel)
        assert point is not None
        _, lower, upper, *_ = bracket_cells(point.bound)
        found.append(
            {
                "kind": choice.kind.title,
                "robustness": choice.kind.zeros or 0,
                "fuel": written(choice.fuel),
                "why": choice.why,
                "exact": None if choice.node is None else (choice.node.fuel, choice.node.maneuver_time),
                "lower": lower,
                "upper": upper,
                "status": point.status,
                "insensitivity": point.insensitivity,
                "pulses": None if point.pulses is None else _shape(point),
            }
        )
    return found
