"""`slewcert table`: the proven command of many displacements, for controllers that cannot solve a linear program.

A command that moves the plant by Δ, its deviation from rest scaled by s in [0, 1], moves it by s Δ in the same time within the same limits:
so a table serves every displacement up to its largest, and what is lost between two rows is the difference of their times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem, problem
from relaxations.proofs import minimum_time
from suite.design import pose
from suite.errors import Mistake, StudyError, SuiteError
from suite.plants import nominal_plant
from suite.spans import span
from suite.study import Study
from suite.sweeps import extrapolated, kept, sides

MOST_ROWS = 10_000


class TableError(SuiteError):
    """The displacements or the files that are asked for make no sense."""


@dataclass(frozen=True, slots=True)
class Row:
    """One displacement (output units, exact), its bracket with the command, and the file that its proof was written to."""

    displacement: Fraction
    bound: Bound
    certificate: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """A row of `table --json`."""
        bound = self.bound
        record = {
            "displacement": float(self.displacement),
            "status": bound.status.name.lower(),
            "maneuver_time": sides(bound),
            "switches": bound.switches,
            "certificate": None if self.certificate is None else str(self.certificate),
        }
        return record if bound.reason is None else {**record, "reason": bound.reason}


@dataclass(frozen=True, slots=True)
class Table:
    """The rows by ascending displacement; `rest` is the input at the initial rest, `mirrored` says that a command may be turned around."""

    study: Study
    rows: tuple[Row, ...]
    rest: float
    mirrored: bool
    seconds: float

    @property
    def impossible(self) -> bool:
        """Whether there is a displacement that no command does."""
        return any(row.bound.status is Status.IMPOSSIBLE for row in self.rows)

    @property
    def proven(self) -> int:
        """How many rows are proven on both sides."""
        return sum(row.bound.status is Status.PROVED for row in self.rows)

    @property
    def usable(self) -> tuple[Row, ...]:
        """The rows that have a command."""
        return tuple(row for row in self.rows if row.bound.command is not None)

    def to_dict(self) -> dict[str, Any]:
        """The object of `table --json` (docs/schemas.md)."""
        return {"study": str(self.study.file), "rows": [row.to_dict() for row in self.rows], "seconds": round(self.seconds, 6)}


def displacements(text: str) -> tuple[Fraction, ...]:
    """`LO:HI:N` as N equally spaced exact numbers, both ends included; 0, which is no move, is left out. Raises `TableError`."""
    low, high, count = span("--displacements", text, MOST_ROWS, "1:10:100", TableError)
    return tuple(x for i in range(count) if (x := low + (high - low) * Fraction(i, count - 1)))


def tabulate(
    study: Study, asked: tuple[Fraction, ...], certificates: Path | None = None, advance: Callable[[], None] = lambda: None
) -> Table:
    """Bracket the minimum time of every displacement; each search begins where those of its neighbours ended.

    Proofs are written to the folder `certificates`. Raises `StudyError` for a displacement that the study's limits exclude.
    """
    if study.command.alpha is not None:
        raise StudyError(str(study.file), [Mistake("command.alpha", study.command.alpha, "a table is one of the fastest commands")])
    if study.command.kind != "time-optimal":
        raise StudyError(str(study.file), [Mistake("command.kind", study.command.kind, "a table is one of time-optimal commands")])
    if study.limits.pulse_width is not None or study.limits.pulses is not None:
        why = "commands of a table are scaled between its rows, and thrusters are on or off"
        raise StudyError(str(study.file), [Mistake("limits.pulse_width", "", why)])
    if study.plant.schedule is not None:
        why = "commands of a table begin at any time, and this plant varies from the start of the move on"
        raise StudyError(str(study.file), [Mistake("plant.schedule", "", why)])
    if study.maneuver.initial_state is not None:
        why = "commands of a table are scaled between its rows, which only moves from rest allow"
        raise StudyError(str(study.file), [Mistake("maneuver.initial_state", "", why)])
    plant = nominal_plant(study)
    posed = pose(study, plant)
    rows: list[Row] = []
    for i, (displacement, problem_, near) in enumerate(_guessed(study, posed, asked, rows), 1):
        bound = minimum_time(problem_, near=near)
        file = kept(certificates, f"{study.file.stem}.{i:0{len(str(len(asked)))}}", bound)
        rows.append(Row(displacement, bound, file))
        advance()
    mirrored = study.limits.upper - study.plant.initial_input == study.plant.initial_input - study.limits.lower
    seconds = sum(row.bound.seconds for row in rows)
    return Table(study, tuple(sorted(rows, key=lambda row: row.displacement)), float(study.plant.initial_input), mirrored, seconds)


def _guessed(
    study: Study, posed: Problem, asked: tuple[Fraction, ...], done: list[Row]
) -> Iterator[tuple[Fraction, Problem, float | None]]:
    """Every displacement, from the largest of each sign down, with its problem and what the rows before say of its minimum time [s]."""
    order = [x for x in reversed(asked) if x > 0] + [x for x in asked if x < 0]
    box = posed.maneuver.box
    for i, displacement in enumerate(order):
        last = [row for row in done[-2:] if (row.displacement > 0) == (displacement > 0) and row.bound.upper]
        near = extrapolated([(row.displacement, row.bound.upper) for row in last if row.bound.upper], displacement)
        if box is not None and last and last[-1].bound.dual is not None and last[-1].bound.dual.problem.maneuver.box is not None:
            box = last[-1].bound.dual.problem.maneuver.box  # with the places that mattered
        try:
            yield displacement, problem(posed.plants, replace(posed.maneuver, displacement=displacement, box=box)), near
        except ManeuverError as refused:
            mistake = Mistake("maneuver.displacement", float(displacement), f"row {i + 1} of the table: {refused}")
            raise StudyError(str(study.file), [mistake]) from None
