"""Commands of limited slope: continuous, straight between the nodes of a grid. Their moments, and the ramps that their multipliers ask for.

The values v_1 … v_N at the nodes are the unknowns, v_0 = 0 and v_N is the final rest. Where the slope is on a limit for a while the slope's
multiplier is a function q of the time to go, 0 at both ends of the ramp; between them the input is inside its limits, so that `p - q'` is 0
there (± the price of the fuel, by the input's sign), and elsewhere q = 0 (../docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import ManeuverError

if TYPE_CHECKING:
    from relaxations.maneuvers import Maneuver

Reals = NDArray[np.float64]

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(8)  # in each cell, where a mode turns by a radian or so
ON_RATE = 1e-3  # of the slope's limit: a cell whose slope is so close is part of a ramp
GAP = 2  # cells between two parts of one ramp at most
MEETING = 1e-6  # of a cell: two ramps so close together meet


@dataclass(frozen=True, slots=True)
class Ramp:
    """From `edges[0]` to `edges[-1]` [s to go] the slope is priced; p - q' is `levels[k]` between two edges, but for a constant in all.

    Where it begins at the end of the move (0), or ends at its beginning, that constant is 0.
    """

    edges: tuple[float, ...]
    levels: tuple[float, ...]


def rate_of(maneuver: Maneuver) -> tuple[float, float] | None:
    """The limits of the slope; raises `ManeuverError` where they exclude 0, or for a task that they do not go with."""
    rate = maneuver.limits.rate
    if rate is None:
        return None
    if not rate[0] < 0 < rate[1]:
        raise ManeuverError(f"limits of the slope contain 0, with room on either side, not [{float(rate[0])!r}, {float(rate[1])!r}]")
    if maneuver.limits.pulsed:
        raise ManeuverError("limits of the slope do not go with pulses: an input that is on or off jumps")
    return float(rate[0]), float(rate[1])


def hats(rows: Callable[[Reals], Reals], instants: Reals) -> Reals:
    """The moments at the end of a unit value at each node from the second on, falling to 0 at its neighbours: shape (size, N)."""
    widths = np.diff(instants)
    points = (instants[:-1, None] + widths[:, None] * (1.0 + POINTS) / 2).ravel()
    table = rows(instants[-1] - points)
    weighted = table.reshape(len(table), len(widths), len(POINTS)) * (WEIGHTS / 2) * widths[:, None]
    rising, falling = weighted @ ((1.0 + POINTS) / 2), weighted @ ((1.0 - POINTS) / 2)
    return rising + np.hstack([falling[:, 1:], np.zeros((len(table), 1))])


def priced(instants: Reals, values: Reals, rate: tuple[float, float], fuel: float) -> tuple[Ramp, ...]:
    """The ramps of node values (N,): runs of cells on a limit of the slope, with the share of the cells at their ends that is on it too."""
    nodes, horizon = np.concatenate([[0.0], values]), float(instants[-1])
    slopes, widths = np.diff(nodes) / np.diff(instants), np.diff(instants)
    found: list[Ramp] = []
    for limit in rate:
        on = slopes * np.sign(limit) >= (1.0 - ON_RATE) * abs(limit)
        active = np.flatnonzero(on)
        for run in np.split(active, np.flatnonzero(np.diff(active) > GAP) + 1) if len(active) else []:
            first, last = int(run[0]), int(run[-1])

            def share(cell: int, beyond: int, limit: float = limit) -> float:
                if not 0 <= cell < len(slopes):
                    return 0.0
                other = rate[0] if limit > 0 else rate[1]  # a ramp the other way may follow at once
                level = other if 0 <= beyond < len(slopes) and slopes[beyond] / other >= 1.0 - ON_RATE else 0.0
                return float(np.clip((slopes[cell] - level) / (limit - level), 0.0, 1.0) * widths[cell])

            start, end = instants[first] - share(first - 1, first - 2), instants[last + 1] + share(last + 1, last + 2)
            edges, levels = [horizon - end], []
            crossing = np.interp(0.0, nodes[first : last + 2] * np.sign(limit), instants[first : last + 2], -1.0, -1.0) if fuel else -1.0
            if fuel and start < crossing < end:
                edges.append(horizon - crossing)
                levels.append(fuel * float(np.sign(limit)))
                levels.append(-fuel * float(np.sign(limit)))
            else:
                middle = float(nodes[first : last + 2].mean())
                levels.append(fuel * float(np.sign(middle)))
            edges.append(horizon - start if start > 0.0 else 2.0 * horizon)  # the first one has no end, whatever the time that is claimed
            found.append(Ramp(tuple(max(float(edge), 0.0) for edge in edges), tuple(levels)))
    found.sort(key=lambda ramp: ramp.edges[0])
    kept: list[Ramp] = []
    for ramp in found:
        if kept and ramp.edges[0] < kept[-1].edges[-1]:  # two that meet: where they do is a matter of tightness only
            edge = min(kept[-1].edges[-1], ramp.edges[-1])
            ramp = Ramp((edge, *(x for x in ramp.edges[1:] if x > edge)), ramp.levels[-sum(x > edge for x in ramp.edges[1:]) :])
            if len(ramp.edges) < 2:
                continue
        whole = bool(kept) and kept[-1].edges[0] == 0.0 and ramp.edges[-1] > horizon  # of such a one only the middle says where q is 0
        if kept and not whole and ramp.edges[0] - kept[-1].edges[-1] <= MEETING * float(widths.max()) and ramp.edges[-1] > ramp.edges[0]:
            # Where the slope turns from one limit to the other within the limits of the input, q goes through 0, wherever that is.
            first = kept.pop()
            ramp = Ramp((*first.edges, *ramp.edges[1:]), (*first.levels, *ramp.levels))
        if ramp.edges[-1] > ramp.edges[0]:
            kept.append(ramp)
    return tuple(kept)


def slid(
    ramps: Sequence[Ramp], p: Callable[[Reals], Reals], whole: Callable[[Reals], Reals], horizon: float, most: float
) -> tuple[Ramp, ...]:
    """Ramps moved, as they are, so that q ends at 0 without a shift: `∫ (p - level) = 0` by one step of Newton's method, of at most `most`
    [s]; `whole` is an antiderivative of p.

    A grid's command has only as many cells in which a ramp begins or ends as it has equations: its other ramps do so at nodes.
    """
    found: list[Ramp] = []
    for ramp, after in zip(ramps, (*ramps[1:], None), strict=True):
        edges, ends = np.array(ramp.edges), np.array([ramp.edges[0], ramp.edges[-1]])
        if ends[0] > 0.0 and ends[1] < horizon:
            missed, slope = float(np.diff(whole(ends))[0] - np.array(ramp.levels) @ np.diff(edges)), float(np.diff(p(ends))[0])
            by = float(np.clip(-missed / slope if slope else 0.0, -most, most))
            low, high = found[-1].edges[-1] if found else 0.0, after.edges[0] if after else horizon
            edges = edges + (by if low < ends[0] + by and ends[1] + by < high else 0.0)
        found.append(replace(ramp, edges=tuple(float(edge) for edge in edges)))
    return tuple(found)


def bound(
    p: Reals,
    points: Reals,
    limits: tuple[float, float],
    rate: tuple[float, float],
    fuel: float,
    ramps: Sequence[Ramp],
    given: float | None = None,
) -> tuple[Reals, float]:
    """The integrand's integral from 0 to each of the fine `points` where p is known, and q(0), if not `given`: trapezoidal rule."""

    def supported(x: Reals, low: float, high: float) -> Reals:
        return np.maximum(high * x, low * x)

    cells = np.diff(points)
    middle = (p[1:] + p[:-1]) / 2
    centre = (points[1:] + points[:-1]) / 2
    value = np.maximum(supported(p - fuel, 0.0, limits[1]) + supported(p + fuel, limits[0], 0.0), 0.0)
    density, first = (value[1:] + value[:-1]) / 2, 0.0
    for ramp in ramps:
        inside = np.flatnonzero((centre > ramp.edges[0]) & (centre < ramp.edges[-1]))
        if not len(inside):
            continue
        level = np.array(ramp.levels)[np.minimum(np.searchsorted(ramp.edges, centre[inside]), len(ramp.levels)) - 1]
        rest = (middle[inside] - level) * cells[inside]
        q = np.concatenate([[0.0], np.cumsum(rest)])
        shift = 0.0
        if ramp.edges[0] == 0.0:
            q = q - q[-1] if given is None else q + given
            first = float(q[0])
        if ramp.edges[-1] < points[-1]:
            shift = float(q[-1] / cells[inside].sum())
            q = q - shift * np.concatenate([[0.0], np.cumsum(cells[inside])])
        level = level + shift
        cost = supported(level - fuel, 0.0, limits[1]) + supported(level + fuel, limits[0], 0.0)
        density[inside] = np.maximum(cost, 0.0) + (supported(q[1:], *rate) + supported(q[:-1], *rate)) / 2
    return np.concatenate([[0.0], np.cumsum(density * cells)]), first
