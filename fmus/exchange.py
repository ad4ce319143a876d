"""Model exchange: the FMU gives its equations, we integrate them, from one jump or event to the next.

    restart ──► integrator steps, rows on the way by interpolation ──► jump of the command, time event, state event, step event
       ▲                                                                                     │
       └───────────────── event iteration with the input as it is afterwards ◄───────────────┘

The command is evaluated inside the right-hand side, in the smooth piece that belongs to the leg at hand, so that nothing of it is held.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Callable
from ctypes import c_double

import numpy as np
from numpy.typing import NDArray

from fmus import rows
from fmus.errors import CallFailed, FmuError
from fmus.instances import Instance
from fmus.integration import Integrator, IntegratorError
from fmus.rows import Progress
from fmus.sessions import Messages, Request, create, driver, failed, prepare
from relaxations.commands import Command, Piece

Array = NDArray[np.float64]

HALVINGS = 10  # of a step whose evaluation the FMU discards
CAUTIOUS = 10  # accepted steps after which its successors may be longer again
LOCATED = 4 * np.finfo(float).eps  # relative accuracy of an event's time
NEAR = 64 * np.finfo(float).eps  # relative distance of two times between which nothing is integrated
MOST_EVENTS = 100  # at one instant
# Steps of a plant that is not stiff: a few for each communication step, and after a restart some while the order grows.
STEPS_PER_ROW, STEPS_PER_START = 20, 500


class _Terminated(Exception):
    """The FMU asks to end the run."""


class _NotFinite(Exception):
    """A derivative is not a number."""


def run(request: Request, raw: bytes, messages: Messages) -> Request:
    """Integrate through the request's grid; returns the reply."""
    times = array("d", raw)
    progress = rows.progress(request["progress"])
    messages.begin(times, progress.count)
    try:
        instance = create(request, "model_exchange", messages)
        prepare(instance, request)
        exchange = _Exchange(instance, request, times, progress, messages)
        exchange.carry_out()
        instance.terminate()
        warning = instance.warning
        instance.free()
    except _Terminated:
        return {"status": "TERMINATED", "detail": f"after {times[max(progress.count.value - 1, 0)]:.9g} s"}
    except _NotFinite as problem:
        return {"status": "NOT_FINITE", "detail": str(problem)}
    except IntegratorError as problem:
        return {"status": "STUCK", "detail": f"{problem} (after {times[max(progress.count.value - 1, 0)]:.9g} s)"}
    except CallFailed as problem:
        return failed(problem, progress, times)
    return {"status": "WARNING", "detail": warning} if warning else {"status": "FINISHED", "detail": ""}


class _Exchange:
    """One run: the instance, the point that is accepted so far, and the integrator."""

    def __init__(self, instance: Instance, request: Request, times: array[float], progress: Progress, messages: Messages) -> None:
        self._model = _Model(instance, request)
        self._instance, self._times, self._messages = instance, times, messages
        self._count = progress.count
        self._read = instance.reader(instance.groups([tuple(o) for o in request["outputs"]]), len(request["outputs"]), progress.address)
        self._pieces = Command.from_dict(request["command"]).pieces(request["initial_input"])
        self._tolerance: float = request["tolerance"]
        self._informs: bool = request["completed_steps"]
        self._time, self._states = 0.0, np.zeros(0)
        self._event_time = math.inf
        self._events_here = 0
        self._stiff, self._taken, self._allowed = False, 0, 0
        self._largest, self._since_cut = 0.0, 0

    def carry_out(self) -> None:
        """The whole run."""
        starts = [piece.start for piece in self._pieces]
        self._model.piece = Piece(0.0, self._model.initial_input)
        self._settle()
        self._read(0)
        self._count.value = 1
        self._event(self._pieces[0], entered=True)
        last = len(self._times) - 1
        row = 1
        while row <= last:
            middle = (self._times[row - 1] + self._times[row]) / 2.0
            index = max(bisect_right(starts, middle) - 1, 0)
            piece = self._pieces[index]
            if piece is not self._model.piece:
                self._event(piece)
            until = row
            following = starts[index + 1] if index + 1 < len(starts) else math.inf
            while until < last and (self._times[until] + self._times[until + 1]) / 2.0 < following:
                until += 1
            self._leg(row, until)
            row = until + 1

    def _leg(self, row: int, last: int) -> None:
        """From the accepted point to the time of row `last`, without a jump of the command; fills in the rows from `row` on."""
        goal = self._times[last]
        halvings = 0
        while row <= last:
            stop = min(goal, self._event_time)
            try:
                reached, states, crossed = self._advance(stop)
                while row <= last and self._times[row] <= reached:
                    inside = self._time < self._times[row] < reached
                    self._model.move(self._times[row], self._integrator.at(self._times[row]) if inside else states)
                    self._read(row)
                    row += 1
                    self._count.value = row
                self._model.move(reached, states)
            except (CallFailed, _NotFinite) as problem:
                if (isinstance(problem, CallFailed) and problem.status != "Discard") or halvings == HALVINGS:
                    raise
                halvings += 1
                self._shorten()
                continue
            event, terminate = self._instance.complete_step() if self._informs else (False, False)
            if terminate:
                raise _Terminated
            if reached > self._time:
                halvings = self._events_here = 0
            self._time, self._states = reached, states
            self._since_cut += 1
            if crossed or event or reached >= self._event_time:
                kind = "state" if crossed else "step" if event else "time"
                self._messages("ok", f"{kind} event at {reached:.12g} s")
                self._event()
            elif self._largest and self._since_cut > CAUTIOUS:
                self._start()
            elif not self._stiff and self._taken > self._allowed + STEPS_PER_ROW * row:
                self._stiff = True
                self._messages("ok", f"at {reached:.9g} s the plant proves stiff: from here on by backward differentiation")
                self._start()

    def _advance(self, stop: float) -> tuple[float, Array, bool]:
        """One integrator step from the accepted point, cut short at the first state event in it."""
        before = self._model.domains
        if stop - self._time <= NEAR * abs(stop):  # no step, but the rounding of a time
            return stop, self._states, False
        reached, states = self._integrator.step(stop)
        self._taken += 1
        after = self._model.look(reached, states)
        if after == before:
            return reached, states, False
        low, high = self._time, reached
        while high - low > LOCATED * max(abs(high), high - self._time):
            middle = (low + high) / 2.0
            if not low < middle < high:
                break
            if self._model.look(middle, self._integrator.at(middle)) == before:
                low = middle
            else:
                high = middle
        return high, states if high == reached else self._integrator.at(high), True

    def _shorten(self) -> None:
        """After a discarded evaluation: again from the accepted point, with at most half of the step that was tried."""
        tried = self._model.time - self._time
        shorter = max(tried, np.finfo(float).eps * abs(self._time)) / 2.0
        self._messages("discard", f"a step of {tried:.9g} s from {self._time:.9g} s was discarded: cut to {shorter:.9g} s")
        self._since_cut = 0
        self._start(shorter)

    def _event(self, piece: Piece | None = None, entered: bool = False) -> None:
        """An event at the accepted point, from which on another `piece` of the command may hold; then a restart."""
        self._events_here += 1
        if self._events_here > MOST_EVENTS:
            raise FmuError(f"more than {MOST_EVENTS} events at {self._time:.9g} s: time does not go on")
        if not entered:
            self._model.move(self._time, self._states)
            self._instance.enter_event_mode()
        if piece is not None:
            self._model.piece = piece
            self._model.set_input(self._time)
        self._settle()
        self._instance.enter_continuous_time()
        self._states = self._model.states()
        self._start()

    def _settle(self) -> None:
        settled = self._instance.settle()
        if settled.terminate:
            raise _Terminated
        self._event_time = settled.next_event

    def _start(self, largest: float = 0.0) -> None:
        """A new beginning for the integrator, from the accepted point, with steps of at most `largest` [s] (0: any).

        An event may have changed the states' sizes.
        """
        self._largest = largest
        self._integrator = Integrator(self._model.slopes, self._model.sizes(), self._tolerance, self._stiff, self._largest)
        self._integrator.start(self._time, self._states)
        self._allowed += STEPS_PER_START
        self._model.domains = self._model.look(self._time, self._states)


class _Model:
    """The FMU as equations: `ẋ = f(t, x, u(t))`, and the signs of its event indicators."""

    def __init__(self, instance: Instance, request: Request) -> None:
        self._instance = instance
        self.initial_input: float = request["initial_input"]
        self.piece = Piece(0.0, self.initial_input)
        self.time = 0.0
        self.domains: bytes = b""
        self._n, self._indicators = instance.sizes(request["states"], request["indicators"])
        # CVODE has no systems without states: one that stands still takes their place.
        self._x, self._dx, self._z = ((c_double * max(n, 1))() for n in (self._n, self._n, self._indicators))
        self._x_view, self._dx_view, self._z_view = (np.ctypeslib.as_array(buffer) for buffer in (self._x, self._dx, self._z))
        self._set_input: Callable[[float], None] = driver(instance, request)

    def states(self) -> Array:
        """The FMU's continuous states, at least one."""
        return np.array(self._instance.states(self._n) or [0.0])

    def sizes(self) -> Array:
        """Their nominal sizes."""
        return np.array(self._instance.nominals(self._n) or [1.0])

    def set_input(self, time: float) -> None:
        """Set the input to the command at `time` [s]."""
        self._set_input(self.piece(time))

    def move(self, time: float, states: Array) -> None:
        """Set time, states and input."""
        self.time = time
        self._instance.call("SetTime", time)
        if self._n:
            self._x_view[:] = states
            self._instance.call("SetContinuousStates", self._x, self._n)
        if not self.piece.constant:
            self.set_input(time)

    def slopes(self, time: float, states: Array, out: Array) -> None:
        """The derivatives of the states, into `out`."""
        self.move(time, states)
        if self._n:
            self._instance.call(self._instance.derivatives_function, self._dx, self._n)
            if not np.isfinite(self._dx_view).all():
                i = int(np.flatnonzero(~np.isfinite(self._dx_view))[0])
                raise _NotFinite(f"the derivative of continuous state {i + 1} is {self._dx_view[i]} at {time:.9g} s")
            out[:] = self._dx_view
        else:
            out[:] = 0.0

    def look(self, time: float, states: Array) -> bytes:
        """Which event indicators are positive there, one byte each."""
        if not self._indicators:
            return b""
        self.move(time, states)
        self._instance.call("GetEventIndicators", self._z, self._indicators)
        return (self._z_view > 0.0).tobytes()
