"""The neutral records that evidence is made of: signals, messages, and the log of one run. Nothing here judges."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reports.errors import RecordError

LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
"""Levels of a message, in the order of foxglove.Log's enumeration."""

SECONDS = "seconds"
"""First field of every logged message: the exact time, of which the log time is only the nearest nanosecond."""

OWN_TOPICS = ("/suite/log", "/verdict")
"""Topics written from `RunLog.messages` and `RunLog.verdict`; no signal may have them."""

VIEWER_LIMIT = 1_000_000
"""Messages in one log above which viewers become slow: worth a warning."""

_LATEST = 2.0**63 / 1e9  # seconds; log times are kept as int64 nanoseconds while they are sorted
_MOST_FIELDS = 2000  # field numbers up to 2047 have tags of at most two bytes
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One group of values sampled together: `values[i, j]` is field `names[j]` at `times[i]`.

    `times` (n,) [s], finite, from zero on, not descending (a jump may have two rows at one instant); `values` (n, k), NaN allowed.
    `names` are identifiers (see `field_names`), `variables` the FMU's own names ("" if it has none), `units` and `causalities` as the
    FMU gives them. Arrays are copied and made read-only. Raises `RecordError`.
    """

    topic: str
    times: NDArray[np.float64]
    names: tuple[str, ...]
    units: tuple[str, ...]
    causalities: tuple[str, ...]
    variables: tuple[str, ...]
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        times, values = _read_only(self.times), _read_only(self.values)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)
        if not _TOPIC.fullmatch(self.topic):
            raise RecordError(f"a topic is a path of identifiers such as /plant/output; this one is {self.topic!r}")
        if self.topic in OWN_TOPICS:
            raise RecordError(f"{self.topic} is written from the log's own messages and verdict; a signal needs another topic")
        for what, given in (("units", self.units), ("causalities", self.causalities), ("variables", self.variables)):
            if len(given) != len(self.names):
                raise RecordError(f"{self.topic}: {len(self.names)} names but {len(given)} {what}")
        if times.ndim != 1 or values.shape != (times.size, len(self.names)):
            wanted = f"({times.size}, {len(self.names)})"
            raise RecordError(f"{self.topic}: times of shape {times.shape} and values of shape {values.shape}; values should be {wanted}")
        if not 0 < len(self.names) <= _MOST_FIELDS:
            raise RecordError(f"{self.topic}: {len(self.names)} fields; a signal has 1 to {_MOST_FIELDS}")
        _check_names(self.topic, self.names)
        if times.size and not (times[0] >= 0.0 and np.all(np.diff(times) >= 0.0) and times[-1] < _LATEST):
            raise RecordError(f"{self.topic}: times must be finite, from zero on and not descending [s]")


@dataclass(frozen=True, slots=True)
class Message:
    """A line of text at `time` [s] of the run; `level` is one of `LEVELS`."""

    time: float
    level: str
    text: str

    def __post_init__(self) -> None:
        if not (math.isfinite(self.time) and 0.0 <= self.time < _LATEST):
            raise RecordError(f"a message's time must be finite and not negative [s], is {self.time!r}")
        if self.level not in LEVELS:
            raise RecordError(f"a message's level is one of {', '.join(LEVELS)}; this one is {self.level!r}")
        object.__setattr__(self, "text", _text(self.text))


@dataclass(frozen=True, slots=True, eq=False)
class RunLog:
    """Everything that one run leaves: `run` says what was run, `verdict` what came out (None: the run or its log is incomplete)."""

    run: Mapping[str, str]
    verdict: Mapping[str, str] | None
    signals: tuple[Signal, ...] = ()
    messages: tuple[Message, ...] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "run", _texts(self.run))
        object.__setattr__(self, "attachments", MappingProxyType(dict(self.attachments)))
        if self.verdict is not None:
            object.__setattr__(self, "verdict", _texts(self.verdict))
        topics = [s.topic for s in self.signals]
        if len(set(topics)) != len(topics):
            raise RecordError(f"each topic belongs to one signal; these are given: {', '.join(topics)}")

    @property
    def message_count(self) -> int:
        """Messages the log file will hold, one a sample of a signal (compare `VIEWER_LIMIT`)."""
        return sum(s.times.size for s in self.signals) + len(self.messages) + (self.verdict is not None)

    def signal(self, topic: str) -> Signal:
        """The signal of `topic`; raises `RecordError` naming the topics there are."""
        for signal in self.signals:
            if signal.topic == topic:
                return signal
        raise RecordError(f"no signal {topic}; this log has {', '.join(s.topic for s in self.signals) or 'none'}")


def field_names(variables: Iterable[str]) -> tuple[str, ...]:
    """Distinct identifiers for FMU variables: `body.x[1]` becomes `body_x_1`, a second name for the same identifier gets a number."""
    taken = {_folded(SECONDS)}
    names = []
    for variable in variables:
        base = re.sub(r"[^A-Za-z0-9]+", "_", variable).strip("_") or "value"
        base = f"_{base}" if base[0].isdigit() else base
        name, number = base, 1
        while _folded(name) in taken:
            number += 1
            name = f"{base}_n{number}"
        taken.add(_folded(name))
        names.append(name)
    return tuple(names)


def _folded(name: str) -> str:
    """Protobuf's JSON form drops underscores and turns letters to capitals: names must differ by more than that."""
    return name.replace("_", "").lower()


def _check_names(topic: str, names: tuple[str, ...]) -> None:
    seen = {_folded(SECONDS): SECONDS}
    for name in names:
        if not _IDENTIFIER.fullmatch(name):
            raise RecordError(f"{topic}: a field name is a letter or underscore, then letters, digits, underscores; this one is {name!r}")
        if (other := seen.setdefault(_folded(name), name)) is not name or name == SECONDS:
            raise RecordError(f"{topic}: the field names {other!r} and {name!r} are too much alike (`field_names` makes distinct ones)")


def _text(text: str) -> str:
    """A broken FMU may print anything; the strings of a log hold only what UTF-8 can."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _texts(texts: Mapping[str, str]) -> Mapping[str, str]:
    return MappingProxyType({_text(key): _text(value) for key, value in texts.items()})


def _read_only(given: ArrayLike) -> NDArray[np.float64]:
    array = np.array(given, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array
