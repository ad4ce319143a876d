"""Five commands for one machine: how long each takes, what is proven of it over the spring's range, and the picture of the README.

    .venv/bin/python docs/two_mass.py          prints the table
    .venv/bin/python docs/two_mass.py FILE     draws the picture, which is docs/two_mass.svg, to FILE

Three commands are those of the studies two_mass_fail, two_mass and two_mass_further_zero; two are what is usual: the fastest move of the
rigid machine, shaped by ZV and ZVD. What a command leaves at most is proven by the checker, as an upper bound over every stiffness of a
range; the curves of the picture are the exact response of the linear plant, stiffness by stiffness.
"""

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from decimal import ROUND_FLOOR, Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np

from relaxations.bounds import Status
from relaxations.commands import Command
from relaxations.maneuvers import problem
from relaxations.response import response
from relaxations.robust.worst import worst_residual
from relaxations.shaping.requests import Request
from reports import charts
from reports.files import write_atomically
from suite.design import design, pose
from suite.loading import load_study
from suite.plants import nominal_plant, plant_at
from suite.study import CommandRequest, ShaperRequest, Study

STUDIES = Path(__file__).parents[1] / "suite" / "studies"
FASTEST = (
    ("fastest for 1 N/m", "two_mass_fail"),
    ("fastest for 0.7 to 1.3 N/m", "two_mass"),
    ("fastest with a further zero", "two_mass_further_zero"),
)
SHAPED = (("rigid move, shaped by ZV", "zv"), ("rigid move, shaped by ZVD", "zvd"))
HEADINGS = ("command", "duration [s]", "fastest of its kind, proven [s]", "leaves, proven", "keeps 5 %, proven [N/m]")
KEPT = Fraction(5, 100)
RANGE = Decimal("0.7"), Decimal("1.3")  # [N/m]
STEP = Decimal("0.01")  # [N/m]: of the curves, and of the range that is kept
STIFFNESS = [k * STEP for k in range(60, 141)]
FARTHEST = Decimal("0.5")  # [N/m] from the nominal stiffness: no farther is looked
WINDOW, SAMPLES = 20.0, 4001  # [s] after the move: four periods of the softest spring, in steps that miss a peak by less than 1e-5 of it


def floored(number: float, places: int) -> Decimal:
    """A lower bound in decimals that still is one."""
    return Decimal(number).quantize(Decimal(1).scaleb(-places), ROUND_FLOOR)


def ceiled(number: Fraction, places: int) -> Decimal:
    """An upper bound in decimals that still is one."""
    return Decimal(math.ceil(number * 10**places)).scaleb(-places)


def residual(study: Study, command: Command, stiffness: Decimal) -> float:
    """Peak of the vibration after the move, in per cent of the move."""
    after = np.linspace(command.end, command.end + WINDOW, SAMPLES)
    moved = response(plant_at(study, {"stiffness": stiffness}), command, after)
    return 100.0 * float(np.ptp(moved)) / 2.0 / float(study.maneuver.scale)


def commands() -> Iterator[tuple[str, Command, str]]:
    """Each command with its name, and what is proven of the fastest of its kind."""
    for name, file in FASTEST:
        made = design(load_study(STUDIES / f"{file}.toml"))
        assert made.command is not None
        assert made.bound.status is Status.PROVED
        yield name, made.command, f"≥ {floored(made.bound.lower, 4)}"
    study = load_study(STUDIES / "two_mass_fail.toml")
    for name, kind in SHAPED:
        made = design(replace(study, command=CommandRequest("shaper", shaper=ShaperRequest(kind, Request(()), reference="rigid"))))
        assert made.command is not None
        yield name, made.command, "–"


def proven(command: Command, low: Decimal, high: Decimal) -> Fraction:
    """What the command leaves at most for every stiffness from low to high [N/m], a fraction of the move."""
    study = load_study(STUDIES / "two_mass.toml")
    posed = pose(study, nominal_plant(study))
    box = posed.maneuver.box
    assert box is not None
    axis = replace(box.axes[0], low=Fraction(low), high=Fraction(high))
    found = worst_residual(problem(posed.plants, replace(posed.maneuver, box=replace(box, axes=(axis,)))), command)
    assert found is not None
    return found.tolerance


def kept(study: Study, command: Command) -> str:
    """The widest range about 1 N/m, in whole steps, in which at most 5 % of the move are left: proven for every stiffness in it."""
    ends = []
    for direction in (-1, 1):
        stiffness = Decimal(1)
        while abs(stiffness - 1) < FARTHEST and residual(study, command, stiffness + direction * STEP) <= 100.0 * float(KEPT):
            stiffness += direction * STEP
        ends.append(stiffness)
    assert proven(command, *ends) <= KEPT
    return f"{ends[0]} to {ends[1]}{' and more' if ends[1] - 1 == FARTHEST else ''}"


def rows() -> Iterator[tuple[str, ...]]:
    """The table, command by command."""
    study = load_study(STUDIES / "two_mass.toml")
    for name, command, least in commands():
        left = Decimal(100) * ceiled(proven(command, *RANGE), 6)
        yield name, f"{command.maneuver_time:.4f}", least, f"≤ {left:.4f} %", kept(study, command)


def draw() -> str:
    """The picture as SVG text that needs no page around it."""
    study = load_study(STUDIES / "two_mass.toml")
    curves = {f"{name}: {command.maneuver_time:.4f} s": [residual(study, command, k) for k in STIFFNESS] for name, command, _ in commands()}
    svg = charts.sensitivity(
        "Residual vibration against stiffness",
        [float(k) for k in STIFFNESS],
        curves,
        factor_label="stiffness of the spring [N/m]",
        quantity_label="residual vibration [% of the move]",
        limits=[charts.Limit(100.0 * float(KEPT), "allowed from 0.7 to 1.3 N/m")],
        band=(float(RANGE[0]), float(RANGE[1])),
    )
    return charts.standalone(svg)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        write_atomically(Path(sys.argv[1]), draw().encode())
    else:
        table = [HEADINGS, *rows()]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        for row in table:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
