"""Moves that begin elsewhere than at rest: known answers, another program, landing, the certificate's new terms, and what is refused."""

from __future__ import annotations

from fractions import Fraction
from math import acos, sqrt

import numpy as np
import pytest
from independent import StateSpace
from problems import two_mass
from proving import proven
from scipy.linalg import expm
from scipy.optimize import linprog

from relaxations.errors import ManeuverError
from relaxations.initial import at_rest, from_output, from_state, moments, moved
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.moments import Basis
from relaxations.plants import LinearPlant
from relaxations.response import response

RIGID = LinearPlant.from_transfer([1], [1, 0, 0])
PENDULUM = LinearPlant.from_transfer([1], [1, 0, 1])
DAMPED = LinearPlant.from_transfer([1], [1, Fraction(1, 5), 1])
SPEED = LinearPlant.from_transfer([1], [1, 0, 2, 0])
SPRING_A, SPRING_B = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [1, -1, 0, 0]], [0, 0, 1, 0]
Numbers = tuple[Fraction | int | str, ...]


def posed(plant: LinearPlant, start: Numbers, displacement: Fraction | int = 0, **others: object):
    """A plant whose output and its derivatives begin at `start`; |u| ≤ 1."""
    limits = Limits(Fraction(-1), Fraction(1), others.pop("fuel", None))  # type: ignore[arg-type]
    begin = from_output(plant, [Fraction(x) for x in start])
    return problem([plant], Maneuver(Fraction(displacement), limits, initial=begin, **others))  # type: ignore[arg-type]


CASES = {
    "rigid body that flies on": (RIGID, (0, 1), 0, 1 + sqrt(2)),
    "rigid body, farther": (RIGID, (0, 1), 2, 2 * sqrt(2.5) - 1),  # v + a t_1, then braking: Δ = v²/(2a) + …
    "pendulum at its turning point": (PENDULUM, (1, 0), 0, acos(-1 / 4)),
    "two masses that coast": (SPEED, (2, 0, 0), 0, 4.2211000412701),  # the same command backwards brings them to that speed
}


@pytest.mark.parametrize("name", CASES)
def test_known_minimum_times(name: str) -> None:
    plant, start, displacement, time = CASES[name]
    found, _ = proven(posed(plant, start, displacement))
    assert found.lower <= time * (1 + 1e-12)
    assert found.upper is not None
    assert found.upper >= time * (1 - 1e-12)
    assert found.upper / found.lower - 1 < 1e-12


@pytest.mark.parametrize(
    ("plant", "start", "displacement"),
    [
        (RIGID, (0, 1), 0),
        (PENDULUM, (5, 3), 0),
        (DAMPED, (2, -1), Fraction(1, 2)),
        (two_mass(), (Fraction(1, 2), Fraction(-1, 4), 0, Fraction(1, 8)), 3),
    ],
)
def test_the_command_lands_and_another_program_finds_none_that_is_shorter(
    plant: LinearPlant, start: Numbers, displacement: Fraction | int
) -> None:
    asked = posed(plant, start, displacement)
    found, command = proven(asked)
    after = np.linspace(command.end, command.end + 20.0, 101)
    landed = response(plant, command, after, begin=asked.maneuver.initial)
    np.testing.assert_allclose(landed, float(displacement), rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(
        [float(response(plant, command, [0.0], begin=asked.maneuver.initial)[0])], [float(Fraction(start[0]))], atol=1e-12
    )
    assert found.upper is not None
    assert reachable(plant, start, float(displacement), found.upper * 1.01)
    assert not reachable(plant, start, float(displacement), found.lower * 0.99)


def reachable(plant: LinearPlant, start: Numbers, displacement: float, time: float, cells: int = 400) -> bool:
    """Whether HiGHS finds a staircase of |u| ≤ 1 from `start` to rest, with matrix exponentials in place of moments."""
    space = StateSpace.of(plant)
    n = len(space.B)
    see = np.array([space.C @ np.linalg.matrix_power(space.A, k) for k in range(n)])
    begin = np.linalg.solve(see, np.array([float(Fraction(x)) for x in start]))
    rest = np.linalg.lstsq(np.vstack([space.A, see[:1]]), np.append(np.zeros(n), displacement), rcond=None)[0]
    hold = 0.0
    if not np.allclose(space.A @ rest, 0.0, atol=1e-9):
        rest, hold = space.rest(displacement)
    transition, constant, _ = space.step(time / cells)
    columns, column = np.zeros((n, cells)), constant
    for k in range(cells - 1, -1, -1):
        columns[:, k] = column
        column = transition @ column
    wanted = rest - expm(space.A * time) @ begin
    scale = np.abs(columns).max(axis=1)
    assert abs(hold) <= 1.0
    found = linprog(np.zeros(cells), A_eq=columns / scale[:, None], b_eq=wanted / scale, bounds=[(-1.0, 1.0)] * cells, method="highs")
    return bool(found.success)


def test_a_start_at_rest_elsewhere_is_a_move() -> None:
    """From rest at -1 to 0 is a displacement of 1."""
    began, moved_by_one = (
        proven(posed(two_mass(), (-1, 0, 0, 0)))[0],
        proven(problem([two_mass()], Maneuver(Fraction(1), Limits.of(-1, 1))))[0],
    )
    assert began.lower == pytest.approx(moved_by_one.lower, rel=1e-12)
    assert began.upper == pytest.approx(moved_by_one.upper, rel=1e-12)


def test_a_small_deviation_changes_little_and_none_is_rest() -> None:
    rest = proven(problem([DAMPED], Maneuver(Fraction(1, 2), Limits.of(-1, 1))))[0]
    times = [proven(posed(DAMPED, (Fraction(1, 10**k), 0), Fraction(1, 2)))[0].lower for k in (3, 6, 9)]
    assert [abs(time - rest.lower) < 10.0**-k * 5 for k, time in zip((3, 6, 9), times, strict=True)] == [True] * 3
    assert proven(posed(DAMPED, (0, 0), Fraction(1, 2)))[0].lower == pytest.approx(rest.lower, rel=1e-12)


def test_with_samples_and_with_a_budget() -> None:
    free = proven(posed(PENDULUM, (5, 3)))[0]
    sampled, command = proven(posed(PENDULUM, (5, 3), sample_time=Fraction(1, 4)))
    assert free.lower <= sampled.lower <= free.lower + 0.5
    assert sampled.upper == sampled.lower
    assert all(segment.start * 4 == round(segment.start * 4) for segment in command.segments)
    begin = from_output(PENDULUM, [5, 3])
    np.testing.assert_allclose(response(PENDULUM, command, [command.end, command.end + 1.0], begin=begin), 0.0, atol=1e-8)
    assert free.command is not None
    saving, frugal = proven(posed(PENDULUM, (5, 3), fuel=Fraction(8)))
    assert saving.lower > free.lower
    assert frugal.fuel() <= 8.0 + 1e-9 < free.command.fuel()


# Coordinates.


def test_states_and_output_derivatives_say_the_same() -> None:
    plant = two_mass()
    rng = np.random.default_rng(5)
    state = [Fraction(int(x), 16) for x in rng.integers(-40, 40, 4)]
    A, C = np.array(SPRING_A, dtype=float), np.array([0.0, 1.0, 0.0, 0.0])
    derivatives = [Fraction(float(C @ np.linalg.matrix_power(A, k) @ np.array([float(x) for x in state]))) for k in range(4)]
    assert from_state(plant, SPRING_A, SPRING_B, state) == from_output(plant, derivatives)


@pytest.mark.parametrize("plant", [two_mass(), DAMPED, LinearPlant.from_transfer([1, 3], [1, 4, 6, 4, 0, 0])])
def test_moments_move_as_the_output_says(plant: LinearPlant) -> None:
    start = [Fraction(k + 1, 3) for k in range(plant.order)]
    basis, weights = Basis(plant.poles), Basis(plant.poles).weights(plant.partial())
    begin = moments(plant, basis, from_output(plant, start))
    times = np.array([0.0, 0.7, 1.9])
    course, slope = moved(basis, begin, times)
    space = StateSpace.of(plant)
    see = np.array([space.C @ np.linalg.matrix_power(space.A, k) for k in range(plant.order)])
    x = np.linalg.solve(see, np.array([float(value) for value in start]))
    np.testing.assert_allclose(weights @ course, [space.C @ expm(space.A * t) @ x for t in times], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(weights @ slope, [space.C @ space.A @ expm(space.A * t) @ x for t in times], rtol=1e-10, atol=1e-10)


def test_what_no_command_can_move_is_refused() -> None:
    A, B = [[-1, 0], [0, -2]], [1, 0]
    plant = LinearPlant.from_state_space(A, B, [1, 1])
    assert from_state(plant, A, B, [3, 0]) == (Fraction(3),)
    with pytest.raises(ManeuverError, match="the input cannot reach"):
        from_state(plant, A, B, [3, 1])


def test_bad_starts_are_refused_in_words() -> None:
    with pytest.raises(ManeuverError, match="first 1 derivatives, not 3"):
        from_output(PENDULUM, [1, 2, 3])
    with pytest.raises(ManeuverError, match="does not see every mode"):
        from_output(LinearPlant.from_transfer([1, 1], [1, 3, 2]), [1, 0])
    rest = at_rest(PENDULUM, Fraction(1, 2))
    with pytest.raises(ManeuverError, match="final rest already"):
        problem([PENDULUM], Maneuver(Fraction(1, 2), Limits.of(-1, 1), initial=rest))
    with pytest.raises(ManeuverError, match="does not go with further zeros"):
        posed(PENDULUM, (1, 0), robustness=1)
    with pytest.raises(ManeuverError, match="has 2 numbers, not 1"):
        problem([PENDULUM], Maneuver(Fraction(0), Limits.of(-1, 1), initial=(Fraction(1),)))
