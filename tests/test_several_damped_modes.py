"""Several modes of much damping at once: what is left, in many digits, and how short such sequences could be."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from flint import arb, arb_mat
from marks import slow
from scipy.optimize import linprog

from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.at_once import dips_at_once, positive_at_once
from relaxations.shaping.decayed import least_up_to_one
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.insensitive import specified
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.requests import Request
from relaxations.shaping.shapers import Shaper, convolve
from relaxations.shaping.simplex import cheapest
from relaxations.shaping.sums_within import _of_instants
from relaxations.shaping.touching import least_of_positive

TURN = 2.0 * math.pi
TIGHT = 1e-7  # relative: duration and least duration; a proof takes a few 1e-9 for each impulse, edges drawn apart 1.5e-8
ROUNDED = 1e-12  # of the largest term, of what vanishes: doubles of instants and amplitudes


def modes_of(*pairs: tuple[float, float]) -> tuple[Mode, ...]:
    return tuple(Mode(TURN * frequency, damping) for frequency, damping in pairs)


def left(shaper: Shaper, mode: Mode, power: int) -> float:
    """Of the largest term, in numbers of 64 bits."""
    times, sizes = (np.array(numbers, dtype=np.longdouble) for numbers in (shaper.times, shaper.amplitudes))
    zeta, omega = np.longdouble(mode.damping), np.longdouble(mode.frequency)
    phases = omega * np.sqrt(1 - zeta * zeta) * times
    terms = sizes * (times / times[-1]) ** power * np.exp(zeta * omega * times)
    return float(np.hypot((terms * np.cos(phases)).sum(), (terms * np.sin(phases)).sum()) / np.abs(terms).max())


@pytest.mark.parametrize(
    ("kind", "pairs", "derivatives"),
    [
        ("zv", ((1.0, 0.95), (2.7, 0.95), (4.1, 0.95)), 0),
        ("zv", ((1.0, 0.99), (2.7, 0.0)), 0),
        ("zvd", ((1.0, 0.9), (2.7, 0.9)), 1),
        ("um-zv", ((1.0, 0.99), (2.7, 0.99)), 0),
        ("um-zv", ((1.0, 0.99), (2.7, 0.0)), 0),
        slow("um-zvd", ((1.0, 0.99), (2.7, 0.99)), 1),
    ],
)
def test_nothing_is_left_and_none_is_shorter(kind: str, pairs: tuple[tuple[float, float], ...], derivatives: int) -> None:
    modes = modes_of(*pairs)
    made = make(kind, Request(modes, simultaneous=True))
    assert math.isclose(math.fsum(made.shaper.amplitudes), 1.0, abs_tol=1e-12)
    for mode in modes:
        for power in range(derivatives + 1):
            assert left(made.shaper, mode, power) < ROUNDED * mode.frequency * made.shaper.duration
    assert made.least is not None
    assert made.shaper.duration * (1.0 - TIGHT) < made.least.duration <= made.shaper.duration
    if kind.startswith("zv"):  # convolved, impulses 1, -1, 1 … have partial sums beyond [0, 1]
        assert made.shaper.duration < make(kind, Request(modes)).shaper.duration
    sums = np.cumsum(made.shaper.amplitudes)
    assert sums.min() >= -1e-15
    assert sums.max() <= 1.0 + 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ei", "um-ei"])
def test_humps_of_modes_that_decay_take_what_their_decay_takes(kind: str) -> None:
    """The tolerance over ranges from 0.088 (um-ei: 0.035) of the frequency on: one impulse, and when it has decayed enough."""
    modes = modes_of((1.0, 0.99), (2.7, 0.99))
    made = make(kind, Request(modes, tolerance=0.05, simultaneous=True))
    assert made.least is not None
    ends = [band.ends[0] for _, band in made.ranges]
    assert made.shaper.duration == pytest.approx(math.log(1.0 / 0.05) / (0.99 * min(ends)), rel=2e-6)  # the grid's is longer by 1e-6
    assert made.least.duration == pytest.approx(made.shaper.duration, rel=2e-6 if kind == "ei" else 2e-5)  # a bracket of 1e-5


def test_impulses_at_one_instant_are_one() -> None:
    times, sizes = np.array([0.0, 1.0, 2.0, 2.0, 2.0 - 1e-15, 3.0, 3.0]), np.array([1.0, -1.0, 1.0, -1.0, 1.0, 0.25, -0.25])
    shaper = _of_instants(times, sizes)
    assert shaper.times == (0.0, 1.0, 2.0, 3.0)
    assert shaper.amplitudes == (1.0, -1.0, 1.0, 0.0)


def test_more_impulses_than_equations_by_two() -> None:
    """Of modes that decay so differently the shortest has six impulses, whose places the multipliers tell."""
    modes = modes_of((1.0, 0.9), (2.7, 0.5))
    shaper, lower = positive_at_once([(mode, 1) for mode in modes])
    assert len(shaper.times) == 6
    assert max(left(shaper, mode, power) for mode in modes for power in (0, 1)) < ROUNDED
    assert lower is not None
    assert shaper.duration * (1.0 - 2e-6) < lower < shaper.duration  # the margin that is tried first is 1e-6


def test_more_dips_than_zeros_are_told_by_what_is_0_at_their_edges() -> None:
    """Five dips of two double zeros; the duration is the one that programs on a grid find, with its certificate."""
    modes = modes_of((1.0, 0.9), (2.7, 0.5))
    shaper, lower = dips_at_once(modes, Fraction(0), 1)
    assert shaper.amplitudes == (1.0, *[-1.0, 1.0] * 5)
    assert shaper.duration == pytest.approx(2.2721556501142895, rel=1e-14)
    assert max(left(shaper, mode, power) for mode in modes for power in (0, 1)) < ROUNDED
    assert lower is not None
    assert shaper.duration * (1.0 - 1e-12) < lower <= shaper.duration * (1.0 + 1e-15)


def test_deeper_dips_are_shorter_and_refuted_as_such() -> None:
    modes = modes_of((1.0, 0.9), (2.7, 0.1))
    durations = [dips_at_once(modes, Fraction(lower), 0)[0].duration for lower in (0, -1)]
    leasts = [dips_at_once(modes, Fraction(lower), 0)[1] for lower in (0, -1)]
    assert durations[1] < durations[0]
    assert leasts == pytest.approx(durations, rel=1e-12)


@pytest.mark.parametrize(("dampings", "upper"), [((0.99, 0.5), 1.5), ((0.9999, 0.99), 1.1)])
def test_sums_beyond_1_end_before_modes_decay(dampings: tuple[float, float], upper: float) -> None:
    """HiGHS on a grid: 1 % less does not do, 1 % more does."""
    modes = modes_of((1.0, dampings[0]), (2.7, dampings[1]))
    made = make("sums-zv", Request(modes, simultaneous=True, sums=(0.0, upper)))
    assert max(left(made.shaper, mode, 0) for mode in modes) < ROUNDED
    assert made.least is not None
    assert made.shaper.duration * (1.0 - 1e-12) < made.least.duration <= made.shaper.duration

    def exists(duration: float) -> bool:
        """Levels S_k of cells: z(T) - Σ S_k Δz_k = 0."""
        instants = np.linspace(-duration, 0.0, 1001)
        z = np.array([np.exp(mode.frequency * mode.direction * instants) for mode in modes], dtype=np.complex128)
        z = np.concatenate([z.real, z.imag])
        found = linprog(
            np.zeros(1000),
            A_eq=np.diff(z, axis=1),
            b_eq=z[:, -1],
            bounds=(0.0, upper),
            method="highs",
        )
        return found.status == 0

    assert not exists(0.99 * made.shaper.duration)
    assert exists(1.01 * made.shaper.duration)


def test_the_same_as_cone_programs_where_these_tell() -> None:
    zeros = [(mode, 0) for mode in modes_of((1.0, 0.3), (2.7, 0.4))]
    shaper, _ = positive_at_once(zeros)
    other = specified([], zeros).shaper
    assert shaper.times == pytest.approx(other.times, rel=1e-7)  # polished to 1e-12 of equations of order one
    assert shaper.amplitudes == pytest.approx(other.amplitudes, rel=1e-6)


@pytest.mark.parametrize("derivatives", [0, 1])
def test_one_mode_has_a_closed_form(derivatives: int) -> None:
    mode = Mode(3.0, 0.97)
    shaper, lower = positive_at_once([(mode, derivatives)])
    assert shaper.times == pytest.approx(derivative_shaper(mode, derivatives).times, rel=1e-14)
    assert shaper.amplitudes == pytest.approx(derivative_shaper(mode, derivatives).amplitudes, rel=1e-12)
    assert (lower or math.inf) <= (derivatives + 1) * mode.half_period
    sums, least = dips_at_once([mode], Fraction(0), derivatives)
    assert least is not None
    assert sums.duration * (1.0 + 1e-14) > least > least_up_to_one(mode, derivatives) * (1.0 - TIGHT)  # instants are doubles


def test_nothing_is_proven_of_what_can_be_shorter() -> None:
    """The convolution is no shortest one, and neither is one that leaves something: what is claimed is below what there is."""
    modes = modes_of((1.0, 0.9), (2.7, 0.9))
    shaper, _ = positive_at_once([(mode, 0) for mode in modes])
    convolved = convolve(derivative_shaper(modes[0]), derivative_shaper(modes[1]))
    longer = Shaper(tuple(1.001 * t for t in shaper.times), shaper.amplitudes)
    for other in (convolved, longer):
        assert (least_of_positive(modes, other) or 0.0) <= shaper.duration


def test_least_duration_of_a_convolution_is_that_of_all_modes() -> None:
    modes = modes_of((1.0, 0.95), (2.7, 0.95), (4.1, 0.95))
    made = make("zv", Request(modes))
    assert made.least is not None
    assert made.least.duration > 0.99 * made.shaper.duration  # one mode alone takes 1.60 s of 2.58 s
    assert not made.notes


@pytest.mark.slow
def test_least_duration_of_convolved_humps_is_that_of_all_zeros() -> None:
    """Of two modes at a damping of 0.99: 7.50 s; the zeros of one of them alone take 5.48 s."""
    made = make("ei", Request(modes_of((1.0, 0.99), (2.7, 0.99))))
    assert made.least is not None
    assert made.shaper.duration * (1.0 - 1e-5) < made.least.duration < made.shaper.duration


@pytest.mark.parametrize("kind", ["zv", "um-zv"])
def test_what_doubles_do_not_hold_is_told_with_what_they_do(kind: str) -> None:
    with pytest.raises(SolverError, match=r"dampings of 0\.9999\d* times these are possible"):
        make(kind, Request(modes_of((1.0, 0.99999), (2.7, 0.99999)), simultaneous=True))


def test_the_simplex_method_and_highs() -> None:
    random = np.random.default_rng(5)
    for _ in range(5):
        table, costs = random.normal(size=(4, 12)), random.integers(1, 9, 12)
        aim = np.abs(table @ random.uniform(size=12))
        table[table @ np.ones(12) < 0.0] *= -1.0
        with precision(192):
            rows, right = [[arb(x) for x in row] for row in table.tolist()], [[arb(x)] for x in aim.tolist()]
            ours = cheapest(arb_mat(rows), arb_mat(right), costs.tolist())
        theirs = linprog(costs, A_eq=table, b_eq=aim, bounds=(0.0, None), method="highs")
        assert (ours is None) == (theirs.status == 2)
        if ours is not None:
            assert sum(float(weight) * costs[column] for column, weight in ours.weights) == pytest.approx(theirs.fun, rel=1e-7)
