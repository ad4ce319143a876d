"""What an FMU is told of a command, step by step: constants and lines with the command's own moments."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.linalg import expm

from fmus.inputs import NEGLIGIBLE, PARTS, Told, constants, instants, lines
from fmus.stepping import Array, grid
from relaxations.commands import Command, Segment, Tail, TailTerm

BANG = Command(2.5, (Segment(0.0, 1.0), Segment(1.003, -1.0)), Tail(0.0))
SLOPED = Command(2.0, (Segment(1.0, 0.5, 2.0), Segment(2.0, 1.0)), Tail(0.25, (TailTerm(-1.0 + 2.0j, 0, 0.75 + 0.5j),)))
REPEATED = Command(0.0, (), Tail(0.0, (TailTerm(-2.0 + 0.0j, 2, 1.0 + 0.0j),)))
POINTS, WEIGHTS = leggauss(40)
TELLERS = [lines, constants, instants]


@pytest.mark.parametrize("tell", TELLERS)
def test_the_input_between_two_points_is_the_one_after_the_jump(tell) -> None:
    times = grid(0.0, 4.0, 0.5, BANG.breakpoints)
    told = tell(BANG, times, 0.0)
    assert told.times.tolist() == times.tolist()
    assert told.logged.tolist() == list(range(len(times)))
    assert told.levels.tolist() == [1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 0.0, 0.0, 0.0]
    assert not told.slopes.any()


@pytest.mark.parametrize("tell", TELLERS)
def test_a_jump_that_lies_a_rounding_error_after_a_point_is_not_lost(tell) -> None:
    late = BANG.shifted(1e-15)
    assert tell(late, grid(0.0, 4.0, 0.5, late.breakpoints), 0.0).levels[0] == 1.0


@pytest.mark.parametrize("tell", TELLERS)
def test_before_the_command_the_input_rests(tell) -> None:
    assert tell(SLOPED, grid(0.0, 3.0, 0.25, SLOPED.breakpoints), -0.5).levels[:4].tolist() == [-0.5] * 4


def test_lines_are_the_slopes_themselves_and_nothing_is_divided_for_them() -> None:
    times = grid(0.0, 3.0, 0.25, SLOPED.breakpoints)
    told = lines(SLOPED, times, 0.0)
    moving = told.times[:-1] < 3.0
    assert told.times.tolist() == times.tolist()
    np.testing.assert_array_equal(told.levels[moving], SLOPED(told.times[:-1])[moving])
    assert told.slopes.tolist() == [0.0] * 4 + [2.0] * 4 + [0.0] * 4


@pytest.mark.parametrize("command", [SLOPED, REPEATED])
@pytest.mark.parametrize("tell", [lines, constants])
def test_what_is_told_has_the_command_s_mean_and_first_moment(tell, command: Command) -> None:
    times = grid(0.0, 6.0, 0.25, command.breakpoints)
    told = tell(command, times, 0.0)
    for left, right, a, b in zip(told.logged[:-1], told.logged[1:], times[:-1].tolist(), times[1:].tolist(), strict=True):
        piece = [p for p in command.pieces() if p.start <= (a + b) / 2][-1]
        middle = (a + b) / 2
        for power in (0, 1):
            points = middle + (b - a) / 2 * POINTS  # forty: exact to rounding
            exact = (b - a) / 2 * sum(w * piece(t) * (t - middle) ** power for t, w in zip(points.tolist(), WEIGHTS, strict=True))
            assert moment(told, left, right, middle, power) == pytest.approx(exact, rel=1e-11, abs=1e-14)


def moment(told: Told, left: int, right: int, middle: float, power: int) -> float:
    """∫ u (t - middle)^power of what is told between two of its times, in closed form."""
    total = 0.0
    for i in range(left, right):
        a, b = told.times[i] - middle, told.times[i + 1] - middle
        level = told.levels[i] - told.slopes[i] * a  # the line's value at `middle`
        total += level * (b ** (power + 1) - a ** (power + 1)) / (power + 1)
        total += told.slopes[i] * (b ** (power + 2) - a ** (power + 2)) / (power + 2)
    return total


def test_a_division_ends_when_the_tail_has_decayed() -> None:
    times = grid(0.0, 60.0, 0.5, REPEATED.breakpoints)
    for tell in (lines, constants):
        told = tell(REPEATED, times, 0.0)
        divided = np.diff(told.logged)
        assert set(divided.tolist()) == {1, PARTS}
        last = times[:-1][divided == PARTS].max()
        assert 10.0 < last < 30.0
        assert abs(REPEATED.tail(last + 1.0)) < 1e3 * NEGLIGIBLE


def response(told: Told) -> Array:
    """A damped oscillator of 3 rad/s at the logged times, exact for constants and lines."""
    A, B = np.array([[0.0, 1.0], [-9.0, -0.1]]), np.array([0.0, 9.0])
    state: Array = np.zeros(2)
    rows: list[Array] = [state]
    for h, level, slope in zip(np.diff(told.times), told.levels, told.slopes, strict=True):
        step = np.zeros((4, 4))
        step[:2, :2], step[:2, 2], step[2, 3] = A, B, 1.0
        state = np.asarray(expm(step * h) @ [*state, level, slope], dtype=np.float64)[:2]
        rows.append(state)
    return np.array(rows)[told.logged]


@pytest.mark.slow
@pytest.mark.parametrize("tell", [lines, constants])
def test_the_error_is_of_fourth_order(tell) -> None:
    steps = [0.4, 0.2, 0.1]
    grids = [grid(0.0, 4.0, h, SLOPED.breakpoints) for h in (*steps, 0.0125)]
    *coarse, finest = [response(tell(SLOPED, times, 0.0)) for times in grids]
    reference = dict(zip(grids[-1].tolist(), finest, strict=True))
    errors = [
        max(np.abs(row - reference[t]).max() for t, row in zip(times.tolist(), rows, strict=True) if t in reference)
        for times, rows in zip(grids, coarse, strict=False)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 3.8).all(), (errors, orders)
    assert (orders < 4.2).all(), (errors, orders)
    assert errors[-1] < 1e-5
