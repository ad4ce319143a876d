"""FMUs with events of every sort, from `tests/events/model.c`: written apart from the plants that are shipped, compiled once a process."""

from __future__ import annotations

import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

from fmus.archives import host_platform
from fmus.build import FmiVersion
from fmus.compiling import compiler

SOURCE = Path(__file__).parent / "events" / "model.c"
KINDS = ("BALL", "RELAY", "CLOCK", "KICK", "FUSSY", "STIFF")
PARAMETERS = ("g", "e", "slow", "longest")
FLAGS = {
    "2.0": {"canHandleVariableCommunicationStepSize": "true", "canGetAndSetFMUstate": "true"},
    "3.0": {"canHandleVariableCommunicationStepSize": "true"},
}


def build_event_plant(folder: Path, kind: str, version: FmiVersion, interfaces: str = "both", **flags: str) -> Path:
    """An FMU in `folder`; `interfaces` is "both", "CoSimulation" or "ModelExchange", `flags` are further attributes of the former."""
    path = folder / f"{kind.lower()}.fmi{version[0]}.fmu"
    where = host_platform() if version == "3.0" else "linux64"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", describe(kind, version, interfaces, flags))
        archive.writestr(f"binaries/{where}/model.so", library(kind, version))
    return path


@cache
def library(kind: str, version: FmiVersion) -> bytes:
    """The shared library."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "model.so"
        flags = ["-std=c11", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-Wall", f"-DFMI={version[0]}", f"-DKIND={kind}"]
        subprocess.run([*compiler(), *flags, "-o", str(out), str(SOURCE), "-lm"], check=True)
        return out.read_bytes()


def describe(kind: str, version: FmiVersion, interfaces: str, flags: dict[str, str]) -> str:
    """modelDescription.xml."""
    fmi2 = version == "2.0"
    chosen = {**FLAGS[version], **flags}
    steps = " ".join(f'{name}="{value}"' for name, value in chosen.items())
    exchange = '<ModelExchange modelIdentifier="model"' + ("/>" if fmi2 else ' needsCompletedIntegratorStep="true"/>')
    parts = {"ModelExchange": exchange, "CoSimulation": f'<CoSimulation modelIdentifier="model" {steps}/>'}
    shown = "".join(text for name, text in parts.items() if interfaces in ("both", name))
    asks = ' intermediateUpdate="true"' if flags.get("providesIntermediateUpdate") == "true" else ""
    rows = [
        ("time", 'causality="independent" variability="continuous"', "", None),
        ("u", f'causality="input" variability="continuous"{asks}', 'start="0"', None),
        ("x", 'causality="output" variability="continuous" initial="exact"', 'start="0"', None),
        ("v", 'causality="local" variability="continuous" initial="exact"', 'start="0"', None),
        ("der(x)", 'causality="local" variability="continuous" initial="calculated"', "", 2),
        ("der(v)", 'causality="local" variability="continuous" initial="calculated"', "", 3),
        ("y", 'causality="output" variability="continuous" initial="calculated"', "", None),
        *((name, 'causality="parameter" variability="fixed" initial="exact"', 'start="0"', None) for name in PARAMETERS),
        ("count", 'causality="output" variability="discrete" initial="calculated"', "", None),
    ]
    variables, unknowns = "", ""
    for reference, (name, attributes, start, state) in enumerate(rows):
        head = f'name="{name}" valueReference="{reference}" {attributes}'
        if fmi2:
            derivative = "" if state is None else f'derivative="{state + 1}"'
            variables += f"<ScalarVariable {head}><Real {start} {derivative}/></ScalarVariable>"
        else:
            derivative = "" if state is None else f'derivative="{state}"'
            variables += f"<Float64 {head} {start} {derivative}/>"
    groups = {"Output": (2, 6, 11), "Derivative": (4, 5), "InitialUnknown": (4, 5, 6, 11)}
    for group, members in groups.items():
        if fmi2:
            unknowns += f"<{group}s>" + "".join(f'<Unknown index="{i + 1}"/>' for i in members) + f"</{group}s>"
        else:
            name = "ContinuousStateDerivative" if group == "Derivative" else group
            unknowns += "".join(f'<{name} valueReference="{i}"/>' for i in members)
    if not fmi2:  # FMPy counts these instead of asking the FMU
        unknowns += "".join(f'<EventIndicator valueReference="{i}"/>' for i in (2, 6))
    token = 'guid="{model}" numberOfEventIndicators="2"' if fmi2 else 'instantiationToken="{model}"'
    body = f"{shown}<ModelVariables>{variables}</ModelVariables><ModelStructure>{unknowns}</ModelStructure>"
    return f'<?xml version="1.0"?><fmiModelDescription fmiVersion="{version}" modelName="{kind}" {token}>{body}</fmiModelDescription>'
