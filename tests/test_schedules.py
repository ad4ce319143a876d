"""The plant's schedule in a study: matrices as written, an FMU along its own motion, what is refused and in which words."""

from __future__ import annotations

import json
from decimal import Decimal
from fractions import Fraction
from math import exp
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_studies import SHIPPED

from relaxations.bounds import Status
from relaxations.errors import PlantError
from suite.cli import main
from suite.design import design, pose
from suite.errors import StudyError
from suite.loading import load_study
from suite.plants import nominal_plant
from suite.study import Schedule
from suite.tables import tabulate
from suite.varying import varying_plant

GAIN = (SHIPPED.parent / "problems" / "varying_gain.toml").read_text(encoding="utf-8")
CRANE = (SHIPPED / "gantry_crane_varying.toml").read_text(encoding="utf-8")


def study(folder: Path, text: str):
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.toml")


def test_matrices_as_written(tmp_path: Path) -> None:
    read = study(tmp_path, GAIN)
    assert read.plant.schedule == Schedule((Decimal(2),), None, ((Decimal(0), Decimal(3)),))
    plant = varying_plant(read.plant)
    assert plant is not None
    assert (plant.instants, plant.B, plant.A[0]) == ((0, 2), ((0, 1), (0, 3)), plant.A[1])


def test_an_fmu_is_linearised_along_its_own_motion(tmp_path: Path) -> None:
    times = (0.5, 1.0, 2.0, 12.0)
    read = study(
        tmp_path,
        CRANE.replace(CRANE[CRANE.index("schedule = ") : CRANE.index("\n\n[maneuver]")], f"schedule = {{ times = {list(times)} }}"),
    )
    plant = varying_plant(read.plant)
    assert plant is not None
    assert plant.order == 4  # the hoist's own states are not moved by the force
    # The hoist's filter in closed form: payout -2 (1 - (1 + t) e^-t), its rate -2 t e^-t, its acceleration -2 (1 - t) e^-t.
    for t, A, B, C in zip((0.0, *times), plant.A, plant.B, plant.C, strict=True):
        length, rate, acceleration = 8 - 2 * (1 - (1 + t) * exp(-t)), -2 * t * exp(-t), -2 * (1 - t) * exp(-t)
        pull = 2 * (9.80665 - acceleration)
        assert [float(x) for x in A[1]] == pytest.approx([0, 0, pull, 0], rel=1e-5, abs=1e-9)
        assert [float(x) for x in A[3]] == pytest.approx([0, 0, -(9.80665 + pull) / length, -2 * rate / length], rel=1e-5, abs=1e-7)
        assert [float(x) for x in B] == pytest.approx([0, 1 / 2000, 0, -1 / 2000 / length], rel=1e-6, abs=1e-12)
        assert [float(x) for x in C] == pytest.approx([1, 0, length, 0], rel=1e-6)
    made = design(read)
    assert made.bound.status is Status.PROVED
    assert any("along its own motion" in note for note in made.problem.notes)


def test_a_certificate_is_about_its_own_schedule(tmp_path: Path) -> None:
    file, other = tmp_path / "study.toml", tmp_path / "other.toml"
    file.write_text(GAIN, encoding="utf-8")
    other.write_text(GAIN.replace("[[0, 3]]", "[[0, 3.0001]]"), encoding="utf-8")
    certificate = tmp_path / "certificate.json"
    found = CliRunner().invoke(main, ["bound", str(file), "--json", "--certificate", str(certificate)])
    assert json.loads(found.stdout)["status"] == "proved"
    for asked, said, code in ((file, "matches", 0), (other, "differs", 1)):
        done = CliRunner().invoke(main, ["check", str(certificate), "--study", str(asked), "--json"])
        assert (json.loads(done.stdout)["study"], done.exit_code) == (said, code)
    assert "t = 2 s" in CliRunner().invoke(main, ["check", str(certificate)]).stdout


STATES = "A = [[0, 1], [0, 0]]\nB = [0, 1]\nC = [1, 0]"
MISTAKES = {
    "must ascend from more than 0": GAIN.replace("times = [2]", "times = [0]"),
    "has 1 items, and times has 2": GAIN.replace("times = [2]", "times = [2, 3]"),
    "has other sizes than plant.B": GAIN.replace("[[0, 3]]", "[[0, 3, 1]]"),
    "varies nothing": GAIN.replace(", B = [[0, 3]]", ""),
    "no such key (did you mean": GAIN.replace("B = [[0, 3]]", "times_ = [1]"),
    "belongs to an FMU, or to the form A, B, C, D": GAIN.replace(
        "A = [[0, 1], [0, 0]]\nB = [0, 1]\nC = [1, 0]", "numerator = [1]\ndenominator = [1, 0, 0]"
    ),
    "further zeros and boxes": GAIN + "\n[command]\nrobustness = 1\n",
    "the plant varies from the beginning of the move on": GAIN + "\n[command]\nstart = 1\n",
    "command.follow, without a schedule": GAIN + '\n[command]\nkind = "shaper"\nshaper = "zv"\n',
    "limits.tail_length": GAIN + "tail_length = { time = 1.0, within = 0.1 }\n",
    "belongs to a plant given as numbers": CRANE.replace("schedule = { ", "schedule = { B = [[1.0]], "),
    "where the FMU rests nothing varies": CRANE.replace("[plant]", "[plant]\ninitial = { settle = true }"),
    "valid are auto, derivatives, differences": CRANE.replace("[plant]", '[plant]\nlinearization = "twin"'),
}


@pytest.mark.parametrize("said", MISTAKES)
def test_mistakes_in_words(said: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError) as caught:
        study(tmp_path, MISTAKES[said])
    assert said in str(caught.value)


def test_what_only_the_plant_tells(tmp_path: Path) -> None:
    swings = GAIN.replace("A = [[0, 1], [0, 0]]", "A = [[0, 1], [-1, 0]]").replace("B = [[0, 3]]", "A = [[[0, 1], [-2, 0]]]")
    with pytest.raises(StudyError, match="not where the plant rests"):
        design(study(tmp_path, swings.replace("displacement = 1", "displacement = 0.5")))
    with pytest.raises(StudyError, match=r"0\.0123456 s is no communication point .* at 0\.02 s"):
        design(study(tmp_path, CRANE.replace("times = [0.1,", "times = [0.0123456,")))
    with pytest.raises(StudyError, match="commands of a table begin at any time"):
        tabulate(study(tmp_path, GAIN), (Fraction(1),))


def test_further_outputs_of_an_fmu_along_its_own_motion(tmp_path: Path) -> None:
    short = CRANE[: CRANE.index("times = [")] + "times = [0.5, 1.0] }\n\n" + CRANE[CRANE.index("[maneuver]") :]
    limited = short.replace("input = [-3000.0, 3000.0]", "deflection = { NAME = 0.4 }\ninput = [-3000.0, 3000.0]")
    read = study(tmp_path, limited.replace("NAME", "sway"))
    posed = pose(read, nominal_plant(read))
    (course,) = posed.courses
    assert (course.name, course.limit) == ("sway", 0.4)
    read = study(tmp_path, limited.replace("NAME", "tension"))
    with pytest.raises(PlantError, match=r"'tension' of .* changes by itself"):
        pose(read, nominal_plant(read))
