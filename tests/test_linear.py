"""`slewcert linearize`, the keys of a study that say how its FMU is linearised, and how far FMUs are from their linear plants."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from made_fmus import linear_fmu, made_fmu, steps_only
from marks import first, in_turn
from study_texts import RIGID, read

from fmus.archives import open_archive
from fmus.bench import Bench
from fmus.build import FmiVersion, build, shipped
from fmus.stepping import Experiment
from fmus.twins import linear_plant, read_twin
from fmus.workers import Worker
from relaxations.commands import Command, Tail
from suite.cli import main
from suite.errors import StudyError
from suite.plants import nominal_plant
from suite.verification import verify

PENDULUM = """
void plant_derivatives(Plant *p) { p->der_angle = p->speed; p->der_speed = -p->gravity * sin(p->angle) - p->friction * p->speed + p->u; }
void plant_outputs(Plant *p) { p->y = p->angle; }
"""
STUDY = '[plant]\nfmu = "{}"\ninput = "u"\noutput = "y"\n{}\n[maneuver]\ndisplacement = {}\n[limits]\ninput = [{}]\n'


@pytest.fixture(scope="module")
def pendulum() -> Path:
    return made_fmu("pendulum", PENDULUM, {"angle": 0.0, "speed": 0.0}, parameters={"gravity": 9.81, "friction": 0.4})


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["linearize", *map(str, arguments)], catch_exceptions=False)


def record(*arguments: str | Path) -> dict[str, Any]:
    done = run(*arguments, "--json")
    assert done.exit_code == 0, done.stderr
    assert done.stdout.count("\n") == 1
    return json.loads(done.stdout)


# The command


def test_the_object_holds_what_the_matrices_say() -> None:
    found = record("two_mass", "--input", "force", "--output", "position_2", "--set", "damping=0.5", "--set", "mass_2=0.25")
    assert found["method"] == "directional derivatives"
    assert (np.array(found["A"]).shape, len(found["B"]), len(found["C"]), found["D"]) == ((4, 4), 4, 4, 0.0)
    assert found["states"] == ["position_1", "velocity_1", "position_2", "velocity_2"]
    poles = [complex(*pole) for pole in found["poles"]]
    expected = sorted(np.linalg.eigvals(np.array(found["A"])), key=lambda p: (abs(p), p.imag))
    # The double pole at the origin is exact; numpy gives it to a root of rounding.
    assert poles == pytest.approx(expected, abs=1e-7)
    assert poles[:2] == [0.0, 0.0]
    assert [complex(*zero) for zero in found["zeros"]] == [pytest.approx(-2.0, rel=1e-14)]
    assert found["gain"] == pytest.approx(0.5 / 0.25, rel=1e-14)  # c / (m_1 m_2)
    s = 0.3 + 0.8j
    by_roots = found["gain"] * np.prod([s - complex(*z) for z in found["zeros"]]) / np.prod([s - p for p in poles])
    matrix = np.array(found["C"]) @ np.linalg.solve(s * np.eye(4) - np.array(found["A"]), np.array(found["B"]))
    assert by_roots == pytest.approx(matrix, rel=1e-12)
    rigid, mode = found["modes"]
    assert (rigid["kind"], rigid["multiplicity"], rigid["step_amplitude"]) == ("rigid", 2, None)
    assert mode["natural_frequency"] == pytest.approx(2 * math.pi * mode["frequency_hz"])
    assert mode["time_constant"] == pytest.approx(1.0 / (mode["damping_ratio"] * mode["natural_frequency"]))
    assert sum(mode["participation"].values()) == pytest.approx(1.0)
    assert found["operating_point"] == {
        "input": 0.0,
        "output": 0.0,
        "states": dict.fromkeys(found["states"], 0.0),
        "settled": 0.0,
        "imbalance": 0.0,
    }
    assert [check["amplitude"] for check in found["checks"]] == [0.01, 1.0]
    assert all(check["error"] < 1e-10 for check in found["checks"])
    assert found["identification"] is None
    assert found["error"] < 1e-14


@pytest.mark.slow
def test_an_identified_plant_says_so(tmp_path: Path) -> None:
    silent = steps_only(build("two_mass"), tmp_path / "silent.fmu")
    found = record(silent, "--input", "force", "--output", "spring", "--set", "damping=0.02")
    how = found["identification"]
    assert (found["method"], found["order"], how["samples"]) == ("identified", 2, 400)
    assert 2 in [entry["order"] for entry in how["orders"]]
    assert how["singular_values"][0] == 1.0
    assert how["singular_values"][2] < 1e-12
    assert found["error"] == how["check_error"] < 1e-11
    assert complex(*found["poles"][0]) == pytest.approx(complex(-0.02, -math.sqrt(2 - 0.0004)), rel=1e-9)
    shown = run(silent, "--input", "force", "--output", "spring", "--set", "damping=0.02").stdout
    assert "Nothing is known of the FMU beyond that" in shown
    assert "singular values: 1, 0.9" in shown
    assert "chosen: 2" in shown


@pytest.mark.slow
def test_what_is_shown_is_what_matters(pendulum: Path) -> None:
    shown = run(pendulum, "--input", "u", "--output", "y", "--set", "u=4.905", "--at", "rest").stdout
    assert "finite differences" in shown
    assert "operating point: u = 4.905 1, y = 0.523598775" in shown
    row = next(line for line in shown.splitlines() if "mode[1]" in line)
    for number in ("-0.2 ± 2.9078702i", "0.463895", "2.91474", "0.0686168", "│ 5 "):
        assert number in row, number
    small, *_, large = (line for line in shown.splitlines() if line.startswith("distance from the FMU"))
    assert "moves of ±0.04905" in small  # a hundredth of the input's size there
    far, near = (float(line.split(": ")[1].split()[0]) for line in (large, small))
    assert far > 3.0 * near, "farther out it is another plant, and that is told"


@pytest.mark.slow
def test_methods_agree(pendulum: Path, tmp_path: Path) -> None:
    point = ("--input", "u", "--output", "y", "--set", "u=4.905", "--set", f"angle={math.pi / 6!r}")
    exact = complex(-0.2, -math.sqrt(9.81 * math.cos(math.pi / 6) - 0.04))
    for file, method in ((pendulum, "differences"), (pendulum, "identified"), (steps_only(pendulum, tmp_path / "p.fmu"), "auto")):
        found = record(file, *point, "--method", method)
        assert complex(*found["poles"][0]) == pytest.approx(exact, rel=1e-8)
        assert found["gain"] == pytest.approx(1.0, rel=1e-8)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent.fmu", "--input", "u", "--output", "y"), ["FMU", "absent.fmu is no such file", "two_mass"]),
        (("two_mas", "--input", "u", "--output", "y"), ['did you mean "two_mass"']),
        (("two_mass", "--input", "forse", "--output", "positon_2"), ["--input", "'force'", "--output", "'position_2'"]),
        (("two_mass", "--input", "spring", "--output", "spring"), ["causality output, not input"]),
        (("two_mass", "--input", "force", "--output", "spring", "--set", "stifness=2", "--set", "x"), ["'stiffness'", "NAME=NUMBER"]),
        (("two_mass", "--input", "force", "--output", "spring", "--set", "spring=2"), ["no start value"]),
        (("two_mass", "--input", "force", "--output", "spring", "--set", "force=nan"), ["NAME=NUMBER"]),
        (("two_mass", "--input", "force", "--output", "spring", "--set", "mass_1=2 m"), ["mass_1=2 m", "kind", "kg"]),
        (("two_mass", "--input", "force", "--output", "spring", "--set", "mas_1=2 g"), ["did you mean 'mass_1'"]),
        (("two_mass", "--input", "force", "--output", "force"), ["causality input, not output"]),
        (("two_mass", "--input", "force", "--output", "stiffness"), ["causality parameter, not output"]),
        (("two_mass", "--input", "force", "--output", "spring", "--step", "nan"), ["--step", "valid are numbers above 0"]),
        (("two_mass", "--input", "force", "--output", "spring", "--step", "inf"), ["--step", "not in the range"]),
        (("two_mass", "--input", "force", "--output", "spring", "--step", "0"), ["--step", "not in the range"]),
        (("two_mass", "--input", "force", "--output", "spring", "--at", "soon"), ["neither a time in seconds nor 'rest'"]),
        (("two_mass", "--input", "force", "--output", "spring", "--method", "guess"), ["identified"]),
        (("two_mass", "--input", "force", "--output", "position_2", "--set", "force=1"), ["not at rest where it starts", "another input"]),
        (("two_mass", "--input", "force", "--output", "position_2", "--set", "velocity_1=1"), ["not at rest", "nearest rest"]),
    ],
)
def test_bad_input_is_named(arguments: tuple[str, ...], words: list[str]) -> None:
    done = run(*arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    for word in words:
        assert word in done.stderr


def test_types_that_cannot_be_driven_are_named(tmp_path: Path) -> None:
    text = made_fmu(
        "whole", "void plant_derivatives(Plant *p) { p->der_x = p->u - p->x; }\nvoid plant_outputs(Plant *p) { p->y = p->x; }", {"x": 0.0}
    )
    import zipfile

    with zipfile.ZipFile(text) as source, zipfile.ZipFile(tmp_path / "whole.fmu", "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'<Float64 name="u"', b'<Int32 name="u"').replace(b'unit="1" start="0.0" causality="input"', b"")
            target.writestr(name, content)
    done = run(tmp_path / "whole.fmu", "--input", "u", "--output", "y")
    assert done.exit_code == 2
    assert "u" in done.stderr


def test_an_fmu_that_fails_is_exit_code_3() -> None:
    crash = "void plant_derivatives(Plant *p) { if (p->x != 0.0) abort(); p->der_x = p->u; }\nvoid plant_outputs(Plant *p) { p->y = p->x; }"
    done = run(made_fmu("crash", crash, {"x": 0.0}), "--input", "u", "--output", "y")
    assert (done.exit_code, done.stdout) == (3, "")
    assert "SIGABRT" in done.stderr
    assert "Traceback" not in done.stderr


# Studies


@pytest.mark.slow
def test_a_study_says_how_its_plant_is_linearised(tmp_path: Path, pendulum: Path) -> None:
    (tmp_path / "p.fmu").write_bytes(pendulum.read_bytes())
    keys = 'parameters = {{ friction = 4 }}\ninitial = {{ input = 4.905, {} }}\nlinearization = "{}"'
    plants = {}
    for state in ("settle = true", "settle = 15", "state = [0.5235987755982988, 0]", "state = { angle = 0.5235987755982988 }"):
        for method in ("auto", "identified" if state == "settle = true" else "differences"):
            study = read(tmp_path, STUDY.format("p.fmu", keys.format(state, method), 0.1, "0, 9"))
            (pole,) = nominal_plant(study).poles
            assert pole.value == pytest.approx(complex(-2.0, math.sqrt(9.81 * math.cos(math.pi / 6) - 4.0)), rel=1e-7)
            plants[state, method] = nominal_plant(study).notes
    assert "identified after settling for" in plants["settle = true", "identified"][0]
    assert any("by finite differences" in note for note in plants["settle = 15", "auto"])


@pytest.mark.slow
def test_a_twin_is_left_aside_if_the_study_asks(tmp_path: Path) -> None:
    plant = (
        '[plant]\nfmu = "two_mass"\ninput = "force"\noutput = "position_2"\n{}\n[maneuver]\ndisplacement = 5\n[limits]\ninput = [-1, 1]\n'
    )
    twin = nominal_plant(read(tmp_path, plant.format('linearization = "twin"')))
    assert twin.notes == ()
    for method in ("derivatives", "differences", "identified"):
        found = nominal_plant(read(tmp_path, plant.format(f'linearization = "{method}"')))
        assert "as the study asks" in next(note for note in found.notes if "linear plant is that of" in note)
        assert found.rigid_order == 2
        assert found.flexible[0].value == pytest.approx(twin.flexible[0].value, rel=1e-9)
        assert found.flexible[0].value.real == 0.0


def test_an_identification_as_the_study_lays_it_down(tmp_path: Path, pendulum: Path) -> None:
    steps_only(pendulum, tmp_path / "p.fmu")
    keys = "identification = { step = 0.05, samples = 120, amplitude = 0.02, order = 2 }"
    notes = nominal_plant(read(tmp_path, STUDY.format("p.fmu", keys, 0.1, "-9, 9"))).notes
    assert any("order 2 from 120 samples every 0.05 s after pulses of ±0.02" in note for note in notes)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('linearization = "twin"', ["plant.linearization", "has none"]),
        ('linearization = "guess"', ["plant.linearization", "identified"]),
        ('linearization = "differences"\nidentification = { order = 2 }', ["plant.identification", "means nothing"]),
        ("identification = { stp = 1 }", ["plant.identification.stp", 'did you mean "step"']),
        ("identification = { step = 0, samples = 5 }", ["identification.step", "greater than 0", "identification.samples", "between 16"]),
        ("initial = { settle = false }", ["plant.initial.settle", "leave it out"]),
        ("initial = { settle = -1 }", ["plant.initial.settle", "greater than 0"]),
        ("initial = { state = [1] }", ["plant.initial.state", "has 1 numbers", "angle, speed"]),
        ("initial = { state = { angel = 1 } }", ["plant.initial.state.angel", "'angle'"]),
    ],
)
def test_mistakes_in_these_keys(tmp_path: Path, pendulum: Path, keys: str, words: list[str]) -> None:
    (tmp_path / "p.fmu").write_bytes(pendulum.read_bytes())
    with pytest.raises(StudyError) as wrong:
        read(tmp_path, STUDY.format("p.fmu", keys, 0.1, "-9, 9"))
    for word in words:
        assert word in str(wrong.value)


@pytest.mark.parametrize("key", ["settle = true", "state = [0]"])
def test_numbers_have_no_state_to_start_from(tmp_path: Path, key: str) -> None:
    with pytest.raises(StudyError, match="belongs to an FMU"):
        read(tmp_path, RIGID.replace("[maneuver]", f"initial = {{ {key} }}\n[maneuver]"))


def test_a_plant_that_does_not_rest_is_a_mistake_of_the_study(tmp_path: Path, pendulum: Path) -> None:
    (tmp_path / "p.fmu").write_bytes(pendulum.read_bytes())
    study = read(tmp_path, STUDY.format("p.fmu", "initial = { input = 4.905 }", 0.1, "0, 9"))
    with pytest.raises(StudyError, match="not at rest where it starts"):
        nominal_plant(study)


# The distance of the FMU from its linear plant


@pytest.mark.parametrize(
    ("name", "version"), in_turn(sorted({*shipped()} - {"spacecraft"}), quick=5)
)  # its thrusters are on or off: its study compares the whole run
def test_shipped_plants_are_their_twins(name: str, version: FmiVersion) -> None:
    """Every output that a twin describes, moved with the natural size of the input: 1e-11 of the response is what the integrator leaves.

    Of a nonlinear plant a tenth of the move leaves at most a fifth of the distance.
    """
    fmu = open_archive(build(name, version))
    assert fmu.twin is not None
    twin = read_twin(fmu.twin)
    rest = fmu.description.find(twin.input).start
    rest = rest if isinstance(rest, float) else 0.0
    with Worker() as worker:
        for output in twin.outputs:
            point = Experiment(fmu.path, twin.input, (output,), {}, rest, {}, Command(0.0, (), Tail(rest)), 1.0, 0.01)
            bench = Bench(worker, fmu, point, 60.0)
            seen = [bench.mismatch(linear_plant(twin, output), amplitude) for amplitude in (1.0, 0.1)]
            large, small = (found[0] for found in seen if found is not None)
            assert small < large / 5 if twin.nonlinear else large < 1e-11


@pytest.mark.parametrize(("angle", "least", "most"), first(1, [(0.1, 1e-4, 1e-2), (0.001, 1e-8, 1e-6)]))
def test_the_mismatch_of_a_non_linear_plant_is_honest(tmp_path: Path, pendulum: Path, angle: float, least: float, most: float) -> None:
    """A pendulum is linear up to θ²/6: that, times a few for the time it has to get out of step, is what a move by θ shows."""
    (tmp_path / "p.fmu").write_bytes(pendulum.read_bytes())
    text = STUDY.format("p.fmu", "", angle, f"{-20 * angle}, {20 * angle}") + "[simulation]\nobserve = 5\n"
    results = verify(read(tmp_path, text), tmp_path / "out").results
    (row,) = results["run_table"]
    assert least < row["quantities"]["model_mismatch"]["value"] < most


@pytest.mark.slow
def test_feed_through_is_no_mismatch(tmp_path: Path) -> None:
    """At a jump of the input both outputs have the value before it."""
    fmu = linear_fmu("through", [[0.0, 1.0], [-4.0, -0.4]], [0.0, 1.0], [3.0, 0.0], 1.5)
    (tmp_path / "through.fmu").write_bytes(fmu.read_bytes())
    text = STUDY.format("through.fmu", "", 1.0, "-3, 3") + "[simulation]\nobserve = 5\n"
    (row,) = verify(read(tmp_path, text), tmp_path / "out").results["run_table"]
    assert row["quantities"]["model_mismatch"]["value"] < 1e-10


@pytest.mark.slow
def test_a_run_from_a_settled_operating_point(tmp_path: Path, pendulum: Path) -> None:
    """It starts there: the first sample is the rest value, and the linear plant of that point foretells the run."""
    (tmp_path / "p.fmu").write_bytes(pendulum.read_bytes())
    text = STUDY.format("p.fmu", "initial = { input = 4.905, settle = true }", 0.001, "4.8, 5.0") + "[simulation]\nobserve = 5\n"
    done = verify(read(tmp_path, text), tmp_path / "out")
    (row,) = done.results["run_table"]
    assert row["status"] == "finished"
    # tan θ_0 θ/2 = 3e-4 is the next term of the sine there.
    assert 1e-6 < row["quantities"]["model_mismatch"]["value"] < 3e-3


def test_settings_may_have_units() -> None:
    ends = ("--input", "force", "--output", "position_2")
    plain = record("two_mass", *ends, "--set", "mass_1=2", "--set", "stiffness=0.5")
    assert record("two_mass", *ends, "--set", "mass_1=2000 g", "--set", "stiffness=500 N/km") == plain


def test_a_distance_that_cannot_be_measured_is_told() -> None:
    ends = ("two_mass", "--input", "force", "--output", "position_2", "--step", "1e-300")
    found = record(*ends)
    assert found["checks"] == []
    assert "the distance from the FMU could not be measured for moves of ±" in found["notes"][-1]
    assert "note: the distance from the FMU could not be measured" in run(*ends).stdout
