"""`slewcert shaper`: kinds, options, files and exit codes."""

from __future__ import annotations

import json
import math
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from marks import slow

from relaxations.shaping.sensitivity import residual, step_response
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.streams import Stream
from suite.cli import main


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["shaper", *map(str, words)], catch_exceptions=False)


def record(*words: str) -> dict[str, Any]:
    done = run(*words, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


MODES = ("--mode", "1.0Hz:0.05", "--mode", "17rad/s:0.02")
KINDS = {
    "zv": [],
    "zvdd": [],
    "si": ["--tolerance", "0.1"],
    "zv-d:4": [],
    "ei": [],
    "2-hump-ei": [],
    "3-hump-ei": [],
    "um-zv": [],
    "um-zvd": [],
    "um-ei": [],
    "um-2-hump-ei": [],
    "mzv": [],
    "sna-zv": ["--negative", "0.4"],
    "sums-zv": ["--sums", "-0.5:1.5"],
    "dl-zv": ["--deflection", "0.4"],
    "custom": ["--impulses", "0:0.25,0.3:0.5,0.7:0.25"],
    "none": [],
}
QUICK = {"zv", "ei", "um-zv", "si", "sna-zv", "custom", "none"}  # one of each family; the others are for `make slow`


@pytest.mark.parametrize("kind", [kind if kind in QUICK else slow(kind) for kind in KINDS])
def test_every_kind_makes_a_shaper_for_two_modes(kind: str):
    found = record(kind, *MODES, *KINDS[kind])
    assert found["times"][0] == 0.0
    assert found["duration"] == found["times"][-1]
    assert sum(found["amplitudes"]) == pytest.approx(1.0, abs=1e-10)
    lower, upper = found["worst_residual"]
    assert lower <= upper <= lower * (1 + 1.1e-10)
    # The proven worst case is the largest of a fine sample of the same box.
    worst = 0.0
    for frequency, damping in ((2 * np.pi, 0.05), (17.0, 0.02)):
        at = frequency * np.linspace(0.8, 1.2, 4001)
        worst = max(worst, float(residual(found["times"], found["amplitudes"], at, damping).max()))
    assert upper >= worst * (1 - 1e-12)
    assert lower <= worst * (1 + 1e-5)  # of the grid's own distance from a peak
    least = found["least_duration"]
    assert least is None or least["lower"] <= found["duration"] * (1 + 1e-15)
    if kind in ("custom", "none"):
        return
    at_modes = max(float(residual(found["times"], found["amplitudes"], w, z)[0]) for w, z in ((2 * np.pi, 0.05), (17.0, 0.02)))
    # A factor with negative impulses may amplify what the other one leaves, up to the sum of its amplitudes' sizes.
    assert at_modes <= (0.1 if kind == "si" else 1e-9 if "ei" not in kind else 0.05 * (1 + 1e-9) if "um" not in kind else 0.05 * 7)


def test_the_published_worst_cases_over_a_box():
    """Over ± 20 % of frequency and damping from 0 to 5 %, of shapers for a damping of 2 %."""
    known = {"zv": (0.310795, 0.310815), "zvd": (0.096600, 0.096606), "zvdd": (0.030023, 0.030027)}
    for kind, (lower, upper) in known.items():
        found = record(kind, "--mode", "1rad/s:0.02", "--damping", "0:0.05")["worst_residual"]
        assert lower <= found[0] <= found[1] <= upper


def test_one_solution_for_all_modes_is_shorter_than_one_after_the_other():
    both, turn = record("um-zv", *MODES, "--simultaneous"), record("um-zv", *MODES)
    assert both["duration"] < turn["duration"]
    assert both["least_duration"]["lower"] == pytest.approx(both["duration"], rel=1e-12)
    assert record("um-zv", *MODES[2:], *MODES[:2], "--simultaneous")["times"] == pytest.approx(both["times"], abs=1e-12)


@pytest.mark.parametrize("step", [slow(0.01), 0.025, 0.11])
@pytest.mark.parametrize("kind", ["zv", slow("zvd")])
def test_instants_on_a_sample_grid_leave_nothing(kind: str, step: float):
    found = record(kind, *MODES, "--sample-time", str(step))
    assert np.array(found["times"]) / step == pytest.approx(np.round(np.array(found["times"]) / step), abs=1e-9)
    assert min(found["amplitudes"]) > 0.0
    assert max(float(residual(found["times"], found["amplitudes"], w, z)[0]) for w, z in ((2 * np.pi, 0.05), (17.0, 0.02))) <= 1e-12
    assert found["duration"] >= 0.5  # half a period of the slower mode, which ZV needs at least


@pytest.mark.slow
def test_many_derivatives_are_made_at_once():
    found = record("zv-d:300", "--mode", "1Hz:0.05")
    assert found["least_duration"]["lower"] == pytest.approx(found["duration"], rel=1e-13)
    assert found["worst_residual"][1] < 1e-7


def test_the_table_says_what_is_proved_and_what_is_measured():
    done = run("um-zv", "--mode", "1.0Hz:0.05")
    assert done.exit_code == 0
    assert re.search(r"least duration of sequences .*: [\d.]+ s: proved", done.stdout)
    assert re.search(r"insensitivity at 5 %: [\d.]+ of the frequency \(measured\)", done.stdout)
    assert re.search(r"worst residual vibration, .*\[[\d.]+, [\d.]+\], mode 1: proved", done.stdout)


def test_files_for_others_hold_the_same_numbers(tmp_path: Path):
    files = [tmp_path / f"shaper{ending}" for ending in (".cfg", ".g", ".h", ".json", ".svg")]
    words = [word for file in files[:3] for word in ("--export", str(file))]
    done = run("zvd", "--mode", "40Hz:0.1", *words, "--save", files[3], "--plot", files[4], "--json")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    shaper = Shaper.from_json(files[3].read_text())
    assert (list(shaper.times), list(shaper.amplitudes)) == (found["times"], found["amplitudes"])
    sections = dict(line.split(": ") for line in files[0].read_text().splitlines()[1:])
    for axis in "xy":
        assert [float(x) for x in sections[f"shaper_a_{axis}"].split(",")] == found["amplitudes"]
        assert [float(x) for x in sections[f"shaper_t_{axis}"].split(",")] == found["times"]
    listed = re.fullmatch(r'; RepRapFirmware 3.6 and later\nM593 P"custom" H([\d.:]+) T([\d.:]+)\n', files[1].read_text())
    assert listed
    assert [float(x) for x in listed[1].split(":")] == found["amplitudes"][:-1]
    assert [float(x) for x in listed[2].split(":")] == found["times"][1:]
    program = tmp_path / "sum.c"
    program.write_text(
        '#include <stdio.h>\n#include "shaper.h"\nint main(void) { for (int i = 0; i < SHAPER_TAPS; i++) '
        'printf("%.17g %.17g\\n", shaper_times[i], shaper_amplitudes[i]); return 0; }\n'
    )
    subprocess.run(["cc", "-Wall", "-Werror", "-o", tmp_path / "sum", program], check=True)
    rows = subprocess.run([tmp_path / "sum"], capture_output=True, text=True, check=True).stdout.split()
    assert [float(x) for x in rows] == [x for pair in zip(found["times"], found["amplitudes"], strict=True) for x in pair]
    picture = files[4].read_text()
    assert picture.startswith("<svg ")
    assert "40 Hz, damping 0.1" in picture


@pytest.mark.parametrize("dialect", ["c89", "c99", "c++98"])
def test_the_header_compiles_without_a_warning_and_shapes_as_the_stream_does(dialect: str, tmp_path: Path):
    step, samples = 0.01, np.cumsum(np.random.default_rng(4).normal(size=300))
    header = tmp_path / "shaper.h"
    assert run("zvd", *MODES, "--sample-time", str(step), "--export", header, "--save", tmp_path / "shaper.json").exit_code == 0
    listed = ", ".join(f"{x!r}" for x in samples.tolist())
    program = tmp_path / ("filter.cc" if "+" in dialect else "filter.c")
    program.write_text(f"""#include <stdio.h>
#include "shaper.h"
#include "shaper.h" /* guarded */
static const double samples[300] = {{{listed}}};
int main(void) {{
    int n, i;
    for (n = 0; n < 300; n++) {{
        double shaped = 0.0;
        for (i = 0; i < SHAPER_TAPS; i++) {{
            int delay = (int)(shaper_times[i] / {step!r} + 0.5);
            if (n >= delay) shaped += shaper_amplitudes[i] * samples[n - delay];
        }}
        printf("%.17g\\n", shaped);
    }}
    return 0;
}}
""")
    compiler = "c++" if "+" in dialect else "cc"
    flags = [f"-std={dialect}", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([compiler, *flags, "-o", tmp_path / "filter", program], check=True)
    rows = subprocess.run([tmp_path / "filter"], capture_output=True, text=True, check=True).stdout.split()
    shaper = Shaper.from_json((tmp_path / "shaper.json").read_text())
    assert [float(x) for x in rows] == pytest.approx(Stream(shaper, step)(samples), abs=1e-14)  # the order of the sum may differ
    assert abs(math.fsum(shaper.amplitudes) - 1.0) <= 2e-16 * len(shaper.amplitudes)  # each is rounded once


def test_firmware_gets_only_what_it_takes(tmp_path: Path):
    assert run("none", "--mode", "40Hz:0", "--export", tmp_path / "none.g").exit_code == 0
    assert (tmp_path / "none.g").read_text() == 'M593 P"none"\n'
    done = run("custom", "--impulses", "0:1.2,0.01:-0.2", "--mode", "40Hz:0", "--export", tmp_path / "last.g")
    assert done.exit_code == 2
    assert "a last impulse that is positive, and this one is -0.2" in done.stderr


def test_the_step_response_is_that_of_the_differential_equation():
    from scipy.integrate import solve_ivp

    times, amplitudes, omega, zeta = (0.0, 0.4, 0.9), (0.5, 0.2, 0.3), 5.0, 0.2

    def motion(t: float, x: np.ndarray) -> list[float]:
        u = sum(a for at, a in zip(times, amplitudes, strict=True) if t >= at)
        return [x[1], omega**2 * (u - x[0]) - 2 * zeta * omega * x[1]]

    at = np.linspace(0.0, 3.0, 61)
    solved = solve_ivp(motion, (0.0, 3.0), [0.0, 0.0], t_eval=at, rtol=1e-9, atol=1e-11, max_step=0.01)
    assert step_response(times, amplitudes, omega, zeta, at) == pytest.approx(solved.y[0], abs=1e-4)  # the steps fall between its own


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["zvx", "--mode", "1Hz:0"], 2, ["zvx", "did you mean", "zvd", "N-hump-ei"]),
        (["zv"], 2, ["--mode is missing"]),
        (["zv", "--mode", "0Hz:0"], 2, ["--mode 0Hz:0", "positive"]),
        (["zv", "--mode", "1Hz:1"], 2, ["damping ratio", "less than 1"]),
        (["zv", "--mode", "1:0.1"], 2, ["FREQUENCY(Hz|rad/s):DAMPING"]),
        (["zv", "--mode", "-1Hz:0"], 2, ["--mode -1Hz:0", "positive", "-6.28"]),
        (["zv", "--mode", "nanHz:nan"], 2, ["positive and finite, not nan", "at least 0 and less than 1", "not nan"]),
        (["zv", "--mode", "1e-320Hz:0"], 2, ["between 1e-100 and 1e+100 rad/s", "6.283e-320"]),
        (["zv", "--mode", "1Hz"], 2, ["no damping ratio", "1.0Hz:0.05"]),
        (["zv", "--mode", "xHz:y"], 2, ["frequency 'x' is no number; the damping ratio 'y' is no number"]),
        (["sna-zv", "--negative", "1e9", "--mode", "1Hz:0"], 2, ["1000000000.0 is more than 10000"]),
        (
            ["si", "--mode", "1Hz:0", "--band", "0.8:1.2@0.05", "--band", "0.9:1.1@0.1"],
            2,
            ["0.9:1.1@0.1 lies within 0.8:1.2@0.05", "below 0.05"],
        ),
        (["si", "--mode", "1Hz:0", "--band", "0.8:1.2", "--band", "0.8:1.2"], 2, ["says nothing"]),
        (["si", "--mode", "1Hz:0", "--band", "0.001:1000"], 2, ["factor of at most 1000"]),
        (["zvd", "--mode", "1Hz:0", "--sample-time", "1e-9"], 2, ["1e+09 samples", "4096", "0.0002441 s"]),
        (["dl-zv", "--mode", "1Hz:0", "--deflection", "0.4", "--sample-time", "1e-9"], 2, ["5e+08", "600", "0.0008333 s"]),
        (["pulses-zv", "--mode", "1Hz:0", "--height", "1e12"], 2, ["up to 2e+08 1/s"]),
        (["zv", "--mode", "1Hz:0", "--input", "-1:1"], 2, ["--input", "--move is made, which is missing"]),
        (["zv", "--mode", "1Hz:0", "--move", "0", "--input", "-1:1"], 2, ["not 0, not 0.0"]),
        (["custom", "--mode", "1Hz:0", "--impulses", "no.json"], 2, ["no.json cannot be read: No such file"]),
        (
            ["zvx", "--mode", "-1Hz:0", "--band", "3:1", "--tolerance", "7", "--move", "1", "--export", "a.txt", "--signal", "x"],
            2,
            ["7 mistakes", "a.txt", "--mode -1Hz:0", "--band 3:1", "--tolerance 7.0", "--move 1: needs", "no shaper 'zvx'", "--decay"],
        ),
        (["zv", "--mode", "1Hz:0", "--mode", "1e6Hz:0", "--simultaneous"], 1, ["not found:", "5e+05 periods", "up to 100"]),
        slow(["dl-zv", "--mode", "1Hz:0", "--deflection", "0.001"], 1, ["on up to 600 samples", "a larger limit needs fewer"]),
        (["ei", "--mode", "1Hz:0", "--tolerance", "1"], 2, ["--tolerance 1.0"]),
        (["ei", "--mode", "1Hz:0", "--negative", "0.3"], 2, ["--negative", "sna-zv"]),
        (["sna-zv", "--mode", "1Hz:0"], 2, ["--negative is missing; sna-zv needs it"]),
        (["sums-zv", "--mode", "1Hz:0"], 2, ["--sums is missing; sums-zv needs it"]),
        (["zv", "--mode", "1Hz:0", "--band", "1.2:0.8"], 2, ["--band 1.2:0.8", "LOW ≤ HIGH"]),
        (["zv", "--mode", "1Hz:0", "--band", "0:0.8"], 2, ["frequencies are positive"]),
        (["zv", "--mode", "1Hz:0", "--damping", "0.5:1.5"], 2, ["less than 1"]),
        (["zv", "--mode", "1Hz:0", "--sample-time", "-1"], 2, ["--sample-time"]),
        (["zv", "--mode", "1Hz:0", "--export", "taps.txt"], 2, ["taps.txt", ".cfg", ".g", ".h"]),
        (["ei", "--mode", "-1Hz:0", "--band", "x", "--tolerance", "7"], 2, ["3 mistakes"]),
        (["zv-d:2000", "--mode", "1Hz:0"], 2, ["2000 derivatives", "999"]),
        (["pulses-zv", "--mode", "1Hz:0", "--height", "0"], 2, ["--height 0.0: a positive number"]),
        slow(["pulses-zv", "--mode", "1Hz:0.05", "--height", "1e-9"], 2, ["1e+09 periods", "up to 10000"]),
        (["custom", "--mode", "1Hz:0", "--impulses", "0:1e308,1:-1e308,2:1"], 2, ["sum to at most 1e+150, not to inf"]),
        (["custom", "--mode", "1Hz:0", "--impulses", "0:0.5,0.5:0.4"], 2, ["error: --impulses: amplitudes sum to 1, not to 0.9"]),
        (["zv", "--mode", "1Hz:0", "--sample-time", "0.7"], 1, ["impossible", "0.5 s"]),
        (["sums-zv", "--mode", "1Hz:0", "--sums", "0.1:0.9"], 1, ["impossible", "at most 0 and at least 1"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_mistakes_are_named_and_leave_nothing(words: list[str], code: int, told: list[str], tmp_path: Path):
    done = run(*words, "--save", tmp_path / "shaper.json", "--json")
    assert done.exit_code == code
    assert [word for word in told if word not in done.stderr] == []
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_the_picture_of_the_readme_is_what_its_command_draws(tmp_path: Path):
    """Words and numbers of it: the last digits of the curves are the machine's."""
    again = tmp_path / "shaper.svg"
    assert run("si", "--mode", "1.0Hz:0.05", "--plot", again).exit_code == 0
    shipped = Path(__file__).parents[1] / "docs" / "shaper.svg"
    shown, drawn = (re.findall(r"<text[^>]*>([^<]*)</text>", file.read_text()) for file in (shipped, again))
    assert shown == drawn
    assert len(shown) > 10
