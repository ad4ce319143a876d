"""Reference traces of shipped plants, by ball arithmetic: the matrix exponential of the linear twin with 200 bits.

The trace shares nothing with the FMU's integrator, and every printed digit is right. To write a plant's reference.csv anew:

    .venv/bin/python tests/reference_traces.py two_mass
"""

from __future__ import annotations

import csv
import io
import sys
from fractions import Fraction
from pathlib import Path

import flint
from flint import arb, arb_mat, fmpq

PLANTS = Path(__file__).parents[1] / "fmus" / "plants"
BITS = 200

# Full force one way and the other, antisymmetric, then none: start [s] and level [input unit].
BANG_BANG = (("0", 1), ("1.0027", -1), ("2.109", 1), ("3.2153", -1), ("4.218", 0))
STEP, STOP = Fraction(1, 10), 12  # s


def reference_trace(plant: str) -> str:
    """The text of reference.csv: at each instant the input from then on, the states and the other outputs."""
    from fmus.twins import read_twin

    twin = read_twin((PLANTS / plant / "twin.toml").read_text(encoding="utf-8"))
    jumps = [(Fraction(start), level) for start, level in BANG_BANG]
    times = sorted({*(start for start, _ in jumps), *(k * STEP for k in range(int(STOP / STEP) + 1))})
    outputs = [name for name in twin.outputs if name not in twin.states]
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["time", twin.input, *twin.states, *outputs])
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        state = arb_mat([[0] for _ in twin.states])
        for now, following in zip(times, [*times[1:], times[-1]], strict=True):
            level = next(level for start, level in reversed(jumps) if start <= now)
            rows = [[_ball(x) for x in twin.outputs[name][0]] for name in outputs]
            values = [state[i, 0] for i in range(len(twin.states))] + [(arb_mat([row]) * state)[0, 0] for row in rows]
            writer.writerow([_decimal(_ball(now)), level, *map(_decimal, values)])
            # Over an interval of constant input, exp of the matrix [[A, B u], [0, 0]] carries (x, 1) along.
            augmented = [[_ball(x) for x in row] + [_ball(b * level)] for row, b in zip(twin.A, twin.B, strict=True)]
            step = (arb_mat([*augmented, [arb(0)] * (len(twin.states) + 1)]) * _ball(following - now)).exp()
            state = arb_mat([[(step * _with_one(state))[i, 0]] for i in range(len(twin.states))])
    finally:
        flint.ctx.prec = before
    return table.getvalue()


def _with_one(state: arb_mat) -> arb_mat:
    return arb_mat([[state[i, 0]] for i in range(state.nrows())] + [[arb(1)]])


def _ball(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


def _decimal(ball: arb) -> str:
    """The nearest double, in the fewest digits that give it back."""
    return repr(float(ball.mid()) + 0.0)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        (PLANTS / name / "reference.csv").write_text(reference_trace(name), encoding="utf-8")
