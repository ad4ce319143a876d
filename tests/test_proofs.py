"""Proven brackets: known answers, pairs that must and must not be proven, seeded random plants, invariance, an independent LP."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import pytest
from independent_reach import Reach
from problems import KNOWN, PROBLEMS, Known
from random_plants import random_task

from relaxations import certificates
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time

REGULAR = 1e-12  # what the refinement of a regular optimum promises
REPAIRED = 1e-6  # what linear repair promises for every problem


def forged(bound: Bound, changes: Mapping[str, Any]) -> bytes:
    """The bound's certificate with other claims and a right digest."""
    assert bound.certificate is not None
    content = json.loads(bound.certificate)
    return certificates.certificate(content["task"], content["claim"] | dict(changes), content["lower"], content["upper"])


def claims(bound: Bound, lower: Fraction | None, upper: Fraction | None) -> Outcome:
    sides = {"lower": lower and certificates.text(lower), "upper": upper and certificates.text(upper)}
    return check(forged(bound, sides)).outcome


@pytest.mark.parametrize("known", PROBLEMS, ids=lambda known: known.name)
def test_known_answers_are_proven(known: Known) -> None:
    found = minimum_time(known.problem())
    if known.time is None:
        assert found.status is Status.IMPOSSIBLE
        return
    assert found.status is Status.PROVED, found.reason
    assert found.upper is not None
    assert found.gap is not None
    assert found.gap <= (REGULAR if found.switches is not None else REPAIRED)
    # The digits known are right to half a unit of the last: the bracket contains or touches them.
    assert found.lower - known.error <= known.time <= found.upper + known.error


@pytest.mark.parametrize("known", KNOWN[::3], ids=lambda known: known.name)
def test_pairs_that_must_and_must_not_be_proven(known: Known) -> None:
    """With the same witnesses: a little weaker claims hold, claims a little beyond the optimum do not."""
    found = minimum_time(known.problem())
    assert found.upper is not None
    lower, upper = Fraction(found.lower), Fraction(found.upper)
    near = Fraction(1, 10**8)
    assert claims(found, lower * (1 - near), upper * (1 + near)) is Outcome.PROVED
    if lower:
        assert claims(found, upper * (1 + near), None) is not Outcome.PROVED
        assert claims(found, None, lower * (1 - near)) is not Outcome.PROVED


def tailed(numerator: list, denominator: list, displacement: str, limits: tuple[Any, Any], length: tuple[str, str] | None = None) -> Bound:
    plant = LinearPlant.from_transfer(numerator, denominator)
    within = None if length is None else (exact(length[0]), exact(length[1]))
    return minimum_time(problem([plant], Maneuver(exact(displacement), Limits.of(*limits), tail=True, tail_length=within)))


PITCH = ["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"]


def test_output_rest_is_faster_than_state_rest() -> None:
    with_tail = tailed(*PITCH, "0.2", ("-0.3", "0.3"))
    state = minimum_time(problem([LinearPlant.from_transfer(*PITCH)], Maneuver(exact("0.2"), Limits.of("-0.3", "0.3"))))
    assert with_tail.status is state.status is Status.PROVED
    assert with_tail.lower == pytest.approx(3.31, abs=5e-3)  # both from the field's literature, given as "about"
    assert state.lower == pytest.approx(13.37, abs=5e-3)


def test_a_tail_alone_takes_no_time() -> None:
    found = tailed([1, 2, 3], [1, 0, 1], "1", (-1, 1))  # begins exactly on the limit, Δ/D = 1
    assert (found.status, found.lower, found.upper, found.gap) == (Status.PROVED, 0.0, 0.0, 0.0)
    assert found.command is not None
    assert not found.command.segments
    # With a hair less room the tail no longer fits, and time is needed.
    longer = tailed([1, 2, 3], [1, 0, 1], "1", (-1, "0.999"))
    assert longer.status is Status.PROVED
    assert longer.lower > 0.0


def test_a_tail_on_its_limit_for_ever() -> None:
    """u_ss on the limit: the tail may only come from below."""
    found = tailed([1, 1], [1, 5, 6], "1", (-1, 6))
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= REGULAR


def test_zeros_on_the_axis_get_no_tail() -> None:
    """The two-mass spring seen at the driven mass: a lasting oscillation of the input is not a rest (state rest takes as long)."""
    found = tailed([1, 0, 1], [1, 0, 2, 0, 0], "1", (-1, 1))
    assert found.lower == pytest.approx(4.2178665105, abs=5e-11)


def test_a_shorter_tail_takes_longer() -> None:
    times = []
    for within in ("1", "0.3", "0.1", "0.01"):
        found = tailed(*PITCH, "0.2", ("-0.3", "0.3"), ("2", within))
        assert found.status is Status.PROVED, (within, found.reason)
        assert found.upper is not None
        times.append((found.lower, found.upper))
    for (_, before), (after, _) in itertools.pairwise(times):
        assert after >= before * (1 - REPAIRED)
    assert times[-1][0] > times[0][1]


@pytest.mark.parametrize("scale", ["1e-6", "1e-3", "1e3", "1e6"])
def test_units_of_time_and_amplitude_do_not_matter(scale: str) -> None:
    unit = exact(scale)
    base = minimum_time(problem([LinearPlant.from_transfer([1], [1, 1, 2, 0, 0])], Maneuver(Fraction(1), Limits.of(-1, 1))))
    # s is measured in 1/scale, so that the gain becomes scale^4, and the times `scale` times shorter.
    plant = LinearPlant.from_transfer([unit**4], [1, unit, 2 * unit**2, 0, 0])
    fast = minimum_time(problem([plant], Maneuver(Fraction(1), Limits.of(-1, 1))))
    strong = minimum_time(problem([LinearPlant.from_transfer([1], [1, 1, 2, 0, 0])], Maneuver(unit, Limits(-unit, unit))))
    for found, expected in ((fast, base.lower / float(unit)), (strong, base.lower)):
        assert found.status is Status.PROVED
        assert found.gap is not None
        assert found.gap <= REGULAR
        assert found.lower == pytest.approx(expected, rel=1e-14)  # two proven doubles of the same number


def prove(seed: int) -> Bound:
    task = random_task(seed)
    found = minimum_time(task.problem())
    assert found.status is Status.PROVED, (task, found.reason)
    assert found.gap is not None, task
    assert found.gap <= REPAIRED, task
    if found.lower > 0.0:  # else it is a tail alone
        # An independent program (other coordinates, another solver): no staircase beats the lower side, and one needs little more than the
        # upper one.
        reach = Reach(task.plant, task.displacement, task.limits, task.robustness, task.tail)
        tolerance = 1e-6  # the solver's own
        assert found.upper is not None
        instants = (200, 1000, 4000) if task.tail else (200,)  # a tail that is looked at too seldom may reach more than there is
        assert any(reach(found.lower, 200, count) < 1.0 + tolerance for count in instants), task
        assert reach(1.05 * found.upper, 200) > 1.0, task
    return found


def test_random_plants() -> None:
    seeds = range(15)
    gaps = [prove(seed).gap or 0.0 for seed in seeds]
    assert sum(gap <= REGULAR for gap in gaps) >= 0.95 * len(seeds)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_many_random_plants(block: int) -> None:
    seeds = range(100 * block, 100 * (block + 1))
    gaps = [prove(seed).gap or 0.0 for seed in seeds]
    assert sum(gap <= REGULAR for gap in gaps) >= 0.95 * len(seeds)
