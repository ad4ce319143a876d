"""Command, shaper and filter files, read in one place by all that takes them: `simulate`, studies, `fmus export`, given impulses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relaxations import commands
from relaxations.cancelling import prefilters
from relaxations.cancelling.prefilters import Prefilter
from relaxations.commands import Command
from relaxations.errors import RelaxationsError
from relaxations.shaping import shapers
from relaxations.shaping.shapers import Shaper
from suite.errors import SuiteError

SPLINE = "slewcert-spline/1"


def _lines(data: Mapping[str, object]) -> Command:
    """A spline as lines within 1e-6 of its excursion, with a switch at every knot."""
    from relaxations.shaping.splines import Spline

    return Spline.from_dict(data).lines()


READERS = {commands.FORMAT: Command.from_dict, shapers.FORMAT: Shaper.from_dict, prefilters.FORMAT: Prefilter.from_dict, SPLINE: _lines}
NAMES = {commands.FORMAT: "command", shapers.FORMAT: "shaper", prefilters.FORMAT: "filter"}


class SourceError(SuiteError):
    """A file that is no command or shaper file."""


def read_json(path: Path, what: str) -> Any:
    """What a JSON file holds; of what `slewcert bound --json` printed the command. Raises `SourceError`, `OSError`."""
    if path.is_dir():
        raise SourceError(f"{path} is a folder, not a {what}")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise SourceError(f"{path} is no text file; a {what} is JSON") from None
    except (ValueError, RecursionError) as problem:  # numbers of thousands of digits and nesting without end are refused too
        raise SourceError(f"{path} is no {what}, which is JSON: {problem}") from None
    if isinstance(data, Mapping) and "format" not in data and "command" in data:
        data = data["command"]
        if data is None:
            raise SourceError(f"{path} is the answer of a study without a command: there is none in it")
    return data


def read_any(path: Path, formats: tuple[str, ...] = tuple(NAMES)) -> Command | Shaper | Prefilter:
    """A file of one of the `formats`; of a spline lines. Raises `SourceError`, `OSError`."""
    what = ", ".join(NAMES[name] for name in formats[:-1]) + (" or " if formats[1:] else "") + NAMES[formats[-1]] + " file"
    data = read_json(path, what)
    found = data.get("format") if isinstance(data, Mapping) else None
    if not isinstance(found, str) or not (found in formats or (found == SPLINE and commands.FORMAT in formats)):
        hint = ""
        if found is None and isinstance(data, Mapping) and "amplitudes" in data and "times" in data:
            hint = "; it looks like what `slewcert shaper --json` prints: `slewcert shaper … --save FILE` writes a shaper file"
        raise SourceError(f'{path} is no {what}: its "format" is {found!r}, not {" or ".join(map(repr, formats))}{hint}')
    try:
        return READERS[found](data)
    except RelaxationsError as problem:
        raise SourceError(f"{path}: {problem}") from None


def read_command(path: Path) -> Command:
    """A command file, or what `slewcert bound --json` printed. Raises `SourceError`, `OSError`."""
    found = read_any(path, (commands.FORMAT,))
    assert isinstance(found, Command)
    return found


def read_shaper(path: Path) -> Shaper:
    """A shaper file. Raises `SourceError`, `OSError`."""
    found = read_any(path, (shapers.FORMAT,))
    assert isinstance(found, Shaper)
    return found
