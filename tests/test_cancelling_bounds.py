"""What any number of delays can reach: grids that converge, proven durations, and random plants whose filters stand between."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from filtered_plants import settled
from marks import slow

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.monotone import _proven, _tails, _weights, least_monotone
from relaxations.cancelling.relaxed import any_delays
from relaxations.cancelling.requests import Request, cancelling
from relaxations.cancelling.structures import Bounds
from relaxations.errors import ImpossibleShaperError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time

PITCH = LinearPlant.from_transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"])
ONE_ZERO = LinearPlant.from_transfer([1, 1], [1, 0, 2])
MONOTONE = Bounds(monotone=True)


@pytest.mark.slow
def test_grids_of_delays_converge_to_the_proven_bound() -> None:
    levels = Bounds(levels=(-1.5, 1.5))
    lower = minimum_time(problem([PITCH], Maneuver(Fraction(1), Limits(-Fraction(3, 2), Fraction(3, 2)), tail=True))).lower
    over = [any_delays(Conditions.of(PITCH), levels, cells).duration - lower for cells in (20, 40, 80)]
    assert over == sorted(over, reverse=True)
    assert min(over) > 0.0
    assert over[-1] < over[0] / 4.0  # between first and second order
    assert settled(PITCH, any_delays(Conditions.of(PITCH), levels, 20))[0] < 1e-8


@pytest.mark.parametrize(
    ("plant", "form", "delays", "robustness", "within"),
    [
        (ONE_ZERO, "last+step", 1, 0, 1e-7),
        slow(ONE_ZERO, "last+step", 2, 1, 2e-5),
        (LinearPlant.from_transfer([1, 3, 2], [1, 0, 2]), "last", 1, 0, 1e-7),
        slow(LinearPlant.from_transfer([1, 2, 3], [1, 0, 2]), "last+step", 1, 0, 1e-7),
        slow(LinearPlant.from_transfer([1, 2, 1], [1, "0.2", 2]), "last", 1, 0, 1e-6),
        slow(LinearPlant.from_transfer([1, 1], [1, "0.1", "5.01", "0.2", 4]), "last", 2, 0, 2e-5),
        slow(LinearPlant.from_transfer([1], [1, "0.2", 2]), "last", 1, 0, 1e-7),
    ],
)
def test_no_monotone_filter_is_much_shorter(plant: LinearPlant, form: str, delays: int, robustness: int, within: float) -> None:
    done = cancelling(plant, Request(delays, form, robustness, bounds=MONOTONE))
    least = least_monotone(Conditions.of(plant, robustness), done.duration)
    assert least is not None
    assert done.duration * (1 - within) <= least <= done.duration


def test_a_duration_that_a_filter_has_is_not_refuted() -> None:
    """The weights that nearly refute the optimum, at durations beyond it: nothing is claimed."""
    conditions = Conditions.of(ONE_ZERO)
    tails = _tails(conditions)
    assert tails is not None
    weights, _ = _weights(conditions, tails, 1.5459)
    assert _proven(conditions, tails, 1.5459, weights)
    for duration in (1.54594, 1.7, 2.3, 3.0):
        for used in (weights, -weights, _weights(conditions, tails, duration)[0]):
            assert not _proven(conditions, tails, duration, used)


def test_what_is_not_known_is_not_claimed() -> None:
    assert least_monotone(Conditions.of(PITCH), 3.0) is None  # a real pole
    assert least_monotone(Conditions.of(LinearPlant.from_transfer([1, 6, 11, 6], [1, 0, 3, 0, 2])), 3.0) is None  # three zeros
    with pytest.raises(ImpossibleShaperError, match="real pole"):
        any_delays(Conditions.of(PITCH), MONOTONE, 10)


def random_plant(random: np.random.Generator, modes: int, zeros: int) -> LinearPlant:
    """Flexible modes, and real zeros left of the axis; decimals of four digits, so that nothing hides in the numbers."""

    def text(value: float) -> str:
        return f"{value:.4f}"

    denominator = np.poly1d([1.0])
    for _ in range(modes):
        omega, zeta = random.uniform(0.5, 5.0), random.uniform(0.0, 0.3)
        denominator = denominator * np.poly1d([1.0, 2.0 * zeta * omega, omega**2])
    numerator = np.poly1d([1.0])
    for _ in range(zeros):
        numerator = numerator * np.poly1d([1.0, random.uniform(0.2, 6.0)])
    return LinearPlant.from_transfer([text(c) for c in numerator.c], [text(c) for c in denominator.c])


@pytest.mark.parametrize("seed", [0, 3, *(slow(seed) for seed in range(4, 40))])
def test_random_plants_rest_after_the_last_delay_and_no_sooner_than_is_proven(seed: int) -> None:
    random = np.random.default_rng(seed)
    modes = int(random.integers(1, 3))
    plant = random_plant(random, modes, int(random.integers(1, 3)))
    done = cancelling(plant, Request(modes))
    worst, largest = settled(plant, done)
    size = max(largest, sum(map(abs, done.gains)), 1.0)
    assert worst < 1e-8 * size  # matrix exponentials of some e^{ζωT} times rounding
    low, high = (pick(*done.command(1.0).extent(), 0.0, done.gain) for pick in (min, max))  # both rests too
    limits = Limits(Fraction(low) - Fraction(1, 10**9), Fraction(high) + Fraction(1, 10**9))
    bound = minimum_time(problem([plant], Maneuver(Fraction(1), limits, tail=True)))
    assert bound.lower <= done.duration * (1 + 1e-12)
