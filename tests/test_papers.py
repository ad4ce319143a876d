"""The tables of docs/papers.md are what the commands print that are named there."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SESSIONS = re.findall(r"(?ms)^```console\n\$ ([^\n]*)\n(.*?)^```", (ROOT / "docs" / "papers.md").read_text())


@pytest.mark.slow
@pytest.mark.parametrize(("command", "quoted"), SESSIONS, ids=[command for command, _ in SESSIONS])
def test_tables_are_what_their_commands_print(command: str, quoted: str) -> None:
    program, *words = shlex.split(command)
    assert program == "python"
    printed = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert printed == quoted


def test_every_claim_has_a_verdict() -> None:
    for _, quoted in SESSIONS:
        headings, *rows = quoted.splitlines()
        assert headings.split()[-1] == "verdict"
        assert rows
        assert [row for row in rows if not re.search(r"  (reproduced|corrected|not reproduced)$", row)] == []


@pytest.mark.slow
def test_the_pole_zero_figures_are_those_that_their_script_draws(tmp_path: Path) -> None:
    """Words and numbers of them: the last digits of the curves are the machine's."""
    subprocess.run([sys.executable, ROOT / "docs" / "pole_zero_figures.py", tmp_path], check=True, capture_output=True)
    drawn, shown = ({path.name: path.read_text() for path in folder.glob("*.svg")} for folder in (tmp_path, ROOT / "docs" / "pole_zero"))
    assert drawn.keys() == shown.keys()
    words = [{name: re.findall(r"<text[^>]*>([^<]*)</text>", svg) for name, svg in each.items()} for each in (drawn, shown)]
    assert words[0] == words[1]
