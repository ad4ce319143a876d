"""Pulses of one height that begin at given intervals, on as few as do: an exhaustive search, which proves that fewer do not.

The conditions are linear in what each pulse contributes, a curve over its width. On a box of widths the best multipliers are a linear
program (each width on a grid); what they leave positive refutes the box, in balls (relaxations.checking.pulse_widths). Else the program's
own widths start Newton's method, and the box is halved across the width that the program mixes most.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linprog

from relaxations.checking.pulse_widths import Halves, Vanishing, Weights, no_widths
from relaxations.plants import exact
from relaxations.shaping.modes import Mode

Reals = NDArray[np.float64]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)  # of an interval, which is shorter than half a period
CLOSED = 1e-11  # of equations of order one
SHORTEST = 1e-9  # of an interval: a pulse that is none
DUST = (1e-2, 1e-4, 1e-6, SHORTEST)  # of an interval: pulses so near none or all of it are that, if equations can be solved without them
GRID, FINER = 9, 8  # widths of a pulse's range in a program; how much finer what it leaves is looked at
CLEAR = 1e-6  # by which a box is refuted, of equations of order one: so much that balls can tell
MOST_BOXES = 600  # of one number of pulses
EXACT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "max_nfev": 100}  # where it creeps another start is better


@dataclass(frozen=True, slots=True)
class Searched:
    """The `widths` [s] that do, or None; `refuted`: it is proven that none do; `boxes` that were looked at."""

    widths: Reals | None
    refuted: bool = False
    boxes: int = 0


@dataclass(frozen=True, slots=True)
class Pulses:
    """What is asked: `count` pulses of `height` [1/s], one an `interval` [s], zero vibration and `derivatives` of it at every mode."""

    modes: tuple[Mode, ...]
    height: float
    interval: float
    derivatives: int
    count: int

    @property
    def end(self) -> float:
        """The end of the last interval [s]."""
        return self.count * self.interval

    def rows(self, since: Reals) -> Reals:
        """Each condition's integrand at instants since the end (any shape), real parts and imaginary parts, shape (equations, …)."""
        table = [np.ones_like(since)]
        for mode in self.modes:
            for power in range(self.derivatives + 1):
                z = (since / self.end) ** power * np.exp(mode.frequency * mode.direction * since)
                table += [z.real, z.imag]
        return np.array(table)

    @property
    def starts(self) -> Reals:
        """When each interval begins, since the end [s]."""
        return self.interval * np.arange(float(self.count)) - self.end

    def contributions(self, low: Reals, high: Reals, grid: int) -> tuple[Reals, Reals]:
        """Widths (pulses, grid) between `low` and `high`, and what each contributes to the equations (equations, pulses, grid)."""
        widths = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, grid)
        first = self._integral(self.starts, low)
        steps = np.broadcast_to(((high - low) / (grid - 1))[:, None], (self.count, grid - 1))
        further = self._integral(self.starts[:, None] + widths[:, :-1], steps)
        return widths, self.height * np.concatenate([first[..., None], first[..., None] + np.cumsum(further, axis=-1)], axis=-1)

    def _integral(self, start: Reals, width: Reals) -> Reals:
        at = start[..., None] + width[..., None] * (NODES + 1.0) / 2.0
        return (self.rows(at) * (WEIGHTS / 2.0)).sum(axis=-1) * width

    def missed(self, widths: Reals) -> Reals:
        """The equations of these widths."""
        total = self._integral(self.starts, widths).sum(axis=-1) * self.height
        total[0] -= 1.0
        return total

    def slopes(self, widths: Reals) -> Reals:
        """Their Jacobian."""
        return self.rows(self.starts + widths) * self.height

    def solved(self, start: Reals) -> Reals | None:
        """Widths near `start` [s] that solve the equations to rounding, or None."""
        h = self.interval
        found = least_squares(self.missed, np.clip(start, 0.0, h), jac=self.slopes, bounds=(0.0, h * (1.0 + 1e-12)), **EXACT)  # type: ignore[arg-type]
        tried = (self._polished(found.x, dust * h) for dust in DUST)
        return next((widths for widths in tried if widths is not None), None)

    def _polished(self, widths: Reals, dust: float) -> Reals | None:
        """To rounding, with those that are at neither end, nor nearer to one than `dust` [s]."""
        h = self.interval
        widths = np.where(widths < dust, 0.0, np.where(widths > h - dust, h, widths))
        inner = (widths > 0.0) & (widths < h)
        for _ in range(8):
            missed = self.missed(widths)
            if np.abs(missed).max() <= CLOSED:
                return widths
            step = np.linalg.lstsq(self.slopes(widths)[:, inner], -missed, rcond=None)[0]
            widths[inner] = np.clip(widths[inner] + step, 0.0, h)
        return None


def search(asked: Pulses) -> Searched:
    """Widths that do, or the proof that there are none; neither if that took more than `MOST_BOXES` boxes."""
    if asked.end * asked.height >= 1.0:
        widths = asked.solved(np.full(asked.count, 1.0 / (asked.count * asked.height)))
        if widths is not None:
            return Searched(widths)
    return _Search(asked).run()


class _Search:
    def __init__(self, asked: Pulses) -> None:
        self.asked, self.boxes, self.found = asked, 0, None

    def run(self) -> Searched:
        count, h = self.asked.count, self.asked.interval
        tree = self._tree(np.zeros(count), np.full(count, h))
        if self.found is not None or tree is None:
            return Searched(self.found, boxes=self.boxes)
        a = self.asked
        conditions = [
            Vanishing(exact(repr(mode.frequency)), exact(repr(mode.damping)), power)
            for mode in a.modes
            for power in range(a.derivatives + 1)
        ]
        return Searched(None, no_widths(conditions, exact(repr(a.height)), exact(repr(h)), count, tree), self.boxes)

    def _tree(self, low: Reals, high: Reals) -> Weights | Halves | None:
        """What refutes the box; None if widths were found, or too many boxes were looked at."""
        self.boxes += 1
        if self.boxes > MOST_BOXES:
            return None
        widths, table = self.asked.contributions(low, high, FINER * (GRID - 1) + 1)
        widths = widths[:, ::FINER]
        multipliers, shares = _multipliers(table[..., ::FINER])
        if np.tensordot(multipliers, table, 1).min(axis=1).sum() - multipliers[0] > CLEAR:
            return self._weights(multipliers)
        middle = (shares * widths).sum(axis=1)
        self.found = self.asked.solved(middle)
        if self.found is not None:
            return None
        spread = np.sqrt((shares * (widths - middle[:, None]) ** 2).sum(axis=1))
        # Where the program mixes nothing, or boxes have become small, the widest is halved.
        pulse = int(np.argmax(spread if spread.max() > SHORTEST * self.asked.interval else high - low))
        at = float((low[pulse] + high[pulse]) / 2.0)
        below = self._tree(low, _replaced(high, pulse, at))
        above = None if below is None else self._tree(_replaced(low, pulse, at), high)
        return None if below is None or above is None else Halves(pulse, Fraction(at), below, above)

    def _weights(self, multipliers: Reals) -> Weights:
        """Of derivatives the checker measures time in seconds."""
        powers = [power for _ in self.asked.modes for power in range(self.asked.derivatives + 1)]
        pairs = multipliers[1:].reshape(-1, 2) / self.asked.end ** np.array(powers)[:, None]
        return Weights(Fraction(float(multipliers[0])), tuple((Fraction(float(a)), Fraction(float(b))) for a, b in pairs))


def _replaced(values: Reals, place: int, value: float) -> Reals:
    changed = values.copy()
    changed[place] = value
    return changed


def _multipliers(table: Reals) -> tuple[Reals, Reals]:
    """Of contributions G (equations, pulses, grid): the |y| ≤ 1 with the largest `Σ_k min_j y·G_kj - y_0`, and how it mixes the widths."""
    equations, pulses, grid = table.shape
    rows = np.hstack([-table.reshape(equations, -1).T, np.kron(np.eye(pulses), np.ones((grid, 1)))])
    costs = np.concatenate([[1.0], np.zeros(equations - 1), -np.ones(pulses)])
    bounds = [(-1.0, 1.0)] * equations + [(None, None)] * pulses
    found = linprog(costs, A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds, method="highs")
    if found.status != 0:
        return np.zeros(equations), np.full((pulses, grid), 1.0 / grid)
    shares = np.maximum(-found.ineqlin.marginals.reshape(pulses, grid), 0.0)
    return found.x[:equations], shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-300)
