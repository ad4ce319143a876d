"""Least durations of shapers with humps, with negative impulses, on samples and on intervals: proven, and against independent programs."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog

from relaxations.checking.durations import Condition, none_as_short, none_on_samples
from relaxations.checking.pulse_widths import Halves, Vanishing, Weights, no_widths
from relaxations.shaping.impulses import negative_zv
from relaxations.shaping.kinds import make
from relaxations.shaping.least_durations import Remnant, least_duration
from relaxations.shaping.modes import Mode
from relaxations.shaping.pulse_intervals import Pulses, _Search, search
from relaxations.shaping.pulses import at_intervals
from relaxations.shaping.requests import Request
from relaxations.shaping.sampled import sampled
from relaxations.shaping.shapers import Shaper

ONE, TWO = (Mode(2 * math.pi, 0.05),), (Mode(2 * math.pi, 0.05), Mode(17.0, 0.02))
TRIED = 1.1e-6  # relative distance of a bound that is the optimum itself: it is tried at 1e-7 and 1e-6 first


def negative_total(shaper: Shaper) -> float:
    return -sum(amplitude for amplitude in shaper.amplitudes if amplitude < 0.0)


def excess(modes: tuple[Mode, ...], duration: float, negative: float, cells: int = 400) -> float:
    """HiGHS: the least largest part (real or imaginary) that is left by impulses on a grid whose negative ones sum to so much at most."""
    since = np.linspace(-duration, 0.0, cells + 1)
    rows = np.array([np.exp(mode.frequency * mode.direction * since) for mode in modes])
    table = np.vstack([np.real(rows), np.imag(rows)])
    n, ones = cells + 1, np.ones((2 * len(table), 1))
    both = np.vstack([np.hstack([table, -table]), -np.hstack([table, -table])])
    found = linprog(
        np.append(np.zeros(2 * n), 1.0),
        A_ub=np.vstack([np.hstack([both, -ones]), np.concatenate([np.zeros(n), np.ones(n), [0.0]])]),
        b_ub=np.append(np.zeros(len(both)), negative),
        A_eq=np.concatenate([np.ones(n), -np.ones(n), [0.0]])[None, :],
        b_eq=[1.0],
        bounds=(0.0, None),
        method="highs",
    )
    assert found.status == 0
    return float(found.fun)


@pytest.mark.parametrize("kind", ["ei", "2-hump-ei", "3-hump-ei", "um-ei", "um-2-hump-ei"])
@pytest.mark.parametrize("damping", [0.0, 0.1, 0.2])
def test_humped_shapers_of_one_mode_are_the_shortest_with_their_zeros(kind: str, damping: float):
    made = make(kind, Request((Mode(3.0, damping),)))
    assert made.least is not None
    assert len(made.least.zeros) == (int(found[0]) if (found := [c for c in kind if c.isdigit()]) else 1) + 1
    assert made.least.duration <= made.shaper.duration
    assert made.least.duration == pytest.approx(made.shaper.duration, rel=TRIED)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("negative", [0.2, 1.0, 3.0])
def test_the_specified_negative_amplitude_is_the_shortest_of_its_size(negative: float, damping: float):
    """Undamped `2 arccos(b/(1 + b))/ω`, in closed form."""
    mode = Mode(2.0, damping)
    shaper = negative_zv(mode, negative)
    lower = least_duration([Remnant(mode)], negative, shaper.duration)
    assert lower is not None
    assert lower <= shaper.duration
    assert lower == pytest.approx(shaper.duration, rel=TRIED)
    if damping == 0.0:
        assert lower == pytest.approx(math.acos(negative / (1 + negative)), rel=TRIED)


@pytest.mark.parametrize("kind", ["sna-zv", "custom"])
def test_bounds_of_several_modes_agree_with_an_independent_program(kind: str):
    impulses = make("sna-zv", Request(TWO, negative=0.4)).shaper
    made = make(kind, Request(TWO, negative=0.4) if kind == "sna-zv" else Request(TWO, impulses=impulses))
    assert made.least is not None
    assert made.least.duration < made.shaper.duration  # convolution is longer
    negative = negative_total(made.shaper)
    assert excess(TWO, 0.99 * made.least.duration, negative) > 1e-4
    assert excess(TWO, 1.01 * made.least.duration, negative) < 1e-5


@pytest.mark.parametrize(("kind", "sums"), [("um-zv", "[0, 1]"), ("um-zvd", "[-1, 2]"), ("um-ei", "[-1, 2]")])
def test_unity_magnitude_in_turn_is_bounded_by_what_its_own_partial_sums_allow(kind: str, sums: str):
    turn = make(kind, Request(TWO))
    assert turn.least is not None
    assert f"partial sums in {sums} and" in turn.least.among
    partial = np.cumsum(turn.shaper.amplitudes)
    assert sums == f"[{min(0, round(partial.min()))}, {round(partial.max())}]"
    assert 0.7 * turn.shaper.duration < turn.least.duration < turn.shaper.duration
    if kind == "um-zv":
        assert turn.least.duration == pytest.approx(make(kind, Request(TWO, simultaneous=True)).shaper.duration, rel=1e-12)


def test_given_impulses_are_bounded_by_what_they_leave_and_nothing_is_claimed_of_those_that_leave_all():
    zv = make("zv", Request(ONE)).shaper
    same = make("custom", Request(ONE, impulses=zv)).least
    assert same is not None
    assert same.duration == pytest.approx(zv.duration, rel=1e-5)  # of rounding the given impulses leave a little
    half = make("custom", Request(ONE, impulses=Shaper((0.0, 0.3, 0.7), (0.25, 0.5, 0.25)))).least
    assert half is not None
    assert half.duration < 0.45
    assert make("custom", Request((Mode(math.pi),), impulses=Shaper((0.0, 2.0), (0.5, 0.5)))).least is None
    assert make("none", Request(ONE)).least == replace(same, duration=0.0, among="all shapers", zeros=())


def test_the_checker_refuses_every_duration_of_a_shaper_with_negative_impulses_that_exists():
    """Random weights and levels: none may be proven too short."""
    chance, mode = np.random.default_rng(4), Mode(1.0, 0.1)
    shaper = negative_zv(mode, 0.5)
    duration = Fraction(shaper.duration) * Fraction(10001, 10000)
    proven, asked = 0, []
    for _ in range(300):
        phase, level = chance.uniform(0.0, 2 * math.pi), Fraction(float(chance.uniform(0.3, 1.1)))
        weight = Fraction(math.cos(phase)), Fraction(math.sin(phase))
        asked = [Condition(Fraction(1), Fraction(1, 10), Fraction(0), 0, weight)]
        assert not none_as_short(duration, asked, Fraction(1, 2), level)
        proven += none_as_short(duration / 3, asked, Fraction(1, 2), level)
    assert proven > 10, "the same weights do prove what is true"
    assert not none_as_short(duration / 3, asked, Fraction(-1), Fraction(1))


@pytest.mark.parametrize("derivatives", [0, 1])
@pytest.mark.parametrize("step", [0.025, 0.11])
@pytest.mark.parametrize("modes", [ONE, TWO], ids=["one", "two"])
def test_on_samples_one_less_does_not_do(modes: tuple[Mode, ...], step: float, derivatives: int):
    found = sampled([(mode, derivatives) for mode in modes], step)
    assert found.needed == round(found.shaper.duration / step)
    since = (np.arange(found.needed) - (found.needed - 1)) * step
    rows = [since**j * np.exp(m.frequency * m.direction * since) for m in modes for j in range(derivatives + 1)]
    table = np.vstack([np.ones(found.needed), *(part for row in rows for part in (row.real, row.imag))])
    less = linprog(np.zeros(found.needed), A_eq=table, b_eq=np.eye(len(table))[0], bounds=(0.0, None), method="highs")
    assert less.status == 2, "an independent program finds none either"


def test_samples_are_refuted_by_true_weights_only():
    def weight(turn: float) -> list[Condition]:
        return [Condition(Fraction(1), Fraction(0), Fraction(0), 0, (Fraction(math.cos(turn)), Fraction(math.sin(turn))))]

    assert none_on_samples(Fraction(1), 3, weight(-1.5))  # cos(t - 1.5) > 0 at 0, 1, 2, 3
    for turn in np.linspace(0.0, 2 * math.pi, 50):
        assert not none_on_samples(Fraction(1), 4, weight(float(turn)))  # 4 s are more than half a period
    assert not none_on_samples(Fraction(0), 3, weight(-1.5))


@pytest.mark.parametrize(("height", "interval", "derivatives"), [(6.54, 0.46, 1), (6.9, 0.35, 0), (3.31, 0.405, 1)])
def test_pulses_on_intervals_are_as_few_as_do(height: float, interval: float, derivatives: int):
    """The proof against all widths on a grid: none of them comes near."""
    found = at_intervals([Mode(2 * math.pi)], height, interval, derivatives)
    count = round(found.shaper.pulses[-1].start / interval) + 1
    assert found.intervals == count
    less = Pulses((Mode(2 * math.pi),), height, interval, derivatives, count - 1)
    grid = 13
    widths = np.linspace(0.0, interval, grid)
    at = less.starts[:, None] + widths
    rates = [2j * math.pi * power for power in (1, 1)][: derivatives + 1]
    parts = [height * np.broadcast_to(widths, at.shape)]
    for power, rate in enumerate(rates):
        whole = (lambda t, b=rate: np.exp(b * t) / b) if power == 0 else (lambda t, b=rate: np.exp(b * t) * (t / b - 1 / b**2))
        parts += [height * (whole(at) - whole(less.starts[:, None]))]
    left = [sum(part[k, choice[k]] for k in range(count - 1)) - (number == 0)
            for choice in [np.meshgrid(*[np.arange(grid)] * (count - 1))] for number, part in enumerate(parts)]  # fmt: skip
    assert np.max(np.abs(left), axis=0).min() > 1e-3


def _leaves(node: Weights | Halves) -> int:
    return 1 if isinstance(node, Weights) else _leaves(node.below) + _leaves(node.above)


def test_a_search_that_is_tampered_with_proves_nothing():
    asked = Pulses(ONE, 6.54, 0.46, 1, 4)
    tree = _Search(asked)._tree(np.zeros(4), np.full(4, 0.46))
    assert isinstance(tree, Halves)
    assert _leaves(tree) > 3
    conditions = [Vanishing(Fraction(repr(2 * math.pi)), Fraction("0.05"), power) for power in (0, 1)]

    def proved(search: Weights | Halves, count: int = 4, height: str = "6.54", interval: str = "0.46") -> bool:
        return no_widths(conditions, Fraction(height), Fraction(interval), count, search)

    assert proved(tree)
    assert not proved(tree, count=5), "five do"
    for broken in (
        replace(tree, below=tree.above),
        replace(tree, pulse=4),
        replace(tree, pulse=-1),
        replace(tree, at=Fraction(1)),
        replace(tree, above=Weights(Fraction(0), ())),
        replace(tree, above=Weights(Fraction(0), ((Fraction(0), Fraction(0)),) * 2)),
    ):
        assert not proved(broken)
    assert not proved(tree, interval="0")
    assert not no_widths([replace(conditions[0], damping=Fraction(1)), conditions[1]], Fraction("6.54"), Fraction("0.46"), 4, tree)
    assert search(asked).refuted


def test_widths_that_exist_are_never_refuted():
    chance, found = np.random.default_rng(2), at_intervals(ONE, 6.54, 0.46, 0)
    count = round(found.shaper.pulses[-1].start / 0.46) + 1
    conditions = [Vanishing(Fraction(repr(2 * math.pi)), Fraction("0.05"), 0)]
    for _, halved in itertools.product(range(40), (False, True)):
        one, other = (
            Weights(Fraction(float(chance.normal())), ((Fraction(float(chance.normal())), Fraction(float(chance.normal()))),))
            for _ in range(2)
        )
        tree = Halves(0, Fraction(float(chance.uniform(0.0, 0.46))), one, other) if halved else one
        assert not no_widths(conditions, Fraction("6.54"), Fraction("0.46"), count, tree)


def test_a_mode_that_is_named_twice_asks_for_no_more_than_once():
    """A plant with two equal modes would ask for a derivative more; a shaper does not."""
    mode = Mode(2.0, 0.1)
    one, two = (make("um-zv", Request(modes, simultaneous=True)) for modes in ((mode, mode), (mode,)))
    assert one.shaper.times == pytest.approx(two.shaper.times, rel=1e-12)
    turn = make("um-zv", Request((mode, mode)))
    assert turn.least is not None
    assert turn.least.duration <= make("sums-zv", Request((mode,), sums=(-1.0, 2.0))).shaper.duration * (1 + 1e-12)


def test_two_impulses_that_serve_two_modes_are_found_on_samples():
    """Half a second is half a period of 1 Hz and one and a half of 3 Hz: fewer impulses than equations, and the others are rounding."""
    found = sampled([(Mode(2 * math.pi), 0), (Mode(6 * math.pi), 0)], 0.05)
    assert found.needed == 10
    assert found.shaper.times == pytest.approx((0.0, 0.5))
    assert found.shaper.amplitudes == pytest.approx((0.5, 0.5), abs=1e-15)
