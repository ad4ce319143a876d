"""The child process from the parent's side: started, asked, watched, killed, cleaned up after."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus import compiled
from fmus.archives import Fmu
from fmus.confinement import MEBIBYTE, Confinement, in_force, signal_of, wrapped
from fmus.errors import FmuError
from fmus.isolated import PEAK, frame
from fmus.pipes import Broken, Message, Pipes, until
from fmus.rows import Rows
from fmus.stepping import RunStatus

NEARLY = 0.9  # of the memory that it may have: a process that fails with that much has failed for the lack of more
RESERVED = 24 * MEBIBYTE  # what counts against the limit and need not be used: stacks of threads, the allocator's spare room
LOOK = 0.2  # seconds between two looks at a child that does not answer
START_TIMEOUT = 60.0  # seconds for a new child to say that it is ready, generous for a loaded machine


@dataclass(slots=True)
class Answer:
    """What came of a request: a status, why, the reply, messages and what the FMU printed."""

    status: RunStatus
    detail: str
    reply: dict[str, Any] = field(default_factory=dict)
    messages: list[tuple[float, str, str]] = field(default_factory=list)
    printed: str = ""


class Child:
    """The process, its folder and its pipes."""

    def __init__(self, confinement: Confinement | None = None) -> None:
        self.confinement = in_force(confinement or Confinement())
        self.folder = Path(tempfile.mkdtemp(prefix="slewcert-"))
        self.runs = 0
        self._unpacked: set[str] = set()
        work = self.folder / "work"
        work.mkdir()
        (self.folder / PEAK).touch()
        loop = compiled.found()
        # A copy of its own: the cache may not be visible in a sandbox.
        self.loop = None if loop is None else str(shutil.copyfile(loop, self.folder / loop.name))
        self.rows = Rows(self.folder)
        # Absolute, as the child works elsewhere: FMUs made of Python code look there for what they import.
        given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        path = os.pathsep.join(str(Path(entry).resolve()) for entry in (Path(__file__).resolve().parent.parent, *given))
        limits = [str(self.confinement.memory), str(self.confinement.file_size)]
        command = [sys.executable, "-P", "-m", "fmus.isolated", str(self.folder), *limits]
        try:
            self._process = subprocess.Popen(
                wrapped(command, self.folder, work, self.confinement),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                cwd=work,  # what the FMU writes to its working directory is removed with the folder
                env={**os.environ, "PYTHONPATH": path},
                start_new_session=os.name == "posix",  # so that what the FMU starts can be ended with it, and Ctrl-C is ours
            )
        except BaseException:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        self._group = _Group(process)
        self._finalizer = weakref.finalize(self, self._group.end, self.folder)
        self._asked = threading.Lock()
        self._pipes = Pipes(process.stdin.fileno(), process.stdout.fileno(), process.stderr.fileno())
        ready = self._await(Answer(RunStatus.FAILED, ""), time.monotonic() + START_TIMEOUT, _Patience(None, None))
        if ready is None or ready.get("status") != "READY":
            words = self._pipes.printed()[-2000:]
            self.stop()
            raise FmuError(f"the child process for the FMU did not start: {words or 'no message'}")

    @property
    def alive(self) -> bool:
        return self._finalizer.alive and not self._gone()

    def place(self, fmu: Fmu) -> Path:
        return self.folder / fmu.sha256[:32]

    def unpack(self, fmu: Fmu) -> None:
        if fmu.sha256 not in self._unpacked:
            self.place(fmu).mkdir()
            fmu.extract(self.place(fmu))
            self._unpacked.add(fmu.sha256)

    def ask(self, request: dict[str, Any], raw: bytes, timeout: float) -> Answer:
        """Send a request and wait for its reply, at most `timeout` seconds."""
        if not timeout > 0.0:
            raise FmuError(f"the wall-clock limit must be positive, is {timeout!r} s")
        place = os.path.join(self.folder, request["sha256"][:32])
        request["library"], request["resources"] = os.path.join(place, request["library"]), os.path.join(place, "resources")
        deadline = time.monotonic() + timeout
        answer = Answer(RunStatus.FAILED, "")
        with self._asked:
            if not self.alive:  # another thread has stopped it
                answer.status, answer.detail = RunStatus.CRASHED, "SIGKILL"
                return answer
            self._pipes.send(frame(request, raw))
            patience = _Patience(request.get("progress"), self.confinement.step)
            reply = self._await(answer, deadline, patience)
            if reply is not None:
                answer.status, answer.detail, answer.reply = RunStatus[reply["status"]], reply["detail"], reply
            elif not self._gone() and (patience.over or time.monotonic() >= deadline):
                answer.status, answer.detail = RunStatus.HUNG, f"no answer within {timeout:g} s"
                if patience.over:
                    answer.detail = f"a step took longer than {patience.limit:g} s"
                self._group.kill()
            else:
                code = signal_of(self._ended(), self.confinement)
                self._group.kill()
                with suppress(Broken):
                    self._take(answer, 0.0)  # messages that came before the end
                answer.status, answer.detail = self._judge(code)
            answer.printed = self._pipes.printed()
        return answer

    def stop(self) -> None:
        """Kill the process and what it started, remove the folder."""
        self._group.kill()
        with self._asked:  # whoever waits for an answer sees the end of it first
            self._finalizer()

    def _await(self, answer: Answer, deadline: float, patience: _Patience) -> Message | None:
        """The reply; messages on the way are collected. None when the child dies or the time is up."""
        while True:
            try:
                reply = self._take(answer, until(deadline, patience.look))
            except Broken:  # the FMU wrote into the pipe: what follows cannot be read
                return None
            if reply is not None:
                return reply
            # The end of the stream may never come if the FMU has started a process that holds the pipe.
            if self._pipes.ended or time.monotonic() >= deadline or self._gone() or patience.ends():
                return None

    def _take(self, answer: Answer, seconds: float) -> Message | None:
        """What comes within so many seconds: messages, and the reply if it is there."""
        for message in self._pipes.messages(seconds):
            if "restart" in message:
                answer.messages.clear()
            elif "message" in message:
                answer.messages.append(tuple(message["message"]))
            else:
                return message
        return None

    def _ended(self) -> int:
        deadline = time.monotonic() + 5.0
        while not self._gone():
            if time.monotonic() >= deadline:  # the FMU closed the pipe, but lives on
                return 0
            time.sleep(0.001)
        return self._process.returncode or 0

    def _gone(self) -> bool:
        return self._process.poll() is not None

    def _peak(self) -> int:
        """The most memory that the process has had [bytes], once it has ended; 0 if that is not known."""
        try:
            return int((self.folder / PEAK).read_text())
        except (OSError, ValueError):
            return 0

    def _judge(self, code: int) -> tuple[RunStatus, str]:
        status, detail = _judge_exit(code)
        if (peak := self._peak()) >= min(NEARLY * self.confinement.memory, self.confinement.memory - RESERVED):
            used, limit = peak / MEBIBYTE, self.confinement.memory / MEBIBYTE
            return RunStatus.MEMORY, f"{used:.0f} of the {limit:.0f} MiB that it may have, then {detail}"
        return status, detail


class _Patience:
    """How long a single step may take: the count of rows, which the child writes to a file that both map, has to go on."""

    def __init__(self, progress: str | None, limit: float | None) -> None:
        self.limit = limit if progress is not None and limit is not None else float("inf")
        self.look = min(LOOK, self.limit / 4.0)
        self.over = False
        self._file, self._seen, self._since = progress, b"", time.monotonic()

    def ends(self) -> bool:
        """Whether the present step has taken too long."""
        if self._file is None or self.limit == float("inf"):
            return False
        try:
            with open(self._file, "rb") as file:
                count = file.read(8)
        except OSError:
            return False
        if count != self._seen:
            self._seen, self._since = count, time.monotonic()
        self.over = time.monotonic() - self._since > self.limit
        return self.over


class _Group:
    """The process and all that it has started."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self._killed = False

    def kill(self) -> None:
        """Kill the process, and at the first call its whole group: later the group's number might be somebody else's."""
        if not self._killed and os.name == "posix":
            self._killed = True
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()

    def end(self, folder: Path) -> None:
        """Kill, reap, close, remove; runs once, at the latest when the parent's interpreter ends."""
        self.kill()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        shutil.rmtree(folder, ignore_errors=True)


def _judge_exit(code: int) -> tuple[RunStatus, str]:
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        outside = " (killed from outside, perhaps for lack of memory)" if name == "SIGKILL" else ""
        return RunStatus.CRASHED, f"{name}{outside}"
    if code >= 0x8000_0000:  # Windows' codes of exceptions
        return RunStatus.CRASHED, f"exception {code:#x}"
    return RunStatus.EXITED, f"exit code {code}"
