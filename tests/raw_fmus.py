"""An FMU's functions called directly through FMPy, the same for FMI 2.0 and 3.0: a second importer, independent of ours."""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from fmpy import extract, read_model_description
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    calloc,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    free,
    printLogMessage,
)
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.logging import addLoggerProxy

Interface = Literal["CoSimulation", "ModelExchange"]


PRINTS = fmi2CallbackLoggerTYPE(printLogMessage)
MEMORY = fmi2CallbackAllocateMemoryTYPE(calloc), fmi2CallbackFreeMemoryTYPE(free)


def callbacks() -> fmi2CallbackFunctions:
    """Callbacks of FMI 2.0 that print messages. FMPy's proxy calls the last logger that it was given, which `simulate_fmu` lets go after a
    run: it is given one that lives as long as the process.
    """
    found = fmi2CallbackFunctions()
    found.logger, (found.allocateMemory, found.freeMemory) = PRINTS, MEMORY
    addLoggerProxy(ctypes.byref(found))
    return found


class RawFmu:
    """One instance, instantiated and not yet initialised. FMPy raises `FMICallException` for any status but OK and Warning."""

    def __init__(
        self, path: Path, folder: Path, interface: Interface = "CoSimulation", token: str | None = None, event_mode: bool = False
    ) -> None:
        self.description: Any = read_model_description(str(path))
        self.stepped = False
        self.is_fmi2 = self.description.fmiVersion == "2.0"
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        kinds = (FMU2Slave, FMU2Model) if self.is_fmi2 else (FMU3Slave, FMU3Model)
        self.fmu: Any = kinds[interface == "ModelExchange"](
            guid=token or self.description.guid,
            unzipDirectory=extract(str(path), unzipdir=str(folder)),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="instance",
        )
        self._instantiate(self.fmu, **({"eventModeUsed": True, "earlyReturnAllowed": True} if event_mode else {}))

    def another(self) -> RawFmu:
        """A further instance of the library that is loaded already; the first one's user frees it."""
        twin = copy.copy(self)
        twin.fmu = copy.copy(self.fmu)
        self._instantiate(twin.fmu)
        return twin

    def _instantiate(self, fmu: Any, **options: bool) -> None:
        fmu.instantiate(**({"callbacks": callbacks()} if self.is_fmi2 else options))

    def __enter__(self) -> RawFmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()

    def set(self, values: Mapping[str, float]) -> None:
        setter = self.fmu.setReal if self.is_fmi2 else self.fmu.setFloat64
        setter([self.references[name] for name in values], list(values.values()))

    def get(self, names: Sequence[str]) -> list[float]:
        getter = self.fmu.getReal if self.is_fmi2 else self.fmu.getFloat64
        return list(getter([self.references[name] for name in names]))

    def initialize(self, values: Mapping[str, float] | None = None, stop: float | None = None) -> None:
        if self.is_fmi2:
            self.fmu.setupExperiment(startTime=0.0, stopTime=stop)
        self.set(values or {})
        self.fmu.enterInitializationMode(**({} if self.is_fmi2 else {"startTime": 0.0, "stopTime": stop}))
        self.fmu.exitInitializationMode()

    def start_continuous_time(self) -> None:
        """For model exchange, after `initialize`."""
        if not self.is_fmi2:
            self.fmu.updateDiscreteStates()
        self.fmu.enterContinuousTimeMode()

    def reset(self) -> None:
        self.fmu.reset()

    def step(self, time: float, step: float) -> Any:
        return self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=step)

    def handle_event(self, values: Mapping[str, float] | None = None) -> float | None:
        """Event mode, and from it into step mode (FMI 3.0 with `event_mode`; after `initialize` the instance is in it); the next event."""
        if self.stepped:
            self.fmu.enterEventMode()
        self.set(values or {})
        *_, defined, next_event = self.fmu.updateDiscreteStates()
        self.fmu.enterStepMode()
        self.stepped = True
        return next_event if defined else None

    def set_input_derivatives(self, name: str, values: Sequence[float]) -> None:
        """First, second … derivative of one input (FMI 2.0 only)."""
        n = len(values)
        references = (ctypes.c_uint * n)(*[self.references[name]] * n)
        self.fmu.fmi2SetRealInputDerivatives(
            self.fmu.component, references, n, (ctypes.c_int * n)(*range(1, n + 1)), (ctypes.c_double * n)(*values)
        )

    def directional(self, unknown: str, known: str) -> float:
        return self.fmu.getDirectionalDerivative([self.references[unknown]], [self.references[known]], [1.0])[0]

    def save(self) -> Any:
        return self.fmu.getFMUState()

    def restore(self, state: Any) -> None:
        self.fmu.setFMUState(state)

    def release(self, state: Any) -> None:
        self.fmu.freeFMUState(state)

    def serialize(self, state: Any) -> bytes:
        return bytes(self.fmu.serializeFMUState(state))

    def deserialize(self, content: bytes) -> Any:
        return self.fmu.deserializeFMUState(content)
