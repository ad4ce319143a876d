"""Plants that fail on purpose: `two_mass` with a fault of `tests/faults/` compiled in, its linear twin included.

All faults set in at `FAULT_TIME`, those of `fixed_step` (which takes steps of 0.05 s only) and `flood` at once.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from fmus.build import PLANTS, FmiVersion, build_folder

FAULTS_FOLDER = Path(__file__).parent / "faults"
FAULTS = tuple(sorted(path.stem for path in FAULTS_FOLDER.glob("*.c")))
FAULT_TIME = 1.0  # s


def build_fault(name: str, fmi_version: FmiVersion = "3.0", out: Path | None = None) -> Path:
    """The FMU of the plant with the fault `name` (one of `FAULTS`), from the cache if it was built before."""
    healthy = PLANTS / "two_mass"
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shutil.copy(FAULTS_FOLDER / f"{name}.c", folder)
        shutil.copy(FAULTS_FOLDER / "fault.h", folder)
        shutil.copy(healthy / "two_mass.c", folder)
        shutil.copy(healthy / "twin.toml", folder)
        variable_step = "false" if name == "fixed_step" else "true"
        text = (healthy / "plant.toml").read_text(encoding="utf-8")
        changed = text.replace('name = "two_mass"', f'name = "{name}"\nstep_hook = true\nvariable_step = {variable_step}')
        (folder / "plant.toml").write_text(changed, encoding="utf-8")
        return build_folder(folder, fmi_version, out)
