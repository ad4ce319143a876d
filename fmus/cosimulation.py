"""The stepping loop of a co-simulation: inputs, steps, events, and what to do when the FMU does not take a step as it was asked to.

Only the standard library is imported here: it runs beside the FMU, in a child that has to start fast.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable
from ctypes import CDLL

from fmus import rows
from fmus.accesses import Group
from fmus.compiled import INPUT, READ, SET, STEP, TILT, Loop, load
from fmus.errors import CallFailed, FmuError
from fmus.events import Interruption, Steps
from fmus.instances import Instance
from fmus.interfaces import Instance2, Instance3
from fmus.rows import Progress
from fmus.sessions import Messages, Request, create, driven, driver, failed, prepare

HALVINGS = 10  # of a step that the FMU discards: 2^-10 of a communication step is as short as any FMU asked for in earnest
SAME = 1e-12  # of a step: an early return nearer to its end than this was at its end
MOST_PARTS = 10_000  # of a communication step, in which nearly as many events may lie
DISCARD = 2

Reader = Callable[[int], None]


class _NeedsCopies(Exception):
    """A discarded step can be taken again only from a copy of the FMU's state, and there was none."""


class _Terminated(Exception):
    """The FMU asks to end the run."""


def run(request: Request, raw: bytes, messages: Messages) -> Request:
    """Step through the request's grid; returns the reply.

    Most runs never see a step discarded, so copies of the FMU's state are taken only in a second attempt.
    """
    try:
        return _attempt(request, raw, messages, copies=False)
    except _NeedsCopies:
        messages.restart()
        return _attempt(request, raw, messages, copies=True)


def _attempt(request: Request, raw: bytes, messages: Messages, copies: bool) -> Request:
    n = request["points"]
    columns = [array("d", raw[8 * i : 8 * j]) for i, j in _spans(n, request["ramps"])]
    times = columns[0]
    progress = rows.progress(request["progress"])
    count = progress.count
    count.value = 0
    messages.begin(times, count)
    supply = _Supply(request) if request["intermediate"] else None
    try:
        steps = Steps(request["event_mode"], request["early_return"], supply.required if supply else (), supply)
        instance = create(request, "co_simulation", messages, steps)
        prepare(instance, request)
        groups = instance.groups([tuple(o) for o in request["outputs"]])
        read = instance.reader(groups, len(request["outputs"]), progress.address)
        stepping = _Stepping(instance, request, messages, copies)
        if supply:
            supply.instance, supply.assign = instance, driver(instance, request)
        stepping.begin(read)
        count.value = 1
        code = load(request["loop"]) if request["loop"] and not (supply or copies) else None
        if code is not None:
            _compiled(code, instance, request, stepping, columns, groups, progress)
        elif not (supply or copies or request["ramps"]) and len(groups) == 1 and groups[0].straight:
            _bare(instance, request, stepping, columns, groups[0], progress)
        else:
            _interpreted(stepping, supply, columns, read, progress)
        instance.terminate()
        warning = instance.warning
        instance.free()
    except _Terminated:
        return {"status": "TERMINATED", "detail": f"during the step from {times[max(count.value - 1, 0)]:.9g} s"}
    except CallFailed as problem:
        return failed(problem, progress, times)
    return {"status": "WARNING", "detail": warning} if warning else {"status": "FINISHED", "detail": ""}


def _spans(n: int, ramps: bool) -> list[tuple[int, int]]:
    """Where the columns lie in the raw part: times (n), sizes, levels and, with ramps, slopes (n - 1 each)."""
    return [(0, n), *((n + i * (n - 1), n + (i + 1) * (n - 1)) for i in range(3 if ramps else 2))]


def _interpreted(
    stepping: _Stepping,
    supply: _Supply | None,
    columns: list[array[float]],
    read: Reader,
    progress: Progress,
) -> None:
    """The loop in Python."""
    times, sizes, levels = columns[:3]
    slopes = columns[3] if len(columns) > 3 else None
    applied, sloped = None, 0.0
    for i in range(len(sizes)):
        level, slope = levels[i], slopes[i] if slopes else 0.0
        if supply.select((times[i] + times[i + 1]) / 2.0) if supply else level != applied or slope != 0.0 or sloped != 0.0:
            stepping.apply(times[i], level, slope)
            applied, sloped = level, slope
        stepping.advance(times[i], sizes[i])
        read(i + 1)
        progress.count.value = i + 2


def _bare(instance: Instance, request: Request, stepping: _Stepping, columns: list[array[float]], group: Group, progress: Progress) -> None:
    """The same where every row is one call and the input holds between its jumps: no more is done in Python than the calls themselves."""
    times, sizes, levels = columns[:3]
    one, row, count = instance.bare_step(), instance.bare_read(group), progress.count
    step, step_arguments, time, size, ended = one.function, one.arguments, one.time, one.size, one.ended
    read, read_arguments, place = row.function, row.arguments, row.place
    stride, address, applied, due = 8 * len(request["outputs"]), progress.address, None, stepping.due
    for i, (t, h, level) in enumerate(zip(times, sizes, levels, strict=False), 2):
        if level != applied:
            stepping.apply(t, level, 0.0)
            applied, due = level, stepping.due
        if due < t + h:
            stepping.advance(t, h)
            due = stepping.due
        else:
            time.value, size.value = t, h
            status = step(*step_arguments)
            if status or ended.value:
                stepping.stepped(status, t, h)
                due = stepping.due
        address += stride
        place.value = address
        status = read(*read_arguments)
        if status:
            instance.judge(row.name, status)
        count.value = i


def _compiled(
    code: CDLL,
    instance: Instance,
    request: Request,
    stepping: _Stepping,
    columns: list[array[float]],
    groups: list[Group],
    progress: Progress,
) -> None:
    """The same in C, which asks back where something happens."""
    times, sizes, levels = columns[:3]
    slopes = columns[3] if len(columns) > 3 else None
    inputs = driven(instance, request)

    def ask(row: int, what: int, status: int) -> None:
        if what == INPUT:
            stepping.apply(times[row], levels[row], 0.0)
        elif what == SET:
            instance.judge(f"{instance.prefix}Set{inputs.suffix}", status)
        elif what == TILT:
            instance.judge(f"{instance.prefix}SetRealInputDerivatives", status)
        elif what >= READ:
            instance.judge(f"{instance.prefix}Get{groups[what - READ].suffix}", status)
        else:
            stepping.note(times[row], levels[row], slopes[row] if slopes else 0.0)
            if what == STEP:
                stepping.stepped(status, times[row], sizes[row])
            else:
                stepping.advance(times[row], sizes[row])
        loop.event_time = stepping.event_time

    loop = Loop(code, instance, inputs, request["ramps"], groups, ask)
    loop.event_time = stepping.event_time
    if isinstance(instance, Instance3):
        loop.flags(instance)
    width = len(request["outputs"])
    loop.run(columns, width, progress.address, progress.count, events=request["event_mode"], divisible=request["divisible"])


class _Supply:
    """The command at any instant, for an FMU that asks for its input within a step."""

    def __init__(self, request: Request) -> None:
        from relaxations.commands import Command  # brings NumPy along: only such runs need it

        self.required = (request["input"][1],)
        self.instance: Instance | None = None
        self.assign: Callable[[float], None] = lambda value: None
        self._pieces = Command.from_dict(request["command"]).pieces(request["initial_input"])
        self._starts = [piece.start for piece in self._pieces]
        self._piece = None

    def select(self, middle: float) -> bool:
        """The next step is the one around this time [s]; whether a new piece of the command begins with it."""
        before, self._piece = self._piece, self._pieces[max(bisect_right(self._starts, middle) - 1, 0)]
        return self._piece is not before

    def __call__(self, time: float) -> None:
        """Set the input to what the command is at `time` [s]."""
        assert self.instance is not None
        assert self._piece is not None
        self.assign(self._piece(time))


class _Stepping:
    """The steps of one instance."""

    def __init__(self, instance: Instance, request: Request, messages: Messages, copies: bool) -> None:
        reference = request["input"][1]
        self._instance, self._messages = instance, messages
        self._step: Callable[[float, float], Interruption | None] = instance.stepper()
        self._assign = driver(instance, request)
        self._tilt = instance.ramp(reference) if isinstance(instance, Instance2) and request["ramps"] else None
        self._events = instance if isinstance(instance, Instance3) and request["event_mode"] else None
        self._keep, self._back = instance.keeper() if isinstance(instance, Instance2) and copies else (None, None)
        self._copyable: bool = request["copies"] and not copies
        self._divisible: bool = request["divisible"]
        self._level, self._slope, self._since = 0.0, 0.0, 0.0
        self.event_time = float("inf")
        """The next event that the FMU has announced [s]."""

    @property
    def due(self) -> float:
        """Before which time [s] a step has to end, for the next event."""
        return self.event_time if self._divisible else float("inf")

    def begin(self, read: Callable[[int], None]) -> None:
        """Read the first row; out of the event mode that initialisation ends in."""
        if self._events:
            self._settle()
            read(0)
            self._events.enter_step_mode()
        else:
            read(0)

    def apply(self, time: float, level: float, slope: float) -> None:
        """The input from `time` [s] on."""
        self.note(time, level, slope)
        if self._events:  # a jump of the input is an event
            self._event(lambda: self._assign(level))
        else:
            self._tell(time)

    def note(self, time: float, level: float, slope: float) -> None:
        """What the input is from `time` [s] on, however it is told."""
        self._level, self._slope, self._since = level, slope, time

    def stepped(self, status: int, start: float, size: float) -> None:
        """After a step from `start` over `size` [s] that returned `status`."""
        stopped = self._instance.stepped(status, start, size)
        if stopped is not None:
            self._resume(start, size, stopped)

    def advance(self, start: float, size: float) -> None:
        """From `start` over `size` [s], in one step if the FMU takes it."""
        if self._keep:
            self._keep()
        stopped = self._step(start, size) if self.due >= start + size else Interruption(start)
        if stopped is not None:
            self._resume(start, size, stopped)

    def _resume(self, start: float, size: float, stopped: Interruption) -> None:
        """The rest of a step that the FMU did not take as a whole, and the events on the way."""
        end, now, largest, asked, halvings = start + size, start, size, size, 0
        for _ in range(MOST_PARTS):
            if stopped.terminate:
                raise _Terminated
            if stopped.discarded:
                if not self._divisible or halvings == HALVINGS:
                    self._instance.judge(self._instance.prefix + "DoStep", DISCARD)
                if self._copyable:
                    raise _NeedsCopies
                halvings, largest = halvings + 1, asked / 2.0
                if self._back:
                    self._back()
                else:
                    now = stopped.reached
                self._messages("discard", f"a step of {asked:.9g} s from {now:.9g} s was discarded: cut to {largest:.9g} s")
            else:
                now = stopped.reached
                if self._events and (stopped.event or now >= self.event_time):
                    self._messages("ok", f"event at {now:.12g} s")
                    self._event()
            left = end - now
            if left <= SAME * size:
                return
            asked = min(left, largest)
            if self._divisible and now < self.event_time < now + asked:
                asked = self.event_time - now
            if self._tilt:
                self._tell(now)
            if self._keep:
                self._keep()
            stopped = self._step(now, asked) or Interruption(end if asked == left else now + asked)
        raise FmuError(f"the FMU did not take the step of {size:.9g} s from {start:.9g} s in {MOST_PARTS} parts")

    def _tell(self, time: float) -> None:
        """Tell the input and, to an FMU that interpolates, its slope, as they are at `time` [s]."""
        self._assign(self._level + self._slope * (time - self._since))
        if self._tilt:
            self._tilt(self._slope)

    def _event(self, change: Callable[[], object] = lambda: None) -> None:
        assert self._events is not None
        self._events.enter_event_mode()
        change()
        self._settle()
        self._events.enter_step_mode()

    def _settle(self) -> None:
        settled = self._instance.settle()
        if settled.terminate:
            raise _Terminated
        self.event_time = settled.next_event
