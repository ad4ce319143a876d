"""Every quantity that a requirement may name, implemented once: the same code judges a run live and in review.

A quantity looks at an `Observation`, which holds nothing but what the run's log holds. Definitions: docs/quantities.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command
from relaxations.response import jumps
from relaxations.shaping.sensitivity import insensitivity
from suite.quantity_names import Quantity

Reals = NDArray[np.float64]
Modes = tuple[tuple[float, float], ...]  # flexible ones: (natural frequency [rad/s], damping ratio)

UNDAMPED = 1e-4  # damping ratios below this count as undamped
DECAYED = 1e-3  # amplitude to which a damped mode must have decayed for its last value to be its rest value
UNEVEN = 1e-3  # of three samples' whole span: no parabola is laid through samples closer than this
PERIODS, MOST_PERIODS = 20, 200  # slowest periods observed after the move: at least, and at most


@dataclass(frozen=True, slots=True)
class Facts:
    """What a run is measured against: Δ and the initial rest (input and output units), the run's own modes, the bracket of the design."""

    displacement: float
    rest_input: float
    rest_output: float
    modes: tuple[tuple[float, float], ...]  # flexible modes of the run's own plant: (natural frequency [rad/s], damping ratio)
    slowest_period: float | None  # [s]; None without flexible modes
    decayed: bool  # whether every mode has decayed when the observed window ends
    lower: float | None = None  # bracket of the minimum time [s]
    upper: float | None = None
    scale: float | None = None  # what relative quantities are divided by; None: |Δ|
    rests: Mapping[str, float] | None = None  # of every variable its value at the initial rest, where a run begins elsewhere


@dataclass(frozen=True, slots=True)
class Observation:
    """One run: signals at the communication points (n,), every logged variable by its FMU name, the command, and the facts."""

    times: Reals
    input: Reals  # the value applied from each instant on
    output: Reals
    linear: Reals  # what the linear plant's output would be
    variables: Mapping[str, Reals]
    command: Command
    facts: Facts

    @property
    def scale(self) -> float:
        """|Δ|, or what stands for it."""
        return abs(self.facts.displacement) if self.facts.scale is None else self.facts.scale

    @property
    def target(self) -> float:
        """y_0 + Δ."""
        return self.facts.rest_output + self.facts.displacement

    @property
    def after(self) -> NDArray[np.bool_]:
        """The samples from the end of the move on."""
        return self.times >= self.command.end


def _extremes(times: Reals, values: Reals) -> tuple[float, float]:
    """Least and greatest value of a smooth signal: the samples, and the vertices of the parabolas through every three of them."""
    low, high = float(values.min()), float(values.max())
    if len(values) < 3:
        return low, high
    t0, t1, t2 = times[:-2], times[1:-1], times[2:]
    y0, y1, y2 = values[:-2], values[1:-1], values[2:]
    first, second = (y1 - y0) / (t1 - t0), (y2 - y1) / (t2 - t1)
    curvature = (second - first) / (t2 - t0)
    # Where a switch lies just beside a regular point, rounding divided by the tiny step between them would be a slope.
    even = np.minimum(t1 - t0, t2 - t1) > UNEVEN * (t2 - t0)
    turning = (first * second <= 0) & (curvature != 0.0) & even
    if turning.any():
        slope = first[turning] + curvature[turning] * (t1 - t0)[turning]  # of the parabola at t1
        vertex = y1[turning] - slope**2 / (4 * curvature[turning])
        low, high = min(low, float(vertex.min())), max(high, float(vertex.max()))
    return low, high


def _rest_output(run: Observation) -> float:
    """y(∞): the last value if the modes have decayed, else the middle of the last full slowest period."""
    if run.facts.decayed or run.facts.slowest_period is None:
        return float(run.output[-1])
    last = run.times >= max(run.times[-1] - run.facts.slowest_period, run.command.end)
    low, high = _extremes(run.times[last], run.output[last])
    return (low + high) / 2


def _residual_vibration(run: Observation, quantity: Quantity) -> float:
    rest = _rest_output(run)
    low, high = _extremes(run.times[run.after], run.output[run.after])
    return max(high - rest, rest - low) / run.scale


def _final_error(run: Observation, quantity: Quantity) -> float:
    return abs(_rest_output(run) - run.target) / run.scale


def _settling_time(run: Observation, quantity: Quantity) -> float:
    band = float(quantity.level or 0) * run.scale
    outside = np.abs(run.output - run.target) - band
    over = np.flatnonzero(outside > 0)
    if not len(over):
        return 0.0
    last = over[-1]
    # What is still outside in the last period of an undamped mode is outside for ever, whatever its phase when the window ends.
    lasting = 0.0 if run.facts.decayed or run.facts.slowest_period is None else run.facts.slowest_period
    if last == len(run.times) - 1 or run.times[last] > max(run.times[-1] - lasting, run.command.end):
        return math.inf  # not settled within the observed window
    share = outside[last] / (outside[last] - outside[last + 1])
    return float(run.times[last] + share * (run.times[last + 1] - run.times[last]))


def _overshoot(run: Observation, quantity: Quantity) -> float:
    way = run.facts.displacement or run.target - run.output[0]  # a plant that begins elsewhere than at rest may have to come back only
    beyond = (run.output - run.target) * math.copysign(1.0, way)
    return max(float(beyond.max()) / run.scale, 0.0)


def _fuel(run: Observation, quantity: Quantity) -> float:
    widths = np.diff(np.minimum(run.times, run.command.end))
    return float(np.sum(np.abs(run.input[:-1] - run.facts.rest_input) * widths))


def _peak_rate(run: Observation, quantity: Quantity) -> float:
    table = jumps(run.command, run.facts.rest_input)
    joins = table[:-1] if run.command.tail.terms else table
    size = float(np.abs(run.input).max())
    ended = run.command([run.command.end])[0] - _before_end(run)
    if np.abs(joins[:, 1]).max(initial=0.0) > 1e-12 * size or abs(ended) > 1e-12 * size:
        return math.inf  # a jump
    slopes = [abs(segment.slope) for segment in run.command.segments]
    steps = np.diff(run.input[run.after]) / np.diff(run.times[run.after])
    return max([*slopes, float(np.abs(steps).max(initial=0.0))])


def _before_end(run: Observation) -> float:
    """The input just before the end of the move."""
    if not run.command.segments:
        return run.facts.rest_input
    last = run.command.segments[-1]
    return last.level + last.slope * (run.command.end - last.start)


def step_impulses(command: Command, rest: float, unit: float) -> tuple[Reals, Reals] | None:
    """Instants [s] and sizes of a command's jumps, counted in units of `unit` (input units); None of slopes or a tail, which are none."""
    if any(segment.slope for segment in command.segments) or command.tail.terms or not unit:
        return None
    table = jumps(command, rest)
    return table[:, 0], table[:, 1] / unit


def command_insensitivity(command: Command, rest: float, unit: float, modes: Modes, level: float) -> float:
    """`insensitivity(level)` of a command: that of its jumps, the least over the modes; infinite without any, NaN where it has none."""
    impulses = step_impulses(command, rest, unit)
    if impulses is None:
        return math.inf if not (unit or modes) else math.nan
    return min((insensitivity(*impulses, frequency, damping, level) for frequency, damping in modes), default=math.inf)


def _insensitivity(run: Observation, quantity: Quantity) -> float:
    rest = run.facts.rest_input
    return command_insensitivity(run.command, rest, float(np.abs(run.input - rest).max()), run.facts.modes, float(quantity.level or 0))


def _optimality_gap(run: Observation, quantity: Quantity) -> float:
    lower, upper = run.facts.lower, run.facts.upper
    if lower is None or upper is None:
        return math.inf
    if lower == 0.0:
        return 0.0 if upper == 0.0 else math.inf
    return upper / lower - 1.0


def _variable(run: Observation, quantity: Quantity) -> Reals:
    return run.variables[quantity.variable or ""]


def _at_rest(run: Observation, quantity: Quantity) -> float:
    """A variable's value at the initial rest."""
    rests = run.facts.rests or {}
    return rests.get(quantity.variable or "", float(_variable(run, quantity)[0]))


DEFINITIONS: Mapping[str, Callable[[Observation, Quantity], float]] = {
    "maneuver_time": lambda run, quantity: run.command.maneuver_time,
    "optimality_gap": _optimality_gap,
    "residual_vibration": _residual_vibration,
    "final_error": _final_error,
    "settling_time": _settling_time,
    "overshoot": _overshoot,
    "fuel": _fuel,
    "peak_input": lambda run, quantity: float(np.abs(run.input).max()),
    "peak_rate": _peak_rate,
    "peak": lambda run, quantity: float(np.abs(_variable(run, quantity) - _at_rest(run, quantity)).max()),
    "final": lambda run, quantity: float(_variable(run, quantity)[-1]),
    "insensitivity": _insensitivity,
    "model_mismatch": lambda run, quantity: float(np.abs(run.output - run.linear).max()) / run.scale,
}


def evaluate(run: Observation, quantity: Quantity) -> float:
    """The value of a quantity on one run; infinite for the rate of a jump or a run that never settles, NaN where it is not defined."""
    return DEFINITIONS[quantity.name](run, quantity)


def window(modes: tuple[tuple[float, float], ...], real_rates: tuple[float, ...], maneuver_time: float) -> tuple[float, float | None, bool]:
    """How long to observe after the move [s], the slowest period [s], and whether everything has decayed by then.

    `modes` (frequency [rad/s], damping ratio) of the run's plant; `real_rates` its real poles [1/s].
    """
    if not modes:
        rates = [abs(rate) for rate in real_rates if rate != 0.0]
        return (math.log(1 / DECAYED) / min(rates) if rates else maneuver_time), None, True
    slowest = max(2 * math.pi / frequency for frequency, _ in modes)
    most = MOST_PERIODS * slowest
    decays = [math.log(1 / DECAYED) / (damping * frequency) for frequency, damping in modes if damping >= UNDAMPED]
    undamped = any(damping < UNDAMPED for _, damping in modes)
    wanted = max([PERIODS * slowest, *decays])
    return min(wanted, most), slowest, not undamped and wanted <= most
