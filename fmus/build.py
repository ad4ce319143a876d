"""Building FMUs from plant folders: generate, compile, pack, cache.

A plant folder NAME holds NAME.c (the equations), plant.toml (the variables), and, if the plant is to be proven about, twin.toml
(the equations as exact matrices); `fmus/plants/README.md` says how to write one. The archive holds model exchange and
co-simulation, one binary (this machine's), and the C sources. The same sources and compiler give the same bytes.
"""

from __future__ import annotations

import hashlib
import importlib.util
import io
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

import platformdirs

from fmus.errors import BuildError, DescriptionError
from fmus.generation import build_description_3, c_header, model_description_2, model_description_3
from fmus.plant_files import PlantFile, read_plant_file
from fmus.twins import check_twin

FmiVersion = Literal["2.0", "3.0"]

PLANTS = Path(__file__).parent / "plants"
SOURCES = Path(__file__).parent / "sources"
SHARED = ("instance.c", "fmustate.c", "integrator.c")
# -ffp-contract=off: no fused multiply-add behind our back, so that every compiler and processor gives the same bits.
# -g0 -s: debug information would name folders of the machine that built it.
FLAGS = (
    *("-std=c11", "-O2", "-g0", "-s", "-shared", "-fvisibility=hidden", "-ffp-contract=off"),
    *("-Wall", "-Wextra", "-DFMI3_OVERRIDE_FUNCTION_PREFIX"),
)
COMPILE_SECONDS = 300.0


def shipped() -> tuple[str, ...]:
    """The names of the plants that come with the package."""
    return tuple(sorted(path.parent.name for path in PLANTS.glob("*/plant.toml")))


def locate(name: str) -> Path:
    """The FMU of a shipped plant, built if it is not in the cache: "two_mass" (FMI 3.0), "two_mass.fmi2" or "two_mass.fmi3"."""
    stem, _, suffix = name.partition(".")
    versions: Mapping[str, FmiVersion] = {"": "3.0", "fmi2": "2.0", "fmi3": "3.0"}
    if suffix not in versions:
        raise BuildError(f"{name!r} is no shipped plant: append nothing, '.fmi2' or '.fmi3' to one of {', '.join(shipped())}")
    return build(stem, versions[suffix])


def build(name: str, fmi_version: FmiVersion = "3.0", out: Path | None = None) -> Path:
    """Build a shipped plant; see `build_folder`. Raises `BuildError` if there is no plant of that name."""
    if name not in shipped():
        raise BuildError(f"there is no shipped plant {name!r}; there is {', '.join(shipped())}")
    return build_folder(PLANTS / name, fmi_version, out)


def build_folder(folder: Path, fmi_version: FmiVersion = "3.0", out: Path | None = None) -> Path:
    """Build the plant in `folder` and return the path of the .fmu file.

    The archive lies in the cache (`SLEWCERT_CACHE`, else the user's cache folder) under a hash of everything that goes into it, and
    is compiled only if it is not there yet. `out` is a file (ending in .fmu) or a folder to copy it to.
    Raises `BuildError`: a malformed plant.toml or twin.toml, no compiler, or the compiler's own words.
    """
    if fmi_version not in get_args(FmiVersion):
        raise BuildError(f"FMI version {fmi_version!r} cannot be built; valid are {', '.join(get_args(FmiVersion))}")
    plant = read_plant_file(folder / "plant.toml")
    files = _archive_files(folder, plant, fmi_version)
    key = _digest({**files, "flags": " ".join(FLAGS).encode(), "platform": "/".join(_binary(plant, fmi_version)).encode()})
    archive = cache() / "fmus" / key[:16] / f"{plant.name}.fmi{fmi_version[0]}.fmu"
    if not archive.exists():
        folder_name, file_name = _binary(plant, fmi_version)
        library = _compile(plant, files, fmi_version, file_name)
        _write(archive, _zip({**files, f"binaries/{folder_name}/{file_name}": library}))
    if out is None:
        return archive
    target = out if out.suffix == ".fmu" else out / archive.name
    _write(target, archive.read_bytes())
    return target


def cache() -> Path:
    """Where built archives are kept."""
    chosen = os.environ.get("SLEWCERT_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("slewcert")


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
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise BuildError(
        "no C compiler found: tried $CC, cc, gcc, clang and the Python package ziglang. "
        "Install one of them ('pip install ziglang' needs no administrator), or set CC to a compiler's command"
    )


def _archive_files(folder: Path, plant: PlantFile, fmi_version: FmiVersion) -> dict[str, bytes]:
    """Everything in the archive but the binary, by its path there."""
    own = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix in {".c", ".h"}}
    if f"{plant.name}.c" not in own:
        raise BuildError(f"{folder} has no {plant.name}.c, which must hold the equations of the plant {plant.name!r}")
    wrapper = f"fmi{fmi_version[0]}.c"
    shared = {path.name: path.read_bytes() for path in sorted(SOURCES.iterdir()) if path.suffix == ".h" or path.name in {*SHARED, wrapper}}
    if clash := own.keys() & (shared.keys() | {"variables.h"}):
        raise BuildError(f"{folder} may not hold a {min(clash)}: the shared sources have a file of that name")
    texts = {**own, **shared}
    twin = folder / "twin.toml"
    resources = {"resources/twin.toml": twin.read_bytes()} if twin.exists() else {}
    if resources:
        try:
            check_twin(twin.read_text(encoding="utf-8"))
        except DescriptionError as problem:
            raise BuildError(f"{twin}: {problem}") from None
    # The token is a hash of all sources: a library never meets the description of another build unnoticed.
    token = _digest({**texts, **resources, "plant.toml": (folder / "plant.toml").read_bytes(), "version": fmi_version.encode()})
    token = f"{{{token[:8]}-{token[8:12]}-{token[12:16]}-{token[16:20]}-{token[20:32]}}}"
    compiled = (f"{plant.name}.c", *SHARED, wrapper)
    texts["variables.h"] = c_header(plant, token).encode()
    files = {f"sources/{name}": text for name, text in texts.items()} | resources
    if fmi_version == "2.0":
        files["modelDescription.xml"] = model_description_2(plant, token, compiled)
    else:
        files["modelDescription.xml"] = model_description_3(plant, token)
        files["sources/buildDescription.xml"] = build_description_3(plant, compiled)
    return files


def _compile(plant: PlantFile, files: Mapping[str, bytes], fmi_version: FmiVersion, file_name: str) -> bytes:
    command = compiler()
    headers = _fmi_headers()
    with tempfile.TemporaryDirectory(prefix="slewcert-build-") as folder:
        for name, text in files.items():
            if name.startswith("sources/"):
                (Path(folder) / Path(name).name).write_bytes(text)
        # Names relative to the folder: a path of this machine in the library would change its bytes from build to build.
        sources = [f"{plant.name}.c", *SHARED, f"fmi{fmi_version[0]}.c"]
        extra = [] if sys.platform == "win32" else ["-fPIC"]
        libraries = [] if sys.platform == "win32" else ["-lm"]
        full = [*command, *FLAGS, *extra, f"-I{headers}", "-o", file_name, *sources, *libraries]
        try:
            done = subprocess.run(full, cwd=folder, capture_output=True, text=True, errors="replace", timeout=COMPILE_SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise BuildError(f"compiling {plant.name} with '{shlex.join(command)}' failed: {problem}") from None
        library = Path(folder) / file_name
        if done.returncode != 0 or not library.exists():
            words = done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode} without a message"
            raise BuildError(f"compiling {plant.name} with '{shlex.join(command)}' failed:\n{words}")
        return library.read_bytes()


def _fmi_headers() -> Path:
    # The headers of the FMI standard come with FMPy; looking for them does not import it.
    spec = importlib.util.find_spec("fmpy")
    for place in (spec.submodule_search_locations or ()) if spec else ():
        if (Path(place) / "c-code" / "fmi3Functions.h").exists():
            return Path(place) / "c-code"
    raise BuildError("the headers of the FMI standard are missing: they come with the Python package FMPy ('pip install fmpy')")


def _binary(plant: PlantFile, fmi_version: FmiVersion) -> tuple[str, str]:
    """Folder below binaries/ and file name of this machine's library."""
    systems = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
    machines = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    machine = machines.get(platform.machine().lower())
    if sys.platform not in systems or machine is None:
        raise BuildError(f"plants cannot be built for {sys.platform} on {platform.machine()}: FMI has no agreed name for it")
    system, suffix = systems[sys.platform]
    if fmi_version == "3.0":
        return f"{machine}-{system}", plant.name + suffix
    # FMI 2.0 names platforms by system and word length; FMPy and others use the FMI 3.0 name where it has none.
    bits = {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}[system]
    return bits if machine == "x86_64" or system == "darwin" else f"{machine}-{system}", plant.name + suffix


def _digest(parts: Mapping[str, bytes]) -> str:
    total = hashlib.sha256()
    for name in sorted(parts):
        total.update(f"{name}\0{len(parts[name])}\0".encode() + parts[name])
    return total.hexdigest()


def _zip(files: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, files[name])
    return buffer.getvalue()


def _write(path: Path, content: bytes) -> None:
    """Write all or nothing: several processes may build the same plant at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, delete=False) as file:
        file.write(content)
    try:
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except OSError:
        os.unlink(file.name)
        raise
