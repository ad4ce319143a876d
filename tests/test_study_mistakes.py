"""Study files that are wrong: every mistake is found, named by its place, and all of them at once."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_texts import BOX, CRANE, FORMS, RIGID, SPRING, mistakes, read, requirement

from suite import schema
from suite.errors import Mistake, StudyError
from suite.study_rules import BELONGS, NEEDS, UNSUPPORTED

# What is added to a good study, where the mistake is, and words that its message must hold

SHAPES = [
    ("[plant]\nrigid = nan\n", "plant.rigid", "finite"),
    ("[plant]\nrigid = inf\n", "plant.rigid", "finite"),
    ("[plant]\nrigid = 1e400\n", "plant.rigid", "magnitude"),
    ("[plant]\nrigid = 1e-999999999\n", "plant.rigid", "magnitude"),
    ("[plant]\nrigid = true\n", "plant.rigid", "number"),
    ("[plant]\nrigid = '1'\n", "plant.rigid", "number"),
    ("[plant]\nfmu = 3\n", "plant.fmu", "text"),
    ('[plant]\nfmu = "a\\u0007"\n', "plant.fmu", "control"),
    ("[plant]\nzeros = [[0, 1, 2]]\n", "plant.zeros[1]", "[re, im]"),
    ("[plant]\nA = [[1, 2], [3, 'x']]\n", "plant.A[2][2]", "number"),
    ("[plant]\nA = 1\n", "plant.A", "list"),
    ("[plant]\nmodes = [{ frequency = 0, gain = 1 }]\n", "plant.modes[1].frequency", "greater than 0"),
    ("[plant]\nmodes = [{ frequency = 1 }]\n", "plant.modes[1].gain", "missing"),
    ("[plant]\nmodes = [{ frequency = 1, gain = 1, dampin = 0 }]\n", "plant.modes[1].dampin", 'mean "damping"'),
    ("[plant]\ndenominater = [1]\n", "plant.denominater", 'mean "denominator"'),
    ("[plant]\ndisplacement = 1\n", "plant.displacement", "[maneuver]"),
    ("[plant]\nparameters = { k = {} }\n", "plant.parameters.k", "number"),
    ("[plant]\nparameters = [1]\n", "plant.parameters", "table"),
    ("[plant]\ninitial = 1\n", "plant.initial", "table"),
    ("[maneuver]\n", "maneuver.displacement", "missing"),
    ("[limits]\ninput = [1, -1]\n", "limits.input", "lower < upper"),
    ("[limits]\ninput = [1, 1]\n", "limits.input", "lower < upper"),
    ("[limits]\ninput = 1\n", "limits.input", "[lower, upper]"),
    ("[limits]\ninput = [-1, 1]\nfuel = 0\n", "limits.fuel", "greater than 0"),
    ("[limits]\ninput = [-1, 1]\npulses = 1.5\n", "limits.pulses", "whole number"),
    ("[limits]\ninput = [-1, 1]\npulses = 99999999999999999999\n", "limits.pulses", "64 bits"),
    ("[limits]\ninput = [-1, 1]\ndeflection = { spring = -1 }\n", "limits.deflection.spring", "greater than 0"),
    ("[limits]\ninput = [-1, 1]\ntail_length = { time = 1, within = 2 }\n", "limits.tail_length.within", "between 0 and 1"),
    (
        '[limits]\ninput = [-1, 1]\nzero_sensitivity = { "mode[1]" = { shift = 0.1, residual = 0.1 } }\n',
        "limits.zero_sensitivity.mode[1]",
        "zero[1]",
    ),
    (
        '[limits]\ninput = [-1, 1]\nzero_sensitivity = { "zero[1]" = { shift = 0, residual = 0.1 } }\n',
        "limits.zero_sensitivity.zero[1].shift",
        "greater than 0",
    ),
    (
        '[limits]\ninput = [-1, 1]\nzero_sensitivity = { "zero[1]" = { shift = 0.1 } }\n',
        "limits.zero_sensitivity.zero[1].residual",
        "missing",
    ),
    (
        '[limits]\ninput = [-1, 1]\nzero_sensitivity = { "zero[1]" = { shift = 0.1, residue = 1 } }\n',
        "limits.zero_sensitivity.zero[1].residue",
        'mean "residual"',
    ),
    ('[command]\nkind = "time-optimum"\n', "command.kind", 'mean "time-optimal"'),
    ("[command]\nrobustness = -1\n", "command.robustness", '"box"'),
    ("[command]\nrobustness = 1.5\n", "command.robustness", "whole number"),
    ("[command]\nrobustness = true\n", "command.robustness", "whole number"),
    ("[command]\nrobustness = { mode = 1 }\n", "command.robustness", "mode[1]"),
    ("[command]\ntail = 1\n", "command.tail", "true or false"),
    ("[command]\ntype = 3\n", "command.type", "1 or 2"),
    ('[command]\nmodes = ["1 Hz"]\n', "command.modes[1]", "1.0Hz:0.05"),
    ("[simulation]\nstep = 0\n", "simulation.step", "greater than 0"),
    ("[simulation]\nseed = -1\n", "simulation.seed", "from 0 on"),
    ('[keep]\nlogs = "some"\n', "keep.logs", '"all"'),
    ("[[uncertainty]]\nrange = [1, 2]\n", "uncertainty[1].parameter", "missing"),
    ("[[uncertainty]]\nparameter = 'k'\nrange = [2, 1]\n", "uncertainty[1].range", "lower < upper"),
    ("[[uncertainty]]\nparameter = 'k'\nrange = [1, 2]\nsamples = 0\n", "uncertainty[1].samples", "from 1 on"),
    ("[[uncertainty]]\nparameter = 'k'\nrange = [1, 2]\nsamples = 1000000000\n", "uncertainty[1].samples", "at most"),
    ("[uncertainty]\nparameter = 'k'\n", "uncertainty", "[[uncertainty]]"),
    ("[requirements]\n", "requirements", 'mean "requirement"'),
    ("[[displacement]]\n", "displacement", "[maneuver]"),
    ("[[plant]]\n", "plant", "[plant]"),
    (requirement(id=""), "requirement[1].id", "missing"),
    (requirement(id='"R 1"'), "requirement[1].id", "file name"),
    (requirement(id='"../R1"'), "requirement[1].id", "file name"),
    (requirement(id='"1R"'), "requirement[1].id", "letter"),
    (requirement(id='"R1\\n"'), "requirement[1].id", "file name"),
    (requirement(id='"con.1"'), "requirement[1].id", "device"),
    (requirement(id='"' + "R" * 81 + '"'), "requirement[1].id", "80"),
    (requirement(max="nan"), "requirement[1].max", "finite"),
    (requirement(scope='"all"'), "requirement[1].scope", '"nominal"'),
]


@pytest.mark.parametrize(("text", "path", "words"), SHAPES)
def test_a_wrong_value_is_named_with_its_place_and_what_would_be_valid(tmp_path: Path, text: str, path: str, words: str) -> None:
    assert words in mistakes(tmp_path, text)[path]


RULES = [
    ("", RIGID.replace("displacement = 1", "displacement = 0"), "maneuver.displacement", "nothing to move"),
    ("", RIGID.replace("displacement = 1", "displacement = 0\ninitial_state = [1, 0]"), "maneuver.scale", "missing"),
    ("", RIGID.replace("displacement = 1", "displacement = 1\nscale = 1"), "maneuver.scale", "displacement = 0 only"),
    ("", RIGID.replace("[-1, 1]", "[0.5, 1]"), "limits.input", "initial rest, 0"),
    ("", RIGID.replace("[-1, 1]", "[-1, 1]\nrate = [1, 2]"), "limits.rate", "contain 0"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 2]"), "limits.input", "final rest, 2"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 0.5]").replace("[-1, 1]", "[-1, 1]\nfuel = 2"), "limits.fuel", "takes 0.5 for ever"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 0, 0]\ninitial = { input = 2 }"), "limits.input", "initial rest, 2"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 0, 0]\nrigid = 1"), "plant", "numerator and rigid"),
    ("", RIGID.replace("denominator = [1, 0, 0]", ""), "plant.denominator", "missing"),
    ("", RIGID.replace("numerator = [1]\ndenominator = [1, 0, 0]", ""), "plant", "nothing of the plant"),
    ("", RIGID.replace("numerator = [1]", "numerator = [1, 0]"), "plant", "zero at the origin"),
    ("", RIGID.replace("numerator = [1]", "numerator = [1, 0, 0, 1]"), "plant", "improper"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 0, 0]\nparameters = { k = 1 }"), "plant.parameters", "belongs to an FMU"),
    ("", RIGID.replace("[1, 0, 0]", "[1, 0, 0]\noutputs = { v = [1] }"), "plant.outputs", "A, B, C, D"),
    ("", f"[plant]\n{FORMS['states'].replace('[1,0,-1,0]', '[1,0,-1]')}", "plant.C", "4 rows"),
    ("", f"[plant]\n{FORMS['states'].replace('bend', 'output_rate')}", "plant.outputs.output_rate", "exists already"),
    (
        "",
        f"[plant]\n{FORMS['roots'].replace(', [0.0, -1.0]', '')}\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]",
        "plant",
        "conjugate",
    ),
    (RIGID, '[command]\nkind = "file"\n', "command.file", "missing"),
    (RIGID, '[command]\nfile = "c.json"\n', "command.file", 'belongs to "file"'),
    (RIGID, '[command]\nkind = "file"\nfile = "none.json"\n', "command.file", "cannot be read"),
    (RIGID, '[command]\nkind = "file"\nfile = "study.toml"\n', "command.file", "JSON"),
    (RIGID, '[command]\nrobustness = "box"\n', "command.robustness", "[[uncertainty]]"),
    (RIGID, BOX, "uncertainty[1].parameter", "given as numbers"),
    (SPRING, BOX + BOX, "uncertainty[2].parameter", "uncertainty[1]"),
    (SPRING, BOX + "samples = 1\n", "uncertainty[1].samples", "at least 2"),
    (SPRING, "[[uncertainty]]\nparameter = 'stiffness'\n", "uncertainty[1].range", "missing"),
    (SPRING, "[[uncertainty]]\nparameter = 'stifness'\nrange = [1, 2]\n", "uncertainty[1].parameter", "'stiffness'"),
    (SPRING, "[[uncertainty]]\nparameter = 'spring'\nrange = [1, 2]\n", "uncertainty[1].parameter", "causality output"),
    (SPRING, "[[uncertainty]]\nparameter = 'mass_1'\nrange = [-1, 1]\n", "uncertainty[1].range", "mass_1 = 0"),
    (SPRING, BOX + "distribution = { kind = 'normal', mean = 1 }\n", "uncertainty[1].distribution", "contradicts range"),
    (RIGID, requirement(max=""), "requirement[1]", "no limit"),
    (RIGID, requirement(min="1"), "requirement[1].min", "greater than max"),
    (RIGID, requirement(scope='"box"'), "requirement[1].scope", "[[uncertainty]]"),
    (RIGID, requirement() + requirement(id='"r1"'), "requirement[2].id", "requirement[1]"),
    (RIGID, requirement(quantity='"residual_vibrations"'), "requirement[1].quantity", 'mean "residual_vibration"'),
    (RIGID, requirement(quantity='"settling_time"'), "requirement[1].quantity", "settling_time(0.02)"),
    (RIGID, requirement(quantity='"settling_time(2)"'), "requirement[1].quantity", "between 0 and 1"),
    (RIGID, requirement(quantity='"insensitivity(x)"'), "requirement[1].quantity", "between 0 and 1"),
    (RIGID, requirement(quantity='"fuel(1)"'), "requirement[1].quantity", "no argument"),
    (RIGID, requirement(quantity='"peak(speed)"'), "requirement[1].quantity", "output_rate"),
    (SPRING, requirement(quantity='"peak(sprig)"'), "requirement[1].quantity", "'spring'"),
    (SPRING, requirement(unit='"mm"'), "requirement[1].unit", "pure number"),
    (SPRING, requirement(quantity='"maneuver_time"', unit='"mm"'), "requirement[1].unit", '"s"'),
    (SPRING, requirement(quantity='"fuel"', unit='"N"'), "requirement[1].unit", "N·s"),
    (RIGID, requirement(quantity='"fuel"', unit='"N·s"'), "requirement[1].unit", "not known"),
    ("", SPRING.replace("two_mass", "two_mas"), "plant.fmu", 'mean "two_mass"'),
    ("", SPRING.replace("two_mass", "two_mass.fmi1"), "plant.fmu", "no such file"),
    ("", SPRING.replace("two_mass", "study.toml"), "plant.fmu", "zip"),
    ("", SPRING.replace("two_mass", "."), "plant.fmu", "folder"),
    ("", SPRING.replace('input = "force"', ""), "plant.input", "force"),
    ("", SPRING.replace('"force"', '"farce"'), "plant.input", "'force'"),
    ("", SPRING.replace('"force"', '"position_1"'), "plant.input", "causality output"),
    ("", SPRING.replace('"position_2"', '"velocity_2"'), "plant.output", "causality local"),
    ("", SPRING.replace("[maneuver]", "parameters = { stifness = 1 }\n[maneuver]"), "plant.parameters.stifness", "'stiffness'"),
    ("", SPRING.replace("[maneuver]", "parameters = { mass_1 = 0 }\n[maneuver]"), "plant", "divides by zero"),
]


@pytest.mark.parametrize(("good", "text", "path", "words"), RULES)
def test_what_contradicts_another_key_or_the_plant_is_named(tmp_path: Path, good: str, text: str, path: str, words: str) -> None:
    assert words in mistakes(tmp_path, good + text)[path]


def test_all_mistakes_come_at_once_in_the_order_of_the_sections(tmp_path: Path) -> None:
    text = SPRING.replace("force", "farce").replace("5.0", "0") + requirement(quantity='"peak(sprig)"', id='"R 1"') + requirement(max="nan")
    with pytest.raises(StudyError) as caught:
        read(tmp_path, text + "[[uncertainty]]\nparameter = 'stifness'\nrange = [1, 2]\n[simulation]\nstep = -1\n[sumulation]\n")
    assert [mistake.path for mistake in caught.value.mistakes] == [
        *("sumulation", "plant.input", "maneuver.displacement", "simulation.step"),
        *("uncertainty[1].parameter", "requirement[1].id", "requirement[2].max"),
    ]
    first, *lines = str(caught.value).splitlines()
    assert first.endswith("study.toml: 7 mistakes")
    assert lines[1].startswith('  plant.input = "farce": ')


UNSUPPORTED_VALUES = {
    "plant.initial.state": "[plant.initial]\nstate = [1]",
    "limits.tail_length": "[limits]\ntail_length = { time = 1, within = 0.1 }",
    "command.final_tolerance": "[command]\nfinal_tolerance = 0.1\n",
    "command.tail": "[command]\ntail = true",
    "uncertainty.distribution": "[[uncertainty]]\nparameter = 'k'\ndistribution = { kind = 'uniform', lower = 1, upper = 2 }",
    "uncertainty.sampling": "[[uncertainty]]\nparameter = 'k'\nsampling = 'sobol'",
    "cluster": "[cluster]\nworkers = 2",
}


@pytest.mark.parametrize("path", UNSUPPORTED)
def test_a_key_that_this_version_cannot_honour_is_refused_not_ignored(tmp_path: Path, path: str) -> None:
    found = mistakes(tmp_path, UNSUPPORTED_VALUES[path])
    place = path.replace("uncertainty", "uncertainty[1]")
    assert "not supported by this version" in found[place]


def test_roots_that_a_plant_does_not_have(tmp_path: Path) -> None:
    for parameter in ("mode[1].frequency", "mode[2].damping", "zero[1]"):
        found = mistakes(tmp_path, RIGID + f"[[uncertainty]]\nparameter = '{parameter}'\nrange = [0.9, 1.1]\n")
        assert "it has neither flexible modes nor zeros" in found["uncertainty[1]"]


def test_the_input_that_the_command_drives_cannot_be_held_too(tmp_path: Path) -> None:
    held = CRANE.replace("[maneuver]", "parameters = { force = 1.0 }\n[maneuver]")
    assert "'force' is driven by the command" in mistakes(tmp_path, held)["plant.parameters.force"]
    axis = "[[uncertainty]]\nparameter = 'force'\nrange = [0.0, 1.0]\n"
    assert "causality input, not parameter" in mistakes(tmp_path, CRANE + axis)["uncertainty[1].parameter"]
    nameless = mistakes(tmp_path, CRANE.replace('input = "force"\n', "").replace("[maneuver]", "parameters = { force = 1.0 }\n[maneuver]"))
    assert "is missing; the FMU has force, hoist" in nameless["plant.input"]


def test_tables_name_keys_that_exist() -> None:
    assert BELONGS.keys() <= set(schema.KEYS["command"])
    assert {key for keys in NEEDS.values() for key in keys} <= set(schema.KEYS["command"])
    for path in UNSUPPORTED:
        section, *keys = path.split(".")
        assert section in schema.KEYS
        assert not keys or keys[0] in schema.KEYS[section]


def test_mistakes_show_long_values_shortened() -> None:
    assert len(str(Mistake("plant.A", [list(range(1000))], "x"))) < 100
