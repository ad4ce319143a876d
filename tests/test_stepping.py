from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuError
from fmus.stepping import MERGE, Experiment, RunStatus, Trajectory, grid, multiples, samples, step_sizes
from relaxations.commands import Command, Segment, Tail

BANG = Command(2.5, (Segment(0.0, 1.0), Segment(1.003, -1.0)), Tail(0.0))


def test_regular_points_are_multiples_not_sums() -> None:
    times = grid(0.0, 100.0, 0.1)
    assert times.tolist() == [n * 0.1 for n in range(1000)] + [100.0]
    assert np.cumsum(np.full(1000, 0.1))[-1] != 100.0  # what accumulation would have given


def test_the_stop_time_is_reached_though_it_is_no_multiple() -> None:
    assert grid(0.0, 1.0, 0.3).tolist() == [0.0, 0.3, 0.6, 3 * 0.3, 1.0]


def test_breakpoints_are_points_and_replace_near_neighbours() -> None:
    nudged = 0.2 + 1e-12
    assert grid(0.0, 0.4, 0.1, (0.0, nudged, 0.25, 0.4, 7.0)).tolist() == [0.0, 0.1, nudged, 0.25, 3 * 0.1, 0.4]


@pytest.mark.parametrize(("stop", "step"), [(1.0, 0.0), (1.0, -1.0), (1.0, np.nan), (1.0, np.inf), (0.0, 0.1), (np.nan, 0.1)])
def test_refuses_a_run_that_goes_nowhere(stop: float, step: float) -> None:
    with pytest.raises(FmuError):
        grid(0.0, stop, step)


@given(
    stop=st.floats(0.01, 50.0),
    count=st.floats(0.3, 500.0),
    parts=st.lists(st.floats(0.0, 1.2), max_size=8),
)
def test_every_grid(stop: float, count: float, parts: list[float]) -> None:
    step = stop / count
    breakpoints = [p * stop for p in parts]
    times = grid(0.0, stop, step, breakpoints)
    assert (times[0], times[-1]) == (0.0, stop)
    assert np.all(np.diff(times) > 0.9 * MERGE * step)
    assert np.all(np.diff(times) <= step * (1 + 2 * MERGE))
    for point in breakpoints:
        if point < stop:
            assert np.min(np.abs(times - point)) <= MERGE * step * 1.0000001  # merged with another breakpoint, at most
    regular = np.round(times / step) * step
    known = np.array([*breakpoints, stop])
    for time, multiple in zip(times, regular, strict=True):
        assert time == multiple or time in known


def test_the_last_step_does_not_pass_the_stop_time() -> None:
    for stop in np.random.default_rng(3).uniform(1.0, 90.0, 200):
        times = grid(0.0, float(stop), 0.07)
        sizes = step_sizes(times)
        assert times[-2] + sizes[-1] <= stop
        assert abs(sizes[-1] - (stop - times[-2])) <= 1e-15 * 90.0  # one unit in the last place


def test_a_grid_of_one_step_reaches_a_stop_that_is_no_multiple() -> None:
    """Nothing is cut off: asked for 1.0 with steps of 0.3, it ends at 1.2."""
    assert multiples(1.0, 0.3).tolist() == [0.0, 0.3, 0.6, 3 * 0.3, 4 * 0.3]
    assert samples(0.3 * 7, 0.3) == 7
    assert samples(1e-9, 0.3) == 1


def test_a_grid_of_one_step_refuses_a_jump_beside_it() -> None:
    assert len(multiples(4.0, 0.5, (0.0, 1.5, 2.5 + 1e-12))) == 9
    assert len(multiples(1.0, 0.5, (1.003,))) == 3, "what comes after the stop does not matter"
    with pytest.raises(FmuError, match=r"changes at 1\.003 s, which is no multiple of the step 0\.5 s"):
        multiples(4.0, 0.5, BANG.breakpoints)


def test_a_refined_run_has_half_the_step_and_a_tenth_of_the_tolerance() -> None:
    experiment = Experiment(Path("x.fmu"), "u", ("y",), {}, 0.0, {}, BANG, 4.0, 0.5)
    finer = experiment.refined()
    assert (finer.step, finer.stop) == (0.25, 4.0)
    assert finer.tolerance == pytest.approx(1e-11)


def test_a_trajectory_cannot_be_changed() -> None:
    trajectory = Trajectory(np.zeros(2), np.zeros(2), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="read-only"):
        trajectory.values[0, 0] = 1.0


def test_every_status_is_a_sentence_and_two_are_complete() -> None:
    assert {s for s in RunStatus if s.complete} == {RunStatus.FINISHED, RunStatus.WARNING}
    assert len({s.value for s in RunStatus}) == len(RunStatus)


@pytest.mark.parametrize("points", [grid, multiples])
def test_more_points_than_memory_holds_are_refused(points: Callable[..., object]) -> None:
    arguments = (0.0, 1e9, 1e-6) if points is grid else (1e9, 1e-6)
    with pytest.raises(FmuError, match=r"1e\+15 communication points, more than 20,000,000"):
        points(*arguments)
