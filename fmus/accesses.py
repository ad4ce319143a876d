"""What is read and set at every step of a run, as the arguments of FMI's functions: one call a type, and one for the driven input."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Sequence
from ctypes import c_double, c_uint
from dataclasses import dataclass
from functools import lru_cache

Typed = tuple[str, int] | tuple[str, int, int, int]
"""A variable's type and value reference; for one element of an array also the array's size and the element's place in it, from 0."""
Number = type[ctypes._SimpleCData]
"""The C type of a variable's values."""
TypeOf = Callable[[str], tuple[str, Number]]
"""From a type in the description to the end of its functions' names, and the C type of its values."""


@dataclass(frozen=True, slots=True)
class Driven:
    """A number that is set again and again: number `place` of `box`, which is set as a whole, as FMI sets arrays."""

    suffix: str
    ctype: Number
    references: ctypes.Array[c_uint]
    box: ctypes.Array[ctypes._SimpleCData]
    place: int


@dataclass(frozen=True, slots=True)
class Group:
    """Variables of one type, read by one call: `size` numbers, of which number `places[k]` belongs into column `columns[k]` of a row."""

    suffix: str
    ctype: Number
    references: ctypes.Array[c_uint]
    size: int
    columns: tuple[int, ...]
    places: tuple[int, ...]
    straight: bool
    """Whether what is read is a row as it comes."""


@dataclass(frozen=True, slots=True)
class BareStep:
    """`function(*arguments)` takes a step from `time` over `size` [s]; whatever else it tells than OK is in `ended`, which is 0 if it is
    nothing. All are C values made once: turning Python's into them would cost a third of a call.
    """

    function: Callable[..., int]
    arguments: tuple[object, ...]
    time: ctypes.c_double
    size: ctypes.c_double
    ended: ctypes.c_uint64


@dataclass(frozen=True, slots=True)
class BareRead:
    """`function(*arguments)` reads a row to the address that `place` holds."""

    name: str
    function: Callable[..., int]
    arguments: tuple[object, ...]
    place: ctypes.c_void_p


def driven(kind: str, reference: int, element: Sequence[int], others: Sequence[float], type_of: TypeOf) -> Driven:
    """One variable, or of an array the `element` (size, place) among `others` (size,), which keep their values."""
    suffix, ctype = type_of(kind)
    size, place = element or (1, 0)
    box = (ctype * size)(*(cell(ctype, x) for x in others))
    return Driven(suffix, ctype, (c_uint * 1)(reference), box, place)


@lru_cache(maxsize=16)
def grouped(variables: tuple[Typed, ...], type_of: TypeOf) -> list[Group]:
    """The calls that read the variables; an array is read once, however many elements are wanted. The same in run after run."""
    columns: dict[str, list[int]] = {}
    for column, (kind, *_) in enumerate(variables):
        columns.setdefault(kind, []).append(column)
    return [_group(variables, kind, places, type_of) for kind, places in columns.items()]


def _group(variables: Sequence[Typed], kind: str, columns: list[int], type_of: TypeOf) -> Group:
    suffix, ctype = type_of(kind)
    wanted = [variables[c] for c in columns]
    sizes: dict[int, int] = {}  # of what is read
    for _, reference, *element in wanted:
        sizes.setdefault(reference, element[0] if element else 1)
    first = dict(zip(sizes, itertools.accumulate(sizes.values(), initial=0), strict=False))
    places = tuple(first[v[1]] + (v[3] if len(v) == 4 else 0) for v in wanted)
    size = sum(sizes.values())
    straight = ctype is c_double and places == tuple(range(len(variables))) and size == len(variables)
    return Group(suffix, ctype, (c_uint * len(sizes))(*sizes), size, tuple(columns), places, straight)


def cell(ctype: Number, value: float) -> float:
    """The value as a variable of that type takes it."""
    return value if ctype is c_double or ctype is ctypes.c_float else round(value)


@lru_cache(maxsize=16)
def texts(words: tuple[str, ...]) -> ctypes.Array[ctypes.c_char_p]:
    """The words as C has them."""
    return (ctypes.c_char_p * len(words))(*(word.encode() for word in words))
