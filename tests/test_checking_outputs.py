"""What the checker computes of outputs in the course of a move, against matrix exponentials, quadrature and cases by hand."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import acb, arb, fmpq
from forgery import system, task
from scipy.linalg import companion, expm

from relaxations.checking import courses, ramps, upper
from relaxations.checking.balls import Root, Wave
from relaxations.checking.reading import Refuted, Undecided

OUTPUTS = {"speed": ["2", "3", "0"], "sway": ["-1", "0.5"]}
PLANT = (["1", "5", "6"], ["1", "2.2", "5.4", "8.2", "4", "0", "0"])  # (s + 1)² (s² + 0.2s + 4) s²: double poles but one pair
START = ["0.5", "-0.25", "1", "0.125", "-0.5", "2"]
DEFLECTION = {"speed": "50", "sway": "50"}
TIMES = (0.0, 0.3, 1.0, 2.5)


pytestmark = pytest.mark.usefixtures("enough_work")


def exactly(x: Any) -> fmpq:
    return fmpq(*Fraction(x).as_integer_ratio())


def plant(**others: Any) -> Any:
    return system(task(*PLANT, "2", outputs=OUTPUTS, deflection=DEFLECTION, **others))


def simulated(numerator: list[str], denominator: list[str], integrals: int, time: float, state: Any = None) -> float:
    """`C e^{At} b` of N/(s^integrals D) in controllable form, or from any state; double precision, so to some 1e-12."""
    below = np.array([float(x) for x in denominator] + [0.0] * integrals)
    size = len(below) - 1
    matrix = companion(below)[::-1, ::-1]  # x_i' = x_{i+1}, the last one -Σ d_i x_i + u
    row = np.zeros(size)
    row[: len(numerator)] = [float(x) for x in reversed(numerator)]
    return float(row @ expm(matrix * time) @ (np.eye(size)[-1] if state is None else state))


@pytest.mark.parametrize("name", OUTPUTS)
@pytest.mark.parametrize("integrals", [0, 1, 2])
def test_responses(name: str, integrals: int) -> None:
    posed = plant()
    roots = courses.common(posed.roots, 2)
    assert [root.multiplicity for root in roots] == [4, *(root.multiplicity for root in posed.roots if not root.value.is_zero())]
    chains = courses.response(posed, roots, name, integrals)
    assert [len(chain) for chain in chains] == [root.multiplicity for root in roots]
    for time in TIMES:
        expected = simulated(OUTPUTS[name], PLANT[1], integrals, time)
        assert float(courses.value(roots, chains, arb(time))) == pytest.approx(expected, abs=1e-10)


def area(numerator: list[str], denominator: list[str], time: float, state: Any) -> float:
    """The integral of an output from 0 to a time without an input, by one more state."""
    below, size = np.array([float(x) for x in denominator]), len(denominator) - 1
    matrix = np.zeros((size + 1, size + 1))
    matrix[:size, :size] = companion(below)[::-1, ::-1]
    matrix[size, : len(numerator)] = [float(x) for x in reversed(numerator)]
    return float((expm(matrix * time) @ [*state, 0.0])[-1])


def test_a_response_where_the_plant_has_no_pole_at_the_origin() -> None:
    posed = system(task(["2"], ["1", "0.5", "4"], "0.25", outputs={"rate": ["1", "0"]}, deflection={"rate": "1"}))
    roots = courses.common(posed.roots, 2)
    assert [root.multiplicity for root in roots] == [2, 1]
    for integrals in (0, 1, 2):
        chains = courses.response(posed, roots, "rate", integrals)
        for time in TIMES:
            expected = simulated(["1", "0"], ["1", "0.5", "4"], integrals, time)
            assert float(courses.value(roots, chains, arb(time))) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", OUTPUTS)
def test_an_output_without_an_input(name: str) -> None:
    posed = plant(initial_state=START)
    roots = courses.common(posed.roots, 2)
    chains = courses.free(posed, roots, name)
    state = np.array([float(x) for x in START])
    for time in TIMES:
        assert float(courses.value(roots, chains, arb(time))) == pytest.approx(
            simulated(OUTPUTS[name], PLANT[1], 0, time, state), abs=1e-10
        )
    at_rest = courses.free(plant(), roots, name)
    assert all(c.is_zero() for chain in at_rest for c in chain)


def test_how_an_output_begins() -> None:
    """y = N(d/dt) ξ and its derivatives, as many as do not need the highest derivative of ξ."""
    posed = plant(initial_state=START).task
    xi = [Fraction(x) for x in START]
    speed = [2 * xi[k + 2] + 3 * xi[k + 1] for k in range(4)]
    sway = [-xi[k + 1] + xi[k] / 2 for k in range(5)]
    for name, expected in (("speed", speed), ("sway", sway)):
        assert [Fraction(int(x.p), int(x.q)) for x in courses.beginning(posed, name)] == expected
    assert [x for x in courses.beginning(plant().task, "sway") if x] == []


def chains_of(roots: Any, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    chains = [
        [
            acb(*(arb(x) for x in rng.integers(-8, 8, 2) / 8)) if root.flexible else acb(rng.integers(-8, 8) / 8)
            for _ in range(root.multiplicity)
        ]
        for root in roots
    ]
    chains[0][-1] = acb(0)  # room for the integral
    return chains


ROOTS = (Root(acb(0), 3), Root(acb("-0.5"), 2), Root(acb("-0.25", 3), 2))


@pytest.mark.parametrize("seed", range(4))
def test_integrals_and_moved_origins(seed: int) -> None:
    chains = chains_of(ROOTS, seed)
    whole = courses.integrated(ROOTS, chains)
    assert float(courses.value(ROOTS, whole, arb(0)).mid()) == pytest.approx(0, abs=1e-30)

    def conjugated(s: acb, _: bool) -> acb:  # the sum as an analytic function: half of each root's part, and of its mirror image
        total = acb(0)
        for root, chain in zip(ROOTS, chains, strict=True):
            for k, c in enumerate(chain):
                total += (c * (root.value * s).exp() + c.conjugate() * (root.value.conjugate() * s).exp()) * s**k / arb(k).fac() / 2
        return total

    for time in ("0.5", "2"):
        by_quadrature = acb.integral(conjugated, 0, acb(arb(time))).real
        assert courses.value(ROOTS, whole, arb(time)).overlaps(by_quadrature)
        assert float(by_quadrature.rad()) < 1e-25
    moved = [courses.advanced(root, chain, arb("0.75")) for root, chain in zip(ROOTS, chains, strict=True)]
    for time in ("0", "0.5", "2"):
        assert courses.value(ROOTS, moved, arb(time)).overlaps(courses.value(ROOTS, chains, arb(time) + arb("0.75")))
        assert courses.wave(ROOTS, chains)(arb(time))[0].overlaps(courses.value(ROOTS, chains, arb(time)))


def at(roots: Any, found: list[Any], time: Any) -> arb:
    """The sum of pieces at an instant; at an edge, that of the piece that begins there."""
    begin, _, chains = [piece for piece in found if arb(piece[0]) <= arb(time)][-1]
    return courses.value(roots, chains, arb(time) - arb(begin))


def test_pieces_between_kicks() -> None:
    """A kick adds its own sum from its instant on; two at once make no piece between them."""
    start, one, other = (chains_of(ROOTS, seed) for seed in (1, 2, 3))
    kicks = [(arb("0.5"), one), (arb("0.5"), other), (arb("1.25"), one)]
    found = list(courses.pieces(ROOTS, start, kicks, arb(2)))
    assert [(float(begin), float(length)) for begin, length, _ in found] == [(0, 0.5), (0.5, 0.75), (1.25, 0.75)]
    for time in ("0", "0.25", "0.5", "1", "1.25", "1.75"):
        expected = courses.value(ROOTS, start, arb(time))
        for begin, chains in kicks:
            if begin <= arb(time):
                expected += courses.value(ROOTS, chains, arb(time) - begin)
        assert at(ROOTS, found, time).overlaps(expected)
    by_zero = list(courses.pieces(ROOTS, start, [(fmpq(0), one)], fmpq(1)))
    assert [(begin, length) for begin, length, _ in by_zero] == [(0, 1)]


PRESSES = [("speed", "0.5", "0.5", "2"), ("sway", "0.25", "1.5", "-3"), ("speed", "1", "5", "1.5"), ("sway", "4", "6", "7")]


@pytest.mark.parametrize("sample_time", [None, "1/8"])
def test_what_multipliers_of_outputs_take_off(sample_time: str | None) -> None:
    """p loses the impulse response h(s - τ) at a time to go τ, or its mean over those from begin to end."""
    posed = plant(sample_time=sample_time)
    roots = courses.common(posed.roots, 2)
    presses = [SimpleNamespace(output=name, begin=exactly(b), end=exactly(e), weight=exactly(w)) for name, b, e, w in PRESSES]
    horizon = fmpq(3) if sample_time else arb(3)
    kicks = courses.pressed(posed, roots, presses, horizon)
    assert [float(arb(at_)) for at_, _ in kicks] == [0.25, 0.5, 1.0, 1.5]
    assert all(isinstance(at_, fmpq if sample_time else arb) for at_, _ in kicks)
    nothing = [[acb(0)] * root.multiplicity for root in roots]
    found = list(courses.pieces(roots, nothing, kicks, horizon))
    for time in (0.125, 0.375, 0.75, 1.25, 2.0, 2.875):
        expected = 0.0
        for name, b, e, w in PRESSES:
            begin, end, weight = float(b), float(e), float(w)
            if begin == end:
                expected -= weight * simulated(OUTPUTS[name], PLANT[1], 0, time - begin) if time > begin else 0.0
            else:
                ends = [simulated(OUTPUTS[name], PLANT[1], 1, max(time - edge, 0.0)) for edge in (begin, end)]
                expected -= weight / (end - begin) * (ends[0] - ends[1])
        assert float(at(roots, found, time).mid()) == pytest.approx(expected, abs=1e-9)


def test_what_multipliers_of_outputs_add_from_a_start() -> None:
    """Each adds its weight times the output without an input, a time to go before the end: or the mean of it, 0 before the move."""
    posed = plant(initial_state=START)
    roots = courses.common(posed.roots, 2)
    presses = [SimpleNamespace(output=name, begin=exactly(b), end=exactly(e), weight=exactly(w)) for name, b, e, w in PRESSES]
    state, expected = np.array([float(x) for x in START]), 0.0
    for name, b, e, w in PRESSES:
        begin, end, weight = float(b), float(e), float(w)
        if begin == end:
            expected += weight * simulated(OUTPUTS[name], PLANT[1], 0, 3 - begin, state)
            continue
        if begin < 3:
            over = [area(OUTPUTS[name], PLANT[1], max(3 - edge, 0.0), state) for edge in (begin, end)]
            expected += weight / (end - begin) * (over[0] - over[1])
    assert float(courses.begun(posed, roots, presses, arb(3)).mid()) == pytest.approx(expected, abs=1e-9)
    assert courses.begun(plant(), roots, presses, arb(3)) == 0


def outcome(prove: Any, *of: Any) -> str:
    try:
        prove(*of)
    except (Refuted, Undecided) as problem:
        return type(problem).__name__
    return "proved"


def wave(*coefficients: Any) -> Wave:
    """A polynomial `Σ c_k s^k/k!`."""
    return Wave.of((Root(acb(0), len(coefficients)),), [exactly(c) for c in coefficients])


@pytest.mark.parametrize(
    ("course", "end", "first", "expected"),
    [
        (wave(0, 1), "0.75", (), "proved"),
        (wave(0, 1), "1.25", (), "Refuted"),
        (wave(0, -1), "1.25", (), "Refuted"),
        (wave(0, 4, -8), "0.5", (), "Undecided"),  # touches 1 at the end: balls do not tell
        (wave(0, 4, -8), "0.49", (), "proved"),
        (wave(0, "3.9", -8), "1", (), "proved"),  # a hump of 0.95 in the middle
        (wave(0, "4.1", -8), "1", (), "Refuted"),  # of 1.05
        (wave(0, "-4.1", 8), "1", (), "Refuted"),
        (wave(1, -1), "1", (), "Undecided"),  # begins at the limit, and nothing exact is known of it
        (wave(1, -1), "1", (1,), "proved"),
        (wave(-1, 1), "1", (-1,), "proved"),
        (wave(1, 1), "1", (1,), "Refuted"),
        (wave(1, 0, -1), "1", (1,), "Undecided"),  # its slope is 0, which is not known exactly
        (wave(1, 0, -1), "1", (1, 0), "proved"),
        (wave(-1, 0, 1), "1", (-1, 0), "proved"),
        (wave(1, 0, 1), "1", (1, 0), "Refuted"),
        (wave(1, 0, 0, -1), "1", (1, 0, 0), "proved"),
        (wave(1, -2, 6), "0.5", (1, -2), "proved"),  # falls at first, ends at 0.75
        (wave(1, -2, 6), "1", (1, -2), "Refuted"),  # ends at 2
        (wave(1, 2, -6), "1", (1, 2), "Refuted"),  # rises at first
        (wave(1, 1, -1), "0.25", (1, 1), "Refuted"),
        (wave("0.75", 1, -2), "1", (), "Undecided"),  # exactly 1 in the middle, which is not beyond
        (wave("-0.75", -1, 2), "1", (), "Undecided"),
        (wave("-0.0046875", "11.15", "-82.5", 360, -720), "1", (), "Refuted"),  # 1.025 at 1/4, and a second hump of 0.975 at 3/4
        (wave("0.0953125", "11.35", "-82.5", 360, -720), "1", (), "Refuted"),  # and of 1.275 at 3/4
        (wave("-0.1046875", "11.15", "-82.5", 360, -720), "1", (), "proved"),  # 0.925 and 0.875
    ],
)
def test_outputs_within_a_limit_of_one(course: Wave, end: str, first: tuple[int, ...], expected: str) -> None:
    assert outcome(courses.within, course, arb(end), fmpq(1), "name", [fmpq(x) for x in first]) == expected


def test_a_command_that_takes_an_output_too_far() -> None:
    """The cart, |u| = 1 for 1 s each way, from rest and from a start, in steps and in ramps."""

    def found(limit: str, levels: list[Any], sloped: bool = False, start: list[str] | None = None) -> str:
        others = {"outputs": {"rate": ["1", "0"]}, "deflection": {"rate": limit}, "rate": ["-9", "9"] if sloped else None}
        posed = system(task(["1"], ["1", "0", "0"], "1", initial_state=start, **others))
        return outcome(courses.prove, posed, 2, [fmpq(2), fmpq(0), fmpq(1), *(fmpq(x) for x in levels)])

    assert found("1.0001", [1, -1]) == "proved"
    assert found("0.9999", [1, -1]) == "Refuted"
    assert found("0.9999", [-1, 1]) == "Refuted"
    assert found("1.5001", [1, -1], start=["0", "0.5"]) == "proved"
    assert found("1.4999", [1, -1], start=["0", "0.5"]) == "Refuted"
    assert found("0.5001", [1, -1], start=["0", "-0.5"]) == "proved"
    assert found("0.5", [1, -1], start=["0", "-0.5"]) in ("proved", "Undecided")
    # straight from 0 to 1 in 1 s and back to 0: a speed of 1/2, then 1
    assert found("1.0001", [0, 1], sloped=True) == "proved"
    assert found("0.9999", [0, 1], sloped=True) == "Refuted"
    assert found("0.5001", [0, 1], sloped=True) == "Refuted"
    assert found("0.7501", [0, -1], sloped=True, start=["0", "0.25"]) == "proved"
    assert found("0.7499", [0, -1], sloped=True, start=["0", "0.25"]) == "Refuted"


def test_straight_pieces_of_any_length_end_where_the_tail_begins() -> None:
    """(s + 1)/s²: the input goes up to 1 in 2 s and down to 1/2 in 3 s, where its tail begins: its integral is 1 + 9/4."""
    others: dict[str, Any] = {"outputs": {"rate": ["1", "0"]}, "rate": ["-9", "9"], "rest": "output"}
    for limit, expected in (("3.2501", "proved"), ("3.2499", "Refuted")):
        posed = system(task(["1", "1"], ["1", "0", "0"], "1", deflection={"rate": limit}, **others))
        assert outcome(courses.prove, posed, 2, [fmpq(5), fmpq(0), fmpq(2), fmpq(0), fmpq(1), fmpq(1, 2)]) == expected


def test_instants_of_multipliers_are_exact() -> None:
    third = fmpq(1, 3)
    assert courses.near(plant(), third).is_exact()
    assert courses.near(plant(sample_time="1/3"), third) == third
    assert isinstance(courses.near(plant(sample_time="1/3"), third), fmpq)
    assert ramps.exact(courses.near(plant(), third)).overlaps(arb(third))


# (s + 3)² (s² + 2s + 5): a tail c₀ e^{-3r} + c₁ r e^{-3r} + Re c₂ e^{(-1+2j)r}
TAILED = (["1", "8", "26", "48", "45"], PLANT[1])


def tailed(**others: Any) -> Any:
    return system(task(*TAILED, "2", rest="output", outputs=OUTPUTS, deflection=DEFLECTION, rate=["-4", "9"], **others))


def tail_numbers(posed: Any, real: tuple[str, str], pair: tuple[str, str]) -> list[fmpq]:
    """Coefficients in the flat order of the zeros."""
    numbers = [x for zero in posed.zeros for x in (pair if zero.flexible else real)]
    return [exactly(x) for x in numbers]


def after_the_move(output: str | None, real: tuple[str, str], pair: tuple[str, str], r: Any) -> Any:
    """What such a tail does: its own derivative, or the output's exponential response, with the second zero's derivative by z."""
    above, below = (
        np.poly1d([1.0, 0.0] if output is None else [float(x) for x in side]) for side in (OUTPUTS.get(output or "", []), PLANT[1])
    )
    if output is None:
        above, below = np.poly1d([1.0, 0.0]), np.poly1d([1.0])

    def gain(z: complex) -> complex:
        return above(z) / below(z)

    slope = (above.deriv()(-3) * below(-3) - above(-3) * below.deriv()(-3)) / below(-3) ** 2
    first, second = (float(x) for x in real)
    z, c = -1 + 2j, complex(*(float(x) for x in pair))
    return (gain(-3) * (first + second * r) + slope * second) * np.exp(-3 * r) + (gain(z) * c * np.exp(z * r)).real


@pytest.mark.parametrize("output", [None, *OUTPUTS])
def test_what_a_tail_does_after_the_move(output: str | None) -> None:
    posed, real, pair = tailed(), ("0.5", "-2"), ("0.25", "1.5")
    answer, above, below = posed.after(output)
    numbers, total = iter(tail_numbers(posed, real, pair)), [arb(0)] * 3
    times = (0.0, 0.4, 1.5)
    for zero in posed.zeros:
        chain = answer([acb(next(numbers), next(numbers) if zero.flexible else 0) for _ in range(zero.multiplicity)], zero)
        for i, r in enumerate(times):
            total[i] += sum((c * b for c, b in zip(chain, zero.impulse(arb(r)), strict=True)), acb(0)).real
    for r, found in zip(times, total, strict=True):
        assert float(found.mid()) == pytest.approx(after_the_move(output, real, pair, r), abs=1e-12)
    if output is None:
        assert (above, below) == (9, 4)
    else:  # rests at 2 N(0)/45
        rest = 2 * exactly(OUTPUTS[output][-1]) / 45
        assert (above, below) == (50 - rest, 50 + rest)


def test_the_controlled_output_is_not_moved_by_a_tail() -> None:
    posed = system(task(*TAILED, "2", rest="output", outputs={"y": TAILED[0]}, deflection={"y": "50"}))
    answer, above, below = posed.after("y")
    assert [answer([acb(3)] * zero.multiplicity, zero) == [acb(0)] * zero.multiplicity for zero in posed.zeros] == [True, True]
    assert (above, below) == (48, 52)


@pytest.mark.parametrize(("output", "real", "pair"), [
    (None, ("0.5", "-2"), ("0.25", "1.5")), (None, ("-0.5", "2"), ("0", "-1")), (None, ("0", "0"), ("0.5", "0.5")),
    ("speed", ("0.5", "-2"), ("0.25", "1.5")), ("sway", ("-2", "2"), ("0.5", "-1.5")),
])  # fmt: skip
def test_a_tail_keeps_slopes_and_outputs_within_their_limits(output: str | None, real: tuple[str, str], pair: tuple[str, str]) -> None:
    """A limit a thousandth beyond the farthest point of a dense grid is proven, one a thousandth below it refuted, on either side."""
    course = after_the_move(output, real, pair, np.linspace(0, 12, 200_001))
    for factor, expected in ((1.001, "proved"), (0.999, "Refuted")):
        if output is None:
            low, high = (
                str(Fraction(side * factor).limit_denominator(10**9)) for side in (min(course.min(), -1e-3), max(course.max(), 1e-3))
            )
            sides = [(low, "1000"), ("-1000", high)]
            tasks = [task(*TAILED, "2", rest="output", rate=[*side], limits=("-1000", "1000")) for side in sides]
        else:
            rest = 2 * float(OUTPUTS[output][-1]) / 45
            farthest = max((course + rest).max(), -(course + rest).min())
            limit = str(Fraction(farthest * factor).limit_denominator(10**9))
            if float(Fraction(limit)) < abs(rest):
                continue
            outputs = {"outputs": {output: OUTPUTS[output]}, "deflection": {output: limit}}
            tasks = [task(*TAILED, "2", rest="output", limits=("-1000", "1000"), **outputs)]
        for of in tasks:
            posed = system(of)
            numbers = tail_numbers(posed, real, pair)
            assert outcome(upper.tail_limits, posed, 0, [fmpq(1), *numbers]) == expected, (of["limits"], expected)
