"""Boxes of three parameters: the checker's enclosures over wide cells, and the bracket that they prove."""

from __future__ import annotations

import functools
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import pytest
from box_tasks import axis, forged, robust
from flint import acb, acb_series, arb, fmpq
from problems import chain

from relaxations import certificates
from relaxations.bounds import Bound, Status
from relaxations.checking.balls import work
from relaxations.checking.claims import MOST_WORK, TERMS, Outcome, check
from relaxations.checking.families import Met, family
from relaxations.checking.members import laid
from relaxations.checking.motions import Around, Kicks, highest
from relaxations.checking.reading import TASK, shaped
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, precision
from relaxations.proofs import minimum_time
from relaxations.robust import moved
from relaxations.robust.boxes import Box
from relaxations.robust.worst import worst_residual

JUMPS = [(7.0, 1.0), (5.5, -2.0), (3.7, 2.0), (1.1, -2.0), (0.0, 1.0)]  # time to go, height


@pytest.fixture(autouse=True)
def series():
    before, left = flint.ctx.cap, work["left"]
    flint.ctx.cap, work["left"] = TERMS, 1e7
    yield
    flint.ctx.cap, work["left"] = before, left


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("damped", [0.0, -0.2])
@pytest.mark.parametrize("width", [1e-6, 0.01, 0.1, 0.4])
def test_what_kicks_leave_is_enclosed_over_a_wide_ball_of_poles(order: int, damped: float, width: float) -> None:
    """Value and three derivatives at places of the ball, by sums; and nothing is given away that jumps take from each other."""
    with precision(128):
        kicks = Kicks([(arb(s), arb(jump)) for s, jump in JUMPS], order)
        ball = acb(arb(damped, width / 4 if damped else 0.0), arb(1.3, width))
        found = kicks.shaken(acb_series([ball, acb(0, 1), acb("0.5", "0.25")]))
        rng = np.random.default_rng(3)
        spread = 0.0
        for share, other in rng.uniform(-1, 1, (40, 2)):
            pole = acb(damped + (share * width / 4 if damped else 0.0), arb(1.3) + other * width)
            alone = acb_series([pole, acb(0, 1), acb("0.5", "0.25")])
            exact = sum(((alone * arb(s)).exp() * arb(jump) for s, jump in JUMPS), acb_series([0])) / alone**order
            assert all(found[k].contains(exact[k].mid()) for k in range(TERMS))
            spread = max(spread, float(abs(exact[0] - kicks.shaken(acb_series([ball.mid()]))[0])))
        # Unless it is very wide the enclosure is no larger than some times what the values do.
        assert width > 0.1 or float(found[0].rad()) <= 8.0 * spread


def test_an_end_of_the_move_that_is_a_ball_loses_nothing() -> None:
    """Where the duration is one of the unknowns the last jump has a time to go of 0 ± a little."""
    with precision(128):
        wide = acb_series([acb(0, arb(1.3, 0.01)), acb(0, 1)])
        exact, solved = (
            Kicks([*((arb(s), arb(jump)) for s, jump in JUMPS[:-1]), (last, arb(1))], 1).shaken(wide) for last in (arb(0), arb(0, 1e-18))
        )
        assert all(abs(one.rad() - other.rad()) < 1e-12 for one, other in zip(exact.coeffs(), solved.coeffs(), strict=True))


def test_the_highest_of_a_bent_line_is_where_it_has_its_top_or_ends() -> None:
    rng, t = np.random.default_rng(4), np.linspace(-1.0, 1.0, 4001)
    for slope, bend in [*rng.uniform(-1, 1, (200, 2)), (0.0, -1.0), (0.0, 1.0), (2.0, -1.0), (1.0, 0.0), (0.0, 0.0), (-1.0, -0.6)]:
        top = float((slope * t + bend * t * t).max())
        exact, wide = highest(abs(arb(slope)), arb(bend)), highest(abs(arb(slope, 0.01)), arb(bend, 0.01))
        assert top * (1 - 1e-12) <= float(exact.upper()) <= top + 1e-6, (slope, bend)
        for a, b in ((0.01, 0.01), (-0.01, 0.01), (0.0, -0.01)):
            assert float(wide.upper()) >= ((slope + a) * t + (bend + b) * t * t).max() - 1e-12
    assert not highest(arb("nan"), arb(-1)) <= 1e9
    assert not highest(arb(1), arb("nan")) <= 1e9


@pytest.mark.parametrize("damping", ["0", "0.03"])
def test_what_plants_of_a_cell_leave_is_enclosed(damping: str) -> None:
    """At places of a cell and instants after the move, by the plants' own roots; and a small cell loses hardly anything."""
    plant = LinearPlant.from_modes(Fraction(1, 4), [("0.8", damping, "-0.4"), ("1.4", damping, "0.3"), ("1.9", damping, "-0.1")])
    axes = tuple(moved.axis(plant, f"mode[{i}].frequency", Fraction(9, 10), Fraction(11, 10)) for i in (1, 2, 3))
    posed = problem([plant], Maneuver(Fraction(2), Limits.of(-1, 1), box=Box(axes, moved.moved(plant, axes), Fraction(1, 20))))
    rng = np.random.default_rng(5)
    with precision(128):
        plants = family(shaped(certificates.task(posed), TASK, "task"))
        kicks = Kicks([(arb(s), arb(jump)) for s, jump in JUMPS], 1)
        for centre, half in (((1, 1, 1), "0.01"), (("0.95", "1.03", "1.01"), "0.02"), (("0.98", 1, "0.97"), "0.001")):
            middle = [fmpq(Fraction(x).numerator, Fraction(x).denominator) for x in centre]
            width = fmpq(Fraction(half).numerator, Fraction(half).denominator)
            cell, centres, radii = laid([(x - width, x + width) for x in middle])
            poles = plants.tracked(cell, centres)
            assert poles is not None
            around = Around.of(plants, kicks, cell, centres, radii, poles)
            own = {
                tuple(place): left(plant, np.array([float(Fraction(x)) for x in centre]) + float(width) * place)
                for place in [np.zeros(3), *rng.choice([-1.0, 1.0], (8, 3)), *rng.uniform(-1, 1, (24, 3))]
            }
            at = own[(0.0, 0.0, 0.0)]
            total = around.moduli()[0]
            assert max(sum(abs(z) for z, _ in motions) for motions in own.values()) <= float(total.upper()) * (1 + 1e-12)
            for tau in (0.0, 0.7, 5.0, 23.0):
                value = [sum((z * np.exp(p * tau)).real for z, p in motions) for motions in own.values()]
                here = sum((z * np.exp(p * tau)).real for z, p in at)
                down, up = (float(side.upper()) for side in around.drift(arb(tau)))
                assert here - down - 1e-9 <= min(value) <= max(value) <= here + up + 1e-9
                assert float(half) > 0.001 or down + up <= 1.5 * (max(value) - min(value))


def left(plant: LinearPlant, factors: np.ndarray) -> list[tuple[complex, complex]]:
    """(Z_j, p_j) of the plant with its modes moved by factors, static gain and zeros kept, after the jumps above."""
    poles = np.array([pole.value for pole in plant.flexible]) * factors
    numerator = np.array([float(Fraction(int(c.p), int(c.q))) for c in reversed(plant.numerators[plant.output].coeffs())])
    numerator = numerator * np.prod(factors**2)
    found = []
    for j, p in enumerate(poles):
        below = p * p * (p - p.conjugate()) * np.prod([(p - q) * (p - q.conjugate()) for i, q in enumerate(poles) if i != j])
        weight = 2 * np.polyval(numerator, p) / float(plant.denominator.leading_coefficient()) / below
        found.append((weight / p * sum(jump * np.exp(p * s) for s, jump in JUMPS), p))
    return found


def test_series_are_told_apart_by_every_bit() -> None:
    with precision(128):
        met, one = Met(), acb_series([acb(arb(1, 1e-9), 2), acb(1)])
        assert met.one(acb_series([acb(arb(1, 1e-9), 2), acb(1)])) is met.one(one)
        for other in (
            acb_series([acb(arb(1, 2e-9), 2), acb(1)]),
            acb_series([acb(arb(1) + arb(2) ** -120, 2), acb(1)]),
            acb_series([acb(arb(1, 1e-9), arb(2, 1e-30)), acb(1)]),
            acb_series([acb(arb(1, 1e-9), 2), acb(1), acb(1)]),
            acb_series([acb(arb(1, 1e-9), -2), acb(1)]),
        ):
            assert met.one(other) is not met.one(one)
        lost = acb_series([acb(arb("nan"), 2)])
        assert met.one(lost) is lost

        def twice(x: acb_series) -> acb_series:
            return x + x

        assert met.of("twice", twice, one) is met.of("twice", twice, one)
        assert met.of("twice", twice, one)[0].real.contains(2)
        assert met.of("once", lambda x: x, one) is one


def three_modes(width: str, tolerance: str, displacement: str) -> Problem:
    plant = chain(4)
    low, high = 1 - Fraction(width), 1 + Fraction(width)
    axes = tuple(moved.axis(plant, f"mode[{i}].frequency", low, high) for i in (1, 2, 3))
    box = Box(axes, moved.moved(plant, axes), Fraction(tolerance))
    return problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1), box=box))


@functools.cache
def nominal() -> Bound:
    posed = three_modes("0.01", "0.05", "2")
    return minimum_time(problem(posed.plants, replace(posed.maneuver, box=None)))


def moduli(bound: Bound, factors: np.ndarray) -> float:
    """`Σ |Z_j|` of the chain with its modes moved by factors, from its roots alone."""
    command = bound.command
    assert command is not None
    modes = 2 * np.sin(np.pi * np.arange(1, 4) / 8)  # of four unit masses and three unit springs in a row
    moved_to = modes * factors
    gain = np.prod(factors) ** 2
    instants = np.array([*(segment.start for segment in command.segments), command.end])
    jumps = np.diff([0.0, *(segment.level for segment in command.segments), 0.0])
    total = 0.0
    for j, w in enumerate(moved_to):
        others = np.prod([v**2 - w**2 for i, v in enumerate(moved_to) if i != j])
        residue = gain / (-(w**2) * 2j * w * others)
        total += 2 * abs(residue / (1j * w) * (np.exp(1j * w * (command.end - instants)) @ jumps))
    return total


@pytest.mark.slow
def test_what_a_command_leaves_of_three_modes_is_proven_and_no_less() -> None:
    posed, bound = three_modes("0.02", "0.05", "2"), nominal()
    assert bound.command is not None
    found = worst_residual(posed, bound.command)
    assert found is not None
    rng = np.random.default_rng(11)
    corners = 2.0 * np.array([*np.ndindex(2, 2, 2)]) - 1.0
    worst = max(moduli(bound, 1 + 0.02 * place) for place in [*corners, *rng.uniform(-1, 1, (200, 3))]) / 2.0
    assert 0.9 * found.tolerance < worst <= found.tolerance
    # Must not be proven: a little less, or a little more of the box.
    less = str(float(found.tolerance) * (1 - 1e-4))
    assert forged(found.certificate, lambda d: d["task"]["box"].update(tolerance=less)) is not Outcome.PROVED

    def within(*factors: str) -> Outcome:
        """The same command and tolerance, with each mode's range this times as wide."""

        def change(data: Any) -> None:
            for parameter, factor in zip(data["task"]["box"]["parameters"], factors, strict=True):
                parameter.update(low=str(1 - Decimal("0.02") * Decimal(factor)), high=str(1 + Decimal("0.02") * Decimal(factor)))

        return forged(found.certificate, change)

    assert within("0.99", "0.99", "0.99") is Outcome.PROVED
    assert all(within(*wider) is not Outcome.PROVED for wider in (("1.05", "1", "1"), ("1", "1.05", "1"), ("1", "1", "1.05")))


@pytest.mark.slow
def test_three_modes_each_within_ten_per_cent() -> None:
    found = minimum_time(three_modes("0.1", "0.05", "4"))
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 1e-4
    assert found.lower == pytest.approx(14.1697, abs=1e-3)
    rng = np.random.default_rng(2)
    assert max(moduli(found, 1 + 0.1 * rng.uniform(-1, 1, 3)) for _ in range(4000)) / 4 <= 0.05 * (1 + 1e-9)
    assert found.certificate is not None
    assert forged(found.certificate, lambda d: d["task"]["box"].update(tolerance="0.04999")) is not Outcome.PROVED
    assert forged(found.certificate, lambda d: d["claim"].update(lower="14.1712")) is not Outcome.PROVED


@pytest.mark.slow
@pytest.mark.parametrize("damping", ["0.02", "0.005"])
def test_three_damped_modes_each_within_five_per_cent(damping: str) -> None:
    """Proven with room: a check of the upper side alone may cost 2e7, and more of three parameters."""
    plant = LinearPlant.from_modes(
        Fraction(1, 4), [("0.7654", damping, "-0.4268"), ("1.4142", damping, "0.25"), ("1.8478", damping, "-0.0732")]
    )
    axes = tuple(moved.axis(plant, f"mode[{i}].frequency", Fraction(95, 100), Fraction(105, 100)) for i in (1, 2, 3))
    found = minimum_time(
        problem([plant], Maneuver(Fraction(2), Limits.of(-1, 1), box=Box(axes, moved.moved(plant, axes), Fraction(1, 20))))
    )
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 1e-4
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert MOST_WORK - work["left"] < 1.5e7
    assert forged(found.certificate, lambda d: d["task"]["box"].update(tolerance="0.04999")) is not Outcome.PROVED


@pytest.mark.slow
def test_masses_and_a_spring() -> None:
    found = robust("1", "0.05", axis("mass_1", "0.1"), axis("mass_2", "0.1"), axis("stiffness", "0.1"))
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 1e-4
