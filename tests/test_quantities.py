"""Every quantity on made-up observations whose answer is known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from numpy.typing import NDArray

from relaxations.commands import Command, Segment, Tail, TailTerm
from suite.quantities import DEFINITIONS, Facts, Observation, evaluate, window
from suite.quantity_names import QUANTITIES, parse_quantity

Reals = NDArray[np.float64]

MOVE = 2.0  # s
BANG = Command(MOVE, (Segment(0.0, 1.0), Segment(1.0, -1.0)), Tail(0.0))
PERIOD = 0.8  # s
OMEGA = 2 * math.pi / PERIOD
MODES = ((OMEGA, 0.0),)
STEP = PERIOD / 50  # the default communication step, at which a sampled peak is still 0.2 % too low


def observation(
    output: Callable[[Reals], Reals],
    *,
    displacement: float = 5.0,
    command: Command = BANG,
    rest: tuple[float, float] = (0.0, 0.0),
    modes: tuple[tuple[float, float], ...] = MODES,
    decayed: bool = False,
    stop: float = MOVE + 20 * PERIOD,
    bracket: tuple[float | None, float | None] = (None, None),
    step: float = STEP,
) -> Observation:
    """A run of which `output(t)` is the output, sampled as the stepper does: regular points and the command's breakpoints."""
    regular = np.arange(0.0, stop, step)
    times = np.unique(np.concatenate([regular, command.breakpoints, [stop]]))
    values = output(times)
    facts = Facts(displacement, rest[0], rest[1], modes, max((2 * math.pi / f for f, _ in modes), default=None), decayed, *bracket)
    variables = MappingProxyType({"output": values, "y": values, "spring": 3.0 - 0.5 * values})
    return Observation(times, command(times, rest[0]), values, np.zeros_like(values), variables, command, facts)


def value(run: Observation, quantity: str) -> float:
    return evaluate(run, parse_quantity(quantity))


def moved(amplitude: float, target: float = 5.0, decay: float = 0.0, offset: float = 0.0) -> Callable[[Reals], Reals]:
    """A straight line to the target, then a vibration about `target + offset`."""

    def output(t: Reals) -> Reals:
        since = np.maximum(t - MOVE, 0.0)
        return np.where(
            t < MOVE, (target + offset) * t / MOVE, target + offset + amplitude * np.exp(-decay * since) * np.sin(OMEGA * since)
        )

    return output


def test_every_quantity_that_can_be_asked_for_is_defined() -> None:
    assert DEFINITIONS.keys() == QUANTITIES.keys()


@pytest.mark.parametrize("displacement", [5.0, -5.0])
def test_residual_vibration_is_the_peak_between_the_samples_over_the_move(displacement: float) -> None:
    run = observation(moved(0.3, displacement), displacement=displacement)
    # A top between two equal samples is the worst case: the parabola lies (ωh)⁴/43 = 6e-6 below it, the higher sample alone 2e-3.
    assert value(run, "residual_vibration") == pytest.approx(0.06, rel=1e-5)
    assert value(run, "final_error") == pytest.approx(0.0, abs=1e-7)


def test_residual_vibration_of_a_damped_mode_is_its_first_peak_not_its_envelope() -> None:
    decay = 1.0
    run = observation(moved(0.5, decay=decay), decayed=True, modes=((math.hypot(OMEGA, decay), decay / math.hypot(OMEGA, decay)),))
    peak = math.atan2(OMEGA, decay) / OMEGA
    expected = 0.5 * math.exp(-decay * peak) * math.sin(OMEGA * peak) / 5.0
    assert expected < 0.9 * 0.1, "the envelope would give 0.1"
    assert value(run, "residual_vibration") == pytest.approx(expected, rel=5e-5)  # a damped peak is a little lopsided
    # What is left after 16 s is e^-16.
    assert value(run, "final_error") == pytest.approx(0.0, abs=1e-7)


def test_a_residual_is_about_the_rest_that_was_reached_and_the_final_error_about_the_target() -> None:
    run = observation(moved(0.3, offset=-0.25))
    assert value(run, "residual_vibration") == pytest.approx(0.06, rel=1e-5)
    assert value(run, "final_error") == pytest.approx(0.05, rel=1e-5)


def test_an_undamped_rest_is_the_middle_of_the_last_full_period_of_the_slowest_mode() -> None:
    drift = 0.01  # of the rest, per second: only the last period counts

    def output(t: Reals) -> Reals:
        return moved(0.3)(t) + drift * np.maximum(t - MOVE, 0.0)

    run = observation(output)
    middle = 5.0 + drift * (20 * PERIOD - PERIOD / 2)
    # The drift tilts the vibration, which shifts both extremes alike to first order; a quarter of a period of drift is the room.
    assert value(run, "final_error") == pytest.approx((middle - 5.0) / 5.0, abs=drift * PERIOD / 4 / 5.0)


def test_a_switch_beside_a_regular_point_is_no_slope() -> None:
    """Rounding between two samples 1e-9 steps apart must not be taken for a turning tangent."""
    run = observation(moved(0.0), step=(MOVE + 1e-9 * STEP) / 125)
    assert 0.0 < np.diff(run.times).min() < 1e-8 * STEP
    noise = np.where(np.arange(len(run.times)) % 2, 1e-13, 0.0)
    assert value(replace(run, output=run.output + noise), "residual_vibration") < 1e-13


def test_overshoot_counts_in_the_direction_of_the_move() -> None:
    def output(sign: float) -> Callable[[Reals], Reals]:
        # 0.5 beyond the target at 2 s, and 1.0 back before the start's side at 1 s
        return lambda t: sign * np.interp(t, [0.0, 1.0, 2.0, 3.0], [0.0, -1.0, 5.5, 5.0])

    for sign in (1.0, -1.0):
        assert value(observation(output(sign), displacement=5.0 * sign), "overshoot") == pytest.approx(0.1)
    assert value(observation(lambda t: np.minimum(t, 4.0)), "overshoot") == 0.0, "what falls short does not overshoot"


def test_targets_are_counted_from_the_first_rest() -> None:
    run = observation(lambda t: 7.0 + moved(0.0)(t), rest=(0.0, 7.0))
    assert value(run, "final_error") == pytest.approx(0.0, abs=1e-15)
    assert value(run, "overshoot") == pytest.approx(0.0, abs=1e-15)
    assert value(run, "settling_time(0.02)") == pytest.approx(0.98 * MOVE)


def test_settling_time_is_the_last_time_outside_the_band() -> None:
    """Into the band, out again and in for good: the last time counts."""
    times, values = [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 5.0, 5.5, 5.0, 5.0]
    run = observation(lambda t: np.interp(t, times, values))
    assert value(run, "settling_time(0.02)") == pytest.approx(2.8)  # 5.5 - 0.5 (t - 2) = 5.1
    assert value(run, "settling_time(0.2)") == pytest.approx(0.8)
    assert value(observation(lambda t: np.full_like(t, 5.0)), "settling_time(0.02)") == 0.0
    assert value(observation(moved(0.3)), "settling_time(0.02)") == math.inf, "a vibration of 6 % never settles to 2 %"
    delayed = observation(lambda t: np.interp(t - 3.0, times, values), stop=30.0)
    assert value(delayed, "settling_time(0.02)") == pytest.approx(5.8)


RAMP = Command(4.0, (Segment(0.0, 0.0, 0.5), Segment(2.0, 1.0, -0.5), Segment(3.0, 0.5, -0.5)), Tail(0.0))


def test_fuel_counts_from_the_input_at_rest_and_ends_with_the_move() -> None:
    assert value(observation(moved(0.0)), "fuel") == pytest.approx(2.0)
    held = Command(2.0, (Segment(0.0, 1.0), Segment(1.0, 0.0)), Tail(0.25))
    assert value(observation(moved(0.0), command=held), "fuel") == pytest.approx(1.0), "what holds the plant afterwards does not count"
    raised = observation(moved(0.0), command=held, rest=(0.25, 0.0))
    assert value(raised, "fuel") == pytest.approx(0.75 + 0.25)
    late = observation(moved(0.0), command=BANG.shifted(1.5))
    assert value(late, "fuel") == pytest.approx(2.0)


def test_fuel_of_slopes_converges_to_the_area() -> None:
    exact = RAMP.fuel()
    assert exact == pytest.approx(2.0)
    errors = [abs(value(observation(moved(0.0), command=RAMP, step=h), "fuel") - exact) for h in (0.1, 0.05)]
    assert errors[0] < 0.1 * 1.0, "at most a step of the peak"
    assert errors[1] < 0.6 * errors[0] + 1e-12


def test_peaks_of_the_input() -> None:
    run = observation(moved(0.0), command=Command(2.0, (Segment(0.0, 1.0), Segment(1.0, -3.0)), Tail(0.0)))
    assert value(run, "peak_input") == 3.0
    assert value(observation(moved(0.0), rest=(2.0, 0.0), command=BANG.shifted(1.0)), "peak_input") == 2.0, "the input, not its deviation"


def test_the_rate_of_a_jump_is_infinite_wherever_it_is() -> None:
    assert value(observation(moved(0.0)), "peak_rate") == math.inf
    smooth = Command(2.0, (Segment(0.0, 0.0, 1.0), Segment(1.0, 1.0, -1.0)), Tail(0.0))
    assert value(observation(moved(0.0), command=smooth), "peak_rate") == 1.0
    assert value(observation(moved(0.0), command=smooth, rest=(0.5, 0.0)), "peak_rate") == math.inf, "from the rest to the first level"
    dropped = Command(2.0, (Segment(0.0, 0.0, 1.0), Segment(1.0, 1.0, -0.5)), Tail(0.0))
    assert value(observation(moved(0.0), command=dropped), "peak_rate") == math.inf, "from the last level to the tail"
    resting = Command(1.0, (Segment(0.0, 0.0),), Tail(0.0))
    assert value(observation(moved(0.0), command=resting), "peak_rate") == 0.0


def test_the_rate_of_a_tail_counts() -> None:
    term = TailTerm(-2.0 + 0.0j, 0, 1.0 + 0.0j)
    tailed = Command(2.0, (Segment(0.0, 0.0, 0.5),), Tail(0.0, (term,)))
    # The steepest chord of e^(-2t) is its first, flatter than the tangent by half a step.
    assert value(observation(moved(0.0), command=tailed), "peak_rate") == pytest.approx(2.0, rel=2 * STEP)
    jumping = Command(2.0, (Segment(0.0, 0.0, 0.25),), Tail(0.0, (term,)))
    assert value(observation(moved(0.0), command=jumping), "peak_rate") == math.inf


def test_peak_and_final_of_a_variable() -> None:
    run = observation(moved(0.0))
    assert value(run, "peak(spring)") == pytest.approx(2.5), "from its first value"
    assert value(run, "final(spring)") == pytest.approx(0.5)
    assert value(run, "peak(output)") == value(run, "peak(y)") == pytest.approx(5.0)
    assert value(run, "final(output)") == pytest.approx(5.0)


def test_maneuver_time_is_the_moves_own_wherever_it_begins() -> None:
    assert value(observation(moved(0.0), command=BANG.shifted(1.5)), "maneuver_time") == MOVE


@pytest.mark.parametrize(
    ("bracket", "gap"),
    [((2.0, 2.5), 0.25), ((2.0, 2.0), 0.0), ((0.0, 0.0), 0.0), ((0.0, 1.0), math.inf), ((2.0, None), math.inf), ((None, None), math.inf)],
)
def test_optimality_gap(bracket: tuple[float | None, float | None], gap: float) -> None:
    assert value(observation(moved(0.0), bracket=bracket), "optimality_gap") == gap


def test_model_mismatch_is_the_largest_distance_over_the_move() -> None:
    run = observation(moved(0.0), displacement=-5.0)
    linear = run.output + np.where(np.arange(len(run.times)) == 7, -0.5, 0.1)
    assert value(replace(run, linear=linear), "model_mismatch") == pytest.approx(0.1)


def test_insensitivity_of_steps_counts_impulses_in_steps() -> None:
    """Input steps of 2 N to 1 N at rest, half a period apart, are a ZV shaper: |cos(π r / 2)| at relative frequency r."""
    half = PERIOD / 2
    zv = Command(half, (Segment(0.0, 1.0),), Tail(2.0))
    run = observation(moved(0.0), command=zv)
    # Impulses 1 and 1 in units of the step amplitude 2: V = |cos(π r/2)|, zero at 1 and V at 1 ± (2/π) asin V.
    assert value(run, "insensitivity(0.05)") == pytest.approx(4 / math.pi * math.asin(0.05), rel=1e-9)
    assert value(replace(run, facts=replace(run.facts, modes=((1.3 * OMEGA, 0.0),))), "insensitivity(0.05)") == 0.0


def test_insensitivity_is_the_smallest_of_the_modes_and_does_not_depend_on_the_start() -> None:
    half = PERIOD / 2
    zv = Command(half, (Segment(0.0, 1.0),), Tail(2.0))
    both = observation(moved(0.0), command=zv, modes=(*MODES, (3 * OMEGA, 0.0)))
    # At three times the frequency, r = 3 is a zero again, and a third as wide in its own relative frequency.
    assert value(both, "insensitivity(0.05)") == pytest.approx(4 / math.pi * math.asin(0.05) / 3, rel=1e-9)
    later = observation(moved(0.0), command=zv.shifted(1.0))
    assert value(later, "insensitivity(0.05)") == pytest.approx(4 / math.pi * math.asin(0.05), rel=1e-9)


def test_insensitivity_is_defined_for_steps_only() -> None:
    assert math.isnan(value(observation(moved(0.0), command=RAMP), "insensitivity(0.05)"))
    still = Command(1.0, (Segment(0.0, 0.0),), Tail(0.0))
    assert math.isnan(value(observation(moved(0.0), command=still), "insensitivity(0.05)"))
    assert value(observation(moved(0.0), modes=()), "insensitivity(0.05)") == math.inf, "nothing vibrates"


def test_window_of_undamped_modes_is_twenty_of_the_slowest_periods() -> None:
    assert window(((OMEGA, 0.0), (3 * OMEGA, 0.0)), (), 2.0) == (pytest.approx(20 * PERIOD), pytest.approx(PERIOD), False)
    assert window(((OMEGA, 0.99e-4),), (), 2.0) == (pytest.approx(20 * PERIOD), pytest.approx(PERIOD), False), "counts as undamped"


def test_window_of_damped_modes_lasts_until_they_have_decayed() -> None:
    length, slowest, decayed = window(((OMEGA, 0.01),), (), 2.0)
    assert (slowest, decayed) == (pytest.approx(PERIOD), True)
    assert length == pytest.approx(math.log(1000) / (0.01 * OMEGA))
    assert window(((OMEGA, 0.2),), (), 2.0) == (pytest.approx(20 * PERIOD), pytest.approx(PERIOD), True), "at least 20 periods"
    # A fast mode that decays more slowly than 20 periods of the slow one decides.
    assert window(((OMEGA, 0.2), (5 * OMEGA, 0.002)), (), 2.0)[0] == pytest.approx(math.log(1000) / (0.002 * 5 * OMEGA))


def test_window_is_at_most_two_hundred_periods() -> None:
    length, _, decayed = window(((OMEGA, 2e-4),), (), 2.0)
    assert length == pytest.approx(200 * PERIOD)
    assert not decayed, "then y(∞) is the middle of the last period, not the last value"
    assert window(((OMEGA, 0.2), (2 * OMEGA, 0.0)), (), 2.0)[2] is False, "one undamped mode is enough"


def test_window_without_modes_lasts_until_the_slowest_real_pole_has_decayed() -> None:
    assert window((), (0.0, 0.0, -0.5, -3.0), 2.0) == (pytest.approx(math.log(1000) / 0.5), None, True)
    length, slowest, decayed = window((), (0.0, 0.0), 2.0)
    assert length > 0.0
    assert (slowest, decayed) == (None, True)
    # With modes, real poles do not count.
    assert window(MODES, (-1e-6,), 2.0)[0] == pytest.approx(20 * PERIOD)
