"""The evidence folder before the runs: whether it may be used, and what of an earlier campaign stays in it.

Nothing is ever deleted that this program did not write.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from reports import manifest
from reports.errors import ManifestError
from suite.campaign import RUNS
from suite.errors import SuiteError
from suite.evidence import JUNIT, LAYOUT, REPORT, RESULTS
from suite.ledger import Ledger
from suite.study import Study

LEDGER = "ledger.sqlite"
TO_RESUME = ("study.toml", f"{LEDGER}*", f"{RUNS}/*.mcap")
WRITTEN = (
    *(*TO_RESUME, manifest.NAME, RESULTS, REPORT, JUNIT, "certificate.json", "certificate.grid.json", "attestation.json"),
    *(f"{RUNS}/{LAYOUT}", "plant/modelDescription.xml", "plant/twin.toml", "plant/hashes.json"),
    *(".*.tmp", f"{RUNS}/.*.tmp", "plant/.*.tmp"),  # left by a process that was killed while it wrote
)
"""What a campaign goes on from, and everything that may lie in an evidence folder: nothing else is ever deleted."""


class FolderError(SuiteError):
    """The output folder cannot be used as asked."""


def check(folder: Path, study: Study, *, resume: bool, force: bool) -> None:
    """Raise `FolderError` unless the folder can be used: what exists is kept unless it is ours and `resume` or `force` was asked for."""
    if folder.exists() and not folder.is_dir():
        raise FolderError(f"{folder} is a file; the evidence needs a folder of its own")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if not _is_ours(folder):
        raise FolderError(f"{folder} is not empty and holds no evidence of ours: it is left alone; choose another --out")
    if strangers := sorted(path for path in _files(folder) if not _matches(path, WRITTEN)):
        named = ", ".join(strangers[:3]) + (f" and {len(strangers) - 3} more" if len(strangers) > 3 else "")
        raise FolderError(f"{folder} holds what is no part of the evidence ({named}): move it away, or choose another --out")
    if resume:
        kept = folder / "study.toml"
        if kept.is_file() and kept.read_bytes() != study.source:
            raise FolderError(f"{folder} belongs to another study (its study.toml differs from {study.file}): use --force or another --out")
    elif not force:
        raise FolderError(f"{folder} exists: --resume continues its runs, --force replaces it, --out DIR writes elsewhere")


def prepare(folder: Path, study: Study, *, resume: bool, force: bool) -> None:
    """Make the folder ready for the runs, or raise `FolderError` as `check` does."""
    check(folder, study, resume=resume, force=force)
    folder.mkdir(parents=True, exist_ok=True)
    # The ledger tells that the folder is ours: it goes last and comes first. A result or manifest of before must not stand beside new runs.
    for path in sorted(_files(folder), key=lambda path: path.startswith(LEDGER)):
        if not (resume and _matches(path, TO_RESUME)) or path.endswith(".tmp"):  # `*` matches the dot of a hidden name too
            (folder / path).unlink()
    with Ledger(folder / LEDGER):
        pass


def _is_ours(folder: Path) -> bool:
    if (folder / LEDGER).is_file():
        return True
    try:
        manifest.read_manifest(folder)
    except ManifestError:
        return False
    return True


def _files(folder: Path) -> list[str]:
    """Paths of everything below the folder that is no folder itself; links are not followed."""
    return [
        (Path(root) / name).relative_to(folder).as_posix()
        for root, folders, names in os.walk(folder)
        for name in (*names, *(name for name in folders if (Path(root) / name).is_symlink()))
    ]


def _matches(path: str, patterns: Sequence[str]) -> bool:
    parts = path.split("/")
    return any(len(parts) == len(wanted) and all(map(fnmatchcase, parts, wanted)) for wanted in (p.split("/") for p in patterns))
