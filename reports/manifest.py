"""The manifest of an evidence folder: SHA-256 and size of every file, so that a reviewer sees what is missing, changed or added."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path, PurePosixPath

from reports.errors import ManifestError
from reports.files import json_bytes, write_atomically

FORMAT = "slewcert-manifest/1"
NAME = "manifest.json"
UNLISTED = (NAME, "attestation.json")
"""Files that a manifest cannot list: itself, and the attestation that signs it."""


class FileState(StrEnum):
    """What became of a file since the manifest was written."""

    OK = "ok"
    MISSING = "missing"
    CHANGED = "changed"
    UNLISTED = "unlisted"


@dataclass(frozen=True, slots=True)
class FileStatus:
    """A file's path within the folder (with slashes) and its state."""

    path: str
    status: FileState


def write_manifest(folder: str | os.PathLike[str], extra: Mapping[str, object]) -> Path:
    """List every file of `folder` in its `manifest.json`, beside the members of `extra` (versions, settings, seed …).

    Raises `ManifestError` for a link or a special file (its content lies elsewhere, or nowhere) and for an `extra` that uses our names.
    """
    folder = Path(folder)
    if taken := {"format", "files"} & set(extra):
        raise ManifestError(f"the manifest's own members cannot be given: {', '.join(sorted(taken))}")
    files = []
    for path in _files(folder):
        full = folder / path
        if full.is_symlink() or not full.is_file():
            raise ManifestError(f"{full} is a link or no regular file: an evidence folder holds the files themselves")
        digest, size = _digest(full)
        files.append({"path": path, "sha256": digest, "size": size})
    target = folder / NAME
    write_atomically(target, json_bytes({"format": FORMAT, **extra, "files": files}))
    return target


def read_manifest(folder: str | os.PathLike[str]) -> dict[str, object]:
    """The manifest's members; `files` is known to be well formed. Raises `ManifestError`."""
    path = Path(folder) / NAME
    try:
        data = json.loads(path.read_bytes(), object_pairs_hook=_no_duplicates)
    except FileNotFoundError:
        raise ManifestError(f"{path} is missing: this is no complete evidence folder") from None
    except (ValueError, RecursionError, OSError) as problem:
        raise ManifestError(f"{path} cannot be read: {problem}") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise ManifestError(f'{path}: a manifest has "format": "{FORMAT}"; this one has {found!r}')
    _listed(data)
    return data


def check_manifest(folder: str | os.PathLike[str]) -> list[FileStatus]:
    """Compare the folder with its manifest: one status for each file that is listed or there, by path. Raises `ManifestError`."""
    folder = Path(folder)
    listed = _listed(read_manifest(folder))
    present = set(_files(folder))
    statuses = []
    for path in sorted(set(listed) | present):
        if path not in present:
            state = FileState.MISSING
        elif path not in listed:
            state = FileState.UNLISTED
        else:
            state = FileState.OK if _matches(folder / path, listed[path]) else FileState.CHANGED
        statuses.append(FileStatus(path, state))
    return statuses


def _matches(path: Path, expected: tuple[str, int]) -> bool:
    # A link is a change even if its target has the right bytes: the folder alone must hold the evidence.
    return not path.is_symlink() and path.is_file() and _digest(path) == expected


def _digest(path: Path) -> tuple[str, int]:
    with open(path, "rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return digest, stream.tell()


def _files(folder: Path) -> Iterator[str]:
    """Paths of everything below `folder` that is no folder, sorted, without following links."""
    found: list[str] = []
    for root, folders, names in os.walk(folder):
        names += [f for f in folders if (Path(root) / f).is_symlink()]
        found += [(Path(root) / name).relative_to(folder).as_posix() for name in names]
    return iter(sorted(path for path in found if path not in UNLISTED))


def _listed(data: Mapping[str, object]) -> dict[str, tuple[str, int]]:
    files = data.get("files")
    if not isinstance(files, list):
        raise ManifestError("a manifest has a list of files")
    listed: dict[str, tuple[str, int]] = {}
    for entry in files:
        match entry:
            case {"path": str(path), "sha256": str(digest), "size": int(size)} if _stays_inside(path) and path not in listed:
                listed[path] = (digest, size)
            case _:
                raise ManifestError(
                    f"a manifest's file has a path within the folder, given once, its sha256 and size; this one is {entry!r}"
                )
    return listed


def _stays_inside(path: str) -> bool:
    pure = PurePosixPath(path)
    return bool(pure.parts) and not pure.is_absolute() and ".." not in pure.parts and pure.as_posix() == path and "\\" not in path


def _no_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise ValueError("a member is given twice")
    return members
