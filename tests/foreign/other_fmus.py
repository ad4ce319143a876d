"""FMUs that were not written here: those that packages of the Python index carry, and those that they make of Python code."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

WHEELS = Path(__file__).parent / "wheels"
GEMSEO = "gemseo_fmu/gemseo_fmu/problems/fmu_files"
CRANE = "crane_fmu/examples"

# A turntable with a flexible shaft, exact for an input that is held: x_{k+1} = e^{Ah} x_k + ∫e^{As} ds B u_k, by one matrix exponential.
SLAVE = """
import numpy as np
from scipy.linalg import expm

from {module} import {base}, {causality}, {number}


class Turntable({base}):
    author, description = "nobody", "Motor and table on a flexible shaft"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.torque, self.stiffness, self.damping, self.table = 0.0, 0.0, 4.0, 0.02, 0.0
        self.x, self.known = np.zeros(4), {{}}
        {time}self.register_variable({number}("torque", causality={causality}.input, start=0.0))
        self.register_variable({number}("stiffness", causality={causality}.parameter, {variability} start=4.0))
        self.register_variable({number}("damping", causality={causality}.parameter, {variability} start=0.02))
        self.register_variable({number}("table", causality={causality}.output))

    def do_step(self, current_time, step_size):
        key = self.stiffness, self.damping, step_size
        if key not in self.known:
            k, c = self.stiffness, self.damping
            a = np.zeros((5, 5))
            a[0, 1] = a[2, 3] = 1.0
            a[1, :] = [-k, -c, k, c, 1.0]
            a[3, :] = [k, c, -k, -c, 0.0]
            self.known = {{key: expm(a * step_size)}}
        self.x = (self.known[key] @ np.append(self.x, self.torque))[:4]
        self.table = float(self.x[2])
        return True
"""
WORDS = {
    "pythonfmu": {
        "module": "pythonfmu",
        "base": "Fmi2Slave",
        "causality": "Fmi2Causality",
        "number": "Real",
        "variability": 'variability=__import__("pythonfmu").Fmi2Variability.fixed,',
        "time": "",
    },
    "pythonfmu3": {
        "module": "pythonfmu3.fmi3slave",
        "base": "Fmi3Slave",
        "causality": "Fmi3Causality",
        "number": "Float64",
        "variability": 'variability=__import__("pythonfmu3").fmi3slave.Fmi3Variability.fixed,',
        "time": 'self.register_variable(Float64("time", causality=Fmi3Causality.independent, '
        'variability=__import__("pythonfmu3").fmi3slave.Fmi3Variability.continuous)); ',
    },
}


def unpack(folder: Path) -> None:
    """Every wheel into a folder of its own, named by its distribution."""
    for wheel in WHEELS.glob("*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder / wheel.name.partition("-")[0])


def import_path(folder: Path) -> str:
    """Where FMUs made of Python code find what they import, as PYTHONPATH."""
    return os.pathsep.join(str(folder / name) for name in ("jsonpath_ng", "component_model"))


def turntable(folder: Path, package: str) -> Path:
    """The turntable as an FMU made by `package`, "pythonfmu" (FMI 2.0) or "pythonfmu3" (FMI 3.0)."""
    script, out = folder / f"{package}_turntable.py", folder / f"{package}_out"
    script.write_text(SLAVE.format(**WORDS[package]))
    out.mkdir(exist_ok=True)
    env = {**os.environ, "PYTHONPATH": str(folder / package)}
    done = subprocess.run(
        [sys.executable, "-m", package, "build", "-f", str(script), "-d", str(out)],
        env=env, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (fmu,) = out.glob("*.fmu")
    return fmu
