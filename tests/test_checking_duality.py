"""The lower side's terms one by one: what multipliers after the move ask for, cells of samples, and claims beyond either side."""

from __future__ import annotations

import random
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from flint import acb, acb_poly, arb, arb_mat, fmpq
from forgery import LIMITED, RECORDED, certificate, changed, costate, number, opened, proven_limited, system, task, written

from relaxations.checking import balls, courses, lower
from relaxations.checking.balls import Root
from relaxations.checking.claims import Outcome, check

pytestmark = pytest.mark.usefixtures("enough_work")


QUICK = ("exact", "started", "held_slope", "held_steps")
SLOW = () if RECORDED.exists() else (pytest.mark.slow,)


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else SLOW) for name in LIMITED])
def test_the_least_time_lies_between_the_sides(name: str) -> None:
    """What is claimed above the upper side, or below the lower one, is not believed; what is weaker is."""
    content = proven_limited(name)
    assert check(content).outcome is Outcome.PROVED
    claim = opened(content)["claim"]
    low, high = (number(claim[side]) for side in ("lower", "upper"))
    for side, value in (("lower", high * Fraction(1000001, 1000000)), ("upper", low * Fraction(999999, 1000000))):
        lie = changed(content, lambda data, side=side, value=value: data["claim"].update({side: written(value)}))
        assert check(lie).outcome is not Outcome.PROVED, side
    weaker = changed(content, lambda data: data["claim"].update(lower=written(low * Fraction(999, 1000))))
    assert check(weaker).outcome is Outcome.PROVED


def test_a_limit_of_the_speed_from_a_start() -> None:
    """The cart at half its speed limit of 1: half a second up, 1.125 s at the limit, one second down; it would go on by itself."""
    press = {"output": "rate", "begin": "1", "end": "2.125", "weight": "1.125"}

    def outcome(time: str, speed: str = "0.5", **change: str) -> Outcome:
        of = task(["1"], ["1", "0", "0"], "2", outputs={"rate": ["1", "0"]}, deflection={"rate": "1"}, initial_state=["0", speed])
        witness = costate((("0", "0"), [("-1", "0"), ("1", "0")]), deflection=[{**press, **change}])
        return check(certificate(of, time, witnesses=(witness, None))).outcome

    assert outcome("2.6249999") is Outcome.PROVED
    assert outcome("2.6250001") is Outcome.REFUTED
    assert outcome("2.6249999", "0.501") is not Outcome.PROVED
    assert outcome("2.6249999", weight="1.124") is not Outcome.PROVED
    assert outcome("2.6249999", weight="1.126") is not Outcome.PROVED


# (s + 3)² (s² + 2s + 5) over s² (s + 1)² (s² + 0.2s + 4)
NUMERATOR, DENOMINATOR = ["1", "8", "26", "48", "45"], ["1", "2.2", "5.4", "8.2", "4", "0", "0"]


def test_multipliers_after_the_move() -> None:
    """λᵀ column_j + Σ (μ⁺ - μ⁻) shape_j(τ) = 0 for the shapes of the input, its slope and an output; each costs its room."""
    others = {"outputs": {"sway": ["-1", "0.5"]}, "deflection": {"sway": "50"}, "rate": ["-4", "9"]}
    posed = system(task(NUMERATOR, DENOMINATOR, "2", rest="output", limits=("-7", "5"), **others))
    contacts = [
        SimpleNamespace(output=None, time=fmpq(1, 2), upper=fmpq(1, 4), lower=fmpq(0)),
        SimpleNamespace(output="sway", time=fmpq(3, 2), upper=fmpq(0), lower=fmpq(2)),
        SimpleNamespace(output="sway", time=fmpq(1), upper=fmpq(3), lower=fmpq(1, 2)),
    ]
    tail = [SimpleNamespace(time=fmpq(3, 4), upper=fmpq(1, 8), lower=fmpq(3, 8))]
    chains = [
        SimpleNamespace(near=(fmpq(0), fmpq(0)), coefficients=((fmpq(1), fmpq(0)), (fmpq(2), fmpq(0)))),
        SimpleNamespace(near=(fmpq(-1), fmpq(0)), coefficients=((fmpq(-1), fmpq(0)), (fmpq(1, 2), fmpq(0)))),
        SimpleNamespace(near=(fmpq(0), fmpq(2)), coefficients=((fmpq(1, 3), fmpq(-1, 5)),)),
    ]
    witness = SimpleNamespace(costate=[chains], tail=tail, after=contacts, steps=())
    moved, price = lower.costate(posed, witness)
    rest = 2 * fmpq(1, 2) / 45
    expected = fmpq(1, 8) * 5 + fmpq(3, 8) * 7 + fmpq(1, 4) * 9 + 2 * (50 + rest) + 3 * (50 - rest) + fmpq(1, 2) * (50 + rest)
    assert price.overlaps(arb(expected))
    assert float(price.rad()) < 1e-30

    def shape(zero: Root, power: int, unit: acb, output: str | None, time: fmpq, slope: bool = False) -> arb:
        """Re of what `unit r^l/l! e^{zr}` is at a time, or its derivative, or the output's response, by Taylor polynomials at z."""
        z, r = zero.value, arb(time)
        if output is None:
            series = acb_poly([z, 1]) if slope else acb_poly([1])
        else:
            above, below = (
                acb_poly([fmpq(*Fraction(x).as_integer_ratio()) for x in reversed(side)]) for side in (["-1", "0.5"], DENOMINATOR)
            )
            above, below = above(acb_poly([z, 1])), below(acb_poly([z, 1]))
            first = above[0] / below[0]
            series = acb_poly([first, (above[1] - first * below[1]) / below[0]])
        powers = [r ** (power - i) / arb(power - i).fac() if power >= i else arb(0) for i in (0, 1)]
        return (unit * (z * r).exp() * sum((series[i] * powers[i] for i in (0, 1)), acb(0))).real

    columns, place = posed.columns.transpose().tolist(), 0
    for zero in posed.zeros:
        for power in range(zero.multiplicity):
            for unit in (acb(1), acb(0, 1))[: 1 + zero.flexible]:
                total = sum((x * y for x, y in zip(columns[place], moved.entries(), strict=True)), arb(0))
                for contact in tail:
                    total += (contact.upper - contact.lower) * shape(zero, power, unit, None, contact.time)
                for contact in contacts:
                    total += (contact.upper - contact.lower) * shape(
                        zero, power, unit, contact.output, contact.time, slope=contact.output is None
                    )
                assert total.contains(0)
                assert float(total.rad()) < 1e-30
                place += 1
    assert place == 4
    # the least change that does it: along the columns, so nothing along what is orthogonal to them all
    change = moved - arb_mat(moved.nrows(), 1, balls.placed(posed.roots, chains)[0])
    gram = posed.columns.transpose() * posed.columns
    along = posed.columns * gram.solve(posed.columns.transpose() * change)
    assert all(x.overlaps(y) for x, y in zip(along.entries(), change.entries(), strict=True))


@pytest.mark.parametrize("seed", range(6))
def test_cells_of_samples(seed: int) -> None:
    """Integrals over cells that do not begin where pieces do, against quadrature piece by piece."""
    rng = random.Random(seed)
    roots = (Root(acb(0), 3), Root(acb("-0.5"), 1), Root(acb("-0.25", 3), 1))

    def chains() -> list[list[acb]]:
        rows = [
            [acb(rng.randint(-8, 8) / 8, rng.randint(-8, 8) / 8 if root.flexible else 0) for _ in range(root.multiplicity)]
            for root in roots
        ]
        rows[0][-1] = acb(0)
        return rows

    start, kicks = chains(), sorted(((fmpq(rng.randint(1, 30), 16), chains()) for _ in range(4)), key=lambda kick: kick[0])
    step, count = fmpq(1, 5), 10
    found = lower.sampled(roots, list(courses.pieces(roots, start, kicks, count * step)), count, step)
    assert len(found) == count

    def integrand(parts: list[list[acb]], origin: fmpq) -> Any:
        def f(s: acb, _: bool) -> acb:
            r, total = s - acb(origin), acb(0)
            for root, chain in zip(roots, parts, strict=True):
                for k, c in enumerate(chain):
                    total += (c * (root.value * r).exp() + c.conjugate() * (root.value.conjugate() * r).exp()) * r**k / arb(k).fac() / 2
            return total

        return f

    for i, cell in enumerate(found):
        a, b = i * step, (i + 1) * step
        expected = acb.integral(integrand(start, fmpq(0)), acb(a), acb(b)).real
        for at, added in kicks:
            if at < b:
                expected += acb.integral(integrand(added, at), acb(max(a, at)), acb(b)).real
        assert cell.overlaps(expected)
        assert float(cell.rad()) < 1e-30
