"""Kinds with a tolerance, and with derivatives, over damping and tolerance: kept and proven, or refused with what is possible."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
from marks import slow

from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.sensitivity import residual
from suite.shaping import assess

DAMPINGS = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99, 0.999)
TOLERANCES = (1e-9, 1e-4, 0.01, 0.05, 0.2, 0.5, 0.9)
KINDS = ("ei", "2-hump-ei", "3-hump-ei", "um-ei", "um-2-hump-ei", "si")
EXACT = ("zv", "zvd", "zv-d:10", "mzv", "um-zv", "um-zvd")
FREQUENCY = float(np.random.default_rng(93).uniform(0.5, 20.0))
ROUNDING = 1e-12  # at the mode: phasors of doubles


def kept(kind: str, damping: float, tolerance: float) -> None:
    mode = Mode(FREQUENCY, damping)
    request = Request((mode,), tolerance=tolerance, bands=() if kind == "si" else ((1.0, 1.0, tolerance),))
    found = assess(kind, request)
    assert math.isclose(math.fsum(found.shaper.amplitudes), 1.0, abs_tol=1e-12)
    assert found.least is None or 0.0 < found.least.duration <= found.shaper.duration
    if found.least is None:
        assert found.notes, "why nothing was proven"
    assert found.worst[1] <= tolerance
    assert float(residual(found.shaper.times, found.shaper.amplitudes, FREQUENCY, damping)[0]) <= tolerance


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "tolerance"), list(itertools.product(DAMPINGS, TOLERANCES)))
@pytest.mark.parametrize("kind", KINDS)
def test_any_damping_and_any_tolerance(kind: str, damping: float, tolerance: float) -> None:
    """Made, or refused with what would be possible."""
    try:
        kept(kind, damping, tolerance)
    except (ShaperError, SolverError) as problem:
        if not re.search(r"\bpossible\b", str(problem)):
            raise


@pytest.mark.parametrize(
    ("kind", "damping", "tolerance"), [("ei", 0.9, 0.2), ("2-hump-ei", 0.99, 1e-9), slow("um-ei", 0.95, 0.05), ("si", 0.99, 1e-4)]
)
def test_some_of_them(kind: str, damping: float, tolerance: float) -> None:
    kept(kind, damping, tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("kind", EXACT)
def test_nothing_is_left_at_any_damping(kind: str, damping: float) -> None:
    if kind == "zv-d:10" and damping == 0.999:
        # Its last amplitude would be smaller than the least double.
        with pytest.raises(ShaperError, match=r"up to a damping of 0\.9988"):
            make(kind, Request((Mode(FREQUENCY, damping),)))
        return
    made = make(kind, Request((Mode(FREQUENCY, damping),)))
    assert made.least is None or 0.0 < made.least.duration <= made.shaper.duration
    assert made.least is not None or made.notes
    assert float(residual(made.shaper.times, made.shaper.amplitudes, FREQUENCY, damping)[0]) <= ROUNDING
