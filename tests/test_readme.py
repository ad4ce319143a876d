"""What the README tells people to type exists, and prints what the README says it prints; every file that it names is there."""

from __future__ import annotations

import contextlib
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from marks import slow

from suite.checks import EVERY_TASK, sizes
from suite.cli import main
from suite.quantity_names import parse_quantity
from suite.study_rules import UNSUPPORTED

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
COLLECTION = "slewcert bound suite/problems"
"""Its table is compared in test_problem_collection.py, which has the whole collection bracketed anyway."""


@cache
def commands() -> tuple[tuple[str, ...], ...]:
    """Every line of the `sh` blocks and every prompt of the `console` blocks, as words, without its comment."""
    typed = [line for block in re.findall(r"(?ms)^```sh\n(.*?)^```", README) for line in block.splitlines()]
    typed += [line.removeprefix("$ ") for line, _ in sessions()]
    return tuple(tuple(words) for line in typed if (words := shlex.split(line, comments=True)))


@cache
def sessions() -> tuple[tuple[str, str], ...]:
    """The command and the output of every `console` block."""
    return tuple((prompt, output) for prompt, output in re.findall(r"(?ms)^```console\n(\$ [^\n]*)\n(.*?)^```", README))


def test_the_two_commands_that_set_everything_up_are_there():
    assert {("make", "verify"), ("make", "test")} <= set(commands())


@pytest.mark.parametrize("typed", commands(), ids=" ".join)
def test_commands_exist(typed: tuple[str, ...]):
    program, *words = typed
    if program == "make":
        assert set(words) <= set(re.findall(r"(?m)^([a-z][a-z-]*):(?!=)", (ROOT / "Makefile").read_text()))
        return
    if program == "python":
        assert (ROOT / words[0]).is_file()
        return
    assert program == "slewcert", f"the README speaks of {program}, which nothing here sets up"
    command: click.Command = main
    while isinstance(command, click.Group) and words:
        following = command.get_command(click.Context(command), words[0])
        assert following is not None, f"slewcert has no command {words[0]}"
        command, words = following, words[1:]
    options = {option for parameter in command.params for option in parameter.opts}
    assert {word.split("=")[0] for word in words if word.startswith("--")} <= options | {"--help"}


def test_files_that_are_named_exist():
    text = re.sub(r"(?s)<!--.*?-->", "", README)
    links = re.findall(r"\]\((?!#|https?:)([^)\s]+)\)", text) + re.findall(r'src(?:set)?="([^"]+)"', text)
    named = [word for command in commands() for word in command if word.startswith(("suite/", "docs/"))]
    assert [target for target in (*links, *named) if not (ROOT / target.split("#")[0]).exists()] == []


@pytest.mark.parametrize("document", sorted((ROOT / "docs").glob("*.md")), ids=lambda path: path.name)
def test_documents_link_to_what_exists(document: Path):
    links = re.findall(r"\]\((?!https?:)([^)\s]+)\)", document.read_text())
    for link in links:
        file, _, anchor = link.partition("#")
        target = document.parent / file if file else document
        assert target.exists(), link
        titles = re.findall(r"(?m)^#+ (.*)$", target.read_text())
        headings = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
        assert not anchor or anchor in headings, link


def test_documents_that_the_code_cites_exist():
    """A docstring that sends its reader to a document names one that is there, and an equation or section that it has."""
    theory = (ROOT / "docs" / "theory.md").read_text()
    for path in [file for package in ("relaxations", "fmus", "reports", "suite") for file in (ROOT / package).rglob("*.py")]:
        text, where = path.read_text(), path.relative_to(ROOT)
        for name in re.findall(r"docs/(\w+\.(?:md|py))", text):
            assert (ROOT / "docs" / name).is_file(), f"{where} cites docs/{name}"
        for number in re.findall(r"theory\.md, equation (\d+)", text):
            assert re.search(rf"(?m)  \({number}\)$", theory), f"{where} cites equation {number}"
        for number in re.findall(r"theory\.md, section (\d+)", text):
            assert f"\n## {number}. " in theory, f"{where} cites section {number}"


# What the commands print.


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like the project's, where commands may leave their evidence."""
    folder = tmp_path_factory.mktemp("readme")
    for name in ("suite", "docs"):
        (folder / name).symlink_to(ROOT / name)
    return folder


@pytest.fixture(scope="module")
def printed(place: Path) -> Mapping[str, str]:
    """The output of every console block's command, run when it is asked for, after those that make the folders that it names."""

    class Outputs(dict[str, str]):
        def __missing__(self, prompt: str) -> str:
            program, *words = shlex.split(prompt.removeprefix("$ "))
            for before, _ in sessions():
                made = before.partition(" --out ")[2].partition(" ")[0]
                if before != prompt and made and made in words:
                    self[before]
            with contextlib.chdir(place):
                if program == "python":
                    self[prompt] = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True).stdout
                else:
                    self[prompt] = CliRunner().invoke(main, words).stdout
            return self[prompt]

    return Outputs()


def quick(prompt: str) -> bool:
    """Whether a command takes no long time: `make verify` and the slow suite run the others."""
    return not ("_fail" in prompt or "python" in prompt)


def pattern(quoted: str) -> str:
    """An expression for a quoted output: `…` is what was left out, on a line of its own whole lines."""
    lines = [r"(?:[^\n]*\n)*?" if line == "…" else re.escape(line).replace("…", r"[^\n]*") + "\n" for line in quoted.splitlines()]
    return "".join(lines)


@pytest.mark.parametrize("prompt", [prompt if quick(prompt) else slow(prompt) for prompt, _ in sessions() if prompt != f"$ {COLLECTION}"])
def test_commands_print_what_is_quoted(prompt: str, printed: Mapping[str, str]):
    output = "".join(f"{line.rstrip()}\n" for line in printed[prompt].splitlines())
    assert re.fullmatch(pattern(dict(sessions())[prompt]), output), output


def test_an_output_that_differs_in_one_digit_is_not_what_is_quoted():
    quoted = "a table\n…\nminimum time: 4.21 s (…)\n"
    assert re.fullmatch(pattern(quoted), "a table\nrow\nrow\nminimum time: 4.21 s (1.5 ms)\n")
    assert not re.fullmatch(pattern(quoted), "a table\nrow\nminimum time: 4.22 s (1.5 ms)\n")


@pytest.mark.slow
def test_the_picture_is_the_one_that_its_script_draws(tmp_path: Path):
    """Words and numbers of it: the last digits of the curves are the machine's."""
    again = tmp_path / "picture.svg"
    subprocess.run([sys.executable, ROOT / "docs" / "two_mass.py", again], check=True)
    shown, drawn = (re.findall(r"<text[^>]*>([^<]*)</text>", file.read_text()) for file in (ROOT / "docs/two_mass.svg", again))
    assert shown == drawn
    assert len(shown) > 10


@pytest.mark.slow
def test_the_picture_of_the_trade_off_is_the_one_that_its_command_draws(tmp_path: Path):
    """Words and numbers of it, as of the other one."""
    again = tmp_path / "picture.svg"
    assert CliRunner().invoke(main, ["tradeoff", str(ROOT / "suite/studies/two_mass.toml"), "--plot", str(again)]).exit_code == 0
    shown, drawn = (re.findall(r"<text[^>]*>([^<]*)</text>", file.read_text()) for file in (ROOT / "docs/tradeoff.svg", again))
    assert shown == drawn
    assert len(shown) > 10


@pytest.mark.slow
def test_the_picture_of_fuel_is_the_one_that_its_command_draws(tmp_path: Path):
    """Words and numbers of it, as of the other ones."""
    again = tmp_path / "picture.svg"
    words = ["fuel", str(ROOT / "suite/studies/two_mass_fuel.toml"), "--from", "1", "--to", "7", "--plot", str(again)]
    assert CliRunner().invoke(main, words).exit_code == 0
    shown, drawn = (re.findall(r"<text[^>]*>([^<]*)</text>", file.read_text()) for file in (ROOT / "docs/fuel.svg", again))
    assert shown == drawn
    assert len(shown) > 10


@pytest.mark.slow
def test_times_in_the_prose_are_those_of_the_picture_and_of_the_commands(printed: Mapping[str, str]):
    picture = (ROOT / "docs/two_mass.svg").read_text()
    told = set(re.findall(r"\((\d\.\d{4}) s\)", README))
    assert told == {"6.6627", "7.2711", "7.6654"}
    for time in told:
        assert f"{time} s" in picture
    outputs = [printed[prompt] for prompt, _ in sessions() if prompt != f"$ {COLLECTION}"]
    took = {f"{float(x):.4f}" for output in outputs for x in re.findall(r"maneuver_time \[s\]\s*│\s*([\d.]+)", output)}
    assert took == {"6.6627", "7.2711"}, "what `verify` is quoted with"


# What it says of what there is.


def test_the_size_of_the_checker_is_the_one_quoted():
    ((core, robust),) = re.findall(r"some (\d+) lines of code for every task and (\d+) more for robust ones", README)
    lines = sizes()
    assert abs(int(core) - sum(lines[module] for module in EVERY_TASK)) <= 10
    assert abs(int(robust) - sum(count for module, count in lines.items() if module not in EVERY_TASK)) <= 10


def test_the_requirement_of_the_example_can_be_written():
    (example,) = re.findall(r'(?m)^quantity = "([^"]+)"', README)
    parse_quantity(example)


def test_what_is_not_there_yet_is_named():
    words = {
        "uncertainty.distribution": "random samples",
        "uncertainty.sampling": "random samples",
        "cluster": "clusters",
    }
    (limits,) = re.findall(r"(?ms)^\*What is not there yet\*: (.*?)\n\n", README)
    assert words.keys() == UNSUPPORTED.keys()  # a key that leaves that table leaves the README too
    assert [key for key, word in words.items() if word not in limits.replace("\n", " ")] == []
