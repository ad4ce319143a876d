"""Reading a study: the TOML file, its meaning, and every mistake at once."""

from __future__ import annotations

from pathlib import Path

from suite.errors import StudyError
from suite.study import Study
from suite.study_file import parse, read_source
from suite.study_meaning import understand


def load_study(path: Path | str) -> Study:
    """The study in a TOML file. Opens its FMU (a shipped one is built if need be) but runs none of its code.

    Raises `StudyError` with every mistake that could be found: wrong syntax, unknown keys, values out of range, keys that contradict each
    other or the FMU, and keys whose meaning this version cannot honour.
    """
    file = Path(path)
    source = read_source(file)
    study, mistakes = understand(parse(file, source), file, source)
    if study is None or mistakes:
        raise StudyError(str(file), mistakes)
    return study
