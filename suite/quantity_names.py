"""The names of all quantities that a requirement may speak of, their arguments and the kind of their unit.

Definitions and implementations are elsewhere (`suite.quantities`); adding a quantity to the study file is one line in `QUANTITIES`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from enum import Enum

from suite.suggestions import did_you_mean


class ArgumentKind(Enum):
    """What stands between the parentheses; the value is how a message describes it."""

    NONE = "no argument"
    FRACTION = "a number between 0 and 1"
    VARIABLE = "the name of an output or of a logged variable"


class UnitKind(Enum):
    """How a quantity's unit follows from the units of the plant's input and variables."""

    NONE = "1"
    SECOND = "s"
    INPUT = "the input's unit"
    INPUT_SECOND = "the input's unit times second"
    INPUT_PER_SECOND = "the input's unit per second"
    VARIABLE = "the variable's unit"


@dataclass(frozen=True, slots=True)
class QuantityName:
    """One line of the table: how the quantity is written, and its unit."""

    name: str
    unit: UnitKind
    argument: ArgumentKind = ArgumentKind.NONE
    example: str = ""

    def __str__(self) -> str:
        return f"{self.name}({self.example})" if self.example else self.name


QUANTITIES: dict[str, QuantityName] = {
    quantity.name: quantity
    for quantity in (
        QuantityName("maneuver_time", UnitKind.SECOND),
        QuantityName("optimality_gap", UnitKind.NONE),
        QuantityName("residual_vibration", UnitKind.NONE),
        QuantityName("final_error", UnitKind.NONE),
        QuantityName("settling_time", UnitKind.SECOND, ArgumentKind.FRACTION, "0.02"),
        QuantityName("overshoot", UnitKind.NONE),
        QuantityName("fuel", UnitKind.INPUT_SECOND),
        QuantityName("peak_input", UnitKind.INPUT),
        QuantityName("peak_rate", UnitKind.INPUT_PER_SECOND),
        QuantityName("peak", UnitKind.VARIABLE, ArgumentKind.VARIABLE, "spring"),
        QuantityName("final", UnitKind.VARIABLE, ArgumentKind.VARIABLE, "position_1"),
        QuantityName("insensitivity", UnitKind.NONE, ArgumentKind.FRACTION, "0.05"),
        QuantityName("model_mismatch", UnitKind.NONE),
    )
}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity as a requirement names it; `level` is the argument of settling_time and insensitivity, `variable` of peak and final."""

    name: str
    level: Decimal | None = None
    variable: str | None = None

    @property
    def unit_kind(self) -> UnitKind:
        """How its unit is found."""
        return QUANTITIES[self.name].unit

    def __str__(self) -> str:
        if self.level is not None:
            return f"{self.name}({self.level})"
        return f"{self.name}({self.variable})" if self.variable is not None else self.name


def parse_quantity(text: str) -> Quantity:
    """`text` as a quantity; raises `ValueError` with a sentence on what would be valid."""
    match = re.fullmatch(r"\s*([^\s()]+)\s*(?:\((.*)\))?\s*", text, flags=re.DOTALL)
    name, argument = match.groups() if match else (text, None)
    known = QUANTITIES.get(name)
    if known is None:
        raise ValueError(f"no such quantity{did_you_mean(name, QUANTITIES)}; there are {', '.join(map(str, QUANTITIES.values()))}")
    if known.argument is ArgumentKind.NONE:
        if argument is not None:
            raise ValueError(f"{name} takes no argument")
        return Quantity(name)
    argument = (argument or "").strip()
    if not argument:
        raise ValueError(f"{name} needs {known.argument.value} in parentheses, as in {known}")
    if known.argument is ArgumentKind.VARIABLE:
        return Quantity(name, variable=argument)
    return Quantity(name, level=_level(argument, known))


def _level(argument: str, known: QuantityName) -> Decimal:
    try:
        level = Decimal(argument)
    except InvalidOperation:
        level = Decimal("nan")
    if not level.is_finite() or not 0 < level < 1 or len(argument) > 30:
        raise ValueError(f"the argument of {known.name} is {known.argument.value}, as in {known}")
    return level
