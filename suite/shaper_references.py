"""`slewcert shaper --reference FILE --shaped FILE`: what a shaper makes of a command, a spline, or a table of samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.commands import FORMAT as COMMAND
from relaxations.commands import Command
from relaxations.errors import CommandError, RelaxationsError
from relaxations.shaping.shapers import Shaper, shape
from relaxations.shaping.splines import FORMAT as SPLINE
from relaxations.shaping.splines import Spline, shape_spline
from reports.files import json_bytes
from suite.decays import table_series
from suite.errors import SuiteError
from suite.sources import read_json

PER_PIECE = 20  # rows of a table in each piece that is no line
TABLES = (".csv", ".tsv", ".txt")
LARGEST = 2**28  # bytes


@dataclass(frozen=True, slots=True)
class Reference:
    """What is shaped, of the kind "command", "spline" or "samples"; the last are lines between them."""

    kind: str
    file: Path
    course: Command | Spline


@dataclass(frozen=True, slots=True)
class ShapedReference:
    """What became of a reference: the file, from when to when it moves [s], how many instants it has at which a derivative jumps."""

    reference: Reference
    file: Path
    begin: float
    end: float
    communication_points: int
    degree: int | None

    def to_dict(self) -> dict[str, Any]:
        """The member `shaped` of `shaper --json` (docs/schemas.md)."""
        return {
            "reference": str(self.reference.file),
            "kind": self.reference.kind,
            "file": str(self.file),
            "from": self.begin,
            "until": self.end,
            "degree": self.degree,
            "communication_points": self.communication_points,
        }


def read_reference(file: Path) -> Reference:
    """A command or spline file (JSON), or a table of samples. Raises `SuiteError`, `CommandError`, `OSError`."""
    if file.stat().st_size > LARGEST:
        raise SuiteError(f"{file} has more than {LARGEST} bytes")
    if file.suffix in TABLES:
        _, times, values, _ = table_series(file, None)
        return Reference("samples", file, Spline.through(times, values, degree=1))
    data = read_json(file, f"command or spline file (or a table: {', '.join(TABLES)})")
    made = data.get("format") if isinstance(data, dict) else None
    if made == SPLINE:
        return Reference("spline", file, Spline.from_dict(data))
    if made == COMMAND:
        return Reference("command", file, Command.from_dict(data))
    raise CommandError(f'{file} has the "format" {made!r}; a reference is "{COMMAND}", "{SPLINE}", or a table ({", ".join(TABLES)})')


def reference_of(file: Path | None, wrong: list[str]) -> Reference | None:
    """`read_reference`, with what is wrong with it among the mistakes of the command."""
    try:
        return None if file is None else read_reference(file)
    except OSError as problem:
        wrong.append(f"--reference {file}: cannot be read: {problem.strerror or problem}")
    except (SuiteError, RelaxationsError) as problem:
        wrong.append(f"--reference: {problem}")
    return None


def mistakes(reference: Path | None, shaped: Path | None) -> Iterator[str]:
    """One without the other, and endings that say nothing."""
    if (reference is None) != (shaped is None):
        given, other = ("--shaped", "--reference") if reference is None else ("--reference", "--shaped")
        yield f"{given} goes with {other}, which is missing: what is shaped, and where to write what becomes of it"
    if shaped is not None and shaped.suffix not in (".json", ".csv"):
        yield f"--shaped {shaped}: must end in .json (a command or a spline) or .csv (a table of a spline or of samples)"


def shaped_file(reference: Reference, shaper: Shaper, file: Path) -> tuple[ShapedReference, bytes]:
    """Shape it; and the content of a command or spline file, or of a table of a spline: rows at every knot (two where the value jumps) and
    between.

    Before a command the input is 0. Raises `ShaperError`, `CommandError`, `SuiteError`.
    """
    course = reference.course
    if isinstance(course, Spline):
        done = shape_spline(course, shaper)
        content = _table(done).encode() if file.suffix == ".csv" else json_bytes(done.to_dict())
        found = ShapedReference(reference, file, float(done.knots[0]), float(done.knots[-1]), len(done.communication_points), done.degree)
    else:
        made = shape(course, shaper)
        if file.suffix == ".csv":
            raise SuiteError(f"--shaped {file}: what becomes of a command is a command, and written as .json")
        content = json_bytes(made.to_dict())
        found = ShapedReference(reference, file, made.start, made.end, len(made.breakpoints), None)
    return found, content


def _table(spline: Spline) -> str:
    curved = np.abs(spline.coefficients[:, 2:]).sum(axis=1) > 0.0 if spline.degree > 1 else np.zeros(len(spline.coefficients), dtype=bool)
    lines = ["time [s],value"]
    jumped = set(spline.jumps(0)[0].tolist())
    before = spline.rest
    for start, end, piece, bent in zip(spline.knots[:-1].tolist(), spline.knots[1:].tolist(), spline.coefficients, curved, strict=True):
        if start in jumped:
            lines.append(f"{start!r},{before!r}")
        at = np.linspace(0.0, end - start, PER_PIECE + 1 if bent else 2)
        values = np.polynomial.polynomial.polyval(at, piece)
        lines += [f"{start + float(t)!r},{float(y)!r}" for t, y in zip(at[:-1], values[:-1], strict=True)]
        before = float(values[-1])
    lines.append(f"{float(spline.knots[-1])!r},{before!r}")
    return "\n".join(lines) + "\n"
