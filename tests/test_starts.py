"""Studies of plants that begin elsewhere than at rest: read, refused in words, run on an FMU, reviewed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_studies import results, run_table
from study_texts import mistakes

from reports import logs
from suite.cli import main
from suite.loading import load_study
from suite.observations import observe

PLANT = """[plant]
fmu = "two_mass"
input = "force"
output = "position_2"
"""
REST = """
[limits]
input = [-1.0, 1.0]
[simulation]
observe = 9.0
[[requirement]]
id = "RESIDUAL"
quantity = "residual_vibration"
max = 1e-6
[[requirement]]
id = "ERROR"
quantity = "final_error"
max = 1e-6
[[requirement]]
id = "PEAK"
quantity = "peak(position_1)"
max = 10
[[requirement]]
id = "MODEL"
quantity = "model_mismatch"
max = 1e-6
"""


def run(*arguments: object):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def verified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("start")
    start = "[maneuver]\ndisplacement = 0\nscale = 2\ninitial_state = { position_1 = 0.5, velocity_2 = 1.5 }\n"
    operating_point = "initial = { state = { position_1 = 3, position_2 = 3 } }\n"
    (folder / "study.toml").write_text(PLANT + operating_point + start + REST)
    done = run("verify", folder / "study.toml", "--out", folder / "out")
    assert done.exit_code == 0, done.output
    return folder / "out"


def test_the_fmu_begins_where_the_study_says_and_comes_back_to_its_rest(verified: Path) -> None:
    (row,) = run_table(verified).values()
    log = logs.read_log(verified / row["log"])
    seen = observe(log)
    states = {name: seen.variables[name][0] for name in ("position_1", "position_2", "velocity_1", "velocity_2")}
    assert states == {"position_1": 3.5, "position_2": 3.0, "velocity_1": 0.0, "velocity_2": 1.5}
    assert seen.facts.rest_output == 3.0
    assert seen.scale == 2.0
    assert seen.target == 3.0
    np.testing.assert_allclose(seen.output[seen.after], 3.0, atol=1e-6)
    np.testing.assert_allclose(seen.linear, seen.output, atol=1e-6)
    # … of the deviation from the rest, not from where the run begins
    assert row["quantities"]["peak(position_1)"]["value"] == pytest.approx(np.abs(seen.variables["position_1"] - 3.0).max(), rel=1e-12)


def test_it_is_proven_reviewed_and_told(verified: Path) -> None:
    found = results(verified)
    assert found["bound"]["status"] == "proved"
    assert found["task"]["initial_state"] == {"position_1": 0.5, "velocity_2": 1.5}
    assert found["task"]["scale"] == 2.0
    assert run("check", verified).exit_code == 0
    assert run("review", verified).exit_code == 0
    assert "begins away from rest by position_1: 0.5, velocity_2: 1.5" in (verified / "report.html").read_text()


def test_states_by_order_are_those_of_the_twin(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PLANT + "[maneuver]\ndisplacement = 1\ninitial_state = [0, 0, 0.25, 0]\n[limits]\ninput = [-1, 1]\n")
    (tmp_path / "b.toml").write_text(
        PLANT + "[maneuver]\ndisplacement = 1\ninitial_state = { position_2 = 0.25 }\n[limits]\ninput = [-1, 1]\n"
    )
    first, second = (json.loads(run("bound", tmp_path / name, "--json").stdout)["maneuver_time"] for name in ("a.toml", "b.toml"))
    assert first == second


NUMBERS = "[plant]\nnumerator = [1]\ndenominator = [1, 0, 1]\n"
MATRICES = "[plant]\nA = [[0, 1], [-1, 0]]\nB = [0, 1]\nC = [1, 0]\n"
LIMITS = "[limits]\ninput = [-1, 1]\n"
WRONG = {
    "no size": (NUMBERS, "displacement = 0\ninitial_state = [1, 0]", "", "maneuver.scale", "is missing"),
    "two sizes": (NUMBERS, "displacement = 1\ninitial_state = [1, 0]\nscale = 1", "", "maneuver.scale", "with displacement = 0 only"),
    "too few": (NUMBERS, "displacement = 0.1\ninitial_state = [1]", "", "maneuver.initial_state", "has 2 states"),
    "too many": (MATRICES, "displacement = 0.1\ninitial_state = [1, 0, 0]", "", "maneuver.initial_state", "A has 2 rows"),
    "names": (MATRICES, "displacement = 0.1\ninitial_state = { x = 1 }", "", "maneuver.initial_state", "have no names"),
    "unknown": (PLANT, "displacement = 1\ninitial_state = { x = 1 }", "", "maneuver.initial_state", "the states are position_1"),
    "robust": (NUMBERS, "displacement = 0.1\ninitial_state = [1, 0]", "[command]\nrobustness = 1", "command.robustness", "begin at rest"),
    "late": (NUMBERS, "displacement = 0.1\ninitial_state = [1, 0]", "[command]\nstart = 1", "command.start", "would move on"),
    "settling": (
        PLANT + "initial = { settle = 1 }\n",
        "displacement = 1\ninitial_state = { position_1 = 1 }",
        "",
        "maneuver.initial_state",
        "contradicts plant.initial.settle",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_makes_no_sense_is_refused_in_words(case: str, tmp_path: Path) -> None:
    plant, maneuver, more, place, words = WRONG[case]
    found = mistakes(tmp_path, f"{plant}[maneuver]\n{maneuver}\n{LIMITS}{more}\n")
    assert place in found, found
    assert words in found[place]


def test_a_plant_at_its_target_already_and_a_table_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(f"{NUMBERS}[maneuver]\ndisplacement = 0.5\ninitial_state = [0.5, 0]\n{LIMITS}")
    done = run("bound", file)
    assert done.exit_code == 2
    assert "at its final rest already" in done.output
    file.write_text(f"{NUMBERS}[maneuver]\ndisplacement = 0.5\ninitial_state = [0.25, 0]\n{LIMITS}")
    assert load_study(file).maneuver.initial_state is not None
    assert run("table", file, "--displacements", "0.1:0.5:2").exit_code == 2
