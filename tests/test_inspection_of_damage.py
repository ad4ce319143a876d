"""What `fmus inspect` sees of an FMU that is damaged or not what it says, where a run fails indeed; of a healthy one it sees nothing."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from marks import first
from test_archives import pack

from fmus.archives import host_platform, machines
from fmus.build import build
from fmus.errors import FmuError, LibraryError
from fmus.inspection import inspect
from fmus.libraries import read_libraries, read_library
from fmus.stepping import Experiment, RunStatus
from fmus.workers import simulate
from relaxations.commands import Command, Tail
from suite.cli import main

Files = dict[str, bytes]


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def healthy(request: pytest.FixtureRequest) -> Files:
    with zipfile.ZipFile(build("two_mass", request.param)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def binary(files: Files) -> str:
    (name,) = [name for name in files if name.startswith("binaries/") and not name.endswith("/")]
    return name


def runs(path: Path) -> bool:
    """Whether a run of it ends well."""
    command = Command(0.0, (), Tail(0.0))
    try:
        return simulate(Experiment(path, "force", ("position_2",), {}, 0.0, {}, command, 0.1, 0.1)).status is RunStatus.FINISHED
    except FmuError:
        return False


def other_machine(library: bytes) -> bytes:
    """The same, for the other kind of processor by its header."""
    assert library[:4] == b"\x7fELF"
    return library[:18] + struct.pack("<H", 62 if library[18] == 183 else 183) + library[20:]


def other_functions(library: bytes) -> bytes:
    """The same, without those that every run begins with."""
    return library.replace(b"\0fmi2Instantiate\0", b"\0fmi2Instantiat_\0").replace(b"\0fmi3InstantiateCo", b"\0fmi3Instantiat_Co")


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0"
WRONG: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "text": (lambda b: LFS, "is text, not a shared library: it begins with 'version https://git-lfs"),
    "bytes": (lambda b: bytes(range(128, 255)), "is no shared library of Linux, Windows or macOS: it begins with the bytes 80 81 82"),
    "empty": (lambda b: b"", "is an empty file"),
    "cut": (lambda b: b[: len(b) // 2], "is a shared library that is damaged or cut off"),
    "program": (lambda b: b[:16] + struct.pack("<H", 1) + b[18:], "is no shared library but an object file"),
    "processor": (other_machine, f"-linux, not for {host_platform()}"),
    "functions": (other_functions, "exports no fmi"),
}


@pytest.mark.parametrize("name", first(6, WRONG))
def test_a_library_that_will_not_load_prevents_a_run(healthy: Files, name: str, tmp_path: Path) -> None:
    change, words = WRONG[name]
    member = binary(healthy)
    path = pack(tmp_path / "a.fmu", {**healthy, member: change(healthy[member])})
    (obstacle,) = inspect(path).obstacles
    assert obstacle.startswith(f"{member} ")
    assert words in obstacle
    assert not runs(path), "what is said to prevent a run does"
    done = CliRunner().invoke(main, ["fmus", "inspect", str(path)], catch_exceptions=False)
    assert done.exit_code == 1


def test_a_healthy_one_has_no_obstacle_and_runs(healthy: Files, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", healthy)
    assert inspect(path).obstacles == ()
    assert runs(path)


def test_libraries_for_other_machines_are_looked_at_too(healthy: Files, tmp_path: Path) -> None:
    member = binary(healthy)
    other = {"binaries/win64/two_mass.dll": b"MZ no", "binaries/darwin64/two_mass.dylib": healthy[member]}
    found = inspect(pack(tmp_path / "a.fmu", {**healthy, **other}))
    assert found.obstacles == ()
    notes = "\n".join(found.notes)
    assert "binaries/win64/two_mass.dll is a shared library that is damaged or cut off" in notes
    assert f"binaries/darwin64/two_mass.dylib is for {host_platform()}, not for x86_64-darwin or aarch64-darwin" in notes


@pytest.mark.parametrize("gone", ["CoSimulation", "ModelExchange"])
def test_one_interface_is_enough(healthy: Files, gone: str, tmp_path: Path) -> None:
    text = healthy["modelDescription.xml"].decode()
    changed = re.sub(rf"(?s)<{gone}\b[^>]*?(/>|>.*?</{gone}>)", "", text)
    assert changed != text
    path = pack(tmp_path / "a.fmu", {**healthy, "modelDescription.xml": changed.encode()})
    assert inspect(path).obstacles == ()
    assert runs(path)


@pytest.mark.parametrize(("named", "prevents"), [("CoSimulation", True), ("ModelExchange", False)])
def test_what_is_wrong_with_the_other_interface_is_a_note(healthy: Files, named: str, prevents: bool, tmp_path: Path) -> None:
    """Each interface has a library of its own; one of them is text."""
    before, tag, rest = healthy["modelDescription.xml"].decode().partition(f"<{named}")
    text = before + tag + rest.replace('modelIdentifier="two_mass"', 'modelIdentifier="other"', 1)
    member = binary(healthy)
    files = {**healthy, "modelDescription.xml": text.encode(), member.replace("two_mass", "other"): b"no library"}
    path = pack(tmp_path / "a.fmu", files)
    found = inspect(path)
    told = found.obstacles if prevents else found.notes
    assert any("other.so is text" in line for line in told)
    assert bool(found.obstacles) is prevents
    assert runs(path) is not prevents
    del files[member.replace("two_mass", "other")]
    found = inspect(pack(path, files))
    interface = "co simulation" if prevents else "model exchange"
    assert any(line.startswith(f"it has no binary for {interface} on this machine") for line in found.notes)


def test_control_characters_of_an_fmu_do_not_reach_the_terminal(healthy: Files, tmp_path: Path) -> None:
    text = re.sub('modelName="[^"]*"', 'modelName="two&#x9b;31m&#x202e;[red]mass"', healthy["modelDescription.xml"].decode())
    path = pack(tmp_path / "a.fmu", {**healthy, "modelDescription.xml": text.encode()})
    done = CliRunner().invoke(main, ["fmus", "inspect", str(path)], catch_exceptions=False)
    assert "two\ufffd31m\ufffd[red]mass" in done.stdout
    done = CliRunner().invoke(main, ["linearize", str(path), "--input", "x", "--output", "y"], catch_exceptions=False)
    assert "\ufffd31m" in done.stderr
    assert "\x9b" not in done.output


def damage(path: Path, member: str) -> None:
    """Change a byte in the middle of a member's packed content."""
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo(member)
    content = bytearray(path.read_bytes())
    content[info.header_offset + 30 + len(member) + info.compress_size // 2] ^= 0xFF
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("member", "prevents"),
    [("resources/table.csv", True), ("extra/more.txt", True), ("sources/more.c", False), ("documentation/index.html", False)],
)
def test_a_damaged_member_is_named_and_prevents_a_run_that_unpacks_it(healthy: Files, member: str, prevents: bool, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {**healthy, member: bytes(range(256)) * 40})
    assert inspect(path).obstacles == ()
    damage(path, member)
    found = inspect(path)
    told = found.obstacles if prevents else found.notes
    assert [line for line in told if line.startswith(f"{member} is damaged")]
    assert bool(found.obstacles) is prevents
    assert runs(path) is not prevents


def test_a_damaged_library_is_refused(healthy: Files, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", healthy)
    damage(path, binary(healthy))
    done = CliRunner().invoke(main, ["fmus", "inspect", str(path)], catch_exceptions=False)
    assert done.exit_code == 2
    assert "is no intact FMU" in done.stderr
    assert not runs(path)


@pytest.mark.parametrize(
    ("twin", "words"),
    [
        (b"A = [", "the linear twin is no TOML"),
        (b'input = "force"\nstates = ["x"]\nA = [[1]]\n', "B must be a list of 1 entries"),
        (b'input = "torque"\nstates = ["x"]\nA = [[1]]\nB = [1]\n', "no variable 'torque'"),
        (b'input = "force"\nstates = ["x"]\nA = [[1]]\nB = [1]\n[outputs.nowhere]\nC = [1]\nD = 0\n', "no variable 'nowhere'"),
        (b'input = "force"\nstates = ["x"]\nB = [1]\nA = [["' + b"(" * 20 + b"9" + b"**16)" * 20 + b'"]]\n', "of more than 65536 bits"),
    ],
)
def test_a_twin_that_cannot_be_used_prevents_a_study(healthy: Files, twin: bytes, words: str, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {**healthy, "resources/twin.toml": twin})
    (obstacle,) = inspect(path).obstacles
    assert obstacle.startswith("a study cannot use its linear twin (resources/twin.toml) without plant.linearization: ")
    assert words in obstacle


def test_folders_name_machines() -> None:
    assert machines("x86_64-linux") == ("x86_64-linux",)
    assert machines("win32") == ("x86-windows",)
    assert machines("darwin64") == ("x86_64-darwin", "aarch64-darwin")
    assert machines("vxworks") == machines("sparc-solaris") == ()


def test_a_library_with_any_change_is_read_or_refused(healthy: Files) -> None:
    """No other error, whatever the bytes: each of the header's, and of every hundredth of the rest, set to three values."""
    content = healthy[binary(healthy)]
    assert read_library(content).machine == host_platform()
    for place in [*range(64), *range(64, len(content), 97)]:
        for value in (0, 0x7F, 0xFF):
            try:
                read_libraries(content[:place] + bytes([value]) + content[place + 1 :])
            except LibraryError:
                continue


@pytest.mark.parametrize("head", [b"MZ", b"\x7fELF", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xce\xfa\xed\xfe"])
def test_what_only_begins_like_a_library_is_refused(head: bytes) -> None:
    for rest in (b"", b"\xff" * 100, bytes(100), b"\1" * 500):
        with pytest.raises(LibraryError):
            read_libraries(head + rest)
