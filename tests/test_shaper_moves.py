"""Moves designed together with their shaper: known times, independent integration of what is left, the certificate, the command line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from marks import slow

from relaxations.bounds import Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command
from relaxations.errors import ShaperError
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping import banded_moves
from relaxations.shaping.banded_moves import within_each
from relaxations.shaping.bands import Band
from relaxations.shaping.impulses import derivative_shaper, negative_zv
from relaxations.shaping.modes import Mode
from relaxations.shaping.moves import Move, gaps, hulls, in_turn, left_over, rigid, with_zeros, within_bands
from suite.cli import main

MODE = Mode(2 * math.pi, 0.05)
BAND = Band(MODE, 0.8, 1.2, 0.05)


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["shaper", *map(str, words)], catch_exceptions=False)


@pytest.mark.parametrize(("derivatives", "known"), [(0, 4.2178665105), (1, 5.8659584390)])
def test_two_masses_take_what_is_known(derivatives: int, known: float):
    """Two masses of 1 kg and a spring of 1 N/m, 1 N: as a body of 2 kg with a mode at √2 rad/s."""
    found = with_zeros(Move(1.0, -0.5, 0.5), [Mode(math.sqrt(2.0))], derivatives)
    assert found.status is Status.PROVED
    assert found.upper == pytest.approx(known, abs=1e-10)


@pytest.mark.parametrize("displacement", [0.01, 0.1, 2.0, -0.3])
def test_together_is_shorter_than_in_turn_and_longer_than_rigid(displacement: float):
    move = Move(displacement, -2.0, 1.5)
    alone, together = rigid(move), with_zeros(move, [MODE], 1)
    assert alone.command is not None
    shaped = in_turn(move, alone.command, derivative_shaper(MODE, 1))
    assert shaped is not None
    assert together.upper is not None
    assert alone.lower < together.lower <= together.upper < shaped.maneuver_time
    for command in (shaped, together.command):
        assert command is not None
        assert left_over(move, command, [Band(MODE, 1.0, 1.0, 0.05)], None)[1] < 1e-9


def swing(move: Move, command: Command, mode: Mode) -> tuple[float, float]:
    """The envelope at the end and the largest swing after it, over the move, from the linear plant's response."""
    plant = move.plant([mode])
    times = command.end + np.linspace(0.0, 4.0 * mode.half_period, 4001)
    rest = response(plant, command, times) - move.displacement
    rate = -mode.damping * mode.frequency
    turning = mode.frequency * math.sqrt(1 - mode.damping**2)
    since = times - command.end
    shape = np.exp(rate * since)[:, None] * np.column_stack([np.cos(turning * since), np.sin(turning * since)])
    parts, *_ = np.linalg.lstsq(shape, rest, rcond=None)
    assert np.abs(shape @ parts - rest).max() < 1e-7 * abs(move.displacement)
    return float(np.hypot(*parts)) / abs(move.displacement), float(np.abs(rest).max()) / abs(move.displacement)


@pytest.mark.parametrize("order", [1, 2])
def test_what_is_left_agrees_with_the_plants_response(order: int):
    move = Move(0.1, -2.0, 2.0, order)
    found = rigid(move)
    assert found.command is not None
    for factor in (0.8, 1.0, 1.2):
        lower, upper = left_over(move, found.command, [Band(MODE, factor, factor, 0.05)], None)
        envelope, _ = swing(move, found.command, MODE.scaled(factor))
        assert lower <= upper
        assert envelope == pytest.approx(upper, rel=1e-6)
    worst = [swing(move, found.command, MODE.scaled(float(factor)))[0] for factor in np.linspace(0.8, 1.2, 41)]
    lower, upper = left_over(move, found.command, [BAND], None)
    assert max(worst) <= upper * (1 + 1e-6)
    assert max(worst) >= lower * (1 - 1e-3)


def test_a_band_is_kept_by_every_plant_and_proven_in_a_certificate():
    move = Move(0.1, -2.0, 2.0)
    found, robust = within_bands(move, [Band(MODE, 0.9, 1.1, 0.05)]), with_zeros(move, [MODE], 1)
    assert found.status is Status.PROVED
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert found.command is not None
    for factor in np.linspace(0.9, 1.1, 21):
        assert swing(move, found.command, MODE.scaled(float(factor)))[1] <= 0.05 * (1 + 1e-6)
    assert found.upper is not None
    assert found.upper < robust.lower


@pytest.mark.slow
def test_bands_of_several_modes_are_one_box():
    """Every plant of the box, simulated by itself, swings by no more than the tolerance. An upper side may stay unproven."""
    move, fast = Move(0.03, -1.0, 1.0), Mode(2 * math.pi * 2.6, 0.02)
    found = within_bands(move, [Band(MODE, 0.95, 1.05, 0.05), Band(fast, 0.96, 1.04, 0.05)])
    assert found.status in (Status.PROVED, Status.BRACKETED)
    assert found.certificate is not None
    assert found.command is not None
    assert found.upper is not None
    assert found.lower <= found.upper <= found.lower * (1 + 1e-3)
    assert check(found.certificate).outcome is Outcome.PROVED, "of the sides that it claims"
    end = found.command.end
    for lazy in np.linspace(0.95, 1.05, 5):
        for quick in np.linspace(0.96, 1.04, 5):
            plant = move.plant([MODE.scaled(float(lazy)), fast.scaled(float(quick))])
            rest = response(plant, found.command, end + np.linspace(0.0, 3.0, 601))
            assert np.abs(rest - 0.03).max() <= 0.05 * 0.03 * (1 + 1e-4)


@pytest.mark.slow
def test_bands_of_one_mode_are_kept_as_one():
    low, middle, high = (Band(MODE, *ends, 0.05) for ends in ((0.95, 1.02), (1.0, 1.03), (1.05, 1.1)))
    other = Band(MODE.scaled(3.0), 0.9, 1.1, 0.05)
    assert hulls([high, other, low]) == (Band(MODE, 0.95, 1.1, 0.05), other)
    assert gaps([high, other, low]) == ((1.02, 1.05),)
    assert gaps([low, middle, other]) == ()
    move = Move(0.1, -2.0, 2.0)
    both, whole = within_bands(move, [low, high]), within_bands(move, [Band(MODE, 0.95, 1.1, 0.05)])
    assert (both.status, both.lower, both.upper) == (whole.status, whole.lower, whole.upper)
    assert both.status is Status.PROVED
    assert both.command is not None
    for band in (low, high):
        for factor in np.linspace(band.low, band.high, 5):
            assert swing(move, both.command, MODE.scaled(float(factor)))[1] <= 0.05 * (1 + 1e-6)


def test_negative_impulses_may_go_beyond_the_limits():
    alone, slow = (rigid(Move(0.1, -limit, limit)).command for limit in (2.0, 1.0))
    assert alone is not None
    assert slow is not None
    assert in_turn(Move(0.1, -2.0, 2.0), alone, negative_zv(MODE, 0.5)) is None
    assert in_turn(Move(0.1, -3.0, 3.0), slow, negative_zv(MODE, 0.5)) is not None


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (lambda: Move(0.0, -1.0, 1.0), "not 0"),
        (lambda: Move(1.0, 1.0, -1.0), "limits ascend"),
        (lambda: Move(1.0, 1.0, 2.0), "limits hold 0"),
        (lambda: Move(math.inf, -1.0, 1.0, 3), r"finite .*; the order is 2"),
        (lambda: within_bands(Move(1.0, -1.0, 1.0), [Band(MODE, 1.1, 1.2, 0.05)]), "leaves out the mode"),
        (
            lambda: within_bands(Move(1.0, -1.0, 1.0), [Band(MODE, 0.9, 1.1, 0.05), Band(MODE.scaled(2.0), 0.9, 1.1, 0.1)]),
            r"0\.05 and 0\.1",
        ),
    ],
)
def test_mistakes_are_named(words, told: str):
    with pytest.raises(ShaperError, match=told):
        words()


@pytest.mark.parametrize(
    "bands",
    [
        # The wide one is kept by what the narrow one needs: both sides are the same.
        slow([Band(MODE, 0.9, 1.1, 0.02), Band(MODE, 0.89, 1.11, 0.9)]),
        slow([Band(MODE, 0.8, 1.1, 0.05), Band(MODE, 0.9, 1.3, 0.1)]),
    ],
)
def test_bands_that_are_not_one_task_are_all_kept_and_nothing_is_faster_than_one_alone(bands: list[Band], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(banded_moves, "within_all", lambda move, bands: None)
    move = Move(0.1, -2.0, 2.0)
    found = within_each(move, bands)
    assert found.bound.command is not None
    assert found.bound.upper is not None
    for band in bands:
        for factor in np.linspace(band.low, band.high, 9):
            mode = band.mode.scaled(float(factor))
            plant = LinearPlant.from_transfer(
                [str(mode.frequency**2)], ["1", str(2 * mode.damping * mode.frequency), str(mode.frequency**2), "0", "0"]
            )
            after = response(plant, found.bound.command, found.bound.upper + np.linspace(0.0, 2.0, 400))
            assert np.abs(after - 0.1).max() <= band.tolerance * 0.1 * (1 + 1e-9)
        alone = within_bands(move, [band])
        assert found.bound.lower >= alone.lower * (1 - 1e-12)
    assert found.bound.lower <= found.bound.upper
    assert (found.bound.status is Status.PROVED) == (found.bound.upper <= found.bound.lower * (1 + 1e-6))


def test_the_command_line_designs_a_move_and_writes_its_command_and_proof(tmp_path: Path):
    files = tmp_path / "move.json", tmp_path / "proof.json"
    words = ("zvd", "--mode", "1.0Hz:0.05", "--move", "0.1", "--input", "-2:2")
    done = run(*words, "--command", files[0], "--certificate", files[1], "--json")
    assert done.exit_code == 0, done.stderr
    move = json.loads(done.stdout)["move"]
    assert move["rigid"]["maneuver_time"]["upper"] == pytest.approx(math.sqrt(0.2), rel=1e-15)
    assert move["shaped"]["maneuver_time"] == pytest.approx(math.sqrt(0.2) + 2 * MODE.half_period, rel=1e-12)
    assert move["together"]["status"] == "proved"
    assert move["together"]["maneuver_time"]["upper"] < 0.83 * move["shaped"]["maneuver_time"]
    command = Command.from_json(files[0].read_text())
    assert command.maneuver_time == move["together"]["maneuver_time"]["upper"]
    plant = LinearPlant.from_transfer([str(MODE.frequency**2)], ["1", str(0.1 * MODE.frequency), str(MODE.frequency**2), "0", "0"])
    assert response(plant, command, np.linspace(2.0, 5.0, 50)) == pytest.approx(np.full(50, 0.1), abs=1e-9)
    assert CliRunner().invoke(main, ["check", str(files[1])]).exit_code == 0
    told = run(*words).stdout
    assert "designed together: [1.18573" in told
    assert "then shaped: 1.4484" in told


def test_what_is_the_shapers_alone_is_said():
    words = ("zv", "--mode", "1Hz:0.05", "--move", "0.1", "--input", "-2:2")
    assert "note: --sample-time is of the shaper" in run(*words, "--sample-time", "0.05").stdout
    assert "note" not in run(*words).stdout


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["zvd", "--move", "0.1"], 2, "--input -2:2"),
        (["zvd", "--input", "-2:2"], 2, "--move"),
        (["zvd", "--move", "0.1", "--input", "1:2"], 2, "hold 0"),
        (["zvd", "--move", "0.1", "--input", "x"], 2, "LOW:HIGH"),
        (["zv", "--move", "0.1", "--input", "0:2"], 1, "limits below and above 0 would"),
        (["zv", "--move", "-0.1", "--input", "0:2", "--order", "1"], 1, "a limit below 0 would"),
        (["none", "--move", "0.1", "--input", "-1:2"], 2, "by no demands"),
        (["zv", "--command", "move.json"], 2, "move.json"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_mistakes_of_the_command_line_are_named_and_leave_nothing(words: list[str], code: int, told: str, tmp_path: Path):
    done = run(*words, "--mode", "1.0Hz:0.05", "--save", tmp_path / "shaper.json")
    assert (done.exit_code, list(tmp_path.iterdir())) == (code, [])
    assert told in done.stderr
