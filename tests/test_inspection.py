"""`slewcert fmus inspect`: everything that an FMU says, and what would prevent a run of it, without loading its code."""

from __future__ import annotations

import ctypes
import json
import subprocess
import zipfile
from pathlib import Path

import pytest
from array_plant import build_chain
from click.testing import CliRunner, Result
from test_archives import description, pack

from fmus.archives import host_platform
from fmus.build import build
from fmus.compiling import compiler
from fmus.errors import DescriptionError
from fmus.inspection import inspect
from fmus.terminals import read_terminals
from suite.cli import main


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["fmus", "inspect", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_chain(tmp_path_factory.mktemp("chain"))


def test_tells_everything_as_json(chain: Path) -> None:
    done = run(chain, "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert (record["fmi_version"], record["model"], record["tool"]) == ("3.0", "chain", "by hand")
    assert record["interfaces"]["CoSimulation"] == {"modelIdentifier": "chain", "canHandleVariableCommunicationStepSize": "true"}
    assert record["binaries"] == {host_platform(): ["chain.so"]}
    assert record["sources"] == ["chain.c"]
    assert record["states"] == ["x[1]", "x[2]", "x[3]", "v[1]", "v[2]", "v[3]"]
    variables = {v["name"]: v for v in record["variables"]}
    assert (variables["stiffness"]["shape"], variables["stiffness"]["dimensions"]) == ([3], ["n"])
    assert (variables["stiffness"]["start"], variables["stiffness"]["min"]) == ([1.0, 1.0, 1.0], 0.0)
    assert (variables["state"]["shape"], variables["state"]["dimensions"]) == ([3, 2], ["n", 2])
    assert variables["material"]["items"] == {"soft": 1, "hard": 2}
    assert (variables["label"]["type"], variables["label"]["start"]) == ("String", "a chain")
    units = {unit["name"]: unit for unit in record["units"]}
    assert (units["mm"]["base"], units["mm"]["factor"]) == ({"m": 1}, 0.001)
    assert units["m"]["display"] == [{"name": "mm", "factor": 1000.0, "offset": 0.0}]
    (drive,) = record["terminals"]
    assert (drive["kind"], drive["matching"]) == ("chain.Drive", "bus")
    assert drive["terminals"][0]["members"] == [{"variable": "enabled", "name": "enabled", "kind": "signal"}]
    assert record["prevents"] == []


def test_tells_it_to_people_too(chain: Path) -> None:
    text = run(chain).stdout
    for words in (
        "chain, made by by hand",
        "Float64[3, 2]",
        "1 (soft)",
        "drive (chain.Drive, bus): force; where the actuators act",
        "safety (plug): enabled",
        "inputs that are no numbers keep their start values: label",
        "sizes of arrays are set by structural parameters: n",
        "nothing prevents a run here",
    ):
        assert words in text


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_nothing_prevents_a_run_of_what_is_shipped(version: str) -> None:
    found = inspect(build("two_mass", version))  # type: ignore[arg-type]
    assert found.obstacles == ()
    assert found.notes[-1] == "it brings a linear twin"
    assert found.sources


def test_a_plant_shipped_here_has_a_name() -> None:
    assert "nothing prevents a run here" in run("two_mass.fmi2").stdout
    assert json.loads(run("chain_6", "--json").stdout)["model"]
    done = run("two_maas")
    assert done.exit_code == 2
    assert 'did you mean "two_mass"?' in done.stderr


def test_loads_no_code(tmp_path: Path) -> None:
    """A library that leaves a mark as soon as it is loaded."""
    mark, source, library = tmp_path / "mark", tmp_path / "mark.c", tmp_path / "mark.so"
    source.write_text(f'#include <stdio.h>\n__attribute__((constructor)) static void on(void) {{ fclose(fopen("{mark}", "w")); }}\n')
    subprocess.run([*compiler(), "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    files = {"modelDescription.xml": description(), f"binaries/{host_platform()}/cart.so": library.read_bytes()}
    path = pack(tmp_path / "mark.fmu", files)
    (obstacle,) = inspect(path).obstacles
    assert "exports no fmi3InstantiateCoSimulation" in obstacle
    assert run(path).exit_code == 1
    assert not mark.exists()
    ctypes.CDLL(str(library))
    assert mark.exists(), "loading it leaves the mark"


def test_names_the_platforms_there_are_where_this_one_is_missing(tmp_path: Path) -> None:
    files = {
        "modelDescription.xml": description(),
        "binaries/sparc-solaris/cart.so": b"",
        "binaries/win64/cart.dll": b"",
        "sources/cart.c": b"",
    }
    path = pack(tmp_path / "a.fmu", files)
    (obstacle,) = inspect(path).obstacles
    assert f"no binary 'cart' for {host_platform()}; its binaries are for: sparc-solaris, win64" in obstacle
    assert "its sources are there" in obstacle
    done = run(path)
    assert done.exit_code == 1
    assert "prevents a run here:" in done.stdout


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("<CoSimulation", '<CoSimulation needsExecutionTool="true"'), "it needs the tool that made it (by hand) on this machine"),
        (
            (' canHandleVariableCommunicationStepSize="true"', ' fixedInternalStepSize="0.02"'),
            "all have one size, 0.02 s by its own account",
        ),
        (("<CoSimulation", '<CoSimulation fixedInternalStepSize="0.001"'), "its own solver takes fixed steps of 0.001 s"),
        (('  <ModelExchange modelIdentifier="chain"/>\n', ""), "shows no derivatives"),
        (('<ModelExchange modelIdentifier="chain"', '<ModelExchange modelIdentifier="chain" providesDirectionalDerivatives="true"'), ""),
        (("<CoSimulation", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"'), "one instance in a process"),
        (("<UnitDefinitions>", "<UnitDefinitions>"), "its state cannot be saved"),
        (('<CoSimulation modelIdentifier="chain"', '<CoSimulation canGetAndSetFMUState="true" modelIdentifier="chain"'), ""),
        (
            ("  <UnitDefinitions>", '  <ScheduledExecution modelIdentifier="chain"/>\n  <UnitDefinitions>'),
            "scheduled execution too, which is not used",
        ),
    ],
)
def test_tells_what_a_run_can_do_in_part_only(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    found = inspect(build_chain(tmp_path, change))
    text = "\n".join(found.notes)
    assert words in text
    if "Directional" in change[1]:
        assert "directional" not in text
    if "FMUState" in change[1]:
        assert "saved" not in text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('causality="input" start="0" unit="N"', 'causality="parameter" variability="fixed" start="0" unit="N"'), "no real input"),
        (('name="x" valueReference="8" causality="output"', 'name="x" valueReference="8" causality="local"'), ""),
    ],
)
def test_tells_what_prevents_a_run(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    obstacles = inspect(build_chain(tmp_path, change)).obstacles
    assert [words in obstacle for obstacle in obstacles] == ([True] if words else [])


FMI1 = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="1.0" modelName="old" modelIdentifier="old" guid="{1}" generationTool="Tool 1"
 numberOfContinuousStates="0" numberOfEventIndicators="0"/>"""


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (FMI1.encode(), "FMI version 1.0 is not supported; 2.0 and 3.0 are: export old anew from Tool 1"),
        (description().replace(b"<CoSimulation", b"<ScheduledExecution"), "cart offers scheduled execution only"),
    ],
)
def test_what_is_refused_everywhere_is_refused_here_too(tmp_path: Path, xml: bytes, words: str) -> None:
    path = pack(tmp_path / "a.fmu", {"modelDescription.xml": xml})
    done = run(path)
    assert done.exit_code == 2
    assert words in done.stderr
    study = tmp_path / "study.toml"
    study.write_text(
        '[plant]\nfmu = "a.fmu"\ninput = "force"\noutput = "position"\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\n'
    )
    for command in ("bound", "verify"):
        done = CliRunner().invoke(main, [command, str(study)], catch_exceptions=False)
        assert done.exit_code == 2
        assert words in done.stderr


def test_terminals_are_read_as_carefully_as_the_description(tmp_path: Path) -> None:
    bomb = b'<!DOCTYPE x [<!ENTITY a "aaaa">]><fmiTerminalsAndIcons/>'
    with pytest.raises(DescriptionError, match=r"terminalsAndIcons\.xml has a DOCTYPE"):
        read_terminals(bomb)
    with pytest.raises(DescriptionError, match="more than 200 deep"):
        read_terminals(b"<a>" * 300)
    path = build_chain(tmp_path)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    pack(path, {**files, "terminalsAndIcons/terminalsAndIcons.xml": bomb})
    assert run(path).exit_code == 2


def test_a_table_of_very_many_variables_is_cut(tmp_path: Path) -> None:
    more = "".join(f'<Float64 name="z{i}" valueReference="{100 + i}" causality="local"/>' for i in range(200))
    done = run(build_chain(tmp_path, ("  </ModelVariables>", f"{more}</ModelVariables>")))
    assert "and 116 more variables: --json lists all" in done.stdout
    assert len(done.stdout.splitlines()) < 140


def test_text_of_an_fmu_forges_no_lines(tmp_path: Path) -> None:
    forged = "Tool&#10;nothing prevents a run here&#x2028;x&#x9b;[2J"
    text = description().decode().replace('modelName="cart"', f'modelName="cart&#10;FMI 9" generationTool="{forged}"')
    done = run(pack(tmp_path / "a.fmu", {"modelDescription.xml": text.encode()}))
    assert "nothing prevents a run here" not in done.stdout.splitlines()
    assert done.stdout.startswith(
        "model         cart\ufffdFMI 9, made by Tool\ufffdnothing prevents a run here\ufffdx\ufffd[2J\nFMI           3.0\n"
    )
    old = text.replace('fmiVersion="3.0"', 'fmiVersion="1.0"')
    done = run(pack(tmp_path / "b.fmu", {"modelDescription.xml": old.encode()}))
    assert len(done.stderr.splitlines()) == 1
    assert "FMI version 1.0 is not supported" in done.stderr


def test_start_values_outside_the_limits_are_noted(tmp_path: Path) -> None:
    mass = b'variability="tunable" start="2.5" unit="kg"'
    for limits, words in (
        (b' min="3"', "mass = 2.5 (at least 3)"),
        (b' max="2"', "mass = 2.5 (at most 2)"),
        (b' min="2.5" max="2.5"', None),
    ):
        text = description().replace(mass, mass + limits)
        assert text != description()
        notes = inspect(pack(tmp_path / "a.fmu", {"modelDescription.xml": text})).notes
        assert [note for note in notes if "limits" in note] == ([f"start values outside the FMU's own limits: {words}"] if words else [])
