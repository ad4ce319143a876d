"""Pulses of one height of modes that all but decay: exact in many digits, none shorter, and no weights refute what exists."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from flint import acb, arb
from marks import slow
from scipy.optimize import linprog

from relaxations.checking.durations import Condition, none_of_pulses
from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.modes import Mode
from relaxations.shaping.narrow_pulses import narrow_pulses
from relaxations.shaping.pulses import pulsed
from relaxations.shaping.shapers import Shaper

W = 2 * math.pi
DRAWN = 3e-8  # relative: longer than the shortest is what is drawn apart, by half a step of 2^-26 or one


def missed(shaper: Shaper, mode: Mode, derivatives: int = 0) -> float:
    """What the pulses leave of the mode, of the largest that one of them leaves of itself; in many digits."""
    with precision(4000):
        rate, end, worst = pole(mode), arb(shaper.duration), 0.0
        for power in range(derivatives + 1):
            parts = []
            for pulse in shaper.pulses:
                edges = arb(pulse.start), arb(pulse.start) + arb(pulse.width)
                before, after = ((t / end) ** power * (rate * (t - end)).exp() for t in edges)
                parts.append(arb(pulse.height) * (after - before))
            largest = max((abs(part) for part in parts), key=lambda size: size.mid())
            worst = max(worst, float(abs(sum(parts, acb(0))) / largest))
        return worst


def pole(mode: Mode) -> acb:
    """κω."""
    zeta = arb(mode.damping)
    return arb(mode.frequency) * acb(zeta, (1 - zeta * zeta).sqrt())


@pytest.mark.parametrize(
    ("height", "derivatives", "modes"),
    [
        (3.0, 0, [(1, 0.99)]),
        (0.05, 1, [(1, 0.99)]),
        (4.0, 0, [(1, 0.99998)]),
        (4.0, 3, [(1, 0.99)]),
        (1.0, 0, [(1, 0.99), (2.7, 0.95)]),
        (3.0, 1, [(1, 0.9), (2.7, 0.5)]),  # of more pulses than zeros need
        slow(2.919, 0, [(1.2, 0.9891), (1.407, 0.861), (3.843, 0.328)]),
        slow(43.1, 1, [(3.743, 0.375), (1.151, 0.9774)]),
        slow(3.8, 0, [(2.036, 0.9701), (1.797, 0.999586)]),
        slow(16.422, 1, [(2.277, 0.9171), (3.462, 0.455), (3.103, 0.999458)]),
    ],
)
def test_nothing_is_left_beside_what_any_pulse_leaves_and_none_is_shorter(
    height: float, derivatives: int, modes: list[tuple[float, float]]
):
    asked = [Mode(f * W, z) for f, z in modes]
    found = pulsed(asked, height, derivatives)
    assert max(missed(found.shaper, mode, derivatives) for mode in asked) < 1e-8
    assert found.shaper.gain == pytest.approx(1.0, abs=1e-14)
    assert 0.0 < max(pulse.height for pulse in found.shaper.pulses) <= height * (1 + 1e-14)
    assert found.lower is not None
    assert found.lower <= found.shaper.duration <= found.lower * (1 + DRAWN)


def test_two_pulses_of_one_mode_are_those_of_its_equations_in_many_digits():
    """(e^{p w} - 1) + e^{p T} (1 - e^{-p v}) = 0, v + w = 1/a: size and phase of e^{pT} tell the same T, by halving v."""
    height, mode = 4.0, Mode(W, 0.99)
    with precision(300):
        p = pole(mode)

        def told(narrow: arb) -> tuple[arb, arb]:
            motion = -((p * (1 / arb(height) - narrow)).exp() - 1) / (1 - (-p * narrow).exp())
            return motion.log().real / p.real, (motion.log().imag + 2 * arb.pi()) / p.imag

        low, high = arb("1e-14"), arb("1e-8")
        for _ in range(120):
            middle = (low + high) / 2
            by_size, by_phase = told(middle)
            low, high = (middle, high) if by_size > by_phase else (low, middle)
        end, narrow = float(told(low)[1]), float(low)
    found = pulsed([mode], height)
    assert found.lower is not None
    assert found.lower <= end == pytest.approx(3.700590841402066, rel=4e-16)
    assert end <= found.shaper.duration <= end * (1 + DRAWN)
    assert sum(pulse.gain for pulse in found.shaper.pulses[-2:]) == pytest.approx(height * narrow, rel=1e-6)


@pytest.mark.parametrize(
    ("height", "modes", "duration"), [(2.0, [(1, 0.9), (2.7, 0.1)], 1.5656608174745894), (0.2, [(1, 0.9)], 5.982088946565733)]
)
def test_they_are_what_programs_find_where_these_tell(height: float, modes: list[tuple[float, float]], duration: float):
    """Digits of the fastest command of the on-off plant, with its certificate."""
    found = narrow_pulses([Mode(f * W, z) for f, z in modes], height, 0)
    assert found.shaper.duration == pytest.approx(duration, rel=1e-14)
    assert found.lower == pytest.approx(duration, rel=1e-12)


@pytest.mark.parametrize(("height", "modes"), [slow(3.0, [(1, 0.9), (2.7, 0.5)]), (5.696, [(2.544, 0.0), (0.647, 0.0)])])
def test_more_pulses_than_zeros_need_are_what_a_grid_holds(height: float, modes: list[tuple[float, float]]):
    """HiGHS: in 1 % less than their duration no such pulses on a grid leave nothing with a whole integral, in 1 % more some do."""
    asked = [Mode(f * W, z) for f, z in modes]
    found = narrow_pulses(asked, height, 1)
    assert len(found.shaper.pulses) > 2 * len(modes) + 1
    cells = 1000

    def reachable(duration: float) -> float:
        middle = np.linspace(-duration, 0.0, cells + 1)[:-1] + duration / cells / 2.0
        table = []
        for mode in asked:
            z = np.exp(mode.frequency * mode.direction * middle)
            for power in (0, 1):
                moment = (middle / duration) ** power * z
                table += [moment.real, moment.imag]
        best = linprog(-np.full(cells, duration / cells), A_eq=np.array(table), b_eq=np.zeros(len(table)), bounds=(0.0, height))
        return -best.fun

    assert reachable(found.shaper.duration * 0.99) < 1.0 < reachable(found.shaper.duration * 1.01)


def test_a_height_that_doubles_do_not_hold_is_told():
    with pytest.raises(SolverError, match=r"pulses-zv at a damping of 0\.9999999 .* up to a damping of 0\.99999016"):
        narrow_pulses([Mode(W, 0.9999999)], 3.0, 0)


def test_heights_at_which_pulses_join_are_told():
    with pytest.raises(SolverError, match=r"pulses of 3\.075 1/s were not followed .* higher ones"):
        narrow_pulses([Mode(f * W, z) for f, z in [(2.882, 0.994399), (3.643, 0.0), (3.461, 0.9208)]], 3.075, 0)


def test_no_weights_refute_pulses_that_exist():
    """Weights of all directions and sizes refute no duration that pulses take, and some a shorter one."""
    mode = Mode(W, 0.9)
    exact = Fraction(mode.frequency), Fraction(mode.damping)
    longer, height = pulsed([mode], 4.0).shaper.duration * (1 + 1e-9), Fraction(4)

    def refuted(duration: float, size: float, angle: float, a: Fraction = height, level: Fraction = Fraction(1)) -> bool:
        weight = Fraction(size * math.cos(angle)), Fraction(size * math.sin(angle))
        return none_of_pulses(Fraction(duration), [Condition(*exact, Fraction(0), 0, weight)], a, level)

    sizes = np.geomspace(1e-2, 1e4, 5)
    angles = np.linspace(0.0, 2 * np.pi, 13)
    assert not any(refuted(longer, size, angle) for size in sizes for angle in angles)
    told = [(size, angle) for size in sizes for angle in angles if refuted(0.9 * longer, size, angle)]
    assert told, "a shorter one is refuted by some"
    size, angle = told[0]
    assert not refuted(0.9 * longer, -size, angle)
    assert not refuted(0.9 * longer, size, angle, a=height * 1000)  # higher pulses are shorter
    assert not refuted(0.9 * longer, size, angle, level=Fraction(0))
    assert not refuted(0.9 * longer, size, angle, level=Fraction(-1))
    assert not refuted(0.9 * longer, size, angle, a=Fraction(-4))
    assert refuted(0.24, size, angle), "shorter than 1/a: there is no room for the integral"


def test_a_tolerance_counts_against_the_weights():
    mode = Mode(W, 0.9)
    exact = Fraction(mode.frequency), Fraction(mode.damping)
    weight = Fraction(1, 1000), Fraction(0)
    assert none_of_pulses(Fraction(1, 5), [Condition(*exact, Fraction(1, 2), 0, weight)], Fraction(4))
    assert not none_of_pulses(Fraction(1, 5), [Condition(*exact, Fraction(1000), 0, weight)], Fraction(4))
    # A derivative says nothing at every instant unless all below it vanish.
    assert not none_of_pulses(Fraction(1, 5), [Condition(*exact, Fraction(0), 1, weight)], Fraction(4))
