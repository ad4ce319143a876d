"""Study files that are right: what is read from them. And files that are none."""

from __future__ import annotations

import json
import pickle
import re
import shutil
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Literal

import pytest
from study_texts import BOX, CRANE, FORMS, PLANT, RIGID, SPRING, read, requirement

from fmus.build import PLANTS, build, build_folder
from fmus.stepping import Experiment
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail
from suite import schema
from suite.errors import StudyError
from suite.loading import load_study
from suite.plants import nominal_plant, plant_at
from suite.quantities import DEFINITIONS
from suite.quantity_names import QUANTITIES, ArgumentKind, parse_quantity
from suite.study import ModalPlant, StateSpacePlant

ROOT = Path(__file__).parents[1]
STUDIES = ROOT / "suite" / "studies"


# What is read


def test_the_shipped_study_is_read_as_written() -> None:
    study = load_study(STUDIES / "two_mass.toml")
    assert (study.plant.input, study.plant.input_unit, study.plant.output, study.plant.output_unit) == ("force", "N", "position_2", "m")
    assert study.maneuver.displacement == Decimal(5)
    assert (study.limits.lower, study.limits.upper) == (Decimal(-1), Decimal(1))
    assert (study.command.kind, study.command.robustness) == ("time-optimal", "box")
    assert (study.command.tolerance, study.command.final_tolerance) == (Decimal("0.0499"), Decimal("1e-6"))
    (axis,) = study.uncertainties
    assert (axis.parameter, axis.unit, axis.samples) == ("stiffness", "N/m", 11)
    assert study.keep_logs == "all"
    first, second, third, *_ = study.requirements
    assert (first.id, str(first.quantity), first.minimum, first.maximum, first.unit, first.scope) == (
        *("SLEW-001", "residual_vibration", None, 0.05, "", "box"),
    )
    assert second.scope == "box"
    assert (third.unit, third.scope) == ("s", "nominal")


def test_the_pair_differs_in_one_line() -> None:
    passing, failing = ((STUDIES / name).read_text().splitlines() for name in ("two_mass.toml", "two_mass_fail.toml"))
    differing = [pair for pair in zip(passing, failing, strict=True) if pair[0] != pair[1]]
    assert differing == [('robustness = "box"', "robustness = 0")]
    assert load_study(STUDIES / "two_mass_fail.toml").command.robustness == 0


def test_defaults(tmp_path: Path) -> None:
    study = read(tmp_path, RIGID + requirement())
    assert study.title == "study"
    assert (study.command.kind, study.command.robustness, study.command.start) == ("time-optimal", 0, 0)
    assert (study.simulation.step, study.simulation.observe, study.simulation.seed) == (None, None, 0)
    assert study.keep_logs == "worst"
    assert study.requirements[0].scope == "nominal"
    assert study.plant.fmu is None


def test_decimals_stay_exact(tmp_path: Path) -> None:
    study = read(tmp_path, SPRING.replace("5.0", "0.1").replace("1.0]", "1.00000000000000000001]") + BOX)
    assert study.maneuver.displacement == Decimal("0.1")
    assert study.limits.upper == Decimal("1.00000000000000000001")
    values = study.uncertainties[0].values
    assert len(values) == 11
    assert (values[0], values[3], values[-1]) == (Fraction(7, 10), Fraction(88, 100), Fraction(13, 10))


def test_units_follow_from_the_fmu(tmp_path: Path) -> None:
    quantities = {"fuel": "N·s", "peak_input": "N", "peak_rate": "N/s", "peak(spring)": "m", "final_error": "", "settling_time(0.02)": "s"}
    text = "".join(requirement(id=f'"R{i}"', quantity=f'"{quantity}"') for i, quantity in enumerate(quantities))
    assert [r.unit for r in read(tmp_path, SPRING + text).requirements] == list(quantities.values())


@pytest.mark.parametrize("unit", ["N·s", "N.s", "N*s", "N s"])
def test_a_product_of_units_may_be_written_in_several_ways(tmp_path: Path, unit: str) -> None:
    assert read(tmp_path, SPRING + requirement(quantity='"fuel"', unit=f'"{unit}"')).requirements[0].unit == "N·s"


def test_output_names_the_controlled_output_of_an_fmu(tmp_path: Path) -> None:
    study = read(tmp_path, SPRING + requirement(quantity='"final(output)"'))
    assert study.requirements[0].quantity.variable == "position_2"


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_plant_gives_the_same_linear_plant(tmp_path: Path, form: str) -> None:
    study = read(tmp_path, RIGID.replace("numerator = [1]\ndenominator = [1, 0, 0]", FORMS[form]))
    plant, same = nominal_plant(study), nominal_plant(read(tmp_path, RIGID.replace(PLANT, f"[plant]\n{FORMS['transfer']}\n")))
    assert plant.denominator == same.denominator
    assert plant.numerators["output"] == same.numerators["output"]


def test_the_plant_at_a_place_in_the_box(tmp_path: Path) -> None:
    study = read(tmp_path, SPRING + BOX)
    stiff = plant_at(study, {"stiffness": Decimal("1.3")}).flexible[0]
    assert stiff.natural_frequency == pytest.approx(2.6**0.5, rel=1e-15)  # ω² = 2k/m, one rounding
    assert nominal_plant(study).flexible[0].natural_frequency == pytest.approx(2**0.5, rel=1e-15)


def test_parameters_of_the_study_reach_the_twin(tmp_path: Path) -> None:
    study = read(tmp_path, SPRING.replace("[maneuver]", "parameters = { stiffness = 2 }\n[maneuver]"))
    assert nominal_plant(study).flexible[0].natural_frequency == pytest.approx(2.0, rel=1e-15)  # ω² = 2k/m, one rounding


def test_an_input_that_the_command_does_not_drive_is_held(tmp_path: Path) -> None:
    study = read(tmp_path, CRANE.replace("[maneuver]", "parameters = { hoist = -1.5 }\n[maneuver]") + BOX.replace("stiffness", "length"))
    assert study.plant.fmu is not None
    assert study.plant.fmu.parameters == {"hoist": Decimal("-1.5")}
    shown = read(tmp_path, CRANE + BOX.replace("stiffness", "hoist"))
    assert (shown.uncertainties[0].parameter, shown.uncertainties[0].unit) == ("hoist", "m")
    experiment = Experiment(
        fmu=study.plant.fmu.archive.path,
        input="force",
        outputs=("cable", "load"),
        parameters={"hoist": -1.5},
        initial_input=0.0,
        initial_state={},
        command=Command(1.0, (Segment(0.0, 0.0),), Tail(0.0)),
        stop=40.0,
        step=1.0,
    )
    with Worker() as worker:
        trajectory = worker.run(experiment, 20.0).trajectory
    assert trajectory is not None
    # The hoist follows with e^{-t} (1 + t): 2e-16 of the way is left after 40 s.
    assert trajectory.values[-1].tolist() == pytest.approx([6.5, 0.0], rel=1e-14)


def test_a_nonlinear_plant_says_what_its_bracket_is_about(tmp_path: Path) -> None:
    (note,) = nominal_plant(read(tmp_path, CRANE)).notes
    assert note.startswith("gantry_crane.fmi3.fmu is nonlinear: the linear plant is its motion near rest")
    assert nominal_plant(read(tmp_path, SPRING)).notes == ()


def test_a_plant_outside_its_meaning_is_an_error_at_plant(tmp_path: Path) -> None:
    study = read(tmp_path, SPRING)
    with pytest.raises(StudyError, match=r"plant: .*mass_1 = 0"):
        plant_at(study, {"mass_1": 0})


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_without_a_twin_is_linearised(tmp_path: Path, version: Literal["2.0", "3.0"]) -> None:
    shutil.copytree(PLANTS / "two_mass", tmp_path / "two_mass", ignore=shutil.ignore_patterns("twin.toml"))
    build_folder(tmp_path / "two_mass", version, tmp_path / "stranger.fmu")
    study = read(tmp_path, SPRING.replace('"two_mass"', '"stranger.fmu"') + BOX)
    shipped = read(tmp_path, SPRING + BOX)
    assert study.plant.fmu is not None
    assert study.plant.fmu.archive.twin is None
    at = {"stiffness": Decimal("0.75")}  # a binary fraction: the same number for the binary and for the exact twin
    found, exact = plant_at(study, at), plant_at(shipped, at)
    assert (found.denominator, found.numerators["output"]) == (exact.denominator, exact.numerators["output"])
    assert "it brings no linear twin): its linearisation where it starts, by directional derivatives" in found.notes[-1]


def test_a_given_command_is_read_with_the_study(tmp_path: Path) -> None:
    command = Command(2.0, (Segment(0.0, 1.0), Segment(1.0, -1.0)), Tail(0.0))
    (tmp_path / "bang.json").write_text(json.dumps(command.to_dict()))
    study = read(tmp_path, RIGID + '[command]\nkind = "file"\nfile = "bang.json"\nstart = 0.5\n')
    assert study.command.given == command
    assert study.command.start == Decimal("0.5")


def test_an_fmu_may_be_a_file_beside_the_study(tmp_path: Path) -> None:
    build("two_mass", "2.0", tmp_path / "mine.fmu")
    study = read(tmp_path, SPRING.replace('"two_mass"', '"mine.fmu"'))
    assert study.plant.fmu is not None
    assert study.plant.fmu.archive.path == tmp_path / "mine.fmu"


def test_tolerance_without_a_box_is_noted_not_ignored(tmp_path: Path) -> None:
    (note,) = read(tmp_path, RIGID + "[command]\nrobustness = 1\ntolerance = 0.05\n").notes
    assert "command.tolerance" in note


def test_hash_and_bytes_are_the_file_s_own(tmp_path: Path) -> None:
    study = read(tmp_path, RIGID)
    assert study.source == (tmp_path / "study.toml").read_bytes()
    assert re.fullmatch(r"[0-9a-f]{64}", study.sha256)


def test_studies_and_their_errors_travel_between_processes(tmp_path: Path) -> None:
    study = load_study(STUDIES / "two_mass.toml")
    assert pickle.loads(pickle.dumps(study)) == study
    with pytest.raises(StudyError) as caught:
        read(tmp_path, "")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


# Files that are no studies


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[plant]\nfmu = \n", 'line 2, column 7): "fmu ="'),
        (b"[plant]\n[plant]\n", "line 2"),
        (b"\x89PNG\r\n", "UTF-8"),
        (b"a = 1\0", "zero bytes"),
        (b"a = " + b"[" * 5000, "nested"),
        (b"a = " + b"1" * 5000, "thousands of digits"),
        (b"", "[plant] is missing"),
    ],
)
def test_a_file_that_is_no_study_is_refused_in_one_sentence(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "study.toml"
    file.write_bytes(content)
    with pytest.raises(StudyError, match=re.escape(words)):
        load_study(file)


def test_a_missing_file_names_its_neighbours(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"no such file; beside it are two_mass\.toml"):
        load_study(STUDIES / "two_masses.toml")
    with pytest.raises(StudyError, match="no such file"):
        load_study(tmp_path / "nowhere" / "study.toml")


def test_a_folder_is_no_study(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="is a folder"):
        load_study(tmp_path)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    assert read(tmp_path, "\ufeff" + RIGID).title == "study"


# The tables agree with each other


def test_every_named_quantity_is_defined_and_parsed() -> None:
    assert DEFINITIONS.keys() == QUANTITIES.keys()
    for known in QUANTITIES.values():
        quantity = parse_quantity(str(known))
        assert str(quantity) == str(known)
        assert (quantity.variable is not None) == (known.argument is ArgumentKind.VARIABLE)


def test_every_key_stands_in_the_reference() -> None:
    reference = (ROOT / "docs" / "study.md").read_text()
    sections = dict(re.findall(r"(?ms)^## `\[+(\w+)\]+`(.*?)(?=^## |\Z)", reference))
    assert sections.keys() == schema.KEYS.keys()
    for section, keys in schema.KEYS.items():
        missing = [key for key in keys if f"`{key}`" not in sections[section]]
        assert missing == [], f"docs/study.md says nothing of these keys of [{section}]"
    assert [str(name) for name in QUANTITIES.values() if f"`{name}`" not in reference] == []


def test_forms_become_their_own_types(tmp_path: Path) -> None:
    kinds = {"states": StateSpacePlant, "modes": ModalPlant}
    for form, kind in kinds.items():
        assert isinstance(read(tmp_path, RIGID.replace(PLANT, f"[plant]\n{FORMS[form]}\n")).plant.source, kind)
