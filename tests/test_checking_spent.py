"""Too little fuel: the checker's bounds on `∫ |u| dt`, against closed forms and the largest value of a costate that NumPy sees."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import flint
import numpy as np
import pytest
from flint import acb, arb, arb_mat, fmpq
from forgery import certificate, costate, system, task

from relaxations.checking import balls, spent
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Undecided

NEAR = "1/1" + "0" * 100  # told from 0 with 512 bits, not with 128


pytestmark = pytest.mark.usefixtures("enough_work")


def started(denominator: list[str], start: list[str], displacement: str = "0", **others: Any) -> dict[str, Any]:
    return task(["1"], denominator, displacement, initial_state=start, **others)


def polynomial(*factors: list[Any]) -> list[str]:
    """The product of polynomials, as a task writes it."""
    product = [Fraction(1)]
    for factor in factors:
        terms = [
            [Fraction(0)] * i + [a * Fraction(b) for b in factor] + [Fraction(0)] * (len(product) - 1 - i) for i, a in enumerate(product)
        ]
        product = [sum(column, Fraction(0)) for column in zip(*terms, strict=True)]
    return [str(c) for c in product]


# By one pole. The plant is D(d/dt) x = u; a pole p asks for |m| = |Σ q_i x^(i)|, D/(s - p) = Σ q_i s^i.
ASKED = {
    "an unstable pole": (started(["1", "-2"], ["3"]), 3),  # x' = 2x + u: m = x
    "a mode": (started(["1", "0", "1"], ["3", "4"]), 5),  # ∫ e^{-it} u dt = -(x' + ix)
    "a faster mode": (started(["1", "0", "4"], ["2", "3"]), 5),  # x' + 2ix
    "an unstable mode": (started(["1", "-2", "2"], ["1", "-3"]), Fraction(412310562, 10**8)),  # x' - 2x + (1 + i) x, of modulus √17
    "an integrator": (started(["1", "0"], ["1/2"], "2"), Fraction(3, 2)),
    "an integrator that goes back": (started(["1", "0"], ["2"], "1/2"), Fraction(3, 2)),
    "a mass that moves": (started(["1", "0", "0"], ["7", "-3"]), 3),
    "a mode beside an integrator": (started(["1", "0", "1", "0"], ["-12", "5", "12"]), 13),  # x'' + x = 0, x'' + ix'
    "an integrator beside a mode": (started(["1", "0", "1", "0"], ["-14", "0", "1"], "0"), 13),
    "two modes": (started(["1", "0", "5", "0", "4"], ["0", "0", "0", "2"]), 2),  # each asks for |x'''|
    "a mode beside a double pole": (started(polynomial([1, 1], [1, 1], [1, 0, 1]), ["3", "0", "0", "4"]), 5),  # (s + 1)² (s + i)
}


@pytest.mark.parametrize("name", ASKED)
def test_what_a_pole_asks_for(name: str) -> None:
    of, asked = ASKED[name]
    for share, outcome in ((Fraction(10**6 - 1, 10**6), Outcome.PROVED), (Fraction(10**6 + 1, 10**6), Outcome.INCONCLUSIVE)):
        limits = {**of["limits"], "fuel": str(asked * share)}
        assert check(certificate({**of, "limits": limits}, impossible="fuel")).outcome is outcome


@pytest.mark.parametrize(
    "of",
    [
        started(["1", "2"], ["9"], fuel="1/10"),  # it decays by itself
        started(["1", "2", "2"], ["9", "9"], fuel="1/10"),
        started(polynomial([1, 0, 1], [1, 1]), ["1", "-1", "1"], fuel="1/10"),  # e^{-t} alone, which the mode has no part in
    ],
)
def test_poles_that_decay_ask_for_nothing(of: dict[str, Any]) -> None:
    assert check(certificate(of, impossible="fuel")).outcome is Outcome.INCONCLUSIVE


def test_a_plant_that_rests_with_an_input_asks_for_nothing_without_it() -> None:
    """With a rest input a moment is not what is left of it: x'' + x = u from (3, 4) to a rest at u = 1."""
    posed = system(started(["1", "0", "1"], ["3", "4"], "1", limits=("-9", "9")))
    assert posed.rest == 1
    assert not spent.by_pole(posed, fmpq(1, 100))
    assert spent.by_pole(system(started(["1", "0", "1"], ["3", "4"])), fmpq(1, 100))


# Which poles do not decay.


@pytest.mark.parametrize(
    ("factors", "kept"),
    [
        (([1, 0], [1, 1], [1, -3]), [0, 3]),
        (([1, 0, 1], [1, 2, 2], [1, -1, 4], [1, "1/2"]), [1j, 0.5 + 1.9364916731037085j]),
        (([1, "-1/2"], [1, "1/2"]), [0.5]),
        (([1, 0, 1], [1, 0, 4]), [1j, 2j]),
        (([1, 0, 4], [1, 3]), [2j]),
        (([1, 3], [1, 2]), []),
        (([1, 0, 0],), [0]),
    ],
)
def test_the_poles_that_do_not_decay(factors: tuple[list[Any], ...], kept: list[complex]) -> None:
    found = spent.lasting(system(started(polynomial(*factors), ["1"] * (sum(len(f) - 1 for f in factors)))))
    values = sorted((complex(root.value.mid()) for root in found), key=abs)
    assert values == pytest.approx(sorted(kept, key=abs), abs=1e-15)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("others", [(), ([1, 0, 4],), ([1, 0],)])
def test_a_pole_beside_the_axis_is_undecided_first(side: int, others: tuple[list[Any], ...]) -> None:
    small = side * Fraction(NEAR)
    denominator = polynomial([1, 2 * small, 1 + small**2], *others)
    start = ["1"] * (len(denominator) - 1)
    with pytest.raises(Undecided, match="imaginary axis"):
        spent.lasting(system(started(denominator, start)))
    with flint.ctx.workprec(512):
        stay = spent.lasting(system(started(denominator, start), 512))
    assert any(abs(complex(root.value.mid()) - 1j) < 1e-9 for root in stay) == (side < 0)
    assert len(stay) == len(others) + (side < 0)


# By a costate: of plants with a zero, whose tail has a price.


SLOW = task(["1", "1"], ["1", "0"], "1", rest="output", limits=("-1/4", "1/4"))
"""y' = u' + u: ∫ u over the move and its tail is 1, and the tail c e^{-r}, |c| ≤ 1/4, brings 1/4 of that at most."""
AT_ONCE = {"time": "0", "upper": "1", "lower": "0"}


def by_costate(fuel: str | None, *, near: str = "1", price: str = "1", contact: Any = AT_ONCE, of: Any = SLOW, **others: Any) -> Outcome:
    posed = {**of, "limits": {**of["limits"], "fuel": fuel}}
    witness = costate((("0", "0"), [(near, "0")]), tail=[contact] if contact else [], fuel=price, **others)
    return check(certificate(posed, impossible="fuel", witnesses=(witness, None))).outcome


def test_what_a_costate_asks_for() -> None:
    assert by_costate("0.749999") is Outcome.PROVED
    assert by_costate("0.750001") is Outcome.INCONCLUSIVE
    assert by_costate("3/4") is Outcome.INCONCLUSIVE  # gain and price are the same
    assert by_costate("0.749999", price="0.9999") is Outcome.INCONCLUSIVE  # p = 1 is more than that
    assert by_costate("0.73", price="1.01") is Outcome.PROVED
    assert by_costate("0.749999", near="2", price="2", contact={**AT_ONCE, "upper": "2"}) is Outcome.PROVED
    assert by_costate("0.749999", near="-1", contact={**AT_ONCE, "upper": "0", "lower": "1"}) is Outcome.INCONCLUSIVE
    assert by_costate(None, price="0") is Outcome.INCONCLUSIVE
    assert by_costate("0.749999", price="0") is Outcome.INCONCLUSIVE


def test_a_costate_of_other_limits_says_nothing_of_fuel() -> None:
    sampled = task(["1"], ["1", "0"], "1", limits=("-1/4", "1/4"), rate=["-9", "9"], sample_time="1/4")
    assert by_costate("0.9", contact=None, of=sampled, steps=["0"]) is Outcome.PROVED  # by its pole, whatever the witness
    sloping = {**SLOW, "limits": {**SLOW["limits"], "rate": ["-9", "9"]}}
    assert by_costate("0.749999", of=sloping) is Outcome.PROVED
    ramp = {"edges": ["0", "1"], "levels": ["0"]}
    assert by_costate("0.749999", of=sloping, ramps=[ramp]) is Outcome.INCONCLUSIVE
    posed = system({**sloping, "limits": {**sloping["limits"], "fuel": "3/4"}})
    moved = {"numbers": arb_mat(1, 1, [1]), "price": arb(0)}
    for fields, outcome in (
        ({}, True),
        ({"fuel": fmpq(0)}, False),
        ({"steps": (fmpq(1),)}, False),
        ({"ramps": (ramp,)}, False),
    ):
        witness = SimpleNamespace(**{"fuel": fmpq(1), "steps": (), "ramps": (), **fields})
        found = spent.too_little(
            posed, witness, lambda *of, witness=witness: (moved["numbers"], moved["price"]) if of == (posed, witness) else None
        )
        assert found is outcome
    assert spent.too_little(posed, None, None) is False


def test_a_costate_counts_what_the_start_has_done_already() -> None:
    """1/s from m to 1 takes 1 - m of fuel."""
    asked = {"numbers": arb_mat(1, 1, [1]), "price": arb(0), "limit": fmpq(1)}
    assert spent.by_costate(system(task(["1"], ["1", "0"], "1", fuel="1/2")), **asked)
    for begun in ("0", "2/5", "49/100"):
        assert spent.by_costate(system(started(["1", "0"], [begun], "1", fuel="1/2")), **asked)
    for begun in ("1/2", "3/5"):
        with pytest.raises(Undecided, match="what the start asks for less"):
            spent.by_costate(system(started(["1", "0"], [begun], "1", fuel="1/2")), **asked)
    dear = {**asked, "price": arb("0.4999")}
    assert spent.by_costate(system(task(["1"], ["1", "0"], "1", fuel="1/2")), **dear)
    assert not spent.by_costate(system(task(["1"], ["1", "0"], "1", fuel="1/2")), **{**asked, "price": arb("0.5001")})


@pytest.mark.parametrize(
    ("denominator", "numbers"),
    [
        (["1", "0", "0"], [0, 1]),  # p = s
        (polynomial([1, 0], [1, 0, 1], [1, 0, 1]), [1, 0, 0, "1/1000", 0]),
        (polynomial([1, 0], [1, "-1/2"]), [-1, "1/1000"]),
        (polynomial([1, 0], [1, "-1/2", 1]), [1, "1/1000", 0]),
    ],
)
def test_a_costate_that_may_grow_says_nothing(denominator: list[str], numbers: list[Any]) -> None:
    posed = system(task(["1"], denominator, "1", fuel="1/10000000"))
    with pytest.raises(Undecided, match="grow with the time to go"):
        spent.by_costate(
            posed, arb_mat(len(numbers), 1, [arb(Fraction(x).numerator) / Fraction(x).denominator for x in numbers]), arb(0), fmpq(10**6)
        )


def test_a_pole_that_grows_is_nothing_to_a_costate_without_it() -> None:
    posed = system(task(["1"], polynomial([1, 0], [1, "-1/2", 1]), "1", fuel="1/10000000"))
    assert spent.by_costate(posed, arb_mat(3, 1, [1, 0, 0]), arb(0), fmpq(10**6))


def test_a_costate_may_be_largest_late() -> None:
    """p = s (e^{-s/16} - e^{-s/15}) is 0.32 at s = 16, where both its terms begin to fall, and 0.5 at about 31."""
    roots = tuple(balls.Root(acb(-arb(1) / n), 2) for n in (16, 15))
    s = np.linspace(0, 400, 400_001)
    largest = float(np.max(s * (np.exp(-s / 16) - np.exp(-s / 15))))
    numbers, target = arb_mat(4, 1, [0, 1, 0, -1]), arb_mat(4, 1, [0, 1, 0, 0])
    task_of = SimpleNamespace(limits=SimpleNamespace(fuel=fmpq(1, 10**6)), plants=())
    posed: Any = SimpleNamespace(task=task_of, roots=roots, target=target, begin=())

    def asks(limit: float) -> bool:
        exact = Fraction(limit)
        return spent.by_costate(posed, numbers, arb(0), fmpq(exact.numerator, exact.denominator))

    assert 0.4 < largest < 0.6
    assert asks(largest * 1.0001)
    with pytest.raises(Undecided, match="not told from the price"):
        asks(largest * 0.9)


# p of random coefficients: origin, a mode that stays, one that decays, double and triple poles.
MIXED = polynomial([1, 0], [1, 0, 9], [1, "1/5", 4], [1, 1], [1, 1], [1, 1])
DECAYING = polynomial([1, "1/5", 4], [1, "1/5", 4], [1, "1/2"], [1, "1/2"])
STAYING = polynomial([1, 0], [1, 0, 1], [1, 0, 4])


def seen(posed: balls.System, numbers: list[float]) -> tuple[float, float]:
    """The largest |p(s)| on a fine grid, and the sum of what does not decay."""
    s, rest, last = np.linspace(0, 300, 300_001), iter(numbers), 0.0
    total = np.zeros_like(s)
    for root in posed.roots:
        pole = complex(root.value.mid())
        for k in range(root.multiplicity):
            c = complex(next(rest), next(rest) if root.flexible else 0)
            total += (c * s**k / [1, 1, 2, 6][k] * np.exp(pole * s)).real
            last += abs(c) if pole.real > -1e-9 else 0.0
    return float(abs(total).max()), last


@pytest.mark.parametrize(("denominator", "seed"), [(of, seed) for of in (MIXED, DECAYING, STAYING) for seed in range(3)])
def test_a_costate_is_nowhere_larger_than_the_price(denominator: list[str], seed: int) -> None:
    rng = np.random.default_rng([90, seed])
    plain = denominator is DECAYING  # it rests without input only where the displacement is 0: the target is made up
    posed = system(task(["1"], denominator, "1", fuel=None, limits=("-9", "9")))
    size = posed.target.nrows()
    numbers = [round(float(x), 3) for x in rng.uniform(-1, 1, size)]
    largest, last = seen(posed, numbers)
    bound = max(largest, last)
    column = arb_mat(size, 1, [arb(str(x)) for x in numbers])
    gain = sum((a * b for a, b in zip(column.entries(), posed.target.entries(), strict=True)), arb(0))

    def asks(limit: float, share: float = 0.999) -> bool:
        """With a budget that makes the costate's gain a hair more or less than its price."""
        fuel = Fraction(share * abs(float(gain)) / limit)
        limits = SimpleNamespace(fuel=fmpq(fuel.numerator, fuel.denominator))
        other: Any = SimpleNamespace(
            task=SimpleNamespace(limits=limits, plants=posed.task.plants),
            roots=posed.roots,
            target=posed.target * (1 if gain > 0 else -1),
            begin=(),
        )
        exact = Fraction(limit)
        return spent.by_costate(other, column, arb(0), fmpq(exact.numerator, exact.denominator))

    assert plain or abs(last - 0) > 0
    assert asks(bound * 1.001)
    assert not asks(bound * 1.001, 1.001)
    with pytest.raises(Undecided, match="the costate is not told from the price"):
        asks(bound * 0.999)
    with pytest.raises(Undecided):
        asks(bound / 4)
