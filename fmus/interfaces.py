"""What differs between FMI 2.0 and FMI 3.0: the functions' signatures, the values' types, the order of calls."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable, Sequence
from ctypes import addressof, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint64, c_void_p
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

from fmus.accesses import BareStep
from fmus.errors import FmuError
from fmus.events import Discrete, Interruption, Steps
from fmus.instances import Instance, Number, format_messages

_LOGGER2 = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_LOGGER3 = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)
_UPDATE3 = ctypes.CFUNCTYPE(None, c_void_p, c_double, *[c_bool] * 4, c_void_p, c_void_p)
_C = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt


class _Callbacks2(ctypes.Structure):
    _fields_ = (("logger", c_void_p), ("allocate", c_void_p), ("free", c_void_p), ("finished", c_void_p), ("environment", c_void_p))


class _EventInfo2(ctypes.Structure):
    _fields_ = (
        *((name, c_int) for name in ("again", "terminate", "nominals_changed", "states_changed", "next_defined")),
        ("next", c_double),
    )


@lru_cache(maxsize=16)
def _uri(folder: Path) -> bytes:
    return folder.as_uri().encode()


class Instance2(Instance):
    """FMI 2.0."""

    _copy: c_void_p | None = None

    prefix = "fmi2"
    signatures: ClassVar[dict[str, str]] = {
        "Instantiate": "sissvii",
        "FreeInstance": "v",
        "SetDebugLogging": "vizv",
        "SetupExperiment": "viddid",
        "EnterInitializationMode": "v",
        "ExitInitializationMode": "v",
        "Terminate": "v",
        "Reset": "v",
        "DoStep": "vddi",
        "GetBooleanStatus": "viv",
        "GetRealStatus": "viv",
        "GetFMUstate": "vv",
        "SetFMUstate": "vv",
        "FreeFMUstate": "vv",
        "SetRealInputDerivatives": "vrzvv",
        "NewDiscreteStates": "vv",
        "EnterEventMode": "v",
        "SetTime": "vd",
        "GetEventIndicators": "vvz",
        "GetNominalsOfContinuousStates": "vvz",
        "CompletedIntegratorStep": "vivv",
        "EnterContinuousTimeMode": "v",
        "GetContinuousStates": "vvz",
        "SetContinuousStates": "vvz",
        "GetDerivatives": "vvz",
        "GetDirectionalDerivative": "vrzrzvv",
    }
    types: ClassVar[dict[str, tuple[str, Number]]] = {
        "Real": ("Real", c_double),
        "Integer": ("Integer", c_int),
        "Enumeration": ("Integer", c_int),
        "Boolean": ("Boolean", c_int),
    }

    def instantiate(self, interface: str, steps: Steps | None = None) -> None:
        logger = _LOGGER2(lambda _environment, _name, status, _category, message: self.received(status, message))
        self._keep = logger  # the FMU calls it as long as it lives
        pointers = (ctypes.cast(f, c_void_p) for f in (logger, _C.calloc, _C.free))
        self._callbacks = _Callbacks2(*pointers, None, None)
        format_messages(self._callbacks, logger)
        function = self.function("Instantiate", restype=c_void_p)
        kind = 1 if interface == "co_simulation" else 0
        uri = _uri(self.resources)
        arguments = self.name, kind, self.token, uri, byref(self._callbacks), 0
        self._created(function(*arguments, 0) or function(*arguments, 1))  # one that refuses is asked again for its words

    def enter_initialization(self, stop: float | None, tolerance: float | None) -> None:
        self.call("SetupExperiment", tolerance is not None, tolerance or 0.0, 0.0, stop is not None, stop or 0.0)
        self.call("EnterInitializationMode")

    def stepper(self) -> Callable[[float, float], Interruption | None]:
        function, handle = self.function("DoStep"), self._handle

        def step(t: float, h: float) -> Interruption | None:
            status = function(handle, t, h, 1)
            return self.stepped(status, t, h) if status else None

        return step

    def bare_step(self) -> BareStep:
        time, size = c_double(), c_double()
        return BareStep(self.bare("DoStep"), (c_void_p(self._handle), time, size, c_int(1)), time, size, c_uint64(0))

    def stepped(self, status: int, t: float, h: float) -> Interruption | None:
        if status == 2:
            return Interruption(min(max(self._reached(t), t), t + h), terminate=self._terminated(), discarded=True)
        if status:
            self.judge("fmi2DoStep", status)
        return None

    def keeper(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Two functions: keep the FMU's state as it is now, and go back to it. The copy is freed with the instance."""
        copy = self._copy = c_void_p(None)
        return lambda: self.call("GetFMUstate", byref(copy)), lambda: self.call("SetFMUstate", copy)

    def free(self) -> None:
        if self._handle is not None and self._copy:
            self.function("FreeFMUstate")(self._handle, byref(self._copy))
        super().free()

    def ramp(self, reference: int) -> Callable[[float], None]:
        """A function that sets the first time derivative of an input (for FMUs that interpolate inputs)."""
        references, order, box = (c_uint * 1)(reference), (c_int * 1)(1), (c_double * 1)()

        def assign(slope: float) -> None:
            box[0] = slope
            self.call("SetRealInputDerivatives", references, 1, order, box)

        return assign

    def update_discrete(self) -> Discrete:
        i = _EventInfo2()
        self.call("NewDiscreteStates", byref(i))
        next_event = i.next if i.next_defined else math.inf
        return Discrete(bool(i.again), bool(i.terminate), bool(i.nominals_changed), bool(i.states_changed), next_event)

    def complete_step(self) -> tuple[bool, bool]:
        event, terminate = c_int(0), c_int(0)
        self.call("CompletedIntegratorStep", 1, byref(event), byref(terminate))
        return bool(event.value), bool(terminate.value)

    def sizes(self, states: int, indicators: int) -> tuple[int, int]:
        return states, indicators

    def derivative(self, unknowns: Sequence[int], known: int) -> list[float]:
        n = len(unknowns)
        seed, result = (c_double * 1)(1.0), (c_double * n)()
        self.call("GetDirectionalDerivative", (c_uint * n)(*unknowns), n, (c_uint * 1)(known), 1, seed, result)
        return list(result)

    def _reached(self, otherwise: float) -> float:
        value = c_double(otherwise)
        return value.value if self.function("GetRealStatus")(self._handle, 2, byref(value)) == 0 else otherwise

    def _terminated(self) -> bool:
        value = c_int(0)
        return self.function("GetBooleanStatus")(self._handle, 3, byref(value)) == 0 and bool(value.value)

    @staticmethod
    def _count(n: int) -> tuple[int, ...]:
        return ()


class Instance3(Instance):
    """FMI 3.0."""

    early_return: bool = False
    ended: tuple[c_bool, c_bool, c_bool, c_double]
    """How the last step ended: with an event, the wish to terminate, early; and when [s], if early."""
    failure: FmuError | None = None
    """What went wrong in a callback of the FMU."""

    prefix = "fmi3"
    signatures: ClassVar[dict[str, str]] = {
        "InstantiateCoSimulation": "sssbbbbrzvvv",
        "InstantiateModelExchange": "sssbbvv",
        "FreeInstance": "v",
        "SetDebugLogging": "vbzv",
        "EnterConfigurationMode": "v",
        "ExitConfigurationMode": "v",
        "EnterInitializationMode": "vbddbd",
        "ExitInitializationMode": "v",
        "Terminate": "v",
        "Reset": "v",
        "DoStep": "vddbvvvv",
        "UpdateDiscreteStates": "vvvvvvv",
        "EnterEventMode": "v",
        "SetTime": "vd",
        "GetEventIndicators": "vvz",
        "GetNominalsOfContinuousStates": "vvz",
        "CompletedIntegratorStep": "vbvv",
        "EnterStepMode": "v",
        "GetNumberOfContinuousStates": "vv",
        "GetNumberOfEventIndicators": "vv",
        "EnterContinuousTimeMode": "v",
        "GetContinuousStates": "vvz",
        "SetContinuousStates": "vvz",
        "GetContinuousStateDerivatives": "vvz",
        "GetDirectionalDerivative": "vrzrzvzvz",
    }
    types: ClassVar[dict[str, tuple[str, Number]]] = {
        "Float64": ("Float64", c_double),
        "Float32": ("Float32", ctypes.c_float),
        "Boolean": ("Boolean", c_bool),
        "Enumeration": ("Int64", ctypes.c_int64),
        **{f"Int{n}": (f"Int{n}", getattr(ctypes, f"c_int{n}")) for n in (8, 16, 32, 64)},
        **{f"UInt{n}": (f"UInt{n}", getattr(ctypes, f"c_uint{n}")) for n in (8, 16, 32, 64)},
    }

    def instantiate(self, interface: str, steps: Steps | None = None) -> None:
        self._logger = _LOGGER3(lambda _environment, status, _category, message: self.received(status, message))
        logger = ctypes.cast(self._logger, c_void_p)
        self._flags = (c_bool * 8)()
        event, terminate, early = (c_bool.from_buffer(self._flags, i) for i in range(3))
        self.ended = event, terminate, early, c_double(0.0)
        # The standard wants a trailing separator, and NULL where there is no such folder.
        folder = os.path.join(self.resources, "").encode() if self.resources.is_dir() else None
        common = self.name, self.token, folder, False
        if interface == "co_simulation":
            function = self.function("InstantiateCoSimulation", restype=c_void_p)
            wanted = steps or Steps()
            self.early_return = wanted.early_return
            required, update = (c_uint * max(len(wanted.required), 1))(*wanted.required), self._intermediate_update(wanted)
            flags = wanted.event_mode, wanted.early_return
            rest = *flags, required, len(wanted.required), None, logger, update
            self._created(function(*common, False, *rest) or function(*common, True, *rest))
        else:
            function = self.function("InstantiateModelExchange", restype=c_void_p)
            self._created(function(*common, False, None, logger) or function(*common, True, None, logger))

    def _intermediate_update(self, steps: Steps) -> c_void_p | None:
        """The callback of a step; an exception in it is kept until the step returns."""
        if steps.supply is None:
            return None
        supply = steps.supply

        def update(_: int, time: float, wanted: bool, _get: bool, _done: bool, _can: bool, request: int, _when: int) -> None:
            ctypes.cast(request, ctypes.POINTER(c_bool))[0] = False
            if wanted and self.failure is None:
                try:
                    supply(time)
                except FmuError as problem:
                    self.failure = problem

        self._update = _UPDATE3(update)
        return ctypes.cast(self._update, c_void_p)

    def enter_initialization(self, stop: float | None, tolerance: float | None) -> None:
        self.call("EnterInitializationMode", tolerance is not None, tolerance or 0.0, 0.0, stop is not None, stop or 0.0)

    def stepper(self) -> Callable[[float, float], Interruption | None]:
        function, handle = self.function("DoStep"), self._handle
        flags = tuple(map(addressof, self.ended))  # cheaper to hand over than references, step after step
        event, terminate, early, _ = self.ended

        def step(t: float, h: float) -> Interruption | None:
            status = function(handle, t, h, True, *flags)
            if status or event.value or terminate.value or early.value or self.failure is not None:
                return self.stepped(status, t, h)
            return None

        return step

    def bare_step(self) -> BareStep:
        time, size = c_double(), c_double()
        flags = (c_void_p(addressof(flag)) for flag in self.ended)
        return BareStep(
            self.bare("DoStep"), (c_void_p(self._handle), time, size, c_bool(True), *flags), time, size, c_uint64.from_buffer(self._flags)
        )

    def stepped(self, status: int, t: float, h: float) -> Interruption | None:
        event, terminate, early = (flag.value for flag in self.ended[:3])
        reached = self.ended[3].value
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure
        if status == 2:  # the FMU is where it was, and says nothing else
            return Interruption(t, discarded=True)
        if status:
            self.judge("fmi3DoStep", status)
        if not (event or terminate or early):
            return None
        if early and not self.early_return and not terminate:
            raise FmuError(f"fmi3DoStep returned early at {reached!r} s, which it was not allowed to")
        return Interruption(min(max(reached, t), t + h) if early else t + h, event, terminate)

    def enter_step_mode(self) -> None:
        """From event mode to steps."""
        self.call("EnterStepMode")

    def update_discrete(self) -> Discrete:
        flags, when = [c_bool(False) for _ in range(5)], c_double(0.0)
        self.call("UpdateDiscreteStates", *(byref(flag) for flag in flags), byref(when))
        again, terminate, nominals, states, defined = (flag.value for flag in flags)
        return Discrete(again, terminate, nominals, states, when.value if defined else math.inf)

    def complete_step(self) -> tuple[bool, bool]:
        event, terminate = c_bool(False), c_bool(False)
        self.call("CompletedIntegratorStep", True, byref(event), byref(terminate))
        return event.value, terminate.value

    def sizes(self, states: int, indicators: int) -> tuple[int, int]:
        found = c_size_t(states), c_size_t(indicators)  # configuration and array sizes decide, not the description
        self.call("GetNumberOfContinuousStates", byref(found[0]))
        self.call("GetNumberOfEventIndicators", byref(found[1]))
        return found[0].value, found[1].value

    def derivative(self, unknowns: Sequence[int], known: int) -> list[float]:
        n = len(unknowns)
        seed, result = (c_double * 1)(1.0), (c_double * n)()
        self.call("GetDirectionalDerivative", (c_uint * n)(*unknowns), n, (c_uint * 1)(known), 1, seed, 1, result, n)
        return list(result)

    @staticmethod
    def _count(n: int) -> tuple[int, ...]:
        return (n,)
