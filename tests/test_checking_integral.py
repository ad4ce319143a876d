"""∫σ(p) in two ways that share nothing but Arb's arithmetic: isolated sign changes and closed forms, and `acb.integral`'s quadrature."""

from __future__ import annotations

import random

import flint
import pytest
from flint import acb, arb, fmpq
from marks import first

from relaxations.checking import balls
from relaxations.checking.balls import Root, Wave
from relaxations.checking.lower import support
from relaxations.checking.reading import Undecided

HORIZON = 3


def random_wave(seed: int) -> tuple[Wave, arb, arb]:
    """One to four roots (rigid, real, flexible; stable, undamped, unstable; simple to triple), any coefficients, limits around 0."""
    rng = random.Random(seed)

    def number(low: float, high: float) -> arb:
        return arb(fmpq(round(rng.uniform(low, high) * 1024), 1024))  # exact at any precision

    roots = []
    for _ in range(rng.randint(1, 4)):
        multiplicity = rng.choice((1, 1, 2, 3))
        match rng.choice(("rigid", "real", "flexible", "undamped")):
            case "rigid" if all(not root.value.is_zero() for root in roots):
                roots.append(Root(acb(0), multiplicity))
            case "undamped":
                roots.append(Root(acb(0, number(0.5, 6.0)), multiplicity))
            case "flexible":
                roots.append(Root(acb(number(-2.0, 0.5), number(0.5, 6.0)), multiplicity))
            case _:
                roots.append(Root(acb(number(-3.0, 1.0)), multiplicity))
    limits = (arb(0) if rng.random() < 0.2 else number(-2.0, -0.1)), number(0.1, 2.0)
    return Wave.of(tuple(roots), [number(-1.0, 1.0) for root in roots for _ in range(root.size)]), *limits


def by_quadrature(p: Wave, horizon: arb, lower: arb, upper: arb) -> arb:
    """`∫ max(upper p, lower p)` by Gauss-Legendre in balls on cells without a kink; p continued as the mean of two conjugate halves."""
    coefficients = p.rows.tolist()[0]

    def integrand(s: acb, analytic: bool) -> acb:
        value, place = acb(0), 0
        for root in p.roots:
            for c, power in zip(coefficients[place:], range(root.multiplicity), strict=False):
                shape = s**power / arb(power).fac()
                value += (c * (root.value * s).exp() + c.conjugate() * (root.value.conjugate() * s).exp()) * shape / 2
            place += root.multiplicity
        return (value * upper).real_max(value * lower, analytic=analytic)

    found = acb.integral(integrand, 0, acb(horizon), rel_tol=arb("1e-12"), abs_tol=arb("1e-12"), eval_limit=300_000)
    return found.real


@pytest.mark.parametrize("seed", first(12, range(24)))
def test_the_integral_agrees_with_quadrature(seed: int) -> None:
    balls.work["left"] = 1e8
    with flint.ctx.workprec(64):
        p, lower, upper = random_wave(seed)
        found, other = support(p, arb(HORIZON), lower, upper, arb("1e-14")), by_quadrature(p, arb(HORIZON), lower, upper)
        assert found.overlaps(other)
        assert float(found.rad()) < 1e-12
        assert float(other.rad()) < 1e-6  # quadrature narrows a kink by bisection only


@pytest.mark.parametrize("seed", range(24))
def test_a_finer_integral_lies_within_a_coarser_one(seed: int) -> None:
    balls.work["left"] = 1e8
    with flint.ctx.workprec(256):
        p, lower, upper = random_wave(seed)
        exact = support(p, arb(HORIZON), lower, upper, arb("1e-40"))
    assert float(exact.rad()) < 1e-38
    for fine in ("1e-2", "1e-6", "1e-12"):
        with flint.ctx.workprec(64):
            coarse = support(p, arb(HORIZON), lower, upper, arb(fine))
        assert coarse.overlaps(exact)
        assert float(coarse.rad()) <= HORIZON * float(fine) * 1.01 + 1e-14


def test_a_costate_that_touches_zero_or_vanishes() -> None:
    """(s - 1)² and 0 have no sign changes to isolate; the integral is 1/3 · ((T-1)³ + 1) and 0."""
    balls.work["left"] = 1e8
    with flint.ctx.workprec(128):
        square = Wave.of((Root(acb(0), 3),), [fmpq(1), fmpq(-2), fmpq(2)])
        found = support(square, arb(3), arb(-1), arb(1), arb("1e-15"))
        assert found.overlaps(arb(3))
        assert float(found.rad()) < 1e-13
        nothing = support(Wave.of((Root(acb(0), 1),), [fmpq(0)]), arb(3), arb(-1), arb(1), arb("1e-15"))
        assert nothing.contains(0)
        shallow = Wave.of((Root(acb(0), 1), Root(acb(-1), 1)), [fmpq(-1, 2), fmpq(1)])  # a root at ln 2
        whole = support(shallow, arb(2), arb(-3), arb(5), arb("1e-15"))
        ln2 = arb(2).log()
        assert whole.overlaps(5 * (arb("0.5") - ln2 / 2) + 3 * (arb(2) / 2 - ln2 / 2 - arb("0.5") + (arb(-2)).exp()))


def test_a_costate_known_too_badly_is_undecided() -> None:
    balls.work["left"] = 1e8
    with flint.ctx.workprec(128), pytest.raises(Undecided):
        support(Wave.of((Root(acb(0), 1),), [arb(0, 1e-6)]), arb(3), arb(-1), arb(1), arb("1e-12"))
    with flint.ctx.workprec(128), pytest.raises(Undecided):
        support(Wave.of((Root(acb(0), 1),), [arb("nan")]), arb(3), arb(-1), arb(1), arb("1e-12"))


@pytest.mark.parametrize("seed", range(12))
def test_steps_are_the_integrals_of_impulses(seed: int) -> None:
    balls.work["left"] = 1e8
    with flint.ctx.workprec(128):
        for root in random_wave(seed)[0].roots:
            for k, value in enumerate(root.step(arb(HORIZON))):
                quadrature = acb.integral(lambda s, _, k=k, root=root: (root.value * s).exp() * s**k / arb(k).fac(), 0, HORIZON)
                assert value.overlaps(quadrature)
                assert float(value.real.rad()) + float(value.imag.rad()) < 1e-30


@pytest.mark.parametrize("seed", range(12))
def test_a_wave_over_an_interval_holds_all_its_values(seed: int) -> None:
    balls.work["left"] = 1e8
    rng = random.Random(seed)
    with flint.ctx.workprec(128):
        p = random_wave(seed)[0]
        for width in (arb("0.001"), arb("0.1"), arb(2)):
            c, value, slope, values = p.over(arb(0), width)
            assert value.overlaps(p(c)[0])
            for _ in range(20):
                at = width * arb(rng.random())
                assert values.overlaps(p(at)[0])
                assert slope.overlaps(p(at)[1])
                step = arb(2) ** -40
                assert float(abs((p(at + step)[0] - p(at)[0]) / step - p(at)[1]).mid()) < 1e-8  # row 1 is the derivative
