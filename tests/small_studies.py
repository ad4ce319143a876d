"""Studies of the two-mass plant that are quickly verified, and what their tests look at in the evidence."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import suite

SHIPPED = Path(suite.__path__[0]) / "studies"

OBSERVED = 12.0  # s after the move: two of the slowest periods within the boxes here, so that a run takes milliseconds

SPRING_STUDY = """
[plant]
numerator = [1.0]
denominator = [1.0, 0.0, 2.0, 0.0, 0.0]
[maneuver]
displacement = 5.0
[limits]
input = [-1.0, 1.0]
"""
"""The two masses as a transfer function, without a parameter that could vary; lines that follow are further limits."""


def small_study(folder: Path, *more: str, fmu: str = "two_mass", samples: int = 3, limit: float = 0.5, name: str = "study.toml") -> Path:
    """A study file with `samples` stiffnesses; `more` are further lines at its end."""
    box = f'[[uncertainty]]\nparameter = "stiffness"\nrange = [0.8, 1.2]\nsamples = {samples}\n' if samples else ""
    text = f"""
title = "Small"
[plant]
fmu = "{fmu}"
input = "force"
output = "position_2"
[maneuver]
displacement = 5.0
[limits]
input = [-1.0, 1.0]
[simulation]
observe = {OBSERVED}
timeout = 20
{box}
[[requirement]]
id = "RESIDUAL"
quantity = "residual_vibration"
max = {limit}
[[requirement]]
id = "TIME"
quantity = "maneuver_time"
max = 8
unit = "s"
scope = "nominal"
"""
    file = folder / name
    file.write_text(text + "\n".join(more) + "\n", encoding="utf-8")
    return file


KEEP_ALL = '[keep]\nlogs = "all"'


def results(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "results.json").read_bytes())


def run_table(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows of the run table by the runs' names."""
    return {row["run"]: row for row in results(folder)["run_table"]}


def digests(folder: Path, pattern: str = "**/*") -> dict[str, str]:
    """SHA-256 of every file that matches, by its path within the folder."""
    found = [path for path in sorted(folder.glob(pattern)) if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}
