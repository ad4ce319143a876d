"""Pole-zero cancelling filters as FMUs: with their poles, for any reference in real time, in front of the plant that they are made for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from exported import VERSIONS, drive, held, lines, set_boolean
from fmpy.validation import validate_fmu
from independent_shaping import shaped
from marks import slow
from raw_fmus import RawFmu
from scipy.linalg import expm

from fmus.blocks import Signal, shaper_block
from fmus.build import build
from fmus.compiling import FmiVersion, host
from fmus.exporting import export
from relaxations.cancelling.closed_forms import pole_last, step_and_pole_last
from relaxations.cancelling.prefilters import Prefilter, cascade
from relaxations.cancelling.requests import Request, cancelling
from relaxations.plants import LinearPlant
from relaxations.shaping.modes import Mode
from suite.cli import main

MODE = Mode(np.sqrt(2.0), 0.0)
FILTERS = {  # (15), (40), (47) of Singh 2012 and the one for samples; the terms of a product start at several delays
    "one zero": pole_last(MODE, [-1.0]),
    "two zeros": pole_last(Mode(1.0, 0.0), [complex(-1.0, np.sqrt(2.0)), complex(-1.0, -np.sqrt(2.0))]),
    "real zeros": pole_last(MODE, [-1.0, -2.0]),
    "on samples": step_and_pole_last(MODE, [-1.0], 1.25),
    "a product": cascade(pole_last(MODE, [-1.0]), pole_last(Mode(2.0, 0.1), [-0.5])),
}
SLOW = {"real zeros", "two zeros", "on samples"}  # each is a compilation
ROUNDING = 1e-12  # of values up to 3: a few hundred sums and exponentials


def written(folder: Path, content: Prefilter, version: FmiVersion) -> Path:
    path = folder / f"filter{version[0]}.fmu"
    path.write_bytes(export(shaper_block(content, "filter", Signal("shaped", "N")), version, [host()]).content)
    return path


@pytest.mark.parametrize("name", [slow(name) if name in SLOW else name for name in FILTERS])
def test_filters_any_reference_at_any_steps(name: str, tmp_path: Path) -> None:
    version = VERSIONS[len(name) % 2]
    rng = np.random.default_rng(len(name))
    times = [0.0, *np.cumsum(10.0 ** rng.uniform(-5, -0.2, 40)).tolist()]
    values = np.repeat(rng.normal(size=20), 2).tolist()
    path = written(tmp_path, FILTERS[name], version)
    assert validate_fmu(str(path)) == []
    for linear in (False, True):
        with RawFmu(path, tmp_path / f"{linear}") as fmu:
            set_boolean(fmu, "linear", linear)
            fmu.initialize({"rest": 0.0, "reference": values[0]})
            outputs = drive(fmu, times, values)
        reference = (lines if linear else held)(times, values, 0.0)
        assert outputs == pytest.approx([shaped(FILTERS[name], reference, times, t) for t in times[1:]], abs=ROUNDING)  # type: ignore[arg-type]


@pytest.mark.parametrize("version", VERSIONS)
def test_at_rest_it_holds_what_holds_the_plant(version: FmiVersion, tmp_path: Path) -> None:
    """The plant (s + 1)/(s² + 2) has a static gain of 1/2, the filter one of 2."""
    with RawFmu(written(tmp_path, FILTERS["one zero"], version), tmp_path / "fmu") as fmu:
        fmu.initialize({"rest": 0.3, "reference": 0.3})
        assert drive(fmu, [0.0, 0.1, 5.0], [0.3, 0.3]) == pytest.approx([0.6, 0.6], rel=1e-14)


def test_in_front_of_the_plant_any_reference_comes_to_rest(tmp_path: Path) -> None:
    """(s + 1)/(s² + 2), samples of 1 ms, a random staircase that ends at 3 s: at rest the filter's 1.546 s later, and not without it."""
    step, content = 1e-3, FILTERS["one zero"]
    rng = np.random.default_rng(4)
    values = np.repeat(rng.normal(size=11), [*[300] * 10, 7000])
    times = step * np.arange(len(values) + 1)
    with RawFmu(written(tmp_path, content, "2.0"), tmp_path / "fmu") as fmu:
        fmu.initialize({"rest": 0.0, "reference": float(values[0])})
        inputs = np.array(drive(fmu, times.tolist(), values.tolist()))
    both = expm(np.array([[0.0, 1.0, 0.0], [-2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]) * step)

    def output(driven: np.ndarray) -> np.ndarray:
        state, found = np.zeros(2), []
        for u in driven:
            state = both[:2, :2] @ state + both[:2, 2] * u
            found.append(state[0] + state[1])
        return np.array(found)

    done = times[1:] > 3.0 + content.duration + 0.01
    assert np.abs(output(inputs) - values[-1])[done].max() < 5e-3  # inputs are held for a millisecond: first order in it
    assert np.abs(output(2.0 * values) - values[-1])[done].max() > 0.5
    assert np.ptp(inputs[done]) > 0.1  # it goes on along the zero


def test_the_aircraft_follows_any_reference(tmp_path: Path) -> None:
    """Both FMUs, coupled every 10 ms as any importer would: the pitch is where the reference is, the filter's duration after that stops."""
    content = cancelling(LinearPlant.from_transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"]), Request(1, "last+step"))
    step, rng = 1e-2, np.random.default_rng(6)
    values = np.repeat(0.2 * rng.normal(size=9), [*[50] * 8, 500])
    found = {}
    for name, path in (("filtered", written(tmp_path, content, "3.0")), ("plain", None)):
        with RawFmu(build("aircraft_pitch", "3.0"), tmp_path / name) as plant:
            plant.initialize({"reference": 0.0})
            times = (step * np.arange(len(values) + 1)).tolist()
            inputs = values.tolist()
            if path is not None:
                with RawFmu(path, tmp_path / "fmu") as shaper:
                    shaper.initialize({"rest": 0.0, "reference": float(values[0])})
                    inputs = drive(shaper, times, inputs)
            pitch = []
            for now, value in zip(times, inputs, strict=False):
                plant.set({"reference": value})
                plant.step(now, step)
                pitch += plant.get(["pitch"])
            found[name] = np.abs(np.array(pitch) - values[-1])[np.array(times[1:]) > 4.0 + content.duration + 0.05].max()
    assert found["filtered"] < 3e-3 < 0.05 < found["plain"]  # of steps of 0.2 rad: the filter's tail is held for 10 ms


def test_the_command_line_takes_the_file(tmp_path: Path) -> None:
    source = tmp_path / "pitch.filter.json"
    source.write_text(json.dumps(FILTERS["real zeros"].to_dict()))
    done = CliRunner().invoke(main, ["fmus", "export", str(source), "--out", str(tmp_path), "--platform", "linux64", "--json"])
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert (record["kind"], record["name"], len(record["files"])) == ("filter", "pitch", 2)
    assert all(validate_fmu(entry["path"]) == [] for entry in record["files"])
    source.write_text(json.dumps(FILTERS["real zeros"].to_dict() | {"gains": [1.0]}))
    wrong = CliRunner().invoke(main, ["fmus", "export", str(source), "--out", str(tmp_path)])
    assert wrong.exit_code == 2
    assert "one gain for each delay" in wrong.output
