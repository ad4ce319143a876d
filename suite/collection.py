"""Brackets of minimum times: of one study, or of a whole collection of problems as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_FLOOR
from pathlib import Path

from relaxations.bounds import Status
from relaxations.onoff.enough import TooLittle, too_little
from reports.files import write_atomically
from suite import weighing
from suite.bound_records import bound_record
from suite.design import Design, design
from suite.errors import SuiteError
from suite.loading import load_study
from suite.rounding import outward
from suite.study import Study


class CollectionError(SuiteError):
    """A folder without studies was given."""


@dataclass(frozen=True, slots=True)
class Bracketed:
    """A study with its design; `certificate` is the file that the proof was written to, if any.

    `short` is the most fuel that is proven to be too little, where the study's own budget is, and `proof` the file that says so, or that
    of the least cost.
    """

    study: Study
    design: Design
    certificate: Path | None
    short: TooLittle | None = None
    proof: Path | None = None

    @property
    def impossible(self) -> bool:
        """Whether it is proven that no command does it."""
        return self.design.bound.status is Status.IMPOSSIBLE

    @property
    def least(self) -> str | None:
        """What every command needs of fuel, in words, where the study's budget is too little."""
        if self.short is None:
            return None
        needed = f"{outward(self.short.below, ROUND_FLOOR)} {self.study.plant.input_unit or 'input'}·s"
        return f"least fuel: every command needs {needed} or more, however long it takes (proved)"

    def to_dict(self) -> dict[str, object]:
        """The object of `bound --json` (docs/schemas.md)."""
        bound, rest = self.design.bound, float(self.study.plant.initial_input)
        record = bound_record(bound, bound.command, rest, None if self.certificate is None else str(self.certificate))
        if self.short is not None:
            record["least_fuel"] = {"lower": self.short.below, "certificate": None if self.proof is None else str(self.proof)}
        if self.design.weighed is not None:
            record["weighted"] = weighing.record(self.design.weighed, rest, None if self.proof is None else str(self.proof))
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
    """Bracket one study's minimum time; what was proven is written to `certificate`, of the least fuel or cost beside it.

    Raises `StudyError`, `OSError`.
    """
    study = load_study(file)
    made = design(study)
    short = too_little(made.problem) if made.bound.status is Status.IMPOSSIBLE else None
    content = made.bound.certificate
    if certificate is None or content is None:
        return Bracketed(study, made, None, short)
    write_atomically(certificate, content)
    stem, proof = certificate.name.removesuffix(".json"), None
    if short is not None:
        proof = certificate.with_name(f"{stem}.least-fuel.json")
        write_atomically(proof, short.certificate)
    if made.weighed is not None and made.weighed.certificate is not None:
        proof = certificate.with_name(f"{stem}.cost.json")
        write_atomically(proof, made.weighed.certificate)
    return Bracketed(study, made, certificate, short, proof)
