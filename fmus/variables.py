"""One variable of an FMU: its type, unit, size and values. Arrays are seen whole, or element by element, counted from 1."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction

from fmus.errors import DescriptionError

REAL_TYPES = ("Real", "Float64", "Float32")
WHOLE_TYPES = {
    "Integer": (-(2**31), 2**31 - 1),
    **{f"Int{n}": (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (8, 16, 32, 64)},
    **{f"UInt{n}": (0, 2**n - 1) for n in (8, 16, 32, 64)},
}
"""The least and the greatest value of each type of whole numbers."""
NUMBER_TYPES = (*REAL_TYPES, *WHOLE_TYPES, "Enumeration", "Boolean")
MOST_ELEMENTS = 1_000_000  # of one array: descriptions and structural parameters may ask for any size
MOST_IN_ALL = 4_000_000  # elements of all arrays: each has a name and a start value in memory

Number = int | float | Decimal | Fraction
Value = bool | int | float | Decimal | Fraction | str
"""What may be given for a variable: a number, true or false, the name of an enumeration's item."""


@dataclass(frozen=True, slots=True)
class DisplayUnit:
    """Another unit to show a value in: shown = factor · value + offset."""

    name: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit in SI base units: `factor · base + offset`; `exponents` such as (("kg", 1), ("m", 1), ("s", -2)).

    `defined` is false where the FMU names the unit and does not say what it is.
    """

    name: str
    exponents: tuple[tuple[str, int], ...]
    factor: float = 1.0
    offset: float = 0.0
    display: tuple[DisplayUnit, ...] = ()
    defined: bool = True


@dataclass(frozen=True, slots=True)
class Element:
    """Where a single number lies in its array: the array's name, the place in row-major order from 0, and the array's size."""

    array: str
    place: int
    size: int


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable of the FMU. `start` is in `unit`; `derivative_of` names the state whose time derivative this is.

    An array has a `shape`, as it is with the structural parameters' present values; each of its `dimensions` is a size or the name of the
    structural parameter that holds it. Its `starts` are in row-major order (empty: not known). One element of it, as `Description.find`
    gives it, has no shape but an `element`. `items` are an enumeration's names and numbers.
    """

    name: str
    causality: str
    variability: str
    type: str
    unit: str
    start: float | str | None
    value_reference: int
    description: str = ""
    initial: str | None = None
    nominal: float = 1.0
    shape: tuple[int, ...] = ()
    derivative_of: str | None = None
    dimensions: tuple[int | str, ...] = ()
    starts: tuple[float, ...] = ()
    items: tuple[tuple[str, int], ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    display_unit: str = ""
    element: Element | None = None
    intermediate: bool = False  # can be set within a step (FMI 3.0)

    @property
    def is_number(self) -> bool:
        """Whether it is one number (no text, clock or array), so that it can be logged."""
        return self.type in NUMBER_TYPES and not self.dimensions

    @property
    def is_real(self) -> bool:
        """Whether it is one floating-point number."""
        return self.type in REAL_TYPES and not self.dimensions

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return math.prod(self.shape)

    @property
    def kind(self) -> str:
        """Its type with its size, for messages: "Float64[3, 2]"."""
        return self.type + (str(list(self.shape)) if self.dimensions else "")

    @property
    def elements(self) -> tuple[str, ...]:
        """The names of its elements in row-major order, such as "x[1,2]"; its own name if it is no array."""
        if not self.dimensions:
            return (self.name,)
        counted = itertools.product(*(range(1, n + 1) for n in self.shape))
        return tuple(f"{self.name}[{','.join(map(str, indices))}]" for indices in counted)

    def resized(self, shape: tuple[int, ...]) -> Variable:
        """The same array with another shape. Start values go along if they are all alike; else they are not known."""
        if shape == self.shape:
            return self
        require_elements(self.name, shape)
        alike = len(set(self.starts)) == 1
        return replace(self, shape=shape, starts=self.starts[:1] * math.prod(shape) if alike else ())

    def at(self, indices: tuple[int, ...]) -> Variable:
        """One element; raises `DescriptionError` if there is no such element."""
        if not self.dimensions:
            raise DescriptionError(f"{self.name!r} is a single value and has no elements")
        if len(indices) != len(self.shape) or not all(1 <= i <= n for i, n in zip(indices, self.shape, strict=True)):
            given = ",".join(map(str, indices))
            ends = f"{self.elements[0]} … {self.elements[-1]}" if self.size else "none: it is empty"
            raise DescriptionError(f"{self.name!r} has no element [{given}]; its elements are {ends}")
        place = 0
        for index, length in zip(indices, self.shape, strict=True):
            place = place * length + index - 1
        return replace(
            self,
            name=f"{self.name}[{','.join(map(str, indices))}]",
            shape=(),
            dimensions=(),
            start=self.starts[place] if self.starts else None,
            starts=(),
            derivative_of=None if self.derivative_of is None else f"{self.derivative_of}[{','.join(map(str, indices))}]",
            element=Element(self.name, place, self.size),
        )

    def number(self, value: Value) -> Number:
        """The number for `value`, of the same kind as it (an item's or truth value's is an int); `DescriptionError` says what is valid."""
        if self.type == "Boolean":
            return self._truth(value)
        if self.type == "Enumeration":
            return self._item(value)
        if not self.is_number:
            raise DescriptionError(f"{self.name!r} is of type {self.kind}; only numbers, Booleans and enumerations can be set")
        if isinstance(value, str | bool):
            raise DescriptionError(f"{self.name!r} is of type {self.type} and cannot be {_shown(value)}; it must be a number")
        if not math.isfinite(value):
            raise DescriptionError(f"{self.name!r} must be set to a finite number, not {value!r}")
        if self.type in WHOLE_TYPES:
            least, most = WHOLE_TYPES[self.type]
            if value != int(value) or not least <= value <= most:
                raise DescriptionError(
                    f"{self.name!r} is of type {self.type} and cannot be {value}: valid are whole numbers {least} … {most}"
                )
        return value

    def within(self, value: Value) -> Number:
        """`number`, and within the FMU's own limits, which are for people to keep and not for the FMU to enforce."""
        number = self.number(value)
        below = self.minimum is not None and number < self.minimum
        if below or (self.maximum is not None and number > self.maximum):
            limits = " and ".join(f"at {w} {x:.10g}" for w, x in (("least", self.minimum), ("most", self.maximum)) if x is not None)
            raise DescriptionError(f"{self.name!r} cannot be {float(number):.10g}: the FMU wants {limits}")
        return number

    def _truth(self, value: Value) -> int:
        if isinstance(value, str) or value not in (0, 1):
            raise DescriptionError(f"{self.name!r} is of type Boolean and cannot be {_shown(value)}: valid are true and false")
        return int(value)

    def _item(self, value: Value) -> int:
        if isinstance(value, str) and value in dict(self.items):
            return dict(self.items)[value]
        if not isinstance(value, str | bool) and value in dict(self.items).values():
            return int(value)
        names = ", ".join(f'"{name}" ({number})' for name, number in self.items[:12]) + (", …" if len(self.items) > 12 else "")
        raise DescriptionError(f"{self.name!r} is an enumeration and cannot be {_shown(value)}: valid are {names or 'none'}")


def require_elements(name: str, shape: Sequence[int]) -> int:
    """How many elements an array of that shape has; `DescriptionError` if these are more than `MOST_ELEMENTS`. The product stops there."""
    count = 0 if 0 in shape else 1
    for length in shape:
        count *= length
        if count > MOST_ELEMENTS:
            shown = " × ".join(map(str, shape[:6])) + (" × …" if len(shape) > 6 else "")
            raise DescriptionError(f"{name!r} would have {shown} elements; at most {MOST_ELEMENTS} are supported")
    return count


def require_in_all(count: int) -> None:
    """`DescriptionError` if the arrays of an FMU have more than `MOST_IN_ALL` elements."""
    if count > MOST_IN_ALL:
        raise DescriptionError(f"its arrays have {count} elements in all; at most {MOST_IN_ALL} are supported")


_ELEMENT = re.compile(r"(.*\S)\s*\[([\d,\s]+)\]", re.DOTALL)


def element_indices(name: str) -> tuple[str, tuple[int, ...]] | None:
    """The array's name and the indices in "name[i,j]"; None if the name has no such form."""
    match = _ELEMENT.fullmatch(name)
    if match is None:
        return None
    try:
        return match[1], tuple(int(part) for part in match[2].split(","))
    except ValueError:
        return None


def _shown(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else str(value)
