"""Writing a command or a shaper as an FMU: sources, descriptions, and a library for every platform that can be compiled for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fmus.blocks import Block
from fmus.build import SOURCES, fmu_files, source_texts
from fmus.compiling import PLATFORMS, FmiVersion, Target, compile_for, has_zig, host
from fmus.errors import BuildError
from fmus.packing import zipped


@dataclass(frozen=True, slots=True)
class Exported:
    """An FMU's archive, and which libraries are in it."""

    content: bytes
    fmi_version: FmiVersion
    platforms: tuple[str, ...]


def export(block: Block, fmi_version: FmiVersion, targets: Sequence[Target]) -> Exported:
    """The FMU of a command or shaper. The same block, targets and compiler give the same bytes.

    Raises `BuildError`: no compiler, a target that it cannot compile for, or its own words.
    """
    own = {name: (SOURCES / name).read_bytes() for name in (block.main, *block.headers)}
    own["constants.h"] = block.constants.encode()
    files, compiled = fmu_files(block.plant, own, (block.main,), fmi_version, {})
    libraries = compile_for(targets, block.plant.name, compiled, source_texts(files), fmi_version)
    platforms = tuple(dict.fromkeys(path.split("/")[1] for path in libraries))
    return Exported(zipped({**files, **libraries}), fmi_version, platforms)


def targets(names: Sequence[str] = ()) -> tuple[Target, ...]:
    """What to compile for: the platforms of these names ("all": every one), by default all that can be compiled for here.

    Raises `BuildError` for a name that is none.
    """
    if wrong := [name for name in names if name != "all" and name not in PLATFORMS]:
        raise BuildError(f"no such platform: {', '.join(wrong)}; there are {', '.join(PLATFORMS)}, all")
    if not names and not has_zig():
        return (host(),)
    chosen = PLATFORMS if not names or "all" in names else dict.fromkeys(names)
    # A platform of two processors means the one of this machine, where nothing compiles for the other.
    own = {name: tuple(t for t in PLATFORMS[name] if t == host()) for name in chosen if not has_zig() and "all" not in names}
    return tuple(target for name in chosen for target in own.get(name) or PLATFORMS[name])
