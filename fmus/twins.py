"""A plant's linear twin: the equations of its C source as exact matrices, read from twin.toml.

    dx/dt = A x + B u,   y = C x + D u

Every entry is a string: a rational expression in the plant's parameters, such as "-stiffness / mass_1", and in `[terms]`, which are
abbreviations of such expressions. Decimals are read exactly, so with parameters from a study the matrices are exact too; a test compares
them with the binary's own derivatives. A row is a list, or a table of its entries by state, in which what is zero is left out.

In the twin of a plant with arrays (a line `size = N` stands at its top) the states are names of arrays; an entry between two of them is an
expression in the row's index `i`, the column's `j` and `size`, counted from 1, in which `(j == i + 1)` is 1 where it is true and else 0.
"""

from __future__ import annotations

import ast
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from types import MappingProxyType
from typing import Any, Protocol, Self, TypeVar

from fmus.errors import DescriptionError
from relaxations.plants import LinearPlant
from relaxations.robust.boxes import Family
from relaxations.robust.families import Parameters

Row = tuple[Fraction, ...]
Value = Fraction | Decimal | float | str

LONGEST_EXPRESSION = 1000  # characters; a twin may come out of a stranger's FMU
LARGEST_POWER = 16
LARGEST_EXPONENT = 1000  # of ten, in a decimal: doubles end at 308, and all digits of an exact number are written out
EXPONENT = re.compile(r"[eE]([-+]?[\d_]+)")
LONGEST_NUMBER = 2**16  # bits of a numerator or denominator: squares of squares double them each time
MOST_STATES = 400


class Number(Protocol):
    """What an entry can be evaluated in: fractions, and anything else that adds, multiplies and divides (intervals, balls)."""

    def __add__(self, other: Self, /) -> Self: ...
    def __sub__(self, other: Self, /) -> Self: ...
    def __mul__(self, other: Self, /) -> Self: ...
    def __truediv__(self, other: Self, /) -> Self: ...
    def __pow__(self, exponent: int, /) -> Any: ...
    def __neg__(self) -> Self: ...


N = TypeVar("N", bound=Number)


@dataclass(frozen=True, slots=True)
class TwinMatrices:
    """`dx/dt = A x + B u` for one input, and for each output name its row C and its feed-through D; exact.

    Of a `nonlinear` plant they are its equations at rest to first order.
    """

    input: str
    states: tuple[str, ...]
    A: tuple[Row, ...]
    B: Row
    outputs: Mapping[str, tuple[Row, Fraction]]
    parameters: Mapping[str, Fraction]
    nonlinear: bool = False


def read_twin(text: str, parameters: Mapping[str, Value] | None = None) -> TwinMatrices:
    """The matrices of the twin.toml `text`, with `parameters` (in the plant's units) in place of the defaults it gives.

    Floats are taken as the binary fractions that they are. Raises `DescriptionError`: a malformed twin, a parameter
    that it does not have, or a value with which an entry has no meaning (a mass of zero).
    """
    return _matrices(text, parameters, lambda name, value: value)


def twin_family(
    text: str, output: str, varied: Sequence[str], parameters: Mapping[str, Value] | None = None, others: Sequence[str] = ()
) -> Family:
    """The twin over a box of the parameters `varied`, the others as in `read_twin`; of `others` among its outputs too, those with
    feed-through excepted. Raises `DescriptionError` as `linear_plant` does."""
    box = Parameters(tuple(varied))
    twin: Any = _matrices(text, parameters, lambda name, value: box.parameter(name) if name in varied else box.constant(value))
    row, through = _output(twin, output)
    further = {name: twin.outputs[name] for name in others if name in twin.outputs and name != output}
    return box.family(twin.A, twin.B, row, through, {name: c for name, (c, d) in further.items() if d.numerator == 0}, output)


def _matrices(text: str, parameters: Mapping[str, Value] | None, number: Callable[[str, Fraction], Any]) -> TwinMatrices:
    """The twin's entries in what `number` makes of a parameter (by name) and of any other number (named "")."""
    data = _load(text)
    defaults = _mapping(data, "parameters")
    numbers = {name: _exact(f"parameters.{name}", value) for name, value in defaults.items()}
    for name, value in (parameters or {}).items():
        if name not in numbers:
            raise DescriptionError(f"the plant's linear twin has no parameter {name!r}; it has {', '.join(sorted(numbers)) or 'none'}")
        numbers[name] = _exact(name, value)
    values = {name: number(name, value) for name, value in numbers.items()}

    size, bases, nonlinear = _size(data), data.get("states"), data.get("nonlinear", False)
    if not isinstance(nonlinear, bool):
        raise DescriptionError(f"nonlinear = {nonlinear!r} must be true or false")
    if not isinstance(bases, list) or not bases or not all(isinstance(name, str) for name in bases):
        raise DescriptionError(f"states = {bases!r} must be a list of names")
    if not isinstance(data.get("input"), str):
        raise DescriptionError(f"input = {data.get('input')!r} must be a name")
    states = [(str(base), j) for base in bases for j in _indices(size)]
    if len(states) > MOST_STATES:
        raise DescriptionError(f"the linear twin has {len(states)} states; at most {MOST_STATES} are read")

    def literal(digits: str) -> Any:
        return number("", Fraction(digits))

    def entry(path: str, written: object, i: int = 0, j: int = 0) -> Any:
        index = {} if size is None else {name: number("", Fraction(k)) for name, k in (("i", i), ("j", j), ("size", size))}
        try:
            return evaluate(written, {**values, **index}, literal) if isinstance(written, str) else number("", _exact(path, written))
        except DescriptionError as problem:
            raise DescriptionError(f"{path}: {problem}") from None

    def row(path: str, written: object, i: int = 0) -> Row:
        if isinstance(written, dict):
            _known(path, written, bases)
            return tuple(entry(f"{path}.{base}", written.get(base, 0), i, j) for base, j in states)
        if size is not None or not isinstance(written, list) or len(written) != len(states):
            raise DescriptionError(f"{path} must be a list of {len(states)} entries, one a state, or a table of entries by state")
        return tuple(entry(f"{path}[{j}]", x) for j, x in enumerate(written))

    for name, value in _mapping(data, "terms").items():
        values[name] = entry(f"terms.{name}", value)
    matrix, column = data.get("A"), data.get("B")
    if isinstance(matrix, dict):
        _known("A", matrix, bases)
        rows = [(f"A.{base}", matrix.get(base, {}), i) for base, i in states]
    elif isinstance(matrix, list) and len(matrix) == len(states) and size is None:
        rows = [(f"A[{i}]", x, 0) for i, x in enumerate(matrix)]
    else:
        raise DescriptionError(f"A must be a list of {len(states)} rows, one a state, or a table of rows by state")
    if isinstance(column, dict):
        _known("B", column, bases)
        B = tuple(entry(f"B.{base}", column.get(base, 0), i) for base, i in states)
    else:
        B = row("B", column)
    outputs: dict[str, tuple[Row, Fraction]] = {}
    for base, output in _mapping(data, "outputs").items():
        if not isinstance(output, dict) or output.keys() != {"C", "D"}:
            raise DescriptionError(f"outputs.{base} must be a table of C (a row) and D (an entry)")
        for i in _indices(size) if base in bases else [0]:
            outputs[_element(base, i)] = (row(f"outputs.{base}.C", output["C"], i), entry(f"outputs.{base}.D", output["D"], i))
    return TwinMatrices(
        input=data["input"],
        states=tuple(_element(base, i) for base, i in states),
        A=tuple(row(*line) for line in rows),
        B=B,
        outputs=MappingProxyType(outputs),
        nonlinear=nonlinear,
        parameters=MappingProxyType(numbers),
    )


def sized(text: str, size: int | None) -> str:
    """A twin.toml for arrays of `size`; as it is, if the plant has none."""
    return text if size is None else f"size = {size}\n{text}"


def _indices(size: int | None) -> list[int]:
    """The indices of an array; of what is no array, just 0."""
    return [0] if size is None else list(range(1, size + 1))


def _element(base: str, i: int) -> str:
    return f"{base}_{i}" if i else base


def _size(data: Mapping[str, Any]) -> int | None:
    size = data.get("size")
    if size is not None and (type(size) is not int or not 1 <= size <= MOST_STATES):
        raise DescriptionError(f"size = {size!r} must be a whole number from 1 to {MOST_STATES}")
    return size


def _known(path: str, written: Mapping[str, Any], names: list[str]) -> None:
    if wrong := [name for name in written if name not in names]:
        raise DescriptionError(f"{path}: {wrong[0]!r} is no state; the states are {', '.join(names)}")


def linear_plant(twin: TwinMatrices, output: str) -> LinearPlant:
    """The twin as the linear plant from its input to `output`.

    The other outputs go along for limits on them, those with feed-through excepted: a deflection limit on them is refused anyway.
    Raises `DescriptionError` for an output that the twin does not have.
    """
    row, through = _output(twin, output)
    others = {name: c for name, (c, d) in twin.outputs.items() if name != output and d == 0}
    return LinearPlant.from_state_space(twin.A, twin.B, row, through, outputs=others, name=output)


def _output(twin: TwinMatrices, output: str) -> tuple[Any, Any]:
    if output not in twin.outputs:
        raise DescriptionError(f"the plant's linear twin has no output {output!r}; it has {', '.join(sorted(twin.outputs))}")
    return twin.outputs[output]


def evaluate(expression: str, values: Mapping[str, N], literal: Callable[[str], N]) -> N:
    """The value of a rational expression: names, decimal literals, + - * / and ** with a whole exponent, brackets; `a == b` is 1 or 0.

    `literal` makes a number of a literal's own text, so that "0.1" is one tenth. Raises `DescriptionError`.
    """
    if len(expression) > LONGEST_EXPRESSION:
        raise DescriptionError(f"an expression of {len(expression)} characters is too long; {LONGEST_EXPRESSION} are allowed")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise DescriptionError(f"{expression!r} is no expression") from None

    def visit(node: ast.expr) -> N:
        value = visited(node)
        if isinstance(value, Fraction) and max(value.numerator.bit_length(), value.denominator.bit_length()) > LONGEST_NUMBER:
            raise DescriptionError(f"{expression!r} is a number of more than {LONGEST_NUMBER} bits")
        return value

    def visited(node: ast.expr) -> N:
        match node:
            case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
                digits = ast.get_source_segment(expression.strip(), node) or ""
                _check_exponent(digits)
                return literal(digits)
            case ast.Name(id=name):
                if name in values:
                    return values[name]
                raise DescriptionError(f"{expression!r}: there is no parameter {name!r}; there is {', '.join(sorted(values)) or 'none'}")
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -visit(operand)
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(exponent))) if exponent <= LARGEST_POWER:
                return visit(left) ** exponent
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return visit(left) + visit(right)
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                return visit(left) - visit(right)
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return visit(left) * visit(right)
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return visit(left) / visit(right)
            case ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]):
                return literal("1" if visit(left) == visit(right) else "0")
        raise DescriptionError(
            f"{expression!r}: {ast.unparse(node)!r} is not allowed; names, decimal numbers, + - * / ==, and ** with a whole "
            f"exponent from 0 to {LARGEST_POWER}, are"
        )

    try:
        return visit(tree.body)
    except ZeroDivisionError:
        used = sorted({node.id for node in ast.walk(tree) if isinstance(node, ast.Name)})
        raise DescriptionError(f"{expression!r} divides by zero with {', '.join(f'{name} = {values[name]}' for name in used)}") from None
    except (ValueError, RecursionError):
        raise DescriptionError(f"{expression!r} is no expression in decimal numbers") from None


def _load(text: str) -> Mapping[str, Any]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise DescriptionError(f"the linear twin is no TOML: {problem}") from None
    known = {"size", "nonlinear", "input", "states", "parameters", "terms", "A", "B", "outputs"}
    for key in data:
        if key not in known:
            raise DescriptionError(f"the linear twin has an unknown key {key!r}; known are {', '.join(sorted(known))}")
    return data


def _mapping(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise DescriptionError(f"{key} = {value!r} must be a table")
    return value


def _exact(path: str, value: object) -> Fraction:
    usable = isinstance(value, (Fraction, Decimal, int, float, str)) and not isinstance(value, bool)
    if isinstance(value, float) and not math.isfinite(value):
        usable = False
    try:
        if usable:
            return _fraction(value)  # type: ignore[arg-type]
    except DescriptionError as problem:
        raise DescriptionError(f"{path}: {problem}") from None
    except (ValueError, OverflowError, ZeroDivisionError):
        pass
    raise DescriptionError(f"{path} = {value!r} must be a finite number")


def _fraction(value: Value) -> Fraction:
    """The number exactly, of text and decimals after a look at their exponents."""
    if isinstance(value, str | Decimal):
        _check_exponent(str(value))
    return Fraction(value)


def _check_exponent(digits: str) -> None:
    found = EXPONENT.search(digits)
    if found and abs(int(found[1])) > LARGEST_EXPONENT:
        raise DescriptionError(f"{digits!r} is out of range: decimals have exponents from -{LARGEST_EXPONENT} to {LARGEST_EXPONENT}")
