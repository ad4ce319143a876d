"""The chain of `tests/arrays` as an FMU: arrays, a structural parameter, a matrix, truth values, an enumeration, text, terminals."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from fmus.archives import host_platform
from fmus.compiling import _fmi_headers, compiler
from fmus.stepping import Array

FOLDER = Path(__file__).parent / "arrays"


@cache
def _library() -> bytes:
    with tempfile.TemporaryDirectory() as place:
        shutil.copy(FOLDER / "chain.c", place)
        strict = ("-O2", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror")
        command = [*compiler(), *strict, f"-I{_fmi_headers()}", "-o", "chain.so", "chain.c", "-lm"]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return (Path(place) / "chain.so").read_bytes()


def build_chain(folder: Path, *changes: tuple[str, str], name: str = "chain", twin: bool = False) -> Path:
    """The FMU in `folder`; `changes` are replacements in its modelDescription.xml, `twin` says whether its linear twin goes along."""
    text = (FOLDER / "modelDescription.xml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(FOLDER / "terminalsAndIcons.xml", "terminalsAndIcons/terminalsAndIcons.xml")
        archive.write(FOLDER / "chain.c", "sources/chain.c")
        if twin:
            archive.write(FOLDER / "twin.toml", "resources/twin.toml")
        archive.writestr(f"binaries/{host_platform()}/chain.so", _library())
    return path


def matrices(stiffness: list[float], anchored: bool = False) -> tuple[Array, Array]:
    """x'' = -K x + force: the state matrix of (x, x'), and the columns of the forces, by hand."""
    n = len(stiffness)
    K = np.zeros((n, n))
    for i in range(n - 1):
        K[i : i + 2, i : i + 2] += stiffness[i] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K[-1, -1] += stiffness[-1] if anchored else 0.0
    zero, one = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, one], [-K, zero]]), np.vstack([zero, one])


def positions(times: Array, stiffness: list[float], forces: list[float], anchored: bool = False, start: Array | None = None) -> Array:
    """Positions (n, masses) under constant forces, by the matrix exponential."""
    A, B = matrices(stiffness, anchored)
    n = len(stiffness)
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:-1, :-1], whole[:-1, -1] = A, B @ np.array(forces)
    first = np.append(np.zeros(2 * n) if start is None else start, 1.0)
    return np.array([(expm(whole * t) @ first)[:n] for t in times], dtype=np.float64)
