"""A finished evidence folder, made once by the command line as a user would make it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The evidence folder of the shipped two-mass study."""
    folder = tmp_path_factory.mktemp("evidence") / "two_mass"
    command = Path(sys.executable).with_name("slewcert")
    done = subprocess.run(
        [command, "verify", ROOT / "suite" / "studies" / "two_mass.toml", "--out", folder],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "COLUMNS": "120"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder
