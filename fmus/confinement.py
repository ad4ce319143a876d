"""What the process of an FMU may use: memory, file sizes, time a step, and optionally a sandbox of the system (bubblewrap).

A limit on memory makes the FMU's allocations fail, as on a machine that has no more. Without the sandbox an FMU may do whatever the user
may; with it there is no network, nothing of the file system but the system itself and Python (read-only) and the run's own folder, and
no other process.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from fmus.errors import FmuError

Sandbox = Literal["none", "auto", "bwrap"]
SANDBOXES: tuple[Sandbox, ...] = get_args(Sandbox)

MEBIBYTE = 2**20
SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/etc", "/opt", "/nix/store")
PROBE_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class Confinement:
    """Limits of the process of an FMU. `memory` [bytes] of data that it may allocate, its Python (some 30 MB) included; enforced on Linux.

    `file_size` [bytes] of any one file that it writes; `step` [s] of wall-clock time for one step of a run, and for what comes before the
    first one (None: the limit of the whole run). `sandbox` "auto" uses bubblewrap where it works, "bwrap" insists on it.
    """

    memory: int = 4096 * MEBIBYTE
    file_size: int = 1024 * MEBIBYTE
    step: float | None = None
    sandbox: Sandbox | None = None

    def __post_init__(self) -> None:
        if self.sandbox not in (None, *SANDBOXES):
            raise FmuError(f"there is no sandbox {self.sandbox!r}; valid are {', '.join(SANDBOXES)}")
        if self.memory < 64 * MEBIBYTE:
            raise FmuError(f"an FMU's process needs at least 64 MiB of memory, not {self.memory / MEBIBYTE:g}")


_chosen: Sandbox = "none"


def choose_sandbox(sandbox: Sandbox) -> None:
    """The sandbox of all FMUs of this process that are not told otherwise; `FmuError` if it is "bwrap" and there is none."""
    global _chosen
    Confinement(sandbox=sandbox)
    if sandbox == "bwrap" and (problem := missing()):
        raise FmuError(f"the sandbox bwrap cannot be used: {problem}")
    _chosen = sandbox


def in_force(confinement: Confinement) -> Confinement:
    """The same with a sandbox that is decided: "bwrap" or "none"."""
    asked = confinement.sandbox or _chosen
    if asked == "bwrap" and (problem := missing()):
        raise FmuError(f"the sandbox bwrap cannot be used: {problem}")
    return replace(confinement, sandbox="none" if asked == "none" or missing() else "bwrap")


@cache
def missing() -> str | None:
    """Why there is no bubblewrap here; None if it works. Many containers have the program, and forbid what it does."""
    program = shutil.which("bwrap")
    if program is None:
        return "there is no program bwrap (bubblewrap) on the PATH"
    try:
        done = subprocess.run(
            [program, *_isolation(), sys.executable, "-c", ""],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as problem:
        return str(problem)
    return None if done.returncode == 0 else done.stderr.strip()[-300:] or f"bwrap ended with exit code {done.returncode}"


def wrapped(command: list[str], folder: Path, work: Path, confinement: Confinement) -> list[str]:
    """The command, in the sandbox if there is to be one; `folder` is all that it may write to, `work` its working directory."""
    if confinement.sandbox != "bwrap":
        return command
    own = ["--bind", str(folder), str(folder), "--chdir", str(work)]
    return ["bwrap", *_isolation(), *own, *command]


def _isolation() -> list[str]:
    """The file system without the user's part of it, no network, no other processes."""
    here = Path(__file__).resolve().parent.parent
    entries = [sys.prefix, sys.base_prefix, Path(sys.executable).resolve().parent.parent, here]
    entries += [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    entries += [entry for entry in sys.path if entry.endswith("site-packages")]
    python = {str(Path(entry).resolve()) for entry in entries}  # nothing can be mounted on a symbolic link
    # A folder of Python that is the root or the user's home would bring in everything.
    visible = [*SYSTEM, *sorted(path for path in python if path not in ("/", str(Path.home().resolve())))]
    binds = [part for path in visible for part in ("--ro-bind-try", path, path)]
    return ["--unshare-all", "--proc", "/proc", "--dev", "/dev", "--tmpfs", "/tmp", *binds]


def signal_of(code: int, confinement: Confinement) -> int:
    """The exit code as Python tells it: negative for a signal, which bubblewrap passes on as 128 + its number."""
    wrapped_signal = confinement.sandbox == "bwrap" and code - 128 in set(signal.Signals)
    return 128 - code if wrapped_signal else code
