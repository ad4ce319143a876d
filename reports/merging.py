"""Many channels' records merged into one stream in the order of time, cut into pieces: whole arrays at a time, no loop over messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One channel's records: `data` holds them one after the other, `sizes` (n,) their bytes, `times` (n,) their log times [ns]."""

    channel: int
    times: NDArray[np.int64]
    sizes: NDArray[np.int64]
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Consecutive records: their bytes, the first and last log time [ns], and by channel the (log time, offset in `data`) of each."""

    data: bytes
    first: int
    last: int
    entries: dict[int, NDArray[np.uint64]]


def merge(streams: Sequence[Stream], limit: int) -> Iterator[Piece]:
    """The streams' records by time (at one instant in the order of the streams), in pieces of at most `limit` bytes or one record."""
    if not sum(s.times.size for s in streams):
        return
    flat = np.frombuffer(b"".join(s.data for s in streams), dtype=np.uint8)
    sizes = np.concatenate([s.sizes for s in streams])
    times = np.concatenate([s.times for s in streams])
    channels = np.repeat([s.channel for s in streams], [s.times.size for s in streams])
    sources = np.cumsum(sizes) - sizes
    order = np.argsort(times, kind="stable")
    sizes, times, channels, sources = sizes[order], times[order], channels[order], sources[order]
    filled = np.cumsum(sizes)
    begin = 0
    while begin < times.size:
        already = filled[begin - 1] if begin else 0
        end = max(int(np.searchsorted(filled, already + limit, side="right")), begin + 1)
        part = slice(begin, end)
        offsets = np.cumsum(sizes[part]) - sizes[part]
        # Byte i of the piece comes from byte i + (source - offset of its record) of the streams.
        picked = np.repeat(sources[part] - offsets, sizes[part]) + np.arange(int(sizes[part].sum()))
        rows = np.stack((times[part], offsets), axis=1).astype(np.uint64)
        entries = {int(c): rows[channels[part] == c] for c in np.unique(channels[part])}
        yield Piece(flat[picked].tobytes(), int(times[begin]), int(times[end - 1]), entries)
        begin = end
