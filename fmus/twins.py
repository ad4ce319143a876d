"""A plant's linear twin: the equations of its C source as exact matrices, read from twin.toml.

    dx/dt = A x + B u,   y = C x + D u

Every entry is a string: a rational expression in the plant's parameters, such as "-stiffness / mass_1". Decimals are read exactly,
so with parameters from a study the matrices are exact too; a test compares them with the binary's own derivatives.
"""

from __future__ import annotations

import ast
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from types import MappingProxyType
from typing import Any, Protocol, Self, TypeVar

from fmus.errors import DescriptionError
from relaxations.plants import LinearPlant

Row = tuple[Fraction, ...]

LONGEST_EXPRESSION = 1000  # characters; a twin may come out of a stranger's FMU
LARGEST_POWER = 16


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
    """`dx/dt = A x + B u` for one input, and for each output name its row C and its feed-through D; exact."""

    input: str
    states: tuple[str, ...]
    A: tuple[Row, ...]
    B: Row
    outputs: Mapping[str, tuple[Row, Fraction]]


def read_twin(text: str, parameters: Mapping[str, Fraction | Decimal | float | str] | None = None) -> TwinMatrices:
    """The matrices of the twin.toml `text`, with `parameters` (in the plant's units) in place of the defaults it gives.

    Floats are taken as the binary fractions that they are. Raises `DescriptionError`: a malformed twin, a parameter
    that it does not have, or a value with which an entry has no meaning (a mass of zero).
    """
    data = _load(text)
    defaults = _mapping(data, "parameters")
    values = {name: _exact(f"parameters.{name}", value) for name, value in defaults.items()}
    for name, value in (parameters or {}).items():
        if name not in values:
            raise DescriptionError(f"the plant's linear twin has no parameter {name!r}; it has {', '.join(sorted(values)) or 'none'}")
        values[name] = _exact(name, value)

    def entry(path: str, written: object) -> Fraction:
        try:
            return evaluate(str(written), values, Fraction) if isinstance(written, str) else _exact(path, written)
        except DescriptionError as problem:
            raise DescriptionError(f"{path}: {problem}") from None

    def row(path: str, written: object, length: int) -> Row:
        if not isinstance(written, list) or len(written) != length:
            raise DescriptionError(f"{path} must be a list of {length} entries, one a state")
        return tuple(entry(f"{path}[{i}]", x) for i, x in enumerate(written))

    states = data.get("states")
    if not isinstance(states, list) or not states or not all(isinstance(name, str) for name in states):
        raise DescriptionError(f"states = {states!r} must be a list of names")
    if not isinstance(data.get("input"), str):
        raise DescriptionError(f"input = {data.get('input')!r} must be a name")
    n = len(states)
    matrix = data.get("A")
    if not isinstance(matrix, list) or len(matrix) != n:
        raise DescriptionError(f"A must be a list of {n} rows, one a state")
    outputs: dict[str, tuple[Row, Fraction]] = {}
    for name, output in _mapping(data, "outputs").items():
        if not isinstance(output, dict) or output.keys() != {"C", "D"}:
            raise DescriptionError(f"outputs.{name} must be a table of C (a row) and D (an entry)")
        outputs[name] = (row(f"outputs.{name}.C", output["C"], n), entry(f"outputs.{name}.D", output["D"]))
    return TwinMatrices(
        input=data["input"],
        states=tuple(states),
        A=tuple(row(f"A[{i}]", x, n) for i, x in enumerate(matrix)),
        B=row("B", data.get("B"), n),
        outputs=MappingProxyType(outputs),
    )


def check_twin(text: str) -> None:
    """Raise `DescriptionError` if `text` is no twin.toml, or if it has no meaning with its own default parameters."""
    read_twin(text)


def linear_plant(twin: TwinMatrices, output: str) -> LinearPlant:
    """The twin as the linear plant from its input to `output`.

    The other outputs go along for limits on them, those with feed-through excepted: a deflection limit on them is refused anyway.
    Raises `DescriptionError` for an output that the twin does not have.
    """
    if output not in twin.outputs:
        raise DescriptionError(f"the plant's linear twin has no output {output!r}; it has {', '.join(sorted(twin.outputs))}")
    row, through = twin.outputs[output]
    others = {name: c for name, (c, d) in twin.outputs.items() if name != output and d == 0}
    return LinearPlant.from_state_space(twin.A, twin.B, row, through, outputs=others, name=output)


def evaluate(expression: str, values: Mapping[str, N], literal: Callable[[str], N]) -> N:
    """The value of a rational expression: names, decimal literals, + - * / and ** with a whole exponent, brackets.

    `literal` makes a number of a literal's own text, so that "0.1" is one tenth. Raises `DescriptionError`.
    """
    if len(expression) > LONGEST_EXPRESSION:
        raise DescriptionError(f"an expression of {len(expression)} characters is too long; {LONGEST_EXPRESSION} are allowed")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise DescriptionError(f"{expression!r} is no expression") from None

    def visit(node: ast.expr) -> N:
        match node:
            case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
                return literal(ast.get_source_segment(expression.strip(), node) or "")
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
        raise DescriptionError(
            f"{expression!r}: {ast.unparse(node)!r} is not allowed; names, decimal numbers, + - * / and ** with a whole "
            f"exponent from 0 to {LARGEST_POWER} are"
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
    known = {"input", "states", "parameters", "A", "B", "outputs"}
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
            return Fraction(value)  # type: ignore[arg-type]
    except (ValueError, OverflowError, ZeroDivisionError):
        pass
    raise DescriptionError(f"{path} = {value!r} must be a finite number")
