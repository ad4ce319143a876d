"""What plants of a box do after a command, enclosed over cells: against roots, weights and sums in doubles at places all over them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import flint
import numpy as np
import pytest
from flint import acb, acb_series, arb, fmpq
from forgery import task

from relaxations.checking.balls import work
from relaxations.checking.families import Moved, family
from relaxations.checking.members import laid
from relaxations.checking.motions import Around, Kicks, highest, in_time
from relaxations.checking.reading import TASK, Undecided, shaped

Polynomial = list[list[Any]]
NEAR = 1e-9  # doubles of roots and exponentials of some seconds


def constant(*coefficients: str, count: int) -> list[Polynomial]:
    return [[[c, [0] * count]] if c != "0" else [] for c in coefficients]


def boxed(of: dict[str, Any], parameters: list[tuple[str, str | None, str, str]], **form: Any) -> dict[str, Any]:
    """A task with a box: names, nominal, lowest and highest values."""
    named = [dict(zip(("name", "nominal", "low", "high"), one, strict=True)) for one in parameters]
    own = {"numerator": [], "denominator": [], "outputs": {}, "plants": [], **form}
    return {**of, "box": {"parameters": named, **own, "tolerance": "1", "final_tolerance": None}}


# (s² + (0.2 + b) s + 2 + a)(s + 1) s over 1 + a/2 + s/4, a within 0.2, b within 0.1.
LIVELY = boxed(
    task(["0.25", "1"], ["1", "1.2", "2.2", "2", "0"]),
    [("a", "0", "-0.2", "0.2"), ("b", "0", "-0.1", "0.1")],
    numerator=[[["0.25", [0, 0]]], [["1", [0, 0]], ["0.5", [1, 0]]]],
    denominator=[
        [["1", [0, 0]]],
        [["1.2", [0, 0]], ["1", [0, 1]]],
        [["2.2", [0, 0]], ["1", [1, 0]], ["1", [0, 1]]],
        [["2", [0, 0]], ["1", [1, 0]]],
        [],
    ],
)
# An undamped mode and a body: the poles stay on the axis.
UNDAMPED = boxed(
    task(["1"], ["1", "0", "2", "0", "0"]),
    [("a", "0", "-0.3", "0.3")],
    numerator=constant("1", count=1),
    denominator=[[["1", [0]]], [], [["2", [0]], ["1", [1]]], [], []],
)
# Roots that are moved: two modes, a real pole that is not, a zero.
TWO_MODES = boxed(
    task(["1", "3"], ["1", "1.4", "5.24", "2.9", "4.4", "0.8"]),
    [("mode[1].frequency", "1", "0.9", "1.1"), ("mode[2].damping", None, "0.05", "0.15"), ("zero[1]", "1", "0.8", "1.2")],
)
ONE_MODE = boxed(task(["1"], ["1", "0.2", "4", "0"]), [("mode[1].frequency", "1", "0.8", "1.25"), ("mode[1].damping", None, "0", "0.1")])
TASKS = {"written": LIVELY, "undamped": UNDAMPED, "two modes moved": TWO_MODES, "a mode moved in both ways": ONE_MODE}


@contextmanager
def posed(of: dict[str, Any]) -> Iterator[Any]:
    before, flint.ctx.prec, flint.ctx.cap, work["left"] = (flint.ctx.prec, flint.ctx.cap), 128, 4, 1e12
    try:
        yield shaped(of, TASK, "task")
    finally:
        flint.ctx.prec, flint.ctx.cap = before


def plant_at(own: Any, place: list[float]) -> tuple[Any, Any]:
    """Numerator and denominator of the plant at a place, in doubles."""
    box, (plant,) = own.box, own.plants
    if box.denominator:

        def valued(which: Any) -> Any:
            return np.array(
                [sum(float(c) * np.prod([x**k for x, k in zip(place, powers, strict=True)]) for c, powers in one) for one in which]
            )

        return valued(box.numerator), valued(box.denominator)
    above, below = (np.array([float(c) for c in which]) for which in (plant.numerator, plant.denominator))
    poles, zeros = np.roots(below), np.roots(above)
    gain = above[-1] / below[np.flatnonzero(below)[-1]]
    modes = sorted((p for p in poles if p.imag > 1e-9), key=abs)
    ordered = sorted((z for z in zeros if z.imag >= -1e-9), key=abs)
    for parameter, x in zip(box.parameters, place, strict=True):
        root, _, what = parameter.name.partition(".")
        at = int(root[root.index("[") + 1 : -1]) - 1
        if root.startswith("zero"):
            ordered[at] = ordered[at] * x
        elif what == "frequency":
            modes[at] = modes[at] * x
        else:
            modes[at] = abs(modes[at]) * complex(-x, np.sqrt(1 - x * x))
    own_poles = [*modes, *(p.conjugate() for p in modes), *(p for p in poles if abs(p.imag) <= 1e-9)]
    own_zeros = [*ordered, *(z.conjugate() for z in ordered if z.imag > 1e-9)]
    above, below = (np.atleast_1d(np.real(np.poly(roots))) for roots in (own_zeros, own_poles))
    below[np.abs(below) < 1e-12] = 0.0
    return above * gain * below[np.flatnonzero(below)[-1]] / above[-1], below


def motions_at(own: Any, place: list[float], jumps: list[tuple[float, float]], order: int, count: int) -> list[tuple[complex, complex]]:
    """Poles with Im ≥ 0 beside the origin and their motions, the nearest to 0 first."""
    above, below = plant_at(own, place)
    found = []
    for p in np.roots(below):
        if abs(p) > 1e-9 and p.imag > -1e-9:
            weight = np.polyval(above, p) / np.polyval(np.polyder(below), p) * (2 if p.imag > 1e-9 else 1)
            found.append((p, weight * sum(jump * np.exp(p * s) for s, jump in jumps) / p**order))
    assert len(found) == count
    return sorted(found, key=lambda one: (round(abs(one[0]), 9), one[0].imag))


def cells(rng: random.Random, own: Any, share: Fraction) -> tuple[tuple[fmpq, fmpq], ...]:
    """A cell somewhere in the box, so wide as a share of each range."""
    sides = []
    for p in own.box.parameters:
        low, high = Fraction(str(p.low)), Fraction(str(p.high))
        begin = low + (high - low) * (1 - share) * Fraction(rng.randint(0, 8), 8)
        ends = (begin, begin + (high - low) * share)
        sides.append(tuple(fmpq(x.numerator, x.denominator) for x in ends))
    return tuple(sides)


def places(rng: random.Random, sides: Any, count: int = 12) -> list[list[float]]:
    """Places of a cell, corners among them."""
    return [
        [
            float(Fraction(str(low)) + Fraction(rng.choice([0, 0, 16, 16, rng.randint(0, 16)]), 16) * Fraction(str(high - low)))
            for low, high in sides
        ]
        for _ in range(count)
    ]


def drawn(rng: random.Random, order: int) -> tuple[Kicks, list[tuple[float, float]]]:
    """Kicks that add up to 0, the last one at the end of the move."""
    instants = [Fraction(k, 4) for k in sorted(rng.sample(range(1, 17), 3), reverse=True)] + [Fraction(0)]
    sizes = [Fraction(rng.choice([-4, -3, -2, 2, 3, 4]), 4) for _ in instants[1:]]
    sizes.append(-sum(sizes, Fraction(0)))
    exact = [(arb(fmpq(s.numerator, s.denominator)), arb(fmpq(x.numerator, x.denominator))) for s, x in zip(instants, sizes, strict=True)]
    return Kicks(exact, order), [(float(s), float(x)) for s, x in zip(instants, sizes, strict=True)]


def enclosed(of: str, seed: int, share: Fraction, order: int) -> Iterator[tuple[Any, Any, Any, Around, Any, Any]]:
    rng = random.Random(f"{of} {seed} {order}")
    with posed(TASKS[of]) as own:
        plants, (kicks, jumps) = family(own), drawn(rng, order)
        sides = cells(rng, own, share)
        cell, centre, radii = laid(sides)
        poles = plants.tracked(cell, centre)
        assert poles is not None
        yield own, sides, jumps, Around.of(plants, kicks, cell, centre, radii, poles), poles[2], rng


@pytest.mark.parametrize("of", TASKS)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_motions_of_a_cell_hold_those_of_all_its_plants(of: str, order: int, seed: int) -> None:
    """Poles in their balls; the sum of moduli and each; how far a residual is from that at the centre, at instants of a span."""
    for own, sides, jumps, around, flexible, rng in enclosed(of, seed, Fraction(1, 10), order):
        count = len(flexible)
        bound, each = around.moduli()
        centre = [float(Fraction(str((low + high) / 2))) for low, high in sides]
        middle = motions_at(own, centre, jumps, order, count)

        starts = [complex(pole[0]) for pole in around.middle.poles]

        def alike(one: Any, starts: list[complex] = starts) -> list[int]:
            """Which of the checker's poles each is: the nearest at the centre."""
            return [int(np.argmin(np.abs(np.array(starts) - p))) for p, _ in one]

        order_of = alike(middle)
        assert sorted(order_of) == list(range(count))
        for (p, z), j in zip(middle, order_of, strict=True):
            assert abs(complex(around.middle.poles[j][0]) - p) < NEAR
            assert abs(complex(around.middle.sizes[j][0]) - z) < NEAR
        spans, largest = [(Fraction(rng.randint(0, 20), 4), Fraction(1, rng.choice([4, 40]))) for _ in range(3)], 0.0
        for place in places(rng, sides):
            here = motions_at(own, place, jumps, order, count)
            assert sum(abs(z) for _, z in here) <= float(bound.upper()) + NEAR
            largest = max(largest, sum(abs(z) for _, z in here))
            for (p, z), j in zip(here, alike(here), strict=True):
                assert around.whole.poles[j][0].contains(acb(p.real, p.imag)) or abs(acb(p) - around.whole.poles[j][0]) < NEAR
                assert abs(z) <= float(each[j].upper()) + NEAR
            for begin, length in spans:
                span = arb(fmpq(begin.numerator, begin.denominator)).union(
                    arb(fmpq((begin + length).numerator, (begin + length).denominator))
                )
                down, up = (float(side.upper()) for side in around.drift(span))
                for t in (begin, begin + length / 2, begin + length):
                    now, then = (sum((z * np.exp(p * float(t))).real for p, z in one) for one in (here, middle))
                    assert -down - NEAR <= now - then <= up + NEAR
        assert float(bound.lower()) <= largest * 1.2 + 0.01  # no more than its second order beyond


@pytest.mark.parametrize("seed", range(30))
def test_a_quadratic_is_taken_where_it_is_largest(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(20):
        slope, bend, wide = Fraction(rng.randint(0, 8), 4), Fraction(rng.randint(-8, 8), 4), Fraction(rng.choice([0, 0, 1]), 8)
        b, c = (arb(fmpq(x.numerator, x.denominator), float(wide)) for x in (slope, bend))
        high, most = (
            float(highest(b, c).upper()),
            max((slope + wide) * t + (bend + wide) * t * t for t in (Fraction(k, 240) for k in range(241))),
        )
        assert float(most) <= high + 1e-12
        assert high <= float(most) + 1e-3  # between two of these instants


@pytest.mark.parametrize("of", TASKS)
@pytest.mark.parametrize("seed", range(3))
def test_a_small_cell_is_bounded_closely(of: str, seed: int) -> None:
    for own, sides, jumps, around, flexible, rng in enclosed(of, seed, Fraction(1, 200), 1):
        bound, each = around.moduli()
        found = [motions_at(own, place, jumps, 1, len(flexible)) for place in places(rng, sides, 30)]
        largest = max(sum(abs(z) for _, z in one) for one in found)
        assert largest - NEAR <= float(bound.upper()) <= largest * 1.01 + 1e-4
        assert sum(float(x.upper()) for x in each) <= largest * 1.05 + 1e-3
        bends = around.bends()
        assert len(bends) == len(sides)
        assert all(x >= 0 for x in bends)
        moved = [max(one) - min(one) for one in zip(*([abs(z) for _, z in each] for each in found), strict=True)]
        assert max(moved) < 1 or bound > 0


@pytest.mark.parametrize("of", TASKS)
@pytest.mark.parametrize("seed", range(2))
def test_a_residual_is_followed_in_time(of: str, seed: int) -> None:
    """Where its limits are a little beyond what plants of the cell do it is within them; where they are less it is not."""
    for own, sides, jumps, around, flexible, rng in enclosed(of, seed, Fraction(1, 60), 1):
        lasting = not all(p[0].real < 0 for p in around.whole.poles)
        instants = np.linspace(0.0, 40.0, 4001)
        courses = []
        for place in places(rng, sides, 8):
            here = motions_at(own, place, jumps, 1, len(flexible))
            courses.append(sum((z * np.exp(p * instants)).real for p, z in here))
        most, least = max(one.max() for one in courses), min(one.min() for one in courses)
        _, each = around.moduli()
        wide = 1.15 * max(most, -least, 1e-3) + 0.01
        fine = in_time(around, each, flexible, arb(wide), arb(wide))
        assert fine is True or (lasting and fine is False)
        for below, above in ((wide, most * 0.9), (-least * 0.9, wide)):
            if min(below, above) > 0.01:
                assert in_time(around, each, flexible, arb(below), arb(above)) is not True


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("radius", [0.0, 1e-5, 1e-2, 0.1])
@pytest.mark.parametrize("pole", [complex(-0.3, 2.0), complex(0.0, 1.0), complex(-1.5, 0.0)])
def test_kicks_over_a_ball_of_poles(order: int, radius: float, pole: complex) -> None:
    """Value and derivatives by the pole, at poles of the ball, by a contour integral."""
    rng = random.Random(f"{order} {radius} {pole}")
    with posed(UNDAMPED):
        kicks, jumps = drawn(rng, order)
        ball = acb(arb(pole.real, radius), arb(pole.imag, radius) if pole.imag else 0)
        found = kicks.shaken(acb_series([ball, 1]))

        def plain(p: complex) -> complex:
            return sum(x * np.exp(p * s) for s, x in jumps) / p**order

        turns = np.exp(2j * np.pi * np.arange(64) / 64)
        for at in [
            pole,
            *(pole + complex(radius * rng.choice([-1, 1]), radius * rng.choice([-1, 0, 1]) if pole.imag else 0.0) for _ in range(6)),
        ]:
            around = np.array([plain(at + 0.3 * turn) for turn in turns])
            for k in range(4):
                derivative = complex((around * turns**-k).mean() / 0.3**k)
                gap = found[k] - acb(derivative)
                assert abs(complex(gap)) <= float(arb(found[k].real.rad()) + arb(found[k].imag.rad())) * 1.5 + 1e-8
                rough = max(abs(around)) * 4**k
                assert float(found[k].real.rad()) <= 60 * radius * rough + 1e-20


@pytest.mark.parametrize("sloped", [False, True])
def test_kicks_of_a_command(sloped: bool) -> None:
    """Of jumps the last one leads to the final rest; of slopes all of them add up to 0."""
    system: Any = SimpleNamespace(sloped=sloped, rest=fmpq(1, 2))
    levels = [fmpq(0), fmpq(2), fmpq(-1)] if sloped else [fmpq(1), fmpq(2), fmpq(-1)]
    kicks = Kicks.of(system, [fmpq(7), fmpq(0), fmpq(1), fmpq(3), *levels], 3)
    assert kicks.order == 1 + sloped
    assert [s for s, _ in kicks.jumps] == [7, 6, 4, 0]
    nodes = [*levels, fmpq(1, 2)]
    if sloped:
        slopes = [(b - a) / t for (a, b), t in zip(pairwise(nodes), (1, 2, 4), strict=True)]
        assert all(
            (jump - arb(x)).contains(0)
            for (_, jump), x in zip(kicks.jumps, [slopes[0], *(b - a for a, b in pairwise(slopes)), -slopes[-1]], strict=True)
        )
    else:
        assert [jump for _, jump in kicks.jumps] == [1, 1, -3, fmpq(3, 2)]


def test_a_repeated_pole_has_no_weight() -> None:
    with posed(boxed(task(["1"], ["1", "2", "1", "0"]), [("zero[1]", "1", "1", "1")])) as own, pytest.raises(Exception, match="no zero"):
        family(own)
    twice = boxed(task(["1"], ["1", "0", "2", "0", "1", "0"]), [("mode[1].frequency", "1", "0.9", "1.1")])
    with posed(twice) as own:
        plants = family(own)
        assert isinstance(plants, Moved)
        with pytest.raises(Undecided, match="repeated"):
            plants.roots([fmpq(1)])
