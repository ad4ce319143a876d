"""Where a command writes, looked at before anything is computed: nothing that it reads may be replaced."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click


def refuse_overwriting(context: click.Context) -> None:
    """Raises `click.UsageError` for an output option that names a file which the command reads, or that a study of it names.

    Options whose file must exist are read, others are written.
    """
    outputs: list[tuple[str, Path]] = []
    inputs: set[Path] = set()
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        values = [Path(one) for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, (str, Path))]
        kind = parameter.type
        if isinstance(parameter, click.Option) and isinstance(kind, click.Path) and not kind.exists:
            outputs += [(parameter.opts[0], path) for path in values]
        else:
            inputs |= {path for path in values if _is_file(path)}
    written = [(option, path) for option, path in outputs if _is_file(path)]
    if not written:
        return
    inputs |= {named for path in inputs if path.suffix == ".toml" for named in _named(path)}
    for option, path in written:
        if any(path.samefile(read) for read in inputs):
            raise click.UsageError(f"{option} {path}: would overwrite a file that the command reads; name another file")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, or with a null character, is no file
        return False


def _named(study: Path) -> set[Path]:
    """Files that a study names, relative to it: the FMU, the command's file; none of one that cannot be read, which its reader tells."""
    try:
        record = tomllib.loads(study.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return set()
    return {file for text in _texts(record) if _is_file(file := study.parent / text)}


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for one in value.values():
            yield from _texts(one)
    elif isinstance(value, list):
        for one in value:
            yield from _texts(one)
