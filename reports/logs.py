"""The log of a run as an MCAP file: written whole or not at all, read back bit by bit. The only module that imports mcap.

Layout: header, metadata `suite.run`, attachments, chunks of messages in the order of time, metadata `suite.verdict`, summary.
The same `RunLog` gives the same bytes: no clock, no random numbers. Checksums find accidents; against intent there is the manifest.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from collections import defaultdict
from io import BytesIO
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

from reports import schemas
from reports.errors import LogError, RecordError
from reports.files import write_atomically
from reports.merging import Piece, Stream, merge
from reports.records import SECONDS, Message, RunLog, Signal

RUN, VERDICT = "suite.run", "suite.verdict"
LOG_TOPIC, VERDICT_TOPIC = "/suite/log", "/verdict"
CHUNK_BYTES = 1 << 20  # viewers load whole chunks; mcap's own writer cuts there too

_HEAD = struct.Struct("<BQ")
_MEDIA_TYPES = {".toml": "application/toml", ".xml": "application/xml", ".json": "application/json"}


def write_log(path: str | os.PathLike[str], log: RunLog) -> str:
    """Write `log` to `path` atomically; returns the file's SHA-256 (hex). Raises `RecordError`, `OSError`."""
    data = log_bytes(log)
    write_atomically(path, data)
    return hashlib.sha256(data).hexdigest()


def read_log(path: str | os.PathLike[str]) -> RunLog:
    """Read a log, every checksum checked.

    A truncated file is read as far as whole records go, and has no verdict. Raises `LogError` if the file is damaged or not one of
    ours, `OSError` if it cannot be read.
    """
    try:
        return parse_log(Path(path).read_bytes())
    except LogError as problem:
        raise LogError(f"{path}: {problem}") from None


def log_bytes(log: RunLog) -> bytes:
    """The MCAP file of `log`."""
    file = _File()
    file.add(Header(profile="", library="slewcert"))
    file.add(Metadata(name=RUN, metadata=dict(log.run)))
    for name, content in log.attachments.items():
        media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        file.add(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content))
    _add_messages(file, log)
    if log.verdict is not None:
        file.add(Metadata(name=VERDICT, metadata=dict(log.verdict)))
    return file.finish()


class _File:
    """The bytes so far, and what the summary will have to say about them."""

    def __init__(self) -> None:
        self.data = bytearray(MAGIC)
        self.summary: dict[Opcode, list[McapRecord]] = defaultdict(list)
        self.counts: dict[int, int] = {}

    def add(self, record: McapRecord) -> tuple[int, int]:
        """Append a record; returns its offset and length."""
        offset, data = len(self.data), _bytes(record)
        self.data += data
        if isinstance(record, Metadata):
            self.summary[Opcode.METADATA_INDEX].append(MetadataIndex(offset, len(data), record.name))
        elif isinstance(record, Attachment):
            index = AttachmentIndex(offset, len(data), 0, 0, len(record.data), record.name, record.media_type)
            self.summary[Opcode.ATTACHMENT_INDEX].append(index)
        return offset, len(data)

    def register(self, topic: str, schema: schemas.Schema, metadata: dict[str, str]) -> int:
        """A new channel with its schema; returns its number. Both are written by the first chunk and repeated in the summary."""
        number = len(self.summary[Opcode.CHANNEL]) + 1
        self.summary[Opcode.SCHEMA].append(Schema(id=number, data=schema.data, encoding="protobuf", name=schema.name))
        self.summary[Opcode.CHANNEL].append(Channel(number, topic, "protobuf", metadata, schema_id=number))
        return number

    def add_chunk(self, head: bytes, piece: Piece) -> None:
        """Append a chunk and its message indexes."""
        content = head + piece.data
        packed = zstandard.compress(content)
        offset, length = self.add(Chunk("zstd", packed, piece.last, piece.first, zlib.crc32(content), len(content)))
        start, offsets = len(self.data), {}
        for channel, rows in piece.entries.items():
            offsets[channel] = len(self.data)
            shifted = rows + np.array([0, len(head)], dtype=np.uint64)
            self.data += struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + rows.nbytes, channel, rows.nbytes) + shifted.astype("<u8").tobytes()
            self.counts[channel] = self.counts.get(channel, 0) + len(rows)
        size = len(self.data) - start
        index = ChunkIndex(length, offset, "zstd", len(packed), piece.last, size, offsets, piece.first, len(content))
        self.summary[Opcode.CHUNK_INDEX].append(index)

    def finish(self) -> bytes:
        """Data end, summary, footer."""
        groups = self.summary
        filled = [index for index in groups[Opcode.CHUNK_INDEX] if isinstance(index, ChunkIndex) and index.message_index_offsets]
        groups[Opcode.STATISTICS] = [
            Statistics(
                attachment_count=len(groups[Opcode.ATTACHMENT_INDEX]),
                channel_count=len(groups[Opcode.CHANNEL]),
                channel_message_counts=self.counts,
                chunk_count=len(groups[Opcode.CHUNK_INDEX]),
                message_count=sum(self.counts.values()),
                message_end_time=max((i.message_end_time for i in filled), default=0),
                message_start_time=min((i.message_start_time for i in filled), default=0),
                metadata_count=len(groups[Opcode.METADATA_INDEX]),
                schema_count=len(groups[Opcode.SCHEMA]),
            )
        ]
        self.add(DataEnd(zlib.crc32(self.data)))
        start = len(self.data)
        offsets = []
        for opcode in sorted(groups):
            if groups[opcode]:  # independent doctors call an empty group an error
                group_start = len(self.data)
                for record in groups[opcode]:
                    self.add(record)
                offsets.append(SummaryOffset(opcode, group_start, len(self.data) - group_start))
        offset_start = len(self.data)
        for offset in offsets:
            self.add(offset)
        footer = _bytes(Footer(start, offset_start, 0))[:-4]
        self.data += footer + struct.pack("<I", zlib.crc32(self.data[start:] + footer)) + MAGIC
        return bytes(self.data)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _add_messages(file: _File, log: RunLog) -> None:
    """All channels' messages, merged in the order of time and cut into chunks."""
    streams: list[Stream] = []
    for signal in log.signals:
        channel = file.register(signal.topic, schemas.signal_schema(signal.topic, signal.names), _channel_metadata(signal))
        rows = schemas.encode_signal(signal, channel)
        sizes = np.full(rows.size, rows.dtype.itemsize, dtype=np.int64)
        streams.append(Stream(channel, schemas.nanoseconds(signal.times), sizes, rows.tobytes()))
    if log.messages:
        channel = file.register(LOG_TOPIC, schemas.LOG, {})
        streams.append(_stream(channel, [(m.time, schemas.encode_message(m)) for m in log.messages]))
    if log.verdict is not None:
        channel = file.register(VERDICT_TOPIC, schemas.VERDICT, {})
        end = _end(log)
        streams.append(_stream(channel, [(end, schemas.encode_verdict(log.verdict, end))]))
    # Schemas and channels come once, at the head of the first chunk, as in files of mcap's own writer.
    head = b"".join(_bytes(r) for opcode in (Opcode.SCHEMA, Opcode.CHANNEL) for r in file.summary[opcode])
    for piece in merge(streams, CHUNK_BYTES):
        file.add_chunk(head, piece)
        head = b""
    if head:  # channels without a single message
        file.add_chunk(head, Piece(b"", 0, 0, {}))


def _stream(channel: int, timed: list[tuple[float, bytes]]) -> Stream:
    """Messages of varying size as a stream."""
    records = [schemas.message_record(channel, i, time, data) for i, (time, data) in enumerate(timed)]
    times = schemas.nanoseconds(np.array([time for time, _ in timed]))
    return Stream(channel, times, np.array([len(r) for r in records], dtype=np.int64), b"".join(records))


def _end(log: RunLog) -> float:
    """The latest time in the log [s]: when the verdict is shown."""
    return max([s.times[-1].item() for s in log.signals if s.times.size] + [m.time for m in log.messages], default=0.0)


def _channel_metadata(signal: Signal) -> dict[str, str]:
    metadata = {"fields": " ".join(signal.names)}
    for name, unit, causality, variable in zip(signal.names, signal.units, signal.causalities, signal.variables, strict=True):
        metadata |= {f"{name}.unit": unit, f"{name}.causality": causality, f"{name}.variable": variable}
    return metadata


def parse_log(data: bytes) -> RunLog:
    """`read_log` from bytes."""
    end, whole = _check(data)
    run: dict[str, str] = {}
    verdict: dict[str, str] | None = None
    attachments: dict[str, bytes] = {}
    contents: list[bytes] = []
    reader = StreamReader(BytesIO(data if whole else data[:end]), emit_chunks=True, validate_crcs=True, record_size_limit=len(data))
    try:
        for record in reader.records:
            if isinstance(record, Metadata) and record.name == RUN:
                run = record.metadata
            elif isinstance(record, Metadata) and record.name == VERDICT:
                verdict = record.metadata
            elif isinstance(record, Attachment):
                attachments[record.name] = record.data
            elif isinstance(record, Chunk):
                stream, length = get_chunk_data_stream(record, validate_crc=True)
                contents.append(stream.read(length))
    except EndOfFile as problem:
        if whole:  # else it is where the file was cut off
            raise LogError(f"damaged: {problem}") from None
    except (McapError, ValueError, struct.error, zstandard.ZstdError, MemoryError) as problem:
        raise LogError(f"damaged: {problem}") from None
    try:
        signals, messages, shown = _decode(contents)
        log = RunLog(run, verdict if whole else None, signals, messages, attachments)
    except (RecordError, ValueError, KeyError, struct.error, McapError) as problem:
        raise LogError(f"not a log of slewcert: {problem}") from None
    expected = [] if log.verdict is None else [schemas.encode_verdict(log.verdict, _end(log))]
    if whole and shown != expected:
        raise LogError(f"the messages of {VERDICT_TOPIC} and the metadata {VERDICT} do not agree")
    return log


def json_series(path: str | os.PathLike[str], place: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and values of the field `place`, "/topic.field.inner", of messages in JSON that any program wrote.

    Raises `LogError` naming the topics or fields there are, `OSError`.
    """
    topic, *fields = place.split(".")
    rows: list[tuple[float, float]] = []
    try:
        with Path(path).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(topics=[topic]):
                if channel.message_encoding != "json":
                    raise LogError(f"messages of {topic} are written in {channel.message_encoding or 'no known encoding'}, not in JSON")
                value = json.loads(message.data)
                for name in fields:
                    value = value[int(name)] if isinstance(value, list) else value[name]
                rows.append((message.log_time / 1e9, float(value)))
            if not rows:
                summary = reader.get_summary()
                topics = sorted({channel.topic for channel in summary.channels.values()}) if summary else []
                raise LogError(f"no messages of {topic}; it has {', '.join(topics) or 'none'}")
    except (LookupError, TypeError, ValueError) as problem:
        raise LogError(f"messages of {topic} have no number at {'.'.join(fields) or 'their root'}: {problem!r}") from None
    except (McapError, struct.error, zstandard.ZstdError) as problem:
        raise LogError(f"damaged: {problem}") from None
    table = np.array(rows)
    return table[:, 0] - table[0, 0], table[:, 1]


def _check(data: bytes) -> tuple[int, bool]:
    """Walk over the records without believing any: where the last whole one ends, and whether the file is complete.

    Every byte of a complete file counts: data and summary by their checksums, the records between them by their place.
    Raises `LogError` for a file that is neither complete nor cut off.
    """
    if not data.startswith(MAGIC) and not MAGIC.startswith(data):
        raise LogError("not an MCAP file: it begins with other bytes")
    position, opcode, starts = len(MAGIC), 0, {}
    while opcode != Opcode.FOOTER and position + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        if position + _HEAD.size + length > len(data):
            break
        starts[opcode] = position
        position += _HEAD.size + length
    if opcode != Opcode.FOOTER or Opcode.FOOTER not in starts:
        if data.endswith(MAGIC) and len(data) > len(MAGIC):
            raise LogError("damaged: the file has its end, but its records do not lead there")
        return position if position <= len(data) else 0, False
    footer, data_end = starts[Opcode.FOOTER], starts.get(Opcode.DATA_END)
    if data_end is None or position - footer != _HEAD.size + 20:
        raise LogError("damaged: the end of the data is not where it should be")
    (data_crc,) = struct.unpack_from("<I", data, data_end + _HEAD.size)
    summary, _, summary_crc = struct.unpack_from("<QQI", data, footer + _HEAD.size)
    if data_crc == 0 or summary_crc == 0:
        raise LogError("the file carries no checksums: it was written by another program, or changed")
    if data_crc != zlib.crc32(memoryview(data)[:data_end]):
        raise LogError("damaged: the checksum of the data does not match")
    if summary != data_end + _HEAD.size + 4 or summary_crc != zlib.crc32(memoryview(data)[summary : position - 4]):
        raise LogError("damaged: the checksum of the summary does not match")
    if not MAGIC.startswith(data[position:]):
        raise LogError("damaged: the file does not end as an MCAP file does")
    return position, data[position:] == MAGIC


def _decode(contents: list[bytes]) -> tuple[tuple[Signal, ...], tuple[Message, ...], list[bytes]]:
    """Signals, messages and verdict messages from the uncompressed chunks."""
    definitions: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    rows: dict[int, list[NDArray[np.uint8]]] = defaultdict(list)
    plain: dict[int, list[bytes]] = defaultdict(list)
    for content in contents:
        places: dict[int, list[tuple[int, int]]] = defaultdict(list)
        position = 0
        while position < len(content):
            opcode, length = _HEAD.unpack_from(content, position)
            body = position + _HEAD.size
            if opcode == Opcode.MESSAGE:
                (channel,) = struct.unpack_from("<H", content, body)
                places[channel].append((position, body + length))
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content[body : body + length])))
                definitions[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(ReadDataStream(BytesIO(content[body : body + length])))
                channels[record.id] = record
            position = body + length
        buffer = np.frombuffer(content, dtype=np.uint8)
        for channel, found in places.items():
            if channels[channel].topic in (LOG_TOPIC, VERDICT_TOPIC):
                plain[channel] += [content[start + 31 : stop] for start, stop in found]
                continue
            spans = np.array(found)
            lengths = spans[:, 1] - spans[:, 0]
            if np.any(lengths != lengths[0]):
                raise LogError(f"messages of {channels[channel].topic} differ in size")
            rows[channel].append(buffer[spans[:, :1] + np.arange(lengths[0])])
    signals: list[Signal] = []
    messages: list[Message] = []
    shown: list[bytes] = []
    for number, channel in channels.items():
        if channel.topic == LOG_TOPIC:
            messages += [schemas.decode_message(data) for data in plain[number]]
        elif channel.topic == VERDICT_TOPIC:
            shown += plain[number]
        else:
            signals.append(_decode_signal(channel, definitions[channel.schema_id], rows[number]))
    return tuple(signals), tuple(messages), shown


def _decode_signal(channel: Channel, schema: Schema, rows: list[NDArray[np.uint8]]) -> Signal:
    names = tuple(channel.metadata["fields"].split(" "))
    units, causalities, variables = (
        tuple(channel.metadata[f"{name}.{what}"] for name in names) for what in ("unit", "causality", "variable")
    )
    expected = schemas.signal_schema(channel.topic, names)
    if (schema.name, schema.data) != (expected.name, expected.data):
        raise LogError(f"the schema of {channel.topic} does not define {SECONDS}, {', '.join(names)}")
    values = np.empty((0, 1 + len(names)))
    if rows:
        values = schemas.decode_signal(np.concatenate(rows), channel.id, 1 + len(names))
    return Signal(channel.topic, values[:, 0], names, units, causalities, variables, values[:, 1:])
