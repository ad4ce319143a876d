"""`slewcert fmus export`: what it writes, that it is the same each time, and what it refuses, with nothing left behind."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from exported import drive
from fmpy import __file__ as fmpy_file
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from independent_shaping import known_shapers
from marks import first, slow
from pyssp_standard.ssp import SSP
from raw_fmus import RawFmu

from fmus import compiling, exporting
from fmus.archives import open_archive
from fmus.build import PLANTS, build, build_folder
from fmus.compiling import SUFFIX, compiler, host
from relaxations.commands import Command, Segment, Tail
from suite.cli import main

COMMAND = Command(3.0, (Segment(0.0, 1.0), Segment(1.5, -1.0)), Tail(0.0))
SHAPERS = known_shapers()


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """This machine's compiler only, whatever is installed; tests/test_cross_compiling.py has the other."""
    monkeypatch.setattr(compiling, "has_zig", lambda: False)
    monkeypatch.setattr(exporting, "has_zig", lambda: False)
    monkeypatch.setattr("suite.taking_away.has_zig", lambda: False)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with a command, shapers, an answer of `bound`, and what is none of these."""
    folder = tmp_path / "files"
    folder.mkdir()
    answers: dict[str, Any] = {
        "move": COMMAND.to_dict(),
        "zv": SHAPERS["zv"].to_dict(),
        "pole-zero": SHAPERS["pole-zero"].to_dict(),
        "bound": {"status": "proved", "command": COMMAND.to_dict(), "switches": 1},
        "impossible": {"status": "impossible", "command": None},
        "study": {"format": "slewcert-results/1"},
        "printed": {"kind": "zv", "times": [0.0, 0.5], "amplitudes": [0.5, 0.5]},  # as `shaper --json` has it
        "lame": {**SHAPERS["zv"].to_dict(), "amplitudes": [0.5, 0.4]},
    }
    for name, data in answers.items():
        (folder / f"{name}.json").write_text(json.dumps(data))
    (folder / "text.json").write_text("no JSON")
    return folder


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["fmus", "export", *map(str, arguments)], catch_exceptions=False)


@pytest.mark.parametrize("name", ["pole-zero", slow("bound")])
def test_writes_both_versions(files: Path, tmp_path: Path, name: str) -> None:
    done = run(files / f"{name}.json", "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    model = name.replace("-", "_")
    assert (record["kind"], record["name"]) == ("command" if name in ("move", "bound") else "shaper", model)
    assert "ziglang" in record["note"]
    for version, entry in zip(("2.0", "3.0"), record["files"], strict=True):
        path = tmp_path / "out" / f"{model}.fmi{version[0]}.fmu"
        assert entry == {"path": str(path), "fmi": version, "platforms": [host().folder(version)]}
        assert validate_fmu(str(path)) == []
        assert open_archive(path).description.fmi_version == version
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [f"{model}.fmi2.fmu", f"{model}.fmi3.fmu"]


def test_says_what_it_wrote_and_for_which_machine(files: Path, tmp_path: Path) -> None:
    done = run(files / "zv.json", "--fmi", "2", "--out", tmp_path / "shaper.fmu")
    assert done.stdout == f"{tmp_path / 'shaper.fmu'}: FMI 2.0 for {host().folder('2.0')}\n"
    assert done.stderr.startswith("built for this machine only; with the Python package ziglang")


@pytest.mark.slow
def test_the_same_file_gives_the_same_bytes(files: Path, tmp_path: Path) -> None:
    for folder in ("one", "other"):
        assert run(files / "move.json", "--fmi", "3", "--out", tmp_path / folder).exit_code == 0
        assert run(files / "zv.json", "--ssp", "two_mass", "--out", tmp_path / folder).exit_code == 0
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes(), path.name


def test_options_reach_the_fmu(files: Path, tmp_path: Path) -> None:
    options = ["--name", "my_shaper", "--output", "torque", "--unit", "N.m", "--rest", "2.5", "--linear", "--history", "16"]
    assert run(files / "zv.json", "--fmi", "3", "--out", tmp_path / "x.fmu", *options).exit_code == 0
    description = open_archive(tmp_path / "x.fmu").description
    assert description.model_name == "my_shaper"
    assert {v.name: (v.unit, v.start) for v in description.variables if v.name != "time"} == {
        "rest": ("N.m", 2.5),
        "linear": ("", 1.0),
        "reference": ("N.m", 2.5),
        "torque": ("N.m", None),
    }
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        assert "#define HISTORY 16\n" in archive.read("sources/constants.h").decode()
        assert "modelIdentifier" in archive.read("sources/buildDescription.xml").decode()


@pytest.mark.slow
@pytest.mark.parametrize("fmi", first(1, ["3", "2"]))
def test_a_unit_is_defined_in_the_fmu(files: Path, tmp_path: Path, fmi: str) -> None:
    """By its exponents, factor and offset, which FMPy reads."""
    path = tmp_path / "x.fmu"
    for unit, expected in {
        "N.m": {"kg": 1, "m": 2, "s": -2},
        "kN": {"kg": 1, "m": 1, "s": -2, "factor": 1000.0},
        "degC": {"K": 1, "offset": 273.15},
        "mm/s2": {"m": 1, "s": -2, "factor": 1e-3},
        "%": {"factor": 0.01},
        "1": {},
    }.items():
        assert run(files / "move.json", "--fmi", fmi, "--unit", unit, "--out", path, "--force").exit_code == 0
        assert validate_fmu(str(path)) == []
        (defined,) = [d for d in read_model_description(str(path)).unitDefinitions if d.name == unit]
        base = defined.baseUnit
        assert base is not None
        named = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
        found = {name: getattr(base, name) for name in named if getattr(base, name)}
        found |= {name: value for name, value in (("factor", base.factor), ("offset", base.offset)) if value != (name == "factor")}
        assert found == pytest.approx(expected, rel=1e-15)
    assert run(files / "move.json", "--fmi", fmi, "--unit", "", "--out", path, "--force").exit_code == 0
    assert open_archive(path).description.find("u").unit == ""


def test_a_file_is_replaced_only_if_asked(files: Path, tmp_path: Path) -> None:
    target = tmp_path / "x.fmu"
    target.write_text("mine")
    done = run(files / "zv.json", "--fmi", "2", "--out", target)
    assert (done.exit_code, target.read_text()) == (2, "mine")
    assert "x.fmu exists already; --force replaces" in done.stderr
    assert run(files / "zv.json", "--fmi", "2", "--out", target, "--force").exit_code == 0
    assert validate_fmu(str(target)) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["text.json"], ["text.json is no command, shaper or filter file", "Expecting value"]),
        (["absent.json"], ["absent.json: No such file"]),
        (["."], ["is a folder, not a command, shaper or filter file"]),
        (
            ["study.json"],
            ["its \"format\" is 'slewcert-results/1', not 'slewcert-command/1' or 'slewcert-shaper/1' or 'slewcert-prefilter/1'"],
        ),
        (["impossible.json"], ["the answer of a study without a command"]),
        (["lame.json"], ["amplitudes sum to 1, not to 0.9"]),
        (["zv.json", "--out", "x.fmu"], ["choose with --fmi 2 or --fmi 3, or name a folder"]),
        (["zv.json", "--out", "x.ssp"], ["an .fmu is written here (for an .ssp name the plant with --ssp)"]),
        (["zv.json", "--out", "zv.json"], ["would overwrite a file that the command reads"]),
        (["zv.json", "--ssp", "two_mass", "--out", "x.fmu"], ["an .ssp is written here (--ssp was given)"]),
        (["zv.json", "--name", "2 fast"], ["'2 fast' is no model identifier"]),
        (["zv.json", "--output", "reference"], ["'reference' is no name for a signal"]),
        (["move.json", "--output", "double"], ["'double' is no name for a signal", "none of time, before, memory, delay, scale, rest"]),
        (["move.json", "--unit", "*/ x"], ["is no unit"]),
        (["move.json", "--unit", "bogus<>"], ['--unit: "bogus<>" is no unit; valid are units as FMI writes them', "N.m"]),
        (["zv.json", "--unit", "newtonz"], ['"newtonz" is no unit that is known; valid are']),
        (["zv.json", "--unit", "kg^0.5"], ["exponents are whole numbers"]),
        (["zv.json", "--unit", " N"], ["' N' cannot be defined"]),
        (["zv.json", "--ssp", "two_mass", "--unit", "V"], ['"V" is no unit of the kind of "N"; valid are N, kN, lbf']),
        (["move.json", "--rest", "nan"], ["rests at a finite value, not at nan"]),
        (["move.json", "--linear"], ["--linear is for shapers", "move.json is a command"]),
        (["move.json", "--history", "0"], ["--history is for shapers"]),
        (["printed.json"], ["slewcert shaper … --save FILE"]),
        (["zv.json", "--history", "1"], ["from 2 to 10000000 changes of its reference, not 1"]),
        (["zv.json", "--ssp", "two_maas"], ["two_maas is no file, and the plants shipped here are", "two_mass", "did you mean"]),
        (["zv.json", "--ssp", "two_mass", "--input", "farce"], ["no variable 'farce'", "'force'"]),
        (["zv.json", "--ssp", "zv.json"], ["zv.json is no intact FMU"]),
        (["zv.json", "--ssp", "two_mass.fmi2", "--fmi", "3"], ["two_mass.fmi2.fmu is of FMI 2.0", "--fmi 3 asks for another"]),
        (["zv.json", "--input", "force"], ["--input is an input of the plant"]),
        (["zv.json", "--platform", "win64"], ["for x86_64-windows needs the Python package ziglang", "for this machine only"]),
        (["zv.json", "--platform", "linux32"], ["'linux32' is not one of", "'all'"]),
    ],
)
def test_mistakes_are_named_and_leave_nothing(files: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]) -> None:
    monkeypatch.chdir(files)
    before = sorted(files.rglob("*"))
    done = run(*arguments)
    assert done.exit_code == 2
    assert [part for part in words if part not in done.stderr] == [], done.stderr
    assert done.stdout == ""
    assert sorted(files.rglob("*")) == before


def test_without_a_compiler_nothing_is_written(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "nowhere")
    done = run(files / "zv.json", "--out", tmp_path / "out")
    assert (done.exit_code, (tmp_path / "out").exists()) == (2, False)
    assert "CC names 'nowhere'" in done.stderr


def test_what_fails_late_leaves_nothing_half_written(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiler fails for the second version, when the first is done."""
    script = tmp_path / "cc"
    script.write_text(f'#!/bin/sh\ncase "$*" in *fmi3.c*) echo broken >&2; exit 1;; esac\nexec {shlex.join(compiler())} "$@"\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    done = run(files / "zv.json", "--out", tmp_path / "out")
    assert (done.exit_code, (tmp_path / "out").exists()) == (2, False)
    assert "broken" in done.stderr


# -- sources -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "version"), first(2, [("zv", "2"), ("filter", "3"), ("repeated", "2"), ("move", "3"), ("step", "2")]))
def test_the_sources_compile_without_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, version: str) -> None:
    """With the pedantry of ISO C, which knows no empty tables: shapers without filters or impulses, commands without segments or tails."""
    contents = {**SHAPERS, "move": COMMAND, "step": Command(0.0, (), Tail(1.0))}
    monkeypatch.setenv("CC", shlex.join([*compiler(), "-Werror", "-pedantic"]))
    (tmp_path / "x.json").write_text(json.dumps(contents[name].to_dict()))
    done = run(tmp_path / "x.json", "--fmi", version, "--out", tmp_path / "x.fmu")
    assert done.exit_code == 0, done.stderr


@pytest.mark.parametrize("version", [slow("2.0"), "3.0"])
def test_anybody_can_compile_the_sources(files: Path, tmp_path: Path, version: str) -> None:
    """With the files that the descriptions list, the standard's headers and no flag of ours, a library that does the same."""
    assert run(files / "pole-zero.json", "--fmi", version[0], "--out", tmp_path / "x.fmu").exit_code == 0
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        archive.extractall(tmp_path / "x")
    listing = "modelDescription.xml" if version == "2.0" else "sources/buildDescription.xml"
    element = ".//File" if version == "2.0" else ".//SourceFile"
    listed = [file.attrib["name"] for file in ElementTree.parse(tmp_path / "x" / listing).iterfind(element)]
    assert listed
    (library,) = (tmp_path / "x" / "binaries").rglob(f"*{SUFFIX[host().system]}")
    headers = Path(fmpy_file).parent / "c-code"
    own = ["-fPIC", "-shared", "-DFMI3_OVERRIDE_FUNCTION_PREFIX", f"-I{headers}", "-o", str(library)]
    subprocess.run([*compiler(), *own, *listed, "-lm"], cwd=tmp_path / "x" / "sources", check=True)
    shutil.make_archive(str(tmp_path / "again"), "zip", tmp_path / "x")
    (tmp_path / "again.zip").rename(tmp_path / "again.fmu")
    times, values = [0.01 * n for n in range(400)], [float(n // 50) for n in range(400)]
    outputs = []
    for path in ("x.fmu", "again.fmu"):
        with RawFmu(tmp_path / path, tmp_path / f"unpacked-{path}") as fmu:
            fmu.initialize()
            outputs.append(drive(fmu, times, values))
    assert outputs[1] == pytest.approx(outputs[0], abs=1e-14)  # without -ffp-contract=off sums may round otherwise


# -- SSP ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "plant", "version"),
    [
        ("zv", "two_mass.fmi2", "1.0"),
        ("move", "two_mass", "2.0"),
        slow("zv", "two_mass", "2.0"),
        slow("move", "two_mass.fmi2", "1.0"),
    ],
)
def test_an_ssp_is_what_the_standard_says(files: Path, tmp_path: Path, name: str, plant: str, version: str) -> None:
    """Read by another implementation, with the standard's schema and its rules for connections."""
    assert run(files / f"{name}.json", "--ssp", plant, "--out", tmp_path).exit_code == 0
    major = "2" if version == "1.0" else "3"
    output, reference = ("shaped", ["reference"]) if name == "zv" else ("u", [])
    outer = {"SystemStructure": [], "Subsystem": [*reference, "position_1", "position_2", "spring"]}
    with SSP(tmp_path / f"{name}.ssp", mode="r") as ssp:
        assert set(ssp.variants) == set(outer)
        for variant, connectors in outer.items():
            ssd: Any
            with ssp.variants[variant] as ssd:
                ssd.check_compliance(ssd.schemas["ssd" if version == "1.0" else "ssd2"], ssd.namespaces)
                assert ssd.version == version
                assert ssd.check_connections(connector_not_in_system=True) == []
                assert [connector.name for connector in ssd.system.connectors] == connectors
                assert [(e.name, e.source) for e in ssd.system.elements] == [
                    (name, f"resources/{name}.fmu"),
                    ("plant", "resources/plant.fmu"),
                ]
                (link,) = ssd.list_connections(start_element=name)
                assert (link.start_connector, link.end_element, link.end_connector) == (output, "plant", "force")
    with zipfile.ZipFile(tmp_path / f"{name}.ssp") as archive:
        archive.extractall(tmp_path / "unpacked")
    assert (tmp_path / "unpacked/resources/plant.fmu").read_bytes() == build("two_mass", f"{major}.0").read_bytes()  # type: ignore[arg-type]
    description = open_archive(tmp_path / f"unpacked/resources/{name}.fmu").description
    assert description.fmi_version == f"{major}.0"
    assert description.find(output).unit == "N", "the unit of the plant's input"
    assert [u.exponents for u in description.units if u.name == "N"] == [(("kg", 1), ("m", 1), ("s", -2))]


def test_a_shaper_rests_where_the_plants_input_starts(files: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(PLANTS / "two_mass", tmp_path / "two_mass"))
    text = (folder / "plant.toml").read_text()
    (folder / "plant.toml").write_text(text.replace("force = { start = 0.0", "force = { start = 0.75"))
    plant = build_folder(folder, "2.0", tmp_path / "loaded.fmu")
    assert run(files / "zv.json", "--ssp", plant, "--out", tmp_path / "loaded.ssp").exit_code == 0
    with zipfile.ZipFile(tmp_path / "loaded.ssp") as archive:
        (tmp_path / "zv.fmu").write_bytes(archive.read("resources/zv.fmu"))
    description = open_archive(tmp_path / "zv.fmu").description
    assert (description.find("rest").start, description.find("reference").start) == (0.75, 0.75)


def test_names_that_meet_are_told_apart(files: Path, tmp_path: Path) -> None:
    """A shaper called "plant"; a plant with an output called like the shaper's reference."""
    folder = Path(shutil.copytree(PLANTS / "two_mass", tmp_path / "two_mass"))
    for file in ("plant.toml", "twin.toml", "two_mass.c"):
        text = (folder / file).read_text()
        (folder / file).write_text(text.replace("[outputs]\nspring", "[outputs]\nreference").replace("->spring =", "->reference ="))
    plant = build_folder(folder, "2.0", tmp_path / "two_mass.fmu")
    assert run(files / "zv.json", "--name", "plant", "--ssp", plant, "--out", tmp_path / "x.ssp").exit_code == 0
    ssd: Any
    with SSP(tmp_path / "x.ssp", mode="r") as ssp, ssp.variants["Subsystem"] as ssd:
        ssd.check_compliance(ssd.schemas["ssd"], ssd.namespaces)
        assert ssd.check_connections(connector_not_in_system=True) == []
        assert [e.name for e in ssd.system.elements] == ["plant", "driven_plant"]
        assert [c.name for c in ssd.system.connectors] == ["reference", "position_1", "position_2", "driven_plant.reference"]
