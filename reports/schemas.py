"""What the messages of a log look like: their Protobuf schemas, made at run time, and their bytes.

A message of a signal is the exact time and one double a field, all with field numbers in order and none left out, so that every
message of one signal has the same size and a whole signal is one NumPy array.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reports import wire
from reports.errors import LogError
from reports.records import LEVELS, SECONDS, Message, Signal


@dataclass(frozen=True, slots=True)
class Schema:
    """A message's full name and the serialised FileDescriptorSet that defines it."""

    name: str
    data: bytes


def signal_schema(topic: str, names: tuple[str, ...]) -> Schema:
    """`slewcert.PlantOutput` for /plant/output: seconds, then the named doubles."""
    name = "".join(part[:1].upper() + part[1:] for part in topic.replace("_", "/").split("/"))
    fields = [wire.field(n, i, wire.DOUBLE) for i, n in enumerate((SECONDS, *names), start=1)]
    return Schema(f"slewcert.{name}", wire.file_set(wire.file(f"slewcert/{name}.proto", "slewcert", [wire.message(name, fields)])))


_ENTRY = wire.message("Entry", [wire.field("key", 1, wire.STRING), wire.field("value", 2, wire.STRING)])
VERDICT = Schema(
    "slewcert.Verdict",
    wire.file_set(
        wire.file(
            "slewcert/Verdict.proto",
            "slewcert",
            [
                wire.message(
                    "Verdict",
                    [wire.field(SECONDS, 1, wire.DOUBLE), wire.field("entries", 2, wire.MESSAGE, ".slewcert.Verdict.Entry", repeated=True)],
                    nested=[_ENTRY],
                )
            ],
        )
    ),
)
"""The verdict once more as a message, for viewers: they show no metadata."""

_TIMESTAMP = wire.message("Timestamp", [wire.field(SECONDS, 1, wire.INT64), wire.field("nanos", 2, wire.INT32)])
_LOG_FIELDS = [
    wire.field("timestamp", 1, wire.MESSAGE, ".google.protobuf.Timestamp"),
    wire.field("level", 2, wire.ENUM, ".foxglove.Log.Level"),
    wire.field("message", 3, wire.STRING),
    wire.field("name", 4, wire.STRING),
    wire.field("file", 5, wire.STRING),
    wire.field("line", 6, wire.FIXED32),
    # Not in foxglove.Log: the exact time. Readers that bring their own definition skip it.
    wire.field(SECONDS, 15, wire.DOUBLE),
]
LOG = Schema(
    "foxglove.Log",
    wire.file_set(
        wire.file("google/protobuf/timestamp.proto", "google.protobuf", [_TIMESTAMP]),
        wire.file(
            "foxglove/Log.proto",
            "foxglove",
            [wire.message("Log", _LOG_FIELDS, enums=[wire.enumeration("Level", (level.upper() for level in LEVELS))])],
            ["google/protobuf/timestamp.proto"],
        ),
    ),
)
"""foxglove.Log, which viewers know by name."""


def nanoseconds(times: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """Log times: the nearest nanosecond to each time [s]."""
    return np.rint(np.asarray(times, dtype=np.float64) * 1e9).astype(np.int64)


def encode_message(message: Message) -> bytes:
    """A foxglove.Log message."""
    seconds, nanos = divmod(int(nanoseconds(message.time)), 1_000_000_000)
    timestamp = wire.integer(1, seconds) + wire.integer(2, nanos)
    text = wire.block(3, message.text) if message.text else b""
    return wire.block(1, timestamp) + wire.integer(2, LEVELS.index(message.level)) + text + wire.double(15, message.time)


def decode_message(data: bytes) -> Message:
    """The inverse of `encode_message`; raises `LogError`."""
    fields = wire.parse(data)
    level, text, time = fields.get(2, 0), fields.get(3, b""), fields.get(15)
    if not (isinstance(level, int) and level < len(LEVELS) and isinstance(text, bytes) and isinstance(time, float)):
        raise LogError("a message of /suite/log is not one of ours")
    return Message(time, LEVELS[level], text.decode())


def encode_verdict(verdict: Mapping[str, str], seconds: float) -> bytes:
    """A message of `VERDICT` at the end of the run [s]."""
    entries = (wire.block(2, wire.block(1, key) + wire.block(2, value)) for key, value in verdict.items())
    return wire.double(1, seconds) + b"".join(entries)


def signal_record_type(count: int) -> np.dtype[np.void]:
    """A whole MCAP message record (opcode, length, channel …) that holds `count` doubles, the exact time included.

    Doubles are the fields `x1`, `x2` …, each after its tag `t1`, `t2` … of one or two bytes.
    """
    members: list[tuple[str, str]] = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
    members += [("log_time", "<u8"), ("publish_time", "<u8")]
    for number in range(1, count + 1):
        members += [(f"t{number}", "u1" if len(wire.double_tag(number)) == 1 else "<u2"), (f"x{number}", "<f8")]
    return np.dtype(members)


def _fill_constants(rows: NDArray[np.void], channel: int, count: int) -> None:
    rows["opcode"], rows["length"], rows["channel"] = 5, rows.dtype.itemsize - 9, channel
    for number in range(1, count + 1):
        rows[f"t{number}"] = int.from_bytes(wire.double_tag(number), "little")


def encode_signal(signal: Signal, channel: int) -> NDArray[np.void]:
    """All message records of a signal, in order."""
    count = 1 + len(signal.names)
    rows = np.zeros(signal.times.size, signal_record_type(count))
    _fill_constants(rows, channel, count)
    rows["sequence"] = np.arange(signal.times.size)
    rows["log_time"] = rows["publish_time"] = nanoseconds(signal.times)
    rows["x1"] = signal.times
    for number, column in enumerate(signal.values.T, start=2):
        rows[f"x{number}"] = column
    return rows


def decode_signal(rows: NDArray[np.uint8], channel: int, count: int) -> NDArray[np.float64]:
    """The doubles (n, count) of message records (n, size), bit by bit; raises `LogError` if they are not laid out as ours are."""
    kind = signal_record_type(count)
    if rows.shape[1] != kind.itemsize:
        raise LogError(f"a message record of channel {channel} has {rows.shape[1]} bytes instead of {kind.itemsize}")
    records = np.ascontiguousarray(rows).view(kind)[:, 0]
    expected = records.copy()
    _fill_constants(expected, channel, count)
    with np.errstate(invalid="ignore"):  # a time that is no number gives some log time, which then does not agree
        expected["publish_time"] = expected["log_time"] = nanoseconds(records["x1"])
    if expected.tobytes() != records.tobytes():
        raise LogError(f"a message record of channel {channel} is not laid out as slewcert's are")
    values = np.empty((len(records), count))
    for number in range(1, count + 1):
        values[:, number - 1] = records[f"x{number}"]
    return values


def message_record(channel: int, sequence: int, time: float, data: bytes) -> bytes:
    """One MCAP message record with any content."""
    stamp = int(nanoseconds(time))
    return struct.pack("<BQHIQQ", 5, 22 + len(data), channel, sequence, stamp, stamp) + data
