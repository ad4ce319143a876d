"""Shapers whose partial sums switch between two bounds: at any damping, of many derivatives, on samples; the shortest, proven."""

from __future__ import annotations

import itertools
import math
import re
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from marks import slow
from scipy.optimize import linprog

from relaxations.bounds import Status
from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bounded import bounded, bounded_on_samples
from relaxations.shaping.decayed import least_up_to_one
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left


@pytest.mark.parametrize(("damping", "derivatives"), [(0.97, 0), slow(0.97, 1), (0.99, 1), slow(0.3, 9), slow(0.0, 16)])
@pytest.mark.parametrize("bounds", [(0, 1), (Fraction(-1, 2), Fraction(3, 2))])
def test_both_sides_are_proven_at_any_damping(damping: float, derivatives: int, bounds: tuple[Fraction, Fraction]):
    mode = Mode(3.7, damping)
    found = bounded([mode], *bounds, derivatives)
    assert found.bound is not None
    assert found.bound.status is Status.PROVED
    assert found.lower is not None
    apart = len(found.shaper.times) != 2 * derivatives + 3  # steps of 2^-26 of the duration in place of impulses that are too close
    assert found.lower == pytest.approx(found.shaper.duration, rel=2.0**-25 if apart else 1e-14)
    assert left(found.shaper, mode, derivatives) <= 1e-8
    sums = list(itertools.accumulate(found.shaper.amplitudes))
    assert min(sums) >= float(bounds[0]) - 1e-12
    assert max(sums) <= float(bounds[1]) + 1e-12


def test_a_lower_side_is_proven_where_doubles_do_not_tell_the_impulses_apart():
    found = bounded([Mode(6.3, 0.999)], 0, 1)
    assert found.lower == pytest.approx(10.994505153812714, rel=1e-12)
    assert found.shaper.duration == pytest.approx(found.lower, rel=2.0**-25)
    assert left(found.shaper, Mode(6.3, 0.999)) <= 1e-13


def turned(angle: Decimal) -> tuple[Decimal, Decimal]:
    """cos and sin by their series, of a 2^-20th of the angle, squared."""
    small = angle / 2**20
    term, cosine, sine = Decimal(1), Decimal(0), Decimal(0)
    for k in range(80):
        sign = 1 if k % 4 < 2 else -1
        cosine, sine = (cosine + sign * term, sine) if k % 2 == 0 else (cosine, sine + sign * term)
        term = term * small / (k + 1)
    for _ in range(20):
        cosine, sine = cosine * cosine - sine * sine, 2 * cosine * sine
    return cosine, sine


def scaled_away(shaper: Shaper, mode: Mode, derivatives: int) -> float:
    """In 500 digits: what is left of the mode and its derivatives, as a fraction of the least of what single impulses do to it."""
    with localcontext() as digits:
        digits.prec = 500
        omega, zeta = Decimal(mode.frequency), Decimal(mode.damping)
        root = (1 - zeta * zeta).sqrt()
        times = list(map(Decimal, shaper.times))
        sizes = [Decimal(a) * (omega * zeta * t).exp() for t, a in zip(times, shaper.amplitudes, strict=True)]
        turns = [turned(omega * root * t) for t in times]
        most = Decimal(0)
        for k in range(derivatives + 1):
            moments = [(t / times[-1] if k else Decimal(1)) ** k * size for t, size in zip(times, sizes, strict=True)]
            parts = [sum((m * turn[i] for m, turn in zip(moments, turns, strict=True)), Decimal(0)) for i in (0, 1)]
            most = max(most, (parts[0] * parts[0] + parts[1] * parts[1]).sqrt())
        return float(most / min(map(abs, sizes)))


@pytest.mark.parametrize(("damping", "derivatives"), [(0.995, 1), (0.998, 1), (0.9999, 0), (0.99998, 0), slow(0.9999, 2), slow(0.995, 20)])
def test_zeros_are_zeros_beside_the_first_impulse_however_near_the_damping_is_to_1(damping: float, derivatives: int):
    """Not by decay: what is left is small beside what any single impulse would have left of itself."""
    mode = Mode(2 * math.pi, damping)
    made = make(f"um-zv-d:{derivatives}", Request((mode,)))
    assert scaled_away(made.shaper, mode, derivatives) < 1e-6  # heights rounded to 1e-16, steps that differ by 2^-26
    sums = list(itertools.accumulate(map(Fraction, made.shaper.amplitudes)))
    assert min(sums) > 0
    assert max(sums) == sums[-1] == 1  # exactly, as doubles
    assert made.least is not None
    assert made.shaper.duration * (1 - 1e-6) < made.least.duration <= made.shaper.duration


def test_with_one_zero_the_least_duration_is_that_of_sums_up_to_1():
    """1 + p ∫ x e^{pt} dt = 0 with x ≥ 0 takes ω_d t from 0 to π - arccos ζ at least: sums of positive multiples turn no farther."""
    for damping in (0.1, 0.7, 0.99, 0.9999):
        known = (math.pi - math.acos(damping)) / math.sqrt((1 - damping) * (1 + damping))
        assert least_up_to_one(Mode(1.0, damping), 0) == pytest.approx(known, rel=1e-12)


@pytest.mark.parametrize(("damping", "derivatives"), [(0.05, 1), (0.3, 0), (0.7, 2), (0.9, 1), (0.97, 2)])
def test_the_least_duration_in_closed_form_is_below_the_one_that_is_proven_with_a_costate(damping: float, derivatives: int):
    found = bounded([Mode(1.0, damping)], 0, 1, derivatives)
    assert found.bound is not None
    assert 0.0 <= found.closed <= found.bound.lower * (1 + 1e-14)
    if damping > 0.95:
        assert found.closed > 0.999 * found.bound.lower


@pytest.mark.parametrize("kind", ["zv", "zvdd", "mzv", "um-zv", "um-zvd", "ei", "2-hump-ei", "um-ei"])
def test_a_refusal_says_up_to_which_damping_and_up_to_there_it_is_made(kind: str):
    with pytest.raises((ShaperError, SolverError), match=r"up to a damping of 0\.9999\d+ it is possible") as refused:
        make(kind, Request((Mode(2 * math.pi, 0.9999999),)))
    named = re.search(r"up to a damping of (0\.9999\d+)", str(refused.value))
    assert named is not None
    if kind.endswith("ei"):  # minutes, in that many digits: the smallest amplitude itself
        return
    mode = Mode(2 * math.pi, float(named[1]))
    made = make(kind, Request((mode,)))
    assert left(made.shaper, mode, kind.count("d")) <= 1e-12
    assert 2.2e-308 < min(map(abs, made.shaper.amplitudes)) < 1e-298


def test_it_is_scaled_by_frequency_and_told_by_damping_continuously():
    lasts = [bounded([Mode(1.0, damping)], 0, 1, 1).shaper.duration for damping in (0.9799, 0.98, 0.9801)]
    assert lasts[0] < lasts[1] < lasts[2]
    assert lasts[2] - 2 * lasts[1] + lasts[0] == pytest.approx(0.0, abs=1e-2 * (lasts[2] - lasts[0]))
    assert bounded([Mode(40.0, 0.98)], 0, 1, 1).shaper.duration == pytest.approx(lasts[1] / 40.0, rel=1e-12)


def test_sums_within_0_and_1_are_unity_magnitude_where_programs_in_doubles_fail():
    request = Request((Mode(6.3, 0.99),), sums=(0.0, 1.0))
    sums, unity = make("sums-zvd", request), make("um-zvd", Request((Mode(6.3, 0.99),)))
    assert sums.shaper == unity.shaper
    assert sums.least is not None
    assert sums.least.duration == pytest.approx(6.90349176304735, rel=1e-13)
    assert sums.shaper.duration == pytest.approx(sums.least.duration, rel=2.0**-25)


def test_too_many_derivatives_are_refused_at_once():
    with pytest.raises(ShaperError, match="up to 20 are possible"):
        bounded([Mode(1.0)], 0, 1, 60)


def on_samples(modes: list[Mode], bounds: tuple[float, float], derivatives: int, step: float, samples: int) -> bool:
    """A program of its own for partial sums, time measured from the end: whether there are any."""
    instants = step * (np.arange(samples + 1) - samples)
    rows = []
    for mode in modes:
        for power in range(derivatives + 1):
            z = (instants / instants[0]) ** power * np.exp(
                complex(mode.damping, math.sqrt(1 - mode.damping**2)) * mode.frequency * instants
            )
            rows += [z.real, z.imag]
    table = np.array(rows)
    found = linprog(np.zeros(samples), A_eq=table[:, :-1] - table[:, 1:], b_eq=-table[:, -1], bounds=[bounds] * samples, method="highs")
    return found.status == 0


@pytest.mark.parametrize(
    ("modes", "bounds", "derivatives", "step"),
    [
        ([Mode(2 * math.pi, 0.02)], (0.0, 1.0), 0, 0.01),
        ([Mode(2 * math.pi, 0.02)], (0.0, 1.0), 1, 0.05),
        ([Mode(2 * math.pi, 0.5)], (-0.5, 1.5), 1, 0.02),
        ([Mode(2 * math.pi, 0.02), Mode(17.0, 0.1)], (0.0, 1.0), 0, 0.02),
    ],
)
def test_on_samples_nothing_is_left_and_fewer_do_not_do(modes: list[Mode], bounds: tuple[float, float], derivatives: int, step: float):
    shaper, needed = bounded_on_samples(modes, Fraction(bounds[0]), Fraction(bounds[1]), derivatives, step)
    places = np.array(shaper.times) / step
    assert np.abs(places - np.round(places)).max() < 1e-9
    assert round(places[-1]) == needed
    sums = list(itertools.accumulate(shaper.amplitudes))
    assert min(sums) >= bounds[0] - 1e-15
    assert max(sums[:-1]) <= bounds[1] + 1e-15
    assert all(left(shaper, mode, derivatives) <= 1e-12 for mode in modes)
    assert on_samples(modes, bounds, derivatives, step, needed)
    assert not on_samples(modes, bounds, derivatives, step, needed - 1)
    # A vertex: what is neither on a bound nor held from the sample before it is no more than the equations ask for.
    between = [s for s in sums[:-1] if min(abs(s - b) for b in bounds) > 1e-9]
    assert len(between) <= 2 * len(modes) * (derivatives + 1) + 1


def test_a_hair_above_the_instants_of_unity_magnitude_it_is_nearly_the_same():
    """Undamped 1, -1, 1 at sixths of the period; samples a little longer than that hold it with amplitudes a little below 1."""
    made = make("um-zv", Request((Mode(2 * math.pi),), sample_time=0.16667))
    assert made.shaper.times == pytest.approx((0.0, 0.16667, 0.33334))
    assert made.shaper.amplitudes == pytest.approx((1.0, -1.0, 1.0), abs=1e-4)
    assert max(made.shaper.amplitudes) < 1.0
    assert made.least is not None
    assert made.least.duration == pytest.approx(0.33334, rel=1e-15)
    assert "which need 2" in made.least.among


@pytest.mark.parametrize(
    ("damping", "derivatives", "near"),
    [
        (0.7, 12, 3e-8),  # steps of dips that are drawn apart
        slow(0.4, 20, 3e-8),
        (0.9, 12, 2e-4),  # the bound is that of partial sums without a lower end
    ],
)
def test_many_derivatives_with_damping_begin_with_deep_dips(damping: float, derivatives: int, near: float) -> None:
    mode = Mode(2.0 * math.pi, damping)
    made = make(f"um-zv-d:{derivatives}", Request((mode,)))
    assert made.least is not None
    assert made.least.duration <= made.shaper.duration < made.least.duration * (1.0 + near)
    assert left(made.shaper, mode, derivatives) < 1e-10
    sums = list(itertools.accumulate(map(Fraction, made.shaper.amplitudes)))
    assert min(sums) >= -Fraction(1, 10**15)
    assert max(sums) <= 1 + Fraction(1, 10**15)
