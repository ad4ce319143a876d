"""What differs between FMI 2.0 and FMI 3.0: the functions' signatures, the values' types, the order of calls."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_uint, c_void_p
from typing import ClassVar

from fmus.errors import FmuError
from fmus.instances import Instance, Number, format_messages


class _Callbacks2(ctypes.Structure):
    _fields_ = (("logger", c_void_p), ("allocate", c_void_p), ("free", c_void_p), ("finished", c_void_p), ("environment", c_void_p))


class _EventInfo2(ctypes.Structure):
    _fields_ = (
        *((name, c_int) for name in ("again", "terminate", "nominals_changed", "states_changed", "next_defined")),
        ("next", c_double),
    )


class Instance2(Instance):
    """FMI 2.0."""

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
        "SetRealInputDerivatives": "vrzvv",
        "NewDiscreteStates": "vv",
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

    def instantiate(self, interface: str) -> None:
        logger = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)(
            lambda _environment, _name, status, _category, message: self.received(status, message)
        )
        c = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
        self._keep = logger, c  # the FMU calls them as long as it lives
        pointers = (ctypes.cast(f, c_void_p) for f in (logger, c.calloc, c.free))
        self._callbacks = _Callbacks2(*pointers, None, None)
        format_messages(self._callbacks)
        function = self.function("Instantiate", restype=c_void_p)
        kind = 1 if interface == "co_simulation" else 0
        uri = self.resources.as_uri().encode()
        self._created(function(self.name, kind, self.token, uri, byref(self._callbacks), 0, 0))

    def enter_initialization(self, stop: float | None, tolerance: float | None) -> None:
        self.call("SetupExperiment", tolerance is not None, tolerance or 0.0, 0.0, stop is not None, stop or 0.0)
        self.call("EnterInitializationMode")

    def stepper(self) -> Callable[[float, float], bool]:
        function, handle = self.function("DoStep"), self._handle

        def step(t: float, h: float) -> bool:
            status = function(handle, t, h, 1)
            if status:
                if status == 2 and self._terminated():
                    return True
                self.judge("fmi2DoStep", status)
            return False

        return step

    def ramp(self, reference: int) -> Callable[[float], None]:
        """A function that sets the first time derivative of an input (for FMUs that interpolate inputs)."""
        references, order, box = (c_uint * 1)(reference), (c_int * 1)(1), (c_double * 1)()

        def assign(slope: float) -> None:
            box[0] = slope
            self.call("SetRealInputDerivatives", references, 1, order, box)

        return assign

    def start_continuous_time(self) -> None:
        for _ in range(100):
            info = _EventInfo2()
            self.call("NewDiscreteStates", byref(info))
            if info.terminate:
                raise FmuError("the FMU asks to terminate at its first event")
            if not info.again:
                break
        else:
            raise FmuError("the FMU's events do not settle after 100 iterations")
        self.call("EnterContinuousTimeMode")

    def derivative(self, unknowns: Sequence[int], known: int) -> list[float]:
        n = len(unknowns)
        seed, result = (c_double * 1)(1.0), (c_double * n)()
        self.call("GetDirectionalDerivative", (c_uint * n)(*unknowns), n, (c_uint * 1)(known), 1, seed, result)
        return list(result)

    def _terminated(self) -> bool:
        value = c_int(0)
        return self.function("GetBooleanStatus")(self._handle, 3, byref(value)) == 0 and bool(value.value)

    @staticmethod
    def _count(n: int) -> tuple[int, ...]:
        return ()


class Instance3(Instance):
    """FMI 3.0."""

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

    def instantiate(self, interface: str) -> None:
        self._logger = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)(
            lambda _environment, status, _category, message: self.received(status, message)
        )
        logger = ctypes.cast(self._logger, c_void_p)
        # The standard wants a trailing separator, and NULL where there is no such folder.
        folder = os.path.join(self.resources, "").encode() if self.resources.is_dir() else None
        common = (self.name, self.token, folder, False, False)
        if interface == "co_simulation":
            function = self.function("InstantiateCoSimulation", restype=c_void_p)
            self._created(function(*common, False, False, None, 0, None, logger, None))
        else:
            function = self.function("InstantiateModelExchange", restype=c_void_p)
            self._created(function(*common, None, logger))

    def enter_initialization(self, stop: float | None, tolerance: float | None) -> None:
        self.call("EnterInitializationMode", tolerance is not None, tolerance or 0.0, 0.0, stop is not None, stop or 0.0)

    def stepper(self) -> Callable[[float, float], bool]:
        function, handle = self.function("DoStep"), self._handle
        event, terminate, early, reached = c_bool(False), c_bool(False), c_bool(False), c_double(0.0)
        flags = tuple(byref(flag) for flag in (event, terminate, early, reached))

        def step(t: float, h: float) -> bool:
            status = function(handle, t, h, True, *flags)
            if status:
                self.judge("fmi3DoStep", status)
            if early.value and not terminate.value:
                raise FmuError(f"fmi3DoStep returned early at {reached.value!r} s, which it was not allowed to")
            return terminate.value

        return step

    def start_continuous_time(self) -> None:
        flags, when = [c_bool(False) for _ in range(5)], c_double(0.0)
        again, terminate = flags[:2]
        for _ in range(100):
            self.call("UpdateDiscreteStates", *(byref(flag) for flag in flags), byref(when))
            if terminate.value:
                raise FmuError("the FMU asks to terminate at its first event")
            if not again.value:
                break
        else:
            raise FmuError("the FMU's events do not settle after 100 iterations")
        self.call("EnterContinuousTimeMode")

    def derivative(self, unknowns: Sequence[int], known: int) -> list[float]:
        n = len(unknowns)
        seed, result = (c_double * 1)(1.0), (c_double * n)()
        self.call("GetDirectionalDerivative", (c_uint * n)(*unknowns), n, (c_uint * 1)(known), 1, seed, 1, result, n)
        return list(result)

    @staticmethod
    def _count(n: int) -> tuple[int, ...]:
        return (n,)
