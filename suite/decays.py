"""`slewcert shaper --decay FILE`: the modes of a measured decay, from a table (CSV) or a log (MCAP)."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.decays import Decay, identify_decay
from fmus.errors import DecayError
from relaxations.errors import RelaxationsError
from reports import logs
from reports.errors import LogError, RecordError
from suite.errors import SuiteError
from suite.observations import observe

Reals = NDArray[np.float64]

LARGEST_FILE = 2**30  # [bytes]


@dataclass(frozen=True, slots=True)
class Measured:
    """A decay that was read: file, signal, and from when to when it was looked at [s]."""

    file: Path
    signal: str
    begin: float
    end: float
    decay: Decay

    def to_dict(self) -> dict[str, object]:
        """The member `decay` of `shaper --json` (docs/schemas.md)."""
        return {
            "file": str(self.file),
            "signal": self.signal,
            "from": self.begin,
            "until": self.end,
            "samples": self.decay.samples,
            "rest": self.decay.rest,
            "rms": self.decay.rms,
            "share": self.decay.share,
            "modes": [
                {
                    "frequency": found.mode.frequency,
                    "frequency_error": found.frequency_error,
                    "damping": found.mode.damping,
                    "damping_error": found.damping_error,
                    "amplitude": found.amplitude,
                }
                for found in self.decay.modes
            ],
        }


def measured_decay(file: Path, signal: str | None = None, begin: float | None = None, end: float | None = None) -> Measured:
    """The modes in `file` between two instants [s] (None: where the command of a log ends, else the start; the end).

    Raises `SuiteError` naming the file and what it has instead, `OSError`.
    """
    if file.stat().st_size > LARGEST_FILE:
        raise SuiteError(f"{file} has more than {LARGEST_FILE} bytes; cut the decay out of it")
    try:
        name, times, values, own = _log(file, signal) if file.suffix == ".mcap" else table_series(file, signal)
        if (falls := np.flatnonzero(np.diff(times) < 0.0)).size:
            before, after = times[falls[0] : falls[0] + 2].tolist()
            raise DecayError(f"its times [s] ascend in the order of the samples, but {after!r} follows {before!r}")
        first = own if begin is None else begin
        kept = (times >= first) & (times <= (math.inf if end is None else end))
        if not kept.any():
            raise DecayError(f"it has no sample from {first:g} s on{'' if end is None else f' until {end:g} s'}")
        times, values = times[kept], values[kept]
        once = np.append(True, np.diff(times) != 0.0)  # at a jump of the input a log has two rows
        if 2 * int(once.sum()) < len(times):
            raise DecayError(f"{len(times)} samples have {int(once.sum())} different times: they are rounded; write more of their digits")
        found = identify_decay(times[once], values[once])
    except (DecayError, RelaxationsError) as problem:
        raise SuiteError(f"{file}: {problem}") from None
    return Measured(file, name, float(times[0]), float(times[-1]), found)


def table_series(file: Path, signal: str | None) -> tuple[str, Reals, Reals, float]:
    """Name, times, values and where to begin, of a table whose first column is the time [s], with or without a line of names."""
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            sample = lines.read(4096)
            lines.seek(0)
            # Where commas are those of decimals, columns are separated by something else: a row tells it, a name may hold anything.
            row = (sample.splitlines()[:-1] or sample.splitlines() or [""])[-1]
            delimiter = next((mark for mark in ";\t" if mark in row), ",")
            rows = [row for row in csv.reader(lines, delimiter=delimiter) if any(cell.strip() for cell in row)]
            if delimiter != ",":
                rows = [[cell.replace(",", ".") if cell.count(",") == 1 else cell for cell in row] for row in rows]
    except (UnicodeDecodeError, csv.Error) as problem:
        raise SuiteError(f"{file} is no table of text (CSV): {problem}") from None
    if not rows or len(rows[0]) < 2:
        raise SuiteError(f"{file} is no table with a column of times [s] and one of values")
    named = not all(_is_number(cell) for cell in rows[0])
    names = [cell.strip() for cell in rows[0]] if named else [str(i + 1) for i in range(len(rows[0]))]
    column = 1
    if signal is not None:
        if signal not in names[1:]:
            raise SuiteError(f"{file} has no column {signal!r}; it has {', '.join(names[1:])} (and times in {names[0]!r})")
        column = names.index(signal, 1)
    elif len(names) > 2:
        raise SuiteError(f"{file} has several columns; choose one by --signal: {', '.join(names[1:])}")
    body = rows[named:]
    if not body:
        raise SuiteError(f"{file} has names of columns and no row of numbers")
    for number, row in enumerate(body, 1 + named):
        if len(row) <= column or not (_is_number(row[0]) and _is_number(row[column])):
            raise SuiteError(f"{file}: line {number} has no number for {names[0]!r} and {names[column]!r}: {delimiter.join(row)[:60]!r}")
    table = np.array([(float(row[0]), float(row[column])) for row in body])
    return names[column], table[:, 0], table[:, 1], float(table[0, 0])


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _log(file: Path, signal: str | None) -> tuple[str, Reals, Reals, float]:
    """The same of a log that slewcert wrote (begun where its command ends), or of messages in JSON: `--signal /topic.field`."""
    if signal is not None and signal.startswith("/"):
        try:
            times, values = logs.json_series(file, signal)
        except (LogError, RecordError) as problem:
            raise SuiteError(f"{file}: {problem}") from None
        return signal, times, values, float(times[0])
    if file.stat().st_size == 0:
        raise SuiteError(f"{file} is empty")
    try:
        run = observe(logs.read_log(file))
    except (LogError, RecordError, LookupError, ValueError, TypeError) as problem:
        why = "it is no log that slewcert wrote; name a field of messages in JSON by --signal /topic.field"
        raise SuiteError(f"{file}: {why} ({problem})") from None
    name = signal or "output"
    if name not in run.variables:
        raise SuiteError(f"{file} has no variable {name!r}; it has {', '.join(run.variables)}")
    return name, run.times, run.variables[name], run.command.end
