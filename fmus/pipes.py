"""The pipes to and from a child process: a request is written and what comes back is read, by one thread and against the clock."""

from __future__ import annotations

import json
import os
import select
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

OUTPUT_LIMIT = 2**16  # bytes kept of what an FMU prints in one run
LARGEST = 2**28  # bytes of an answer; what announces more was not written by us
CHUNK = 2**16

Message = dict[str, Any]


class Broken(Exception):
    """Somebody else has written into the pipe of answers."""


class Pipes:
    """Ends of the pipes: `requests` to write to, `answers` and `printed` to read from (file descriptors, closed by whoever opened them).

    Nothing here waits for one pipe only: a child that hangs does not read, one that floods its output must not be blocked.
    """

    def __init__(self, requests: int, answers: int, printed: int) -> None:
        self._requests, self._answers, self._printed = requests, answers, printed
        for descriptor in (requests, answers, printed):
            os.set_blocking(descriptor, False)
        self._poll = select.poll()
        self._poll.register(answers, select.POLLIN)
        self._poll.register(printed, select.POLLIN)
        self._unsent, self._received = memoryview(b""), bytearray()
        self._kept, self._more = bytearray(), False
        self.ended = False
        """Whether no answer can come any more."""

    def send(self, data: bytes) -> None:
        """Begin to send; the rest goes while answers are awaited. What was printed before belongs to no run."""
        self._print()
        self._kept, self._more = bytearray(), False
        self._unsent = memoryview(data)
        self._write()
        if self._unsent:
            self._poll.register(self._requests, select.POLLOUT)

    def messages(self, seconds: float) -> Iterator[Message]:
        """What has come within so many seconds, at once if there is something; raises `Broken`."""
        for descriptor, _ in self._poll.poll(max(seconds, 0.0) * 1e3):
            if descriptor == self._requests:
                self._write()
                if not self._unsent:
                    self._poll.unregister(descriptor)
            elif descriptor == self._printed:
                self._print()
            else:
                self._receive()
        while len(self._received) >= 8:
            text, raw = struct.unpack_from(">II", self._received)
            if text + raw > LARGEST:
                raise Broken
            if len(self._received) < 8 + text + raw:
                return
            body = bytes(self._received[8 : 8 + text])
            del self._received[: 8 + text + raw]
            try:
                message = json.loads(body)
            except ValueError:
                raise Broken from None
            if not isinstance(message, dict):
                raise Broken
            yield message

    def printed(self) -> str:
        """What the child has printed since the request, the beginning of it if it was much."""
        self._print()
        return self._kept.decode("utf-8", "replace") + ("\n… (more was printed, and dropped)" if self._more else "")

    def _write(self) -> None:
        try:
            while self._unsent:
                self._unsent = self._unsent[os.write(self._requests, self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:  # the child has died; the answers' end says so
            self._unsent = memoryview(b"")

    def _receive(self) -> None:
        def take(data: bytes) -> None:
            self._received += data

        if not self._read(self._answers, take):
            self.ended = True

    def _print(self) -> None:
        def take(data: bytes) -> None:
            room = OUTPUT_LIMIT - len(self._kept)
            self._kept += data[:room]
            self._more |= len(data) > room

        self._read(self._printed, take)

    def _read(self, descriptor: int, take: Callable[[bytes], None]) -> bool:
        """Read what is there, but not for ever; False at the end of the pipe."""
        for _ in range(64):
            try:
                data = os.read(descriptor, CHUNK)
            except BlockingIOError:
                return True
            except OSError:
                data = b""
            if not data:
                with suppress(KeyError):
                    self._poll.unregister(descriptor)
                return False
            take(data)
            if len(data) < CHUNK:
                return True
        return True


def until(deadline: float, look: float) -> float:
    """Seconds to wait until the deadline (of the monotonic clock), at most `look`."""
    return min(max(deadline - time.monotonic(), 0.0), look)
