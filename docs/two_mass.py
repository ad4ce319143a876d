"""Draw the picture of the README, docs/two_mass.svg: what each study's command leaves of the move, against the spring's true stiffness.

    .venv/bin/python docs/two_mass.py [FILE]

The commands are those of the paired studies two_mass and two_mass_fail; the curves are the exact response of the linear plant.
"""

import sys
from decimal import Decimal
from pathlib import Path

import numpy as np

from relaxations.commands import Command
from relaxations.response import response
from reports import charts
from reports.files import write_atomically
from suite.collection import bracket
from suite.plants import plant_at
from suite.study import Study

STUDIES = Path(__file__).parents[1] / "suite" / "studies"
STIFFNESS = [Decimal(k) / 100 for k in range(60, 141)]  # [N/m]
WINDOW, SAMPLES = 20.0, 4001  # [s] after the move: four periods of the softest spring, in steps that miss a peak by less than 1e-5 of it


def residual(study: Study, command: Command, stiffness: Decimal) -> float:
    """Peak of the vibration after the move, in per cent of the move."""
    after = np.linspace(command.end, command.end + WINDOW, SAMPLES)
    moved = response(plant_at(study, {"stiffness": stiffness}), command, after)
    return 100.0 * float(np.ptp(moved)) / 2.0 / float(study.maneuver.scale)


def draw() -> str:
    """The picture as SVG text that needs no page around it."""
    curves: dict[str, list[float]] = {}
    for name, label in (("two_mass_fail", "fastest"), ("two_mass", "fastest with one further zero at the mode")):
        done = bracket(STUDIES / f"{name}.toml")
        command = done.design.command
        assert command is not None
        curves[f"{label}: {command.maneuver_time:.4f} s"] = [residual(done.study, command, k) for k in STIFFNESS]
    svg = charts.sensitivity(
        "Residual vibration against stiffness",
        [float(k) for k in STIFFNESS],
        curves,
        factor_label="stiffness of the spring [N/m]",
        quantity_label="residual vibration [% of the move]",
        limits=[charts.Limit(5.0, "allowed from 0.7 to 1.3 N/m")],
    )
    return charts.standalone(svg)


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_suffix(".svg")
    write_atomically(file, draw().encode())
