"""How a command is told to an FMU that takes its inputs step by step: as constants, or as straight lines.

Constant and, where the FMU interpolates its inputs, sloping parts of the command are told as they are. Elsewhere steps are divided. An FMU
that interpolates is told the line that has the command's mean and first moment over the step, one that does not constants, two and two
with that mean and moment. What is left is a second moment: the error at the communication points is of fourth order in the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from relaxations.commands import Command

Array = NDArray[np.float64]

PARTS = 8  # of a step on which the command cannot be told as it is; even, since constants come in pairs
NEGLIGIBLE = 1e-12  # of the largest input: a first moment below this is that of a constant
NODES, WEIGHTS = leggauss(5)  # exact for the moments of cubics, and to rounding for those of e^{at} while |a| times the step is below 1


@dataclass(frozen=True, slots=True)
class Told:
    """`times` (n,) [s] of all steps, `levels` (n - 1,) and `slopes` (n - 1,) of the input on them, and the indices of the logged times."""

    times: Array
    levels: Array
    slopes: Array
    logged: NDArray[np.intp]


def lines(command: Command, times: Array, rest: float) -> Told:
    """For an FMU that interpolates: value at the left end (after a jump) and slope of the input on each interval."""
    mean, moment = _moments(command, times, rest)
    pieces = command.pieces(rest)
    curved = (_middles(times) >= command.end) & (moment != 0.0)
    times, logged = _divided(times, curved)
    table = np.array([(p.start, p.level, p.slope) for p in pieces])
    start, level, slope = table[np.searchsorted(table[:, 0], _middles(times), side="right") - 1].T
    value = level + slope * (times[:-1] - start)
    if command.tail.terms:
        mean, moment = _moments(command, times, rest)
        inside = _middles(times) >= command.end
        slope = np.where(inside, 12.0 * moment / np.diff(times), slope)
        value = np.where(inside, mean - 6.0 * moment, value)
    return Told(times, value, slope, logged)


def constants(command: Command, times: Array, rest: float) -> Told:
    """For an FMU that holds its inputs: their values, on steps that are shorter where the command moves."""
    moving = _moments(command, times, rest)[1] != 0.0
    times, logged = _divided(times, moving)
    levels, moment = _moments(command, times, rest)
    first = np.flatnonzero(np.repeat(moving, np.diff(logged))).reshape(-1, 2)[:, 0]
    second = first + 1
    # Over a pair of steps of width h the first moment of the constants is (c_2 - c_1) h²/2.
    joint, apart = (levels[first] + levels[second]) / 2.0, (levels[second] - levels[first]) / 2.0 + moment[first] + moment[second]
    levels[first], levels[second] = joint - apart, joint + apart
    return Told(times, levels, np.zeros_like(levels), logged)


def instants(command: Command, times: Array, rest: float) -> Told:
    """For an FMU that asks for its input at any instant within a step: the value at the left end, after a jump."""
    pieces = command.pieces(rest)
    index = np.searchsorted([p.start for p in pieces], _middles(times), side="right") - 1
    values = np.array([pieces[i](t) for i, t in zip(index.tolist(), times[:-1].tolist(), strict=True)])
    return Told(times, values, np.zeros_like(values), np.arange(len(times)))


def _middles(times: Array) -> Array:
    return (times[:-1] + times[1:]) / 2.0


def _divided(times: Array, where: NDArray[np.bool_]) -> tuple[Array, NDArray[np.intp]]:
    """The times with `PARTS` parts of each interval `where` that is true, and the indices of the given ones among them."""
    logged = np.concatenate([[0], np.cumsum(np.where(where, PARTS, 1))])
    fine = np.interp(np.arange(logged[-1] + 1), logged, times)
    fine[logged] = times  # to the bit
    return fine, logged


def _moments(command: Command, times: Array, rest: float) -> tuple[Array, Array]:
    """Mean `∫u/h` and first moment `∫u (t - middle)/h²` of the command on each interval; constants come out as they are, and with 0."""
    points = _middles(times)[:, None] + np.diff(times)[:, None] / 2.0 * NODES
    values = command(points.ravel(), rest).reshape(points.shape)
    mean, moment = values @ WEIGHTS / 2.0, values @ (WEIGHTS * NODES) / 4.0
    still = np.abs(moment) <= NEGLIGIBLE * np.abs(values).max()
    return np.where((values == values[:, :1]).all(axis=1), values[:, 0], mean), np.where(still, 0.0, moment)
