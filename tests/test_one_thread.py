"""Linear algebra of many small matrices runs in one thread: several wait for each other far longer than they work."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import suite

SAY = "import os, suite.cli; print(os.environ['OPENBLAS_NUM_THREADS'])"


@pytest.mark.parametrize(("own", "told"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_the_command_line_asks_for_one_thread_unless_the_user_asks_for_more(own: dict[str, str], told: str) -> None:
    there = {name: value for name, value in os.environ.items() if name != suite.THREADS} | own
    done = subprocess.run([sys.executable, "-c", SAY], env=there, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == told
