"""Central differences with a balanced step: known derivatives, an error that is one, and functions that know little of themselves."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable

import numpy as np
import pytest

from fmus.differences import balance, column

Function = Callable[[float], float | None]


def derivative(f: Function, x: float, size: float = 1.0) -> tuple[float, float]:
    def evaluate(t: float) -> list[float] | None:
        value = f(t)
        return None if value is None else [value]

    found = column(evaluate, x, size)
    assert found is not None
    (value,), (error,) = found
    return value, error


@pytest.mark.parametrize("x", [0.0, 1e-3, 0.7, 12.3, -5e6])
def test_a_straight_line_is_known_to_the_last_place(x: float) -> None:
    value, error = derivative(lambda t: 3.7 * t - 1.1, x, max(1.0, abs(x)))
    # The widest step is an eighth of the size: ε |f| / h is a few ε of the slope.
    assert value == pytest.approx(3.7, rel=1e-14)
    assert error < 1e-13


@pytest.mark.parametrize(
    ("f", "slope", "x", "known"),
    [
        (math.sin, math.cos, 0.7, 1e-10),
        (math.exp, math.exp, 0.0, 1e-10),
        (lambda t: t**3, lambda t: 3 * t * t, 0.0, 1e-15),
        (lambda t: math.tanh(100.0 * t), lambda t: 100.0 / math.cosh(100.0 * t) ** 2, 1e-3, 1e-8),  # straight within a hundredth only
        (lambda t: math.sqrt(t) if t >= 0.0 else None, lambda t: 0.5 / math.sqrt(t), 1e-3, 1e-8),  # the domain ends a thousandth away
        (lambda t: max(min(t, 1e-2), -1e-2), lambda t: 1.0, 0.0, 1e-13),  # saturates
        (abs, lambda t: 0.0, 0.0, 0.0),  # what is between both sides
        (lambda t: 4.0, lambda t: 0.0, 3.0, 0.0),
    ],
)
def test_known_derivatives(f: Function, slope: Callable[[float], float], x: float, known: float) -> None:
    value, error = derivative(f, x)
    # ε^(2/3) of a smooth function of natural size 1 is 4e-11; the others as the comments say.
    assert abs(value - slope(x)) <= known
    assert abs(value - slope(x)) <= error


def test_the_error_is_one_for_random_functions_and_any_noise() -> None:
    """Out of 2000: every error at most three times what is told, and hardly any more than it."""
    random = np.random.default_rng(5)
    beyond = 0
    for _ in range(2000):
        a, b, c, x = random.uniform(-2.0, 2.0, 4)
        w = random.uniform(-2.0, 2.0) * 10 ** random.uniform(-1.0, 1.5)
        slope, noise = random.choice([0.0, 1.0, 1e3]), random.choice([0.0, 1e-9, 1e-6])

        def f(t: float, a=a, b=b, c=c, x=x, w=w, slope=slope, noise=noise) -> float:
            return a * math.sin(w * t + b) + c * t * t + slope * (t - x) + noise * random.uniform(-1.0, 1.0)

        value, error = derivative(f, x, max(1.0, abs(x)))
        off = abs(value - (a * w * math.cos(w * x + b) + 2.0 * c * x + slope)) / error
        assert off < 3.0
        beyond += off > 1.0
    assert beyond < 40


def test_a_function_in_single_precision_gives_what_it_has() -> None:
    """Small steps do not move it at all: they must not be taken for a derivative of zero."""
    value, error = derivative(lambda t: ctypes.c_float(ctypes.c_float(t).value * 2.5 + 10.0).value, 1.0)
    assert abs(value - 2.5) <= error < 1e-4


def test_entries_choose_their_steps_separately() -> None:
    values, errors = column(lambda t: [math.sin(50.0 * t), 3.0 * t, 7.0], 0.3, 1.0) or ([], [])
    assert abs(values[0] - 50.0 * math.cos(15.0)) <= errors[0] < 1e-6
    assert values[1] == pytest.approx(3.0, rel=1e-14)
    assert values[2] == 0.0
    assert errors[2] < 1e-12  # ε · 7 over the widest step that all of them took


def test_what_has_no_value_on_either_side_has_no_derivative() -> None:
    assert column(lambda t: None, 0.0, 1.0) is None
    assert column(lambda t: [math.nan], 0.0, 1.0) is None
    assert column(lambda t: [math.sqrt(t)] if t >= 0.0 else None, 0.0, 1.0) is None


def test_steps_stay_below_the_largest_allowed() -> None:
    seen: list[float] = []

    def record(t: float) -> list[float]:
        seen.append(abs(t - 2.0))
        return [t]

    column(record, 2.0, 4.0, largest=2.0**-15)
    assert max(seen) <= 4.0 * 2.0**-15


def test_the_balance_lies_between_noise_and_truncation() -> None:
    h = 10.0 ** np.arange(-8.0, 1.0)
    error = 1e-9 / h + h**2
    jumps = np.abs(np.diff(np.where(np.arange(9) % 2, 1.0, -1.0) * 1e-9 / h + h**2))
    best, told = balance(jumps.tolist(), [0.0] * 9, 10.0)
    assert error[best] == error.min()
    assert told == pytest.approx(error.min(), rel=3.0)
