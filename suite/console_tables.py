"""Tables of displacements, trade-offs and budgets of fuel on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from suite import fuel_text, tradeoff_text
from suite.console import command_table, escape, out
from suite.fuel_costs import FuelCost
from suite.fuel_records import FuelSweep
from suite.fuel_times import FuelAtTime
from suite.table_text import table_cells
from suite.tables import Table as DisplacementTable
from suite.tradeoffs import Tradeoff


def show_table(done: DisplacementTable, exports: Sequence[Path]) -> None:
    """One row a displacement, and what was written."""
    console, shown = out(), Table()
    headings, rows = table_cells(done)
    for heading in headings:
        shown.add_column(escape(heading), justify="left" if heading == "status" else "right")
    for row in rows:
        shown.add_row(*map(escape, row))
    console.print(shown)
    console.print(f"{len(rows)} displacements, {done.proven} proven on both sides, {done.seconds:.1f} s")
    for path in exports:
        console.print(f"written: {escape(str(path))}", soft_wrap=True)


def show_tradeoff(done: Tradeoff, plot: Path | None) -> None:
    """One row a point, tolerances first, then widths; the usual commands beside them."""
    console, shown = out(), Table()
    for heading in tradeoff_text.headings(done.study):
        shown.add_column(escape(heading), justify="left" if heading == "status" else "right")
    for sweep in (done.tolerances, done.widths):
        for point in sweep:
            style = "bold" if point.tolerance == done.tolerance and point.width == 1 else None
            shown.add_row(*map(escape, tradeoff_text.cells(point)), style=style)
        shown.add_section()
    console.print(shown)
    for line in tradeoff_text.lines(done):
        console.print(escape(line), soft_wrap=True)
    proven = sum(point.status in ("proved", "impossible") for point in done.points)
    console.print(f"{len(done.points)} points, {proven} proven, {done.seconds:.1f} s")
    if plot is not None:
        console.print(f"written: {escape(str(plot))}", soft_wrap=True)


def show_fuel(done: FuelSweep, files: Sequence[Path]) -> None:
    """One row a budget, as many as fit; the prudent choices, what is missing, and what was written."""
    console, shown = out(), Table()
    for heading in fuel_text.headings(done):
        shown.add_column(escape(heading), justify="right")
    for cells, marked in fuel_text.rows(done):
        shown.add_row(*map(escape, cells), style="bold" if marked else None)
    console.print(shown)
    for line in fuel_text.lines(done):
        console.print(escape(line), soft_wrap=True)
    points = [point for curve in done.curves for point in (*curve.points, *curve.held)]
    proven = sum(point.status in ("proved", "impossible") for point in points)
    console.print(f"{len(done.curves[0].points)} budgets, {len(points)} minimum times, {proven} proven, {done.seconds:.1f} s")
    for file in files:
        console.print(f"written: {escape(str(file))}", soft_wrap=True)


def show_fuel_at_time(done: FuelAtTime) -> None:
    """The bracket of the least fuel and its command."""
    console = out()
    for line in done.lines():
        console.print(escape(line), soft_wrap=True)
    if done.found is not None and done.found.command is not None:
        console.print(command_table(done.found.command, done.study.plant.input_unit))


def show_fuel_cost(done: FuelCost) -> None:
    """The bracket of the least cost, its dead-zone check, and its command."""
    console = out()
    for line in done.lines():
        console.print(escape(line), soft_wrap=True)
    console.print(command_table(done.found.command, done.study.plant.input_unit))
