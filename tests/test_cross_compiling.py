"""Libraries for every platform from one machine, with ziglang: what they are for, export and need, and that the same comes out each time.

They are read here; tests/test_emulation.py runs them.
"""

from __future__ import annotations

import importlib.util
import json
import re
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from exported import drive
from fmpy import __file__ as fmpy_file
from fmpy.validation import validate_fmu
from independent_shaping import known_shapers
from raw_fmus import RawFmu

from fmus import compiling
from fmus.compiling import PLATFORMS, Target, host
from fmus.libraries import read_library, slices
from suite.cli import main

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed (make foreign installs it)"),
]
HEADERS = Path(fmpy_file).parent / "c-code"
# All that is allowed: the system's own libraries, which every such machine has.
SYSTEM = re.compile(
    r"lib[cm]\.so\.6|ld-linux-[a-z0-9_-]+\.so\.[12]|KERNEL32\.dll|ntdll\.dll|api-ms-win-crt-.*\.dll|/usr/lib/libSystem\.B\.dylib"
)

LINKERS_OWN = {"_fini", "_init", "__dso_handle", "_mh_dylib_header"}


def functions(version: str) -> set[str]:
    """Every function of the standard, from its own header."""
    text = (HEADERS / f"fmi{version[0]}Functions.h").read_text()
    return set(re.findall(rf"#define (fmi{version[0]}[A-Z]\w+)\s+fmi{version[0]}FullName", text))


def highest_glibc(content: bytes) -> tuple[int, ...]:
    """The newest version of GNU's C library that it asks for."""
    return max(tuple(int(n) for n in version.split(b".")) for version in re.findall(rb"GLIBC_([0-9.]+)", content))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A shaper with a filter, in both versions, for all platforms; warnings are errors of clang, too."""
    folder = tmp_path_factory.mktemp("exported")
    (folder / "shaper.json").write_text(json.dumps(known_shapers()["pole-zero"].to_dict()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            compiling, "FLAGS", (*compiling.FLAGS, "-Werror", "-pedantic", "-Wno-strict-prototypes")
        )  # the standard's header has such
        for name in ("one", "other"):
            done = CliRunner().invoke(main, ["fmus", "export", str(folder / "shaper.json"), "--out", str(folder / name), "--json"])
            assert done.exit_code == 0, done.output
            assert json.loads(done.stdout)["note"] is None
    return {f"{version}.0": folder / "one" / f"shaper.fmi{version}.fmu" for version in "23"}


def libraries(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name.startswith("binaries/")}


def test_the_same_bytes_each_time(exported: dict[str, Path]) -> None:
    for path in exported.values():
        assert path.read_bytes() == (path.parents[1] / "other" / path.name).read_bytes()


def test_fmi_3_has_a_folder_for_each_platform(exported: dict[str, Path]) -> None:
    assert validate_fmu(str(exported["3.0"])) == []
    found = libraries(exported["3.0"])
    assert {name.split("/")[1] for name in found} == {f"{t.machine}-{t.system}" for targets in PLATFORMS.values() for t in targets}
    for name, content in found.items():
        assert read_library(content).machine == name.split("/")[1]
        assert name.endswith({"linux": ".so", "windows": ".dll", "darwin": ".dylib"}[name.split("/")[1].split("-")[1]])


def test_fmi_2_has_the_folders_of_its_time(exported: dict[str, Path]) -> None:
    assert validate_fmu(str(exported["2.0"])) == []
    found = libraries(exported["2.0"])
    names = ["aarch64-linux/shaper.so", "darwin64/shaper.dylib", "linux64/shaper.so", "win64/shaper.dll"]
    assert sorted(found) == [f"binaries/{name}" for name in names]
    assert read_library(found["binaries/linux64/shaper.so"]).machine == "x86_64-linux"
    assert read_library(found["binaries/win64/shaper.dll"]).machine == "x86_64-windows"
    macs = [read_library(part).machine for part in slices(found["binaries/darwin64/shaper.dylib"])]
    assert macs == ["x86_64-darwin", "aarch64-darwin"]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_every_library_exports_the_standard_and_needs_nothing_but_the_system(exported: dict[str, Path], version: str) -> None:
    expected = functions(version)
    assert len(expected) > 30
    for name, content in libraries(exported[version]).items():
        for part in slices(content) if name.endswith("darwin64/shaper.dylib") else [content]:
            library = read_library(part)
            assert library.exports is not None
            assert expected - library.exports == set(), name
            assert {other for other in library.exports if not other.startswith(f"fmi{version[0]}")} <= LINKERS_OWN, name
            assert [need for need in library.needs if not SYSTEM.fullmatch(need)] == [], name
            assert library.signed or library.machine != "aarch64-darwin", "a Mac of this kind runs nothing that is not signed"
            if name.endswith(".so"):
                assert highest_glibc(part) <= (2, 17), name


def test_nothing_of_this_machine_is_in_the_libraries(exported: dict[str, Path]) -> None:
    for path in exported.values():
        for name, content in libraries(path).items():
            assert [
                place for place in (str(Path.home()), str(Path(__file__).parents[1]), "slewcert-build") if place.encode() in content
            ] == [], name


def test_this_machines_does_what_its_own_compilers_does(exported: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmus.compiling.has_zig", lambda: False)
    monkeypatch.setattr("fmus.exporting.has_zig", lambda: False)
    source = exported["2.0"].parents[1] / "shaper.json"
    done = CliRunner().invoke(main, ["fmus", "export", str(source), "--fmi", "2", "--out", str(tmp_path / "own.fmu")])
    assert done.exit_code == 0, done.output
    times, values = [0.01 * n for n in range(1000)], [float(n // 70 % 3) for n in range(1000)]
    outputs = []
    for index, path in enumerate((exported["2.0"], tmp_path / "own.fmu")):
        with RawFmu(path, tmp_path / str(index)) as fmu:
            fmu.initialize()
            outputs.append(drive(fmu, times, values))
    assert outputs[0] == pytest.approx(outputs[1], abs=1e-14)  # exp and cos of two C libraries


def test_one_platform_can_be_chosen(tmp_path: Path) -> None:
    (tmp_path / "zv.json").write_text(json.dumps(known_shapers()["zv"].to_dict()))
    done = CliRunner().invoke(
        main, ["fmus", "export", str(tmp_path / "zv.json"), "--fmi", "3", "--platform", "win64", "--out", str(tmp_path / "x.fmu")]
    )
    assert done.exit_code == 0, done.output
    assert list(libraries(tmp_path / "x.fmu")) == ["binaries/x86_64-windows/zv.dll"]
    assert host() != Target("windows", "x86_64"), "else this tests no other platform"
