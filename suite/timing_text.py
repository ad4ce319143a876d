"""What timing errors leave as lines of text and as a picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.table import Table

from reports.files import write_atomically
from reports.formatting import at_least, at_most
from suite.console import escape, out
from suite.timings import Left, Timing, TimingError

POINTS = 13  # of the curves of worst errors
DECADES = 2.0  # that they reach below the largest error
MOST_COLUMNS, MOST_CURVES = 6, 4  # motions in the table of instants, and in the picture
DIGITS = 5  # of what is proven
SMALL = ((1e-1, 1e-3, "ms"), (1e-4, 1e-6, "µs"), (0.0, 1e-9, "ns"))  # moves that last as long: what an error is counted in [s]


def drawable(path: Path) -> None:
    """Raises `TimingError` for a picture of another format than SVG."""
    if path.suffix != ".svg":
        raise TimingError(f"--plot {path}: the picture is an SVG, so its name ends in .svg")


def unit_of(done: Timing, one: Left) -> str:
    """The unit of a motion: the output's, over a power of a second."""
    base = done.study.plant.output_unit or "1"
    return base + {0: "", 1: "/s"}.get(one.motion.unit, f"/s^{one.motion.unit}")


def small(done: Timing) -> tuple[float, str]:
    """A small time [s] for a move of this duration, and what it is called."""
    return next((size, name) for least, size, name in SMALL if done.command.maneuver_time >= least)


def show(done: Timing, plot: Path | None) -> None:
    """Two tables: what is left of each motion, and what each instant does to it."""
    console, asked = out(), done.asked
    (size, each), seen = small(done), done.left[:MOST_COLUMNS]
    console.print(escape(done.study.title or done.study.file.stem))
    shown = Table()
    columns = ["left at T", "unit", "as planned", f"rms for each {each} of jitter"]
    columns += ["delayed"] * bool(asked.on or asked.off)
    columns += ["rms, first order", "95 % below", f"largest of {asked.samples}"] * bool(asked.jitter)
    columns += ["worst, proved"] * bool(asked.within)
    for column in columns:
        words = column in ("left at T", "unit")
        shown.add_column(escape(column), justify="left" if words else "right", no_wrap=words)
    for one in done.left:
        row = [one.motion.name, unit_of(done, one), _rounding(done, one.planned), f"{one.per_second * size:.4g}"]
        row += [_rounding(done, one.delayed)] * bool(asked.on or asked.off)
        if one.rms is not None:
            row += [f"{one.rms:.4g}", *(f"{one.percentiles[name]:.4g}" for name in ("p95", "largest"))]
        if one.worst is not None:
            row += [f"≤ {at_most(one.worst.bound, DIGITS)}"]
        shown.add_row(*map(escape, row))
    console.print(shown)
    shown = Table()
    shown.add_column("instant [s]", justify="right")
    if done.planned != done.happening:
        shown.add_column("happens [s]", justify="right")
    shown.add_column(escape(f"jump [{done.study.plant.input_unit or '1'}]"), justify="right")
    for one in seen:
        shown.add_column(escape(f"{one.motion.name} [{unit_of(done, one)}] for each {each}"), justify="right")
    for i, (planned, late) in enumerate(zip(done.planned, done.happening, strict=True)):
        row = [f"{planned.instant:.10f}"] + [f"{late.instant:.10f}"] * (done.planned != done.happening) + [f"{planned.jump:+.6g}"]
        for one in seen:
            slope = one.slopes[i] * size
            row.append(f"{abs(slope) * one.motion.factor:.4g}" if one.motion.flexible else f"{slope.real + 0.0:+.4g}")
        shown.add_row(*map(escape, row))
    console.print(shown)
    if len(done.left) > len(seen):
        console.print(f"{len(done.left) - len(seen)} more modes: what each instant does to them is in --json")
    for line in lines(done):
        console.print(escape(line), soft_wrap=True)
    if plot is not None:
        console.print(f"written: {escape(str(plot))}", soft_wrap=True)


def lines(done: Timing) -> Iterator[str]:
    """What stands below the tables."""
    if done.together is not None:
        total = at_most(100 * done.together, DIGITS)
        yield f"instants within ± {done.asked.within:g} s: the flexible modes together leave at most {total} % of the move: proved"
    if done.limit is not None and done.allowed is not None:
        name, limit = done.limit
        kept = f"{name} (residual vibration at most {limit:g}) is kept by the modes of the nominal plant"
        if done.allowed > 0.0:
            most = ", the most for which the events are sure to keep their order" if done.ordered(done.allowed) else ""
            yield f"{kept} if no instant errs by more than {at_least(done.allowed, DIGITS)} s{most}: proved"
        else:
            yield f"{kept.replace('is kept', 'is not kept')} even without errors"
    if any(one.motion.unit for one in done.left):
        yield "a rate that is left makes the output drift until something stops it: it is no vibration, and not part of the modes"
    for note in done.notes:
        yield f"note: {note}"


def _rounding(done: Timing, value: float) -> str:
    """A value, or 0 where it is rounding alone."""
    return f"{value:.4g}" if abs(value) > 1e-12 * done.scale else "0"


def draw(done: Timing, path: Path) -> None:
    """The picture to a file."""
    write_atomically(path, picture(done).encode())


def picture(done: Timing) -> str:
    """The command with what each instant does to each mode, and what is left against the size of the errors, as SVG text."""
    from relaxations import timing
    from relaxations.timing_worst import worst
    from reports.charts import Limit, standalone
    from reports.timing_charts import Curve, timing_errors

    command, happening = done.command, done.happening
    places = [one for one in done.left if not one.motion.unit]
    largest = sorted(places, key=lambda one: one.per_second)[-MOST_CURVES:]
    shown = [one for one in places if any(one is other for other in largest)]
    most = min(done.most, command.maneuver_time / 10)
    errors = np.geomspace(most * 10.0**-DECADES, most, POINTS)
    share, (size, each) = 100.0 / done.scale, small(done)
    curves = [
        Curve(
            one.motion.name,
            [share * worst(one.motion, happening, command.end, float(error)).bound for error in errors],
            [share * timing.root_mean_square(one.motion, happening, command.end, float(error)) for error in errors],
            [share * size * abs(slope) * one.motion.factor for slope in one.slopes],
        )
        for one in shown
    ]
    edges = [command.start, *(segment.start for segment in command.segments[1:]), command.end]
    levels = [*(segment.level for segment in command.segments), command.tail.steady]
    plant = done.study.plant
    limit = (
        None if done.limit is None else Limit(100.0 * done.limit[1], f"{done.limit[0]}: {100 * done.limit[1]:g} % of residual vibration")
    )
    return standalone(
        timing_errors(
            f"{done.study.title or done.study.file.stem}: what errors of timing leave",
            curves,
            errors=errors.tolist(),
            instants=[event.instant for event in happening],
            each=each,
            command=(edges, levels, float(plant.initial_input)),
            command_label=f"{plant.input} [{plant.input_unit}]" if plant.input_unit else plant.input,
            limit=limit,
        )
    )
