"""The sweep of budgets: known digits as the command prints them, order and brackets, prudent choices, mistakes told; pictures and page."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from independent_limits import Limited

from relaxations.checking.claims import Outcome, check
from relaxations.plants import LinearPlant, exact
from suite.cli import main
from suite.fuel_plans import FuelError, kinds, spread, written
from suite.fuel_records import Kind, Pulses
from suite.sweeps import extrapolated

STUDIES = Path(__file__).parents[1] / "suite" / "studies"
NUMBERS = """
[plant]
{plant}
[maneuver]
displacement = {displacement}
[limits]
input = [{limits}]
{limit}
[command]
{command}
"""
SPRING = "numerator = [1.0]\ndenominator = [1.0, 0.0, 2.0, 0.0, 0.0]"
LAG = "numerator = [1.0]\ndenominator = [1.0, 1.0, 0.0]"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["fuel", *(str(argument) for argument in arguments)], catch_exceptions=False)


def study_file(
    folder: Path,
    plant: str = SPRING,
    *,
    displacement: str = "5.0",
    limits: str = "-1.0, 1.0",
    limit: str = "",
    command: str = "",
    more: str = "",
) -> Path:
    file = folder / "study.toml"
    file.write_text(NUMBERS.format(plant=plant, displacement=displacement, limits=limits, limit=limit, command=command))
    return file


@cache
def swept(folder: Path) -> tuple[dict[str, Any], Path]:
    """The paper's example at a few budgets, with everything that the command writes."""
    out = folder / "out"
    budgets = [word for fuel in ("3", "3.5", "6.7") for word in ("--show", fuel)]
    result = run(
        STUDIES / "two_mass_fuel.toml", "--from", 2, "--to", 7, "--points", 6, *budgets, "--out", out, "--no-held",
        "--certificates", out / "proofs", "--plot", out / "over.svg", "--json",
    )  # fmt: skip
    assert result.exit_code == 0
    return json.loads(result.stdout), out


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    return swept(tmp_path_factory.getbasetemp())


def curve(record: dict[str, Any], kind: str) -> dict[str, Any]:
    return next(one for one in record["curves"] if one["kind"] == kind)


def point(record: dict[str, Any], kind: str, fuel: float) -> dict[str, Any]:
    return next(one for one in curve(record, kind)["points"] if one["fuel"] == fuel)


# The paper's numbers, to ten digits by Newton's method on the switch times: F20, F21, and the budgets that are no profile's of it.


@pytest.mark.slow
def test_known_profiles_as_the_command_prints_them(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found
    zv, zvd = point(record, "zv", 4.0), point(record, "zvd", 3.5)
    assert zv["maneuver_time"]["upper"] == pytest.approx(8.1107317945, abs=6e-11)
    assert zv["switch_times"][1:4] == pytest.approx([0.8169711992, 1.7558594103, 2.9388882111], abs=6e-11)
    assert zv["sides"] == [1, 0, 1, 0, -1, 0, -1]
    assert zv["insensitivity"] == pytest.approx(0.10653, abs=5e-6)
    assert zvd["maneuver_time"]["upper"] == pytest.approx(9.2461624729, abs=6e-11)
    assert zvd["switch_times"][1:4] == pytest.approx([0.5501287725, 1.8495533507, 3.0494245782], abs=6e-11)
    other = point(record, "zv", 3.5)
    assert other["maneuver_time"]["upper"] == pytest.approx(8.7965032368, abs=6e-11)
    assert other["insensitivity"] == pytest.approx(0.01423, abs=5e-6)  # the paper says 0.012


def test_what_fuel_buys(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found

    def time(kind: str, fuel: float) -> float:
        return point(record, kind, fuel)["maneuver_time"]["upper"]

    assert time("zv", 4.502) - time("zv", 6.7) == pytest.approx(0.0309, abs=1e-4)
    costs = [time(kind, 3.0) - time(kind, 4.0) for kind in ("rb", "zv", "zvd")]
    assert sum(costs) / 3 == pytest.approx(1.531, abs=5e-4)


def test_nodes_are_named_in_closed_form(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found
    named = {choice["node"]["number"]: choice for choice in record["choices"] if choice["node"]}
    assert sorted(named) == [1, 2]
    for number, fuel, time in ((1, 4.5015815808, 6.6936737286), (2, 2.2507907904, 10.0111612715)):
        node = named[number]["node"]
        assert node["fuel"] == pytest.approx(fuel, abs=6e-11)
        assert node["maneuver_time"] == pytest.approx(time, abs=6e-11)
        assert fuel <= named[number]["fuel"] <= fuel * 1.001  # what stands in a study is a little more, of few digits
        assert point(record, "zv", named[number]["fuel"])["maneuver_time"]["lower"] <= time
    assert [choice["kind"] for choice in record["choices"] if choice["node"] is None] == ["zvd"] * len(curve(record, "zvd")["knees"])


def test_every_point_is_proven_and_more_fuel_takes_no_more_time(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found
    for one in record["curves"]:
        assert [p["status"] for p in one["points"]] == ["proved"] * len(one["points"])
        for less, more in pairwise(one["points"]):
            assert less["fuel"] < more["fuel"]
            assert more["maneuver_time"]["lower"] <= less["maneuver_time"]["upper"]
            assert less["maneuver_time"]["lower"] >= more["maneuver_time"]["lower"] - 1e-14
        assert all(p["burnt"] <= p["fuel"] * (1 + 1e-14) for p in one["points"])
    for fuel in (p["fuel"] for p in curve(record, "rb")["points"]):  # what asks for more takes longer
        times = [point(record, kind, fuel)["maneuver_time"] for kind in ("rb", "zv", "zvd")]
        assert all(a["lower"] <= b["upper"] for a, b in pairwise(times))


def test_the_rigid_body_in_closed_form(found: tuple[dict[str, Any], Path]) -> None:
    # M = 2, Δ = 5, |u| ≤ 1: T = 2 M Δ/U + U/2, as long as there is a coast, U < √(4 M Δ)
    record, _ = found
    for one in curve(record, "rb")["points"]:
        fuel = one["fuel"]
        assert one["maneuver_time"]["upper"] == pytest.approx(20 / fuel + fuel / 2 if fuel < math.sqrt(40) else math.sqrt(40), rel=1e-14)


def test_certificates_are_about_their_budgets(found: tuple[dict[str, Any], Path]) -> None:
    record, out = found
    files = [p["certificate"] for one in record["curves"] for p in (*one["points"], one["unlimited"])]
    assert len({*files}) == len(files) == len(list((out / "proofs").iterdir()))
    chosen = Path(point(record, "zvd", 3.5)["certificate"])
    assert chosen.name == "two_mass_fuel.zvd.3.5.certificate.json"
    assert check(chosen.read_bytes()).outcome is Outcome.PROVED
    assert json.loads(chosen.read_bytes())["task"]["limits"]["fuel"] == "3.5"


def test_profiles_turn_to_type_two(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found
    assert [point(record, "zv", fuel)["type"] for fuel in (4.0, 4.502)] == [1, 2]
    assert [point(record, "zvd", fuel)["type"] for fuel in (4.502, 5.0)] == [1, 2]
    assert point(record, "rb", 7.0)["pulses"] == 2


def test_pictures_and_page_show_what_was_found(found: tuple[dict[str, Any], Path]) -> None:
    record, out = found
    names = {"fuel.html", "fuel.json", "over.svg", "proofs", "slew-time.svg", "insensitivity.svg", "sensitivity.svg", "higher-mode.svg"}
    assert {path.name for path in out.iterdir()} == names | {f"switches-{kind}.svg" for kind in ("rb", "zv", "zvd")}
    assert json.loads((out / "fuel.json").read_text()) == {key: value for key, value in record.items() if key != "files"}
    page = (out / "fuel.html").read_text()
    assert "<script" not in page
    assert "default-src 'none'" in page
    assert page.count("<svg") == 7
    assert "limits.fuel = 4.502" in page
    words = {file.stem: re.findall(r"<text[^>]*>([^<]*)</text>", file.read_text()) for file in out.glob("*.svg")}
    for name, wanted in {
        "slew-time": ["fuel [N·s]", "slew time [s]", "rigid body", "ZV", "ZVD", "n = 1", "too fast for any rigid body command: proven"],
        "switches-zv": ["time in the move [s]", "+1 N", "\u22121 N", "end of the move"],
        "insensitivity": ["5 % insensitivity [% of the frequency]"],
        "sensitivity": ["ZV, 3.5 N·s: insensitivity 1.42 %", "5 %"],
        "higher-mode": ["largest residual [steps of the input]"],
    }.items():
        assert set(wanted) <= set(words[name]), words[name]
    assert {"Slew time", "Insensitivity", "Switches, ZV", "Switches, ZVD"} <= set(words["over"])


def test_text_names_choices_and_says_how_a_point_becomes_a_study(tmp_path: Path) -> None:
    result = run(study_file(tmp_path), "--from", 4, "--to", 5, "--points", 2, "--kind", "ZV", "--no-held", "--out", tmp_path)
    assert result.exit_code == 0
    assert "ZV, 4.502 input·s: just above node 1, at one pulse either way (exactly 4.5015815808 input·s, 6.6936737286 s)" in result.stdout
    assert "of type 1 up to 4 input·s, of type 2 from 4.502 input·s on" in result.stdout
    assert "fuel = 4.502 under [limits], robustness = 0 under [command]" in result.stdout
    assert "3 budgets, 3 minimum times, 3 proven" in result.stdout


@pytest.mark.slow
def test_the_form_is_held_where_the_fastest_command_is_not_of_it(tmp_path: Path) -> None:
    # the paper has the form until some 5.4 N·s, and no discernible difference in time
    file = study_file(tmp_path)
    record = json.loads(run(file, "--from", 4.9, "--to", 5.6, "--points", 3, "--kind", "zvd", "--json", "--certificates", tmp_path).stdout)
    (found,) = record["curves"]
    efficient, free = found["fuel_efficient"], found["unlimited"]
    assert efficient["burnt"] == pytest.approx(5.349746, abs=1e-6)
    assert (efficient["status"], efficient["type"], efficient["fuel"]) == ("proved", 1, None)
    assert efficient["maneuver_time"]["lower"] > free["maneuver_time"]["upper"]
    assert [(p["fuel"], p["type"]) for p in found["points"]] == [(4.9, 1), (5.25, 2), (5.6, 2)]
    (held,) = found["held"]  # at 4.9 the fastest is of the form; at 5.6 the form does not burn so much
    assert (held["fuel"], held["type"]) == (5.25, 1)
    assert held["maneuver_time"]["lower"] > found["points"][1]["maneuver_time"]["upper"]
    assert held["maneuver_time"]["upper"] <= found["points"][1]["maneuver_time"]["upper"] * 1.002
    content = Path(held["certificate"]).read_bytes()
    assert check(content).outcome is Outcome.PROVED
    assert json.loads(content)["task"] != json.loads(Path(found["points"][1]["certificate"]).read_bytes())["task"]


# Without a word about the range, and plants of other kinds.


@pytest.mark.slow
def test_the_range_of_budgets_is_what_the_kinds_burn(tmp_path: Path) -> None:
    record = json.loads(run(study_file(tmp_path, limit="fuel = 3.75"), "--points", 2, "--kind", "zv", "--no-held", "--json").stdout)
    fuels = [p["fuel"] for p in record["curves"][0]["points"]]
    burnt = record["curves"][0]["unlimited"]["burnt"]
    assert burnt == pytest.approx(6.6627284203)
    assert fuels[-1] == 6.67
    assert fuels[0] == 0.96
    assert 3.75 in fuels  # the study's own
    assert set(np.round(fuels, 3)) >= {4.502, 2.251}


def test_a_plant_without_flexible_modes_has_one_kind(tmp_path: Path) -> None:
    record = json.loads(run(study_file(tmp_path, LAG, displacement="1.0"), "--from", 1.05, "--to", 1.1, "--points", 2, "--json").stdout)
    assert [one["kind"] for one in record["curves"]] == ["rb"]
    assert any("no flexible mode" in note for note in record["notes"])
    assert record["curves"][0]["points"][-1]["maneuver_time"]["upper"] == pytest.approx(math.log((math.e**1.05 - 1) / (1 - math.e**-0.05)))


def test_too_little_fuel_is_proven_and_the_least_is_named(tmp_path: Path) -> None:
    file = study_file(tmp_path, LAG, displacement="1.0")
    result = run(file, "--from", 0.9, "--to", 1.1, "--points", 3, "--json")
    assert result.exit_code == 1
    record = json.loads(result.stdout)["curves"][0]
    assert [p["status"] for p in record["points"]][0::2] == ["impossible", "proved"]
    assert record["least_fuel"] == pytest.approx(1.0, rel=1e-6)
    assert record["least_fuel"] <= 1.0
    text = run(file, "--from", 0.9, "--to", 1.1, "--points", 2, "--out", tmp_path).stdout
    assert "0.9 input·s and less is too little, proven: every command needs 1 input·s or more" in text


MISTAKES = [
    ((), ("--from", "3", "--to", "3"), "--from 3 --to 3: the sweep goes from less fuel to more"),
    ((), ("--from", "7", "--to", "3"), "from less fuel to more"),
    ((), ("--from", "0", "--to", "3"), "--from 0: without fuel nothing moves"),
    ((), ("--from", "-1"), "more than 0"),
    ((), ("--to", "much"), "--to is an amount of fuel"),
    ((), ("--points", "1"), "--points 1: from 2 to"),
    ((), ("--kind", "zvx"), "--kind zvx: rb (rigid body), zv, zvd"),
    ((), ("--level", "5"), "--level 5: a fraction"),
    ((), ("--higher-mode", "1"), "--higher-mode 1: times the highest frequency"),
    ((), ("--plot", "fuel.png"), "the picture is an SVG"),
    ((), ("--from", "3", "--to", "4", "--show", "9"), "--show 9 is outside the sweep, 3 to 4"),
    (("plant", "numerator = [1.0]\ndenominator = [1.0, 0.0, 1.0]"), (), "has no rigid-body mode: an input of 0.5 holds it at its target"),
    (("command", "tail = true"), (), "a tail, whose fuel no budget counts"),
    (("displacement", "5.0\ninitial_state = [0.1, 0.0, 0.0, 0.0]"), (), "kinds of commands are compared on a move from rest"),
]


@pytest.mark.parametrize(("changed", "options", "words"), MISTAKES, ids=[words for *_, words in MISTAKES])
def test_mistakes_are_told(tmp_path: Path, changed: tuple[str, str] | tuple[()], options: Sequence[str], words: str) -> None:
    given: dict[str, str] = dict([changed]) if changed else {}
    if "plant" in given:
        given["displacement"] = "0.5"
    result = run(study_file(tmp_path, **given), *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr


# The parts.


def test_kinds_are_read_once_each_and_count_their_zeros() -> None:
    assert kinds(["ZV", "rb", "zv", "zvddd"]) == (Kind("zv", 0), Kind("rb", None), Kind("zvddd", 3))
    for wrong in ("", "zvv", "zd", "rbd", "zv" + "d" * 7):
        with pytest.raises(FuelError, match="--kind"):
            kinds([wrong])


@pytest.mark.parametrize(
    ("sides", "kind", "count"),
    [
        ((1, -1), 1, 2),
        ((1, 0, 1, 0, -1, 0, -1), 1, 4),
        ((-1, 0, 1), 1, 2),
        ((1, -1, 1, -1), 2, 4),
        ((1, 0, -1, 0, 1, 0, -1), 2, 4),
        ((1, 0, 1), 1, 2),
    ],
)
def test_types_of_profiles(sides: tuple[int, ...], kind: int, count: int) -> None:
    profile = Pulses(tuple(float(i) for i in range(len(sides) + 1)), sides)
    assert (profile.type, profile.count) == (kind, count)


def test_budgets_are_decimals_that_a_study_can_be_given() -> None:
    rng = np.random.default_rng(2026)
    for _ in range(50):
        low = exact(f"{10 ** rng.uniform(-3, 3):.3g}")
        high, count = low * exact(f"{rng.uniform(1.01, 9):.3g}"), int(rng.integers(2, 300))
        budgets = spread(low, high, count)
        assert (budgets[0], budgets[-1], len(budgets)) == (low, high, count)
        assert all(a < b for a, b in pairwise(budgets))
        assert all(Fraction(written(fuel)) == fuel for fuel in budgets)
        step = float(high - low) / (count - 1)
        assert max(abs(float(b - a) - step) for a, b in pairwise(budgets)) <= 2e-3 * step


def test_a_line_through_the_last_two_is_the_guess() -> None:
    assert extrapolated([], Fraction(1)) is None
    assert extrapolated([(Fraction(2), 5.0)], Fraction(1)) == 5.0
    assert extrapolated([(Fraction(3), 4.0), (Fraction(2), 5.0)], Fraction(1)) == 6.0
    assert extrapolated([(Fraction(3), 40.0), (Fraction(2), 5.0)], Fraction(1)) == 5.0  # a line that would be below half


def test_without_a_word_the_pictures_go_to_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(study_file(tmp_path, LAG, displacement="1.0"), "--from", 1.1, "--to", 1.2, "--points", 2).exit_code == 0
    assert {path.name for path in (tmp_path / "study-fuel").iterdir()} == {"fuel.html", "fuel.json", "slew-time.svg", "switches-rb.svg"}


# Against another program, and machines of every kind that is shipped.


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_machines_against_another_program(seed: int, tmp_path: Path) -> None:
    """Minimum times by HiGHS on a grid that shares nothing with ours, which can only be slower; unequal limits and damping too."""
    rng = np.random.default_rng([2026, 7, seed])
    omega, zeta = rng.uniform(1.0, 3.0), rng.choice([0.0, 0.03])
    bottom = [float(f"{c:.4g}") for c in np.polymul([1, 0, 0], [1, 2 * zeta * omega, omega**2])]
    low, high = -float(f"{rng.uniform(0.5, 2):.3g}"), float(f"{rng.uniform(0.5, 2):.3g}")
    file = study_file(tmp_path, f"numerator = [1.0]\ndenominator = {bottom}", displacement="2.0", limits=f"{low}, {high}")
    result = run(file, "--points", 7, "--kind", "zv", "--no-held", "--json")
    assert result.exit_code == 0
    (found,) = json.loads(result.stdout)["curves"]
    plant = LinearPlant.from_transfer([1], bottom)
    for one in found["points"][::3]:
        assert one["status"] == "proved"
        lower, upper = one["maneuver_time"]["lower"], one["maneuver_time"]["upper"]
        other = Limited(plant, 2.0, low, high, one["fuel"]).time(0.98 * lower, 1.05 * upper, 150, 1e-4)
        assert other >= lower * (1 - 1e-6)
        assert other == pytest.approx(upper, rel=6e-3)  # what a grid of 150 steps is slower


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spacecraft", "robot_arm", "disk_drive", "chain", "gantry_crane", "two_mass_rate"])
def test_shipped_machines(name: str) -> None:
    """Two modes, damping, a lag of the actuator, six masses, a swinging load, limits of the slope: proven, and in order."""
    result = run(STUDIES / f"{name}.toml", "--points", 5, "--no-held", "--json")
    assert result.exit_code == 0
    for one in json.loads(result.stdout)["curves"]:
        assert {p["status"] for p in one["points"]} == {"proved"}
        assert all(more["maneuver_time"]["lower"] <= less["maneuver_time"]["upper"] for less, more in pairwise(one["points"]))
        assert all(more["maneuver_time"]["upper"] <= less["maneuver_time"]["upper"] * 1.0001 for less, more in pairwise(one["points"]))
