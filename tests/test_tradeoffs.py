"""The trade-off: every point is a theorem with its own certificate, in the right order, and none is left out of text, JSON or picture."""

from __future__ import annotations

import json
import math
import re
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from small_studies import SPRING_STUDY

from relaxations.checking.claims import Outcome, check
from reports.charts import Limit
from reports.errors import RecordError
from reports.tradeoff_charts import Sweep, tradeoff
from suite.cli import main
from suite.tradeoffs import TradeoffError, tolerances, widths

TWO_MASS = """
[plant]
fmu = "two_mass"
input = "force"
output = "position_2"
{plant}
[maneuver]
displacement = 5.0
[limits]
input = [-1.0, 1.0]
[command]
robustness = "box"
tolerance = 0.1
{command}
[[uncertainty]]
parameter = "{parameter}"
range = [{range}]
samples = 3
"""


PROBLEMS = Path(__file__).parents[1] / "suite" / "problems"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


def study_file(
    folder: Path, parameter: str = "stiffness", ranges: str = "0.7, 1.3", plant: str = "", command: str = "", name: str = "study"
) -> Path:
    file = folder / f"{name}.toml"
    file.write_text(TWO_MASS.format(parameter=parameter, range=ranges, plant=plant, command=command))
    return file


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The JSON of a trade-off over ± 30 % of the stiffness, and the folder with its picture and certificates."""
    folder = tmp_path_factory.mktemp("tradeoff")
    options = ("--tolerances", "0.05:0.2:2", "--widths", "0:1.5:4", "--plot", folder / "p.svg", "--certificates", folder / "proofs")
    done = run("tradeoff", study_file(folder), *options, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout), folder


def sides(point: dict[str, Any]) -> tuple[float, float]:
    return point["maneuver_time"]["lower"], point["maneuver_time"]["upper"]


def test_points_are_those_asked_for_and_the_study_s_own(found: tuple[dict[str, Any], Path]) -> None:
    record, _ = found
    assert [point["tolerance"] for point in record["tolerances"]] == [0.05, 0.1, 0.2]
    assert [point["width"] for point in record["widths"]] == [0.0, 0.5, 1.0, 1.5]
    assert [point["ranges"]["stiffness"] for point in record["widths"]] == [[1.0, 1.0], [0.85, 1.15], [0.7, 1.3], [0.55, 1.45]]
    assert record["tolerances"][1] == record["widths"][2], "the study's own point is in both"
    assert {point["status"] for point in (*record["tolerances"], *record["widths"])} == {"proved"}
    assert {point["proven"]["lower"] and point["proven"]["upper"] for point in record["widths"]} == {True}


def test_more_is_never_faster(found: tuple[dict[str, Any], Path]) -> None:
    """A smaller tolerance and a wider box ask for more; with a residual allowed the nominal plant alone is faster than exactly at rest."""
    record, _ = found
    for points in (record["tolerances"][::-1], record["widths"]):
        for easier, harder in pairwise(points):
            assert sides(easier)[0] <= sides(harder)[1]
            assert sides(easier)[1] < sides(harder)[0], "here the brackets are apart"
    exact = record["commands"][0]
    assert exact["robustness"] == 0
    assert sides(exact) == (pytest.approx(6.6627284203, abs=1e-9),) * 2
    assert sides(record["widths"][0])[1] < sides(exact)[0]


def test_known_values(found: tuple[dict[str, Any], Path]) -> None:
    """5 % of any stiffness within 30 %, and what the usual commands leave there: both known from the robust task's own tests."""
    record, _ = found
    lower, upper = sides(record["tolerances"][0])
    assert lower <= 7.26970 <= 7.26991 <= upper
    left = {command["robustness"]: command["worst_residual"] for command in record["commands"]}
    assert left == {0: pytest.approx(0.139429, rel=1e-4), 1: pytest.approx(0.04633, rel=1e-4), 2: pytest.approx(0.012733, rel=1e-4)}


@pytest.mark.slow
def test_every_point_s_certificate_is_checked_and_says_what_the_point_says(found: tuple[dict[str, Any], Path]) -> None:
    record, folder = found
    points = [*record["tolerances"], *(point for point in record["widths"] if point["width"] != 1.0)]
    for point in points:
        checked = check(Path(point["certificate"]).read_bytes())
        assert checked.outcome is Outcome.PROVED
        assert checked.certificate is not None
        task, claim = checked.certificate.task, checked.certificate.claim
        assert float(Fraction(int(task.box.tolerance.p), int(task.box.tolerance.q))) == point["tolerance"]
        assert [[float(p.low.p) / float(p.low.q), float(p.high.p) / float(p.high.q)] for p in task.box.parameters] == [
            pytest.approx(ends, abs=1e-15) for ends in point["ranges"].values()
        ]
        assert claim.lower is not None
        assert claim.upper is not None
        assert sides(point) == pytest.approx((float(claim.lower.p) / float(claim.lower.q), float(claim.upper.p) / float(claim.upper.q)))
    names = {path.name for path in (folder / "proofs").iterdir()}
    assert len(names) == len(points) + 6, "each usual command's own, and what it leaves"
    assert run("check", *sorted((folder / "proofs").iterdir())).exit_code == 0
    own = record["tolerances"][1]["certificate"]
    assert run("check", own, "--study", folder / "study.toml").exit_code == 0, "the study's own point is about the study"


def test_the_picture_names_everything(found: tuple[dict[str, Any], Path]) -> None:
    _, folder = found
    words = re.findall(r"<text[^>]*>([^<]*)</text>", (folder / "p.svg").read_text())
    for wanted in (
        *("no command is this fast: proven", "not known between the points", "this study", "minimum time [s]"),
        *("For stiffness 0.7 to 1.3 N/m", "With a residual of at most 10 %", "range of stiffness to both sides [± %]"),
        *("nominal plant alone, exactly at rest: 6.6627 s", "with a further zero: 7.6654 s, leaves ≤ 4.6331 %"),
    ):
        assert wanted in words


def test_without_a_box_there_are_tolerances_only_and_they_are_the_box_of_width_zero(
    found: tuple[dict[str, Any], Path], tmp_path: Path
) -> None:
    (tmp_path / "n.toml").write_text(SPRING_STUDY)
    done = run(
        "tradeoff", tmp_path / "n.toml", "--tolerances", "0.1:0.2:2", "--json", "--certificates", tmp_path, "--plot", tmp_path / "n.svg"
    )
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert record["widths"] == []
    assert [point["tolerance"] for point in record["tolerances"]] == [0.05, 0.1, 0.2]
    assert any("no box to widen" in note for note in record["notes"])
    mine, other = sides(record["tolerances"][1]), sides(found[0]["widths"][0])
    assert mine[0] <= other[1]
    assert other[0] <= mine[1]
    assert check(Path(record["tolerances"][0]["certificate"]).read_bytes()).outcome is Outcome.PROVED
    refused = run("tradeoff", tmp_path / "n.toml", "--widths", "0:1:2")
    assert refused.exit_code == 2
    assert "nothing that --widths could widen" in refused.stderr


@pytest.mark.slow
def test_what_is_impossible_or_no_task_is_shown_as_such(tmp_path: Path) -> None:
    """With another mass the load rests elsewhere, whatever the command: more than 5 % off beyond ± 10 %."""
    study = study_file(tmp_path, "mass_2", "0.8, 1.2", command="final_tolerance = 0.05")
    options = ("--tolerances", "0.1:0.2:2", "--widths", "0:6:3", "--plot", tmp_path / "p.svg")
    done = run("tradeoff", study, *options)
    assert done.exit_code == 1
    assert done.stdout.count("impossible") >= 3
    assert "refused" in done.stdout, "a mass of -0.2 kg"
    words = (tmp_path / "p.svg").read_text()
    assert "impossible in any time: proven" in words
    assert "no such task" in words


@pytest.mark.slow
def test_a_box_that_is_only_sampled_is_bracketed_and_its_upper_side_bounds_nothing(tmp_path: Path) -> None:
    study = study_file(tmp_path, plant='linearization = "derivatives"')
    done = run("tradeoff", study, "--tolerances", "0.1:0.2:2", "--widths", "0:1:2", "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert {point["status"] for point in record["tolerances"]} == {"bracketed"}
    assert {(point["proven"]["lower"], point["proven"]["upper"]) for point in record["tolerances"]} == {(True, False)}
    assert all("sampled" in point["reason"] for point in record["tolerances"])
    assert [command["worst_residual"] for command in record["commands"]] == [None] * 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--tolerances", "0.1"), "--tolerances is LO:HI:N"),
        (("--tolerances", "0:0.1:3"), "more than 0 and less than 1"),
        (("--tolerances", "0.1:1:3"), "more than 0 and less than 1"),
        (("--tolerances", "0.1:0.2:1000"), "N from 2 to 200"),
        (("--widths", "-1:1:3"), "0 (the nominal plant) or more"),
        (("--widths", "nan:1:3"), "--widths is LO:HI:N"),
        (("--plot", "x.png"), "ends in .svg"),
    ],
)
def test_options_that_make_no_sense(tmp_path: Path, options: tuple[str, str], words: str) -> None:
    done = run("tradeoff", study_file(tmp_path), *options)
    assert (done.exit_code, done.stdout) == (2, "")
    assert words in done.stderr


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('robustness = "box"\ntolerance = 0.1', "tail = true"), "command.tail = true"),
        (('robustness = "box"\ntolerance = 0.1', 'kind = "shaper"\nshaper = "zv"'), "time-optimal commands"),
        (("0.7, 1.3", "-0.5, 1.3"), "unstable"),
        (("0.7, 1.3", "1.1, 1.3"), "nominal"),
    ],
)
def test_studies_without_a_trade_off(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    study = study_file(tmp_path)
    study.write_text(study.read_text().replace(*change))
    done = run("tradeoff", study)
    assert (done.exit_code, done.stdout) == (2, "")
    assert words in done.stderr


def test_a_plant_that_varies_has_no_trade_off() -> None:
    done = run("tradeoff", PROBLEMS / "varying_gain.toml")
    assert done.exit_code == 2
    assert "varies while it moves" in done.stderr


@pytest.mark.slow
def test_uncertain_modes_of_numbers_have_widths_too() -> None:
    """A mode within 16.3 % down and 14.0 % up is a stiffness within 30 %: another family of the same plants."""
    record = json.loads(
        run("tradeoff", PROBLEMS / "two_mass_box.toml", "--tolerances", "0.1:0.2:2", "--widths", "0.5:1:2", "--json").stdout
    )
    assert {point["status"] for point in (*record["tolerances"], *record["widths"])} == {"proved"}
    lower, upper = sides(record["tolerances"][1])
    assert lower <= 6.77832 <= upper, "as of the stiffness"
    low, high = record["widths"][0]["ranges"]["mode[1].frequency"]
    assert (low, high) == (pytest.approx(0.91833001325), pytest.approx(1.07008771255))


@pytest.mark.slow
def test_a_study_of_another_robustness_says_what_this_is_about(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    text = study.read_text().replace('robustness = "box"\ntolerance = 0.1', "robustness = 1")
    study.write_text(text + '[[requirement]]\nid = "R"\nquantity = "residual_vibration"\nmax = 0.2\n')
    record = json.loads(run("tradeoff", study, "--tolerances", "0.1:0.2:2", "--widths", "0.5:1:2", "--json").stdout)
    assert record["tolerance"] == 0.2
    assert record["notes"] == [
        'the study asks for robustness = 1; this is about "box", its tolerance 0.2, as R limits the residual vibration'
    ]


def test_points_unless_said_otherwise() -> None:
    assert [float(x) for x in tolerances(None, Fraction(5, 100))] == [0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2]
    assert Fraction(1, 20) not in tolerances(None, Fraction(499, 10000)), "nearly the study's own"
    assert max(tolerances(None, Fraction(9, 10))) < 1
    assert [float(x) for x in widths(None)] == [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5]
    assert widths("0:1:4") == (Fraction(0), Fraction(333333, 10**6), Fraction(666667, 10**6), Fraction(1))
    with pytest.raises(TradeoffError):
        tolerances("1:2", Fraction(1, 20))


def test_the_chart_shows_states_by_form_and_refuses_what_does_not_fit() -> None:
    states = ["proved", "bracketed", "bracketed", "impossible", "refused"]
    upper = [1.0, 1.2, math.nan, math.nan, math.nan]
    between = [(1.0, math.nan), (math.nan, math.nan), (1.1, math.nan), (math.inf, math.nan)]
    sweep = Sweep("w", "t", [0, 1, 2, 3, 4], [1.0, 1.1, 1.1, math.nan, math.nan], upper, states, between, 3)
    svg = tradeoff("c", [sweep], reference=Limit(1.05, "nominal"), commands={})
    for words in (
        "proven from both sides",
        "bracketed: not proven",
        "no command was found",
        "impossible in any time",
        "no such task",
        "this study",
    ):
        assert words in svg
    assert svg == tradeoff("c", [sweep], reference=Limit(1.05, "nominal"), commands={})
    with pytest.raises(RecordError, match="4 gaps"):
        tradeoff("c", [Sweep("w", "t", [0, 1, 2, 3, 4], upper, upper, states, between[1:], 3)], reference=None, commands={})
