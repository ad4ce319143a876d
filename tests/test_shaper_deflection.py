"""Deflection-limited shapers: the limit holds at every instant of an independent integration, nothing is left, and limits cost time."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from relaxations.checking.sampled_deflections import Asked, Left, Strayed, none_on_samples
from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.shaping.bounded import bounded
from relaxations.shaping.deflection import deflection, deflection_limited
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.modes import Mode
from relaxations.shaping.sensitivity import residual
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left

ONE, TWO = (Mode(2 * math.pi, 0.02),), (Mode(6.0, 0.02), Mode(17.0, 0.03))


def integrated(shaper: Shaper, mode: Mode) -> float:
    """The largest |y - u| while the step is shaped, by integration of the differential equation from impulse to impulse."""
    state, largest, level = [0.0, 0.0], 0.0, 0.0
    stops = [*shaper.times, shaper.times[-1] + 2 * mode.half_period]
    for amplitude, begin, end in zip(shaper.amplitudes, stops[:-1], stops[1:], strict=True):
        level += amplitude
        square, damped = mode.frequency**2, 2 * mode.damping * mode.frequency
        force = lambda t, x, u=level, k=square, c=damped: [x[1], k * (u - x[0]) - c * x[1]]  # noqa: E731
        run = solve_ivp(force, (begin, end), state, rtol=1e-9, atol=1e-11, max_step=mode.half_period / 50)
        largest = max(largest, float(np.abs(run.y[0] - level).max()))
        state = run.y[:, -1].tolist()
    return largest


def test_the_deflection_of_an_unshaped_step_is_1_and_of_zv_a_half():
    for shaper, known in ((Shaper((0.0,), (1.0,)), 1.0), (derivative_shaper(Mode(3.0), 0), 0.5)):
        found = deflection(shaper, Mode(3.0))
        assert found.lower <= known * (1 + 1e-15)
        assert found.upper == pytest.approx(known, rel=1e-14)


@pytest.mark.parametrize(("modes", "limit", "derivatives"), [(ONE, 0.4, 0), (ONE, 0.2, 1), (TWO, 0.4, 0)])
def test_the_limit_holds_and_nothing_is_left(modes: tuple[Mode, ...], limit: float, derivatives: int):
    found = deflection_limited(modes, limit, derivatives=derivatives).shaper
    assert sum(found.amplitudes) == pytest.approx(1.0, abs=1e-12)
    sums = np.cumsum(found.amplitudes)
    assert sums.min() >= 0.0
    assert sums.max() <= 1.0 + 4e-16  # the sums' own rounding; a program's room of 1e-9 is not in what is made
    for mode in modes:
        assert integrated(found, mode) <= limit * (1 + 1e-6)
        nudge = 1e-3  # with further derivatives zero the residual grows with their power
        at = [float(residual(found.times, found.amplitudes, mode.frequency * f, mode.damping)[0]) for f in (1.0, 1.0 + nudge)]
        assert at[0] < 1e-10
        assert at[1] < 20.0 * nudge ** (derivatives + 1) * 5.0**derivatives


@pytest.mark.parametrize(
    ("damping", "derivatives"),
    [(0.9, 1), (0.99, 0), pytest.param(0.99, 1, marks=pytest.mark.slow), pytest.param(0.999, 0, marks=pytest.mark.slow)],
)
def test_much_damping(damping: float, derivatives: int):
    """Dips from 1 fall with the mode's decay, to 1e-34 of a step at last, and are solved in units that fall with it."""
    mode = Mode(2 * math.pi, damping)
    found = deflection_limited([mode], 0.5, derivatives=derivatives).shaper
    shortest = bounded([mode], 0.0, 1.0, derivatives).lower
    assert shortest is not None
    assert shortest < found.duration < shortest + 0.4  # what half a step's deflection costs is hardly more than 0.3 s at any of these
    assert left(found, mode, derivatives) < 1e-11
    assert np.cumsum(found.amplitudes).max() <= 1.0 + 4e-16
    depths = np.cumsum(np.array(found.amplitudes)[::-1])[:0:-1]  # of partial sums below 1, exact where these are rounded to it
    assert depths.min() >= -1e-15 * math.exp(-damping * mode.frequency * found.duration)
    assert deflection(found, mode).upper <= 0.5
    assert integrated(found, mode) <= 0.5 * (1 + 1e-6)


def test_a_tighter_limit_takes_longer_and_wider_sums_do_not():
    durations = [deflection_limited(ONE, limit).shaper.duration for limit in (0.6, 0.4, 0.2, 0.1)]
    assert durations == sorted(durations)
    assert deflection_limited(ONE, 0.4, (-1.0, 2.0)).shaper.duration <= durations[1]


def test_mistakes_are_named():
    with pytest.raises(ShaperError, match="positive fraction"):
        deflection_limited(ONE, 0.0)
    with pytest.raises(ImpossibleShaperError, match=r"at most 0\.25"):
        deflection_limited(ONE, 0.4, sample_time=0.3)
    with pytest.raises(ShaperError, match="at least one mode"):
        deflection_limited([], 0.4)


@pytest.mark.parametrize(("modes", "limit", "derivatives"), [(ONE, 0.4, 0), (ONE, 0.2, 1), (TWO, 0.6, 0)])
def test_one_sample_less_is_impossible_for_an_independent_program_too(modes: tuple[Mode, ...], limit: float, derivatives: int):
    """HiGHS on impulses instead of partial sums, deflections from the matrix exponential: no solution with a sample less than is needed."""
    found = deflection_limited(modes, limit, derivatives=derivatives)
    assert found.needed > 0
    assert found.needed <= round(found.shaper.duration / found.step)
    count = found.needed
    instants = found.step * np.arange(count)
    since = instants - instants[-1]
    equal = [np.ones(count)]
    limits = []
    for mode in modes:
        pole = mode.pole
        for power in range(derivatives + 1):
            z = since**power * np.exp(mode.frequency * mode.direction * since)
            equal += [z.real, z.imag]
        error = lambda t, p=pole: -(np.exp(p * t) * (1 + 1j * p.real / p.imag)).real  # noqa: E731
        table = np.array([[error(t - begun) if t >= begun else 0.0 for begun in instants] for t in instants])
        limits += [table, table - np.diag(np.diag(table))]
    strays, sums = np.vstack(limits), np.tri(count)
    less = linprog(
        np.zeros(count),
        A_ub=np.vstack([strays, -strays, sums, -sums]),
        b_ub=np.concatenate([np.full(2 * len(strays), limit), np.ones(count), np.zeros(count)]),
        A_eq=np.array(equal),
        b_eq=np.eye(len(equal))[0],
        bounds=(None, None),
        method="highs",
    )
    assert less.status == 2


def exactly(mode: Mode) -> tuple[Fraction, Fraction]:
    return Fraction(repr(mode.frequency)), Fraction(repr(mode.damping))


def test_sequences_that_exist_are_never_refuted():
    """Random weights, against ZV on its own two samples, which deflects by half."""
    chance, mode = np.random.default_rng(5), Mode(2.0)
    asked = Asked((exactly(mode),), 0, Fraction(1, 10), 16, Fraction(6, 10), (Fraction(0), Fraction(1)))  # 1.6 s; ZV takes 1.571 s
    proven = 0
    for _ in range(300):
        left = [Left(0, 0, (Fraction(float(chance.normal())), Fraction(float(chance.normal()))))]
        strayed = [Strayed(0, int(chance.integers(0, 17)), bool(chance.integers(0, 2)), Fraction(float(chance.normal()))) for _ in range(2)]
        assert not none_on_samples(asked, left, strayed)
        proven += none_on_samples(replace(asked, count=3), left, [replace(one, sample=one.sample % 4) for one in strayed])
    assert proven > 3, "weights do prove what is true"
    good = Asked((exactly(mode),), 0, Fraction(1, 10), 3, Fraction(6, 10), (Fraction(0), Fraction(1)))
    left = [Left(0, 0, (Fraction(1), Fraction(0)))]
    assert none_on_samples(good, left, [])  # cos(2t) > 0 for |t| ≤ 0.3
    for broken in (
        replace(good, interval=Fraction(0)),
        replace(good, count=0),
        replace(good, sums=(Fraction(1), Fraction(0))),
        replace(good, modes=((Fraction(2), Fraction(1)),)),
        replace(good, limit=Fraction(-1)),
    ):
        assert not none_on_samples(broken, left, [])
    assert not none_on_samples(good, [replace(left[0], power=1)], [])
    assert not none_on_samples(good, [replace(left[0], mode=-1)], [])
    assert not none_on_samples(good, left, [Strayed(0, 4, True, Fraction(1))])
