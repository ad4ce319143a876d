"""The shipped problem collection: what every file says of itself is proven, in one go, and checked in a fresh process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from fractions import Fraction
from math import acos, acosh, e, log, pi, sqrt
from pathlib import Path

import numpy as np
import pytest

from relaxations.bounds import Status
from relaxations.response import response
from suite import console
from suite.collection import Bracketed, bracket, collect
from suite.plants import nominal_plant

ROOT = Path(__file__).parents[1]
PROBLEMS = ROOT / "suite" / "problems"
FILES = collect([PROBLEMS])
SLEWCERT = Path(sys.executable).with_name("slewcert")

GAP = 1e-12  # relative; a regular optimum is claimed a double below and a double above its duration
STAIRCASES = {
    "two_mass_one_switch": 1e-8,
    "two_mass_sampled": 0.0,
    "rigid_body_sampled": 0.0,
    "varying_crane_limits": 1e-15,
    "rigid_body_speed": 1e-5,
    "rigid_body_steps": 1e-15,
    "stop_of_limited_jerk": 1e-5,
    "two_mass_rate": 1e-5,
    "two_mass_spring_limit": 1e-5,
    "two_mass_box": 1e-4,
    "two_mass_box_thrusters": 1e-4,
    "two_mass_two_pulses": 1.1e-6,
}
"""Degenerate optima: the upper side is a repaired staircase, 1e-9 beyond the minimum time or ten times that; samples are exact.
With further limits, and for a whole box, both sides are those of a grid."""
PATTERNS = {"two_mass_box_thrusters", "two_mass_two_pulses"}
"""Of these the upper side has exact switch times all the same: pulses of a pattern."""

FACTS = {
    # Known independently of this project: Newton's method in 25 to 30 digits on the switch times (as text, with the digits that are sure) …
    "two_mass_1": "4.2178665105",
    "two_mass_5": "6.6627284203",
    "two_mass_robust_1": "5.8659584390",
    "two_mass_position_1": "4.2178665105",
    "actuator_lag_ignored": "4.2178665105",
    "chain_03": "6.5107768002",
    "chain_04": "9.5933833916",
    "chain_06": "14.7227905482",
    "chain_08": "19.7430923674",
    "chain_11": "27.0783724616",
    "chain_12": "28.4927336597",
    "two_mass_fuel": "8.1107317945",
    "two_mass_fuel_robust": "9.2461624729",
    "two_mass_spring_limit": "4.7565",
    "rigid_body_speed": 2.5,
    "rigid_body_steps": "2.73",
    "stop_of_limited_jerk": 1.25,
    "two_mass_rate": "4.321",
    "two_mass_sampled": "6.75",
    "rigid_body_sampled": 2.0,
    "two_mass_thrusters": "6.6627284203",
    "two_mass_two_pulses": pi * sqrt(2) + 10 / (pi * sqrt(2)),
    "two_mass_box": "7.2697",
    "two_mass_box_thrusters": "7.2697",
    "varying_gain_thrusters": "1.5391950535",
    "emergency_stop": "3.1510411012",
    "swinging_load": acos(-1 / 4),
    "stop_and_return": 1 + sqrt(2),
    "varying_crane": "6.9616579172",
    "varying_crane_limits": "8.2",
    "varying_crane_swinging": "7.1148087641",
    "varying_gain": "1.5391950535",
    "pitch_state": "13.37",
    "pitch_tail": "3.31",
    "tail_touches_limits": "9.0910458905",
    # … or in closed form.
    "two_mass_one_switch": sqrt(8) * pi,
    "real_mode": -2 * log(1 - sqrt(1 - 1 / e)) - 1,
    "rigid_body_asymmetric": sqrt(2 * 2 * 4 / 3),
    "triple_integrator": 32 ** (1 / 3),
    "unstable": log(1.9),
    "unstable_pendulum": acosh(11 / 4),
    "spring_mass": acos(1 / 4),
    "spring_mass_one_sided": acos(-1 / 4),
    "spring_mass_limits_are_rests": 2 * pi / 3,
    "one_zero_state": acos(-1 / 3) / sqrt(2),
    "complex_zeros_state": acos(1 / 15),
    "real_zeros_state": acos(1 / 8) / sqrt(2),
    "complex_zeros_at_once": 0.0,
}
IMPOSSIBLE = {"impossible_cannot_pull", "impossible_fuel", "impossible_rest_on_limit"}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("certificates")


@pytest.fixture(scope="module")
def collection(certificates: Path) -> dict[str, Bracketed]:
    """Every problem, bracketed once."""
    return {file.stem: bracket(file, certificates / f"{file.stem}.certificate.json") for file in FILES}


def sides(done: Bracketed) -> tuple[float, float]:
    bound = done.design.bound
    assert bound.status is Status.PROVED, bound.reason
    assert bound.upper is not None
    return bound.lower, bound.upper


def holds(number: str, lower: float, upper: float) -> bool:
    """Whether the number that was rounded to `number` may lie between the sides."""
    half = Fraction(1, 2 * 10 ** len(number.partition(".")[2]))
    return Fraction(lower) - half <= Fraction(number) <= Fraction(upper) + half


@pytest.mark.parametrize("name", [file.stem for file in FILES])
def test_everything_is_proven(name: str, collection: dict[str, Bracketed]):
    done = collection[name]
    if name in IMPOSSIBLE:
        assert done.impossible
        return
    lower, upper = sides(done)
    assert upper - lower <= STAIRCASES.get(name, GAP) * lower
    assert (done.design.bound.switches is None) is (name in STAIRCASES.keys() - PATTERNS)


@pytest.mark.parametrize("name", FACTS)
def test_known_minimum_times(name: str, collection: dict[str, Bracketed]):
    lower, upper = sides(collection[name])
    fact = FACTS[name]
    if isinstance(fact, str):
        assert holds(fact, lower, upper)
    else:  # a few roundings in the closed form
        assert lower - 1e-14 * fact <= fact <= upper + 1e-14 * fact


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_file_tells_its_minimum_time_and_has_it(file: Path, collection: dict[str, Bracketed]):
    comment = [line.removeprefix("#").strip() for line in file.read_text().splitlines() if line.startswith("#")]
    told = [re.search(r"([\d.]+)(?= s\b|$)", line) for line in comment if line.startswith("T* =")]
    if file.stem in IMPOSSIBLE:
        assert comment[-1] == "Impossible in any time."
        return
    (found,) = told
    assert found is not None
    assert holds(found[1], *sides(collection[file.stem]))


def test_switch_times_that_a_file_tells_are_those_of_the_command(collection: dict[str, Bracketed]):
    told = {file.stem: re.search(r"(?m)^# (?:Switches|One switch) at ([^\n]*(?:\n# [^T\n][^\n]*)*)", file.read_text()) for file in FILES}
    checked = 0
    for name, match in told.items():
        if match is None:
            continue
        # What a source prints with fewer digits is no claim of the file.
        numbers = [float(number) for number in re.findall(r"\d\.\d{10}", match[1])]
        command = collection[name].design.command
        assert command is not None
        assert [segment.start for segment in command.segments[1:]] == pytest.approx(numbers, abs=5.1e-11)
        checked += 1
    assert checked == 8


def test_every_certificate_is_verified_in_one_fresh_process(certificates: Path, collection: dict[str, Bracketed]):
    files = sorted(certificates.glob("*.json"))
    least = {done.proof.name for done in collection.values() if done.proof is not None}  # a budget that is too little has a second proof
    assert least == {"impossible_fuel.certificate.least-fuel.json"}
    assert {file.name for file in files} == {f"{name}.certificate.json" for name in collection} | least
    done = subprocess.run([SLEWCERT, "check", "--json", *files], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    for file, record in zip(files, json.loads(done.stdout)["files"], strict=True):
        name = file.name.split(".")[0]
        assert record["status"] == "proved", name
        if name in IMPOSSIBLE:
            assert record["impossible"]
            assert record["maneuver_time"] is None
            continue
        # Decimals rounded outward from the same rationals that the doubles were rounded outward from.
        lower, upper = sides(collection[name])
        assert float(record["maneuver_time"]["lower"]) == pytest.approx(lower, rel=1e-15)
        assert float(record["maneuver_time"]["upper"]) == pytest.approx(upper, rel=1e-15)


@pytest.mark.slow
def test_certificates_are_about_their_own_study(certificates: Path, collection: dict[str, Bracketed]):
    del collection
    certificate = certificates / "two_mass_1.certificate.json"
    for study, said, code in (("two_mass_1", "matches", 0), ("two_mass_5", "differs", 1)):
        command = [SLEWCERT, "check", "--json", certificate, "--study", PROBLEMS / f"{study}.toml"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert (json.loads(done.stdout)["study"], done.returncode) == (said, code), done.stderr


# Pairs: what one line more in a study changes.


@pytest.mark.parametrize("name", ["one_zero", "complex_zeros", "mixed_zeros", "pitch"])
def test_an_output_rest_is_sooner_than_a_rest_of_the_state(name: str, collection: dict[str, Bracketed]):
    assert sides(collection[f"{name}_tail"])[1] < 0.7 * sides(collection[f"{name}_state"])[0]


@pytest.mark.parametrize(
    ("less", "more"),
    [
        ("pitch_tail", "pitch_tail_robust"),
        ("pitch_tail", "pitch_tail_short"),
        ("pitch_tail_short", "pitch_state"),
        ("pitch_tail", "pitch_tail_insensitive"),
        ("pitch_tail_insensitive", "pitch_state"),
        ("two_mass_1", "two_mass_robust_1"),
        ("two_mass_robust_1", "two_mass_robust_2"),
        ("two_mass_5", "two_mass_robust_5"),
        ("two_mass_5", "two_mass_sampled"),
        ("two_mass_asymmetric", "two_mass_1"),
        ("modal_sum", "modal_sum_robust"),
        ("actuator_lag_included", "actuator_lag_robust_real"),
        ("actuator_lag_robust_real", "actuator_lag_robust_both"),
        ("spring_mass", "spring_mass_one_sided"),
    ],
)
def test_more_that_is_asked_takes_longer(less: str, more: str, collection: dict[str, Bracketed]):
    assert sides(collection[less])[1] < sides(collection[more])[0]


def test_a_real_mode_that_is_ignored_makes_a_shorter_command_that_does_not_stop_the_plant(collection: dict[str, Bracketed]):
    ignored, included = (collection[f"actuator_lag_{name}"] for name in ("ignored", "included"))
    assert sides(ignored)[1] < sides(included)[0]
    true = nominal_plant(included.study)
    left = {}
    for name, done in (("ignored", ignored), ("included", included)):
        command = done.design.command
        assert command is not None
        after = np.linspace(command.end, command.end + 20.0, 2001)
        left[name] = float(np.abs(response(true, command, after) - 1.0).max())
    assert left["included"] < 1e-12
    assert left["ignored"] == pytest.approx(0.366, abs=5e-4)


def test_readme_quotes_the_table(collection: dict[str, Bracketed], capsys: pytest.CaptureFixture[str]):
    """Milliseconds apart, and but for the last digits of a staircase, which is as good as the solver was on the day."""
    console.show_collection(list(collection.values()))
    printed = [cells(line) for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    (quoted,) = re.findall(r"(?ms)^\$ slewcert bound suite/problems\n(.*?)^```", (ROOT / "README.md").read_text())
    rows = [cells(line) for line in quoted.splitlines() if line.startswith("│")]
    assert [row[0] for row in rows] == [row[0] for row in printed]
    for told, row in zip(rows, printed, strict=True):
        if row[0] in STAIRCASES:
            assert [float(x) for x in told[4:6]] == pytest.approx([float(x) for x in row[4:6]], rel=2 * STAIRCASES[row[0]])
            told, row = (x[:4] + x[7:] for x in (told, row))
        assert told[:-1] == row[:-1]
    assert f"{len(FILES)} studies, {len(FILES)} proven" in quoted


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("│").split("│")]
