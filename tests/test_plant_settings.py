"""What a study may set on an FMU beside plain numbers, and how what cannot be set is told."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pytest
from array_plant import build_chain
from study_texts import mistakes, read

from suite.study import Study


def text(fmu: Path, settings: str, more: str = "", input: str = "force[1]", output: str = "x[3]") -> str:
    return f"""
[plant]
fmu = "{fmu}"
input = "{input}"
output = "{output}"
parameters = {{ {settings} }}
[maneuver]
displacement = 1
[limits]
input = [-1, 1]
{more}"""


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_chain(tmp_path_factory.mktemp("chain"))


def parameters(study: Study) -> dict[str, Decimal]:
    assert study.plant.fmu is not None
    return dict(study.plant.fmu.parameters)


def test_every_kind_of_value_becomes_numbers_of_single_variables(tmp_path: Path, chain: Path) -> None:
    settings = 'n = 2, stiffness = [0.1, 2], anchored = true, gain = -3, material = "hard", enabled = false, "force[2]" = 0.5'
    study = read(tmp_path, text(chain, settings, output="x[2]"))
    assert parameters(study) == {
        "n": 2,
        "stiffness[1]": Decimal("0.1"),
        "stiffness[2]": 2,
        "anchored": 1,
        "gain": -3,
        "material": 2,
        "enabled": 0,
        "force[2]": Decimal("0.5"),
    }
    assert study.plant.fmu is not None
    assert study.plant.fmu.archive.description.find("x").shape == (2,), "what is loaded is what is run"
    assert (study.plant.input_unit, study.plant.output_unit) == ("N", "m")


@pytest.mark.parametrize(
    ("settings", "key", "words"),
    [
        ("stiffness = 2", "stiffness", r"Float64[3]; give a list of its values, or name one element, such as stiffness[1]"),
        ("stiffness = [1, 2]", "stiffness", "has 2 values where its shape [3] wants a list of 3"),
        ("stiffness = [1, 2, [3]]", "stiffness", "takes no list"),
        ('stiffness = [1, 2, "3"]', "stiffness", 'cannot be "3"; it must be a number'),
        ("stiffness = [1, 2, -3]", "stiffness", "'stiffness[3]' cannot be -3: the FMU wants at least 0"),
        ('stiffness = [1, 2, 3], "stiffness[1]" = 1', "stiffness[1]", "given twice"),
        ("anchored = 2", "anchored", "valid are true and false"),
        ("gain = true", "gain", "cannot be true; it must be a number"),
        ("gain = 1.5", "gain", "valid are whole numbers"),
        ("gain = 10", "gain", "at least -9 and at most 9"),
        ("material = 'steel'", "material", 'cannot be "steel": valid are "soft" (1), "hard" (2)'),
        ("material = true", "material", "valid are"),
        ("label = 'x'", "label", "String and keeps its start value"),
        ("n = 2.5", "n", "valid are whole numbers"),
        ("n = [3]", "n", "takes no list"),
        ("x = [1, 2, 3]", "x", "not parameter"),
        ('"force[1]" = 1', "force[1]", "driven by the command"),
        ("nn = 1", "nn", "no variable 'nn'"),
    ],
)
def test_a_value_that_cannot_be_is_named_with_what_could(tmp_path: Path, chain: Path, settings: str, key: str, words: str) -> None:
    assert words in mistakes(tmp_path, text(chain, settings))[f"plant.parameters.{key}"]


def test_a_size_decides_which_elements_there_are(tmp_path: Path, chain: Path) -> None:
    found = mistakes(tmp_path, text(chain, "n = 2"))
    assert "'x' has no element [3]; its elements are x[1] … x[2]" in found["plant.output"]
    read(tmp_path, text(chain, "n = 64", output="x[64]"))
    assert "at most 1000000" in mistakes(tmp_path, text(chain, "n = 2e6"))["plant.parameters"]


@pytest.mark.parametrize(
    ("input", "words"),
    [
        ("enabled", "type Boolean; a command drives a single real input"),
        ("label", "type String; a command drives"),
        ("force", "name one element, such as force[1]"),
    ],
)
def test_an_actuator_is_a_real_number(tmp_path: Path, chain: Path, input: str, words: str) -> None:
    assert words in mistakes(tmp_path, text(chain, "", input=input))["plant.input"]


@pytest.mark.parametrize(
    ("axis", "key", "words"),
    [
        ('parameter = "n"\nrange = [2, 3]', "parameter", "structural parameter"),
        ('parameter = "gain"\nrange = [1, 2]\nsamples = 3', "range", "whole numbers"),
        ('parameter = "stiffness[2]"\nrange = [-1, 2]', "range", "at least 0"),
        ('parameter = "stiffness"\nrange = [1, 2]', "parameter", "name one element, such as stiffness[1]"),
    ],
)
def test_an_axis_of_the_box_is_one_number(tmp_path: Path, chain: Path, axis: str, key: str, words: str) -> None:
    assert words in mistakes(tmp_path, text(chain, "", f"[[uncertainty]]\n{axis}\n"))[f"uncertainty[1].{key}"]
