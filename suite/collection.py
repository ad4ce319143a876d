"""Brackets of minimum times: of one study, or of a whole collection of problems as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relaxations.bounds import Status
from reports.files import write_atomically
from suite.bound_records import bound_record
from suite.design import Design, design
from suite.errors import SuiteError
from suite.loading import load_study
from suite.study import Study


class CollectionError(SuiteError):
    """A folder without studies was given."""


@dataclass(frozen=True, slots=True)
class Bracketed:
    """A study with its design; `certificate` is the file that the proof was written to, if any."""

    study: Study
    design: Design
    certificate: Path | None

    @property
    def impossible(self) -> bool:
        """Whether it is proven that no command does it."""
        return self.design.bound.status is Status.IMPOSSIBLE

    def to_dict(self) -> dict[str, object]:
        """The object of `bound --json` (docs/schemas.md)."""
        bound, rest = self.design.bound, float(self.study.plant.initial_input)
        record = bound_record(bound, bound.command, rest, None if self.certificate is None else str(self.certificate))
        made = self.design.cancelled
        return record if made is None else {**record, "prefilter": {**made.to_dict(), "command": made.command.to_dict()}}


def collect(paths: Sequence[Path]) -> list[Path]:
    """The study files that paths name: files as they are, of a folder every `.toml` in it; raises `CollectionError` for an empty folder."""
    files: list[Path] = []
    for path in paths:
        found = sorted(path.glob("*.toml")) if path.is_dir() else [path]
        if not found:
            raise CollectionError(f"{path} holds no study (no file *.toml)")
        files += found
    return files


def bracket(file: Path, certificate: Path | None = None) -> Bracketed:
    """Bracket one study's minimum time; what was proven is written to `certificate`. Raises `StudyError`, `OSError`."""
    study = load_study(file)
    made = design(study)
    content = made.bound.certificate
    if certificate is not None and content is not None:
        write_atomically(certificate, content)
        return Bracketed(study, made, certificate)
    return Bracketed(study, made, None)
