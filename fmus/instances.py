"""An instance of a loaded binary, FMI 2.0 and 3.0 alike (`fmus.interfaces` has what differs): the one module that uses FMPy.

Of FMPy it takes the parser of modelDescription.xml and the C helper that formats FMI 2.0's variadic log messages. The
calls themselves have their own prototypes, because the stepping loop reads straight into a block of memory.

This module runs beside foreign machine code: it belongs into a child process (`fmus.isolated`), and it imports only the
standard library until a function needs more.
"""

from __future__ import annotations

import ctypes
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from fmus.accesses import BareRead, BareStep, Driven, Group, Number, Typed, cell, driven, grouped, texts
from fmus.errors import CallFailed, DescriptionError, FmuError
from fmus.events import Discrete, Interruption, Steps
from fmus.loaded import loaded

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription, ModelVariable
    from fmpy.model_description import Unit as RawUnit

    __all__ = ["ModelDescription", "ModelVariable", "RawUnit"]

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

Log = Callable[[str, str], None]


def parse_description(xml: bytes) -> ModelDescription:
    """Validate against the standard's schema and parse; `DescriptionError` lists every problem."""
    import io
    import zipfile

    from fmpy.model_description import ValidationError, read_model_description

    from fmus.markup import one_line

    # The parser reads zip files. One made here shows it this document only, not the rest of an untrusted archive.
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("modelDescription.xml", xml)
    try:
        return read_model_description(archive)
    except ValidationError as problem:
        raise DescriptionError(one_line("modelDescription.xml is not valid: " + "; ".join(map(str, problem.problems)))) from None
    except Exception as problem:  # noqa: BLE001 - the parser raises bare exceptions for what the schema does not catch
        raise DescriptionError(one_line(f"modelDescription.xml cannot be used: {type(problem).__name__}: {problem}")) from None


MOST_ITERATIONS = 100  # of one event


class Instance(ABC):
    """One instance of an FMU: created, initialised, stepped or evaluated, freed.

    Every call that returns something other than OK raises `CallFailed`, except Warning, which is kept in `warning`
    (the first one) so that the run can go on and be marked.
    """

    prefix: ClassVar[str]
    signatures: ClassVar[dict[str, str]]
    types: ClassVar[dict[str, tuple[str, Number]]]

    def __init__(self, library: Path, token: str, name: str, resources: Path, log: Log) -> None:
        """Load the binary. `log` receives (level, text) for each message of the FMU."""
        self.token, self.name, self.resources = token.encode(), name.encode(), resources
        self.log = log
        self.warning = ""
        self._last_message = ""
        self._handle: int | None = None
        self._library, self._functions, self._addresses = loaded(library)

    @abstractmethod
    def instantiate(self, interface: str, steps: Steps | None = None) -> None:
        """Create the instance: `interface` is "co_simulation" or "model_exchange"; `steps` of co-simulation belong to FMI 3.0."""

    @abstractmethod
    def enter_initialization(self, stop: float | None, tolerance: float | None) -> None:
        """Begin initialisation for a run from 0 to `stop` [s]."""

    @abstractmethod
    def stepper(self) -> Callable[[float, float], Interruption | None]:
        """A function (t, h) that steps from t to t + h [s]; None if that was all."""

    @abstractmethod
    def bare_step(self) -> BareStep:
        """A step as a call of C; what comes of it is judged by `stepped`, unless it returns 0 and tells nothing."""

    @abstractmethod
    def stepped(self, status: int, t: float, h: float) -> Interruption | None:
        """What a step from t to t + h [s] came to whose C function returned `status`; raises for one that cannot be mended."""

    @abstractmethod
    def update_discrete(self) -> Discrete:
        """One iteration of an event."""

    @abstractmethod
    def complete_step(self) -> tuple[bool, bool]:
        """Model Exchange: an integrator step is accepted; whether the FMU wants event mode, and whether it wants to end the run."""

    @abstractmethod
    def sizes(self, states: int, indicators: int) -> tuple[int, int]:
        """Numbers of continuous states and event indicators; the arguments are the description's."""

    @abstractmethod
    def derivative(self, unknowns: Sequence[int], known: int) -> list[float]:
        """∂unknowns/∂known at the present point, by the FMU's directional derivative."""

    def log_trouble(self, categories: Sequence[str]) -> None:
        """Ask for messages of those categories that explain a status; without this many FMUs stay silent."""
        if wanted := texts(tuple(name for name in categories if name.startswith("logStatus"))):
            self.function("SetDebugLogging")(self._handle, True, len(wanted), wanted)  # an FMU that cannot is no failure

    def exit_initialization(self) -> None:
        """End initialisation."""
        self.call("ExitInitializationMode")

    def terminate(self) -> None:
        """End the run."""
        self.call("Terminate")

    def reset(self) -> None:
        """Back to the state after `instantiate`."""
        self.call("Reset")

    def free(self) -> None:
        """Free the instance; the binary stays loaded."""
        if self._handle is not None:
            handle, self._handle = self._handle, None
            self.function("FreeInstance", restype=None)(handle)

    def set(self, variable: Typed, value: float | Sequence[float]) -> None:
        """Set one number, or all numbers of an array (value reference of the array, row-major)."""
        kind, reference, *element = variable
        values = [value] if isinstance(value, int | float) else list(value)
        if element:
            self.setter(self.driven(kind, reference, tuple(element)))(values[0])
            return
        suffix, ctype = self._type(kind)
        cells = (ctype * max(len(values), 1))(*(cell(ctype, x) for x in values))
        self.call(f"Set{suffix}", (c_uint * 1)(reference), 1, cells, *self._count(len(values)))

    def driven(self, kind: str, reference: int, element: Sequence[int] = (), others: Sequence[float] = ()) -> Driven:
        """One variable to be set again and again; see `fmus.accesses`."""
        return driven(kind, reference, element, others, self._type)

    def setter(self, what: Driven) -> Callable[[float], None]:
        """A fast function that sets it; of an array only the one element changes."""
        function, box, place = self.function(f"Set{what.suffix}"), what.box, what.place
        whole = what.ctype is not c_double and what.ctype is not ctypes.c_float
        arguments = (self._handle, what.references, 1, box, *self._count(len(box)))
        name = f"{self.prefix}Set{what.suffix}"

        def assign(value: float) -> None:
            box[place] = round(value) if whole else value
            status = function(*arguments)
            if status:
                self.judge(name, status)

        return assign

    def configure(self, parameters: Sequence[tuple[str, int, float]]) -> None:
        """Set structural parameters (FMI 3.0), right after `instantiate`: arrays then have the sizes that follow."""
        if parameters:
            self.call("EnterConfigurationMode")
            for kind, reference, value in parameters:
                self.set((kind, reference), value)
            self.call("ExitConfigurationMode")

    def groups(self, variables: Sequence[Typed]) -> list[Group]:
        """The calls that read the variables."""
        return grouped(tuple(variables), self._type)

    def reader(self, groups: Sequence[Group], width: int, address: int) -> Callable[[int], None]:
        """A function that reads the groups into row `i`, of `width`, of a block of float64 rows at `address`."""
        parts = [self._reader(group, width, address) for group in groups]
        if len(parts) == 1:
            return parts[0]

        def read(row: int) -> None:
            for part in parts:
                part(row)

        return read

    def _reader(self, group: Group, width: int, address: int) -> Callable[[int], None]:
        function, handle, references, n = self.function(f"Get{group.suffix}"), self._handle, group.references, len(group.references)
        tail, name, stride = self._count(group.size), f"{self.prefix}Get{group.suffix}", 8 * width
        if group.straight:

            def straight(row: int) -> None:
                status = function(handle, references, n, address + row * stride, *tail)
                if status:
                    self.judge(name, status)

            return straight
        buffer, targets = (group.ctype * group.size)(), tuple(zip(group.columns, group.places, strict=True))

        def copied(row: int) -> None:
            status = function(handle, references, n, buffer, *tail)
            if status:
                self.judge(name, status)
            cells = (c_double * width).from_address(address + row * stride)
            for column, place in targets:
                cells[column] = buffer[place]

        return copied

    def bare_read(self, group: Group) -> BareRead:
        """The call that reads a group of variables that are a row as they come."""
        place, name = c_void_p(), f"Get{group.suffix}"
        arguments = (
            c_void_p(self._handle),
            group.references,
            c_size_t(len(group.references)),
            place,
            *map(c_size_t, self._count(group.size)),
        )
        return BareRead(self.prefix + name, self.bare(name), arguments, place)

    def settle(self) -> Discrete:
        """Iterate an event until nothing changes any more; what changed on the way is kept."""
        total = Discrete()
        for _ in range(MOST_ITERATIONS):
            now = self.update_discrete()
            total.nominals_changed |= now.nominals_changed
            total.states_changed |= now.states_changed
            total.terminate, total.next_event = now.terminate, now.next_event
            if now.terminate or not now.again:
                return total
        raise FmuError(f"the FMU's events do not settle after {MOST_ITERATIONS} iterations")

    def enter_event_mode(self) -> None:
        """From continuous time, or from a step of co-simulation, to event mode."""
        self.call("EnterEventMode")

    def enter_continuous_time(self) -> None:
        """From event mode to continuous time."""
        self.call("EnterContinuousTimeMode")

    def start_continuous_time(self) -> None:
        """Model Exchange after initialisation: settle events, enter continuous time."""
        if self.settle().terminate:
            raise FmuError("the FMU asks to terminate at its first event")
        self.enter_continuous_time()

    def states(self, count: int) -> list[float]:
        """The continuous state vector (Model Exchange)."""
        return self._vector("GetContinuousStates", count)

    def set_states(self, values: Sequence[float]) -> None:
        """Set the continuous state vector (Model Exchange)."""
        self.call("SetContinuousStates", (c_double * len(values))(*values), len(values))

    def set_time(self, time: float) -> None:
        """Set the independent variable [s] (Model Exchange)."""
        self.call("SetTime", time)

    def rates(self, count: int) -> list[float]:
        """The time derivatives of the continuous states (Model Exchange)."""
        return self._vector(self.derivatives_function, count)

    def nominals(self, count: int) -> list[float]:
        """The sizes of the continuous states (Model Exchange); 0, which some tools export, is read as 1."""
        return [abs(size) if math.isfinite(size) and size else 1.0 for size in self._vector("GetNominalsOfContinuousStates", count)]

    def get(self, variables: Sequence[Typed]) -> list[float]:
        """The values of a few variables."""
        block = (c_double * max(len(variables), 1))()
        if variables:
            self.reader(self.groups(variables), len(variables), ctypes.addressof(block))(0)
        return list(block)[: len(variables)]

    def call(self, name: str, *arguments: object) -> None:
        """Call a function of this instance and judge its status."""
        status = self.function(name)(self._handle, *arguments)
        if status:
            self.judge(self.prefix + name, status)

    def judge(self, call: str, status: int) -> None:
        """Keep the first Warning; raise for everything worse."""
        word = STATUS[status] if 0 <= status < len(STATUS) else f"the unknown status {status}"
        if status == 1:
            self.warning = self.warning or f"{call} returned Warning" + (f": {self._last_message}" if self._last_message else "")
        elif status:
            raise CallFailed(call, word, self._last_message)

    def function(self, name: str, restype: type | None = c_int) -> Callable[..., int]:
        """The C function with its prototype; `FmuError` if the binary lacks it."""
        full = self.prefix + name
        found = self._functions.get(full)
        if found is None:
            try:
                found = getattr(self._library, full)
            except AttributeError:
                raise FmuError(f"the FMU's binary has no function {full}") from None
            found.restype = restype
            found.argtypes = [_LETTERS[letter] for letter in self._signature(name)]
            self._functions[full] = found
        return found

    def bare(self, name: str) -> Callable[..., int]:
        """The C function as it is, to be called with C values only: nothing is checked or converted."""
        self.function(name)  # which says so if there is none
        return self._library[self.prefix + name]

    def received(self, status: int, message: bytes | None) -> None:
        """Pass on a log message of the FMU."""
        text = (message or b"").decode("utf-8", "replace").rstrip("\n")
        self._last_message = text[:500]
        self.log(STATUS[status].lower() if 0 <= status < len(STATUS) else "unknown", text)

    @property
    def handle(self) -> int | None:
        """The instance as the FMU knows it."""
        return self._handle

    def address(self, name: str) -> int:
        """Where the C function lies, for other C code; `FmuError` if the binary lacks it."""
        if name not in self._addresses:
            function: Any = self.function(name)
            self._addresses[name] = ctypes.cast(function, c_void_p).value or 0
        return self._addresses[name]

    @property
    def derivatives_function(self) -> str:
        """The name of the function that gives the derivatives of the continuous states."""
        return "GetDerivatives" if self.prefix == "fmi2" else "GetContinuousStateDerivatives"

    def _signature(self, name: str) -> str:
        if name in self.signatures:
            return self.signatures[name]
        return "vrzv" + "z" * len(self._count(1))  # Get… and Set… of any type

    def _vector(self, name: str, count: int) -> list[float]:
        values = (c_double * max(count, 1))()
        if count:
            self.call(name, values, count)
        return list(values)[:count]

    @classmethod
    def _type(cls, kind: str) -> tuple[str, Number]:
        try:
            return cls.types[kind]
        except KeyError:
            raise FmuError(f"variables of type {kind} cannot be read or set as numbers") from None

    @staticmethod
    @abstractmethod
    def _count(n: int) -> tuple[int, ...]:
        """The number of values, which FMI 3.0 wants after the values."""

    def _created(self, handle: int | None) -> None:
        if not handle:
            detail = f": {self._last_message}" if self._last_message else ""
            raise FmuError(f"the FMU refused to be instantiated{detail}")
        self._handle = handle


_LETTERS = dict(v=c_void_p, s=c_char_p, d=c_double, i=c_int, b=c_bool, z=c_size_t, r=POINTER(c_uint))  # noqa: C408 - reads as a table


_formatted: dict[str, object] = {}
"""The logger that the C function calls, whoever logs in this process: it must outlive its instance."""


def format_messages(callbacks: ctypes.Structure, logger: object) -> None:
    """Put a C function before the `logger` of `callbacks` that formats messages with their variadic arguments, unknown to Python."""
    add = _formatter()
    if add is not None:
        add(byref(callbacks))
        _formatted["logger"] = logger


@cache
def _formatter() -> Callable[..., object] | None:
    from importlib.util import find_spec

    package = find_spec("fmpy")  # found, not imported: importing it would take longer than many a run
    system = {"win32": "win64", "darwin": "darwin64"}.get(sys.platform, "linux64")
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    if package is None or package.origin is None:
        return None
    try:
        helper = ctypes.CDLL(str(Path(package.origin).parent / "logging" / system / f"logging{suffix}"))
        add = helper.addLoggerProxy
    except (OSError, AttributeError):  # no such helper for this machine: messages keep their "%s"
        return None
    add.argtypes, add.restype = [c_void_p], None
    return add
