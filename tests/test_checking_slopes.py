"""What the checker computes of limits of the slope, against quadrature, enumeration and identities that share nothing with it."""

from __future__ import annotations

import itertools
import random
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import acb, arb, fmpq
from forgery import certificate, command, system, task

from relaxations.checking import balls, courses, lower, ramps, upper
from relaxations.checking.balls import Root
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Refuted, Undecided

RIGID = task(["1", "5", "11", "15"], ["1", "1.2", "4.2", "4", "0", "0"], "2", rest="output", rate=["-4", "4"])  # (s + 3)(s² + 2s + 5)
HELD = task(["2"], ["1", "2.2", "5.4", "8.2", "4"], "0.25", rate=["-4", "4"])  # (s + 1)² (s² + 0.2s + 4), input 1/2 at rest
TAILED = task(["1", "5", "11", "15"], ["1", "2.2", "5.4", "8.2", "4"], "2", rest="output", rate=["-4", "4"])  # both: held at 8/15
N = 3
COMMANDS = {
    "rigid": (RIGID, [5, 0, 1, 3, 0, -1, Fraction(1, 2), Fraction(1, 5), Fraction(-1, 7), Fraction(2, 9)]),
    "tailed": (TAILED, [5, 0, 1, 3, 0, -1, Fraction(1, 2), Fraction(1, 5), Fraction(-1, 7), Fraction(2, 9)]),
    "held": (HELD, [4, 0, Fraction(1, 3), 2, 0, Fraction(3, 4), Fraction(-1, 2)]),
}


pytestmark = pytest.mark.usefixtures("enough_work")


def fractions(numbers: list[Any]) -> list[upper.Number]:
    return [fmpq(Fraction(x).numerator, Fraction(x).denominator) for x in numbers]


@pytest.mark.parametrize("name", COMMANDS)
def test_moments_of_a_command_of_straight_pieces(name: str) -> None:
    """`∫_0^T s^k/k! e^{ps} u(T - s) ds` by quadrature, piece by piece; the last level is where the tail begins."""
    posed, numbers = COMMANDS[name]
    plant, command = system(posed), fractions(numbers)
    (time, *starts), levels, tail = command[: N + 1], command[N + 1 : 2 * N + 1], command[2 * N + 1 :]
    last = plant.rest + (tail[0] + tail[1] if tail else 0)  # the real zero's coefficient, and the pair's real part, in either order
    assert not tail or last == plant.end(tail) or plant.zeros[0].flexible
    nodes = list(itertools.pairwise(zip([*starts, time], [*levels, plant.end(tail)], strict=True)))
    expected: list[arb] = []
    for root in plant.roots:
        for k in range(root.multiplicity):

            def straight(s: acb, _: bool, a: Any, ua: Any, slope: Any, root: Root = root, k: int = k) -> acb:
                return s**k / arb(k).fac() * (root.value * s).exp() * (acb(ua) + acb(slope) * (acb(time - a) - s))

            total = acb(0)
            for (a, ua), (b, ub) in nodes:
                slope = (ub - ua) / (b - a)
                total += acb.integral(
                    lambda s, flag, a=a, ua=ua, slope=slope, f=straight: f(s, flag, a, ua, slope), acb(time - b), acb(time - a)
                )
            expected += [total.real, -total.imag][: 1 + root.flexible]
    found = ramps.moments(plant, command, N).entries()
    assert all(x.overlaps(y) and float(x.rad()) < 1e-30 and float(y.rad()) < 1e-25 for x, y in zip(found, expected, strict=True))
    assert len({float(x.mid()) for x in found}) == len(found)


@pytest.mark.parametrize("name", COMMANDS)
def test_moments_are_linear_in_levels(name: str) -> None:
    """So each column of the Jacobian is a difference of two residuals, exactly."""
    posed, numbers = COMMANDS[name]
    plant, command = system(posed), fractions(numbers)
    at = upper.residual(plant, N, command)
    assert all(
        x.overlaps(y)
        for x, y in zip(
            at.entries(),
            (
                plant.drift(arb(0))
                - plant.target
                + ramps.moments(plant, command, N)
                - plant.columns * balls.arb_mat(plant.columns.ncols(), 1, command[2 * N + 1 :])
            ).entries(),
            strict=True,
        )
    )
    for place in range(N + 2, len(command)):
        other = [number + (i == place) for i, number in enumerate(command)]
        change, slopes = upper.residual(plant, N, other) - at, upper.derivative(plant, N, command, place)
        assert all(x.overlaps(y) for x, y in zip(slopes.entries(), change.entries(), strict=True))
        assert any(not x.contains(0) for x in change.entries())
        assert max(float(x.rad()) for x in slopes.entries()) < 1e-30


def test_a_sloped_command_jumps_nowhere() -> None:
    plant, command = system(HELD), fractions(COMMANDS["held"][1])

    def outcome(**others: Any) -> str:
        changed = [fmpq(others[f"n{i}"]) if f"n{i}" in others else x for i, x in enumerate(command)]
        try:
            ramps.prove(plant, changed, N)
        except (Refuted, Undecided) as problem:
            return type(problem).__name__
        return "proved"

    assert outcome() == "proved"  # slopes 9/4, -3/4, 1/2
    assert outcome(n4=1) == "Refuted"
    assert outcome(n3=fmpq(39, 10)) == "Refuted"  # up by 1 in 1/10 s
    assert outcome(n3=fmpq(15, 4)) == "proved"  # exactly 4
    assert outcome(n2=fmpq(5, 3), n5=fmpq(13, 6)) == "Refuted"  # down by 8/3 in 1/3 s
    assert outcome(n6=fmpq(-7, 1), n3=2) == "Refuted"


def test_a_sloped_command_ends_where_the_tail_begins() -> None:
    plant = system(RIGID)
    for end, expected in (("1/2", "proved"), ("11/12", "Refuted"), ("1/12", "Refuted"), ("5/6", "proved")):
        pair_first = plant.zeros[0].flexible
        tail = [Fraction(0)] * 3
        tail[0 if pair_first else 1] = Fraction(1, 3)  # the pair's real part
        tail[2 if pair_first else 0] = Fraction(end) - Fraction(1, 3)
        command = fractions([Fraction(31, 10), 0, 1, 3, 0, -1, Fraction(1, 2), *tail])
        try:
            ramps.prove(plant, command, N)
            found = "proved"
        except Refuted:
            found = "Refuted"
        assert found == expected


def test_fuel_of_straight_pieces() -> None:
    """`∫ |u| dt`: triangles where u changes its sign, trapezoids where it does not."""
    levels, instants = fractions([0, 2, -1, -3, 0, 0, 1]), fractions([0, 1, 4, 6, 7, 9, 10])
    # 1, then 2 s of 2 → 0 and 1 s of 0 → -1, then 2 s of mean 2, then 1.5, nothing, 0.5
    burnt = ramps.burnt(levels, instants)
    assert burnt.contains(fmpq(19, 2))
    assert float(burnt.rad()) < 1e-35
    for a, b in ((1, 3), (-1, -3), (3, -1), (-3, 1), (0, 2), (-2, 0)):
        grid = np.linspace(float(a), float(b), 100_001)
        exact = 2.5 * np.trapezoid(np.abs(grid), dx=1e-5)
        assert float(ramps.burnt(fractions([a, b]), fractions([1, Fraction(7, 2)]))) == pytest.approx(
            exact, rel=1e-8
        )  # 2nd order at a kink
    unknown = ramps.burnt([arb(0, 0.5), fmpq(1)], fractions([0, 1]))  # from -1/2 to 1/2: at least all that it could be
    assert unknown.upper() >= arb("0.75")
    assert unknown.upper() <= arb("0.751")


@pytest.mark.parametrize("seed", range(12))
def test_stepped_inputs_by_enumeration(seed: int) -> None:
    """The largest `Σ gained u - μ h Σ |u| + Σ q (change allowed - change made)` is at corners; q is 0 where no number is written."""
    rng = random.Random(seed)

    def rational(low: int, high: int) -> Fraction:
        return Fraction(rng.randint(8 * low, 8 * high), 8)

    step, low, high, count = rational(0, 1) + Fraction(1, 8), -rational(0, 2), rational(0, 2) + Fraction(1, 8), 4
    rate = (-rational(1, 3), rational(1, 3)) if seed % 4 else None
    fuel = rational(0, 1) if seed % 3 else Fraction(0)
    gained = [rational(-2, 2) for _ in range(count)]
    written = [rational(-2, 2) for _ in range(rng.choice((1, 3, 5, 7)))]
    q = [*written, *[Fraction(0)] * count][: count + 1] if rate else [Fraction(0)] * (count + 1)
    limits = SimpleNamespace(sample_time=fractions([step])[0], rate=fractions([*rate]) if rate else None)
    plant: Any = SimpleNamespace(task=SimpleNamespace(limits=limits), lower=fractions([low])[0], upper=fractions([high])[0])
    witness = SimpleNamespace(fuel=fractions([fuel])[0], steps=fractions([*q] if not rate else written))
    total, first = ramps.stepped(plant, [arb(x) for x in fractions([*gained])], witness)

    def best(rest: Fraction) -> Fraction:
        values = []
        for u in itertools.product({low, Fraction(0), high}, repeat=count):
            made = [after - before for after, before in itertools.pairwise([rest, *u, Fraction(0)])]
            value = sum(g * x - fuel * step * abs(x) for g, x in zip(gained, u, strict=True)) - sum(
                x * y for x, y in zip(q, made, strict=True)
            )
            values.append(value)
        return max(values) + sum(max(x * step * side for side in rate) if rate else 0 for x in q)

    for rest in (Fraction(0), Fraction(1, 2)):
        expected = best(rest) + q[0] * rest
        assert total.overlaps(arb(*fractions([expected]))), (total, expected)
        assert float(total.rad()) < 1e-30
    assert first == arb(*fractions([q[0]]))


PIECES = 3 * 2**13  # so that edges at quarters lie between cells


def by_midpoints(
    p: Any, ramps_of: list[tuple[list[float], list[float]]], q0: float | None, horizon: float, of: dict[str, float]
) -> tuple[float, float]:
    """The right side of the inequality by sums over midpoints, from the definition in ramps.py; second order, so to some 1e-7."""
    edges = np.linspace(0, horizon, PIECES + 1)
    s, ds = (edges[1:] + edges[:-1]) / 2, horizon / PIECES
    values, price = p(s), of["fuel"]

    def cost(x: Any) -> Any:
        best = np.maximum(of["upper"] * (x - price), of["lower"] * (x + price))
        return np.maximum(best, 0.0)

    total, first, free = 0.0, 0.0, np.ones(PIECES, bool)
    for nodes, levels in ramps_of:
        inside = (s > nodes[0]) & (s < nodes[-1])
        if not inside.any():
            continue
        free &= ~inside
        level = np.array(levels)[np.clip(np.searchsorted(nodes, s[inside]) - 1, 0, len(levels) - 1)]
        slopes = values[inside] - level
        starts, open_end = nodes[0] == 0, nodes[-1] > horizon
        begin = q0 if starts and q0 is not None else -slopes.sum() * ds if starts else 0.0
        shift = 0.0 if open_end else (begin + slopes.sum() * ds) / (inside.sum() * ds)
        course = begin + np.cumsum(slopes - shift) * ds - (slopes - shift) * ds / 2
        total += (cost(level + shift).sum() + np.maximum(of["high"] * course, of["low"] * course).sum()) * ds
        first = begin if starts else first
    return total + cost(values[free]).sum() * ds, first


@pytest.mark.parametrize("price", ["0", "0.25"])
@pytest.mark.parametrize("given", [None, "-0.375"])
@pytest.mark.parametrize(
    "rows",
    [
        [],
        [([0, 0.5, 1.25], [0.5, -0.25])],
        [([0.5, 1, 1.75], [0.75, 1.5])],
        [([0, 0.5], [0.25]), ([0.75, 1.5, 2], [0.5, -0.5]), ([2.5, 2.75, 5], [-0.75, 0.125])],
        [([0, 0.25, 7], [1, -0.5])],
        [([3.5, 4], [1])],
    ],
    ids=["none", "start", "middle", "three", "all", "beyond"],
)
def test_ramps_by_quadrature(price: str, given: str | None, rows: list[Any]) -> None:
    """A wave over the origin, a real pole and a pair, ramps at the start, within the move, over its beginning, and beyond."""
    roots = (Root(acb(0), 4), Root(acb("-0.5"), 2), Root(acb("-0.25", 3), 1))
    numbers = [fmpq(1, 4), fmpq(-1, 2), fmpq(0), fmpq(0), fmpq(3, 4), fmpq(-1, 8), fmpq(1, 2), fmpq(5, 8)]
    horizon, limits = arb(3), SimpleNamespace(rate=(fmpq(-3), fmpq(2)))
    own = roots[0], roots[1], roots[2]
    chains = courses.given(own, own, [arb(x) for x in numbers])
    written = [SimpleNamespace(edges=fractions(nodes), levels=fractions(levels)) for nodes, levels in rows]
    if given is not None and not (rows and rows[0][0][0] == 0):
        given = None
    nothing = [[acb(0)] * root.multiplicity for root in own]
    pieces = list(courses.pieces(own, chains, ramps.edges(written, nothing, horizon), horizon))
    plant: Any = SimpleNamespace(lower=fmpq(-1), upper=fmpq(3, 2))
    found, first = ramps.most(
        *(SimpleNamespace(limits=limits), own, pieces, written, None if given is None else arb(given)),
        lambda wave, length, low, high: lower.support(wave, length, low, high, arb("1e-20")),
        lambda wave: lower.parts(plant, wave, fmpq(*Fraction(price).as_integer_ratio())),
    )

    def p(s: Any) -> Any:
        return 0.25 - 0.5 * s + np.exp(-s / 2) * (0.75 - s / 8) + ((0.5 + 0.625j) * np.exp((-0.25 + 3j) * s)).real

    of = {"fuel": float(price), "lower": -1.0, "upper": 1.5, "low": -3.0, "high": 2.0}
    expected, begins = by_midpoints(p, rows, None if given is None else float(given), 3.0, of)
    assert float(found.mid()) == pytest.approx(expected, abs=1e-6)
    assert float(first.mid()) == pytest.approx(begins, abs=1e-6)
    assert float(found.rad()) < 1e-15


def test_levels_and_edges() -> None:
    ramp = SimpleNamespace(edges=fractions([1, 2, 4]), levels=fractions([5, 7]))
    assert [ramps.level_at(ramp, arb(at)) for at in ("1", "1.5", "2", "3")] == [arb(5), arb(5), arb(7), arb(7)]
    kicks = ramps.edges([ramp], [[acb(0)]], arb(4))
    assert [at for at, _ in kicks] == [arb(1), arb(2)]
    with pytest.raises(Undecided):
        ramps.exact(arb(1, 0.1))
    assert ramps.exact(fmpq(1, 2)) == arb("0.5")
    with pytest.raises(Undecided):
        ramps.exact(fmpq(1, 3))


@pytest.mark.parametrize(("fuel", "expected"), [("2.4251", Outcome.PROVED), ("2.4249", Outcome.REFUTED)])
def test_the_fuel_of_a_command_of_straight_pieces(fuel: str, expected: Outcome) -> None:
    """1/s: up to 1, held, down to -1/2, held, back: areas of 0.5 + 1.5 + 0.2 above 0, of 0.05 + 0.05 + 0.125 below."""
    posed = task(["1"], ["1", "0"], "1.975", rate=["-4", "4"], fuel=fuel, limits=("-2", "2"))
    nodes = [("0", "0"), ("1", "1"), ("2.5", "1"), ("3.1", "-0.5"), ("3.2", "-0.5")]
    witness = command("3.7", nodes, [["level", 1, 0]])
    assert check(certificate(posed, upper="3.7", witnesses=(None, witness))).outcome is expected
