"""The child process beside an FMU's machine code: reads requests, drives the FMU, writes replies.

Only the standard library is imported here, so that a new child is ready in some 30 ms; what needs more imports it when it is used.
Whatever the FMU does to this process, the parent (`fmus.workers`) survives: rows go to a file that both map into memory, messages are
sent as they come.

Frames, both ways: two big-endian 32-bit lengths, then JSON, then raw bytes. Requests are "run" and "linearize".
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import shutil
import signal
import struct
import sys
import threading
from array import array
from contextlib import suppress
from pathlib import Path
from typing import IO, NoReturn

from fmus import cosimulation
from fmus.errors import CallFailed, FmuError
from fmus.instances import Instance
from fmus.jacobians import jacobian
from fmus.sessions import Messages, Request, create, prepare

PEAK = "peak"  # the file that holds the most memory that the FMU's process has had [bytes], once it has ended


def read_frame(stream: IO[bytes]) -> tuple[Request, bytes] | None:
    """The next frame, None at the end of the stream."""
    head = stream.read(8)
    if len(head) < 8:
        return None
    text, raw = struct.unpack(">II", head)
    body = stream.read(text), stream.read(raw)
    return (json.loads(body[0]), body[1]) if len(body[0]) == text and len(body[1]) == raw else None


def frame(message: Request, raw: bytes = b"") -> bytes:
    """A frame's bytes."""
    text = json.dumps(message).encode()
    return struct.pack(">II", len(text), len(raw)) + text + raw


def run(request: Request, raw: bytes, messages: Messages) -> Request:
    """One run, by the interface that was asked for; returns the reply."""
    if request["interface"] == "co_simulation":
        return cosimulation.run(request, raw, messages)
    from fmus import exchange  # brings the integrator along, which takes longer to load than many a run

    return exchange.run(request, raw, messages)


def linearize(request: Request, messages: Messages) -> Request:
    """The FMU's Jacobian at its operating point; returns the reply."""
    messages.begin(array("d"), None)

    def make() -> Instance:
        instance = create(request, request["interface"], messages)
        prepare(instance, request)
        if request["interface"] == "co_simulation":
            step = instance.stepper()
            count, size = request["settle"]
            for i in range(count):
                if step(i * size, size) is not None:
                    raise FmuError(f"the FMU interrupts its step from {i * size:.9g} s, before it has settled")
        else:
            instance.start_continuous_time()
            if request["state"]:
                instance.set_time(request["time"])
                instance.set_states(request["state"])
        return instance

    return jacobian(request, make)


def serve(requests: IO[bytes], replies: int, folder: str) -> None:
    """Answer requests until the parent goes away."""
    lock = threading.Lock()

    def send(message: Request) -> None:
        data = frame(message)
        with lock:
            while data:
                data = data[os.write(replies, data) :]

    def leave() -> NoReturn:
        """The parent is gone, however it went: leave nothing behind."""
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    def watch() -> None:
        """Leave even while the FMU hangs in the other thread."""
        poll = select.poll()
        poll.register(requests, 0)  # tells of nothing but the end of the pipe
        while not any(event & (select.POLLHUP | select.POLLERR) for _, event in poll.poll()):
            pass
        leave()

    threading.Thread(target=watch, daemon=True).start()
    messages = Messages(send)
    send({"status": "READY"})
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else ctypes.cdll.msvcrt.fflush
    while True:
        item = read_frame(requests)
        if item is None:
            leave()
        request, raw = item
        try:
            reply = run(request, raw, messages) if request["kind"] == "run" else linearize(request, messages)
        except CallFailed as problem:
            reply = {"status": "FAILED", "detail": str(problem)}
        except FmuError as problem:
            reply = {"status": "FAILED", "detail": str(problem)}
        except OSError as problem:  # on Windows an access violation inside the FMU arrives as this
            reply = {"status": "CRASHED", "detail": str(problem)}
        flush(None)  # what the FMU printed belongs before the reply
        try:
            send(reply)
        except OSError:
            leave()


def main() -> None:
    """Take the standard streams away from the FMU, then serve.

    The arguments are the folder to remove when the parent dies, and the limits of memory and of a file [bytes].
    """
    requests, replies = os.fdopen(os.dup(0), "rb"), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    folder, memory, file_size = sys.argv[1], *map(int, sys.argv[2:])
    if os.name == "posix":
        _limit(memory, file_size)
        if pid := os.fork():
            for descriptor in (requests.fileno(), replies, 0, 1, 2):
                os.close(descriptor)  # the parent reads to the end of these, which is the FMU's end
            _watch(pid, Path(folder) / PEAK)
    serve(requests, replies, folder)


def _watch(pid: int, note: Path) -> NoReturn:
    """Wait for the FMU's process, note the most memory that it has had [bytes], end as it did.

    Its own parent has to be a small process: what a process counts as its most memory begins with that of the one that started it,
    and whoever runs FMUs may be larger than all that they are allowed.
    """
    _, status, usage = os.wait4(pid, 0)
    with suppress(OSError), note.open("r+") as file:  # if it is gone, so is whoever wanted to know
        file.write(str(usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)))
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        if -code != signal.SIGKILL:
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


def _limit(memory: int, file_size: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash is reported, its memory image helps nobody here
    for what, limit in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_FSIZE, file_size)):
        hard = resource.getrlimit(what)[1]
        least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (least, least))


if __name__ == "__main__":
    main()
