"""A finished evidence folder and a comparison, made once by the command line as a user would make them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "suite" / "studies"


def run(*words: str | Path) -> None:
    """The command line, as a user would use it; it has to succeed."""
    command = Path(sys.executable).with_name("slewcert")
    done = subprocess.run([command, *words], capture_output=True, text=True, timeout=300, env={**os.environ, "COLUMNS": "120"})
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="session")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The evidence folder of the shipped two-mass study."""
    folder = tmp_path_factory.mktemp("evidence") / "two_mass"
    run("verify", STUDIES / "two_mass.toml", "--out", folder)
    return folder


@pytest.fixture(scope="session")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shaped crane with four shapers, compared."""
    folder = tmp_path_factory.mktemp("comparison")
    shapers = [word for kind in ("none", "zv", "zvd", "si") for word in ("--shaper", kind)]
    run("compare", STUDIES / "gantry_crane_shaped.toml", *shapers, "--out", folder)
    return folder
