"""An FMU whose interfaces live in two libraries: each record names the one that was loaded."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from marks import slow
from small_studies import small_study
from test_archives import pack

from fmus.archives import open_archive
from fmus.build import FmiVersion, build
from reports import logs
from suite.cli import main

COMMAND = {
    "format": "slewcert-command/1",
    "maneuver_time": 1.0,
    "segments": [{"start": 0.0, "level": 1.0, "slope": 0.0}],
    "tail": {"steady": 0.0, "terms": []},
}


def two_binaries(folder: Path, version: FmiVersion) -> Path:
    """`two_mass` with a second library for model exchange: the first one and a byte behind its end, which no loader looks at."""
    with zipfile.ZipFile(build("two_mass", version)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = files["modelDescription.xml"].decode()
    before, tag, rest = text.partition("<ModelExchange")
    assert 'modelIdentifier="two_mass"' in rest.split(">")[0]
    files["modelDescription.xml"] = (before + tag + rest.replace('modelIdentifier="two_mass"', 'modelIdentifier="exchanged"', 1)).encode()
    (name,) = [name for name in files if name.startswith("binaries/") and not name.endswith("/")]
    files[name.replace("two_mass", "exchanged")] = files[name] + b"\0"
    return pack(folder / "two_binaries.fmu", files)


@pytest.fixture(params=["2.0", "3.0"])
def fmu(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str, str]:
    """The file, and the SHA-256 of what co-simulation and model exchange load."""
    path = two_binaries(tmp_path, request.param)
    with zipfile.ZipFile(path) as archive:
        hashes = {Path(name).stem: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist() if name.endswith(".so")}
    return path, hashes["two_mass"], hashes["exchanged"]


def told(*arguments: str | Path) -> dict[str, object]:
    done = CliRunner().invoke(main, [*map(str, arguments), "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_inspect_names_both(fmu: tuple[Path, str, str]) -> None:
    path, stepped, exchanged = fmu
    libraries = told("fmus", "inspect", path)["libraries"]
    assert isinstance(libraries, dict)
    assert {name: entry["sha256"] for name, entry in libraries.items()} == {"CoSimulation": stepped, "ModelExchange": exchanged}
    assert stepped != exchanged
    assert open_archive(path).binary_sha256("model-exchange") == exchanged


@pytest.mark.slow
@pytest.mark.parametrize("interface", [slow("co-simulation"), "model-exchange"])
def test_a_study_records_the_one_that_it_ran(fmu: tuple[Path, str, str], interface: str, tmp_path: Path) -> None:
    path, stepped, exchanged = fmu
    used = stepped if interface == "co-simulation" else exchanged
    file = small_study(tmp_path, fmu=str(path), samples=0)
    file.write_text(file.read_text().replace("timeout = 20", f'timeout = 20\ninterface = "{interface}"'))
    out = tmp_path / "out"
    told("verify", file, "--out", out)
    plant = json.loads((out / "results.json").read_bytes())["plant"]
    hashes = json.loads((out / "plant/hashes.json").read_bytes())
    assert plant["binary_sha256"] == hashes["binary_sha256"] == used
    assert set(plant["libraries"].values()) == {stepped, exchanged}
    (log,) = (out / "runs").glob("*.mcap")
    assert logs.read_log(log).run["binary_sha256"] == used


@pytest.mark.slow
def test_a_simulation_and_a_linearisation_record_the_one_that_they_ran(fmu: tuple[Path, str, str], tmp_path: Path) -> None:
    path, stepped, exchanged = fmu
    (tmp_path / "move.json").write_text(json.dumps(COMMAND))
    ends = ("--input", "force", "--output", "position_2")
    for interface, used in (("co-simulation", stepped), ("model-exchange", exchanged)):
        log = tmp_path / f"{interface}.mcap"
        told("simulate", path, tmp_path / "move.json", *ends, "--log", log, "--interface", interface, "--stop", "2")
        assert logs.read_log(log).run["binary_sha256"] == used
    assert told("linearize", path, *ends, "--method", "differences")["binary_sha256"] == exchanged
    assert told("linearize", path, *ends, "--method", "identified")["binary_sha256"] == stepped
