"""Building FMUs from plant folders: generate, compile, pack, cache.

A plant folder NAME holds NAME.c (the equations), plant.toml (the variables), and, if the plant is to be proven about, twin.toml
(the equations as exact matrices); `fmus/plants/README.md` says how to write one. The archive holds model exchange and
co-simulation, one binary (this machine's), and the C sources. The same sources and compiler give the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

from fmus.compiling import FLAGS, SUFFIX, FmiVersion, cache, compile_library, host
from fmus.errors import BuildError, DescriptionError
from fmus.generation import build_description_3, c_header, model_description_2, model_description_3
from fmus.packing import digest, token, write, zipped
from fmus.plant_files import PlantFile, read_plant_file
from fmus.twins import check_twin

PLANTS = Path(__file__).parent / "plants"
SOURCES = Path(__file__).parent / "sources"
INTEGRATOR = "integrator.c"
SHARED = ("instance.c", "fmustate.c")
HEADERS = ("instance.h", "integrator.h", "plant.h")


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
    files, compiled = _plant_files(folder, plant, fmi_version)
    library = f"binaries/{host().folder(fmi_version)}/{plant.name}{SUFFIX[host().system]}"
    key = digest({**files, "flags": " ".join(FLAGS).encode(), "platform": library.encode()})
    archive = cache() / "fmus" / key[:16] / f"{plant.name}.fmi{fmi_version[0]}.fmu"
    if not archive.exists():
        write(archive, zipped({**files, library: compile_library(plant.name, compiled, source_texts(files))}))
    if out is None:
        return archive
    target = out if out.suffix == ".fmu" else out / archive.name
    write(target, archive.read_bytes())
    return target


def source_texts(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files below sources/, by name."""
    return {name.removeprefix("sources/"): text for name, text in files.items() if name.startswith("sources/")}


def fmu_files(
    plant: PlantFile, own: Mapping[str, bytes], main: Sequence[str], fmi_version: FmiVersion, resources: Mapping[str, bytes]
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Everything in an archive but the libraries, by its path there, and the names of the C files to compile.

    `own` are source files by name, `main` those of them that are compiled; what is the same for every FMU joins them here.
    Raises `BuildError` if `own` holds a file that has the name of a shared one.
    """
    wrapper = f"fmi{fmi_version[0]}.c"
    shared = {name: (SOURCES / name).read_bytes() for name in (*SHARED, *HEADERS, wrapper)}
    if clash := own.keys() & (shared.keys() | {"variables.h"}):
        raise BuildError(f"a plant's folder may not hold a {min(clash)}: the shared sources have a file of that name")
    compiled = (*main, *SHARED, wrapper)

    def described(guid: str) -> dict[str, bytes]:
        files = {f"sources/{name}": text for name, text in {**own, **shared, "variables.h": c_header(plant, guid).encode()}.items()}
        if fmi_version == "2.0":
            description = {"modelDescription.xml": model_description_2(plant, guid, compiled)}
        else:
            description = {"modelDescription.xml": model_description_3(plant, guid)}
            description["sources/buildDescription.xml"] = build_description_3(plant, compiled)
        return {**files, **resources, **description}

    # The token is a hash of everything else: a library never meets the description of another build unnoticed.
    return described(token(described(""))), compiled


def _plant_files(folder: Path, plant: PlantFile, fmi_version: FmiVersion) -> tuple[dict[str, bytes], tuple[str, ...]]:
    own = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix in {".c", ".h"}}
    if f"{plant.name}.c" not in own:
        raise BuildError(f"{folder} has no {plant.name}.c, which must hold the equations of the plant {plant.name!r}")
    if INTEGRATOR in own:
        raise BuildError(f"{folder} may not hold a {INTEGRATOR}: the shared sources have a file of that name")
    twin = folder / "twin.toml"
    resources = {"resources/twin.toml": twin.read_bytes()} if twin.exists() else {}
    if resources:
        try:
            check_twin(twin.read_text(encoding="utf-8"))
        except DescriptionError as problem:
            raise BuildError(f"{twin}: {problem}") from None
    own[INTEGRATOR] = (SOURCES / INTEGRATOR).read_bytes()
    return fmu_files(plant, own, (f"{plant.name}.c", INTEGRATOR), fmi_version, resources)
