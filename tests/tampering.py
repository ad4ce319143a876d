"""Ways to change evidence, by accident or with everything told accordingly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result
from small_studies import results

from reports import logs, manifest
from reports.files import json_bytes, sha256
from reports.records import RunLog
from suite.cli import main


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["review", *map(str, arguments)], catch_exceptions=False)


def flip(path: Path, place: float = 0.5) -> None:
    """One bit of the byte at this fraction of the file."""
    content = bytearray(path.read_bytes())
    content[int(place * (len(content) - 1))] ^= 1
    path.write_bytes(content)


def close(folder: Path) -> None:
    """Write the manifest anew, as somebody does who knows how."""
    extra = {name: value for name, value in manifest.read_manifest(folder).items() if name not in ("format", "files")}
    manifest.write_manifest(folder, extra)


def rewrite(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change the results, and the manifest with them."""
    found = results(folder)
    change(found)
    (folder / "results.json").write_bytes(json_bytes(found))
    close(folder)


def relog(folder: Path, name: str, change: Callable[[RunLog], RunLog], row: Mapping[str, Any] | None = None) -> None:
    """Change a log, its hash in the results (and what else `row` says of it there), and the manifest."""
    logs.write_log(folder / "runs" / f"{name}.mcap", change(logs.read_log(folder / "runs" / f"{name}.mcap")))

    def retell(found: dict[str, Any]) -> None:
        entry = next(entry for entry in found["run_table"] if entry["run"] == name)
        entry.update(row or {}, sha256=sha256(folder / "runs" / f"{name}.mcap"))

    rewrite(folder, retell)
