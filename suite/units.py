"""Units: what a unit's name means, and exact conversion between units. The only module that imports pint.

A value in a unit is `factor · value + offset` in SI base units. Angles are kept apart: rad counts as 1 where only one side of a conversion
has it, but a frequency in cycles (Hz, rpm, turn) never passes for one in radians.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

from fmus.variables import DisplayUnit, Unit

if TYPE_CHECKING:
    from pint import UnitRegistry

BASE = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd", "radian": "rad"}
CYCLES = ("hertz", "turn", "revolution", "cycle", "revolutions_per_minute", "revolutions_per_second", "circle")
AGREEMENT = Fraction(1, 10**9)  # FMUs write factors with 6 to 17 digits
DIGITS = 40  # of a converted number that no decimal holds exactly
LONGEST = 60  # characters of a unit

Exponents = tuple[tuple[str, Fraction], ...]


class UnitError(ValueError):
    """A unit that does not exist, or cannot be converted to the one that is wanted; the message is a sentence."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A unit: `exponents` of the SI base units (rad among them), `factor` and `offset` to these; `cyclic` if it counts cycles."""

    name: str
    exponents: Exponents
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    cyclic: bool = False

    @property
    def angle(self) -> Fraction:
        """The exponent of rad."""
        return dict(self.exponents).get("rad", Fraction(0))

    @property
    def kind(self) -> Exponents:
        """The exponents without rad."""
        return tuple(pair for pair in self.exponents if pair[0] != "rad")

    def times(self, seconds: int, name: str) -> Scale:
        """This unit times a power of the second; for differences, so without an offset."""
        powers = dict(self.exponents)
        powers["s"] = powers.get("s", Fraction(0)) + seconds
        return Scale(name, _ordered(powers), self.factor, Fraction(0), self.cyclic)

    def si(self, value: float, difference: bool) -> float:
        """The value in SI base units."""
        return float(self.factor) * value + (0.0 if difference else float(self.offset))

    @property
    def coherent(self) -> bool:
        """Whether it is the SI unit itself."""
        return self.factor == 1 and self.offset == 0 and not self.cyclic

    @property
    def si_name(self) -> str:
        """The SI unit of the same kind."""
        return next((name for name, powers in _DERIVED.items() if _ordered(powers) == self.exponents), _spelled(self.exponents))


ONE = Scale("1", ())
SECOND = Scale("s", (("s", Fraction(1)),))
RADIAN_PER_SECOND = Scale("rad/s", (("s", Fraction(-1)), ("rad", Fraction(1))))

_DERIVED: dict[str, Mapping[str, int]] = {
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "N/m": {"kg": 1, "s": -2},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
}


def _ordered(powers: Mapping[str, Fraction | int]) -> Exponents:
    return tuple((symbol, Fraction(powers[symbol])) for symbol in BASE.values() if powers.get(symbol))


def _spelled(exponents: Exponents) -> str:
    def word(symbol: str, power: Fraction) -> str:
        return symbol if power == 1 else f"{symbol}{power}"

    above = ".".join(word(s, p) for s, p in exponents if p > 0) or "1"
    below = ".".join(word(s, -p) for s, p in exponents if p < 0)
    return f"{above}/({below})" if "." in below else f"{above}/{below}" if below else above


_SYMBOLS = r"[^\W\d_]|[°µμΩ%_]"
_TEXT = re.compile(rf"(?:{_SYMBOLS}|[0-9]|[\s.*·⋅/()^+-])+")


@lru_cache(maxsize=1000)
def named(text: str) -> Scale:
    """The unit of that name, in the spelling of pint or of FMI ("N.m/rad", "m/s2"); raises `UnitError`."""
    plain = text.strip()
    if not plain or len(plain) > LONGEST or not _TEXT.fullmatch(plain):
        raise UnitError(f'"{text[:LONGEST]}" is no unit')
    if re.search(r"\)\s*(?:\*\*|\^|[0-9])|[0-9]{2}|(?:\*\*|\^)\s*[^\s0-9+-]", plain):
        raise UnitError(f'"{text}" has exponents that are not understood; write them after a symbol, of one digit, as in "m/s2"')
    spelled = re.sub(r"[·⋅]|(?<=[^\d\s])\.(?=[^\d\s])", "*", plain)
    spelled = re.sub(rf"(?<=({_SYMBOLS}))\s*([+-]?[0-9])", r"**\2", spelled)
    registry = _registry()
    try:
        unit = registry.parse_units(spelled)
        quantity: Any = registry.Quantity
        low, high, check = (quantity(Fraction(n), unit).to_base_units() for n in (0, 1, 2))
        parts, base = dict(unit._units), dict(low.units._units)
    except Exception:  # noqa: BLE001 - pint raises many kinds of errors, for what it cannot parse and for what it can but not convert
        raise UnitError(f'"{text}" is no unit that is known') from None
    offset, factor = Fraction(low.magnitude), Fraction(high.magnitude) - Fraction(low.magnitude)
    powers = {BASE.get(str(name), str(name)): Fraction(power) for name, power in base.items() if str(name) != "count"}
    if Fraction(check.magnitude) != offset + 2 * factor or factor <= 0 or not set(powers) <= set(BASE.values()):
        raise UnitError(f'"{text}" is no unit of a physical quantity')
    cyclic = any(str(part).endswith(CYCLES) for part in parts)
    return Scale(plain, _ordered(powers), factor, offset, cyclic)


@cache
def _registry() -> UnitRegistry:
    from pint import UnitRegistry

    # Hertz counts cycles here; by the book it is 1/s. Nm is what people write for N.m; pint takes it for the fineness of a yarn.
    registry = UnitRegistry(non_int_type=Fraction, on_redefinition="ignore", autoconvert_offset_to_baseunit=True)  # type: ignore[arg-type]
    registry.define("hertz = 2 * pi * radian / second = Hz")
    registry.define("newton_meter = newton * meter = Nm")
    registry.define("@alias ohm = Ohm")
    registry._build_cache()
    return registry


def as_declared(unit: Unit) -> Scale | None:
    """An FMU's unit by the FMU's own definition alone; None if there is none, or none that can be inverted."""
    if not unit.defined or not unit.factor > 0:
        return None
    return Scale(unit.name, _ordered(dict(unit.exponents)), Fraction(repr(unit.factor)), Fraction(repr(unit.offset)))


def of_fmu(unit: Unit) -> Scale | None:
    """An FMU's unit as the FMU defines it, or as its name says if it does not; None if neither says anything.

    Many FMUs leave rad out of rad/s, and write π with few digits: what the name says more exactly is believed where it agrees.
    """
    try:
        by_name = named(unit.name)
    except UnitError:
        by_name = None
    declared = as_declared(unit)
    if declared is None:
        return None if unit.defined else by_name
    if by_name is None or by_name.kind != declared.kind or abs(by_name.offset - declared.offset) > AGREEMENT * 1000:
        return declared
    if declared.angle not in (0, by_name.angle):
        return declared
    ratio = declared.factor / by_name.factor
    per_cycle = by_name.factor / _cycles_only(by_name)  # Hz as 1/s: the FMU counts cycles and does not say so
    agrees = any(abs(ratio * other - 1) < AGREEMENT for other in ((1, per_cycle) if by_name.cyclic and not declared.angle else (1,)))
    return replace(by_name, name=unit.name) if agrees else declared


def _cycles_only(unit: Scale) -> Fraction:
    """The factor with a cycle counted as 1."""
    turn = named("turn").factor
    return unit.factor / turn ** int(unit.angle) if unit.angle.denominator == 1 else unit.factor


def shown_as(display: DisplayUnit, unit: Scale) -> Scale | None:
    """A display unit of an FMU's unit: shown = factor · value + offset."""
    factor, offset = Fraction(repr(display.factor)), Fraction(repr(display.offset))
    if factor == 0:
        return None
    return Scale(display.name, unit.exponents, unit.factor / factor, unit.offset - unit.factor * offset / factor, unit.cyclic)


def convert(value: Decimal, given: Scale, wanted: Scale, difference: bool) -> Decimal:
    """The value in the wanted unit, exact if a decimal can be, else of 40 digits. A difference has no offset (20 degC are 20 K).

    Raises `UnitError` for another kind of quantity.
    """
    if given.kind != wanted.kind or (wanted is ONE and given.exponents):
        other = f'unit of the kind of "{wanted.name}"' if wanted.exponents else "pure number"
        raise UnitError(f'"{given.name}" is no {other}; {examples(wanted)}')
    if given.angle != wanted.angle and (given.cyclic or wanted.cyclic or given.kind == RADIAN_PER_SECOND.kind):
        raise UnitError(f'"{given.name}" and "{wanted.name}" leave open whether a cycle counts as 1 or as 2π; valid is "{wanted.name}"')
    exact = given.factor * Fraction(value) + (0 if difference else given.offset - wanted.offset)
    return decimal(exact / wanted.factor)


def decimal(exact: Fraction) -> Decimal:
    """The fraction as a decimal: exactly where it has one of up to 40 digits, else rounded to 40."""
    with localcontext() as context:
        context.prec = DIGITS
        return (Decimal(exact.numerator) / Decimal(exact.denominator)).normalize() + 0


_EXAMPLES = {
    "m": "m, mm, um, in",
    "m/s": "m/s, mm/s, km/h",
    "m/s2": "m/s2, mm/s2, g_0",
    "rad": "rad, deg, turn",
    "rad/s": "rad/s, deg/s, Hz, rpm",
    "s": "s, ms, min",
    "kg": "kg, g, t",
    "N": "N, kN, lbf",
    "N.m": "N.m, kN.m, J",
    "N/m": "N/m, N/mm",
    "Pa": "Pa, bar, MPa",
    "W": "W, kW",
    "V": "V, mV",
    "A": "A, mA",
    "K": "K, degC",
    "1": "plain numbers, %",
}


def examples(unit: Scale) -> str:
    """Units of the same kind, for messages."""
    listed = _EXAMPLES.get(unit.si_name)
    own = "" if listed is None or unit.name in listed.split(", ") or unit is ONE else f"{unit.name}, "
    return f"valid are {own}{listed}" if listed else f'valid is "{unit.name}"'
