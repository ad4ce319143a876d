"""Whatever takes a command takes what `slewcert bound --json` prints, and says the same of a file that holds none. Folders are made."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from suite.cli import main

PLANT = '[plant]\nfmu = "two_mass"\ninput = "force"\noutput = "position_2"\n'
TASK = "[maneuver]\ndisplacement = 5.0\n[limits]\ninput = [-1.0, 1.0]\n"
ENDS = ("--input", "force", "--output", "position_2")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `bound --json` printed."""
    folder = tmp_path_factory.mktemp("answer")
    (folder / "fast.toml").write_text(PLANT + TASK)
    done = run("bound", folder / "fast.toml", "--json")
    assert done.exit_code == 0
    (folder / "answer.json").write_text(done.stdout)
    (folder / "command.json").write_text(json.dumps(json.loads(done.stdout)["command"]))
    return folder / "answer.json"


def test_simulate_takes_an_answer_of_bound(answer: Path) -> None:
    found = [json.loads(run("simulate", "two_mass", path, *ENDS, "--json").stdout) for path in (answer, answer.with_name("command.json"))]
    assert found[0] == found[1]
    assert found[0]["quantities"]["final(position_2)"]["value"] == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize(
    "command", ['kind = "file"\nfile = "{}"', 'kind = "shaper"\nshaper = "zv"\nreference = "{}"'], ids=["file", "shaped"]
)
def test_a_study_takes_an_answer_of_bound(answer: Path, command: str, tmp_path: Path) -> None:
    times = []
    for name in ("answer.json", "command.json"):
        file = tmp_path / "study.toml"
        file.write_text(f"{PLANT}{TASK}[command]\n{command.format(answer.with_name(name))}\n")
        done = run("bound", file, "--json")
        assert done.exit_code == 0, done.stderr
        times.append({**json.loads(done.stdout), "seconds": 0})
    assert times[0] == times[1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"command": null, "status": "impossible"}', "is the answer of a study without a command"),
        ('{"format": "slewcert-shaper/1", "times": [0], "amplitudes": [1]}', "is no command file: its \"format\" is 'slewcert-shaper/1'"),
        ('{"format": "slewcert-command/1"}', "maneuver_time"),
        ('{"format": ["x"]}', "is no command file"),
        ("[1]", "is no command file"),
        ("no json", "is no command file, which is JSON"),
    ],
)
def test_all_say_the_same_of_what_is_no_command(text: str, words: str, tmp_path: Path) -> None:
    path, file = tmp_path / "x.json", tmp_path / "study.toml"
    path.write_text(text)
    file.write_text(f'{PLANT}{TASK}[command]\nkind = "file"\nfile = "x.json"\n')
    told = []
    for arguments in (("simulate", "two_mass", path, *ENDS), ("bound", file)):
        done = run(*arguments)
        assert done.exit_code == 2
        assert words in done.stderr
        told.append(done.stderr.partition(str(path))[2])
    assert told[0].strip() in told[1]


@pytest.mark.slow
def test_every_command_makes_the_folders_that_it_writes_to(answer: Path, tmp_path: Path) -> None:
    zv = ("shaper", "zv", "--mode", "1Hz:0")
    move = (*zv, "--move", "1", "--input", "-1:1")
    for number, (before, option, name) in enumerate(
        [
            (("simulate", "two_mass", answer, *ENDS), "--log", "run.mcap"),
            (("bound", answer.with_name("fast.toml")), "--certificate", "proof.json"),
            (zv, "--save", "zv.json"),
            (zv, "--plot", "zv.svg"),
            (zv, "--export", "zv.h"),
            (move, "--command", "move.json"),
            (move, "--certificate", "proof.json"),
            (("fmus", "export", answer, "--fmi", "2"), "--out", "x.fmu"),
        ]
    ):
        path = tmp_path / str(number) / "deep" / name
        done = run(*before, option, path)
        assert done.exit_code == 0, done.stderr
        assert path.is_file(), option


def test_a_log_that_cannot_be_written_is_told_before_the_run(answer: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file" / "run.mcap", tmp_path):
        done = run("simulate", "two_mass", answer, *ENDS, "--log", path)
        assert done.exit_code == 2
        assert str(path.parent if path.parent.is_file() else path) in done.stderr
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file"]
