"""Shapers and comparisons on a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from suite.console import coloured, escape, out, short
from suite.shaper_text import shaper_lines

if TYPE_CHECKING:
    from suite.comparison import Comparison
    from suite.shaping import Shaping


def decimals(column: Sequence[float]) -> list[str]:
    """Ten decimals, where they show what there is; else eleven digits."""
    plain = not any(column) or 1e-3 <= max(map(abs, column)) < 1e7
    return [f"{number:.10f}" if plain else f"{number:.11g}" for number in column]


@contextmanager
def searching(title: str) -> Iterator[None]:
    """What is searched for, and for how long, on standard error; nothing where that is no terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), TextColumn("Ctrl-C ends it")
    with Progress(*columns, console=console, transient=True) as bar:
        bar.add_task(escape(title), total=None)
        yield


def show_shaper(done: Shaping) -> None:
    """Impulses, duration with its lower bound, insensitivity, and the proven worst case."""
    console = out()
    shaper = done.shaper
    table = Table(*map(escape, ("from [s]", "for [s]", "height [1/s]") if shaper.pulses else ("instant [s]", "amplitude")))
    for column in table.columns:
        column.justify = "right"
    pulses = [(pulse.start, pulse.width, pulse.height) for pulse in shaper.pulses]
    columns = [decimals(column) for column in zip(*(pulses or zip(shaper.times, shaper.amplitudes, strict=True)), strict=True)]
    for row in zip(*columns, strict=True):
        table.add_row(*row)
    console.print(table)
    for line in shaper_lines(done):
        console.print(escape(line), soft_wrap=True)


def show_comparison(done: Comparison) -> None:
    """One row a command, and where the page lies."""
    console = out()
    table = Table(title=escape(done.record["title"]), title_justify="left", title_style="bold")
    for heading in ("command", "takes [s]", "over the minimum", "worst residual", "failing", "verdict"):
        table.add_column(escape(heading), justify="left" if heading in ("command", "failing", "verdict") else "right")
    for row in done.record["commands"]:
        over = row["over_lower_bound"]
        failing = ", ".join(name for name, found in row["requirements"].items() if found["verdict"] != "pass")
        cells = (short(row["maneuver_time"]), "–" if over is None else f"{over:+.1%}", short(row["worst"].get("residual_vibration")))
        table.add_row(escape(row["name"]), *cells, escape(failing) or "–", coloured(row["verdict"]))
    console.print(table)
    console.print(f"report: {escape(str(done.page))}", soft_wrap=True)
