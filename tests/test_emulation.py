"""Exported libraries for Windows, macOS and Linux on both processors, run in an emulator: all give the same signal.

This machine's own library runs without one in test_cross_compiling.py and test_exported_shapers.py.
"""

from __future__ import annotations

import importlib.util
import json
import re
import struct
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from independent_shaping import known_shapers

from fmus.blocks import model_name
from fmus.libraries import slices
from relaxations.commands import Command, Segment, Tail, TailTerm
from suite.cli import main

MISSING = [name for name in ("ziglang", "unicorn") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(bool(MISSING), reason=f"{' and '.join(MISSING)} not installed (make foreign installs both)"),
]
MOVE = Command(
    1.5,
    (Segment(0.0, 1.0), Segment(0.37, -0.5, 0.25), Segment(1.0, 0.125)),
    Tail(0.25, (TailTerm(-0.5 + 0j, 0, -0.2 + 0j), TailTerm(-0.3 + 2j, 1, 0.1 + 0.2j))),
)
SOURCES = {**{name: shaper.to_dict() for name, shaper in known_shapers().items()}, "move": MOVE.to_dict()}
STEP, STEPS = 0.03, 120
SUM_OF_ROUNDINGS = 1e-13  # exp, sin and cos of other C libraries differ in the last place


def fmi(number: int) -> int:
    """A status of FMI: the lower half of the register."""
    return number & 0xFFFF_FFFF


def played(library: bytes, version: str, xml: str) -> list[float]:
    """The output after each step."""
    from emulated import Emulated

    e, fmi2 = Emulated(library), version == "2"
    token = re.search(r'(?:guid|instantiationToken)="([^"]*)"', xml)
    references = {name: int(number) for name, number in re.findall(r'name="(\w+)" valueReference="(\d+)"', xml)}
    assert token is not None
    logger, key = e.import_address("logger"), token[1].encode()
    if fmi2:
        memory = struct.pack("<5Q", logger, e.import_address("calloc"), e.import_address("free"), 0, 0)
        instance = e.call("fmi2Instantiate", b"one", 1, key, b"file:///nowhere", e.store(memory), 0, 0)
        assert fmi(e.call("fmi2SetupExperiment", instance, 0, 0.0, 0.0, 0, 0.0)) == 0
        assert fmi(e.call("fmi2EnterInitializationMode", instance)) == 0
    else:
        instance = e.call("fmi3InstantiateCoSimulation", b"one", key, 0, 0, 0, 0, 0, 0, 0, 0, logger, 0)
        assert fmi(e.call("fmi3EnterInitializationMode", instance, 0, 0.0, 0.0, 0, 0.0)) == 0
    assert instance
    prefix = f"fmi{version}"
    assert fmi(e.call(f"{prefix}ExitInitializationMode", instance)) == 0
    box, flags, count = e.store(bytes(8)), [e.store(bytes(8)) for _ in range(4)], () if fmi2 else (1,)
    output = e.store(struct.pack("<I", references["shaped" if "reference" in references else "u"]))
    entry = e.store(struct.pack("<I", references["reference"])) if "reference" in references else None
    kind, values = "Real" if fmi2 else "Float64", []
    for n in range(STEPS):
        if entry is not None:
            e.cpu.mem_write(box, struct.pack("<d", n // 7 % 3 - 0.75 * (n > 60)))
            assert fmi(e.call(f"{prefix}Set{kind}", instance, entry, 1, box, *count)) == 0
        assert fmi(e.call(f"{prefix}DoStep", instance, n * STEP, STEP, 1, *(() if fmi2 else flags))) == 0
        assert fmi(e.call(f"{prefix}Get{kind}", instance, output, 1, box, *count)) == 0
        values.append(struct.unpack("<d", bytes(e.cpu.mem_read(box, 8)))[0])
    e.call(f"{prefix}Terminate", instance)
    e.call(f"{prefix}FreeInstance", instance)
    return values


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    for name, content in SOURCES.items():
        (folder / f"{model_name(name)}.json").write_text(json.dumps(content))
        done = CliRunner().invoke(main, ["fmus", "export", str(folder / f"{model_name(name)}.json"), "--out", str(folder)])
        assert done.exit_code == 0, done.output
    return folder


@pytest.mark.parametrize("version", ["2", "3"])
@pytest.mark.parametrize("name", SOURCES)
def test_every_platform_gives_the_same_signal(exported: Path, name: str, version: str) -> None:
    found: dict[str, list[float]] = {}
    with zipfile.ZipFile(exported / f"{model_name(name)}.fmi{version}.fmu") as archive:
        xml = archive.read("modelDescription.xml").decode()
        for member in archive.namelist():
            if member.startswith("binaries/") and not member.endswith("/"):
                content = archive.read(member)
                for i, library in enumerate(slices(content) if content[:4] == b"\xca\xfe\xba\xbe" else [content]):
                    found[f"{member}[{i}]"] = played(library, version, xml)
    assert len(found) == 5, "Linux and macOS on two processors each, Windows on one"
    first = next(iter(found.values()))
    assert len(set(first)) > 4, "the signal changes"
    exact = name != "move" and not SOURCES[name].get("terms")
    for member, values in found.items():
        assert values == (first if exact else pytest.approx(first, abs=SUM_OF_ROUNDINGS)), member
