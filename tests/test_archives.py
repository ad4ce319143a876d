from __future__ import annotations

import hashlib
import os
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import archives
from fmus.archives import Fmu, host_platform, open_archive
from fmus.build import build
from fmus.descriptions import read_description
from fmus.errors import ArchiveError, DescriptionError, FmuError, PlatformError

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="cart" instantiationToken="{{1}}">
  <CoSimulation modelIdentifier="{identifier}"/>
  <UnitDefinitions><Unit name="kg"><BaseUnit kg="1"/></Unit></UnitDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="force" valueReference="1" causality="input" start="0"/>
    <Float64 name="position" valueReference="2" causality="output"/>
    <Float64 name="mass" valueReference="3" causality="parameter" variability="tunable" start="2.5" unit="kg"/>
    <String name="label" valueReference="4" causality="parameter" variability="fixed"><Start value="x"/></String>
    <Float64 name="profile" valueReference="5" causality="output"><Dimension start="3"/></Float64>
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/><Output valueReference="5"/></ModelStructure>
</fmiModelDescription>"""


def description(identifier: str = "cart") -> bytes:
    return DESCRIPTION.format(identifier=identifier).encode()


def pack(path: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name)
            info.filename = name  # the constructor would make an unsafe name safe
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return path


@pytest.fixture(scope="session", params=["2.0", "3.0"])
def two_mass(request: pytest.FixtureRequest) -> Fmu:
    return open_archive(build("two_mass", request.param))


def test_reads_what_a_shipped_fmu_says_about_itself(two_mass: Fmu) -> None:
    d = two_mass.description
    assert d.major in (2, 3)
    assert two_mass.sha256 == hashlib.sha256(two_mass.path.read_bytes()).hexdigest()
    with zipfile.ZipFile(two_mass.path) as archive:
        member = two_mass.require_platform()
        assert two_mass.binary_sha256("co_simulation") == hashlib.sha256(archive.read(member)).hexdigest()
        assert two_mass.twin is not None
        assert two_mass.twin.encode() == archive.read("resources/twin.toml")
    assert two_mass.require_platform("model_exchange") == member
    assert [state for state, _ in d.states] == ["position_1", "velocity_1", "position_2", "velocity_2"]
    assert [d.find(rate).derivative_of for _, rate in d.states] == [state for state, _ in d.states]
    stiffness = d.settable_parameter("stiffness")
    assert (stiffness.unit, stiffness.start, stiffness.causality) == ("N/m", 1.0, "parameter")
    assert next(u.exponents for u in d.units if u.name == "N/m") == (("kg", 1), ("s", -2))
    assert d.capabilities.variable_step
    assert d.capabilities.directional_derivatives, "the FMI 3.0 attribute has a plural s"


def test_unpacks_what_a_run_needs_and_nothing_else(two_mass: Fmu, tmp_path: Path) -> None:
    two_mass.extract(tmp_path)
    assert (tmp_path / two_mass.require_platform()).is_file()
    assert (tmp_path / "resources" / "twin.toml").is_file()
    assert not (tmp_path / "sources").exists()


def test_refuses_to_unpack_another_file_than_it_opened(tmp_path: Path) -> None:
    fmu = open_archive(pack(tmp_path / "a.fmu", {"modelDescription.xml": description()}))
    pack(fmu.path, {"modelDescription.xml": description(), "resources/more": b""})
    with pytest.raises(ArchiveError, match="changed since"):
        fmu.extract(tmp_path / "out")


@pytest.mark.parametrize(
    "name",
    ["/etc/evil", "../evil", "resources/../../evil", "resources/./x", "resources\\..\\..\\evil", "C:/evil", "resources//evil", "~/x\0y"],
)
def test_refuses_names_that_lead_outside(name: str, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), name: b"x"})
    with pytest.raises(ArchiveError, match="outside"):
        open_archive(path)


@pytest.mark.parametrize(
    "name",
    ["resources/" + "x/" * 2500 + "y", "resources/" + "x" * 5000, "resources/" + "ä" * 128, "/".join(["x" * 250] * 9), "/".join("x" * 101)],
)
def test_refuses_names_that_no_file_system_takes(name: str, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), name: b"x"})
    with pytest.raises(ArchiveError, match="too long or too deep to be unpacked"):
        open_archive(path)


@pytest.mark.parametrize("name", ["resources/" + "x/" * 98 + "y", "resources/" + "x" * 255, "resources/" + "/".join(["x" * 250] * 8)])
def test_takes_names_up_to_that(name: str, tmp_path: Path) -> None:
    open_archive(pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), name: b"x"})).extract(tmp_path / "out")
    assert (tmp_path / "out" / name).read_bytes() == b"x"


def test_refuses_symbolic_links(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description()})
    link = zipfile.ZipInfo("resources/link")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(ArchiveError, match="symbolic link"):
        open_archive(path)


def test_refuses_a_name_that_is_there_twice(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description()})
    with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
        warnings.simplefilter("ignore")  # that it is a duplicate is the point
        archive.writestr("modelDescription.xml", description("other"))
    with pytest.raises(ArchiveError, match="twice"):
        open_archive(path)


def test_refuses_a_zip_bomb(tmp_path: Path) -> None:
    files = {"modelDescription.xml": description(), "resources/zeros": bytes(archives.RATIO_FREE + 1)}
    with pytest.raises(ArchiveError, match="bomb"):
        open_archive(pack(tmp_path / "a.fmu", files))


def test_refuses_what_unpacks_to_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description()})
    open_archive(path)
    monkeypatch.setattr(archives, "MAX_TOTAL", len(description()) - 1)
    with pytest.raises(ArchiveError, match="at most"):
        open_archive(path)


@pytest.mark.parametrize(("limit", "member"), [("MAX_DESCRIPTION", "modelDescription.xml"), ("MAX_TWIN", archives.TWIN)])
def test_refuses_single_files_that_are_too_large(limit: str, member: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), archives.TWIN: bytes(5000)})
    monkeypatch.setattr(archives, limit, 100)
    with pytest.raises(ArchiveError, match=f"{member} of [0-9]+ bytes is too large"):
        open_archive(path)


@pytest.mark.parametrize("identifier", ["../../../../evil/x", "a/b", "a b", "1a", "a.b", "ä"])
def test_refuses_an_identifier_that_could_name_another_binary(identifier: str, tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description(identifier)})
    with pytest.raises(FmuError, match="modelIdentifier"):
        open_archive(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_refuses_a_doctype_in_any_encoding(encoding: str, tmp_path: Path) -> None:
    bomb = '<!DOCTYPE fmiModelDescription [<!ENTITY a "aaaa">]>\n<fmiModelDescription'
    text = description().decode().replace("<fmiModelDescription", bomb, 1).replace("UTF-8", encoding)
    with pytest.raises(DescriptionError, match="DOCTYPE"):
        open_archive(pack(tmp_path / "a.fmu", {"modelDescription.xml": text.encode(encoding)}))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('fmiVersion="3.0"', 'fmiVersion="1.0"', "FMI version 1.0 is not supported"),
        ('fmiVersion="3.0"', "", "FMI version missing"),
        ('fmiVersion="3.0"', 'fmiVersion="3.0-beta.2"', "FMI version 3.0-beta.2, a preliminary version of the standard, is not supported"),
        ('fmiVersion="3.0"', 'fmiVersion="3.x"', "FMI version 3.x"),
        ('<Dimension start="3"/>', '<Dimension start="100000000000"/>', "would have 100000000000 elements; at most 1000000 are supported"),
        ('<Dimension start="3"/>', '<Dimension start="1000"/>' * 300, "would have 1000 × .* × … elements"),
        ("<CoSimulation", "<ScheduledExecution", "scheduled execution only"),
        ("</fmiModelDescription>", "", "well-formed"),
        ('valueReference="1"', 'valueReference="x"', "not valid"),
        ('causality="output"/>', 'causality="parameter" variability="continuous"/>', "cannot be used"),
    ],
)
def test_refuses_descriptions_that_it_cannot_honour(old: str, new: str, words: str) -> None:
    with pytest.raises(DescriptionError, match=words):
        read_description(description().replace(old.encode(), new.encode()))


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 cut"])
def test_says_that_a_file_is_no_fmu(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match=r"a\.fmu is no intact FMU"):
        open_archive(path)


def test_a_pipe_or_a_device_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.fmu")
    for path in (tmp_path / "pipe.fmu", Path("/dev/zero")):
        with pytest.raises(ArchiveError, match="is no file but a pipe, socket or device"):
            open_archive(path)


def test_says_what_an_archive_lacks(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="holds no modelDescription"):
        open_archive(pack(tmp_path / "a.fmu", {"readme.txt": b""}))
    with pytest.raises(ArchiveError, match="cannot be read"):
        open_archive(tmp_path / "missing.fmu")


def test_names_the_platforms_that_it_has(tmp_path: Path) -> None:
    files = {"modelDescription.xml": description(), "binaries/sparc-solaris/cart.so": b"", "binaries/win32/cart.dll": b""}
    fmu = open_archive(pack(tmp_path / "a.fmu", files))
    with pytest.raises(PlatformError, match=f"{host_platform()}.*sparc-solaris, win32"):
        fmu.require_platform()
    with pytest.raises(DescriptionError, match="Co-Simulation only; Model Exchange is needed"):
        fmu.require_platform("model_exchange")


def test_names_the_nearest_variables_and_the_wrong_causality() -> None:
    d = read_description(description())
    assert d.find("mass", "parameter").start == 2.5
    with pytest.raises(DescriptionError, match="no variable 'positon'; did you mean 'position'"):
        d.find("positon", "output")
    with pytest.raises(DescriptionError, match="'mass' of cart has causality parameter, not input; its inputs are: force"):
        d.drivable_input("mass")
    with pytest.raises(DescriptionError, match="String"):
        d.settable_parameter("label")
    with pytest.raises(DescriptionError, match=r"Float64\[3\]"):
        d.readable("profile")
    with pytest.raises(DescriptionError, match="no start value"):
        d.settable_state("position")


def test_reads_a_nominal_of_zero_as_one() -> None:
    changed = description().replace(b'name="position"', b'name="position" nominal="0"').replace(b'start="2.5"', b'start="2.5" nominal="-3"')
    d = read_description(changed)
    assert (d.find("position").nominal, d.find("mass").nominal) == (1.0, 3.0)


@pytest.fixture(scope="module")
def original() -> bytes:
    return build("two_mass", "3.0").read_bytes()


def test_refuses_a_name_that_is_a_file_and_a_folder(tmp_path: Path) -> None:
    for name in ("resources", "binaries/x/y"):
        path = pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), f"{name}/more": b"", name: b""})
        with pytest.raises(ArchiveError, match=f"holds '{name}' as a file and as a folder"):
            open_archive(path)
    open_archive(pack(tmp_path / "a.fmu", {"modelDescription.xml": description(), "resources/": b"", "resources/more": b""}))


@given(data=st.data())
def test_a_damaged_file_never_raises_anything_else(data: st.DataObject, original: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    content = bytearray(original)
    # The directory at the end decides how the archive is read: damage there is the most instructive.
    for _ in range(data.draw(st.integers(1, 4))):
        position = len(content) - 1 - data.draw(st.integers(0, min(len(content) - 1, 3000)))
        content[position] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.fmu"
    path.write_bytes(content)
    try:
        fmu = open_archive(path)
    except FmuError:
        return
    assert fmu.description.model_name


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_damaged_contents_are_named_and_no_traceback(method: int, tmp_path: Path) -> None:
    path = tmp_path / "damaged.fmu"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("modelDescription.xml", b"<fmiModelDescription/>" * 200)
    with zipfile.ZipFile(path) as archive:
        begin = archive.getinfo("modelDescription.xml").header_offset + 30 + len("modelDescription.xml")
        size = archive.getinfo("modelDescription.xml").compress_size
    intact = path.read_bytes()
    for place in range(begin, begin + size):
        path.write_bytes(intact[:place] + bytes([intact[place] ^ 0xFF]) + intact[place + 1 :])
        with pytest.raises((ArchiveError, DescriptionError)):
            open_archive(path)


def test_the_elements_of_all_arrays_are_limited_too() -> None:
    more = "".join(
        f'<Float64 name="a{i}" valueReference="{10 + i}" causality="local" initial="exact" start="1"><Dimension start="1000000"/></Float64>'
        for i in range(5)
    )
    with pytest.raises(DescriptionError, match="its arrays have 5000003 elements in all; at most 4000000 are supported"):
        read_description(description().replace(b"</ModelVariables>", more.encode() + b"</ModelVariables>"))


def test_an_empty_array_is_none_of_these() -> None:
    text = description().replace(b'<Dimension start="3"/>', b'<Dimension start="100000000000"/><Dimension start="0"/>')
    assert read_description(text).find("profile").size == 0
