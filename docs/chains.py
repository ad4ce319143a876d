"""What a proof costs against the number of poles: free-free chains of unit masses and springs, force on the first, 5 m, |u| ≤ 1 N.

    .venv/bin/python docs/chains.py [MOST_POLES] [FILE]

Prints the table of docs/theory.md, section 7, and draws docs/chains.svg. Seconds are the processor's, and those of a second solve in the
process, but for chains whose first takes more than ten.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Check, check
from relaxations.checking.reading import MOST_POLES
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.polishing import BITS, BITS_PER_EQUATION
from relaxations.proofs import minimum_time
from reports import charts
from reports.files import write_atomically

POLES = (4, 8, 12, 22, 40, 60, 80, 100, 120, 150, 200)
PATIENCE, WARM = 600.0, 10.0  # [s]
HEADINGS = ("poles", "switches", "lower [s]", "upper [s]", "gap", "seconds", "of these check", "condition", "bits", "bits of check")


@dataclass(frozen=True)
class Row:
    """One chain: what was found, in how many seconds, and the checker's verdict once more, in how many of its own."""

    poles: int
    bound: Bound
    seconds: float
    checked: Check
    checking: float

    def cells(self) -> tuple[str, ...]:
        """As the table shows it; the condition is that of the modal equations, 1 where doubles do."""
        bound, frame = self.bound, self.bound.dual.problem.frame if self.bound.dual else None
        return (
            f"{self.poles}",
            f"{bound.switches}",
            f"{bound.lower!r}",
            f"{bound.upper!r}",
            f"{bound.gap:.1e}",
            f"{self.seconds:.2f}",
            f"{self.checking:.2f}",
            f"{frame.condition:.0e}" if frame else "1",
            f"{BITS + BITS_PER_EQUATION * self.poles}",
            f"{self.checked.bits}",
        )


def chain(masses: int) -> Problem:
    """n unit masses and n - 1 unit springs on a line, nothing else; the output is the position of the last mass."""
    n = masses
    rows = [[0] * (2 * n) for _ in range(2 * n)]
    for i in range(n):
        rows[i][n + i] = 1
        for j in {i - 1, i + 1} & set(range(n)):
            rows[n + i][j] += 1
            rows[n + i][i] -= 1
    plant = LinearPlant.from_state_space(rows, [int(i == n) for i in range(2 * n)], [int(i == n - 1) for i in range(2 * n)])
    return problem([plant], Maneuver(Fraction(5), Limits.of(-1, 1)))


def timed(posed: Problem) -> tuple[Bound, float]:
    """The proven bracket, and the seconds that it took."""
    begun = time.process_time()
    bound = minimum_time(posed)
    return bound, time.process_time() - begun


def measured(most: int) -> Iterator[Row]:
    """Chain by chain until one is not proven, takes too long, or has more poles than the checker reads."""
    for poles in POLES:
        if poles > most:
            return
        posed = chain(poles // 2)
        bound, seconds = timed(posed)
        if seconds < WARM:
            bound, seconds = timed(posed)
        assert bound.certificate is not None
        begun = time.process_time()
        checked = check(bound.certificate)
        yield Row(poles, bound, seconds, checked, time.process_time() - begun)
        if bound.status is not Status.PROVED or seconds > PATIENCE:
            print(f"ends at {poles} poles: {bound.reason or f'more than {PATIENCE:.0f} s'}")
            return
    print(f"ends here: the checker reads plants of at most {MOST_POLES} poles")


def draw(rows: list[Row]) -> str:
    """The picture as SVG text that needs no page around it."""
    curves = {
        "search and proof": [row.seconds for row in rows],
        "of these: checking the certificate": [row.checking for row in rows],
    }
    svg = charts.costs(
        "Cost of a proof against the number of poles",
        [row.poles for row in rows],
        curves,
        size_label="poles of the chain",
        cost_label="processor time [s]",
    )
    return charts.standalone(svg)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    done, widths = [], (5, 8, 18, 18, 7, 7, 14, 9, 4, 13)
    print("  ".join(cell.rjust(width) for cell, width in zip(HEADINGS, widths, strict=True)))
    for row in measured(int(arguments[0]) if arguments else MOST_POLES):
        done.append(row)
        print("  ".join(cell.rjust(width) for cell, width in zip(row.cells(), widths, strict=True)), flush=True)
    write_atomically(Path(arguments[1]) if len(arguments) > 1 else Path(__file__).with_suffix(".svg"), draw(done).encode())
