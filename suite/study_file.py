"""From a file to a table: everything that can be wrong with a study before its first key is looked at."""

from __future__ import annotations

import difflib
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

from suite.errors import ABSENT, Mistake, StudyError

LARGEST_FILE = 16 * 2**20  # [bytes]; matrices of a few hundred states fit, a log opened by mistake does not fill the memory


def read_source(file: Path) -> bytes:
    """The file's bytes; raises `StudyError` if there is no such file, or it cannot be a study."""
    try:
        if file.is_dir():
            raise _error(file, "is a folder; a study is a TOML file")
        if file.stat().st_size > LARGEST_FILE:
            raise _error(file, f"has {file.stat().st_size} bytes; a study is a text file of at most {LARGEST_FILE}")
        return file.read_bytes()
    except FileNotFoundError:
        raise _error(file, f"no such file{_neighbours(file)}") from None
    except (OSError, ValueError) as problem:  # ValueError: a NUL in the path
        raise _error(file, f"cannot be read: {getattr(problem, 'strerror', None) or problem}") from None


def parse(file: Path, source: bytes) -> dict[str, Any]:
    """The file's table, decimals kept exact; raises `StudyError` naming the line where TOML ends."""
    try:
        text = source.decode("utf-8")
    except UnicodeDecodeError as problem:
        line = source.count(b"\n", 0, problem.start) + 1
        raise _error(file, f"is not UTF-8 text (byte 0x{source[problem.start]:02x} in line {line}); a study is a TOML file") from None
    if "\0" in text:
        raise _error(file, "holds zero bytes: this is no text file; a study is a TOML file")
    try:
        return tomllib.loads(text.removeprefix("\ufeff"), parse_float=Decimal)
    except tomllib.TOMLDecodeError as problem:
        raise _error(file, f"is not valid TOML: {problem}{_quoted(text, problem)}") from None
    except RecursionError:
        raise _error(file, "is not a study: its brackets are nested too deeply") from None
    except ValueError:  # Python refuses to convert integers of thousands of digits
        raise _error(file, "holds a whole number of thousands of digits") from None


def printable(name: str) -> str:
    """A file's name with question marks for bytes that are no UTF-8: evidence is text."""
    return name.encode("utf-8", "replace").decode()


def _error(file: Path, message: str) -> StudyError:
    return StudyError(str(file), [Mistake("", ABSENT, message)])


def _neighbours(file: Path) -> str:
    try:
        studies = sorted(entry.name for entry in file.parent.glob("*.toml"))
    except OSError:
        return ""
    studies = sorted(studies, key=lambda name: -difflib.SequenceMatcher(None, file.name, name).ratio())[:8]  # the likeliest first
    return f"; beside it are {', '.join(studies)}" if studies else ""


def _quoted(text: str, problem: tomllib.TOMLDecodeError) -> str:
    """The line that the parser complains about; its message says `(at line N, column M)`."""
    words = str(problem).rpartition("at line ")[2].split(",")[0]
    lines = text.splitlines()
    if not words.isdigit() or not 0 < int(words) <= len(lines):
        return ""
    return f': "{lines[int(words) - 1].strip()[:80]}"'
