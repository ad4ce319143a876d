"""The stepping loop in C (`sources/stepping.c`): built with the plants, found in the cache, and handed an FMU's functions.

It costs some 30 ns a step, where the loop in Python costs microseconds; what it logs is the same to the bit. Where it has not been
built, Python steps. Only the standard library is imported here until something is built or looked for: the loop runs beside the FMU.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable
from ctypes import POINTER, byref, c_bool, c_double, c_float, c_int, c_int64, c_size_t, c_void_p
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmus.accesses import Driven, Group
    from fmus.instances import Instance
    from fmus.interfaces import Instance3

SOURCE = Path(__file__).parent / "sources" / "stepping.c"
INPUT, SET, TILT, PART, STEP, READ = range(6)
"""What the loop asks about: a jump to be told as an event, a status of setting the input, of its slope, a step to be cut, a step's end
that needs looking at, a status of reading a group (and one more each)."""

_TROUBLE = ctypes.CFUNCTYPE(c_int, c_size_t, c_int, c_int)
_FLOATS = (c_double, c_float)
_WHOLE = tuple(getattr(ctypes, f"c_{sign}int{n}") for sign in ("", "u") for n in (8, 16, 32, 64))
_KINDS = {kind: place for place, kind in enumerate((*_FLOATS, *_WHOLE, c_bool))}


class _Group(ctypes.Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("get", "references", "buffer", "columns", "places")),
        *((name, c_size_t) for name in ("reference_count", "size", "count")),
        ("kind", c_int),
    )


class _Loop(ctypes.Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("instance", "step", "set", "tilt", "input", "box", "event", "terminate", "early", "reached")),
        *((name, c_void_p) for name in ("times", "sizes", "levels", "slopes", "rows", "count")),
        ("groups", POINTER(_Group)),
        ("trouble", _TROUBLE),
        *((name, c_size_t) for name in ("box_size", "place", "points", "width", "group_count")),
        ("event_time", c_double),
        *((name, c_int) for name in ("version", "single", "events", "divisible")),
    )


@cache
def load(library: str) -> ctypes.CDLL | None:
    """The compiled loop; None if it cannot be loaded, or is of another version: Python steps then."""
    try:
        code, size = ctypes.CDLL(library), c_size_t(0)
        code.slewcert_sizes.restype, code.slewcert_sizes.argtypes = c_size_t, [c_void_p]
        same = code.slewcert_sizes(byref(size)) == ctypes.sizeof(_Loop) and size.value == ctypes.sizeof(_Group)
    except (OSError, AttributeError):
        return None
    return code if same else None


class Loop:
    """One run's loop. `event_time` [s], the next event that the FMU has announced, may be changed on the way."""

    def __init__(
        self, code: ctypes.CDLL, instance: Instance, driven: Driven, tilted: bool, groups: list[Group], ask: Callable[[int, int, int], None]
    ) -> None:
        """`tilted`: the input's slope is told too.

        `ask` gets a row, what is the matter, and a status; it returns if the loop can go on, and raises if not.
        """
        self._run = code.slewcert_steps
        self._failure: BaseException | None = None
        self._kept: list[object] = []  # what the structures point to

        def trouble(row: int, what: int, status: int) -> int:
            try:
                ask(row, what, status)
            except BaseException as problem:  # noqa: BLE001 - it is raised again on the other side of the C code
                self._failure = problem
                return 1
            return 0

        self._loop = _Loop(
            instance=instance.handle,
            step=instance.address("DoStep"),
            set=instance.address(f"Set{driven.suffix}"),
            tilt=instance.address("SetRealInputDerivatives") if tilted else None,
            input=self._keep(driven.references),
            box=self._keep(driven.box),
            box_size=len(driven.box),
            place=driven.place,
            groups=(_Group * max(len(groups), 1))(*(self._group(instance, group) for group in groups)),
            trouble=_TROUBLE(trouble),
            group_count=len(groups),
            event_time=float("inf"),
            version=2 if instance.prefix == "fmi2" else 3,
            single=driven.ctype is c_float,
        )

    @property
    def event_time(self) -> float:
        return self._loop.event_time

    @event_time.setter
    def event_time(self, time: float) -> None:
        self._loop.event_time = time

    def flags(self, instance: Instance3) -> None:
        """Where FMI 3.0's steps say how they ended."""
        for name, flag in zip(("event", "terminate", "early", "reached"), instance.ended, strict=True):
            setattr(self._loop, name, self._keep(flag))

    def run(self, columns: list[array[float]], width: int, rows: int, count: c_int64, *, events: bool, divisible: bool) -> None:
        """All steps. `columns`: times, step sizes, levels and perhaps slopes; `rows` is the address of the rows, the first one read."""
        loop = self._loop
        for name, column in zip(("times", "sizes", "levels", "slopes"), columns, strict=False):
            setattr(loop, name, column.buffer_info()[0])
        loop.points, loop.width, loop.rows, loop.count = len(columns[0]), width, rows, ctypes.addressof(count)
        loop.events, loop.divisible = events, divisible
        if self._run(byref(loop)):
            assert self._failure is not None
            raise self._failure

    def _group(self, instance: Instance, group: Group) -> _Group:
        columns, places = ((c_size_t * len(numbers))(*numbers) for numbers in (group.columns, group.places))
        return _Group(
            get=instance.address(f"Get{group.suffix}"),
            references=self._keep(group.references),
            buffer=None if group.straight else self._keep((group.ctype * group.size)()),
            columns=self._keep(columns),
            places=self._keep(places),
            reference_count=len(group.references),
            size=group.size,
            count=len(columns),
            kind=_KINDS[group.ctype],
        )

    def _keep(self, data: ctypes.Array[Any] | ctypes._SimpleCData[Any]) -> int:
        self._kept.append(data)
        return ctypes.addressof(data)


def library() -> Path:
    """Where the loop lies in the cache, built or not: another place for other sources, flags or machines."""
    from fmus import compiling
    from fmus.packing import digest

    target = compiling.host()
    key = digest({"source": SOURCE.read_bytes(), "flags": " ".join((*compiling.FLAGS, target.machine, target.system)).encode()})
    return compiling.cache() / "loops" / key[:16] / f"stepping{compiling.SUFFIX[target.system]}"


def build() -> Path:
    """The loop for this machine, compiled if it is not there yet; raises `BuildError` with the compiler's words."""
    from fmus.compiling import compile_library
    from fmus.packing import write

    path = library()
    if not path.exists():
        write(path, compile_library("stepping", [SOURCE.name], {SOURCE.name: SOURCE.read_bytes()}))
    return path


def found() -> Path | None:
    """The loop if it has been built, else None."""
    from fmus.errors import BuildError

    try:
        path = library()
    except BuildError:  # a machine that nothing can be built for
        return None
    return path if path.is_file() else None
