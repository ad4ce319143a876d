"""`slewcert prefilter`: the published filters from a study's plant, files and pictures, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from small_studies import SHIPPED

from relaxations.cancelling.answers import output, tail_length, zero_sensitivities
from relaxations.cancelling.closed_forms import pole_first, pole_last
from relaxations.cancelling.prefilters import Prefilter
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.modes import Mode
from suite.cli import main

PITCH = "numerator = [1.151, 0.1774]\ndenominator = [1, 0.739, 2.072, 0.1774]"
DIGITS = 6e-11


def run(*words: object) -> Any:
    return CliRunner().invoke(main, ["prefilter", *map(str, words)], catch_exceptions=False)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "pitch.toml"
    file.write_text(f"[plant]\n{PITCH}\n[maneuver]\ndisplacement = 0.2\n[limits]\ninput = [-0.35, 0.35]\n", encoding="utf-8")
    return file


def found(*words: object) -> dict[str, Any]:
    done = run(*words, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_the_published_filters(study: Path) -> None:
    nominal = found(study, "--delays", 1, "--form", "last+step")
    assert nominal["duration"] == pytest.approx(2.3672493903, abs=DIGITS)
    assert nominal["minimum_time"]["lower"] <= nominal["duration"]
    assert nominal["residual"] < 1e-14
    robust = found(study, "--delays", 2, "--form", "last+step", "--robustness", 1)
    assert robust["prefilter"]["delays"][1:] == pytest.approx([2.2520627528, 4.8107659262], abs=DIGITS)
    steps = found(study, "--delays", 2, "--zeros", "none", "--gains", "-0.35:2", "--unbounded")
    assert steps["duration"] == pytest.approx(4.2744016911, abs=DIGITS)
    assert (steps["bounded"], steps["prefilter"]["terms"], steps["zero_sensitivity"]) == (False, [], {})


def test_a_study_of_filters_says_what_is_left_out(study: Path) -> None:
    study.write_text(study.read_text() + '[command]\nkind = "pole-zero"\ndelays = 1\nform = "last+step"\n')
    assert found(study)["duration"] == pytest.approx(2.3672493903, abs=DIGITS)
    given = found(study, "--instants", "1.2,2.5")
    assert given["duration"] == 2.5


@pytest.mark.slow
def test_files_and_pictures(study: Path, tmp_path: Path) -> None:
    done = run(study, "--delays", 1, "--form", "last+step", "--save", tmp_path / "f.json", "--plot", tmp_path / "f.svg")
    assert done.exit_code == 0
    assert "any command within the limits that brings the output to rest: [" in done.stdout
    assert "zero[1] elsewhere by 1%" in done.stdout
    kept = Prefilter.from_json((tmp_path / "f.json").read_text())
    assert kept.duration == pytest.approx(2.3672493903, abs=DIGITS)
    picture = (tmp_path / "f.svg").read_text()
    assert "last delay, 2.3672 s" in picture
    for label in ("tail", "final level, 0.2", "limits, -0.35 and 0.35", "pitch: filter of form last+step"):
        assert f">{label}<" in picture
    assert run(study, "--delays", 2, "--zeros", "none", "--plot", tmp_path / "f.svg").exit_code == 0
    assert ">tail<" not in (tmp_path / "f.svg").read_text()


def test_every_form_has_a_filter(study: Path) -> None:
    done = run(study, "--delays", 1, "--form", "first+step", "--unbounded")
    assert done.exit_code == 0
    assert "0.0000000000" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        ((), 2, "--delays is missing"),
        (("--delays", 0), 2, "--delays"),
        (("--delays", 1, "--form", "middle"), 2, "names no delayed term"),
        (("--delays", 1), 2, "it takes 2 delays"),
        (("--delays", 1, "--form", "last+step", "--gains", "0:0.01"), 1, "impossible: no filter of this form"),
        (("--delays", 1, "--form", "last+step", "--gains", "2"), 2, "LOW:HIGH"),
        (("--instants", "2,1"), 2, "ascend"),
        (("--instants", "1", "--sample-time", "0.1"), 2, "one of them"),
        (("--sample-time", "nan"), 2, "more than 0 s"),
        (("--instants", "1", "--delays", 2), 2, "contradicts"),
        (("--delays", 1, "--zeros", "zero[1]"), 2, "numbers of the plant's zeros"),
        (("--delays", 1, "--zeros", "4"), 2, "1 distinct zeros"),
        (("--delays", 2, "--form", "last+step", "--monotone"), 1, "real pole"),
        (("--delays", 1, "--form", "last+step", "--plot", "x.png"), 2, "SVG"),
    ],
)
def test_what_is_wrong_is_told(study: Path, words: tuple[object, ...], code: int, told: str) -> None:
    done = run(study, *words)
    assert (done.exit_code, told in done.stderr) == (code, True), done.stderr


def test_a_box_needs_the_number_of_zeros() -> None:
    done = run(SHIPPED / "two_mass.toml", "--delays", 3)
    assert (done.exit_code, "--robustness is missing" in done.stderr) == (2, True)


ONE_ZERO = LinearPlant.from_transfer([1, 1], [1, 0, 2])


def test_the_output_is_the_sum_of_what_starts_at_each_delay() -> None:
    times = np.linspace(0.0, 8.0, 300)
    last = pole_last(Mode(2**0.5), [-1.0])
    assert output(ONE_ZERO, last, times) == pytest.approx(response(ONE_ZERO, last.command(1.0), times), abs=1e-12)
    first = pole_first(Mode(2**0.5), [-1.0])
    assert output(ONE_ZERO, first, times)[times > first.duration] == pytest.approx(1.0, abs=1e-12)


def test_a_zero_that_is_elsewhere_leaves_what_is_said() -> None:
    """To first order: the plant's zero is moved by 0.01 % of its magnitude, its static gain kept."""
    done = pole_last(Mode(2**0.5), [-1.0])
    (said,) = zero_sensitivities(ONE_ZERO, done).values()
    shift = 1e-4
    beside = LinearPlant.from_transfer([1 / (1 + shift), 1], [1, 0, 2])
    late = done.duration + np.linspace(0.0, 30.0, 500)
    left = output(beside, done, late) - 1.0
    forced = said * shift * np.exp(-(late - done.duration))
    columns = np.stack([np.exp(-(late - done.duration)), np.cos(2**0.5 * late), np.sin(2**0.5 * late)], axis=1)
    coefficients = np.linalg.lstsq(columns, left, rcond=None)[0]  # and what moved gains leave of the mode
    assert abs(coefficients[0]) == pytest.approx(forced[0], rel=1e-3)  # second order in the shift


def test_the_length_of_a_tail() -> None:
    done = pole_last(Mode(2**0.5), [-1.0])
    tail = done.reference(done.duration + np.array([tail_length(done, 0.01)])) - done.gain
    largest = done.gain  # the tail rises to it
    assert abs(tail[0]) == pytest.approx(0.01 * largest, rel=0.02)  # one of 4001 instants over 40 time constants
    assert tail_length(pole_last(Mode(1.0), []), 0.01) == 0.0
