"""Building FMUs: the same bytes each time, the right compiler, and messages that help."""

from __future__ import annotations

import importlib
import importlib.util
import shlex
import shutil
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fault_plants import FAULTS, build_fault
from fmpy.validation import validate_fmu
from marks import first

from fmus import compiling
from fmus.build import PLANTS, build, build_folder, is_shipped, locate, shipped
from fmus.compiling import FmiVersion, compiler
from fmus.errors import BuildError

VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("SLEWCERT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the plant `two_mass`, to be changed."""
    return Path(shutil.copytree(PLANTS / "two_mass", tmp_path / "plant"))


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def no_compiler() -> list[str]:
    raise AssertionError("nothing is to be compiled here")


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", shipped())
def test_shipped_plants_pass_validation(name: str, version: FmiVersion) -> None:
    assert validate_fmu(str(build(name, version))) == []


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("fault", FAULTS)
def test_fault_plants_pass_validation(fault: str, version: FmiVersion) -> None:
    """Their faults are of the kind that no look at the archive can find."""
    assert validate_fmu(str(build_fault(fault, version))) == []


@pytest.mark.parametrize("name", shipped())
def test_shipped_plants_are_complete(name: str) -> None:
    files = {path.name for path in (PLANTS / name).iterdir()}
    assert {f"{name}.c", "plant.toml", "twin.toml", "README.md", "reference.csv"} <= files


@pytest.mark.parametrize("version", first(1, VERSIONS))
def test_the_same_sources_give_the_same_bytes(cache: Path, version: FmiVersion) -> None:
    first = build("two_mass", version)
    content = first.read_bytes()
    shutil.rmtree(cache)
    again = build("two_mass", version)
    assert again == first
    assert again.read_bytes() == content


@pytest.mark.parametrize("version", VERSIONS)
def test_nothing_of_this_machine_is_in_the_archive(version: FmiVersion) -> None:
    places = [str(Path.home()), str(Path(__file__).parents[1]), tempfile.gettempdir()]
    with zipfile.ZipFile(build("two_mass", version)) as archive:
        for name in archive.namelist():
            content = archive.read(name)
            assert [place for place in places if place.encode() in content] == [], name


def test_an_archive_is_built_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = build("two_mass")
    monkeypatch.setattr(compiling, "compiler", no_compiler)
    assert build("two_mass") == first == locate("two_mass") == locate("two_mass.fmi3")
    kept = sorted(path.suffix for path in cache.rglob("*") if path.is_file())
    assert kept == [".fmu", ".so"], "the plant and the stepping loop: no half-written file stays behind"


def test_a_changed_source_is_another_archive_with_another_token(cache: Path, folder: Path) -> None:
    before = build_folder(folder)
    change(folder / "two_mass.c", "p->force + pull", "p->force - 0.1 * p->velocity_1 + pull")
    after = build_folder(folder)
    assert before != after

    def token(path: Path) -> str:
        with zipfile.ZipFile(path) as archive:
            return ElementTree.fromstring(archive.read("modelDescription.xml")).attrib["instantiationToken"]

    assert token(before) != token(after)


def test_out_is_a_file_or_a_folder(tmp_path: Path) -> None:
    assert build("two_mass", "2.0", out=tmp_path / "new") == tmp_path / "new" / "two_mass.fmi2.fmu"
    assert build("two_mass", "3.0", out=tmp_path / "plant.fmu").read_bytes() == build("two_mass").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "plant.fmu"]


def test_the_archive_holds_twin_and_sources() -> None:
    for version in VERSIONS:
        with zipfile.ZipFile(build("two_mass", version)) as archive:
            names = set(archive.namelist())
            assert archive.read("resources/twin.toml") == (PLANTS / "two_mass" / "twin.toml").read_bytes()
            assert {"sources/two_mass.c", "sources/variables.h", f"sources/fmi{version[0]}.c"} <= names
            assert len([name for name in names if name.startswith("binaries/")]) == 1


def test_the_build_description_meets_its_schema() -> None:
    etree = importlib.import_module("lxml.etree")  # FMPy's own validator; it has no types
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"))
    with zipfile.ZipFile(build("two_mass")) as archive:
        description = etree.fromstring(archive.read("sources/buildDescription.xml"))
        schema.assertValid(description)
        listed = [f"sources/{file.attrib['name']}" for file in description.iter("SourceFile")]
        assert set(listed) <= set(archive.namelist())


# -- arrays ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_the_name_chooses_the_size(version: FmiVersion) -> None:
    path = locate(f"chain_4.fmi{version[0]}")
    with zipfile.ZipFile(path) as archive:
        assert archive.read("resources/twin.toml").startswith(b"size = 4\n")
        assert b"double position[4]; /* m */" in archive.read("sources/variables.h")
    description: Any = fmpy.read_model_description(str(path))
    states = [unknown.variable.derivative.name for unknown in description.derivatives]
    assert states == [f"{kind}_{i}" for kind in ("position", "velocity") for i in range(1, 5)]
    assert description.coSimulation.modelIdentifier == "chain_4"
    assert is_shipped("chain_4")
    assert not is_shipped("chain_x")


def test_a_size_that_makes_no_sense_is_refused() -> None:
    for name in ("chain_1", "chain_41", "chain_0"):
        with pytest.raises(BuildError, match=rf"masses = {name[6:]}: from 2 to 40 are possible"):
            build(name)
    with pytest.raises(BuildError, match=r"the plant has no \[size\], so it cannot be built with 3"):
        build("two_mass_3")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "masses"', 'name = "n masses"', "size.name = 'n masses' is no name of a macro"),
        ("start = 3", "start = 1.5", "masses = 1.5: from 2 to 40 are possible"),
        ("range = [2, 40]", "range = [40, 2]", r"size.range = \[40, 2\] must be two whole numbers"),
        ("range = [2, 40]", "range = [2, 40]\nstep = 1", r"unknown key size.step"),
        ("[size]", "[sizes]", "unknown key sizes"),
        ('[size]\nname = "masses"\nstart = 3\nrange = [2, 40]\n', "", r"position.each = true needs a table \[size\]"),
        ("each = true, start = 0.0", "each = 1, start = 0.0", "each = 1 must be true or false"),
        ("stiffness = {", "position_2 = {", "two variables are called 'position_2'"),
    ],
)
def test_mistakes_with_arrays_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    copy = Path(shutil.copytree(PLANTS / "chain", tmp_path / "chain"))
    change(copy / "plant.toml", old, new)
    with pytest.raises(BuildError, match=words):
        build_folder(copy)


# -- the compiler ----------------------------------------------------------------------------------------------------------


def programs(monkeypatch: pytest.MonkeyPatch, *names: str, ziglang: bool = False) -> None:
    """A machine with these programs on its PATH, and with or without the Python package ziglang."""
    find_spec = importlib.util.find_spec
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}" if name in names else None)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: (find_spec("json") if ziglang else None) if name == "ziglang" else find_spec(name)
    )


def test_compilers_are_tried_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    programs(monkeypatch, "cc", "gcc", "clang", "mycc", ziglang=True)
    assert compiler() == ["/bin/cc"]
    monkeypatch.setenv("CC", "mycc -m64")
    assert compiler() == ["mycc", "-m64"]
    programs(monkeypatch, "clang", "gcc")
    assert compiler() == ["/bin/gcc"]
    programs(monkeypatch, "clang")
    assert compiler() == ["/bin/clang"]


def test_ziglang_stands_in_for_a_missing_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    programs(monkeypatch, ziglang=True)
    assert compiler() == [sys.executable, "-m", "ziglang", "cc"]


def test_without_any_compiler_the_message_says_how_to_get_one(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs(monkeypatch)
    with pytest.raises(BuildError, match=r"no C compiler found: tried \$CC, cc, gcc, clang .*'pip install ziglang'"):
        build("two_mass")


def test_a_wrong_cc_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    programs(monkeypatch, "gcc")
    monkeypatch.setenv("CC", "nowhere -O3")
    with pytest.raises(BuildError, match="CC names 'nowhere'"):
        compiler()


def test_the_compilers_own_words_are_kept(cache: Path, folder: Path) -> None:
    change(folder / "two_mass.c", "p->force", "p->farce")
    with pytest.raises(BuildError, match=r"(?s)compiling two_mass with .* failed:.*two_mass\.c:.*farce"):
        build_folder(folder)
    assert not list(cache.rglob("*.fmu"))


@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_compile_without_a_warning(cache: Path, monkeypatch: pytest.MonkeyPatch, version: FmiVersion) -> None:
    monkeypatch.setenv("CC", shlex.join([*compiler(), "-Werror"]))
    build("two_mass", version)


def test_a_failing_compiler_without_words(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    with pytest.raises(BuildError, match="exit code 1 without a message"):
        build("two_mass")


# -- what is refused -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: build("two_masses"), "no shipped plant 'two_masses'; there is .*two_mass"),
        (lambda: locate("two_mass.fmi1"), "append nothing, '.fmi2' or '.fmi3'"),
        (lambda: build("two_mass", "1.0"), "FMI version '1.0' cannot be built; valid are 2.0, 3.0"),  # type: ignore[arg-type]
        (lambda: build_folder(Path(__file__).parent), "no plant folder: it has no plant.toml"),
    ],
)
def test_what_cannot_be_built_is_said(call: Callable[[], Path], words: str) -> None:
    with pytest.raises(BuildError, match=words):
        call()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "two_mass"', 'name = "2 mass"', "'2 mass' is no model identifier"),
        ('name = "two_mass"', 'name = "other"', r"has no other\.c, which must hold the equations"),
        ("tangent = true", "tangents = true", "unknown key tangents"),
        ("tangent = true", 'tangent = "yes"', "tangent = 'yes' must be true or false"),
        ("step = 0.05", "step = 30", "0 < step <= stop"),
        ("stop = 20.0", "stop = inf", "experiment.stop = inf must be a finite number"),
        ("positive = true", "positiv = true", r"unknown key parameters\.mass_1\.positiv"),
        ("mass_1 = { start = 1.0", "mass_1 = { start = 0.0", "parameters.mass_1.start = 0.0 must be positive"),
        ("mass_1 = ", "static = ", "parameters.static: a variable's name is a C identifier"),
        ('unit = "kg"', 'unit = "lb"', "parameters.mass_1.unit = 'lb' is not among"),
        ("kg = 1, m = 1", "lb = 1, m = 1", 'unknown key units."N".lb'),
        ('derivative_unit = "m/s"', 'derivative_unit = "mph"', "states.position_1.derivative_unit = 'mph'"),
        ('depends = ["velocity_1"]', 'depends = ["speed"]', "states.position_1.depends: 'speed' is no input or state"),
        ("[states.position_1]", "[states.position_1]\nnominal = 0.0", "nominal = 0.0 must be positive"),
        ("[inputs]\nforce =", "[outputs2]\nforce =", "unknown key outputs2"),
        ("spring = {", "force = {", "two variables are called 'force'"),
        ("spring = {", "x-y = {", "a variable's name is a C identifier"),
        ("spring = {", "der_spring = {", "a variable's name is a C identifier"),
        ("[units]", "[units", "plant.toml: "),
    ],
)
def test_mistakes_in_a_plant_file_are_named(folder: Path, old: str, new: str, words: str) -> None:
    change(folder / "plant.toml", old, new)
    with pytest.raises(BuildError, match=words):
        build_folder(folder)


def test_a_malformed_twin_is_found_before_it_is_shipped(folder: Path) -> None:
    change(folder / "twin.toml", '"1 / mass_1"', '"1 / mass"')
    with pytest.raises(BuildError, match=r"twin\.toml: B\[1\]: .* no parameter 'mass'"):
        build_folder(folder)


def test_a_plants_files_may_not_shadow_the_shared_ones(folder: Path) -> None:
    (folder / "plant.h").write_text("")
    with pytest.raises(BuildError, match=r"may not hold a plant\.h"):
        build_folder(folder)


@pytest.mark.slow
def test_a_plant_without_twin_and_tangent_builds(cache: Path, folder: Path) -> None:
    (folder / "twin.toml").unlink()
    change(folder / "plant.toml", "tangent = true", "tangent = false")
    for version in VERSIONS:
        path = build_folder(folder, version)
        assert validate_fmu(str(path)) == []
        with zipfile.ZipFile(path) as archive:
            assert "resources/twin.toml" not in archive.namelist()
