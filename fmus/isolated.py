"""The child process beside an FMU's machine code: reads requests, drives the FMU, writes replies.

Only the standard library is imported here, so that a new child is ready in some 30 ms. Whatever the FMU does to this
process, the parent (`fmus.workers`) survives: rows go to a file that both map into memory, messages are sent as they come.

Frames, both ways: two big-endian 32-bit lengths, then JSON, then raw bytes. Requests are "run" and "linearize".
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import queue
import shutil
import struct
import sys
import threading
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from fmus.errors import CallFailed, FmuError
from fmus.instances import Instance, Log
from fmus.interfaces import Instance2, Instance3

MAX_MESSAGES = 1000
MAX_TEXT = 2000

Request = dict[str, Any]


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


class Progress:
    """Rows of float64 in a file that the parent created: int64 count of complete rows, then the rows."""

    def __init__(self, path: str) -> None:
        """Map the file."""
        with open(path, "r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)
        self.count = ctypes.c_int64.from_buffer(self._map)
        self.address = ctypes.addressof(self.count) + 8


class Messages:
    """Sends the FMU's log messages on as they come, at most `MAX_MESSAGES` a run."""

    def __init__(self, send: Callable[[Request], None]) -> None:
        """`send` takes one frame's message."""
        self._send = send
        self.number = 0
        self.count: ctypes.c_int64 | None = None
        self.times: array[float] = array("d")

    def begin(self, times: array[float], count: ctypes.c_int64 | None) -> None:
        """Start a run: a message's time is that of the last complete row."""
        self.number, self.times, self.count = 0, times, count

    def __call__(self, level: str, text: str) -> None:
        """Pass one message on."""
        self.number += 1
        if self.number > MAX_MESSAGES + 1:
            return
        row = max(self.count.value - 1, 0) if self.count is not None else 0
        time = self.times[row] if row < len(self.times) else 0.0
        if self.number == MAX_MESSAGES + 1:
            level, text = "warning", f"the FMU sent more than {MAX_MESSAGES} messages; the rest is dropped"
        cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + " …"
        self._send({"message": [time, level, cut]})


def create(request: Request, interface: str, log: Log) -> Instance:
    """A fresh instance; its binary stays loaded from run to run.

    It costs a tenth of a millisecond and carries nothing over from the run before, which a reset only promises.
    """
    kind = Instance2 if request["fmi"] == 2 else Instance3
    instance = kind(Path(request["library"]), request["token"], request["name"], Path(request["resources"]), log)
    instance.instantiate(interface)
    instance.log_trouble(request["log_categories"])
    return instance


def prepare(instance: Instance, request: Request) -> None:
    """Set structural parameters, parameters and start values, initialise with the inputs at rest."""
    instance.configure(request["structure"])
    for kind, reference, value in request["start"]:
        instance.set((kind, reference), value)
    instance.enter_initialization(request["stop"], request["tolerance"])
    for kind, reference, value in request["inputs"]:
        instance.set((kind, reference), value)
    driver(instance, request)(request["initial_input"])
    instance.exit_initialization()


def driver(instance: Instance, request: Request) -> Callable[[float], None]:
    """A fast function that sets the input that the command drives; if it is an array's element, its neighbours keep what they have."""
    kind, reference, *element = request["input"]
    return instance.setter(kind, reference, element, request["neighbours"])


def run(request: Request, raw: bytes, messages: Messages) -> Request:
    """Step through the request's grid; returns the reply."""
    n = request["points"]
    columns = [array("d", raw[8 * i : 8 * j]) for i, j in _spans(n, request["ramps"])]
    times, sizes, levels = columns[:3]
    progress = Progress(request["progress"])
    count = progress.count
    messages.begin(times, count)
    try:
        instance = create(request, "co_simulation", messages)
        prepare(instance, request)
        assign, step, reference = driver(instance, request), instance.stepper(), request["input"][1]
        read = instance.reader([tuple(o) for o in request["outputs"]], progress.address)
        tilt = instance.ramp(reference) if request["ramps"] and isinstance(instance, Instance2) else None
        slopes = columns[3] if tilt else None
        read(0)
        count.value = 1
        applied, sloped = None, 0.0
        for i in range(n - 1):
            level = levels[i]
            if level != applied:
                assign(level)
                applied = level
            if tilt is not None and slopes is not None and (slopes[i] != 0.0 or sloped != 0.0):
                sloped = slopes[i]
                assign(level)
                tilt(sloped)
            terminate = step(times[i], sizes[i])
            if terminate:
                return {"status": "TERMINATED", "detail": f"during the step from {times[i]:.9g} s"}
            read(i + 1)
            count.value = i + 2
        instance.terminate()
        warning = instance.warning
        instance.free()
    except CallFailed as problem:
        status = problem.status.upper() if problem.status in ("Discard", "Error", "Fatal") else "FAILED"
        done = count.value
        return {"status": status, "detail": f"{problem} ({f'after {times[done - 1]:.9g} s' if done else 'before the first point'})"}
    return {"status": "WARNING", "detail": warning} if warning else {"status": "FINISHED", "detail": ""}


def _spans(n: int, ramps: bool) -> list[tuple[int, int]]:
    """Where the columns lie in the raw part: times (n), sizes, levels and, with ramps, slopes (n - 1 each)."""
    return [(0, n), *((n + i * (n - 1), n + (i + 1) * (n - 1)) for i in range(3 if ramps else 2))]


def linearize(request: Request, messages: Messages) -> Request:
    """The FMU's Jacobian at its initial point, by Model Exchange; returns the reply."""
    messages.begin(array("d"), None)
    instance = create(request, "model_exchange", messages)
    prepare(instance, request)
    instance.start_continuous_time()
    states, derivatives = request["states"], request["derivatives"]
    n, count = len(states), len(request["outputs"])
    outputs = [tuple(o) for o in request["outputs"]]
    assign, reference = driver(instance, request), request["input"][1]
    x, u = instance.states(n), request["initial_input"]
    result = {"x": x, "rates": instance.rates(n), "y": instance.get(outputs), "method": "directional derivatives", "note": ""}
    columns: list[list[float]] = []
    if request["directional"]:
        unknowns = [*derivatives, *(r for _, r in outputs)]
        try:
            columns = [instance.derivative(unknowns, known) for known in (*states, reference)]
        except CallFailed as problem:
            if problem.status == "Fatal":
                raise
            columns, result["note"] = [], f"directional derivatives failed ({problem})"
    if not columns:
        result["method"] = "finite differences"

        def evaluate(point: list[float]) -> list[float]:
            instance.set_states(point[:n]) if n else None
            assign(point[n])
            return instance.rates(n) + instance.get(outputs)

        point = [*x, u]
        for i, scale in enumerate(request["scales"]):
            # Central differences: the error h²·f‴/6 + ε·f/h is least near h = ε^(1/3).
            h = 6e-6 * max(abs(point[i]), scale)
            above, below = point[i] + h, point[i] - h
            high = evaluate([*point[:i], above, *point[i + 1 :]])
            low = evaluate([*point[:i], below, *point[i + 1 :]])
            columns.append([(a - b) / (above - below) for a, b in zip(high, low, strict=True)])
    instance.free()
    rows = [[column[i] for column in columns] for i in range(n + count)]
    return {"status": "FINISHED", "detail": instance.warning, "rows": rows, **result}


def serve(requests: IO[bytes], replies: int, folder: str) -> None:
    """Answer requests until the parent goes away."""
    lock = threading.Lock()

    def send(message: Request) -> None:
        data = frame(message)
        with lock:
            while data:
                data = data[os.write(replies, data) :]

    inbox: queue.SimpleQueue[tuple[Request, bytes]] = queue.SimpleQueue()

    def receive() -> None:
        while (item := read_frame(requests)) is not None:
            inbox.put(item)
        # The parent is gone, however it went: leave nothing behind, even if the FMU hangs in the other thread.
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    threading.Thread(target=receive, daemon=True).start()
    messages = Messages(send)
    send({"status": "READY"})
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else ctypes.cdll.msvcrt.fflush
    while True:
        request, raw = inbox.get()
        try:
            reply = run(request, raw, messages) if request["kind"] == "run" else linearize(request, messages)
        except CallFailed as problem:
            reply = {"status": "FAILED", "detail": str(problem)}
        except FmuError as problem:
            reply = {"status": "FAILED", "detail": str(problem)}
        except OSError as problem:  # on Windows an access violation inside the FMU arrives as this
            reply = {"status": "CRASHED", "detail": str(problem)}
        flush(None)  # what the FMU printed belongs before the mark
        try:
            os.write(2, request["mark"].encode())
            send(reply)
        except OSError:  # the parent is gone: the other thread cleans up and ends the process, so it must not end before
            threading.Event().wait()


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
    serve(requests, replies, folder)


def _limit(memory: int, file_size: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash is reported, its memory image helps nobody here
    for what, limit in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_FSIZE, file_size)):
        hard = resource.getrlimit(what)[1]
        least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (least, least))


if __name__ == "__main__":
    main()
