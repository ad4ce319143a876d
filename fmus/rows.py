"""The rows of a run in a file that two processes map: the child fills it, and the parent has what is there whatever becomes of the child.

An int64 counts the complete rows, then come the rows, float64.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from functools import lru_cache
from pathlib import Path

HEAD = 8  # bytes of the count


class Rows:
    """The file from the parent's side, used for run after run, and replaced by a larger one when it has to be."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made, self._size = 0, 0
        self._map: mmap.mmap | None = None
        self.path = ""

    def begin(self, points: int, width: int) -> None:
        """Have room for so many rows; none is complete."""
        self._size = HEAD + 8 * points * width
        if self._map is None or len(self._map) < self._size:
            self.close()
            path = self._folder / f"progress-{self._made}"
            self._made += 1
            with path.open("w+b") as file:
                file.truncate(self._size)
                self._map = mmap.mmap(file.fileno(), self._size)
            self.path = str(path)
        self._map[:HEAD] = bytes(HEAD)

    def content(self) -> tuple[int, bytes]:
        """The count of complete rows, and a copy of all rows."""
        assert self._map is not None
        head = self._map[:HEAD]
        return int.from_bytes(head, sys.byteorder, signed=True), self._map[HEAD : self._size]

    def close(self) -> None:
        """Give up the file."""
        if self._map is not None:
            self._map.close()
            self._map = None
            Path(self.path).unlink(missing_ok=True)


class Progress:
    """The file from the child's side."""

    def __init__(self, path: str) -> None:
        """Map the file."""
        with open(path, "r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)
        self.count = ctypes.c_int64.from_buffer(self._map)
        self.address = ctypes.addressof(self.count) + HEAD


progress = lru_cache(maxsize=1)(Progress)
"""The file of that path, which stays mapped from run to run."""
