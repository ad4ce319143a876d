"""A sweep of budgets as pictures, and as a page that holds them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from relaxations.shaping.sensitivity import residual
from reports.charts import Limit, standalone
from reports.files import json_bytes, write_atomically
from reports.fuel_charts import Lines, Marks, Profiles, Sensitivity, SlewTimes, Times, chart
from reports.pages import render_fuel
from suite.fuel_plans import FuelError
from suite.fuel_records import Curve, FuelSweep, Point
from suite.fuel_sweeps import AROUND
from suite.fuel_text import choice_records, how_to
from suite.quantities import step_impulses
from suite.sweeps import stairs

PAGE, RECORD = "fuel.html", "fuel.json"
FACTORS = np.linspace(0.85, 1.15, 601)  # of the modelled frequency
TALLEST = 8.0  # times the level of insensitivity: of what is more nobody asks how much it is
MOST_SHOWN = 4  # curves of sensitivity in one picture


def drawable(plot: Path | None) -> None:
    """Raises `FuelError` for a picture of another format than SVG."""
    if plot is not None and plot.suffix != ".svg":
        raise FuelError(f"--plot {plot}: the picture is an SVG, so its name ends in .svg")


def draw(done: FuelSweep, path: Path) -> None:
    """The overview to a file: time, insensitivity, and the switches of the first two kinds that leave modes at rest."""
    panels = [_times(done), *([_narrow(done)] if done.modes else []), *(_profiles(done, curve) for curve in _flexible(done)[:2])]
    name = f"{done.study.title or done.study.file.stem}: what fuel buys"
    write_atomically(path, standalone(chart(name, panels, 2 if len(panels) > 1 else 1)).encode())


def write(done: FuelSweep, folder: Path) -> list[Path]:
    """Every picture, the page that shows them, and the record of `--json`, into a folder; the files, the page first."""
    drawn = pictures(done)
    files = [folder / PAGE, folder / RECORD, *(folder / f"{stem}.svg" for stem, _, _ in drawn)]
    record = done.to_dict()
    write_atomically(files[1], json_bytes(record))
    for file, (_, _, svg) in zip(files[2:], drawn, strict=True):
        write_atomically(file, standalone(svg).encode())
    text = render_fuel(
        title=done.study.title or done.study.file.stem,
        record=record,
        choices=choice_records(done),
        how_to=how_to(done),
        charts={caption: svg for _, caption, svg in drawn},
    )
    write_atomically(files[0], text.encode())
    return files


def pictures(done: FuelSweep) -> list[tuple[str, str, str]]:
    """Name of the file, caption, and SVG text of each."""
    told: list[tuple[str, str, Callable[[str], str]]] = [
        ("slew-time", "Slew time against fuel", lambda name: chart(name, [_times(done)])),
    ]
    if any(curve.efficient is not None for curve in done.curves):
        told.append(("form", "What pulses one way, then the other, cost", lambda name: chart(name, [_form(done)])))
    for curve in done.curves:
        caption = f"Switches against fuel, {curve.kind.title}"
        told.append((f"switches-{curve.kind.name}", caption, lambda name, curve=curve: chart(name, [_profiles(done, curve)])))
    if done.modes:
        level = f"{100 * done.settings.level:g} % insensitivity against fuel"
        told.append(("insensitivity", level, lambda name: chart(name, [_narrow(done)])))
        if _shown(done):
            told.append(("sensitivity", "Residual vibration against the true frequency", lambda name: chart(name, [_sensitivity(done)])))
        higher = f"Excitation of a mode that nobody modelled, {_far(done)}"
        told.append(("higher-mode", higher, lambda name: chart(name, [_higher(done)])))
    if len(done.weights) > 1:
        caption = "Weight of fuel at which the first node is the better choice than more fuel"
        told.append(("alpha", caption, lambda name: chart(name, [_weights(done)])))
    return [(stem, caption, make(caption)) for stem, caption, make in told]


def _form(done: FuelSweep) -> Lines:
    """What is lost by the form that is held, where that is known."""
    curves = []
    for look, curve in enumerate(done.curves):
        held, efficient = {point.fuel: point.bound.upper for point in curve.held}, curve.efficient
        known = []
        for point in curve.points:
            one_way = point.pulses is not None and point.pulses.type == 1
            slack = efficient is not None and efficient.burnt is not None and float(point.fuel) >= efficient.burnt
            time = point.bound.upper if one_way else held.get(point.fuel, efficient.bound.upper if efficient and slack else None)
            if time is not None and point.bound.upper is not None:
                known.append((float(point.fuel), max(100.0 * (time / point.bound.upper - 1.0), 0.0)))
        if efficient is not None and known:
            curves.append((curve.kind.title, [x for x, _ in known], [share for _, share in known], look))
    return Lines(curves, _fuel(done), "slower than the fastest [%]", _marks(done), "Pulses one way, then the other")


def _fuel(done: FuelSweep) -> str:
    return f"fuel [{done.unit}]"


def _marks(done: FuelSweep) -> Marks:
    own = done.study.limits.fuel
    return Marks({choice.node.number: choice.node.fuel for choice in done.choices if choice.node}, None if own is None else float(own))


def _flexible(done: FuelSweep) -> list[Curve]:
    return [curve for curve in done.curves if curve.kind.zeros is not None] or list(done.curves)


def _times(done: FuelSweep) -> SlewTimes:
    curves = []
    for look, curve in enumerate(done.curves):
        lower, upper = zip(*map(_both, curve.points), strict=True)
        below = [math.nan if low is None else low for low, _ in stairs(curve.points, -1)]
        states = [point.status for point in curve.points]
        curves.append(Times(curve.kind.title, _fuels(curve), lower, upper, states, below, look))
    held = [found for look, curve in enumerate(done.curves) if (found := _held(curve, look)) is not None]
    return SlewTimes(curves, _fuel(done), _marks(done), "Slew time", held)


def _held(curve: Curve, look: int) -> tuple[str, list[float], list[float], int] | None:
    """What the form costs, where it costs anything: its points, and from what it burns at most on the time that it takes then."""
    efficient, most = curve.efficient, float(curve.points[-1].fuel)
    if efficient is None or efficient.burnt is None or efficient.bound.upper is None:
        return None
    points = [(float(point.fuel), point.bound.upper) for point in curve.held if point.bound.upper is not None]
    points += [(x, efficient.bound.upper) for x in (efficient.burnt, most) if x <= most]
    label = f"{curve.kind.title}, pulses one way, then the other"
    return (label, [x for x, _ in points], [t for _, t in points], look) if len(points) > 1 else None


def _both(point: Point) -> tuple[float, float]:
    if point.status == "impossible":
        return math.nan, math.nan
    return point.bound.lower, math.nan if point.bound.upper is None else point.bound.upper


def _fuels(curve: Curve) -> list[float]:
    return [float(point.fuel) for point in curve.points]


def _profiles(done: FuelSweep, curve: Curve) -> Profiles:
    limits, unit, rest = done.study.limits, done.study.plant.input_unit, float(done.study.plant.initial_input)
    names = tuple(f"{float(level) - rest:+g} {unit}".strip().replace("-", "\u2212") for level in (limits.upper, limits.lower))
    rows = [None if point.pulses is None else (point.pulses.times, point.pulses.sides) for point in curve.points]
    return Profiles(_fuels(curve), rows, (names[0], names[1]), _fuel(done), _marks(done), f"Switches, {curve.kind.title}")


def _narrow(done: FuelSweep) -> Lines:
    label = f"{100 * done.settings.level:g} % insensitivity [% of the frequency]"
    return _measured(done, label, "Insensitivity", lambda point: None if point.insensitivity is None else 100.0 * point.insensitivity)


def _higher(done: FuelSweep) -> Lines:
    label = "largest residual [steps of the input]"
    return _measured(done, label, f"An unmodelled mode, {_far(done)}", lambda point: point.higher_mode, every=True)


def _weights(done: FuelSweep) -> Lines:
    x, alphas = [float(weight.displacement) for weight in done.weights], [weight.alpha for weight in done.weights]
    unit = f" [{done.study.plant.output_unit}]" if done.study.plant.output_unit else ""
    marks = Marks({}, abs(float(done.study.maneuver.displacement)))
    label, title = f"critical α [s per {done.unit}]", "Below the critical α more fuel than that of node 1 pays"
    return Lines([("ZV", x, alphas, 1)], f"displacement{unit}", label, marks, title, logarithmic=True)


def _far(done: FuelSweep) -> str:
    low, high = (factor * done.settings.higher for factor in (AROUND[0], AROUND[-1]))
    return f"{low:.3g} to {high:.3g} times the highest frequency"


def _measured(done: FuelSweep, label: str, title: str, of: Callable[[Point], float | None], *, every: bool = False) -> Lines:
    """What is measured of the commands of kinds that leave the modes at rest, or of `every` kind."""
    curves = []
    for look, curve in enumerate(done.curves):
        if every or curve.kind.zeros is not None:
            values = [math.nan if (value := of(point)) is None else value for point in curve.points]
            curves.append((curve.kind.title, _fuels(curve), values, look))
    return Lines(curves, _fuel(done), label, _marks(done), title)


def _shown(done: FuelSweep) -> list[tuple[Curve, Point]]:
    """The commands whose sensitivity is drawn."""
    pairs = [(curve, fuel) for fuel in done.shown for curve in done.curves if curve.kind.zeros is not None]
    return [(curve, point) for curve, fuel in pairs if (point := curve.at(fuel)) is not None and point.pulses is not None][:MOST_SHOWN]


def _sensitivity(done: FuelSweep) -> Sensitivity:
    curves, looks = [], {curve.kind: look for look, curve in enumerate(done.curves)}
    for curve, point in _shown(done):
        command, rest = point.bound.command, curve.posed.rest
        assert command is not None
        impulses = step_impulses(command, rest, max(abs(segment.level - rest) for segment in command.segments))
        assert impulses is not None
        worst = np.max([residual(*impulses, FACTORS * frequency, damping) for frequency, damping in done.modes], axis=0)
        width = "" if point.insensitivity is None else f": insensitivity {100 * point.insensitivity:.3g} %"
        low = np.where(worst <= TALLEST * done.settings.level, 100.0 * worst, np.nan)
        curves.append((f"{curve.kind.title}, {float(point.fuel):.6g} {done.unit}{width}", low.tolist(), looks[curve.kind]))
    level = Limit(100.0 * done.settings.level, f"{100 * done.settings.level:g} %")
    return Sensitivity(FACTORS.tolist(), curves, "residual vibration [% of a step]", level)
