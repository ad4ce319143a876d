"""Linear twins: exact matrices from expressions, and what is refused."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import pytest
from flint import arb

from fmus.build import PLANTS
from fmus.errors import DescriptionError
from fmus.twins import evaluate, linear_plant, read_twin, sized

TWO_MASS = (PLANTS / "two_mass" / "twin.toml").read_text(encoding="utf-8")
SMALL = """
input = "u"
states = ["x"]
A = [["-a"]]
B = ["1 / b"]
[parameters]
a = "0.1"
b = 2
[outputs]
y = { C = ["1"], D = "a" }
z = { C = ["2"], D = 0 }
"""


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("0.1", Fraction(1, 10)),
        ("-stiffness / mass", Fraction(-7, 30)),
        ("2 * (stiffness + 1) - mass", Fraction(2, 5)),
        ("stiffness ** 2 / mass", Fraction(49, 300)),
        ("mass ** 0", Fraction(1)),
        ("1e-3", Fraction(1, 1000)),
        ("- -mass", Fraction(3)),
        ("(mass == 3) * stiffness + (mass == stiffness)", Fraction(7, 10)),
    ],
)
def test_expressions_are_exact(expression: str, value: Fraction) -> None:
    assert evaluate(expression, {"stiffness": Fraction("0.7"), "mass": Fraction(3)}, Fraction) == value


def test_expressions_work_in_other_numbers() -> None:
    """The same entries can be evaluated over a whole interval of parameters."""
    stiffness = arb(1, 0.3)
    entry = evaluate("-stiffness / 0.5", {"stiffness": stiffness}, arb)
    assert entry.contains(arb("-1.4000001"))
    assert not entry.contains(arb("-2.7"))


@pytest.mark.parametrize(
    "expression",
    [
        "__import__('os')",
        "mass.real",
        "mass if mass else 1",
        "mass ** 1000",
        "mass ** 0.5",
        "mass ** mass",
        "mass // 2",
        "[mass][0]",
        "True",
        "1j",
        "0x10",
        "'a'",
        "mass; mass",
        "",
        "(" * 300 + "1" + ")" * 300,
        "1" * 2000,
        "nowhere",
        "1 / (mass - mass)",
        "lambda: 0",
        "(mass := 2)",
        "mass ** -1",
    ],
)
def test_expressions_are_nothing_more(expression: str) -> None:
    with pytest.raises(DescriptionError):
        evaluate(expression, {"mass": Fraction(3)}, Fraction)


def test_parameters_are_taken_as_written() -> None:
    assert read_twin(TWO_MASS).A[1][0] == -1
    assert read_twin(TWO_MASS, {"stiffness": Decimal("0.7")}).A[1][0] == Fraction(-7, 10)
    assert read_twin(TWO_MASS, {"stiffness": 0.7}).A[1][0] == -Fraction(0.7) != Fraction(-7, 10)
    assert read_twin(SMALL).outputs["y"] == ((Fraction(1),), Fraction(1, 10))


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"stifness": 1.0}, "no parameter 'stifness'; it has damping, mass_1, mass_2, stiffness"),
        ({"mass_1": 0.0}, "divides by zero with mass_1 = 0"),
        ({"mass_1": float("nan")}, "mass_1 = nan must be a finite number"),
        ({"mass_1": Decimal("Infinity")}, "must be a finite number"),
        ({"mass_1": "heavy"}, "must be a finite number"),
    ],
)
def test_senseless_parameters_are_named(parameters: dict[str, float], words: str) -> None:
    with pytest.raises(DescriptionError, match=words):
        read_twin(TWO_MASS, parameters)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('input = "u"', "", "input = None must be a name"),
        ('states = ["x"]', 'states = "x"', "states = 'x' must be a list of names"),
        ('states = ["x"]', 'states = ["x", "v"]', "A must be a list of 2 rows"),
        ('[["-a"]]', '[["-a", "0"]]', r"A\[0\] must be a list of 1 entries"),
        ('"1 / b"', '"1 / c"', r"B\[0\]: '1 / c': there is no parameter 'c'"),
        ('"1 / b"', "nan", r"B\[0\] = nan must be a finite number"),
        (', D = "a"', "", "outputs.y must be a table of C"),
        ("[parameters]", "[parameter]", "unknown key 'parameter'"),
        ('input = "u"', 'input = "u"\nnonlinear = 1', "nonlinear = 1 must be true or false"),
        ("[outputs]", "outputs", "no TOML"),
    ],
)
def test_malformed_twins_are_refused(old: str, new: str, words: str) -> None:
    assert old in SMALL
    with pytest.raises(DescriptionError, match=words):
        read_twin(SMALL.replace(old, new))


CHAIN = """
input = "u"
states = ["x", "v"]
B = { v = "(i == 1) / m" }
[parameters]
m = "2"
[terms]
third = "1 / 3"
pull = "third / m"
[A]
x = { v = "(j == i)" }
v = { x = "pull * ((j == i + 1) + (j == i - 1) - (j == i) * (2 - (i == 1) - (i == size)))" }
[outputs]
x = { C = { x = "(j == i)" }, D = 0 }
mean = { C = { x = "1 / size" }, D = 0 }
"""


def test_blocks_and_terms_make_the_same_matrices_as_lists() -> None:
    twin = read_twin(sized(CHAIN, 3), {"m": "4"})
    k = Fraction(1, 12)
    assert twin.states == ("x_1", "x_2", "x_3", "v_1", "v_2", "v_3")
    stiffness = [[-k, k, 0], [k, -2 * k, k], [0, k, -k]]
    assert [list(row) for row in twin.A] == [
        *([0, 0, 0, *(int(i == j) for j in range(3))] for i in range(3)),
        *([*row, 0, 0, 0] for row in stiffness),
    ]
    assert list(twin.B) == [0, 0, 0, Fraction(1, 4), 0, 0]
    assert {name: list(row) for name, (row, _) in twin.outputs.items()} == {
        "x_1": [1, 0, 0, 0, 0, 0],
        "x_2": [0, 1, 0, 0, 0, 0],
        "x_3": [0, 0, 1, 0, 0, 0],
        "mean": [Fraction(1, 3)] * 3 + [0, 0, 0],
    }
    assert read_twin(sized(CHAIN, 1)).A == ((0, 1), (0, 0)), "a chain of one mass is free"


@pytest.mark.parametrize(
    ("size", "old", "new", "words"),
    [
        (0, "", "", "size = 0 must be a whole number from 1 to 400"),
        (201, "", "", "the linear twin has 402 states; at most 400 are read"),
        (2, "x = { v", "y = { v", "A: 'y' is no state; the states are x, v"),
        (2, "B = { v", "B = { w", "B: 'w' is no state"),
        (2, 'C = { x = "1 / size" }', 'C = ["1", "1", "0", "0"]', r"outputs.mean.C must be a list of 4 entries, one a state, or a table"),
        (2, "[A]", "[terms2]", "unknown key 'terms2'"),
        (2, 'third = "1 / 3"', 'third = "1 / pull"', r"terms.third: '1 / pull': there is no parameter 'pull'"),
        (2, "(j == i)", "(j < i)", "is not allowed"),
        (2, "(j == i)", "(j == i == 1)", "is not allowed"),
        (None, "", "", "there is no parameter 'i'"),
    ],
)
def test_malformed_blocks_are_refused(size: int | None, old: str, new: str, words: str) -> None:
    assert old in CHAIN
    with pytest.raises(DescriptionError, match=words):
        read_twin(sized(CHAIN.replace(old, new, 1), size))


def test_the_linear_plant_has_the_twins_outputs() -> None:
    plant = linear_plant(read_twin(SMALL), "z")
    assert plant.output == "z"
    assert "y" not in plant.numerators, "an output with feed-through is left out"
    assert "z" in linear_plant(read_twin(SMALL), "y").numerators
    with pytest.raises(DescriptionError, match="no output 'x'; it has y, z"):
        linear_plant(read_twin(SMALL), "x")


@pytest.mark.parametrize("written", ["1e1001", "1E-1001", "1e999999999", "1e-9_999_999", "2 * (1e999999999 + 1)"])
def test_exponents_are_limited_before_a_digit_is_written_out(written: str) -> None:
    with pytest.raises(DescriptionError, match="exponents from -1000 to 1000"):
        evaluate(written, {}, Fraction)


def test_so_are_those_of_parameters_and_of_settings() -> None:
    text = SMALL.replace('a = "0.1"', 'a = "1e999999999"')
    with pytest.raises(DescriptionError, match=r"parameters\.a: '1e999999999' is out of range"):
        read_twin(text)
    with pytest.raises(DescriptionError, match=r"a: .* is out of range"):
        read_twin(SMALL, {"a": Decimal("1e999999999")})
    assert read_twin(SMALL.replace('a = "0.1"', 'a = "1e-1000"')).A[0][0] == -Fraction(1, 10**1000)
