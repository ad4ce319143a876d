"""Small studies that are right, to which a test adds what it is about."""

from __future__ import annotations

from pathlib import Path

import pytest

from suite.errors import StudyError
from suite.loading import load_study
from suite.study import Study

RIGID = """
[plant]
numerator = [1]
denominator = [1, 0, 0]
[maneuver]
displacement = 1
[limits]
input = [-1, 1]
"""

SPRING = """
[plant]
fmu = "two_mass"
input = "force"
output = "position_2"
[maneuver]
displacement = 5.0
[limits]
input = [-1.0, 1.0]
"""

CRANE = """
[plant]
fmu = "gantry_crane"
input = "force"
output = "load"
[maneuver]
displacement = 10.0
[limits]
input = [-3000.0, 3000.0]
"""

BOX = """
[[uncertainty]]
parameter = "stiffness"
range = [0.7, 1.3]
"""

PLANT = "[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n"


def read(folder: Path, text: str) -> Study:
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return load_study(file)


def mistakes(folder: Path, text: str) -> dict[str, str]:
    """Path of every mistake, and the messages there."""
    with pytest.raises(StudyError) as caught:
        read(folder, text)
    found: dict[str, str] = {}
    for mistake in caught.value.mistakes:
        found[mistake.path] = f"{found.get(mistake.path, '')}\n{mistake.message}"
    return found


def requirement(**keys: str) -> str:
    lines = {"id": '"R1"', "quantity": '"residual_vibration"', "max": "0.05"} | keys
    return "[[requirement]]\n" + "".join(f"{key} = {value}\n" for key, value in lines.items() if value)


FORMS = {
    "transfer": "numerator = [0.5]\ndenominator = [1, 0, 1, 0, 0]",
    "roots": "poles = [0, 0, [0, 1], [0.0, -1.0]]\ngain = 0.5",
    "states": "A = [[0,1,0,0],[0,0,0,0],[0,0,0,1],[0,0,-1,0]]\nB = [0,0.5,0,0.5]\nC = [1,0,-1,0]\noutputs = { bend = [0,0,1,0] }",
    "modes": "rigid = 0.5\nmodes = [{ frequency = 1, damping = 0, gain = -0.5 }]",
}
