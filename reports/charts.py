"""Charts as SVG text for the page: no fonts, no scripts, no clock. The only module that imports matplotlib.

Colours are CSS variables of the page with a fallback each, so that one chart suits a light screen, a dark one and paper. Equal data
gives equal text. Labels are taken literally: a `$` in a study's name is no formula.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reports.errors import RecordError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Stand-ins for the page's colours: matplotlib wants numbers, the page wants variables.
INK, FAINT, LINE, SECOND, LIMIT, BAD, UNSURE = "#010101", "#020202", "#030303", "#040404", "#050505", "#060606", "#070707"
FOURTH = "#080808"
_COLOURS = {
    INK: "var(--chart-ink, #3d444d)",
    FAINT: "var(--chart-faint, #d5d9de)",
    LINE: "var(--chart-line, #1f5fa8)",
    SECOND: "var(--chart-second, #b3541e)",
    LIMIT: "var(--chart-limit, #8a6d00)",
    BAD: "var(--chart-bad, #b3261e)",
    UNSURE: "var(--chart-unsure, #9a6700)",
    FOURTH: "var(--chart-fourth, #7b2d8b)",
}
_FONT = "var(--chart-font, system-ui, sans-serif)"
_STYLE: dict[Any, Any] = {  # keys are a literal type that only newer versions of matplotlib name
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9,
    "axes.unicode_minus": True,
    "figure.facecolor": "none",
    "font.family": ["DejaVu Sans"],  # comes with matplotlib: the same metrics everywhere
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "lines.linewidth": 1.5,
    "path.simplify": True,
    "svg.fonttype": "none",  # text stays text: searchable, and in the page's font
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.color": INK,
    "ytick.labelsize": 8.5,
}
_WIDTH = 7.6  # inches; the page scales it

Float64 = NDArray[np.float64]
Fill = Callable[["Figure", list["Axes"]], object]


@dataclass(frozen=True, slots=True)
class Limit:
    """A horizontal line at `value`, named in the legend."""

    value: float
    label: str


def command_and_response(
    name: str,
    times: ArrayLike,
    command: ArrayLike,
    output: ArrayLike,
    *,
    start: float,
    end: float,
    target: float,
    displacement: float,
    command_label: str,
    output_label: str,
    input_limits: tuple[float, float] | None = None,
    linear: ArrayLike | None = None,
    tolerance: float | None = None,
) -> str:
    """A run in three panels: the command during the move, the output during the move, and how far the output is from its target afterwards.

    `times` (n,) [s]; `command` (n,) is the input applied from each instant on, `output` (n,), `linear` (n,) the linear plant's output;
    the move lasts from `start` to `end` [s]; `target` = y_0 + Δ and `displacement` = |Δ| > 0 in the output's unit; `tolerance` a
    fraction of |Δ|. `name` describes the run to people who cannot see the chart, and must differ between the charts of one page.
    """
    t, u, y = _arrays(times=times, command=command, output=output)
    reference = None if linear is None else _arrays(times=times, linear=linear)[1]
    if not displacement > 0.0:
        raise RecordError(f"displacement must be positive, is {displacement!r}")
    with _figure(name, (_WIDTH, 6.4)) as figure:
        above, middle, below = figure.subplots(3, 1, height_ratios=(2, 3, 2))
        middle.sharex(above)
        moving = t <= end + 0.35 * max(end - start, 1e-12)
        above.step(t[moving], u[moving], where="post", color=LINE)
        if input_limits is not None:
            for level in input_limits:
                above.axhline(level, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=1)
        above.set_ylabel(command_label)
        above.tick_params(labelbottom=False)
        middle.axhline(target, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)), label="target")
        middle.plot(t[moving], y[moving], color=LINE, label="FMU")
        if reference is not None:
            middle.plot(t[moving], reference[moving], color=SECOND, linestyle=(0, (1, 2.5)), linewidth=2.0, label="linear plant")
        middle.set_ylabel(output_label)
        middle.legend(loc="best")
        for axes in (above, middle):
            axes.axvline(end, color=INK, linewidth=0.8, linestyle=":")
        after = t >= end
        deviation = 100.0 * (y[after] - target) / displacement
        below.plot(t[after], deviation, color=LINE, linewidth=0.9)
        if tolerance is not None:
            for level in (-100.0 * tolerance, 100.0 * tolerance):
                below.axhline(level, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)))
        below.set(xlabel="time [s]", ylabel="from target [% of move]")
        below.set_title("After the move", loc="left")
        above.set_title("During the move (dotted: its end)", loc="left")
        above.margins(x=0.01)
        below.margins(x=0.01)
        _tidy_offsets(middle, below)
        return _svg(figure, name)


def sweep(
    name: str,
    values: ArrayLike,
    results: ArrayLike,
    *,
    parameter_label: str,
    quantity_label: str,
    verdicts: Sequence[str] | None = None,
    errors: ArrayLike | None = None,
    limits: Sequence[Limit] = (),
    nominal: float | None = None,
) -> str:
    """A quantity over an uncertain parameter: one mark a run, as judged by the caller, the limits as lines.

    `values`, `results` (n,), NaN where a run has no result; `errors` (n,) numerical errors. Marks differ in form as well as in colour.
    """
    x, y = _arrays(values=values, results=results)
    judged = np.array(verdicts if verdicts is not None else ["pass"] * x.size)
    if judged.size != x.size:
        raise RecordError(f"{x.size} values but {judged.size} verdicts")
    order = np.argsort(x, kind="stable")
    x, y, judged = x[order], y[order], judged[order]
    with _figure(name, (_WIDTH, 3.4)) as figure:
        axes = figure.subplots()
        axes.plot(x, y, color=LINE, linewidth=1.0)
        if errors is not None:
            axes.errorbar(x, y, yerr=np.asarray(errors, dtype=float)[order], fmt="none", ecolor=INK, elinewidth=0.8)
        marks = {"pass": ("o", LINE, "pass"), "fail": ("X", BAD, "FAIL"), "undecided": ("D", UNSURE, "UNDECIDED")}
        for verdict, (marker, colour, label) in marks.items():
            if np.any(chosen := judged == verdict):
                axes.plot(x[chosen], y[chosen], marker, color=colour, markersize=5.5, markeredgewidth=0, label=label)
        lost = ~np.isfinite(y)
        if np.any(lost):  # a run without a result is shown where it is missing
            axes.plot(x[lost], np.full(lost.sum(), 0.02), "x", color=BAD, transform=axes.get_xaxis_transform(), label="no result")
        for limit in limits:
            axes.axhline(limit.value, color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), label=limit.label)
        if nominal is not None:
            axes.axvline(nominal, color=INK, linewidth=0.8, linestyle=":", label="nominal")
        axes.set_xlabel(parameter_label)
        axes.set_ylabel(quantity_label)
        axes.legend(loc="best")
        _tidy_offsets(axes)
        return _svg(figure, name)


def sensitivity(
    name: str,
    factors: ArrayLike,
    curves: Mapping[str, ArrayLike],
    *,
    factor_label: str = "frequency / modelled frequency",
    quantity_label: str = "residual vibration [% of move]",
    limits: Sequence[Limit] = (),
    band: tuple[float, float] | None = None,
) -> str:
    """Sensitivity curves: residual vibration against a mode's true frequency, one named curve a command; limits hold within `band`."""
    (x,) = _arrays(factors=factors)
    with _figure(name, (_WIDTH, 3.4)) as figure:
        axes = figure.subplots()
        styles, colours = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (5, 2, 1, 2)), (0, (9, 3))), (LINE, SECOND, INK, INK, INK)
        for number, (label, curve) in enumerate(curves.items()):
            y, width = _arrays(factors=factors, curve=curve)[1], 1.0 if number > 2 else 1.6
            axes.plot(x, y, color=colours[number % 5], linestyle=styles[number % 5], linewidth=width, label=label)
        if band is not None:
            axes.axvspan(*band, color=FAINT, alpha=0.5, linewidth=0, zorder=0)
        for limit in limits:
            low, high = band or axes.get_xlim()
            axes.hlines(limit.value, low, high, color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), label=limit.label)
        axes.set(xlabel=factor_label, ylabel=quantity_label, ylim=(0.0, None))
        axes.margins(x=0.01)
        axes.legend(loc="best")
        return _svg(figure, name)


def responses(
    name: str,
    curves: Mapping[str, tuple[ArrayLike, ArrayLike, ArrayLike]],
    *,
    end: float,
    target: float,
    displacement: float,
    command_label: str,
    output_label: str,
) -> str:
    """Several runs on one another: what was commanded, the output, and its distance from the target; a curve is times, input, output.

    `end` [s] is when the longest move ends, `displacement` = |Δ| > 0 in the output's unit.
    """
    with _figure(name, (_WIDTH, 6.8)) as figure:
        above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(2, 3, 3))
        middle.axhline(target, color=LIMIT, linewidth=1.0, linestyle=(0, (4, 3)))
        for number, (label, (times, command, output)) in enumerate(curves.items()):
            t, u, y = _arrays(times=times, command=command, output=output)
            seen = t <= 2.0 * end
            look: dict[str, Any] = _look(number)
            above.step(t[seen], u[seen], where="post", **look)
            middle.plot(t[seen], y[seen], label=label, **look)
            below.plot(t[seen], 100.0 * (y[seen] - target) / displacement, **look)
        below.set_ylim(-10.0, 10.0)
        above.set_ylabel(command_label)
        middle.set_ylabel(output_label)
        below.set(xlabel="time [s]", ylabel="from target [% of move]")
        middle.legend(loc="best")
        for axes in (above, middle, below):
            axes.margins(x=0.01)
        _tidy_offsets(middle)
        return _svg(figure, name)


def sweeps(name: str, curves: Mapping[str, tuple[ArrayLike, ArrayLike]], *, parameter_label: str, quantity_label: str) -> str:
    """A quantity over a parameter, one named curve a command, on a logarithmic axis; a curve is values and results."""
    with _figure(name, (_WIDTH, 3.6)) as figure:
        axes = figure.subplots()
        for number, (label, (values, results)) in enumerate(curves.items()):
            x, y = _arrays(values=values, results=results)
            axes.plot(x, np.maximum(y, 1e-12), marker="os^D"[number % 4], markersize=4.0, label=label, **_look(number))
        axes.set(yscale="log", xlabel=parameter_label, ylabel=quantity_label)
        axes.yaxis.set_major_formatter(lambda value, place: f"{value:g}")  # powers would be mathematics, which is off
        axes.legend(loc="best")
        return _svg(figure, name)


def _look(number: int) -> dict[str, Any]:
    """A colour and a line that tell this curve from its neighbours in print as well."""
    styles, colours = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (5, 2, 1, 2))), (LINE, SECOND, INK, FOURTH)
    return {"color": colours[number % 4], "linestyle": styles[number % 4], "linewidth": 1.3}


def costs(name: str, sizes: ArrayLike, curves: Mapping[str, ArrayLike], *, size_label: str, cost_label: str = "time [s]") -> str:
    """What something costs against its size, one named curve a part of it, on logarithmic axes; `sizes` (n,) and costs are positive."""
    (x,) = _arrays(sizes=sizes)
    with _figure(name, (_WIDTH, 3.4)) as figure:
        axes = figure.subplots()
        for number, (label, curve) in enumerate(curves.items()):
            y = _arrays(sizes=sizes, curve=curve)[1]
            axes.plot(x, y, color=(LINE, SECOND, INK)[number % 3], marker="os^"[number % 3], markersize=4.0, label=label)
        axes.set(xscale="log", yscale="log", xlabel=size_label, ylabel=cost_label)
        axes.yaxis.set_major_formatter(lambda value, place: f"{value:g}")
        axes.set_xticks(x, [f"{size:g}" for size in x])
        axes.set_xticks([], minor=True)
        axes.legend(loc="best")
        return _svg(figure, name)


def shaping(
    name: str,
    factors: Sequence[float],
    curves: Mapping[str, ArrayLike],
    times: ArrayLike,
    command: ArrayLike,
    responses: Mapping[str, ArrayLike],
    *,
    bands: Sequence[tuple[float, float, Limit]],
    ranges: Mapping[str, tuple[str, ArrayLike, ArrayLike]] = MappingProxyType({}),
) -> str:
    """A shaper in two panels: residual vibration [%] against relative frequency, and the shaped unit step with what each mode makes of it.

    `factors` (n,) and a curve (n,) a mode; `times` (m,) [s], the shaped step `command` (m,) and a response (m,) a mode. `ranges`, by the
    curve's name: what it is a range of, and the least and the largest residual (n,) over it. `bands` are shaded, each with its tolerance.
    """
    with _figure(name, (_WIDTH, 5.6)) as figure:
        above, below = figure.subplots(2, 1)
        styles, colours = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (5, 2, 1, 2))), (LINE, SECOND, INK)
        for number, (label, curve) in enumerate(curves.items()):
            x, y = _arrays(factors=factors, curve=curve)
            above.plot(x, y, color=colours[number % 3], linestyle=styles[number % 4], label=label)
            if label in ranges:
                told, least, most = ranges[label]
                x, low, high = _arrays(factors=factors, least=least, most=most)
                above.fill_between(x, low, high, color=colours[number % 3], alpha=0.25, linewidth=0, label=told)
        levels = {limit.value: limit.label for *_, limit in bands}  # one holds everywhere, of several each over its own bands
        for value, label in levels.items():
            spans = [band[:2] for band in bands if band[2].value == value] if len(levels) > 1 else [(factors[0], factors[-1])]
            above.hlines(value, *zip(*spans, strict=True), color=LIMIT, linewidth=1.2, linestyle=(0, (4, 3)), label=label)
        for low, high in dict.fromkeys(band[:2] for band in bands):
            above.axvspan(low, high, color=FAINT, alpha=0.5, linewidth=0, zorder=0, label=f"band, {low:g} to {high:g}")
        above.set(xlabel="frequency / modelled frequency", ylabel="residual vibration [%]", ylim=(0.0, None))
        t, u = _arrays(times=times, command=command)
        below.step(t, u, where="post", color=LIMIT, linewidth=1.0, label="shaped step")
        for number, (label, response) in enumerate(responses.items()):
            below.plot(*_arrays(times=times, response=response), color=colours[number % 3], linestyle=styles[number % 4], label=label)
        below.set(xlabel="time [s]", ylabel="step response")
        above.margins(x=0.01)
        below.margins(x=0.01)
        above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)  # curves may be anywhere below
        below.legend(loc="best")
        return _svg(figure, name)


def panels(name: str, count: int, height: float, fill: Fill, *, stacked: Sequence[float] = ()) -> str:
    """A chart of `count` panels side by side with one vertical axis, or `stacked` over one another in these ratios; `height` in inches."""
    if stacked:
        return grid(name, count, 1, (_WIDTH, height), fill, height_ratios=list(stacked))
    return grid(name, 1, count, (_WIDTH + 0.8, height), lambda figure, axes: (fill(figure, axes), _tidy_offsets(axes[0])), sharey=True)


def grid(name: str, rows: int, columns: int, size: tuple[float, float], fill: Fill, **arrangement: Any) -> str:
    """A chart of `rows` times `columns` panels, of this size [inches]; `fill` draws into them. `arrangement` is that of matplotlib."""
    with _figure(name, size) as figure:
        axes = list(figure.subplots(rows, columns, squeeze=False, **arrangement).flat)
        fill(figure, axes)
        return _svg(figure, name)


def standalone(svg: str) -> str:
    """A chart as a file of its own: on light paper, which the fallback colours are for, on a dark page too."""
    head, body = svg.split("</title>", 1)
    return f'{head}</title><rect width="100%" height="100%" rx="6" fill="#ffffff"/>{body}\n'


def _arrays(**given: ArrayLike) -> list[Float64]:
    """The arguments as float arrays of one and the same length; raises `RecordError` naming those that differ."""
    arrays = {name: np.asarray(value, dtype=float) for name, value in given.items()}
    shapes = {name: a.shape for name, a in arrays.items()}
    if len(set(shapes.values())) != 1 or any(a.ndim != 1 for a in arrays.values()):
        raise RecordError(f"a chart needs lists of one length; given are {', '.join(f'{n} {s}' for n, s in shapes.items())}")
    return list(arrays.values())


@contextmanager
def _figure(name: str, size: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure of this size [inches], in our style for as long as it is drawn."""
    import matplotlib as mpl  # here: a bound, which draws nothing, would take twice as long
    from matplotlib.figure import Figure

    style: dict[Any, Any] = _STYLE | {"svg.hashsalt": name}
    with mpl.rc_context(style):
        yield Figure(figsize=size, layout="constrained")


def _tidy_offsets(*all_axes: Axes) -> None:
    """No `1e-9` in a corner far from the axis, unless the numbers need it."""
    for axes in all_axes:
        axes.ticklabel_format(axis="y", useOffset=False)


def _svg(figure: Figure, name: str) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    out = io.StringIO()
    FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    # Several charts share one page: keep only the ids that are referred to, and those apart by the chart's name.
    used = set(re.findall(r'(?:url\(#|xlink:href="#)([^)"]+)', svg))
    prefix = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-") or "chart"
    svg = re.sub(r' id="([^"]*)"', lambda m: f' id="{prefix}-{m[1]}"' if m[1] in used else "", svg)
    svg = re.sub(r"(url\(#|xlink:href=\"#)", rf"\g<1>{prefix}-", svg)
    for stand_in, variable in _COLOURS.items():
        svg = svg.replace(stand_in, variable)
    svg = svg.replace("'DejaVu Sans'", _FONT)
    box = re.search(r'viewBox="([^"]+)"', svg)
    assert box is not None  # matplotlib always writes one
    label = escape(name, quote=True)
    spaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    head = f'<svg {spaces} viewBox="{box[1]}" preserveAspectRatio="xMinYMin"'
    return f'{head} role="img" aria-label="{label}"><title>{label}</title>' + svg[svg.index(">") + 1 :].strip()
