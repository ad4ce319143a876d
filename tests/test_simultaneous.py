"""One solution for all modes: what it keeps, that it is shorter than a convolution, close modes, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from independent_shaping import shortest_positive
from test_shaper_command import record, run

from relaxations.shaping.humps import extra_insensitive
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import residual


@pytest.mark.parametrize(
    ("kind", "modes"),
    [
        ("ei", ("1Hz:0.1", "1.3Hz:0.05")),
        pytest.param("ei", ("1Hz:0", "2.7Hz:0"), marks=pytest.mark.slow),
        pytest.param("2-hump-ei", ("1Hz:0.05", "2.2Hz:0"), marks=pytest.mark.slow),
    ],
)
def test_humps_for_several_modes_keep_the_range_of_each(kind: str, modes: tuple[str, ...]):
    words = [word for mode in modes for word in ("--mode", mode)]
    both, turn = record(kind, *words, "--simultaneous"), record(kind, *words)
    assert both["duration"] < 0.95 * turn["duration"]
    # The program's samples lie a hair inside the tolerance, and the bound a hair below the duration.
    assert both["duration"] * (1 - 1e-5) <= both["least_duration"]["lower"] <= both["duration"]
    assert [kept["mode"] for kept in both["ranges"]] == [1, 2]
    for kept, mode in zip(both["ranges"], both["modes"], strict=True):
        assert 0.0 < kept["worst_residual"][0] <= kept["worst_residual"][1] <= 0.05
        low, high = kept["frequency"]
        factors = np.linspace(low, high, 3001)
        assert residual(both["times"], both["amplitudes"], factors * mode["frequency"], mode["damping"]).max() <= 0.05
        own = extra_insensitive(Mode(mode["frequency"], mode["damping"]), 0.05, 1 if kind == "ei" else 2).shaper
        ends = residual(own.times, own.amplitudes, np.array([low, high]) * mode["frequency"], mode["damping"])
        assert ends == pytest.approx([0.05, 0.05], abs=1e-5)  # ends are whole millionths of the frequency
    swapped = record(kind, *words[2:], *words[:2], "--simultaneous")
    assert swapped["duration"] == pytest.approx(both["duration"], rel=1e-6)


@pytest.mark.slow
def test_a_linear_program_of_its_own_finds_no_shorter_one():
    """Circles replaced by polygons around them, sampled more finely: its shortest duration on a grid is not below what is proven."""
    found = record("ei", "--mode", "1Hz:0", "--mode", "2.7Hz:0", "--simultaneous")
    demands = []
    for kept, mode in zip(found["ranges"], found["modes"], strict=True):
        low, high = kept["frequency"]
        demands += [(f * mode["frequency"], mode["damping"], 0.05) for f in np.linspace(low, high, 41)]
    shortest = shortest_positive(demands, cells=160, corners=32)
    assert found["least_duration"]["lower"] <= shortest * (1 + 1e-3)  # the program sees 41 frequencies of each range
    assert shortest == pytest.approx(found["duration"], rel=0.01)  # a grid of 160 cells, circles smaller by 0.5 %


@pytest.mark.parametrize("second", ["1.001Hz", *(pytest.param(f, marks=pytest.mark.slow) for f in ("1.05Hz", "1.00001Hz"))])
@pytest.mark.parametrize("kind", ["zv", "um-zv", *(pytest.param(k, marks=pytest.mark.slow) for k in ("si", "ei", "zvd"))])
def test_close_modes_need_little_more_than_one(kind: str, second: str):
    words = ("--mode", "1Hz:0.05", "--mode", f"{second}:0.05")
    both, turn = record(kind, *words, "--simultaneous"), record(kind, *words)
    # Two um-zv shapers in a row leave [0, 1] and may be shorter than any that does not.
    assert kind == "um-zv" or both["duration"] <= turn["duration"] * (1 + 1e-3)
    assert turn["duration"] * 0.3 < both["least_duration"]["lower"] <= both["duration"]
    allowed = 0.05 if kind in ("si", "ei") else 1e-9
    assert max(float(residual(both["times"], both["amplitudes"], m["frequency"], 0.05)[0]) for m in both["modes"]) <= allowed


def test_close_modes_without_a_tolerance_become_a_derivative():
    """Zeros at 1 and 1.00001 Hz are but for 1e-5 a double zero: the zvd shaper's duration, from below."""
    found = record("zv", "--mode", "1Hz:0", "--mode", "1.00001Hz:0", "--simultaneous")
    assert found["duration"] == pytest.approx(1.0 - 0.5e-5, abs=1e-8)
    assert found["amplitudes"] == pytest.approx([0.25, 0.5, 0.25], abs=1e-7)
    assert found["times"][1] * 2 == pytest.approx(found["duration"], rel=1e-6)
    assert math.isclose(found["duration"], 2 / (1 + 1.00001), rel_tol=1e-8)  # cos(ωt/2) = 0 halfway between both


def test_what_names_no_single_solution_is_refused_with_what_does():
    done = run("mzv", "--mode", "1Hz:0", "--mode", "2Hz:0", "--simultaneous")
    assert done.exit_code == 2
    assert all(word in done.stderr for word in ("3/4 of one mode's period", "convolved", "zv with it"))
