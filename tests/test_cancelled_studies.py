"""Studies with `kind = "pole-zero"`: the filtered command against its bracket, on the FMU, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from marks import slow
from small_studies import SHIPPED, results

from relaxations.response import response
from suite.checks import check_path
from suite.cli import main
from suite.design import Design, design
from suite.errors import StudyError
from suite.loading import load_study
from suite.verification import verify

PLANTS = {
    "pitch": "numerator = [1.151, 0.1774]\ndenominator = [1, 0.739, 2.072, 0.1774]",
    "one zero": "numerator = [1, 1]\ndenominator = [1, 0, 2]",
    "backward": "numerator = [-1, 1]\ndenominator = [1, 0.2, 2]",
    "cart": "numerator = [1, 1]\ndenominator = [1, 0, 0]",
    "hidden": "numerator = [1, 4, 3]\ndenominator = [1, 3, 2, 6]",
    "unstable": "numerator = [1, 1]\ndenominator = [1, 0, -2]",
}


def study(folder: Path, plant: str, *keys: str, limits: str = "input = [-5.0, 5.0]", displacement: float = 1.0) -> Path:
    file = folder / "study.toml"
    file.write_text(
        f"[plant]\n{PLANTS[plant]}\n[maneuver]\ndisplacement = {displacement}\n[limits]\n{limits}\n[command]\n"
        + "\n".join(('kind = "pole-zero"', *keys)),
        encoding="utf-8",
    )
    return file


def made(folder: Path, *words: str, **more: Any) -> Design:
    return design(load_study(study(folder, *words, **more)))


@pytest.mark.parametrize(
    ("plant", "keys", "limits", "displacement", "time"),
    [
        ("one zero", ("delays = 1",), "input = [-5.0, 5.0]", 1.0, 1.5459306102),
        ("one zero", ("delays = 1",), "input = [-5.0, 5.0]", -0.7, 1.5459306102),
        ("one zero", ("delays = 1", "tail = false"), "input = [-5.0, 5.0]", 1.0, 2.2214414691),
        ("one zero", ("delays = 1", 'form = "last+step"', "monotone = true"), "input = [0.0, 5.0]", 1.0, 1.5459306102),
        ("pitch", ("delays = 1", 'form = "last+step"'), "input = [-0.35, 0.35]", 0.2, 2.3672493903),
        ("pitch", ("delays = 2", "tail = false", "gains = [-0.35, 2.0]"), "input = [-9, 9]", 0.2, 4.2744016911),
        ("pitch", ("delays = 2", 'form = "last+step"', "robustness = 1"), "input = [-0.35, 0.35]", 0.2, 4.8107659262),
        ("pitch", ("delays = 2", 'form = "last+step"', "robustness = { 'mode[1]' = 1 }"), "input = [-0.35, 0.35]", 0.2, 4.8107659262),
    ],
)
def test_the_filtered_command_is_no_better_than_its_proven_bound(
    tmp_path: Path, plant: str, keys: tuple[str, ...], limits: str, displacement: float, time: float
) -> None:
    done = made(tmp_path, plant, *keys, limits=limits, displacement=displacement)
    assert done.command is not None
    assert done.command.maneuver_time == pytest.approx(time, abs=6e-11)
    assert done.bound.status.name == "PROVED"
    assert done.bound.lower <= done.command.maneuver_time * (1 + 1e-12)
    late = done.command.end + np.linspace(1e-9, 40.0, 400)
    assert np.abs(response(done.plant, done.command, late) - displacement).max() < 1e-9 * abs(displacement)
    low, high = done.command.extent()
    assert done.problem.lower - 1e-9 <= low <= high <= done.problem.upper + 1e-9


def test_a_rigid_body_is_moved_and_left_without_input(tmp_path: Path) -> None:
    done = made(tmp_path, "cart", "delays = 2", 'form = "last+step"', limits="input = [-1.0, 1.0]")
    assert done.command is not None
    assert done.command.tail.steady == 0.0
    assert done.bound.lower <= done.command.maneuver_time <= done.bound.lower * (1 + 1e-6)


def test_delays_on_samples(tmp_path: Path) -> None:
    done = made(tmp_path, "one zero", "delays = 1", 'form = "last+step"', "monotone = true", "sample_time = 0.1")
    assert done.command is not None
    assert done.command.maneuver_time == pytest.approx(1.6, abs=1e-12)
    given = made(tmp_path, "one zero", "delays = 1", 'form = "last+step"', "monotone = true", "instants = [1.6]")
    assert given.command is not None
    assert given.command.tail.terms[0].coefficient == pytest.approx(done.command.tail.terms[0].coefficient, abs=1e-12)


@pytest.mark.slow
def test_without_a_tail_hidden_modes_come_to_rest_too(tmp_path: Path) -> None:
    """(s + 1)(s + 3)/((s² + 2)(s + 3)): the bracket of state rest is about the mode at -3 as well, and so is the filter."""
    file = study(tmp_path, "hidden", "delays = 2", "tail = false", "gains = [-2.0, 3.0]")
    done = design(load_study(file))
    assert done.command is not None
    assert done.cancelled is not None
    assert abs(done.cancelled.prefilter(-3.0)) < 1e-11  # e^{3T} times rounding
    assert done.bound.lower <= done.command.maneuver_time


def test_samples_of_the_controller_hold_the_delays(tmp_path: Path) -> None:
    done = made(tmp_path, "one zero", "delays = 2", "tail = false", limits="input = [-5.0, 5.0]\nsample_time = 0.25")
    assert done.command is not None
    assert all(at / 0.25 == pytest.approx(round(at / 0.25), abs=1e-9) for at in done.command.breakpoints)
    assert done.bound.lower <= done.command.maneuver_time * (1 + 1e-12)


@pytest.mark.slow
def test_a_short_tail_is_asked_for(tmp_path: Path) -> None:
    keys = ("delays = 2", 'form = "last+step"')
    short = made(tmp_path, "pitch", *keys, limits="input = [-0.5, 0.5]\ntail_length = { time = 1.0, within = 0.05 }", displacement=0.2)
    assert short.command is not None
    assert abs(short.command.tail(1.0) - 0.2) <= 0.05 * 0.3 * (1 + 1e-6)
    assert short.bound.lower <= short.command.maneuver_time * (1 + 1e-12)


@pytest.mark.parametrize(
    ("plant", "keys", "limits", "path", "words"),
    [
        ("one zero", (), "input = [-5, 5]", "command.delays", "is missing"),
        ("one zero", ("delays = 0",), "input = [-5, 5]", "command.delays", "whole number from 1 on"),
        ("one zero", ("delays = 1", 'form = "lost"'), "input = [-5, 5]", "command.form", "names no delayed term"),
        ("one zero", ("delays = 1", 'form = "first"'), "input = [-9, 9]", "command.form", "slewcert prefilter"),
        ("one zero", ("delays = 1", 'zeros = ["zero[2]"]'), "input = [-5, 5]", "command.zeros", "1 distinct zeros"),
        ("one zero", ("delays = 1", 'zeros = ["pole[1]"]'), "input = [-5, 5]", "command.zeros[1]", "zero[1]"),
        ("one zero", ("delays = 1", 'robustness = "box"'), "input = [-5, 5]", "command.robustness", "further zeros"),
        ("one zero", ("delays = 1", "tolerance = 0.05"), "input = [-5, 5]", "command.tolerance", "means nothing"),
        ("one zero", ("delays = 1", 'shaper = "zv"'), "input = [-5, 5]", "command.shaper", "means nothing"),
        ("one zero", ("delays = 1", "instants = [1, 2]"), "input = [-5, 5]", "command.instants", "as many as the delays"),
        ("one zero", ("delays = 1",), "input = [-5, 5]\nrate = [-1, 1]", "limits.rate", "slopes"),
        ("one zero", ("delays = 1",), "input = [-5, 5]\npulses = 3", "limits.pulses", "any height"),
        ("pitch", ("delays = 1",), "input = [-5, 5]\ndeflection = { output = 2 }", "command.delays", "it takes 2 delays"),
        slow(
            *("pitch", ("delays = 1", 'form = "last+step"'), "input = [-5, 5]\ndeflection = { output_rate = 0.6 }"),
            *("command.delays", "strays by"),
        ),
        ("pitch", ("delays = 11", 'form = "last+step"'), "input = [-5, 5]", "command.delays", "more than 10 free delays"),
        ("backward", ("delays = 1", 'zeros = ["zero[1]"]'), "input = [-5, 5]", "command.zeros", "right of the imaginary axis"),
        ("unstable", ("delays = 2", "tail = false"), "input = [-5, 5]", "command.kind", "unstable poles"),
        ("cart", ("delays = 2", 'form = "last+step"'), "input = [-1, 1]\nfuel = 0.3", "command.delays", "fuel"),
        (
            *("pitch", ("delays = 1", 'form = "last+step"'), "input = [-5, 5]"),
            *('command.delays', "zero_sensitivity"),
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told(tmp_path: Path, plant: str, keys: tuple[str, ...], limits: str, path: str, words: str) -> None:
    if words == "zero_sensitivity":
        limits += '\nzero_sensitivity = { "zero[1]" = { shift = 0.1, residual = 0.0001 } }'
    with pytest.raises(StudyError) as caught:
        made(tmp_path, plant, *keys, limits=limits)
    told = {mistake.path: mistake.message for mistake in caught.value.mistakes}
    assert words in told[path], told


def test_bound_tells_the_filter_and_what_is_impossible(tmp_path: Path) -> None:
    def run(*words: str) -> Any:
        return CliRunner().invoke(main, ["bound", *words], catch_exceptions=False)

    file = study(tmp_path, "one zero", "delays = 1")
    done = run(str(file), "--json")
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert found["prefilter"]["duration"] == pytest.approx(1.5459306102, abs=6e-11)
    assert found["prefilter"]["residual"] < 1e-14
    assert found["prefilter"]["command"]["maneuver_time"] >= found["maneuver_time"]["lower"]
    assert "through the filter" in run(str(file)).stdout
    tight = study(tmp_path, "one zero", "delays = 1", "gains = [0.0, 0.1]")
    done = run(str(tight))
    assert (done.exit_code, "within the bounds" in done.stderr) == (1, True)


@pytest.mark.slow
def test_the_published_reference_on_the_aircraft(tmp_path: Path) -> None:
    verify(load_study(SHIPPED / "aircraft_pitch_cancelled.toml"), tmp_path / "out", jobs=1)
    found = results(tmp_path / "out")
    assert found["prefilter"]["delays"][1:] == pytest.approx([2.2520627528, 4.8107659262], abs=6e-11)
    worst = max(run["quantities"]["residual_vibration"]["value"] for run in found["run_table"])
    assert 0.01 < worst < 0.015
    assert check_path(tmp_path / "out", None).exit_code == 0
