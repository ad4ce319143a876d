"""One flexible mode, one delay: the published digits, the branch that the arctangents leave open, and independent transfer functions."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
import pytest

from relaxations.cancelling.closed_forms import pole_first, pole_last, step_and_pole_last
from relaxations.cancelling.prefilters import Prefilter, cascade
from relaxations.errors import PlantError, ShaperError
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import ShaperTerm

ROOT2, ROOT3 = math.sqrt(2.0), math.sqrt(3.0)
UNDAMPED = Mode(ROOT2, 0.0)
DIGITS = 5e-11  # what the ten digits of a published or recomputed number leave open
ROUNDING = 1e-13  # of numbers of order one after some ten operations


def literal(done: Prefilter, s: complex) -> complex:
    """The transfer function by numerical integration of its impulse response: nothing in common with partial fractions."""
    total = sum(gain * cmath.exp(-s * delay) for delay, gain in zip(done.delays, done.gains, strict=True))
    for term in done.terms:
        t = np.linspace(0.0, 60.0 / -term.rate.real, 400_001)
        h = (term.coefficient * t**term.power * np.exp(term.rate * t)).real * np.exp(-s * (t + term.start))
        total += complex(np.trapezoid(h, t))
    return total


def test_one_real_zero_to_ten_digits() -> None:  # (15)
    done = pole_last(UNDAMPED, [-1.0])
    assert done.duration == pytest.approx(1.5459306102, abs=DIGITS)
    assert done.gains == pytest.approx((ROOT3 - 1.0, 0.0), abs=ROUNDING)
    assert done.terms[0].coefficient == pytest.approx(3.0 - ROOT3, abs=ROUNDING)


def test_complex_zeros_to_ten_digits() -> None:  # (40): 1/3, and 1 over s² + 2s + 3
    done = pole_last(UNDAMPED, [-1 + 1j * ROOT2, -1 - 1j * ROOT2])
    assert done.duration == pytest.approx(1.3510217177, abs=DIGITS)
    assert done.gains[0] == pytest.approx(1 / 3, abs=ROUNDING)
    assert (done(0.7 + 0.3j) - done.gains[0]) * cmath.exp((0.7 + 0.3j) * done.duration) == pytest.approx(
        1.0 / ((0.7 + 0.3j) ** 2 + 2 * (0.7 + 0.3j) + 3), abs=ROUNDING
    )


def test_real_zeros_to_ten_digits() -> None:  # (47): over (s + 1)(s + 2)
    done = pole_last(UNDAMPED, [-1.0, -2.0])
    assert done.duration == pytest.approx(1.1107207345, abs=DIGITS)
    assert done.gains[0] == pytest.approx(0.3203772410, abs=DIGITS)
    assert [term.coefficient.real for term in done.terms] == pytest.approx([1.3592455180, -1.3592455180], abs=DIGITS)


def test_without_zeros_it_is_the_zero_vibration_shaper() -> None:
    mode = Mode(3.0, 0.2)
    k = math.exp(-0.2 * math.pi / math.sqrt(1 - 0.04))
    for done in (pole_last(mode, []), pole_first(mode, [], positive=True)):
        assert done.duration == pytest.approx(math.pi / (3.0 * math.sqrt(1 - 0.04)), rel=ROUNDING)
        assert done.shaper().amplitudes == pytest.approx((1 / (1 + k), k / (1 + k)), rel=ROUNDING)


@pytest.mark.parametrize("damping", [0.0, 0.1, 0.6])
@pytest.mark.parametrize(
    "zeros", [[-0.2], [-9.0], [-0.3, -0.3], [-1 - 2j, -1 + 2j], [-0.1 + 0.5j, -0.1 - 0.5j]], ids=["near", "far", "twice", "pair", "slow"]
)
def test_poles_are_cancelled_and_the_gain_is_right(damping: float, zeros: list[complex]) -> None:
    mode = Mode(1.7, damping)
    p = 1.7 * complex(-damping, math.sqrt(1 - damping**2))
    gain = math.prod(-complex(z) for z in zeros).real / 1.7**2
    for done in (
        pole_last(mode, zeros),
        pole_first(mode, zeros),
        pole_first(mode, zeros, positive=True),
        step_and_pole_last(mode, zeros, 0.61),
    ):
        size = sum(map(abs, done.gains)) + sum(abs(term.coefficient) for term in done.terms)
        assert abs(done(p)) < 1e-13 * size * math.exp(1.7 * damping * done.duration)
        assert done.gain * gain == pytest.approx(1.0, rel=1e-12)
        assert done.duration < 2 * math.pi / p.imag
        assert set(done.poles) == {complex(z) for z in zeros if complex(z).imag >= 0}
    assert literal(pole_last(mode, zeros), 0.4 + 0.2j) == pytest.approx(complex(pole_last(mode, zeros)(0.4 + 0.2j)), abs=1e-6)


def test_signs_of_the_parametrisations() -> None:
    assert min(pole_last(UNDAMPED, [-1.0]).gains[0], pole_last(UNDAMPED, [-1.0]).terms[0].coefficient.real) > 0.0
    short, long = pole_first(UNDAMPED, [-1.0]), pole_first(UNDAMPED, [-1.0], positive=True)
    assert short.gains[1] < 0.0 < short.terms[0].coefficient.real
    assert min(long.gains[1], long.terms[0].coefficient.real) > 0.0
    assert long.duration - short.duration == pytest.approx(math.pi / ROOT2, abs=ROUNDING)


def test_derivatives_of_the_transfer_function() -> None:
    done = Prefilter((0.0, 1.3), (0.4, 0.1), (ShaperTerm(1.3, -0.5 + 2j, 1, 0.3 - 0.2j), ShaperTerm(0.0, -1 + 0j, 2, 0.7)))
    s, h = 0.3 + 0.9j, 1e-4
    for order in (1, 2):
        differences = (done(s + h, order - 1) - done(s - h, order - 1)) / (2 * h)
        assert done(s, order) == pytest.approx(complex(differences), abs=1e-6)  # h² of a third derivative of order ten


def test_the_step_response_is_the_command() -> None:
    done = pole_last(Mode(2.0, 0.05), [-0.7 + 0.4j, -0.7 - 0.4j])
    t = np.linspace(0.0, 9.0, 200)
    assert done.command(3.0, rest=0.5)(t) == pytest.approx(0.5 + 3.0 * done.reference(t), abs=1e-12)


def test_filters_follow_each_other() -> None:
    first, second = pole_last(UNDAMPED, [-1.0]), pole_last(Mode(5.0, 0.1), [])
    both = cascade(first, second)
    for s in (0.3 + 0.7j, -0.2 + 3j):
        assert both(s) == pytest.approx(complex(first(s) * second(s)), abs=1e-12)


def test_files_are_read_back() -> None:
    done = pole_last(UNDAMPED, [-1 + 1j, -1 - 1j])
    assert Prefilter.from_dict(done.to_dict()) == done


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: pole_last(UNDAMPED, [0.5]), "right of the imaginary axis"),
        (lambda: pole_last(UNDAMPED, [2j, -2j]), "on the imaginary axis"),
        (lambda: pole_last(UNDAMPED, [-1.0, -2.0, -3.0]), "at most two zeros"),
        (lambda: step_and_pole_last(Mode(1.0, 0.0), [-1.0], math.pi), "half the mode's damped period"),
        (lambda: step_and_pole_last(Mode(1.0, 0.0), [-1.0], 0.0), "positive"),
        (lambda: Prefilter((0.0, 1.0), (1.0,)), "one gain for each delay"),
        (lambda: Prefilter((0.0, 1.0), (1.0, 1.0), (ShaperTerm(0.5, -1 + 0j, 0, 1.0),)), "one of the delays"),
        (lambda: Prefilter((0.0, 1.0), (1.0, 1.0), (ShaperTerm(1.0, 1 + 0j, 0, 1.0),)), "does not decay"),
        (lambda: Prefilter.from_dict({"format": "slewcert-shaper/1"}), "slewcert-prefilter/1"),
    ],
)
def test_mistakes_are_told(wrong: Callable[[], object], words: str) -> None:
    with pytest.raises((PlantError, ShaperError), match=words):
        wrong()
