"""FMUs made for one test: a linear plant from its matrices, any plant from its equations in C, and FMUs that offer less than they can."""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.build import FmiVersion, build_folder

Rows = Sequence[Sequence[float]]


def made_fmu(
    name: str,
    equations: str,
    states: Mapping[str, float],
    *,
    parameters: Mapping[str, float] | None = None,
    input: tuple[str, float] = ("u", 0.0),
    outputs: Sequence[str] = ("y",),
    extra: str = "",
    version: FmiVersion = "3.0",
    nominal: Mapping[str, float] | None = None,
    out: Path | None = None,
) -> Path:
    """The FMU of the C functions in `equations` (`plant_derivatives`, `plant_outputs` …), with start values; built once."""
    lines = [f'name = "{name}"', extra, "[experiment]", "stop = 10.0", "step = 0.01", "[units]", '"1" = {}', "[parameters]"]
    lines += [f'{key} = {{ start = {value!r}, unit = "1" }}' for key, value in (parameters or {}).items()]
    lines += ["[inputs]", f'{input[0]} = {{ start = {input[1]!r}, unit = "1" }}', "[states]"]
    lines += [
        f'{key} = {{ start = {value!r}, unit = "1", derivative_unit = "1", nominal = {(nominal or {}).get(key, 1.0)!r} }}'
        for key, value in states.items()
    ]
    lines += ["[outputs]", *(f'{key} = {{ unit = "1" }}' for key in outputs)]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "plant.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / f"{name}.c").write_text(f'#include "plant.h"\n#include <math.h>\n#include <stdlib.h>\n{equations}\n', encoding="utf-8")
        return build_folder(folder, version, out)


def linear_fmu(
    name: str, A: Rows, B: Sequence[float], C: Sequence[float], D: float = 0.0, version: FmiVersion = "3.0", extra: str = ""
) -> Path:
    """The FMU of `x' = A x + B u`, `y = C x + D u`; its states are x1, x2 …"""
    states = [f"x{i}" for i in range(1, len(B) + 1)]

    def terms(row: Sequence[float], last: float) -> str:
        return " + ".join([f"({a!r}) * p->{x}" for a, x in zip(row, states, strict=True) if a] + [f"({last!r}) * p->u"])

    rates = "".join(f"    p->der_{x} = {terms(row, b)};\n" for x, row, b in zip(states, A, B, strict=True))
    equations = f"void plant_derivatives(Plant *p) {{\n{rates}}}\nvoid plant_outputs(Plant *p) {{ p->y = {terms(C, D)}; }}\n"
    return made_fmu(name, equations, dict.fromkeys(states, 0.0), version=version, extra=extra)


def steps_only(path: Path, out: Path, *, derivatives: bool = False, variable: bool = True) -> Path:
    """The same FMU as another tool might have exported it: co-simulation alone, without directional derivatives or variable steps."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(out, "w") as target:
        for info in source.infolist():
            content = source.read(info)
            if info.filename == "modelDescription.xml":
                text = re.sub(r"(?s)<ModelExchange\b[^>]*?(/>|>.*?</ModelExchange>)", "", content.decode())
                if not derivatives:
                    text = re.sub(r' provides(Directional|Adjoint)Derivatives?="true"', "", text)
                if not variable:
                    text = text.replace(' canHandleVariableCommunicationStepSize="true"', "")
                content = text.encode()
            target.writestr(info, content)
    return out
