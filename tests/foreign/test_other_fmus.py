"""`slewcert verify` on FMUs that were not written here: OpenModelica's and PythonFMU's, as packages of the Python index carry them.

Their linear plants are found, compared with the equations that their authors publish, and proven about; their runs agree with these plants.
"""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from other_fmus import CRANE, GEMSEO, WHEELS, import_path, turntable, unpack

from relaxations.commands import Command, Segment, Tail
from suite.cli import main

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(not (WHEELS / "ready").is_file(), reason="the packages with FMUs are not there (make foreign)"),
]
TOOLS = {
    "mass_damper": "OpenModelica Compiler OpenModelica 1.19.3",
    "mass_spring_1": "OpenModelica Compiler OpenModelica 1.21.0~2-g0bc3d29",
    "mass_spring_2": "OpenModelica Compiler OpenModelica 1.21.0~2-g0bc3d29",
    "oscillator": "PythonFMU 0.6.9",
    "turntable_2": "PythonFMU 0.7.0",
    "turntable_3": "PythonFMU3 0.3.4",
}
# [plant] and the rest of each study, the natural frequency [rad/s] and damping of the only mode, and the numerator's constant
SHAFT = (math.sqrt(8.0), 0.02 / math.sqrt(8.0), 4.0)
CASES = {
    # m x'' + d x' + c x = f with m = 1 kg, c = 10 kN/m, d = 2 N s/m
    "mass_damper": (
        'input = "f"\noutput = "y"\nparameters = { "damper.d" = 2.0, "spring.s_rel0" = "50 cm" }',
        "displacement = 0.01", 'input = ["-50 N", "200 N"]', 'interface = "model-exchange"', ("spring.c", 9000, 11000), (100.0, 0.01, 1.0),
    ),
    # m_1 x_1'' = -(k_1 + k_2) x_1 + k_2 x_2, all of them 1; and its neighbour
    "mass_spring_1": (
        'input = "x2"\noutput = "x1"\ninitial = { input = 0.0, state = { _D_outputAlias_v1 = 0.0 } }',
        "displacement = 1.0", "input = [-3, 3]", 'interface = "model-exchange"', ("k1", 0.9, 1.1), (math.sqrt(2.0), 0.0, 1.0),
    ),
    "mass_spring_2": (
        'input = "x1"\noutput = "x2"\ninitial = { input = 0.0, state = { _D_outputAlias_x2 = 0.0 } }',
        "displacement = 1.0", "input = [-3, 3]", 'interface = "model-exchange"', ("k3", 0.9, 1.1), (math.sqrt(2.0), 0.0, 1.0),
    ),
    # m x'' + c x' + k x = f with m = k = 1, c = 0.1
    "oscillator": (
        'input = "f[0]"\noutput = "x[0]"\nidentification = { step = 0.05, samples = 200 }',
        "displacement = 1.0", "input = [-1.5, 1.5]", "step = 0.05\nobserve = 20", ("k[0]", 0.9, 1.1), (1.0, 0.05, 1.0),
    ),
    # two inertias of 1 kg m² on a shaft of 4 N m/rad and 0.02 N m s/rad: ω² = 2 k, 2 ζ ω = 2 c
    "turntable_2": (
        'input = "torque"\noutput = "table"\nidentification = { step = 0.2, samples = 60 }',
        "displacement = 0.5", "input = [-1, 1]", "step = 0.05\nobserve = 20", ("stiffness", 3.6, 4.4), SHAFT,
    ),
    "turntable_3": (
        'input = "torque"\noutput = "table"\nidentification = { step = 0.2, samples = 60 }',
        "displacement = 0.5", "input = [-1, 1]", "step = 0.05\nobserve = 20", ("stiffness", 3.6, 4.4), SHAFT,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheels")
    unpack(folder)
    return folder


@pytest.fixture
def fmus(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    monkeypatch.setenv("PYTHONPATH", import_path(unpacked))
    linux = unpacked / GEMSEO / "linux"
    return {
        "mass_damper": linux / "Mass_Damper.fmu",
        "mass_spring_1": linux / "MassSpringSubSystem1.fmu",
        "mass_spring_2": linux / "MassSpringSubSystem2.fmu",
        "oscillator": unpacked / CRANE / "HarmonicOscillator6D.fmu",
        "turntable_2": turntable(unpacked, "pythonfmu"),
        "turntable_3": turntable(unpacked, "pythonfmu3"),
    }


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


def test_every_case_is_of_a_tool() -> None:
    assert set(CASES) == set(TOOLS)


@pytest.mark.parametrize("name", CASES)
def test_verify(name: str, fmus: dict[str, Path], tmp_path: Path) -> None:
    plant, maneuver, limits, simulation, (parameter, low, high), (frequency, damping, constant) = CASES[name]
    inspected = json.loads(run("fmus", "inspect", fmus[name], "--json").stdout)
    assert TOOLS[name] in inspected["tool"]

    study, out = tmp_path / "study.toml", tmp_path / "out"
    lines = [f'[plant]\nfmu = "{fmus[name]}"\n{plant}', f"[maneuver]\n{maneuver}", f"[limits]\n{limits}", "[command]\nrobustness = 1"]
    lines += [f"[simulation]\n{simulation}", f'[[uncertainty]]\nparameter = "{parameter}"\nrange = [{low}, {high}]\nsamples = 2']
    for quantity, limit in {"residual_vibration": '"5 %"', "model_mismatch": 1e-6}.items():
        lines.append(f'[[requirement]]\nid = "{quantity.upper()}"\nquantity = "{quantity}"\nmax = {limit}')
    study.write_text("\n".join(lines))

    done = run("verify", study, "--out", out)
    assert done.exit_code == 0, done.output
    found = json.loads((out / "results.json").read_text())
    assert found["bound"]["status"] == "proved"
    assert found["runs"] == {"total": 3, "passed": 3, "failed": 0, "errors": 0}
    assert run("review", out).exit_code == 0
    assert run("check", out).exit_code == 0

    # The plant that the theorem is about, against the equations: exact to rounding where derivatives are seen, to 1e-10 where identified.
    (linear,) = json.loads((out / "certificate.json").read_text())["task"]["plants"]
    first, second, third, *rest = (float(Fraction(number)) for number in linear["denominator"])
    assert first == 1.0
    assert not any(rest), "the rest are poles at the origin"
    assert third == pytest.approx(frequency**2, rel=1e-9)
    assert second == pytest.approx(2.0 * damping * frequency, rel=1e-8, abs=1e-12)
    assert float(Fraction(linear["numerator"][-1])) == pytest.approx(constant, rel=1e-8)
    assert all(abs(float(Fraction(number))) < 1e-9 for number in linear["numerator"][:-2])


def test_all_of_them_can_be_inspected(unpacked: Path) -> None:
    found = sorted(unpacked.glob("*/**/*.fmu"))
    assert len(found) >= 18
    for path in found:
        done = run("fmus", "inspect", path)
        assert done.exit_code in (0, 1), done.output
        if "win32" in path.parts and "Model.fmu" not in path.name:
            assert "its binaries are for: win" in done.output, path


def test_what_an_fmu_says_when_it_refuses_to_start(fmus: dict[str, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("PYTHONPATH")
    command = tmp_path / "command.json"
    moved = Command(1.0, (Segment(0.0, 1.0),), Tail(0.0))
    command.write_text(json.dumps(moved.to_dict()))
    done = run("simulate", fmus["oscillator"], command, "--input", "f[0]", "--output", "x[0]", "--stop", "2")
    assert done.exit_code == 3
    assert "No module named" in done.output
    assert "needs its execution tool, PythonFMU 0.6.9" in done.output
