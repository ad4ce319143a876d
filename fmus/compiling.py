"""Compiling the C sources of an FMU: this machine's compiler for this machine, ziglang for every platform.

The same sources and compiler give the same bytes.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import platformdirs

from fmus.errors import BuildError

FmiVersion = Literal["2.0", "3.0"]

# -ffp-contract=off: no fused multiply-add behind our back, so that every compiler and processor gives the same bits.
# -g0 -s: debug information would name folders of the machine that built it.
FLAGS = (
    *("-std=c11", "-O2", "-g0", "-s", "-shared", "-fvisibility=hidden", "-ffp-contract=off"),
    *("-Wall", "-Wextra", "-DFMI3_OVERRIDE_FUNCTION_PREFIX"),
)
COMPILE_SECONDS = 1200.0  # ziglang compiles its C libraries first, once for each system: minutes on a busy machine
SUFFIX = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}


@dataclass(frozen=True, slots=True)
class Target:
    """What a library is for; system and machine in the words of FMI 3.0."""

    system: str
    machine: str

    def folder(self, fmi_version: FmiVersion) -> str:
        """Its folder below binaries/."""
        if fmi_version == "3.0":
            return f"{self.machine}-{self.system}"
        # FMI 2.0 names platforms by system and word length; FMPy and others use the FMI 3.0 name where it has none.
        bits = {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}[self.system]
        return bits if self.machine == "x86_64" or self.system == "darwin" else f"{self.machine}-{self.system}"

    @property
    def zig(self) -> str:
        """Its name for ziglang: GNU's C library of 2012, so that the library loads on old systems too."""
        return f"{self.machine}-" + {"linux": "linux-gnu.2.17", "windows": "windows-gnu", "darwin": "macos"}[self.system]


PLATFORMS: Mapping[str, tuple[Target, ...]] = {
    "linux64": (Target("linux", "x86_64"), Target("linux", "aarch64")),
    "win64": (Target("windows", "x86_64"),),
    "darwin64": (Target("darwin", "x86_64"), Target("darwin", "aarch64")),
}


def cache() -> Path:
    """Where built archives are kept."""
    chosen = os.environ.get("SLEWCERT_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("slewcert")


def host() -> Target:
    """This machine."""
    systems = {"linux": "linux", "darwin": "darwin", "win32": "windows"}
    machines = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    machine = machines.get(platform.machine().lower())
    if sys.platform not in systems or machine is None:
        raise BuildError(f"FMUs cannot be built for {sys.platform} on {platform.machine()}: FMI has no agreed name for it")
    return Target(systems[sys.platform], machine)


def compiler() -> list[str]:
    """The C compiler's command: $CC, cc, gcc, clang, or the one inside the Python package ziglang, whichever is there first."""
    chosen = shlex.split(os.environ.get("CC", ""))
    if chosen:
        if shutil.which(chosen[0]) is None:
            raise BuildError(f"the environment variable CC names {chosen[0]!r}, which is no program on the PATH; unset it or correct it")
        return chosen
    for program in ("cc", "gcc", "clang"):
        if path := shutil.which(program):
            return [path]
    if has_zig():
        return ZIG
    raise BuildError(
        "no C compiler found: tried $CC, cc, gcc, clang and the Python package ziglang. "
        "Install one of them ('pip install ziglang' needs no administrator), or set CC to a compiler's command"
    )


ZIG = [sys.executable, "-m", "ziglang", "cc"]


def has_zig() -> bool:
    """Whether the Python package ziglang is installed, which compiles for every platform."""
    return importlib.util.find_spec("ziglang") is not None


def compile_library(name: str, sources: Sequence[str], texts: Mapping[str, bytes], target: Target | None = None) -> bytes:
    """The shared library of the C files `sources` among `texts`, for `target` (with ziglang) or else for this machine.

    Raises `BuildError` with the compiler's own words.
    """
    command = compiler() if target is None else [*ZIG, "-target", target.zig]
    system = (target or host()).system
    file_name = name + SUFFIX[system]
    headers = _fmi_headers()
    with tempfile.TemporaryDirectory(prefix="slewcert-build-") as folder:
        for path, text in texts.items():
            (Path(folder) / path).write_bytes(text)
        # Names relative to the folder: a path of this machine in the library would change its bytes from build to build.
        extra, libraries = ([], []) if system == "windows" else (["-fPIC"], ["-lm"])
        full = [*command, *FLAGS, *extra, f"-I{headers}", "-o", file_name, *sources, *libraries]
        # ziglang keeps what it has compiled (its own C libraries above all) where it is told.
        zig = {"ZIG_GLOBAL_CACHE_DIR": str(cache() / "zig"), "ZIG_LOCAL_CACHE_DIR": str(cache() / "zig")}
        try:
            done = subprocess.run(full, cwd=folder, env={**zig, **os.environ}, capture_output=True, text=True, errors="replace",
                                  timeout=COMPILE_SECONDS, check=False)  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise BuildError(f"compiling {name} with '{shlex.join(command)}' failed: {problem}") from None
        library = Path(folder) / file_name
        if done.returncode != 0 or not library.exists():
            words = done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode} without a message"
            raise BuildError(f"compiling {name} with '{shlex.join(command)}' failed:\n{words}")
        return library.read_bytes()


def compile_for(targets: Sequence[Target], name: str, sources: Sequence[str], texts: Mapping[str, bytes],
                fmi_version: FmiVersion) -> dict[str, bytes]:  # fmt: skip
    """The libraries for `targets`, by their paths in the archive. Without ziglang `targets` may hold this machine only."""
    if missing := [t for t in targets if not has_zig() and t != host()]:
        names = ", ".join(f"{t.machine}-{t.system}" for t in missing)
        raise BuildError(
            f"a library for {names} needs the Python package ziglang, which is not installed ('pip install ziglang', 100 MB); "
            "without it there is one for this machine only"
        )
    found: dict[str, list[tuple[Target, bytes]]] = {}
    for target in targets:
        library = compile_library(name, sources, texts, target if has_zig() else None)
        found.setdefault(f"binaries/{target.folder(fmi_version)}/{name}{SUFFIX[target.system]}", []).append((target, library))
    # FMI 2.0 has one folder for both processors of a Mac.
    return {path: parts[0][1] if len(parts) == 1 else universal(parts) for path, parts in found.items()}


def universal(parts: Sequence[tuple[Target, bytes]]) -> bytes:
    """One library for several processors of a Mac: a table (big-endian: type, subtype, offset, size, alignment), then the libraries."""
    processors = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}
    alignment = 14  # as a power of two: pages of 16 KiB
    head, body = struct.pack(">II", 0xCAFEBABE, len(parts)), b""
    first = 1 << alignment
    for target, library in parts:
        head += struct.pack(">IIIII", *processors[target.machine], first + len(body), len(library), alignment)
        body += library + bytes(-len(library) % (1 << alignment))
    return head.ljust(first, b"\0") + body


def _fmi_headers() -> Path:
    # The headers of the FMI standard come with FMPy; looking for them does not import it.
    spec = importlib.util.find_spec("fmpy")
    for place in (spec.submodule_search_locations or ()) if spec else ():
        if (Path(place) / "c-code" / "fmi3Functions.h").exists():
            return Path(place) / "c-code"
    raise BuildError("the headers of the FMI standard are missing: they come with the Python package FMPy ('pip install fmpy')")
