"""Brackets of minimum times: of one study, or of a whole collection of problems as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from relaxations.bounds import Status
from reports.files import write_atomically
from suite import weighing
from suite.bound_records import bound_record
from suite.design import Design, design, least_fuel_words
from suite.errors import SuiteError
from suite.loading import load_study
from suite.study import Study


class CollectionError(SuiteError):
    """A folder without studies was given."""


@dataclass(frozen=True, slots=True)
class Bracketed:
    """A study with its design; `certificate` is the file that the proof was written to, if any.

    `proof` is the file of what else is proven: that the study's budget of fuel is too little, or the least cost.
    """

    study: Study
    design: Design
    certificate: Path | None
    proof: Path | None = None

    @property
    def impossible(self) -> bool:
        """Whether it is proven that no command does it."""
        return self.design.bound.status is Status.IMPOSSIBLE

    @property
    def told(self) -> Iterator[str]:
        """What else is proven, in words: the fuel that every command needs, where the study's budget is too little; the least cost."""
        plant, least, found = self.study.plant, self.design.least, self.design.weighed
        if least is not None:
            yield f"least fuel: {least_fuel_words(least, plant.input_unit)}"
        if found is not None:
            yield from weighing.lines(found, float(plant.initial_input), f"{plant.input_unit or 'input'}·s")

    def to_dict(self) -> dict[str, object]:
        """The object of `bound --json` (docs/schemas.md)."""
        bound, rest = self.design.bound, float(self.study.plant.initial_input)
        record = bound_record(bound, bound.command, rest, None if self.certificate is None else str(self.certificate))
        if self.design.least is not None:
            record["least_fuel"] = {"lower": self.design.least, "certificate": None if self.proof is None else str(self.proof)}
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
    content = made.bound.certificate
    if certificate is None or content is None:
        return Bracketed(study, made, None)
    write_atomically(certificate, content)
    stem, proof = certificate.name.removesuffix(".json"), None
    if made.short is not None:
        proof = certificate.with_name(f"{stem}.least-fuel.json")
        write_atomically(proof, made.short.certificate)
    if made.weighed is not None and made.weighed.certificate is not None:
        proof = certificate.with_name(f"{stem}.cost.json")
        write_atomically(proof, made.weighed.certificate)
    return Bracketed(study, made, certificate, proof)
