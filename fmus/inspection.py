"""What an FMU file holds and what would prevent a run of it here, found without loading any of its code."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fmus.archives import DAMAGED, TWIN, Fmu, host_platform, machines, open_archive
from fmus.descriptions import Description
from fmus.errors import ArchiveError, FmuError, LibraryError
from fmus.libraries import Library, read_libraries
from fmus.terminals import TERMINALS, Terminal, read_terminals
from fmus.variables import NUMBER_TYPES, REAL_TYPES, Variable

MOST_NAMED = 6  # variables that one finding names
LARGEST_TERMINALS = 2**24  # bytes
LARGEST_LIBRARY = 2**28  # bytes: larger ones are not looked into
INTERFACES = {"co_simulation": "InstantiateCoSimulation", "model_exchange": "InstantiateModelExchange"}


@dataclass(frozen=True, slots=True)
class Inspection:
    """An FMU with what is beside its description. `binaries` maps each platform's folder to the libraries in it.

    `obstacles` say what prevents any run on this machine, `notes` what a run can do only in part, or at a price.
    """

    fmu: Fmu
    host: str
    binaries: tuple[tuple[str, tuple[str, ...]], ...]
    sources: tuple[str, ...]
    terminals: tuple[Terminal, ...]
    obstacles: tuple[str, ...]
    notes: tuple[str, ...]


def inspect(path: Path | str) -> Inspection:
    """Look into an FMU; raises what `open_archive` raises, for FMI 1.0 and for scheduled execution only too."""
    fmu = open_archive(path)
    binaries: dict[str, list[str]] = {}
    sources: list[str] = []
    terminals: tuple[Terminal, ...] = ()
    try:
        with zipfile.ZipFile(fmu.path) as archive:
            damaged = dict(_damaged(archive))
            for name in archive.namelist():
                parts = PurePosixPath(name).parts
                if len(parts) == 3 and parts[0] == "binaries" and PurePosixPath(name).suffix in (".so", ".dll", ".dylib"):
                    binaries.setdefault(parts[1], []).append(parts[2])
                elif len(parts) > 1 and parts[0] == "sources" and not name.endswith("/"):
                    sources.append("/".join(parts[1:]))
            if TERMINALS in archive.namelist():
                if archive.getinfo(TERMINALS).file_size > LARGEST_TERMINALS:
                    raise ArchiveError(f"{fmu.path}: {TERMINALS} of {archive.getinfo(TERMINALS).file_size} bytes is too large")
                terminals = read_terminals(archive.read(TERMINALS))
            found = list(_libraries(fmu, archive, damaged))
    except (*DAMAGED, OSError) as problem:
        raise ArchiveError(f"{fmu.path} cannot be read: {problem}") from None
    unpacked = {name: why for name, why in damaged.items() if fmu.unpacks(name)}
    # The interface that a run uses unless the other one is asked for; each may have a library of its own.
    used = next((loaded[0] for loaded in map(fmu.binary, INTERFACES) if loaded is not None), "")
    return Inspection(
        fmu=fmu,
        host=host_platform(),
        binaries=tuple((folder, tuple(sorted(files))) for folder, files in sorted(binaries.items())),
        sources=tuple(sorted(sources)),
        terminals=terminals,
        obstacles=(
            *_obstacles(fmu, bool(sources)),
            *(f"{name} is damaged, so the archive cannot be unpacked: {why}" for name, why in unpacked.items()),
            *(words for name, words in found if name == used),
            *_twin_obstacles(fmu),
        ),
        notes=(
            *_notes(fmu),
            *(f"{name} is damaged; no run here unpacks it: {why}" for name, why in damaged.items() if name not in unpacked),
            *(words for name, words in found if name != used),
        ),
    )


def _damaged(archive: zipfile.ZipFile) -> Iterator[tuple[str, str]]:
    """The members whose content cannot be unpacked, or is not what was packed, each with what is wrong."""
    for info in archive.infolist():
        try:
            with archive.open(info) as member:
                while member.read(2**20):
                    pass
        except (*DAMAGED, OSError) as problem:
            yield info.filename, str(problem)


def _libraries(fmu: Fmu, archive: zipfile.ZipFile, damaged: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The libraries that will not load where they lie, or lack what every run calls: the member's name, and what is wrong with it."""
    names = archive.namelist()
    for name in names:
        path = PurePosixPath(name)
        if len(path.parts) != 3 or path.parts[0] != "binaries" or path.suffix not in (".so", ".dll", ".dylib") or name in damaged:
            continue
        if archive.getinfo(name).file_size > LARGEST_LIBRARY:
            continue
        try:
            there = read_libraries(archive.read(name))
        except LibraryError as problem:
            yield name, f"{name} is {problem}"
            continue
        wanted = machines(path.parts[1])
        fitting = [library for library in there if library.machine in wanted] if wanted else list(there)
        if not fitting:
            yield name, f"{name} is for {' and '.join(library.machine for library in there)}, not for {' or '.join(wanted)}"
        beside = {PurePosixPath(other).name for other in names if other.startswith(f"binaries/{path.parts[1]}/")}
        for library in fitting:
            # What it loads may bring the functions.
            if (lacks := _lacking(fmu, path.stem, library)) and not library.needs & beside:
                yield name, f"{name} exports no {', '.join(lacks)}"


def _lacking(fmu: Fmu, identifier: str, library: Library) -> list[str]:
    """The functions that create an instance and let it go, as far as the library exports none of that name."""
    has = fmu.description
    offered = [interface for interface in INTERFACES if getattr(has.capabilities, interface) == identifier]
    if library.exports is None or not offered:
        return []
    made = ["Instantiate"] if has.major == 2 else [INTERFACES[interface] for interface in offered]
    wanted = [f"fmi{has.major}{name}" for name in (*made, "EnterInitializationMode", "Terminate", "FreeInstance")]
    return [name for name in wanted if name not in library.exports]


def _twin_obstacles(fmu: Fmu) -> Iterator[str]:
    """What is wrong with the linear twin, which a study takes for the plant unless `plant.linearization` names a method."""
    if fmu.twin is None:
        return
    from fmus.twins import read_twin  # here: it brings the mathematics along

    has = fmu.description
    try:
        twin = read_twin(fmu.twin)
        has.drivable_input(twin.input)
        for name in (*twin.outputs, *twin.parameters):
            has.find(name)
    except FmuError as problem:
        yield f"a study cannot use its linear twin ({TWIN}) without plant.linearization: {problem}"


def _obstacles(fmu: Fmu, sources: bool) -> Iterator[str]:
    has = fmu.description
    offered = [interface for interface in INTERFACES if getattr(has.capabilities, interface)]
    if not any(map(fmu.binary, offered)):
        try:
            fmu.require_platform(offered[0])
        except FmuError as problem:
            steps = has.capabilities.co_simulation is not None
            yield f"{problem}{' (its sources are there, and could be compiled)' if sources and steps else ''}"
    if not any(v.type in REAL_TYPES and v.size for v in map(has.find, has.names("input"))):
        yield f"it has no real input that a command could drive; its inputs are: {_listed(has.names('input'))}"
    if not any(v.type in REAL_TYPES and v.size for v in map(has.find, has.names("output"))):
        yield f"it has no real output that could be moved; its outputs are: {_listed(has.names('output'))}"


def _notes(fmu: Fmu) -> Iterator[str]:
    has, can = fmu.description, fmu.description.capabilities
    offered = [interface for interface in INTERFACES if getattr(can, interface)]
    for interface in offered:
        if fmu.binary(interface) is None and any(map(fmu.binary, offered)):
            yield f"it has no binary for {interface.replace('_', ' ')} on this machine: simulation.interface has to name the other one"
    if can.needs_execution_tool:
        yield f"it needs the tool that made it ({has.tool or 'which it does not name'}) on this machine"
    if can.co_simulation and not can.variable_step:
        step = can.fixed_internal_step or has.default_step
        size = f", {step:g} s by its own account" if step else ""
        yield f"its communication steps must all have one size{size}: every jump of a command has to lie on a multiple of it"
    if can.co_simulation and can.fixed_internal_step and can.variable_step:
        yield f"its own solver takes fixed steps of {can.fixed_internal_step:g} s: what happens between them is rounded to them"
    if can.co_simulation and not (has.major == 2 and can.interpolates_inputs):
        yield "it takes no input derivatives: a slope or a tail of the input becomes a staircase, and its error is measured"
    if not can.model_exchange:
        yield "it has no model exchange, so it shows no derivatives: without a twin its linear plant has to be found from its response"
    elif not can.directional_derivatives:
        yield "it has no directional derivatives: without a twin its linear plant comes from differences"
    if can.model_exchange and not can.co_simulation:
        yield "it has model exchange only: it brings no solver"
    if not _offers(has, "canGetAndSetFMUstate"):
        yield "its state cannot be saved: a step that it discards cannot be tried again in smaller ones"
    if can.once_per_process:
        yield "it allows one instance in a process: every run gets a new one, which takes some 50 ms"
    yield from _variables(has)
    if any(name == "ScheduledExecution" for name, _ in has.interfaces):
        yield "it offers scheduled execution too, which is not used"
    yield "it brings a linear twin" if fmu.twin is not None else "it brings no linear twin (resources/twin.toml): it is linearised"


def _offers(has: Description, attribute: str) -> bool:
    # FMI 2.0 and 3.0 differ in one capital letter.
    return any(key.lower() == attribute.lower() and value in ("true", "1") for _, written in has.interfaces for key, value in written)


def _variables(has: Description) -> Iterator[str]:
    astray = list(filter(None, map(_astray, has.variables)))
    if astray:
        yield f"start values outside the FMU's own limits: {_listed(astray)}"
    deaf = [v.name for v in has.variables if v.causality == "input" and v.type not in NUMBER_TYPES]
    if deaf:
        yield f"inputs that are no numbers keep their start values: {_listed(deaf)}"
    clocks = [v.name for v in has.variables if v.type == "Clock"]
    if clocks:
        yield f"clocks are left alone: {_listed(clocks)}"
    structural = has.names("structuralParameter")
    if structural:
        yield f"sizes of arrays are set by structural parameters: {_listed(structural)}"


def _astray(v: Variable) -> str:
    """A start value beyond the variable's own minimum or maximum, in words; empty if there is none."""
    starts = v.starts or ((v.start,) if isinstance(v.start, float) and v.type in NUMBER_TYPES else ())
    for start in starts:
        if v.minimum is not None and start < v.minimum:
            return f"{v.name} = {start:g} (at least {v.minimum:g})"
        if v.maximum is not None and start > v.maximum:
            return f"{v.name} = {start:g} (at most {v.maximum:g})"
    return ""


def _listed(names: tuple[str, ...] | list[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "") or "none"
