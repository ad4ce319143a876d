"""Where a command writes, looked at before anything is computed: it can be written, and nothing that it reads is replaced."""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click


def refuse_overwriting(context: click.Context) -> None:
    """Raises `click.UsageError` for an output option that names a file which the command reads, that a study of it names, or that another
    output option names.

    Options whose file must exist are read, others are written.
    """
    outputs, inputs = _paths(context)
    taken: dict[str, str] = {}
    folders = {one.opts[0] for one in context.command.params if isinstance(one.type, click.Path) and one.type.dir_okay}
    for option, path in [one for one in outputs if one[0] not in folders]:
        other = taken.setdefault(os.path.realpath(path), option)
        if other != option:
            raise click.UsageError(f"{option} {path}: would overwrite what {other} writes there; name another file")
    written = [(option, path) for option, path in outputs if _is_file(path)]
    if not written:
        return
    inputs |= {named for path in inputs if path.suffix == ".toml" for named in _named(path)}
    for option, path in written:
        if any(path.samefile(read) for read in inputs):
            raise click.UsageError(f"{option} {path}: would overwrite a file that the command reads; name another file")


def refuse_unwritable(context: click.Context) -> None:
    """Raises `click.UsageError` for an output option whose file or folder cannot be written, hours before it would be.

    Missing folders are made when the file is written, so that the nearest folder that exists decides: a file without a name is made
    in it, since permissions alone do not tell of read-only and special file systems. What is neither file nor folder would be replaced.
    """
    for option, path in _paths(context)[0]:
        try:
            if path.exists() and not (path.is_file() or path.is_dir()):
                raise click.UsageError(f"{option} {path}: is neither a file nor a folder, and would be replaced; name another file")
            folder = path if path.is_dir() else _nearest(path.absolute().parent)
            if not folder.is_dir():
                raise click.UsageError(f"{option} {path}: {folder} is not a folder; name a file in a folder that exists or can be made")
            with tempfile.TemporaryFile(dir=folder):
                pass
        except (OSError, ValueError) as problem:
            why = problem.strerror if isinstance(problem, OSError) and problem.strerror else problem
            raise click.UsageError(f"{option} {path}: cannot be written ({why}); name a file in a folder that can be written") from None


def _nearest(folder: Path) -> Path:
    """The folder itself or the nearest above it that exists; a link that leads nowhere exists, since no folder can be made there."""
    return next(one for one in (folder, *folder.parents) if os.path.lexists(one))


def _paths(context: click.Context) -> tuple[list[tuple[str, Path]], set[Path]]:
    """Options and paths that a command writes; files that it reads."""
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
    return outputs, inputs


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
