"""Logs: every float64 survives, any altered byte is noticed, a cut file reads as far as it goes, and others can read them too."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import Message as ProtobufMessage
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.decoder import DecoderFactory
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from reports import files, logs, merging
from reports.errors import LogError, RecordError
from reports.logs import log_bytes, parse_log, read_log, write_log
from reports.records import Message, RunLog, Signal, field_names

Float64 = NDArray[np.float64]


def group(topic: str, times: Float64, values: Float64, variables: tuple[str, ...] | None = None) -> Signal:
    """A signal whose unit and causality do not matter."""
    count = values.shape[1]
    variables = variables or tuple(f"x[{i}]" for i in range(count))
    return Signal(topic, times, field_names(variables), ("m",) * count, ("output",) * count, variables, values)


def sample_log(samples: int = 60, states: int = 3) -> RunLog:
    """A run with a jump (two rows at one instant), several topics, messages and attachments."""
    times = np.sort(np.concatenate([np.linspace(0.0, 7.3, samples - 1), [1.00267843037816]]))
    times[5] = times[4]
    values = np.random.default_rng(7).standard_normal((samples, states))
    signals = (
        Signal("/command/u", times, ("u",), ("N",), ("input",), ("force",), np.sign(values[:, :1])),
        group("/plant/output", times[::2], values[::2, :2], ("position_1", "position_2")),
        group("/plant/state", times, values),
        Signal("/limits", np.zeros(1), ("lower", "upper"), ("N", "N"), ("", ""), ("", ""), np.array([[-1.0, 1.0]])),
    )
    messages = (Message(0.0, "info", "initialised"), Message(0.1 + 0.2, "warning", "naïve Δ – 100 %"))
    attachments = {"study.toml": b'title = "x"\n', "modelDescription.xml": b"<fmi/>", "empty.json": b""}
    return RunLog({"run": "0000-nominal", "maneuver_time": "4.21786651045103"}, {"verdict": "pass"}, signals, messages, attachments)


def assert_same(left: RunLog, right: RunLog) -> None:
    """Equal to the last bit of every float64."""
    assert (left.run, left.verdict, left.attachments, left.messages) == (right.run, right.verdict, right.attachments, right.messages)
    assert [s.topic for s in left.signals] == [s.topic for s in right.signals]
    for a, b in zip(left.signals, right.signals, strict=True):
        assert (a.names, a.units, a.causalities, a.variables) == (b.names, b.units, b.causalities, b.variables)
        assert a.times.tobytes() == b.times.tobytes()
        assert a.values.tobytes() == b.values.tobytes()


def test_a_log_comes_back_bit_by_bit(tmp_path: Path) -> None:
    log = sample_log()
    digest = write_log(tmp_path / "runs" / "0000-nominal.mcap", log)
    path = tmp_path / "runs" / "0000-nominal.mcap"
    assert_same(read_log(path), log)
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_the_strangest_floats_survive() -> None:
    quiet, payload = np.uint64(0x7FF8000000000000), np.uint64(0xFFF80000DEADBEEF)
    odd = np.array([0.0, -0.0, 5e-324, -1.7976931348623157e308, np.inf, -np.inf, 0.1 + 0.2, np.pi]).tolist()
    values = np.array([*odd, *np.array([quiet, payload]).view(np.float64)]).reshape(-1, 1)
    times = np.array([0.0, 5e-324, 1e-300, 1e-10, 0.1 + 0.2, np.nextafter(1.0, 2.0), 1.00267843037816, 86400.1, 9e8, 9e9])
    assert_same(parse_log(log_bytes(RunLog({}, None, (group("/x", times, values),)))), RunLog({}, None, (group("/x", times, values),)))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(0.0, 1e6), max_size=40).map(sorted),
    st.integers(1, 18),  # field 16 is the first whose tag has two bytes
    st.integers(0, 2**32 - 1),
)
def test_any_signal_survives(times: list[float], count: int, seed: int) -> None:
    bits = np.random.default_rng(seed).integers(0, 2**64, (len(times), count), dtype=np.uint64)
    log = RunLog({}, {"verdict": "undecided"}, (group("/plant/state", np.array(times), bits.view(np.float64)),))
    assert_same(parse_log(log_bytes(log)), log)


@pytest.mark.parametrize("count", [14, 15, 127, 300])
def test_many_fields(count: int) -> None:
    log = RunLog({}, None, (group("/plant/state", np.arange(3.0), np.arange(3.0 * count).reshape(3, count)),))
    assert_same(parse_log(log_bytes(log)), log)


@pytest.mark.parametrize("log", [RunLog({}, None), RunLog({}, {}), RunLog({"a": "b"}, None, (group("/x", np.empty(0), np.empty((0, 2))),))])
def test_nearly_empty_logs(log: RunLog) -> None:
    assert_same(parse_log(log_bytes(log)), log)


def test_several_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "CHUNK_BYTES", 700)
    log = sample_log()
    data = log_bytes(log)
    assert data.count(b"zstd") > 10  # each chunk names its compression, twice
    assert_same(parse_log(data), log)


def test_the_same_log_gives_the_same_bytes() -> None:
    assert log_bytes(sample_log()) == log_bytes(sample_log())
    assert log_bytes(parse_log(log_bytes(sample_log()))) == log_bytes(sample_log())


def test_every_flipped_bit_of_the_file_is_noticed() -> None:
    data = log_bytes(sample_log(samples=12))
    unnoticed = []
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << position % 8
        try:
            parse_log(bytes(damaged))
            unnoticed.append(position)
        except LogError:
            pass
    assert unnoticed == []


@pytest.mark.parametrize("what", [b"initialised", b"modelDescription.xml", b'title = "x"', b"pass", b"4.21786651045103", b"foxglove.Log"])
def test_an_altered_word_is_noticed(what: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs.zstandard, "compress", lambda content: _stored(content))
    data = log_bytes(sample_log())
    assert what in data
    with pytest.raises(LogError, match="damaged"):
        parse_log(data.replace(what, what[::-1]))


def _stored(content: bytes) -> bytes:
    """A Zstandard frame that stores its content as it is, so that a test can find words in it."""
    assert len(content) < 1 << 17  # the largest raw block
    header = bytes.fromhex("28b52ffd") + b"\xa0" + len(content).to_bytes(4, "little")
    return header + (len(content) << 3 | 1).to_bytes(3, "little") + content


def test_checksums_may_not_be_removed() -> None:
    data = log_bytes(sample_log())
    crc = data[: data.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")]
    end = len(crc) + 9
    with pytest.raises(LogError, match="no checksums"):
        parse_log(data[:end] + bytes(4) + data[end + 4 :])


@pytest.mark.slow
def test_every_cut_file_reads_as_far_as_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "CHUNK_BYTES", 700)
    log = sample_log(samples=20)
    data = log_bytes(log)
    seen = set()
    for length in {*range(0, len(data), 7), *range(len(data) - 40, len(data))}:  # every byte takes seconds
        part = parse_log(data[:length])
        assert part.verdict is None
        for signal in part.signals:
            whole, count = log.signal(signal.topic), signal.times.size
            assert signal.times.tobytes() == whole.times[:count].tobytes()
            assert signal.values.tobytes() == whole.values[:count].tobytes()
            seen.add((signal.topic, count))
    assert {("/plant/state", 20), ("/plant/output", 10)} <= seen
    assert len(seen) > 8


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(b"PK\x03\x04 something else")
    with pytest.raises(LogError, match=r"other\.mcap: not an MCAP file"):
        read_log(path)
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "missing.mcap")


def test_verdict_message_and_metadata_must_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    real = logs.schemas.encode_verdict
    monkeypatch.setattr(logs.schemas, "encode_verdict", lambda verdict, seconds: real({"verdict": "fail"}, seconds))
    data = log_bytes(sample_log())
    monkeypatch.undo()
    with pytest.raises(LogError, match="do not agree"):
        parse_log(data)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    write_log(path, sample_log())
    before = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_log(path, RunLog({}, None))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.mcap"]


# --- other people's readers


class Decoder(DecoderFactory):
    """Decodes with Google's Protobuf runtime and nothing but the schema in the file."""

    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], ProtobufMessage] | None:
        assert message_encoding == "protobuf"
        assert schema is not None
        assert schema.encoding == "protobuf"
        pool = descriptor_pool.DescriptorPool()
        for file in getattr(descriptor_pb2, "FileDescriptorSet").FromString(schema.data).file:  # noqa: B009 (made at run time: unknown to type checkers)
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString


@pytest.mark.parametrize("kind", [SeekingReader, NonSeekingReader])
def test_mcaps_own_readers_agree(kind: type[SeekingReader | NonSeekingReader], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "CHUNK_BYTES", 2000)
    log = sample_log()
    data = log_bytes(log)

    def reader() -> SeekingReader | NonSeekingReader:
        return kind(io.BytesIO(data), validate_crcs=True, decoder_factories=[Decoder()])

    found: dict[str, list[tuple[float, ...]]] = {}
    texts, stamps = [], []
    for _, channel, message, decoded in reader().iter_decoded_messages():
        stamps.append(message.log_time)
        assert message.log_time == message.publish_time == round(decoded.seconds * 1e9)
        if channel.topic == "/suite/log":
            stamp = decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
            assert stamp == message.log_time
            texts.append((decoded.level, decoded.message))
        elif channel.topic == "/verdict":
            assert [(e.key, e.value) for e in decoded.entries] == [("verdict", "pass")]
        else:
            names = [f.name for f in decoded.DESCRIPTOR.fields]
            assert names[0] == "seconds"
            found.setdefault(channel.topic, []).append(tuple(getattr(decoded, n) for n in names))
    assert stamps == sorted(stamps)
    assert texts == [(2, "initialised"), (3, "naïve Δ – 100 %")]
    for signal in log.signals:
        rows = np.array(found[signal.topic])
        assert rows.tobytes() == np.column_stack([signal.times, signal.values]).tobytes()
    assert [m.name for m in reader().iter_metadata()] == ["suite.run", "suite.verdict"]
    assert {a.name: a.data for a in reader().iter_attachments()} == log.attachments


def test_the_summary_counts_right() -> None:
    log = sample_log()
    summary = SeekingReader(io.BytesIO(log_bytes(log))).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == log.message_count
    assert (summary.statistics.attachment_count, summary.statistics.metadata_count) == (3, 2)
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 7_300_000_000)
    channel = next(c for c in summary.channels.values() if c.topic == "/command/u")
    assert isinstance(channel, Channel)
    assert channel.metadata == {"fields": "u", "u.unit": "N", "u.causality": "input", "u.variable": "force"}


# --- records


def test_field_names_are_distinct_identifiers() -> None:
    variables = ("body.x[1]", "body_x_1", "x1", "x_1", "3d", "der(v)", "seconds", "Δ", "")
    names = field_names(variables)
    assert names[0] == "body_x_1"
    assert names[5] == "der_v"
    assert len({n.replace("_", "").lower() for n in names} | {"seconds"}) == len(variables) + 1
    log = RunLog({}, None, (group("/plant/state", np.zeros(1), np.zeros((1, len(variables))), variables),))
    assert_same(parse_log(log_bytes(log)), log)
    for schema in SeekingReader(io.BytesIO(log_bytes(log))).get_summary().schemas.values():  # type: ignore[union-attr]
        assert Decoder().decoder_for("protobuf", schema) is not None  # Google's pool refuses names that clash


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"topic": "plant/output"}, "a topic is a path"),
        ({"topic": "/verdict"}, "another topic"),
        ({"times": np.array([0.0, np.nan])}, "times must be finite"),
        ({"times": np.array([1.0, 0.5])}, "not descending"),
        ({"times": np.array([-1.0, 0.5])}, "from zero on"),
        ({"times": np.array([0.0, 1e10])}, "times must be finite"),
        ({"times": np.array([0.0])}, r"shape \(1,\) and values of shape \(2, 1\)"),
        ({"units": ()}, "1 names but 0 units"),
        ({"names": ("x y",)}, "'x y'"),
        ({"names": ("seconds",)}, "too much alike"),
    ],
)
def test_records_that_do_not_fit(change: dict[str, object], complaint: str) -> None:
    good: dict[str, object] = {
        "topic": "/x",
        "times": np.array([0.0, 1.0]),
        "names": ("x",),
        "units": ("m",),
        "causalities": ("output",),
        "variables": ("x",),
        "values": np.zeros((2, 1)),
    }
    Signal(**good)  # type: ignore[arg-type]
    with pytest.raises(RecordError, match=complaint):
        Signal(**good | change)  # type: ignore[arg-type]


def test_messages_and_topics_are_checked() -> None:
    with pytest.raises(RecordError, match="'loud'"):
        Message(0.0, "loud", "")
    with pytest.raises(RecordError, match="time"):
        Message(float("inf"), "info", "")
    assert Message(0.0, "info", "\ud800").text == "?"
    assert RunLog({"detail": "\ud800"}, {"detail": "\ud800"}).verdict == {"detail": "?"}
    signal = group("/x", np.zeros(1), np.zeros((1, 1)))
    with pytest.raises(RecordError, match="one signal"):
        RunLog({}, None, (signal, signal))
    with pytest.raises(RecordError, match="this log has /x"):
        RunLog({}, None, (signal,)).signal("/y")
    with pytest.raises(ValueError, match="read-only"):
        signal.values[0, 0] = 1.0


def test_merging_keeps_the_order_of_time_and_of_streams() -> None:
    one = merging.Stream(1, np.array([0, 5, 5]), np.array([1, 2, 1]), b"abbc")
    two = merging.Stream(2, np.array([0, 4, 9]), np.array([1, 3, 1]), b"XYYYZ")
    pieces = list(merging.merge([one, two], limit=5))
    assert [p.data for p in pieces] == [b"aXYYY", b"bbcZ"]
    assert [(p.first, p.last) for p in pieces] == [(0, 4), (5, 9)]
    assert pieces[1].entries[1].tolist() == [[5, 0], [5, 2]]
    assert [p.data for p in merging.merge([one, two], limit=1)] == [b"a", b"X", b"YYY", b"bb", b"c", b"Z"]
