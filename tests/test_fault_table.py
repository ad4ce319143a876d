"""The table of faults in docs/fmus.md is complete and true: every fault there is, with FMI 2.0 and 3.0."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Literal

import pytest
from fault_plants import FAULTS, build_fault
from hostile_fmus import NAMES, hostile
from marks import in_turn
from test_workers import PATIENCE, experiment, finished

from fmus.build import build
from fmus.confinement import MEBIBYTE, Confinement
from fmus.errors import FmuError
from fmus.workers import Worker

TEXT = (Path(__file__).parents[1] / "docs/fmus.md").read_text(encoding="utf-8")
ROWS = {name: (status, words) for name, status, words in re.findall(r"^\| `(\w+)`[^|]*\| (\w+) \| (?:`([^`]*)`)? ?\|$", TEXT, re.MULTILINE)}


def test_every_fault_has_a_row() -> None:
    assert {*FAULTS, *NAMES} == set(ROWS)


@pytest.mark.parametrize(("name", "version"), in_turn(sorted(ROWS), quick=20))
def test_a_fault_ends_as_its_row_says(name: str, version: Literal["2.0", "3.0"], tmp_path: Path) -> None:
    if name == "leak" and sys.platform != "linux":
        pytest.skip("other systems do not enforce a limit of memory")
    fmu = build_fault(name, version) if name in FAULTS else hostile(name, version, tmp_path)
    status, words = ROWS[name]
    with Worker(Confinement(memory=256 * MEBIBYTE, file_size=3 * MEBIBYTE)) as worker:
        try:
            outcome = worker.run(experiment(fmu), 0.7 if name == "hang" else PATIENCE)
            found, said = outcome.status.name.lower(), outcome.detail
        except FmuError as problem:
            found, said = "refused", str(problem)
        assert found == status
        assert words in said
        finished(worker.run(experiment(build("two_mass", version)), PATIENCE))
