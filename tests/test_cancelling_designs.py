"""Filters of given structure: published digits, other plants against matrix exponentials, and what no filter can do."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from filtered_plants import settled
from marks import slow
from numpy.typing import NDArray

from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling, cascaded, staged
from relaxations.cancelling.structures import Bounds
from relaxations.errors import ImpossibleShaperError, ManeuverError, PlantError, ShaperError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time

PITCH = LinearPlant.from_transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"])
ONE_ZERO = LinearPlant.from_transfer([1, 1], [1, 0, 2])
DISPLACEMENT = 0.2
DIGITS = 6e-11  # half a unit of the tenth digit, and the rounding of the digits themselves


def gains(done: Prefilter) -> NDArray[np.float64]:
    return DISPLACEMENT * np.array(done.gains)


def coefficients(done: Prefilter) -> list[float]:
    return [DISPLACEMENT * term.coefficient.real for term in done.terms]


def test_pitch_of_one_delay() -> None:  # (58); the published -0.0184 and 2.3673 are off in the last digit
    done = cancelling(PITCH, Request(1, "last+step"))
    assert done.duration == pytest.approx(2.3672493903, abs=DIGITS)
    assert gains(done) == pytest.approx([0.2197918790, 0.0992515680], abs=DIGITS)
    assert coefficients(done) == pytest.approx([-0.0183477910], abs=DIGITS)
    assert done.poles[0].real == pytest.approx(-0.1541268, abs=5e-8)


@pytest.mark.slow
def test_pitch_of_steps_alone_with_bounded_gains() -> None:  # (60), (61)
    done = cancelling(PITCH, Request(2, zeros=(), bounds=Bounds(gains=(-0.35 / DISPLACEMENT, 2.0 / DISPLACEMENT))))
    assert done.delays[1:] == pytest.approx((1.5783360626, 4.2744016911), abs=DIGITS)
    assert gains(done) == pytest.approx([0.8734502718, -0.35, -0.3234502718], abs=DIGITS)
    assert done.terms == ()


def test_pitch_in_a_cascade() -> None:  # (63), (64)
    first, second = staged(PITCH, [("mode[1]", None), ("real[1]", 4.2744016911 - 2.2739214535)])
    assert first.duration == pytest.approx(2.2739214535, abs=DIGITS)
    assert first.gains == pytest.approx([0.6770178291, 0.3229821709], abs=DIGITS)
    assert second.gains == pytest.approx([6.1916675, -5.1916675], abs=1e-6)  # published to seven digits; the delay has ten
    both = cascaded([first, second])
    assert len(both.delays) == 4
    for pole in PITCH.poles:
        assert abs(both(pole.value)) < 1e-12
    assert both.gain == pytest.approx(1.0, abs=1e-12)


def test_pitch_with_further_zeros_at_the_mode() -> None:  # (65)
    done = cancelling(PITCH, Request(2, "last+step", robustness=1))
    assert done.delays[1:] == pytest.approx((2.2520627528, 4.8107659262), abs=DIGITS)
    assert gains(done) == pytest.approx([0.1458330720, 0.1263400827, 0.0209898287], abs=DIGITS)
    assert coefficients(done) == pytest.approx([-0.0143589168], abs=DIGITS)
    mode = PITCH.flexible[0].value
    assert max(abs(done(mode)), abs(done(mode, 1))) < 1e-11  # e^{ζωT} and T times rounding


PLANTS = {
    "one zero": (ONE_ZERO, Request(1)),
    "pole on the undelayed term": (ONE_ZERO, Request(1, "first")),
    "pole on every term": (ONE_ZERO, Request(1, "every")),
    "pole on the middle one of three": (PITCH, Request(2, "1+step", bounds=Bounds(levels=(-2.0, 2.0)))),
    "two zeros with feed-through": (LinearPlant.from_transfer([1, 2, 3], [1, 0, 2]), Request(1)),
    "repeated zeros": (LinearPlant.from_transfer([1, 2, 1], [1, "0.2", 2]), Request(1)),
    "free numerator": (
        LinearPlant.from_transfer([1, 2, 3], [1, "0.1", 3, "0.2", 2]),
        Request(2, "last+step+free", bounds=Bounds(gains=(-3, 3))),
    ),
    "rigid body": (LinearPlant.from_transfer([1, 1], [1, 0, 0]), Request(2, "last+step", bounds=Bounds(levels=(-1, 1)))),
    "rigid body and mode": (LinearPlant.from_transfer([1, 1], [1, 0, 2, 0, 0]), Request(3, "last+step", bounds=Bounds(levels=(-1, 1)))),
    "a zero right of the axis is left alone": (LinearPlant.from_transfer([-1, 1, 2], [1, "0.3", 2, "0.5"]), Request(1, "last+step")),
    "two modes": (LinearPlant.from_transfer([1, 1], [1, "0.1", "5.01", "0.2", 4]), Request(2)),
}


SLOW = {"pole on the middle one of three", "free numerator", "rigid body and mode"}  # some seconds of minimisation each


@pytest.mark.parametrize("name", [slow(name) if name in SLOW else name for name in PLANTS])
def test_the_output_is_at_rest_after_the_last_delay(name: str) -> None:
    plant, request = PLANTS[name]
    done = cancelling(plant, request)
    worst, largest = settled(plant, done)
    assert worst < 1e-9 * max(largest, 1.0)  # some sixty matrix exponentials
    moving = [pole for pole in plant.poles if not pole.is_rigid]
    assert max((abs(done(pole.value)) for pole in moving), default=0.0) < 1e-10 * max(1.0, *map(abs, done.gains))


@pytest.mark.slow
def test_with_levels_and_enough_delays_nothing_is_faster() -> None:
    done = cancelling(PITCH, Request(3, "last+step", bounds=Bounds(levels=(-1.5, 1.5))))
    bound = minimum_time(problem([PITCH], Maneuver(Fraction(1), Limits(-Fraction(3, 2), Fraction(3, 2)), tail=True)))
    assert bound.lower * (1 - 1e-9) <= done.duration <= bound.lower * (1 + 1e-7)


def test_a_monotone_reference_never_turns_back() -> None:
    done = cancelling(ONE_ZERO, Request(1, "last+step", bounds=Bounds(monotone=True)))
    assert done.duration == pytest.approx(1.5459306102, abs=DIGITS)  # the pole alone is the fastest of them
    assert (np.diff(done.reference(np.linspace(0.0, 12.0, 2000))) >= -1e-12).all()


@pytest.mark.slow
def test_delays_on_samples_cancel_exactly() -> None:
    done = cancelling(PITCH, Request(2, "last+step", bounds=Bounds(levels=(-2.0, 2.0)), sample_time=0.25))
    assert np.array(done.delays) / 0.25 == pytest.approx(np.round(np.array(done.delays) / 0.25), abs=1e-12)
    assert settled(PITCH, done)[0] < 1e-10
    free = cancelling(PITCH, Request(2, "last+step", bounds=Bounds(levels=(-2.0, 2.0))))
    assert free.duration <= done.duration + 1e-9


def test_given_delays_are_taken() -> None:
    done = cancelling(ONE_ZERO, Request(1, "last+step", instants=(0.8,)))
    assert done.duration == 0.8
    assert settled(ONE_ZERO, done)[0] < 1e-10
    several = cancelling(ONE_ZERO, Request(3, "last+step", instants=(0.5, 1.0, 1.6), bounds=Bounds(gains=(0.0, 1.0))))
    assert settled(ONE_ZERO, several)[0] < 1e-10
    assert 0.0 <= min(several.gains) <= max(several.gains) <= 1.0 + 1e-9


def test_a_heavy_body_takes_its_time() -> None:
    """1/s² pushed by 0.001 takes 2 √1000 s."""
    done = cancelling(LinearPlant.from_transfer([1], [1, 0, 0]), Request(2, bounds=Bounds(levels=(-1e-3, 1e-3))))
    assert done.duration == pytest.approx(2.0 * 1000.0**0.5, rel=1e-7)


@pytest.mark.parametrize("speed", [1e-6, 1e6])
def test_slow_and_fast_plants_have_the_same_filters(speed: float) -> None:
    """Time is measured in the plant's own: (s + 1)(s + 2)/(s² + 2) and the pitch loop with s divided by the speed."""
    one = LinearPlant.from_zeros_poles([-speed, -2 * speed], [[0, repr(2**0.5 * speed)], [0, repr(-(2**0.5) * speed)]], 1)
    done = cancelling(one, Request(1, "last+step", bounds=Bounds(monotone=True)))
    assert done.duration * speed == pytest.approx(1.1107207345, abs=DIGITS)
    zeros, poles = ([[repr(r.value.real * speed), repr(i * speed)] for r in roots for i in {r.value.imag, -r.value.imag}]
                    for roots in (PITCH.zeros, PITCH.poles))  # fmt: skip
    done = cancelling(LinearPlant.from_zeros_poles(zeros, poles, "1e-3"), Request(2, "last+step", robustness=1))
    assert np.array(done.delays[1:]) * speed == pytest.approx((2.2520627528, 4.8107659262), abs=DIGITS)


@pytest.mark.parametrize(
    ("plant", "request_", "error", "words"),
    [
        (LinearPlant.from_transfer([1, 1], [1, 0, -2]), Request(), PlantError, "unstable poles"),
        (LinearPlant.from_transfer([1], [1, -2, 5]), Request(), PlantError, "unstable poles 1 ± 2j;"),
        (LinearPlant.from_transfer([-1, 1], [1, 0, 2]), Request(zeros=(1.0,)), PlantError, "right of the imaginary axis"),
        (LinearPlant.from_transfer([1, 0], [1, 0, 2]), Request(), PlantError, "zero at the origin"),
        (ONE_ZERO, Request(zeros=(-3.0,)), PlantError, "no zero at"),
        (ONE_ZERO, Request(zeros=(-1.0, -1.0)), PlantError, "multiplicity 1"),
        (ONE_ZERO, Request(robustness={"mode[2]": 1}), ManeuverError, r"mode\[1\]"),
        (PITCH, Request(1), ShaperError, "it takes 2 delays"),
        (PITCH, Request(1, robustness=1), ShaperError, "6 equations"),
        (PITCH, Request(2, "last+step"), ShaperError, "infinitely many"),
        (PITCH, Request(1, "middle"), ShaperError, "names no delayed term"),
        (PITCH, Request(1, "last+stop"), ShaperError, "stop"),
        (PITCH, Request(0), ShaperError, "at least one delay"),
        (PITCH, Request(2, "last+step", bounds=Bounds(monotone=True)), ImpossibleShaperError, "real pole"),
        (PITCH, Request(1, sample_time=0.1), ShaperError, "at least 3 delays"),
        (ONE_ZERO, Request(1, "last+step", sample_time=0.1), ShaperError, "infinitely many"),
        (ONE_ZERO, Request(1, instants=(1.0, 2.0)), ShaperError, "ascend"),
        (ONE_ZERO, Request(1, instants=(1.0,)), ImpossibleShaperError, "2 gains and numerators"),
        (ONE_ZERO, Request(1, bounds=Bounds(gains=(0.0, 0.1))), ImpossibleShaperError, "within the bounds"),
    ],
)
def test_what_no_filter_can_do_is_said(plant: LinearPlant, request_: Request, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        cancelling(plant, request_)
