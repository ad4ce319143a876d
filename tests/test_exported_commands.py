"""The command as an FMU: its own bits at any communication point, by every importer and interface."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from exported import VERSIONS, write_command
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from raw_fmus import RawFmu

from fmus.archives import open_archive
from fmus.blocks import Signal
from fmus.compiling import FmiVersion
from relaxations.commands import Command, Segment, Tail, TailTerm

TAIL = Tail(0.25, (TailTerm(-0.5 + 2j, 1, 0.1 - 0.2j), TailTerm(-3 + 0j, 0, 0.4 + 0j), TailTerm(-3 + 0j, 2, -1.5 + 0j)))
MOVE = Command(3.0, (Segment(0.25, 1.0), Segment(1.0, -1.0, 0.5), Segment(2.5, 0.75)), TAIL)
# e^, cos and powers of a tail differ by an ulp between C libraries; the segments are the same operations on the same numbers
TAIL_ROUNDING = 1e-15


@pytest.fixture(scope="module", params=VERSIONS)
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_command(tmp_path_factory.mktemp("command"), MOVE, request.param, Signal("force", "N", {"kg": 1, "m": 1, "s": -2}))


def play(path: Path, folder: Path, times: list[float], values: dict[str, float] | None = None) -> list[float]:
    """The output at each of the communication points."""
    with RawFmu(path, folder) as raw:
        raw.initialize(values)
        found, now = raw.get(["force"]), 0.0
        for time in times:
            raw.step(now, time - now)
            now = time
            found += raw.get(["force"])
    return found


def test_passes_validation_and_says_what_it_is(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    description = open_archive(fmu).description
    assert {v.name: (v.causality, v.unit, v.start) for v in description.variables} == {
        "time": ("independent", "s", None),
        "delay": ("parameter", "s", 0.0),
        "scale": ("parameter", "", 1.0),
        "rest": ("parameter", "N", 0.0),
        "force": ("output", "N", None),
    }
    assert description.capabilities.variable_step


def test_has_the_commands_own_bits_at_any_communication_point(fmu: Path, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    times = np.sort(np.concatenate([random.uniform(0.0, 3.25, 200), [0.25, 1.0, 2.5]])).tolist()
    assert play(fmu, tmp_path, times) == MOVE([0.0, *times]).tolist()


def test_has_the_tail_to_rounding(fmu: Path, tmp_path: Path) -> None:
    times = np.sort(np.random.default_rng(1).uniform(3.25, 40.0, 200)).tolist()
    assert play(fmu, tmp_path, times)[1:] == pytest.approx(MOVE(times).tolist(), abs=TAIL_ROUNDING)


def test_at_a_switch_it_has_switched_however_its_instant_was_computed(fmu: Path, tmp_path: Path) -> None:
    """Sums of 0.1 miss 1.0 and 2.5 by some ulp, and by more than one."""
    times = np.cumsum(np.full(40, 0.1)).tolist()
    assert times[9] < 1.0, "else this tests nothing"
    found = play(fmu, tmp_path, times)
    assert found[10] == pytest.approx(-1.0, abs=1e-15)
    assert found[25] == 0.75
    assert found[2] == 0.0


def test_delay_scale_and_rest(fmu: Path, tmp_path: Path) -> None:
    times = [0.5, 0.9, 1.75, 4.0, 7.0]
    found = play(fmu, tmp_path, times, {"delay": 0.75, "scale": -2.0, "rest": 0.5})
    expected = 0.5 - 2.0 * (MOVE(np.array([0.0, *times]) - 0.75, rest=0.5) - 0.5)
    assert found == pytest.approx(expected.tolist(), abs=1e-15)
    assert found[:2] == [0.5, 0.5]


def test_a_command_that_is_a_step(tmp_path: Path) -> None:
    path = write_command(tmp_path, Command(0.0, (), Tail(1.5)), "2.0", Signal("force"))
    assert play(path, tmp_path / "unpacked", [0.5, 1.0]) == [1.5, 1.5, 1.5]
    assert play(path, tmp_path / "again", [0.5, 1.0, 1.5], {"delay": 0.75}) == [0.0, 0.0, 1.5, 1.5]


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_a_foreign_importer_plays_it(fmu: Path, interface: str) -> None:
    """Model exchange brings its switches as time events, so every recorded point lies on the right side of them."""
    result = simulate_fmu(str(fmu), fmi_type=interface, stop_time=6.0, output_interval=0.01, output=["force"])
    times = np.array(result["time"])
    near = np.abs(times[:, None] - np.array(MOVE.breakpoints)[None, :]).min(axis=1) < 1e-9
    assert np.array(result["force"])[~near] == pytest.approx(MOVE(times[~near]).tolist(), abs=1e-15)
    assert (~near).sum() > 500


def test_event_mode_brings_every_switch_to_the_importer(tmp_path: Path) -> None:
    """Early return: one step asked for, and it ends at each switch; before the event the old value, after it the new one."""
    path = write_command(tmp_path, MOVE, "3.0")
    with RawFmu(path, tmp_path / "unpacked", event_mode=True) as raw:
        raw.initialize()
        assert raw.handle_event() == pytest.approx(0.25)
        now, seen = 0.0, []
        while now < 10.0:
            needed, _, early, now = raw.step(now, 10.0 - now)
            assert needed == early
            before = raw.get(["u"])[0]
            if needed:
                following = raw.handle_event()
                seen.append((now, before, raw.get(["u"])[0], following))
    points = MOVE.breakpoints
    assert [s[0] for s in seen] == pytest.approx(points, rel=1e-15)
    assert [s[1] for s in seen] == pytest.approx([0.0, 1.0, -0.25, 0.75], abs=1e-15)
    assert [s[2] for s in seen] == pytest.approx(MOVE(points).tolist(), abs=1e-15)
    assert [s[3] for s in seen[:-1]] == pytest.approx(points[1:], rel=1e-15)
    assert seen[-1][3] is None


@pytest.mark.slow
def test_the_file_format_says_the_same(tmp_path: Path) -> None:
    """The FMU of a command that went through its file is the same to the byte."""
    version: FmiVersion = "2.0"
    again = Command.from_json(json.dumps(MOVE.to_dict()))
    (tmp_path / "again").mkdir()
    assert write_command(tmp_path, MOVE, version).read_bytes() == write_command(tmp_path / "again", again, version).read_bytes()
