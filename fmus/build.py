"""Building FMUs from plant folders: generate, compile, pack, cache.

A plant folder NAME holds NAME.c (the equations), plant.toml (the variables), and, if the plant is to be proven about, twin.toml
(the equations as exact matrices); `fmus/plants/README.md` says how to write one. The archive holds model exchange and
co-simulation, one binary (this machine's), and the C sources. The same sources and compiler give the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

from fmus import compiled as loop
from fmus.compiling import FLAGS, SUFFIX, FmiVersion, cache, compile_library, host
from fmus.errors import BuildError, DescriptionError
from fmus.generation import build_description_3, c_header, model_description_2, model_description_3
from fmus.packing import digest, token, write, zipped
from fmus.plant_files import PlantFile, read_plant_file
from fmus.twins import read_twin, sized

PLANTS = Path(__file__).parent / "plants"
SOURCES = Path(__file__).parent / "sources"
INTEGRATOR = "integrator.c"
VERSIONS: Mapping[str, FmiVersion] = {"": "3.0", "fmi2": "2.0", "fmi3": "3.0"}  # by what stands after a plant's name
SHARED = ("instance.c", "fmustate.c")
HEADERS = ("instance.h", "integrator.h", "plant.h")


def shipped() -> tuple[str, ...]:
    """The names of the plants that come with the package."""
    return tuple(sorted(path.parent.name for path in PLANTS.glob("*/plant.toml")))


def is_shipped(name: str) -> bool:
    """Whether `locate` knows what `name` means; building it may still fail."""
    stem, _, suffix = name.partition(".")
    return suffix in VERSIONS and _folder(stem) is not None


def locate(name: str) -> Path:
    """The FMU of a shipped plant, built if it is not in the cache: "two_mass" (FMI 3.0), "two_mass.fmi2" or "two_mass.fmi3".

    A plant with arrays is built with its own size, "chain", or with another one, "chain_6".
    """
    stem, _, suffix = name.partition(".")
    if suffix not in VERSIONS:
        raise BuildError(f"{name!r} is no shipped plant: append nothing, '.fmi2' or '.fmi3' to one of {', '.join(shipped())}")
    return build(stem, VERSIONS[suffix])


def build(name: str, fmi_version: FmiVersion = "3.0", out: Path | None = None) -> Path:
    """Build a shipped plant; see `build_folder`. Raises `BuildError` if there is no plant of that name."""
    found = _folder(name)
    if found is None:
        raise BuildError(f"there is no shipped plant {name!r}; there is {', '.join(shipped())}")
    folder, size = found
    return build_folder(folder, fmi_version, out, size=size)


def _folder(name: str) -> tuple[Path, int | None] | None:
    """The folder of a shipped plant and the size in its name: none in "two_mass", 6 in "chain_6"."""
    stem, _, size = name.rpartition("_")
    if name in shipped():
        return PLANTS / name, None
    return (PLANTS / stem, int(size)) if stem in shipped() and size.isdecimal() and len(size) < 6 else None


def build_folder(folder: Path, fmi_version: FmiVersion = "3.0", out: Path | None = None, *, size: int | None = None) -> Path:
    """Build the plant in `folder`, with arrays of `size` if it has any, and return the path of the .fmu file.

    The archive lies in the cache (`SLEWCERT_CACHE`, else the user's cache folder) under a hash of everything that goes into it, and
    is compiled only if it is not there yet. `out` is a file (ending in .fmu) or a folder to copy it to.
    Raises `BuildError`: a malformed plant.toml or twin.toml, no compiler, or the compiler's own words.
    """
    if fmi_version not in get_args(FmiVersion):
        raise BuildError(f"FMI version {fmi_version!r} cannot be built; valid are {', '.join(get_args(FmiVersion))}")
    plant = read_plant_file(folder / "plant.toml", size)
    files, compiled = _plant_files(folder, plant, fmi_version)
    library = f"binaries/{host().folder(fmi_version)}/{plant.name}{SUFFIX[host().system]}"
    key = digest({**files, "flags": " ".join(FLAGS).encode(), "platform": library.encode()})
    archive = cache() / "fmus" / key[:16] / f"{plant.name}.fmi{fmi_version[0]}.fmu"
    loop.build()  # so that steps are quick wherever plants are built
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
    if plant.source not in own:
        raise BuildError(f"{folder} has no {plant.source}, which must hold the equations of the plant {plant.name!r}")
    if INTEGRATOR in own:
        raise BuildError(f"{folder} may not hold a {INTEGRATOR}: the shared sources have a file of that name")
    resources = {}
    if (twin := folder / "twin.toml").exists():
        text = sized(twin.read_text(encoding="utf-8"), plant.size.value if plant.size else None)
        try:
            read_twin(text)
        except DescriptionError as problem:
            raise BuildError(f"{twin}: {problem}") from None
        resources["resources/twin.toml"] = text.encode()
    own[INTEGRATOR] = (SOURCES / INTEGRATOR).read_bytes()
    return fmu_files(plant, own, (plant.source, INTEGRATOR), fmi_version, resources)
