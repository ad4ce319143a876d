"""Units by themselves: what names mean, exact conversion, and what must never be converted silently."""

from __future__ import annotations

from contextlib import suppress
from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.variables import DisplayUnit, Unit
from suite import units
from suite.units import ONE, RADIAN_PER_SECOND, UnitError, convert, decimal, named, of_fmu

TWO_PI = Fraction("6.283185307179586476925286766559005768394")  # 40 digits, from tables


@pytest.mark.parametrize(
    ("value", "given_unit", "wanted", "result"),
    [
        ("5", "mm", "m", "0.005"),
        ("1.2", "kN", "N", "1200"),
        ("1", "in", "mm", "25.4"),
        ("3", "N.m", "N*m", "3"),
        ("3", "Nm", "J", "3"),
        ("2.5", "kg.m2/s2", "N.m", "2.5"),
        ("3", "m2", "mm2", "3e6"),
        ("3", "N.s/m", "kg/s", "3"),
        ("3", "N·s/m", "kg.s-1", "3"),
        ("36", "km/h", "m/s", "10"),
        ("6", "l/min", "m3/s", "0.0001"),
        ("50", "ms", "s", "0.05"),
        ("5", "%", "1", "0.05"),
        ("180", "deg", "rad", TWO_PI / 2),
        ("1", "Hz", "rad/s", TWO_PI),
        ("60", "rpm", "rad/s", TWO_PI),
        ("60", "rpm", "Hz", "1"),
        ("1", "kHz", "Hz", "1000"),
        ("1", "Hz", "deg/s", "360"),
        ("12", "µm", "um", "12"),
        ("4", "kOhm", "Ω", "4000"),
        ("1", "lbf", "N", "4.4482216152605"),
        ("2", "bar", "Pa", "2e5"),
    ],
)
def test_converts_exactly(value: str, given_unit: str, wanted: str, result: str | Fraction) -> None:
    found = Fraction(convert(Decimal(value), named(given_unit), named(wanted), difference=True))
    assert abs(found - Fraction(result)) <= found * Fraction(1, 10**39), "all forty digits"


def test_an_absolute_temperature_has_an_offset_and_a_difference_none() -> None:
    celsius, kelvin, fahrenheit = named("degC"), named("K"), named("degF")
    assert convert(Decimal(20), celsius, kelvin, difference=False) == Decimal("293.15")
    assert convert(Decimal(20), celsius, kelvin, difference=True) == 20
    assert convert(Decimal(68), fahrenheit, celsius, difference=False) == 20
    assert convert(Decimal(9), fahrenheit, celsius, difference=True) == 5


@pytest.mark.parametrize(
    ("given_unit", "wanted", "words"),
    [
        ("kg", "m", '"kg" is no unit of the kind of "m"; valid are m, mm, um, in'),
        ("N.m", "N", 'no unit of the kind of "N"; valid are N, kN, lbf'),
        ("m", "mm2", 'valid is "mm2"'),
        ("Hz", "1/s", "whether a cycle counts as 1 or as 2π"),
        ("1/min", "rad/s", "whether a cycle counts as 1 or as 2π"),
        ("rad/s", "1/s", "whether a cycle counts as 1 or as 2π"),
    ],
)
def test_refuses_what_measures_something_else(given_unit: str, wanted: str, words: str) -> None:
    with pytest.raises(UnitError, match="^.*" + words.replace("(", r"\(")):
        convert(Decimal(1), named(given_unit), named(wanted), difference=True)


@pytest.mark.parametrize("unit", ["deg", "s", "Hz"])
def test_a_pure_number_has_no_unit(unit: str) -> None:
    with pytest.raises(UnitError, match="is no pure number; valid are plain numbers, %"):
        convert(Decimal(1), named(unit), ONE, difference=True)


def test_an_angle_may_be_written_for_a_variable_of_unit_one() -> None:
    found = Fraction(convert(Decimal(360), named("deg"), named("rad/rad"), difference=True))
    assert abs(found - TWO_PI) <= TWO_PI * Fraction(1, 10**39)


@pytest.mark.parametrize(
    "text",
    ["", "foo", "dB", "bit", "m**999", "((m2)2)2", "m^m", "m 10", "m" * 70, '__import__("os")', "m;s", "5 m", "(m)**9", "m\0"],
)
def test_text_that_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(UnitError):
        named(text)


@given(st.text(alphabet="mskgNHzradµ°%./*^()-+ 0123456789", max_size=20))
def test_no_text_does_anything_else(text: str) -> None:
    with suppress(UnitError):
        assert named(text).factor > 0


def unit(name: str, factor: float = 1.0, offset: float = 0.0, **powers: int) -> Unit:
    return Unit(name, tuple(powers.items()), factor, offset)


@pytest.mark.parametrize(
    ("written", "factor", "angle", "cyclic"),
    [
        (unit("rad/s", s=-1, rad=1), 1, 1, False),
        (unit("rad/s", s=-1), 1, 1, False),
        (unit("Hz", s=-1), TWO_PI, 1, True),
        (unit("Hz", 6.283185307179586, s=-1, rad=1), TWO_PI, 1, True),
        (unit("rpm", 0.10471975511966, s=-1), TWO_PI / 60, 1, True),
        (unit("rpm", 1 / 60, s=-1), TWO_PI / 60, 1, True),
        (unit("1/min", 0.104719755119660, s=-1, rad=1), Fraction("0.10471975511966"), 1, False),
        (unit("deg", 0.0174532925199433, rad=1), TWO_PI / 360, 1, False),
        (unit("mm", 1.0, m=1), 1, 0, False),  # the FMU's word counts, not the name
        (unit("tick", 0.25, s=1), Fraction(1, 4), 0, False),
        (unit("N.m", kg=1, m=2, s=-2), 1, 0, False),
    ],
)
def test_an_fmus_definition_counts_and_its_name_completes_it(written: Unit, factor: Fraction, angle: int, cyclic: bool) -> None:
    found = of_fmu(written)
    assert found is not None
    assert (found.name, found.angle, found.cyclic) == (written.name, angle, cyclic)
    assert abs(found.factor - factor) <= factor * Fraction(1, 10**38)


def test_a_unit_that_is_only_named_means_what_its_name_says_or_nothing() -> None:
    known = of_fmu(Unit("N/mm", (), defined=False))
    assert known is not None
    assert (known.factor, known.si_name) == (1000, "N/m")
    assert of_fmu(Unit("widgets", (), defined=False)) is None
    assert of_fmu(unit("broken", factor=0.0)) is None


def test_display_units_convert_as_the_fmu_says() -> None:
    meter = named("m")
    furlong = units.shown_as(DisplayUnit("furlong_fmu", 1 / 201.168), meter)
    assert furlong is not None
    assert abs(convert(Decimal(2), furlong, meter, difference=True) - Decimal("402.336")) < Decimal("1e-12")
    shown = units.shown_as(DisplayUnit("cold", 1.8, -459.67), named("K"))
    assert shown is not None
    assert abs(convert(Decimal(68), shown, named("K"), difference=False) - Decimal("293.15")) < Decimal("1e-12")


@pytest.mark.parametrize(
    ("name", "si"), [("N.mm", "N.m"), ("kPa", "Pa"), ("W/(m2.K)", "kg/(s3.K)"), ("mm", "m"), ("deg", "rad"), ("%", "1"), ("1/ms", "1/s")]
)
def test_names_the_si_unit(name: str, si: str) -> None:
    assert named(name).si_name == si


@given(st.fractions(min_value=-(10**9), max_value=10**9))
def test_a_decimal_is_exact_or_of_forty_digits(exact: Fraction) -> None:
    found = decimal(exact)
    assert abs(Fraction(found) - exact) <= abs(exact) * Fraction(1, 10**39)
    denominator = exact.denominator
    for prime in (2, 5):
        while denominator % prime == 0:
            denominator //= prime
    if denominator == 1 and exact.denominator < 10**20:
        assert Fraction(found) == exact


@given(st.decimals(min_value="0.001", max_value="1000", places=6), st.sampled_from(["deg/s", "Hz", "rpm", "1000 rad/s"[5:]]))
def test_there_and_back_is_the_same(value: Decimal, name: str) -> None:
    there = convert(value, named(name), RADIAN_PER_SECOND, difference=True)
    back = convert(there, RADIAN_PER_SECOND, named(name), difference=True)
    assert abs(back - value) <= value * Decimal("1e-38")
