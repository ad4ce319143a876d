"""What can be wrong with a request to `suite`.

    SuiteError
    └── StudyError       the study file cannot be used; holds every `Mistake` that was found in it

A requirement that fails is no error but a verdict, and so is a run that could not be finished.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class _Absent(Enum):
    """One object that stays itself in another process."""

    ABSENT = "absent"


ABSENT = _Absent.ABSENT
"""The value of a key that is not in the file (`None` would be a value)."""

VALUE_LENGTH = 60  # a message names the value, it does not repeat a matrix


class SuiteError(Exception):
    """Base of everything this package raises on purpose."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One thing that is wrong in a study: where (dotted path, items counted from 1), what stands there, and what would be valid."""

    path: str
    value: object
    message: str

    def __str__(self) -> str:
        place = self.path if self.value is ABSENT else f"{self.path} = {written(self.value)}"
        return f"{place}: {self.message}" if place else self.message


class StudyError(SuiteError):
    """A study that cannot be used: `file` and all `mistakes`, in the order of the file's sections."""

    def __init__(self, file: str, mistakes: Iterable[Mistake]) -> None:
        self.file = file
        self.mistakes = tuple(mistakes)
        super().__init__(file, self.mistakes)

    def __str__(self) -> str:
        if len(self.mistakes) == 1:
            return f"{self.file}: {self.mistakes[0]}"
        return "\n".join([f"{self.file}: {len(self.mistakes)} mistakes", *(f"  {mistake}" for mistake in self.mistakes)])

    def __reduce__(self) -> tuple[type[StudyError], tuple[str, tuple[Mistake, ...]]]:
        return StudyError, (self.file, self.mistakes)


def written(value: object) -> str:
    """A value as TOML writes it, cut to one short line."""
    match value:
        case bool():
            text = str(value).lower()
        case str():
            text = '"' + value.encode("unicode_escape").decode().replace('"', '\\"') + '"'
        case list() | tuple():
            text = "[" + ", ".join(written(item) for item in value) + "]"
        case dict():
            text = "{ " + ", ".join(f"{key} = {written(item)}" for key, item in value.items()) + " }"
        case _:
            text = str(value)
    return text if len(text) <= VALUE_LENGTH else text[: VALUE_LENGTH - 1] + "…"
