"""Reference traces of shipped plants, by something that shares nothing with the FMU's integrator or its C source.

A linear plant's is the matrix exponential of its twin in ball arithmetic with 200 bits, and every printed digit is right. A nonlinear
plant's comes from its equations written anew (`nonlinear_plants.py`), by SciPy's DOP853, and is right to about 11 digits.
To write a plant's reference.csv anew:

    .venv/bin/python tests/reference_traces.py two_mass
"""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import flint
import numpy as np
from flint import arb, arb_mat, fmpq
from nonlinear_plants import MODELS
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fmus.plant_files import read_plant_file
from fmus.twins import read_twin, sized

PLANTS = Path(__file__).parents[1] / "fmus" / "plants"
BITS = 200

# Full force one way and the other, antisymmetric, then none: start and level, for a plant whose natural unit of time is a second.
BANG_BANG = (("0", 1), ("1.0027", -1), ("2.109", 1), ("3.2153", -1), ("4.218", 0))


@dataclass(frozen=True)
class Signal:
    """The test input of a plant: BANG_BANG times `level` [input unit], in units of `unit` [s], with a row every `step` units up to `stop`.

    `held` are the values of the other inputs.
    """

    level: str = "1"
    unit: str = "1"
    step: str = "0.25"
    stop: int = 8
    held: Mapping[str, float] = field(default_factory=dict)

    def jumps(self) -> list[tuple[Fraction, Fraction]]:
        """Start [s] and level of each constant piece."""
        return [(Fraction(start) * Fraction(self.unit), level * Fraction(self.level)) for start, level in BANG_BANG]

    def times(self) -> list[Fraction]:
        """The instants of the rows: the regular ones and the jumps [s]."""
        step = Fraction(self.step)
        regular = (k * step * Fraction(self.unit) for k in range(int(self.stop / step) + 1))
        return sorted({*(start for start, _ in self.jumps()), *regular})

    def pieces(self) -> Iterator[tuple[Fraction, Fraction, Fraction]]:
        """(start [s], end [s], level) from row to row; the last one has no length."""
        times = self.times()
        for now, following in zip(times, [*times[1:], times[-1]], strict=True):
            yield now, following, next(level for start, level in reversed(self.jumps()) if start <= now)


SIGNALS = {
    "aircraft_pitch": Signal("0.2"),
    "chain": Signal("1", "2"),
    "disk_drive": Signal("10", "0.0005"),
    "gantry_crane": Signal("3000", "2", held={"hoist": 2.0}),
    "rlc_filter": Signal("1", "0.0001"),
    "robot_arm": Signal("200", "0.05"),
    "spacecraft": Signal("10", "4"),
    "stirred_tanks": Signal("2", "100"),
    "two_mass": Signal(step="0.1", stop=12),
}


def reference_trace(plant: str) -> str:
    """The text of reference.csv: at each instant the input from then on, the states and the other outputs."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerows(_nonlinear(plant) if plant in MODELS else _linear(plant))
    return table.getvalue()


def read_reference(plant: str) -> tuple[list[str], NDArray[np.float64]]:
    """The columns' names and the table of a plant's reference.csv."""
    with (PLANTS / plant / "reference.csv").open(encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=float)


def twin_text(plant: str) -> str:
    """A plant's linear twin, as it lies in its folder, with the size that it has if none is chosen."""
    size = read_plant_file(PLANTS / plant / "plant.toml").size
    return sized((PLANTS / plant / "twin.toml").read_text(encoding="utf-8"), size.value if size else None)


def _nonlinear(plant: str) -> Iterator[list[str]]:
    model, signal = MODELS[plant], SIGNALS[plant]
    yield ["time", model.input, *model.states, *model.outputs]
    state = np.zeros(len(model.states))
    for start, end, level in signal.pieces():
        given = {model.input: float(level), **signal.held}
        yield [repr(float(x)) for x in (start, level)] + [f"{x + 0.0:.13g}" for x in (*state, *model.observe(state, given))]
        if end > start:
            span = (float(start), float(end))
            solved = solve_ivp(lambda _, x: model.slope(x, given), span, state, method="DOP853", rtol=3e-14, atol=1e-15)  # noqa: B023
            state = solved.y[:, -1]


def _linear(plant: str) -> Iterator[list[str]]:
    twin = read_twin(twin_text(plant))
    outputs = [name for name in twin.outputs if name not in twin.states]
    yield ["time", twin.input, *twin.states, *outputs]
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        state = arb_mat([[0] for _ in twin.states])
        for start, end, level in SIGNALS[plant].pieces():
            rows = [([_ball(x) for x in twin.outputs[name][0]], _ball(twin.outputs[name][1] * level)) for name in outputs]
            values = [state[i, 0] for i in range(len(twin.states))] + [(arb_mat([row]) * state)[0, 0] + d for row, d in rows]
            yield [_decimal(_ball(start)), _shortest(level), *map(_decimal, values)]
            # Over an interval of constant input, exp of the matrix [[A, B u], [0, 0]] carries (x, 1) along.
            augmented = [[_ball(x) for x in row] + [_ball(b * level)] for row, b in zip(twin.A, twin.B, strict=True)]
            step = (arb_mat([*augmented, [arb(0)] * (len(twin.states) + 1)]) * _ball(end - start)).exp()
            state = arb_mat([[(step * _with_one(state))[i, 0]] for i in range(len(twin.states))])
    finally:
        flint.ctx.prec = before


def _with_one(state: arb_mat) -> arb_mat:
    return arb_mat([[state[i, 0]] for i in range(state.nrows())] + [[arb(1)]])


def _ball(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


def _decimal(ball: arb) -> str:
    """The nearest double, in the fewest digits that give it back."""
    return repr(float(ball.mid()) + 0.0)


def _shortest(level: Fraction) -> str:
    return str(level) if level.denominator == 1 else repr(float(level))


if __name__ == "__main__":
    for name in sys.argv[1:]:
        (PLANTS / name / "reference.csv").write_text(reference_trace(name), encoding="utf-8")
