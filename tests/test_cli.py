"""The command line: exit codes, what stands on which stream, and that bad input is named and leaves nothing behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from small_studies import SHIPPED, small_study
from study_texts import BOX, RIGID, SPRING, requirement

from fmus.build import build, shipped
from suite.cli import main


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


def object_of(text: str) -> dict[str, Any]:
    """Standard output as the one JSON object that it must be."""
    assert text.count("\n") == 1
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


# Bad input

TASK = "[maneuver]\ndisplacement = {}\n[limits]\ninput = [{}]\n"
FOREIGN = '[plant]\nfmu = "foreign.fmu"\ninput = "force"\noutput = "position_2"\n' + TASK.format("5.0", "-1, 1")
TRANSFER = "[plant]\nnumerator = {}\ndenominator = {}\n" + TASK.format("1", "{}")

BAD = {
    "unknown key": (SPRING + "[command]\nrobustnes = 1\n", ["command.robustnes = 1", 'did you mean "robustness"']),
    "unknown section": (SPRING + "[comand]\n", ['did you mean "command"']),
    "nan": (SPRING.replace("5.0", "nan"), ["maneuver.displacement", "finite"]),
    "infinity": (SPRING.replace("-1.0, 1.0", "-1.0, inf"), ["limits.input", "finite"]),
    "limits without the first rest": (SPRING.replace("-1.0, 1.0", "0.5, 1.0"), ["limits.input", "initial rest"]),
    "limits without the final rest": (TRANSFER.format("[1]", "[1, 1]", "-0.5, 0.5"), ["limits", "final rest", "1"]),
    "displacement 0": (SPRING.replace("5.0", "0.0"), ["maneuver.displacement = 0.0", "must not be 0"]),
    "missing FMU": (SPRING.replace("two_mass", "absent.fmu"), ["absent.fmu is no such file"]),
    "no FMU": (SPRING.replace("two_mass", "study.toml"), ["study.toml", "zip"]),
    "no binary for this platform": (FOREIGN, ["foreign.fmu", "no binary", "riscv64-plan9"]),
    "unknown input": (SPRING.replace('"force"', '"farce"'), ["plant.input", "'force'"]),
    "unknown output": (SPRING.replace("position_2", "position_3"), ["plant.output", "'position_2'"]),
    "unknown parameter": (SPRING + BOX.replace("stiffness", "stifness"), ["uncertainty[1].parameter", "'stiffness'"]),
    "wrong causality": (SPRING.replace('"force"', '"position_1"'), ["plant.input", "causality output"]),
    "zero at the origin": (TRANSFER.format("[1, 0]", "[1, 1, 1]", "-1, 1"), ["zero"]),
    "improper": (TRANSFER.format("[1, 0, 0]", "[1, 1]", "-1, 1"), ["improper"]),
    "not TOML": ("title == 1", ["TOML", "line 1"]),
    "nothing": ("", ["[plant] is missing", "[maneuver] is missing", "[limits] is missing"]),
    "requirement without a limit": (SPRING + requirement(max=""), ["requirement[1]", "no limit"]),
    "unsupported": (SPRING + "[cluster]\nworkers = 2\n", ["cluster", "not supported by this version"]),
}


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plant's FMU with its binary for a machine that nobody has."""
    path = tmp_path_factory.mktemp("elsewhere") / "foreign.fmu"
    with zipfile.ZipFile(build("two_mass")) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            place, parts = name, name.split("/")
            if parts[0] == "binaries" and len(parts) > 2:
                place = "/".join(("binaries", "riscv64-plan9", *parts[2:]))
            target.writestr(place, source.read(name))
    return path


@pytest.mark.parametrize("command", ["verify", "bound"])
@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, elsewhere: Path, case: str, command: str
) -> None:
    text, words = BAD[case]
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(text)
    if "foreign.fmu" in text:
        Path("foreign.fmu").symlink_to(elsewhere)
    if "not supported" in words[-1] and command == "bound":
        words = words[:1]
    before = sorted(os.listdir())
    for options in ((), ("--json",)):
        done = run(command, "study.toml", *options)
        assert (done.exit_code, done.stdout) == (2, "")
        assert [word for word in words if word not in done.stderr] == [], done.stderr
        assert sorted(os.listdir()) == before


def test_a_mode_that_the_input_cannot_excite_is_dropped_and_one_that_the_output_cannot_see_is_brought_to_rest(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    beside = "[plant]\nA = [[0,1,0,0],[0,0,0,0],[0,0,0,1],[0,0,-1,0]]\nB = [0,1,0,{}]\nC = [1,0,{},0]\n" + TASK.format(1, "-1, 1")
    file.write_text(beside.format(0, 1))
    done = run("bound", file)
    assert done.exit_code == 0
    assert "note: " in done.stdout
    assert "minimum time: [1.99999999" in done.stdout or "minimum time: [2.0" in done.stdout, "the double integrator's own"
    file.write_text(beside.format(1, 0))
    lower = json.loads(run("bound", file, "--json").stdout)["maneuver_time"]["lower"]
    assert lower > 2.1, "resting the mode costs time, seen or not"


def test_all_mistakes_come_at_once(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(SPRING.replace("force", "farce").replace("5.0", "nan") + "[comand]\n" + requirement(quantity='"residual"'))
    done = run("verify", file)
    assert done.exit_code == 2
    assert "4 mistakes" in done.stderr
    for path in ("comand", "plant.input", "maneuver.displacement", "requirement[1].quantity"):
        assert f"\n  {path}" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["verify"], "STUDY"),
        (["verify", "a.toml", "b.toml"], "b.toml"),
        (["verify", "absent.toml"], "absent.toml"),
        (["verify", "."], "folder"),
        (["verify", "study.toml", "--jobs", "0"], "--jobs"),
        (["verify", "study.toml", "--jobs", "many"], "--jobs"),
        (["verify", "study.toml", "--resume", "--force"], "--resume"),
        (["verify", "study.toml", "--no-such-option"], "--no-such-option"),
        (["bound", "absent.toml"], "absent.toml"),
        (["bound"], "STUDY"),
        (["review", "absent"], "absent"),
        (["review"], "PATH"),
        (["fmus", "build", "three_mass"], "two_mass"),
        (["verfy"], "verify"),
        (["--no-such-option"], "--no-such-option"),
    ],
)
def test_wrong_usage_is_exit_code_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str) -> None:
    monkeypatch.chdir(tmp_path)
    small_study(tmp_path)
    done = run(*arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    assert words in done.stderr
    assert os.listdir() == ["study.toml"]


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x00" * 100, b"x = " + b"[" * 100_000, b"x = " + b"9" * 10_000])
def test_files_that_are_no_study_are_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "study.toml"
    file.write_bytes(content)
    assert run("verify", file).exit_code == 2


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    done = run("verify", small_study(tmp_path, samples=0), "--out", tmp_path / "locked" / "out")
    assert done.exit_code == 2
    assert "locked" in done.stderr


# Output


def test_verify_json_is_one_object_as_the_contract_has_it(tmp_path: Path) -> None:
    done = run("verify", small_study(tmp_path, samples=2), "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0
    record = object_of(done.stdout)
    assert record.keys() == {"verdict", "requirements", "runs", "evidence"}
    assert record["verdict"] == "pass"
    assert record["runs"] == {"total": 3, "passed": 3, "failed": 0, "errors": 0}
    assert record["evidence"] == str(tmp_path / "out")
    keys = {"id", "quantity", "value", "limit", "margin", "verdict", "worst_run"}
    assert [entry.keys() for entry in record["requirements"]] == [keys, keys]
    assert [entry["id"] for entry in record["requirements"]] == ["RESIDUAL", "TIME"]
    worst = record["requirements"][0]
    assert worst["margin"] == pytest.approx(worst["limit"] - worst["value"])
    assert (tmp_path / "out" / "runs" / f"{worst['worst_run']}.mcap").is_file()


def test_verify_prints_the_table_the_bracket_the_worst_case_and_the_report(tmp_path: Path) -> None:
    done = run("verify", small_study(tmp_path, samples=2), "--out", tmp_path / "out")
    lines = done.stdout.splitlines()
    assert done.exit_code == 0
    assert lines[0].strip() == "Small"
    assert any("RESIDUAL" in line and "PASS" in line for line in lines)
    assert any(line.startswith("minimum time: [6.6627284203") for line in lines)
    assert any(line.startswith("worst residual_vibration: ") and "stiffness = " in line for line in lines)
    assert f"report: {tmp_path / 'out' / 'report.html'}" in lines
    assert lines[-1] == "verdict: PASS"


@pytest.mark.parametrize(("problem", "listed"), [("two_mass_box", True), ("rigid_body_sampled", True), ("two_mass_rate", False)])
def test_a_staircase_of_few_levels_is_listed_and_ramps_are_not(problem: str, listed: bool) -> None:
    done = run("bound", Path(__file__).parents[1] / "suite" / "problems" / f"{problem}.toml")
    assert ("from, s" in done.stdout) is listed


def test_bound_json_is_one_object_as_the_contract_has_it(tmp_path: Path) -> None:
    done = run("bound", small_study(tmp_path), "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    record = object_of(done.stdout)
    keys = {"status", "maneuver_time", "command", "switches", "fuel", "certificate", "seconds"}
    assert record.keys() - {"reason"} == keys
    assert record["status"] in ("proved", "bracketed")
    assert ("reason" in record) == (record["status"] != "proved")
    lower, upper = record["maneuver_time"]["lower"], record["maneuver_time"]["upper"]
    assert lower <= upper
    assert upper == pytest.approx(6.6627284203, abs=1e-9)
    assert record["command"]["maneuver_time"] == upper
    assert record["switches"] == 3
    assert record["fuel"] == pytest.approx(upper)
    assert record["certificate"] is None


def test_bound_for_people_shows_the_switch_times(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(RIGID)
    done = run("bound", file)
    assert done.exit_code == 0
    assert "minimum time: [" in done.stdout
    assert "1.0000000000" in done.stdout


def test_the_default_folder_is_named_after_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    small_study(tmp_path, samples=0, name="slew.toml")
    assert run("verify", "slew.toml").exit_code == 0
    assert Path("slew-evidence/report.html").is_file()


def test_shipped_plants_are_listed_and_built(tmp_path: Path) -> None:
    listed = run("fmus", "list").stdout
    assert [name for name in shipped() if f"│ {name} " not in listed] == []
    assert "0 (×2), ±1.414j" in listed
    assert "gantry_crane   │ mechanical, nonlinear" in listed
    assert "chain: 2 to 40 masses" in listed
    told = object_of(run("fmus", "list", "--json").stdout)
    assert told["plants"] == list(told["details"]) == list(shipped())
    assert told["details"]["two_mass"]["poles"] == [[0, 0], [0, 0], [0, 2**0.5], [0, -(2**0.5)]]
    assert told["details"]["stirred_tanks"]["zeros"] == [[-0.026, 0]]
    assert told["details"]["chain"]["size"] == {"name": "masses", "range": [2, 40]}
    done = run("fmus", "build", "two_mass", "chain_4", "--out", tmp_path, "--json")
    expected = [f"{name}.fmi{major}.fmu" for name in ("two_mass", "chain_4") for major in (2, 3)]
    assert object_of(done.stdout) == {"fmus": [str(tmp_path / name) for name in expected]}
    assert all(zipfile.is_zipfile(path) for path in tmp_path.iterdir())


def test_every_command_has_a_help_page() -> None:
    for arguments in ([], ["verify"], ["bound"], ["review"], ["fmus"], ["fmus", "list"], ["fmus", "build"]):
        done = run(*arguments, "--help")
        assert done.exit_code == 0
        assert done.stdout.startswith("Usage:")
    assert run("--version").stdout.startswith("slewcert, version ")


# A process of its own


def process(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    code = "import sys; from suite.cli import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, check=False, timeout=120)


HEAVY = ("cvxpy", "fmpy", "mcap", "matplotlib", "jinja2", "pydantic", "numpy", "scipy", "flint", "rich", "sqlite3")


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom suite.cli import main\n"
        "main(['--help'], standalone_mode=False)\nmain(['verify', '--help'], standalone_mode=False)\n"
        f"print('heavy:', [name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "heavy: []"


@pytest.mark.slow
def test_a_terminal_without_our_signs_gets_question_marks(tmp_path: Path) -> None:
    file = small_study(tmp_path, samples=0)
    done = process("verify", file, "--out", tmp_path / "out", PYTHONIOENCODING="ascii")
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    assert done.stdout.isascii()
    assert "verdict: PASS" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux")
def test_file_names_that_are_no_text_do_not_matter(tmp_path: Path) -> None:
    strange = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
    strange.mkdir()
    file = small_study(strange, samples=0, name=os.fsdecode(b"study \xfe.toml"))
    file.write_text(file.read_text().replace('title = "Small"\n', ""))
    done = process("verify", file, "--out", strange / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert Path(object_of(done.stdout)["evidence"]) == strange / "out"
    assert process("review", strange / "out").returncode == 0


@pytest.mark.slow
def test_the_shipped_studies_are_right() -> None:
    for file in sorted(SHIPPED.glob("*.toml")):
        assert run("bound", file, "--json").exit_code == 0
