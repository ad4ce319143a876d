"""Zeros with much damping: they are zeros beside what the impulses themselves have left, or the answer is "not found"."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from marks import slow

from relaxations.errors import SolverError
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left, require
from suite.cli import main

TURN = 2.0 * math.pi


def sums(shaper: Shaper, mode: Mode, power: int) -> float:
    """|Σ A t^j e^{κωt}| beside the sum of the sizes of its own terms."""
    times, amplitudes = np.array(shaper.times), np.array(shaper.amplitudes)
    terms = amplitudes * times**power * np.exp(mode.frequency * mode.direction * times)
    return float(abs(terms.sum()) / np.abs(terms).sum())


@pytest.mark.parametrize(
    ("kind", "damping", "options", "derivatives", "known"),
    [
        slow("dl-zvd", 0.93, {"deflection": 0.5}, 1, 68 / 24),  # the shortest without a limit takes 2.54 s
        ("dl-zv", 0.99, {"deflection": 0.4}, 0, 93 / 24),  # 3.38 s; 3.54 s would do with partial sums of 1 + 4e-10
        ("zvd", 0.99, {"sample_time": 0.07}, 1, 7.14),
        ("zvd", 0.95, {"sample_time": 0.07}, 1, 3.22),
        ("um-zv", 0.99, {"sample_time": 0.05}, 0, 3.45),  # 3.385 s with free instants
        ("um-zvd", 0.99, {"sample_time": 0.05}, 1, 6.95),  # 6.922 s
    ],
)
def test_what_is_made_with_much_damping_leaves_nothing(
    kind: str, damping: float, options: dict[str, float], derivatives: int, known: float
):
    mode = Mode(TURN, damping)
    found = make(kind, Request((mode,), **options)).shaper  # type: ignore[arg-type]
    assert found.duration == pytest.approx(known, rel=1e-9)
    assert max(sums(found, mode, power) for power in range(derivatives + 1)) < 1e-9


def test_two_modes_of_different_decay_on_samples():
    modes = (Mode(TURN, 0.1), Mode(2.7 * TURN, 0.6))
    found = make("zv", Request(modes, sample_time=0.05)).shaper
    assert max(sums(found, mode, 0) for mode in modes) < 1e-9


def test_a_decay_is_no_zero():
    """What these leave is 1e-9 and less of an unshaped vibration, and all of what their first impulse leaves."""
    mode = Mode(TURN, 0.93)
    for wrong in (Shaper((0.0, 40.0), (1.0, 0.0)), Shaper((0.0, 4.0), (0.5, 0.5)), Shaper((0.0,), (1.0,))):
        assert left(wrong, mode) > 0.9
        with pytest.raises(SolverError, match=r"zv promises zero vibration at 6\.28319 rad/s, damping 0\.93.*closed form"):
            require("zv", wrong, [mode])
    zv = derivative_shaper(mode)
    require("zv", zv, [mode])
    with pytest.raises(SolverError, match="and 1 derivative"):
        require("zvd", zv, [mode], 1)


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        ("si --mode 1Hz:0 --damping 0:0.1 --band 1:1", 0, "frequency × 1 to 1, damping 0 to 0.1: [0.04999999"),
        ("si --mode 1Hz:0.5 --damping 0:0.1", 2, "does not hold the damping of the mode itself (0.5)"),
        ("um-zv-d:21 --mode 1Hz:0.1", 2, "up to 20 are possible"),
        ("um-zv-d:6 --mode 1Hz:0 --mode 2Hz:0 --simultaneous", 2, "28 equations at once; up to 24 are possible"),
        ("um-zv --mode 1Hz:0.99 --mode 3Hz:0.95 --sample-time 0.1", 1, "tried up to a damping of 0.9878"),
        ("pulses-zv --mode 1Hz:0.99 --height 3 --sample-time 0.1", 1, "tried up to a damping of 0.9812"),
        ("pulses-zv-d:20 --mode 1Hz:0.05 --height 3", 2, "up to 24 are possible"),
        ("si --mode 1Hz:0.05 --band 0.1:10", 1, "by a factor of up to 12 are possible"),
        ("dl-zv --mode 1Hz:0.05 --deflection 1e-6", 2, "limits from 0.00083 on are possible"),
        ("um-zv --mode 1Hz:0.02 --sample-time 1", 1, "too coarse"),
        ("um-zv --mode 1Hz:0.02 --sample-time 1e-5", 2, "samples into the shaper"),
        ("zv --mode 1Hz:0 --plot p.png", 2, "--plot p.png: the picture is SVG"),
    ],
)
def test_what_is_not_done_is_told_in_words(words: str, code: int, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["shaper", *words.split()], catch_exceptions=False)
    assert done.exit_code == code
    text = " ".join((done.stdout + done.stderr).split())
    assert told in text
    assert "clarabel" not in text.lower()
    assert not list(tmp_path.iterdir())
