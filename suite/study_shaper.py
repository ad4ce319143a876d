"""`command.kind = "shaper"`: from the keys as written to the request as meant."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import TypeVar

from relaxations.commands import Command
from relaxations.errors import RelaxationsError, ShaperError
from relaxations.shaping.kinds import KINDS, find, mistakes
from relaxations.shaping.requests import BAND, TOLERANCE, Request
from relaxations.shaping.shapers import Shaper
from suite import schema, sources
from suite.errors import ABSENT, Mistake, SuiteError
from suite.shaping import band_of, impulses_of, mode_of
from suite.study import ShaperRequest
from suite.study_plant import PlantNames
from suite.suggestions import did_you_mean

R = TypeVar("R")


def understand_shaper(written: schema.Command, folder: Path, known_names: PlantNames | None, wrong: list[Mistake]) -> ShaperRequest | None:
    """What the keys mean, or None and what is wrong with them."""
    if written.shaper is None:
        return None
    before = len(wrong)
    modes = [_read(lambda text=text: mode_of(text), text, f"command.modes[{i}]", wrong) for i, text in enumerate(written.modes or (), 1)]
    if written.modes == ():
        wrong.append(Mistake("command.modes", [], "is empty; without this key the modes are those of the plant"))
    tolerance = TOLERANCE if written.tolerance is None else float(written.tolerance)
    bands = [_read(lambda text=text: band_of(text, tolerance), text, f"command.bands[{i}]", wrong)
             for i, text in enumerate(written.bands or (), 1)]  # fmt: skip
    request = Request(
        modes=tuple(mode for mode in modes if mode),
        tolerance=tolerance,
        band=BAND if written.band is None else _pair(written.band),
        negative=_float(written.negative),
        sums=None if written.sums is None else _pair(written.sums),
        sample_time=_float(written.sample_time),
        simultaneous=bool(written.simultaneous),
        bands=tuple(band for band in bands if band),
        pulse=_float(written.pulse),
        height=_float(written.height),
        deflection=_float(written.deflection),
        impulses=None if written.impulses is None else _impulses(written.impulses, folder, wrong),
    )
    try:
        kind, _ = find(written.shaper)
        for option, problem in mistakes(kind, written.shaper, request):
            value = getattr(written, option)
            wrong.append(Mistake(f"command.{option}", ABSENT if value is None else value, problem))
    except ShaperError as problem:
        names = [name for kind in KINDS for name in kind.written.split(", ")]
        wrong.append(Mistake("command.shaper", written.shaper, f"{problem}{did_you_mean(written.shaper, names)}"))
    reference = written.reference
    known = reference if reference in ("step", "rigid", None) else read_command(reference, folder, "command.reference", wrong)
    follow = None if written.follow is None else _follow(written, known_names, wrong)
    if len(wrong) > before:
        return None
    damping = None if written.damping is None else _pair(written.damping)
    return ShaperRequest(written.shaper, request, damping, known, follow)


def read_command(file: str, folder: Path, place: str, wrong: list[Mistake]) -> Command | None:
    """A command file that a study names at `place`; None and a mistake if it is none."""
    path = (folder / file).expanduser()
    try:
        return sources.read_command(path)
    except OSError as problem:
        wrong.append(Mistake(place, file, f"{path} cannot be read: {problem.strerror}"))
    except SuiteError as problem:
        wrong.append(Mistake(place, file, str(problem)))
    return None


def _read(read: Callable[[], R], value: object, place: str, wrong: list[Mistake]) -> R | None:
    try:
        return read()
    except OSError as problem:
        wrong.append(Mistake(place, value, f"{problem.filename} cannot be read: {problem.strerror}"))
    except (ValueError, RelaxationsError, SuiteError) as problem:
        wrong.append(Mistake(place, value, str(problem)))
    return None


def _impulses(text: str, folder: Path, wrong: list[Mistake]) -> Shaper | None:
    file = str((folder / text).expanduser()) if text.endswith(".json") else text
    return _read(lambda: impulses_of(file), text, "command.impulses", wrong)


def _follow(
    written: schema.Command, names: PlantNames | None, wrong: list[Mistake]
) -> tuple[str, tuple[float, ...], tuple[Decimal, ...]] | None:
    assert written.follow is not None
    asked, place, before = written.follow, "command.follow", len(wrong)
    times = tuple(float(time) for time in asked.times)
    if written.modes is not None:
        wrong.append(Mistake(f"{place}", ABSENT, "contradicts modes: what is followed are the plant's own"))
    if len(times) < 2 or any(later <= earlier for earlier, later in itertools.pairwise(times)) or times[0] < 0.0:
        wrong.append(Mistake(f"{place}.times", list(asked.times), "must be two or more instants in seconds, ascending from 0 on"))
    if len(asked.values) != len(times):
        wrong.append(Mistake(f"{place}.values", list(asked.values), f"must be as many as the times, {len(times)}"))
    try:
        if names is not None:
            names.parameter(asked.parameter)
        elif len(wrong) == before:
            wrong.append(Mistake(f"{place}.parameter", asked.parameter, "is no parameter: a plant given as numbers has none"))
    except ValueError as problem:
        wrong.append(Mistake(f"{place}.parameter", asked.parameter, str(problem)))
    return (asked.parameter, times, asked.values) if len(wrong) == before else None


def _float(number: Decimal | None) -> float | None:
    return None if number is None else float(number)


def _pair(interval: tuple[Decimal, Decimal]) -> tuple[float, float]:
    return float(interval[0]), float(interval[1])
