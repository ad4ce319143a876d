"""Decays as they come from the world: what is wrong with a record is told, and what is not wrong with it changes nothing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from marks import slow

from suite.decays import measured_decay
from suite.errors import SuiteError

TIMES = np.arange(0.0, 5.0, 0.01)
FREQUENCY, DAMPING = 2 * math.pi * 1.3, 0.04
VALUES = np.exp(-DAMPING * FREQUENCY * TIMES) * np.cos(FREQUENCY * math.sqrt(1 - DAMPING**2) * TIMES)


def table(times: np.ndarray, values: np.ndarray) -> str:
    return "".join(f"{t!r},{y!r}\n" for t, y in zip(times.tolist(), values.tolist(), strict=True))


UNEVEN = np.sort(np.random.default_rng(1).uniform(0.0, 5.0, 400))
HARMLESS = {
    "as it is": table(TIMES, VALUES),
    "a gap": table(TIMES[(TIMES < 1.0) | (TIMES > 2.5)], VALUES[(TIMES < 1.0) | (TIMES > 2.5)]),
    "uneven": table(UNEVEN, np.interp(UNEVEN, np.arange(0, 5, 1e-4),
                                      np.exp(-DAMPING * FREQUENCY * np.arange(0, 5, 1e-4))
                                      * np.cos(FREQUENCY * math.sqrt(1 - DAMPING**2) * np.arange(0, 5, 1e-4)))),
    "huge": table(TIMES, VALUES * 1e300),
    "tiny": table(TIMES, 3e-200 + VALUES * 1e-200),
    "after an epoch": table(TIMES + 1.7e6, VALUES),
    "before zero": table(TIMES - 10.0, VALUES),
    "decimal commas": table(TIMES, VALUES).replace(",", ";").replace(".", ","),
    "a name with a semicolon": "time [s],x; filtered\n" + table(TIMES, VALUES).partition("\n")[2],
    "some rows twice": table(np.repeat(TIMES, 1 + (np.arange(500) % 5 == 0)), np.repeat(VALUES, 1 + (np.arange(500) % 5 == 0))),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [slow(name) if name in ("a gap", "huge", "tiny", "before zero", "after an epoch", "some rows twice") else name for name in HARMLESS],
)
def test_what_is_not_wrong_changes_nothing(name: str, tmp_path: Path):
    file = tmp_path / "decay.csv"
    file.write_text(HARMLESS[name])
    (found,) = measured_decay(file).decay.modes
    assert found.mode.frequency == pytest.approx(FREQUENCY, rel=1e-6)  # lines between samples, 1e-4 s apart, and times of 1e6 s
    assert found.mode.damping == pytest.approx(DAMPING, abs=1e-6)


BAD = {
    "not a number": (table(TIMES, VALUES).replace(f"0.5,{VALUES[50].item()!r}", "0.5,NaN"), ["line 51", "0.5,NaN"]),
    "names alone": ("t,y\n", ["no row of numbers"]),
    "nothing": ("", ["no table"]),
    "constant": (table(TIMES, np.ones(500)), ["stands still"]),
    "backwards": (table(TIMES[::-1], VALUES), ["ascend", "4.98 follows 4.99"]),
    "rounded times": (table(TIMES.round(1), VALUES), ["500 samples have 51 different times"]),
    "growing": (table(TIMES, VALUES[::-1].copy()), ["does not decay"]),
    "times twice": (table(TIMES, TIMES), ["only a slow drift"]),
    "too slowly sampled": (table(TIMES, np.exp(-TIMES) * np.cos(2 * math.pi * 49.9 * TIMES)), ["too few", "three times a period"]),
    "noise": (table(TIMES, np.random.default_rng(2).normal(size=500)), ["no vibration that decays"]),
    "a short one": (table(TIMES[:10], VALUES[:10]), ["at least 16 samples", "has 10"]),
    "three columns": ("".join(f"{t},{t},{y}\n" for t, y in zip(TIMES, VALUES, strict=True)), ["several columns", "--signal"]),
}


@pytest.mark.parametrize("name", [slow(name) if name in ("too slowly sampled",) else name for name in BAD])
def test_what_is_wrong_is_told(name: str, tmp_path: Path):
    text, words = BAD[name]
    file = tmp_path / "decay.csv"
    file.write_text(text)
    with pytest.raises(SuiteError) as caught:
        measured_decay(file)
    assert [word for word in ("decay.csv", *words) if word not in str(caught.value)] == []


@pytest.mark.slow
def test_how_much_a_fit_leaves_is_told(tmp_path: Path):
    file = tmp_path / "decay.csv"
    file.write_text(table(TIMES, VALUES + np.random.default_rng(3).normal(scale=0.1, size=500)))
    found = measured_decay(file).decay
    assert found.share == pytest.approx(0.1 / np.std(VALUES + 0.0), rel=0.15)  # with the noise in the signal itself
    assert abs(found.modes[0].mode.frequency - FREQUENCY) < 5 * found.modes[0].frequency_error


def test_an_empty_log_is_told(tmp_path: Path):
    (tmp_path / "run.mcap").touch()
    with pytest.raises(SuiteError, match="is empty"):
        measured_decay(tmp_path / "run.mcap")
