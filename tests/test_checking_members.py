"""The plants of a box as the checker sees them: polynomials in parameters, where each comes to rest, and what is said of them."""

from __future__ import annotations

import itertools
import random
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from flint import arb, fmpq
from forgery import certificate, command, costate, task
from marks import first

from relaxations.checking import members
from relaxations.checking.claims import Outcome, check, claim
from relaxations.checking.reading import Refuted, Undecided, read

Terms = list[tuple[Fraction, tuple[int, ...]]]


pytestmark = pytest.mark.usefixtures("enough_work")


def exact(x: Any) -> fmpq:
    return fmpq(*Fraction(x).as_integer_ratio())


def fraction(x: Any) -> Fraction:
    return Fraction(int(x.p), int(x.q))


def polynomial(terms: Terms, place: Any, derivative: int | None = None) -> Fraction:
    """Σ c Π x_i^n_i, or its derivative by one of them."""
    total = Fraction(0)
    for coefficient, powers in terms:
        product = coefficient
        for i, (x, n) in enumerate(zip(place, powers, strict=True)):
            if i == derivative:
                product *= n * x ** (n - 1) if n else 0
            else:
                product *= x**n
        total += product
    return total


@pytest.mark.parametrize("seed", range(8))
def test_coefficients_and_their_derivatives(seed: int) -> None:
    rng = random.Random(seed)
    terms: Terms = [(Fraction(rng.randint(-9, 9), 4), tuple(rng.randint(0, 3) for _ in range(2))) for _ in range(4)]
    given = [(exact(c), powers) for c, powers in terms]
    place = [Fraction(rng.randint(-9, 9), 4), Fraction(rng.randint(1, 9), 4)]
    box: Any = SimpleNamespace(plants=(), numerator=(given, [(exact(3), (0, 0))]), denominator=())
    for derivative in (None, 0, 1):
        expected = polynomial(terms, place, derivative)
        numbers = [exact(x) for x in place]
        assert fraction(members.valued(given, numbers, derivative)) == expected
        lowest, highest = members.member(box, numbers, "numerator", derivative)
        assert (fraction(lowest), fraction(highest)) == (3 if derivative is None else 0, expected)
        over = arb(members.valued(given, [arb(x, 0.25) for x in numbers], derivative))
        for shift in (Fraction(-1, 4), Fraction(0), Fraction(1, 4)):
            assert over.contains(exact(polynomial(terms, [x + shift for x in place], derivative)))
    assert members.valued([], [], None) == 0


def test_plants_that_are_listed() -> None:
    first = SimpleNamespace(place=(exact(1), exact(2)), numerator=(exact(3),), denominator=(exact(1), exact(4)))
    other = SimpleNamespace(place=(exact(2), exact(1)), numerator=(exact(7),), denominator=(exact(1), exact(8)))
    box: Any = SimpleNamespace(plants=(first, other), numerator=(), denominator=())
    assert members.member(box, [exact(2), exact(1)], "denominator") == [8, 1]
    assert members.member(box, [exact(1), exact(2)], "numerator") == [3]
    assert members.member(box, [exact(1), exact(2)], "denominator", 1) == [0, 0]
    with pytest.raises(Exception, match="no plant of the box is listed"):
        members.member(box, [exact(2), exact(2)], "numerator")


def test_long_powers_are_given_up() -> None:
    long = exact(Fraction(2) ** 1000 + 1)  # 1,001 bits
    assert members.valued([(exact(1), (19,))], [long]) == long**19
    with pytest.raises(Undecided, match="too long"):
        members.valued([(exact(1), (20,))], [long])


def boxed(
    numerator: list[Terms], denominator: list[Terms], ranges: list[tuple[str, str, str]], share: Fraction | None, **others: Any
) -> dict[str, Any]:
    """A robust task; each parameter is (nominal, low, high)."""
    nominal = [Fraction(r[0]) for r in ranges]
    head = polynomial(denominator[0], nominal)
    plant = [[str(polynomial(t, nominal) / head) for t in side] for side in (numerator, denominator)]
    of = task(plant[0], plant[1], limits=("-100", "100"), **others)
    written = [[[[str(c), [*powers]] for c, powers in terms] for terms in side] for side in (numerator, denominator)]
    parameters = [{"name": f"k{i}", "nominal": n, "low": low, "high": high} for i, (n, low, high) in enumerate(ranges)]
    final = None if share is None else str(share)
    box = {
        "parameters": parameters,
        "numerator": written[0],
        "denominator": written[1],
        "outputs": {},
        "plants": [],
        "tolerance": "5",
        "final_tolerance": final,
    }
    return {**of, "box": box}


def posed(of: dict[str, Any]) -> Any:
    return read(certificate(of, lower="1", witnesses=(costate(), None))).task


def outcome(of: Any) -> str:
    try:
        members.lands(of)
    except (Refuted, Undecided) as problem:
        return type(problem).__name__
    return "proved"


def constant(c: Any) -> Terms:
    return [(Fraction(c), (0, 0))]


@pytest.mark.parametrize("rigid", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("seed", first(3, range(6)))
def test_every_plant_rests_near_the_target_or_not(seed: int, sign: int, rigid: int) -> None:
    """A gain a(k)/d(k) against its exact values over a grid: a fiftieth more than the worst is proven, a fiftieth less refuted."""
    rng = random.Random(seed)

    def varied(kind: int) -> Terms:
        bends = [(Fraction(rng.randint(-4, 4), 16), powers) for powers in ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2))]
        return [(Fraction(kind * 3), (0, 0)), *bends]

    above, below = varied(sign), varied(rng.choice((1, -1)))
    ranges = [("0", "-1/2", "1"), ("1/4", "-1/4", "1/2")]
    numerator, denominator = [above], [constant(1), constant(3), below, *[[] for _ in range(rigid)]]
    nominal = [Fraction(0), Fraction(1, 4)]
    gain = polynomial(above, nominal) / polynomial(below, nominal)
    grid = itertools.product(*([Fraction(low) + (Fraction(high) - Fraction(low)) * i / 24 for i in range(25)] for _, low, high in ranges))
    worst = max(abs(polynomial(above, place) / polynomial(below, place) / gain - 1) for place in grid)
    worst = worst.limit_denominator(1000)
    assert worst > Fraction(1, 50)
    for factor, expected in ((Fraction(51, 50), "proved"), (Fraction(49, 50), "Refuted")):
        assert outcome(posed(boxed(numerator, denominator, ranges, worst * factor))) == expected
    assert outcome(posed(boxed(numerator, denominator, ranges, None))) == "proved"


def test_the_room_is_that_of_the_gain() -> None:
    """Where `wide - off` and `wide + off` are not negative, the ratio of gains is within the share of 1, and nowhere else."""
    above, below = [(Fraction(3), (0, 0)), (Fraction(1), (1, 0))], [(Fraction(2), (0, 0)), (Fraction(-1), (0, 1))]
    for *signs, size in itertools.product((1, -1), (1, -1), (Fraction(1), Fraction(1, 8))):
        numerator, denominator = (
            [(c * sign * size, powers) for c, powers in terms] for sign, terms in zip(signs, (above, below), strict=True)
        )
        of = posed(boxed([numerator], [constant(1), constant(3), denominator], [("0", "-1", "1"), ("0", "-1", "1")], Fraction(1, 4)))
        shift = members.Shift.of(of)
        for x, y in itertools.product((-1, Fraction(-1, 3), 0, Fraction(1, 2), 1), repeat=2):
            ratio = polynomial(numerator, (x, y)) / polynomial(denominator, (x, y)) / Fraction(3, 2) * signs[0] * signs[1]
            sides = shift.room([exact(x), exact(y)])
            assert [side >= 0 for side in sides] == [ratio <= Fraction(5, 4), ratio >= Fraction(3, 4)]
            for q in (0, 1):  # both are polynomials in each: a derivative is the limit of differences
                h = exact(Fraction(1, 10**9))
                beside = shift.room([exact(x) + h * (q == 0), exact(y) + h * (q == 1)])
                slopes = shift.room([exact(x), exact(y)], q)
                assert all(
                    abs((after - before) / h - slope) < exact("0.00001") for before, after, slope in zip(sides, beside, slopes, strict=True)
                )


def test_a_plant_of_another_kind_has_no_room() -> None:
    """A denominator's lowest coefficient that goes through 0, or an integrator that the nominal plant does not have."""
    through = [(Fraction(1), (0, 0)), (Fraction(-2), (1, 0))]
    ranges = [("0", "0", "1"), ("0", "0", "0")]
    of = posed(boxed([constant(1)], [constant(1), constant(3), through], ranges, Fraction(1)))
    assert outcome(of) == "Undecided"
    with pytest.raises(Undecided):
        members.Shift.of(of).room([exact("0.5"), exact(0)])
    with pytest.raises(Undecided):
        members.Shift.of(of).room([exact(1), exact(0)])
    creeping = [(Fraction(1), (1, 0))]
    of = posed(boxed([constant(1)], [constant(1), constant(3), creeping], [("0", "0", "1"), ("0", "0", "0")], Fraction(1)))
    assert members.rigid(of) == 1
    with pytest.raises(Undecided):
        members.Shift.of(of).room([exact("0.5"), exact(0)])


@pytest.mark.parametrize(
    ("share", "place", "expected"),
    [
        ("0.24", ["1"], Outcome.PROVED),
        ("0.25", ["1"], Outcome.INCONCLUSIVE),
        ("0.24", ["0.9"], Outcome.INCONCLUSIVE),
        ("0.24", ["1.1"], Outcome.MALFORMED),
        ("0.24", ["-0.1"], Outcome.MALFORMED),
        ("0.24", ["1", "1"], Outcome.MALFORMED),
        (None, ["1"], Outcome.MALFORMED),
    ],
)
def test_one_plant_that_rests_too_far_away(share: str | None, place: list[str], expected: Outcome) -> None:
    """The gain is 1 + k/4, and k = 1 the worst."""
    of = boxed(
        [[(Fraction(1), (0,)), (Fraction(1, 4), (1,))]],
        [[(Fraction(1), (0,))]] * 2,
        [("0", "0", "1")],
        share if share is None else Fraction(share),
    )
    witness = {**costate(), "samples": [{"place": place, "residual": [], "deflection": [], "after": []}]}
    assert check(certificate(of, impossible="final", witnesses=(witness, None))).outcome is expected


def test_a_plant_at_an_edge_of_the_box() -> None:
    """The gain is 1 + k/4, k from 0 to 1, and 1 at the nominal plant: at k = 0 the plant rests at 4/5 of the target."""
    for share, expected in ((Fraction(19, 100), Outcome.PROVED), (Fraction(21, 100), Outcome.INCONCLUSIVE)):
        of = boxed([[(Fraction(1), (0,)), (Fraction(1, 4), (1,))]], [[(Fraction(1), (0,))]] * 2, [("1", "0", "1")], share)
        witness = {**costate(), "samples": [{"place": ["0"], "residual": [], "deflection": [], "after": []}]}
        assert check(certificate(of, impossible="final", witnesses=(witness, None))).outcome is expected
        assert check(certificate(of, impossible="final")).outcome is Outcome.MALFORMED
        assert check(certificate(task(["1"], ["1", "0"]), impossible="final")).outcome is Outcome.MALFORMED


def test_a_plant_that_rests_just_within_the_tolerance() -> None:
    """At k = 1 the gain is 5/4 of the nominal one, exactly as far off as it may be: so is no plant too far."""
    for range_ in (("0", "0", "1"), ("0", "-1/2", "1")):
        assert (
            outcome(posed(boxed([[(Fraction(1), (0,)), (Fraction(1, 4), (1,))]], [constant_of_one()] * 2, [range_], Fraction(1, 4))))
            == "proved"
        )


def constant_of_one() -> Terms:
    return [(Fraction(1), (0,))]


def test_a_cell_as_balls() -> None:
    cell, centre, widths = members.laid([(fmpq(1), fmpq(3)), (fmpq(2), fmpq(2)), (fmpq(-1, 3), fmpq(1, 3))])
    wide, _, thirds = (arb(x) for x in cell)
    assert all(wide.contains(arb(x)) for x in (1, 2, 3))
    assert float(wide.rad()) == pytest.approx(1)
    assert cell[1] == 2
    assert all(thirds.overlaps(arb(fmpq(i, 3))) for i in (-1, 0, 1))
    assert centre == [2, 2, 0]
    assert [float(w) for w in widths] == pytest.approx([1, 0, 1 / 3])


def test_cells_are_halved_across_the_widest_side() -> None:
    of = posed(boxed([constant(1)], [constant(1), constant(1)], [("0", "0", "4"), ("0", "0", "1")], Fraction(1)))
    zero, one, two = exact(0), exact(1), exact(2)
    assert members.halved(of, ((zero, two), (zero, one)), "") == [
        ((zero, two), (zero, one / 2)),
        ((zero, two), (one / 2, one)),
    ]  # 1/2 and 1 of the ranges
    assert members.halved(of, ((one, two), (zero, zero)), "") == [((one, one * 3 / 2), (zero, zero)), ((one * 3 / 2, two), (zero, zero))]
    with pytest.raises(Undecided, match="so small"):
        members.halved(of, ((one, one + exact(Fraction(3, 2**40))), (zero, zero)), "so small")
    assert len(members.halved(of, ((one, one + exact(Fraction(5, 2**40))), (zero, zero)), "")) == 2


def moved(*parameters: tuple[str, str | None, str, str], **others: Any) -> Outcome:
    """Of a task whose parameters move roots of 1/(s² + s/5 + 1)."""
    written = [dict(zip(("name", "nominal", "low", "high"), p, strict=True)) for p in parameters]
    box = {
        "parameters": written,
        "numerator": [],
        "denominator": [],
        "outputs": {},
        "plants": [],
        "tolerance": "1.01",
        "final_tolerance": None,
        **others,
    }
    of = {**task(["1"], ["1", "0.2", "1"], limits=("-5", "5")), "box": box}
    return check(certificate(of, upper="1", witnesses=(None, command("1", [("0", "1")], [])))).outcome


@pytest.mark.parametrize(
    ("parameters", "fine"),
    [
        ([("mode[1].frequency", "1", "0.9", "1.1")], True),
        ([("mode[1].frequency", "1", "1", "1")], True),
        ([("mode[1].frequency", "1", "0", "1.1")], False),
        ([("mode[1].frequency", "1", "1.01", "1.1")], False),
        ([("mode[1].frequency", "1", "0.9", "0.99")], False),
        ([("mode[1].frequency", "1.1", "0.9", "1.2")], False),
        ([("mode[1].damping", None, "0.05", "0.15")], True),
        ([("mode[1].damping", None, "0", "0.15")], True),
        ([("mode[1].damping", None, "0.1", "0.1")], True),
        ([("mode[1].damping", "0.1", "0.05", "0.15")], False),
        ([("mode[1].damping", None, "0.15", "0.05")], False),
        ([("mode[1].damping", None, "-0.05", "0.05")], False),
        ([("mode[1].damping", None, "0.05", "1")], False),
        ([("mode[1].frequency", "1", "0.9", "1.1"), ("mode[1].frequency", "1", "0.9", "1.1")], False),
        ([("mode[1].frequency", "1", "0.9", "1.1"), ("k", "1", "0.9", "1.1")], False),
        ([("mode[0].frequency", "1", "0.9", "1.1")], False),
        ([("mode[1].stiffness", "1", "0.9", "1.1")], False),
    ],
)
def test_parameters_that_move_roots(parameters: list[Any], fine: bool) -> None:
    assert moved(*parameters) is (Outcome.PROVED if fine else Outcome.MALFORMED)


def test_roots_are_moved_without_coefficients() -> None:
    one = ("mode[1].frequency", "1", "1", "1")
    assert moved(one, numerator=[[["1", [0]]]]) is Outcome.MALFORMED
    assert moved(one, final_tolerance="0") is not Outcome.MALFORMED
    assert moved(one, final_tolerance="-1") is Outcome.MALFORMED
    assert moved(one, tolerance="0") is Outcome.MALFORMED


def words(of: dict[str, Any]) -> list[str]:
    return claim(check(certificate(of, upper="1", witnesses=(None, command("1", [("0", "1")], []))))).splitlines()


def test_boxes_in_words() -> None:
    ranges = [("0", "0", "1")]
    gain: Terms = [(Fraction(1), (0,)), (Fraction(1, 4), (1,))]
    text = words(boxed([gain], [[(Fraction(1), (0,))]] * 2, ranges, Fraction(1, 4)))
    assert "  and every plant of the box 'k0' in [0, 1] (nominal 0); coefficients in terms of these, (factor, powers):" in text
    assert "  numerator    [[['1', [0]], ['1/4', [1]]]]" in text
    assert "  In every one of these plants the residual |y(t) - y(∞)| for t ≥ T is at most 5 of the displacement instead of 0;" in text
    assert (
        "  y(∞) is the target in the nominal plant, within 1/4 of the displacement of it in the others, and no plant keeps drifting."
        in text
    )
    text = words(boxed([gain], [[(Fraction(1), (0,))]] * 2, ranges, None))
    assert "  y(∞) is the target in the nominal plant, and no plant keeps drifting." in text
    of = task(["1"], ["1", "0.2", "1"], limits=("-5", "5"))
    parameters = [
        {"name": "mode[1].frequency", "nominal": "1", "low": "0.9", "high": "1.1"},
        {"name": "mode[1].damping", "nominal": None, "low": "0", "high": "0.2"},
    ]
    box = {
        "parameters": parameters,
        "numerator": [],
        "denominator": [],
        "outputs": {},
        "plants": [],
        "tolerance": "1.01",
        "final_tolerance": None,
    }
    text = words({**of, "box": box})
    assert (
        "  and every plant that it becomes when these of its roots are moved: mode[1].frequency in [0.9, 1.1], mode[1].damping in [0, 0.2];"
        in text
    )
    assert "  y(∞) is the target in all of them, and none keeps drifting." in text
    hold, others = "  The limits of outputs hold in every one of them, for all t ≥ 0.", members.OTHERS
    assert hold not in text
    assert others not in text
    text = words({**task(["1"], ["1", "0.2", "1"], limits=("-5", "5"), outputs={"w": ["1"]}, deflection={"w": "9"}), "box": box})
    assert hold in text
    assert others in text
    limited = boxed([gain], [[(Fraction(1), (0,))]] * 2, ranges, None)
    limited["limits"]["deflection"], limited["plants"][0]["outputs"] = {"w": "9"}, {"w": ["1"]}
    limited["box"]["outputs"] = {"w": [[["1", [0]]]]}
    text = words(limited)
    assert hold in text
    assert others not in text
    listed = [{"place": [str(k)], "numerator": ["1"], "denominator": ["1", str(1 + k)], "outputs": {}} for k in (0, 1)]
    box = {
        "parameters": [{"name": "k", "nominal": "0", "low": "0", "high": "1"}],
        "numerator": [],
        "denominator": [],
        "outputs": {},
        "plants": listed,
        "tolerance": "5",
        "final_tolerance": "1/2",
    }
    text = words({**task(["1"], ["1", "1"], limits=("-5", "5")), "box": box})
    assert "  and these 2 plants of 'k' in [0, 1] (nominal 0); nothing is said of any other plant of these ranges:" in text
    assert "  at 1: [1] / [1, 2]" in text
    assert (
        "  y(∞) is the target in the nominal plant, within 1/2 of the displacement of it in the others, and no plant keeps drifting."
        in text
    )


def test_coefficients_over_a_cell_about_zero_are_numbers() -> None:
    """The first cell of a parameter that is a deviation."""
    whole = members.valued(((fmpq(2), (3, 0)), (fmpq(1), (1, 2)), (fmpq(1), (0, 0))), [arb(0, 0.5), arb(-3, 0.25)])
    for x in (-0.5, 0.0, 0.5):
        for y in (-3.25, -2.75):
            assert arb(whole).contains(
                fmpq(*x.as_integer_ratio()) ** 3 * 2 + fmpq(*x.as_integer_ratio()) * fmpq(*y.as_integer_ratio()) ** 2 + 1
            )
    assert arb(whole).rad() < 7
    assert arb(members.valued(((fmpq(1), (2, 0)),), [arb(0, 0.5), arb(-3, 0.25)], 0)).contains(fmpq(1))
