"""The exact response of a linear plant to a command: closed form, no time stepping."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command
from relaxations.initial import moments as initial_moments
from relaxations.moments import Basis
from relaxations.plants import LinearPlant

Reals = NDArray[np.float64]


def jumps(command: Command, rest: float = 0.0) -> Reals:
    """Rows (instant [s], jump of level, jump of slope) of the segments and of the step to `tail.steady`; impulses are level jumps."""
    table, level, slope, since = [], rest, 0.0, 0.0
    for segment in command.segments:
        table.append((segment.start, segment.level - (level + slope * (segment.start - since)), segment.slope - slope))
        level, slope, since = segment.level, segment.slope, segment.start
    table.append((command.end, command.tail.steady - (level + slope * (command.end - since)), -slope))
    return np.array(table)


def moments(basis: Basis, command: Command, time: float, rest: float = 0.0) -> Reals:
    """M(time) of the command's segments in deviations from `rest`, shape (n,); the tail's decaying terms are left out."""
    table = jumps(command, rest)
    table = table[table[:, 0] < time]
    since = time - table[:, 0]
    return basis.rows(since, 1) @ table[:, 1] + basis.rows(since, 2) @ table[:, 2]


def response(
    plant: LinearPlant,
    command: Command,
    times: Sequence[float] | Reals,
    output: str | None = None,
    rest: float = 0.0,
    *,
    before: bool = False,
    begin: Sequence[Fraction] | None = None,
) -> Reals:
    """Deviation of an output from its first rest value at `times` [s], output units; the input rests at `rest` before the command.

    y(t) = w M(t) + D (u(t) - rest), M summed over the command's jumps and its tail's terms; at a jump of u the value after it, or `before`.
    A plant that is not at rest begins at `begin` (`relaxations.initial`).
    """
    t = np.asarray(times, dtype=float)
    basis, partial = Basis(plant.poles), plant.partial(output)
    weights = basis.weights(partial)
    y = partial.feedthrough * (command(np.nextafter(t, -np.inf) if before else t, rest) - rest)
    if not plant.order:
        return y
    if begin is not None:
        y += weights @ basis.free(initial_moments(plant, basis, begin), t)
    during = t <= command.end
    for instant, level, slope in jumps(command, rest):
        acting = during & (t > instant)
        since = t[acting] - instant
        y[acting] += weights @ (level * basis.rows(since, 1) + slope * basis.rows(since, 2))
    # Afterwards the jumps' contributions, which grow with t, nearly cancel: go on from the state at the end instead.
    after = ~during
    since = t[after] - command.end
    y[after] += weights @ basis.free(moments(basis, command, command.end, rest), since)
    y[after] += weights @ ((command.tail.steady - rest) * basis.rows(since, 1))
    for term in command.tail.terms:
        # Re(c e^{zr}) = (c e^{zr} + conj)/2; on complex chains both halves count, on real ones they are conjugate.
        for rate, coefficient in ((term.rate, term.coefficient / 2), (term.rate.conjugate(), term.coefficient.conjugate() / 2)):
            y[after] += weights @ basis.real(iter(coefficient * basis.tail(rate, term.power, since)))
    return y
