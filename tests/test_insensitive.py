"""The shortest positive shapers: exact zeros, bands, and lower bounds that an independent linear program agrees with."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from independent_shaping import shortest_positive
from marks import first, slow
from scipy.optimize import linprog

from relaxations.checking.durations import Condition, none_as_short
from relaxations.checking.worst import worst_residual
from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import Shortest, specified
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.ranges import humped_ranges
from relaxations.shaping.requests import Request
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.small_tolerances import within
from suite.shaping import assess

PROVEN = 1.1e-8  # relative distance of the lower bound: it is tried at 1e-8 first


def worst(found: Shortest, band: Band) -> float:
    """The proven largest residual over the band."""
    times, amplitudes = ([Fraction(x) for x in numbers] for numbers in (found.shaper.times, found.shaper.amplitudes))
    low, high = (Fraction(repr(factor)) * Fraction(repr(band.mode.frequency)) for factor in (band.low, band.high))
    damping = Fraction(repr(band.mode.damping))
    return worst_residual(times, amplitudes, (low, high), (damping, damping), relative=1e-10).upper


@pytest.mark.parametrize("damping", [0.0, 0.05, slow(0.1), 0.3])
@pytest.mark.parametrize(("low", "high", "tolerance"), first(1, [(0.8, 1.2, 0.05), (0.6, 1.4, 0.05), (0.95, 1.05, 0.02), (1.0, 1.0, 0.05)]))
def test_the_tolerance_holds_over_the_whole_band_and_nothing_shorter_does(damping: float, low: float, high: float, tolerance: float):
    band = Band(Mode(2 * math.pi, damping), low, high, tolerance)
    found = specified([band])
    assert worst(found, band) <= tolerance
    assert min(found.shaper.amplitudes) > 0.0
    assert found.lower is not None
    assert found.lower == pytest.approx(found.shaper.duration, rel=PROVEN)
    assert found.lower < found.shaper.duration


@pytest.mark.parametrize("derivatives", [0, 1, slow(2)])
@pytest.mark.parametrize("damping", [0.0, slow(0.1), 0.4])
def test_of_one_mode_the_binomials_are_the_shortest(damping: float, derivatives: int):
    mode = Mode(3.0, damping)
    found, known = specified([], [(mode, derivatives)]), derivative_shaper(mode, derivatives)
    # The amplitudes of a multiple zero are known to rounding divided by the smallness of the last derivative.
    assert found.shaper.times == pytest.approx(known.times, abs=1e-10)
    assert found.shaper.amplitudes == pytest.approx(known.amplitudes, abs=1e-10)
    assert found.lower == pytest.approx(known.duration, rel=PROVEN)


@pytest.mark.parametrize("derivatives", [0, slow(1)])
def test_several_modes_at_once_are_shorter_than_one_after_the_other(derivatives: int):
    modes = [Mode(1.0, 0.05), Mode(2.6, 0.02), Mode(1.7, 0.1)]
    found = specified([], [(mode, derivatives) for mode in modes])
    assert max(float(residual(found.shaper.times, found.shaper.amplitudes, m.frequency, m.damping)[0]) for m in modes) <= 1e-12
    assert found.lower == pytest.approx(found.shaper.duration, rel=PROVEN)
    assert found.shaper.duration < 0.9 * sum(derivative_shaper(mode, derivatives).duration for mode in modes)
    turned = specified([], [(mode, derivatives) for mode in reversed(modes)])
    assert turned.shaper.times == pytest.approx(found.shaper.times, abs=1e-9)


def test_a_mode_that_the_shaper_of_another_serves_costs_nothing():
    for derivatives in (0, 1):
        found = specified([], [(Mode(1.0), derivatives), (Mode(3.0), derivatives)])
        assert found.shaper.duration == pytest.approx((derivatives + 1) * math.pi, rel=1e-9)
        assert found.lower == pytest.approx((derivatives + 1) * math.pi, rel=PROVEN)
    equal = specified([], [(Mode(1.0), 0), (Mode(2.0), 0)])  # thirds of the circle serve both
    assert equal.shaper.times == pytest.approx(2 * math.pi / 3 * np.arange(3), abs=1e-9)


def test_bands_and_exact_zeros_together():
    band, zero = Band(Mode(6.28, 0.05), 0.9, 1.1, 0.05), Mode(20.0)
    found = specified([band], [(zero, 1)])
    assert worst(found, band) <= 0.05
    assert float(residual(found.shaper.times, found.shaper.amplitudes, 20.0, 0.0)[0]) <= 1e-10
    assert found.lower == pytest.approx(found.shaper.duration, rel=PROVEN)


@pytest.mark.slow
def test_time_scales_with_frequency_and_tighter_demands_take_longer():
    wide = [specified([Band(Mode(w, 0.02), 0.8, 1.2, 0.05)]).shaper for w in (1.0, 5e4)]
    assert np.array(wide[0].times) / 5e4 == pytest.approx(np.array(wide[1].times), rel=1e-8)
    durations = [
        specified([Band(Mode(1.0, 0.02), 1 - half, 1 + half, v)]).shaper.duration for half, v in ((0.2, 0.1), (0.2, 0.05), (0.3, 0.05))
    ]
    assert durations == sorted(durations)


@pytest.mark.parametrize(("modes", "tolerance"), first(1, [([Mode(1.0, 0.05), Mode(2.6, 0.02)], 0.0), ([Mode(1.0, 0.1)], 0.05)]))
def test_an_independent_linear_program_agrees(modes: list[Mode], tolerance: float):
    """HiGHS on a grid of instants, with circles of tolerance as polygons of 64 sides around them: the root lies where it was found."""
    bands = [Band(mode, 0.85, 1.15, tolerance) for mode in modes] if tolerance else []
    found = specified(bands, [] if tolerance else [(mode, 0) for mode in modes])
    frequencies = [(w, m.damping) for m in modes for w in (np.linspace(0.85, 1.15, 61) * m.frequency if tolerance else [m.frequency])]
    sides = np.exp(2j * np.pi * np.arange(64) / 64)

    def least(duration: float, cells: int) -> float:
        """The smallest excess over the polygons around the circles."""
        since = np.linspace(-duration, 0.0, cells + 1)
        rows = [np.exp(w * complex(z, math.sqrt(1 - z * z)) * since) for w, z in frequencies]
        table = np.array([(side * row).real for row in rows for side in sides])
        lower = linprog(
            np.append(np.zeros(cells + 1), 1.0),
            np.hstack([table, -np.ones((len(table), 1))]),
            np.full(len(table), tolerance),
            np.append(np.ones(cells + 1), 0.0)[None, :],
            [1.0],
            bounds=[(0.0, None)] * (cells + 1) + [(None, None)],
            method="highs",
        )
        assert lower.status == 0
        return float(lower.fun)

    # Shorter by 1 %: impossible even on a grid with its larger polygons; longer by 1 %: possible (grid and polygons cost less than that).
    assert least(0.99 * found.shaper.duration, 300) > 1e-4
    assert least(1.01 * found.shaper.duration, 300) < 1e-4


def conditions(duration: float) -> list[Condition]:
    """ZV of the mode 1 rad/s: the weight that sees both impulses from outside, as it stands half a period earlier."""
    middle = duration / 2.0
    direction = complex(math.cos(-middle), math.sin(-middle))
    return [Condition(Fraction(1), Fraction(0), Fraction(0), 0, (Fraction(direction.real), Fraction(direction.imag)))]


def test_the_checker_proves_what_is_true_and_nothing_else():
    assert none_as_short(Fraction(3), conditions(3.0))  # cos(t - 1.5) > 0 on [0, 3]
    assert none_as_short(Fraction(314, 100), conditions(3.14))
    assert not none_as_short(Fraction(315, 100), conditions(3.15))  # half a period is 3.1416: such shapers exist
    assert not none_as_short(Fraction(3), conditions(1.0))  # a wrong weight proves nothing
    assert not none_as_short(Fraction(3), [])
    (good,) = conditions(3.0)
    for broken in (
        Condition(Fraction(0), good.damping, good.tolerance, 0, good.weight),
        Condition(good.frequency, Fraction(1), good.tolerance, 0, good.weight),
        Condition(good.frequency, Fraction(-1, 10), good.tolerance, 0, good.weight),
        Condition(good.frequency, good.damping, Fraction(-1), 0, good.weight),
        Condition(good.frequency, good.damping, Fraction(0), 1, good.weight),  # a derivative without the value below it
    ):
        assert not none_as_short(Fraction(3), [broken])


def test_the_checker_refuses_every_duration_of_a_shaper_that_exists():
    """Random weights against shapers that are there: none may be proven too short."""
    chance, shaper = np.random.default_rng(8), derivative_shaper(Mode(1.0, 0.1), 1)
    for _ in range(200):
        weights = [tuple(Fraction(float(x)) for x in chance.normal(size=2)) for _ in range(2)]
        asked = [Condition(Fraction(1), Fraction(0.1), Fraction(0), power, (w[0], w[1])) for power, w in enumerate(weights)]
        assert not none_as_short(Fraction(shaper.duration) * Fraction(10001, 10000), asked)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: specified([]), ["nothing is asked"]),
        (lambda: Band(Mode(1.0), 1.2, 0.8, 0.05), ["1.2", "0.8"]),
        (lambda: Band(Mode(1.0), 0.0, 0.8, 1.0), ["0.0", "tolerance", "1.0"]),
    ],
)
def test_mistakes_are_named(make, words: list[str]):
    with pytest.raises(ShaperError) as caught:
        make()
    assert all(word in str(caught.value) for word in words)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("band", "dampings"),
    [
        ((0.8, 1.2, 0.05), (0.0, 0.1)),
        slow((1.0, 1.0, 0.05), (0.0, 0.2)),
        slow((0.9, 1.1, 0.02), (0.1, 0.6)),
        slow((0.7, 1.3, 0.05), (0.05, 0.3)),
    ],
)
def test_a_range_of_dampings_is_designed_for(band: tuple[float, float, float], dampings: tuple[float, float]):
    """The tolerance holds in the whole box, which the edges tell; each single damping takes no longer; no shorter one keeps the corners."""
    mode = Mode(2 * math.pi, (dampings[0] + dampings[1]) / 2)
    found = specified([Band(mode, *band, dampings)])
    times, amplitudes = found.shaper.times, found.shaper.amplitudes
    box = [residual(times, amplitudes, np.linspace(band[0], band[1], 201) * mode.frequency, z).max() for z in np.linspace(*dampings, 101)]
    assert max(box) <= band[2]
    assert max(box) == pytest.approx(band[2], rel=1e-6)
    assert found.lower == pytest.approx(found.shaper.duration, rel=PROVEN)
    alone = [specified([Band(Mode(mode.frequency, z), *band)]).shaper.duration for z in (dampings[0], mode.damping, dampings[1])]
    assert found.shaper.duration > max(alone) * (1 - 1e-9)
    places = [(f * mode.frequency, z, band[2]) for f in np.linspace(band[0], band[1], 9) for z in np.linspace(*dampings, 5)]
    assert shortest_positive(places, cells=120, corners=32) == pytest.approx(found.shaper.duration, rel=0.02)


def test_wrong_dampings_of_a_band_are_named():
    with pytest.raises(ShaperError, match=r"not from 0\.2 to 0\.1"):
        Band(Mode(1.0, 0.15), 0.9, 1.1, 0.05, (0.2, 0.1))


@pytest.mark.slow
def test_a_small_tolerance_over_a_range_of_dampings_is_kept_by_a_shaper_with_derivatives():
    band = Band(Mode(2 * math.pi, 0.05), 0.95, 1.05, 1e-8, (0.04, 0.06))
    found = within([band])
    for damping in np.linspace(0.04, 0.06, 11):
        omega = np.linspace(0.95, 1.05, 101) * 2 * math.pi
        assert residual(found.shaper.times, found.shaper.amplitudes, omega, damping).max() <= 1e-8


def test_a_residual_that_is_highest_between_places_is_seen():
    """Its places alone showed no more than the tolerance; between two of them 0.0500011 was left."""
    at = (Mode(36.581 * 2.0 * math.pi, 0.0), Mode(44.934 * 2.0 * math.pi, 0.0))
    bands = humped_ranges(at, 0.05, 1)
    found = specified(bands)
    assert max(worst(found, band) for band in bands) <= 0.05


def test_a_promise_that_is_broken_is_no_shaper(monkeypatch: pytest.MonkeyPatch):
    made = make("zv", Request((Mode(6.0, 0.0),)))
    monkeypatch.setattr("suite.shaping.make", lambda kind, request: made)
    assess("zv", Request((Mode(6.0, 0.0),)))  # it promises nothing over a band
    with pytest.raises(SolverError, match=r"si promises 0.05 from 0.8 to 1.2 of mode 1's frequency, but .* leaves 0\.30"):
        assess("si", Request((Mode(6.0, 0.0),)))
