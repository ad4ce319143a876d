"""Benchmark of a sweep of fuel budgets: it prints figures. Times are never judged; what is asked is 60 s on one core."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from suite.fuel_plans import plan
from suite.fuel_sweeps import sweep
from suite.loading import load_study

pytestmark = pytest.mark.benchmark

STUDY = Path(__file__).parents[2] / "suite" / "studies" / "two_mass.toml"


def test_two_hundred_budgets() -> None:
    """From 1 to 7, rigid body, ZV and ZVD, with all pictures' data: 600 minimum times, each proven."""
    begun, spent = time.perf_counter(), time.process_time()
    done = sweep(plan(load_study(STUDY), "1", "7"))
    wall, own = time.perf_counter() - begun, time.process_time() - spent
    points = [point for curve in done.curves for point in curve.points]
    assert len(points) >= 600
    proven = sum(point.status == "proved" for point in points)
    print(f"\n200 budgets of three kinds: {wall:.1f} s, {own:.1f} s of one core, {proven} of {len(points)} proven")


def test_the_whole_command(tmp_path: Path) -> None:
    """`slewcert fuel` as it is typed, its folder of pictures written."""
    command = [sys.executable, "-m", "suite", "fuel", str(STUDY), "--from", "1", "--to", "7", "--out", str(tmp_path / "fuel")]
    begun = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    print(f"\nslewcert fuel --from 1 --to 7: {time.perf_counter() - begun:.1f} s")
