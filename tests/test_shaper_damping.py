"""Shapers at any damping and tolerance: where humps end, how the shaper goes on, and what is proven of it there."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import cast

import numpy as np
import pytest
from marks import slow
from scipy.optimize import brentq, minimize_scalar

from relaxations.checking.worst import worst_residual
from relaxations.errors import ShaperError
from relaxations.shaping.bounded import bounded
from relaxations.shaping.humps import extra_insensitive, unity_magnitude
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.kinds import make
from relaxations.shaping.least_durations import least_with_derivatives
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.sampled import sampled
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left
from suite.shaper_files import picture
from suite.shaping import assess


def worst(shaper: Shaper, damping: float, low: float, high: float) -> float:
    """The proven upper end over a band of a mode of 1 rad/s."""
    numbers = [Fraction(t) for t in shaper.times], [Fraction(a) for a in shaper.amplitudes]
    exact = Fraction(damping)
    return worst_residual(*numbers, (Fraction(low), Fraction(high)), (exact, exact), relative=1e-15, absolute=3e-16).upper


def hump_beyond(shaper: Shaper, damping: float, zero: float) -> tuple[float, float]:
    """Where the residual is largest beyond its last zero, and how large."""
    found = minimize_scalar(lambda nu: -float(residual(shaper.times, shaper.amplitudes, nu, damping)[0]),
                            bounds=(zero, 3.0 * zero), method="bounded", options={"xatol": 1e-10})  # fmt: skip
    return float(found.x), -float(found.fun)


@pytest.mark.parametrize("damping", [slow(0.75), 0.9, slow(0.97)])
def test_beyond_its_end_one_hump_is_the_zv_shaper_whose_highest_residual_is_at_the_mode(damping: float):
    """Independently: ZV in closed form, its hump by a search of one number, scaled to be at 1."""
    zv = derivative_shaper(Mode(1.0, damping))
    place, height = hump_beyond(zv, damping, 1.0)
    found = extra_insensitive(Mode(1.0, damping), 0.05)
    assert found.shaper.times == pytest.approx([0.0, zv.duration * place], rel=1e-7)  # of the search: a maximum is flat
    assert found.shaper.amplitudes == pytest.approx(zv.amplitudes, rel=1e-12)
    assert found.ripple == pytest.approx(height, rel=1e-10)
    assert found.ripple < 0.05


@pytest.mark.slow
def test_where_one_hump_ends_and_that_it_is_continuous_there():
    """The end: ZV's own hump is as high as the tolerance."""
    tolerance = 0.05

    def over(damping: float) -> float:
        return hump_beyond(derivative_shaper(Mode(1.0, damping)), damping, 1.0)[1] - tolerance

    end = float(cast(float, brentq(over, 0.5, 0.9, xtol=1e-12)))
    assert end == pytest.approx(0.69319, abs=1e-5)
    last, first = (extra_insensitive(Mode(1.0, end + step), tolerance) for step in (-1e-5, 1e-5))
    assert len(last.shaper.times) == 3
    assert len(first.shaper.times) == 2
    assert first.shaper.duration == pytest.approx(last.shaper.duration, rel=1e-3)
    at = np.linspace(0.4, 3.0, 200)
    curves = [residual(one.shaper.times, one.shaper.amplitudes, at, end) for one in (last, first)]
    assert curves[0] == pytest.approx(curves[1], abs=1e-4)


@pytest.mark.parametrize("humps", [1, slow(2), slow(3)])
def test_humps_are_continuous_in_the_tolerance(humps: int):
    """Around every bend of the curve of solutions: a step of the tolerance moves nothing by more than a small multiple of it."""
    steps = np.linspace(0.02, 0.2, 7)
    durations = [extra_insensitive(Mode(1.0, 0.3), float(v), humps).shaper.duration for v in steps]
    assert np.abs(np.diff(durations)).max() < 0.6


@pytest.mark.parametrize("tolerance", [1e-12, slow(1e-4), 0.5])
@pytest.mark.parametrize("damping", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("make_one", [extra_insensitive, unity_magnitude])
def test_the_tolerance_is_kept_at_the_mode_and_about_it_proven(make_one, damping: float, tolerance: float):
    found = make_one(Mode(1.0, damping), tolerance)
    low = max(0.95, found.zeros[0].frequency)
    high = min(1.05, found.zeros[-1].frequency) if len(found.zeros) > 1 else 1.05
    assert worst(found.shaper, damping, low, high) <= tolerance
    assert found.ripple <= tolerance
    at_mode = float(residual(found.shaper.times, found.shaper.amplitudes, 1.0, damping)[0])
    assert at_mode == pytest.approx(found.ripple, abs=2e-15 + 1e-6 * found.ripple)


def test_tolerances_that_doubles_cannot_hold_are_refused_in_words():
    with pytest.raises(ShaperError, match=r"1e-14.*lost in the rounding.*from 1e-13 on, and zvdd leaves nothing"):
        extra_insensitive(Mode(1.0), 1e-14, 2)


@pytest.mark.parametrize("damping", [0.0, 0.5, 0.95, 0.999])
@pytest.mark.parametrize("derivatives", [0, 1, 12, 60])
def test_least_durations_of_derivatives_are_exact_at_any_damping(damping: float, derivatives: int):
    mode = Mode(3.0, damping)
    assert least_with_derivatives(mode, derivatives) <= (derivatives + 1) * math.pi / (3.0 * math.sqrt(1.0 - damping**2)) * (1 + 1e-13)
    if (derivatives + 1) * math.log10(mode.decay) < -308:
        with pytest.raises(ShaperError, match=r"doubles hold 1e-307; up to a damping of"):
            make(f"zv-d:{derivatives}", Request((mode,)))
        return
    made = make(f"zv-d:{derivatives}", Request((mode,)))
    assert made.least is not None
    assert made.least.duration <= made.shaper.duration
    assert made.least.duration == pytest.approx((derivatives + 1) * mode.half_period, rel=1e-13)  # 1 - ζ² in doubles


@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_function_that_proves_it_has_one_sign(n: int):
    x = np.linspace(-(n + 1) * np.pi, 0.0, 20_001)
    p = np.sin(x) * np.prod([x + k * np.pi for k in range(1, n + 1)], axis=0)
    assert p.max() <= 1e-9 * np.abs(p).max()


@pytest.mark.parametrize("derivatives", [0, 1, 2])
def test_unity_magnitude_near_critical_damping(derivatives: int):
    """As doubles its gaps may vanish; what is left is still nothing."""
    for damping in (0.9, 0.99):
        shaper = bounded([Mode(1.0, damping)], 0, 1, derivatives).shaper
        assert sum(shaper.amplitudes) == 1.0
        assert float(residual(shaper.times, shaper.amplitudes, 1.0, damping)[0]) < 1e-12


@pytest.mark.parametrize("count", [5, 9, 20])
def test_the_worst_case_of_many_impulses_encloses_that_of_a_fine_sample(count: int):
    """Random sequences, negative impulses among them, over boxes of frequency and damping, of impulses and of pulses' edges."""
    chance = np.random.default_rng(count)
    for order in (0, 1):
        times = np.concatenate([[0.0], np.sort(chance.uniform(0.0, 12.0, count - 1))])
        amplitudes = chance.normal(size=count)
        numbers = [Fraction(float(t)) for t in times], [Fraction(float(a)) for a in amplitudes]
        found = worst_residual(*numbers, (Fraction(7, 10), Fraction(3, 2)), (Fraction(0), Fraction(1, 5)), relative=1e-4, order=order)
        seen = max(float(residual(times, amplitudes, np.linspace(0.7, 1.5, 801), z, order).max()) for z in np.linspace(0.0, 0.2, 41))
        assert found.lower <= found.upper <= found.lower * (1 + 1.1e-4)
        assert seen <= found.upper
        assert found.lower <= seen * (1 + 2e-3)  # of the sample's own distance from the peak


@pytest.mark.slow
def test_nearly_nothing_is_proven_of_sequences_in_which_everything_cancels():
    """(N + 1)-fold zeros: 61 impulses over a band, within a thousand cells."""
    shaper = derivative_shaper(Mode(1.0, 0.05), 60)
    numbers = [Fraction(t) for t in shaper.times], [Fraction(a) for a in shaper.amplitudes]
    found = worst_residual(*numbers, (Fraction(1, 2), Fraction(2)), (Fraction(1, 20), Fraction(1, 20)), relative=1e-8, absolute=1e-12)
    grid = residual(shaper.times, shaper.amplitudes, np.linspace(0.5, 2.0, 4001), 0.05)
    assert found.lower <= found.upper <= found.lower * (1 + 1.1e-8)
    assert found.upper == pytest.approx(float(grid.max()), rel=1e-5)
    assert found.cells < 1000


@pytest.mark.parametrize("damping", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("tolerance", [0.05, 0.5])
def test_specified_insensitivity_is_near_its_bound_with_much_damping(damping: float, tolerance: float):
    """Where the mode's own decay does it all, e^{-ζ·0.8ωT} = V: the shaper is within 1e-4 of the least duration, and proven to keep V."""
    made = make("si", Request((Mode(1.0, damping),), tolerance=tolerance))
    assert made.least is not None
    assert made.least.duration <= made.shaper.duration <= made.least.duration * (1 + 1e-4)
    assert worst(made.shaper, damping, 0.8, 1.2) <= tolerance
    if damping > 0.9:
        assert made.shaper.duration == pytest.approx(-math.log(tolerance) / (0.8 * damping), rel=1e-4)


@pytest.mark.slow
def test_specified_insensitivity_of_a_tolerance_that_programs_do_not_tell_from_none():
    made = make("si", Request((Mode(1.0, 0.6),), tolerance=1e-9))
    assert made.least is not None
    assert made.least.duration < made.shaper.duration
    assert worst(made.shaper, 0.6, 0.8, 1.2) <= 1e-9
    assert any("larger tolerance" in note for note in made.notes)


@pytest.mark.parametrize(("damping", "known"), [(0.9, 2.48), (0.97, 4.38)])
def test_modes_of_very_different_decay_on_samples(damping: float, known: float):
    """Nine equations, nine impulses; the mode that has all but decayed is left nothing of its own terms either."""
    modes = Mode(2 * math.pi, damping), Mode(2.7 * 2 * math.pi, 0.5)
    shaper = sampled([(mode, 1) for mode in modes], 0.02).shaper
    assert shaper.duration == pytest.approx(known, abs=0.03)  # a sample and a half: what is that close may not be told
    assert len(shaper.times) <= 9
    assert min(shaper.amplitudes) > 0.0
    assert all(left(shaper, mode, 1) < 1e-9 for mode in modes)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "most"), [(0.9, 2.48), (0.97, 4.40)])
def test_modes_of_very_different_decay_at_once(damping: float, most: float):
    modes = Mode(2 * math.pi, damping), Mode(2.7 * 2 * math.pi, 0.5)
    made = make("zvd", Request(modes, simultaneous=True))
    assert len(made.shaper.times) <= 9
    assert made.least is not None
    assert made.least.duration <= made.shaper.duration <= most
    assert all(left(made.shaper, mode, 1) < 1e-9 for mode in modes)


def test_the_picture_shows_the_range_of_damping():
    mode = Mode(2 * math.pi, 0.05)
    assert "1 Hz, damping 0 to 0.2" in picture(assess("zv", Request((mode,)), (0.0, 0.2)))
    assert "damping 0 to" not in picture(assess("zv", Request((mode,))))
