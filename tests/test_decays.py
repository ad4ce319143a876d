"""Modes from measured decays: known ones are found again, with honest errors, from tables and logs; what holds none is refused."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from mcap.writer import Writer
from small_studies import small_study

from fmus.decays import identify_decay
from fmus.errors import DecayError
from suite.cli import main
from suite.loading import load_study
from suite.verification import verify

MODES = ((2 * math.pi, 0.03, 1.0, 0.3), (19.0, 0.02, 0.4, 1.0))


def decay(t: np.ndarray, modes=MODES, rest: float = 0.3) -> np.ndarray:
    total = np.full_like(t, rest)
    for omega, zeta, size, phase in modes:
        total += size * np.exp(-zeta * omega * t) * np.cos(omega * math.sqrt(1 - zeta**2) * t + phase)
    return total


def shaper(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["shaper", *map(str, words)], catch_exceptions=False)


def write(path: Path, rows, head: str = "time,tip\n") -> Path:
    path.write_text(head + "".join(",".join(f"{x:.15g}" for x in row) + "\n" for row in rows))
    return path


@pytest.mark.parametrize("count", [1, 2])
def test_without_noise_the_modes_are_exact(count: int):
    t = np.linspace(2.0, 10.0, 500)
    found = identify_decay(t, decay(t - 2.0, MODES[:count]))
    assert [mode.mode.frequency for mode in found.modes] == pytest.approx([m[0] for m in MODES[:count]], rel=1e-9)
    assert [mode.mode.damping for mode in found.modes] == pytest.approx([m[1] for m in MODES[:count]], rel=1e-7)
    assert [mode.amplitude for mode in found.modes] == pytest.approx([m[2] for m in MODES[:count]], rel=1e-7)
    assert found.rest == pytest.approx(0.3, abs=1e-9)


@pytest.mark.slow
def test_standard_errors_are_those_of_many_repetitions():
    """Of 30 noisy records two thirds of the errors lie within one standard error: between 11 and 28 of them (4 sigma)."""
    chance, t = np.random.default_rng(11), np.linspace(0.0, 8.0, 300)
    inside = {"frequency": 0, "damping": 0}
    for _ in range(30):
        found = identify_decay(t, decay(t, MODES[:1]) + 0.05 * chance.normal(size=len(t)))
        (mode,) = found.modes
        inside["frequency"] += abs(mode.mode.frequency - MODES[0][0]) <= mode.frequency_error
        inside["damping"] += abs(mode.mode.damping - MODES[0][1]) <= mode.damping_error
        assert found.rms == pytest.approx(0.05, rel=0.25)
    assert all(11 <= count <= 28 for count in inside.values()), inside


def test_a_gap_hides_no_mode():
    """Even samples of a record with a gap hold a line in place of it, and a realisation of those shows one of these two modes."""
    t = np.linspace(0.0, 8.0, 1600)
    y = sum(
        size * np.exp(-z * w * t) * np.cos(w * math.sqrt(1.0 - z * z) * t + phase)
        for w, z, size, phase in ((2 * math.pi * 1.3, 0.03, 1.0, 0.4), (2 * math.pi * 4.1, 0.01, 0.3, 1.0))
    ) + 0.01 * np.random.default_rng(3).normal(size=len(t))
    kept = np.ones(len(t), dtype=bool)
    kept[len(t) // 4 : len(t) // 3] = False
    found = identify_decay(t[kept], y[kept])
    assert [mode.mode.frequency / (2 * math.pi) for mode in found.modes] == pytest.approx([1.3, 4.1], abs=1e-3)
    assert [mode.mode.damping for mode in found.modes] == pytest.approx([0.03, 0.01], abs=1e-3)
    assert found.share < 0.05


def test_uneven_samples_and_an_undamped_mode():
    chance = np.random.default_rng(4)
    t = np.sort(chance.uniform(0.0, 6.0, 700))
    found = identify_decay(t, decay(t, ((5.0, 0.0, 2.0, 0.1),)))
    assert found.modes[0].mode.frequency == pytest.approx(5.0, rel=1e-6)
    assert found.modes[0].mode.damping == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (lambda t: np.random.default_rng(1).normal(size=len(t)), "no vibration"),
        (lambda t: 0.2 * t, "no vibration"),
        (lambda t: np.full_like(t, 3.0), "stands still"),
        (lambda t: decay(t, ((0.7, 0.01, 1.0, 0.4),)), "less than the period"),
        (lambda t: np.full_like(t, np.nan), "finite"),
    ],
)
def test_what_holds_no_mode_is_refused(values, words: str):
    t = np.linspace(0.0, 5.0, 400)
    with pytest.raises(DecayError, match=words):
        identify_decay(t, values(t))


def test_times_ascend_and_there_are_enough_of_them():
    t = np.linspace(0.0, 5.0, 400)
    with pytest.raises(DecayError, match="times of a decay ascend"):
        identify_decay(t[::-1], decay(t))
    with pytest.raises(DecayError, match="at least 16 samples"):
        identify_decay(t[:5], decay(t[:5]))


@pytest.mark.slow
def test_a_table_becomes_a_shaper(tmp_path: Path):
    t = np.linspace(0.0, 8.0, 600)
    file = write(tmp_path / "tip.csv", zip(t, decay(t), 0 * t, strict=True), "time;tip;other\n".replace(";", ","))
    done = shaper("zvd", "--decay", file, "--signal", "tip", "--json")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert [mode["frequency"] for mode in found["modes"]] == pytest.approx([2 * math.pi, 19.0], rel=1e-6)
    assert found["decay"]["signal"] == "tip"
    assert len(found["amplitudes"]) == 9
    # The part after 2 s alone, and a head of the table cut off.
    late = json.loads(shaper("zvd", "--decay", file, "--signal", "tip", "--from", "2", "--until", "7", "--json").stdout)
    assert late["decay"]["from"] >= 2.0
    assert late["decay"]["until"] <= 7.0
    assert late["duration"] == pytest.approx(found["duration"], rel=1e-6)
    bare = write(tmp_path / "bare.txt", zip(t, decay(t), strict=True), "")
    assert json.loads(shaper("zvd", "--decay", bare, "--json").stdout)["duration"] == pytest.approx(found["duration"], rel=1e-9)
    shown = shaper("zvd", "--decay", bare).stdout
    assert "mode 1: 1 ± " in shown
    assert "(measured)" in shown


def test_mistakes_in_tables_are_told(tmp_path: Path):
    t = np.linspace(0.0, 8.0, 100)
    two = write(tmp_path / "two.csv", zip(t, decay(t), t, strict=True), "time,tip,base\n")
    for words, told in (
        ((two,), "choose one by --signal: tip, base"),
        ((two, "--signal", "top"), "no column 'top'; it has tip, base"),
        ((two, "--signal", "tip", "--from", "9"), "no sample from 9 s on"),
        ((write(tmp_path / "hole.csv", [(0, 1), (1, 2)], "t,x\n0,a\n"),), "line 2 has no number for 't' and 'x'"),
        ((write(tmp_path / "one.csv", [(1,), (2,)], "t\n"),), "column of times"),
    ):
        done = shaper("zv", "--decay", *words)
        assert done.exit_code == 2
        assert told in done.stderr, done.stderr
    assert shaper("zv", "--mode", "1Hz:0", "--signal", "x").exit_code == 2
    assert shaper("zv", "--decay", tmp_path / "none.csv").exit_code == 2


def test_the_log_of_a_run_begins_where_its_command_ends(tmp_path: Path):
    study = small_study(tmp_path, "[command]", 'kind = "shaper"', 'shaper = "none"', samples=0)
    verify(load_study(study), tmp_path / "out")
    log = tmp_path / "out" / "runs" / "0000-nominal.mcap"
    found = json.loads(shaper("zvd", "--decay", log, "--json").stdout)
    assert found["modes"] == [{"frequency": pytest.approx(2**0.5, rel=1e-6), "damping": pytest.approx(0.0, abs=1e-6)}]
    assert found["decay"]["from"] == pytest.approx(2 * 10**0.5, abs=1e-6)
    done = shaper("zvd", "--decay", log, "--signal", "position_9")
    assert done.exit_code == 2
    assert "no variable 'position_9'; it has" in done.stderr


def test_messages_in_json_of_any_program(tmp_path: Path):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(library="another")
    schema = writer.register_schema("reading", "jsonschema", b"{}")
    channel = writer.register_channel("/arm/tip", "json", schema)
    t = np.linspace(0.0, 8.0, 500)
    for time, value in zip(t, decay(t), strict=True):
        at = round(1e9 * (100.0 + time))
        writer.add_message(channel, at, json.dumps({"pose": {"x": [value, 0.0]}}).encode(), at)
    writer.finish()
    file = tmp_path / "arm.mcap"
    file.write_bytes(stream.getvalue())
    found = json.loads(shaper("zv", "--decay", file, "--signal", "/arm/tip.pose.x.0", "--json").stdout)
    assert [mode["frequency"] for mode in found["modes"]] == pytest.approx([2 * math.pi, 19.0], rel=1e-6)
    for signal, told in (("/arm/top.x", "it has /arm/tip"), ("/arm/tip.pose.y", "no number at pose.y"), (None, "--signal /topic.field")):
        done = shaper("zv", "--decay", file, *(() if signal is None else ("--signal", signal)))
        assert done.exit_code == 2
        assert told in done.stderr, done.stderr
