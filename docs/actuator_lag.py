"""The thesis of Tuttle and Seering (1996) in numbers: what a command is worth that was designed without the plant's real mode.

    .venv/bin/python docs/actuator_lag.py

Designs `actuator_lag_ignored` and `actuator_lag_included` of the problem collection and sends both commands through the plant that has the
real mode, in closed form.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from relaxations.response import response
from suite.collection import bracket
from suite.plants import nominal_plant

PROBLEMS = Path(__file__).parents[1] / "suite" / "problems"
TIMES = np.linspace(0.0, 40.0, 400_001)  # [s]; until twenty time constants of the actuator have passed
BANDS = (0.02, 0.001)  # of the move
HEADINGS = ("real mode", "minimum time, proven [s]", "missing at its end", "within 2 % from", "within 0.1 % from")


def rows() -> Iterator[tuple[str, ...]]:
    """For each command its proven bracket, how much of the move is missing when it ends, and from when on the output is there to stay."""
    ignored, included = (bracket(PROBLEMS / f"actuator_lag_{name}.toml") for name in ("ignored", "included"))
    true = nominal_plant(included.study)
    for name, done in (("ignored", ignored), ("included", included)):
        command, bound = done.design.command, done.design.bound
        assert command is not None
        missing = 1.0 - response(true, command, TIMES) / float(done.study.maneuver.displacement)
        settled = (TIMES[np.flatnonzero(np.abs(missing) > band)[-1] + 1] for band in BANDS)
        at_end = abs(missing[np.searchsorted(TIMES, command.end)])
        yield name, f"[{bound.lower!r}, {bound.upper!r}]", f"{100 * at_end:.1f} %", *(f"{time:.2f} s" for time in settled)


if __name__ == "__main__":
    table = [HEADINGS, *rows()]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
