"""Tails that must not matter if a zero is not where it should be: closed forms, the moved zero itself, certificates."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
import pytest
from forgery import opened
from independent import StateSpace
from marks import first

from relaxations import bounds, proofs, sides
from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time
from relaxations.refinement import Failure

Asked = Mapping[str, tuple[str, str]]
REGULAR = 1e-12

ROOTS: dict[str, tuple[list[Any], list[Any], Any, int]] = {
    "real": ([-1], [0, 0, -3], 1, 1),
    "pair": ([("-0.5", 2), ("-0.5", -2)], [0, 0, -2, ("-0.1", 3), ("-0.1", -3)], 1, 1),
    "double": ([-1, -1], [("-0.2", 1), ("-0.2", -1), -4], 3, 1),
    "double_pair": ([(-1, 2), (-1, -2)] * 2, [0, 0, -2, ("-0.1", 3), ("-0.1", -3), -4], 1, 1),
    "among_others": ([-1, ("-0.5", 2), ("-0.5", -2), 3], [0, 0, -2, ("-0.1", 3), ("-0.1", -3), -4], 1, 2),
    "feed_through": ([(-1, 2), (-1, -2)], [("-0.2", 1), ("-0.2", -1)], 1, 1),
}
PITCH = LinearPlant.from_transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"])


def posed(plant: LinearPlant, asked: Asked, displacement: str = "0.5", limit: str = "2", tail: bool = True) -> Problem:
    sensitivity = {name: (exact(shift), exact(residual)) for name, (shift, residual) in asked.items()}
    maneuver = Maneuver(exact(displacement), Limits.of("-" + limit, limit), tail=tail)
    return problem([plant], replace(maneuver, zero_sensitivity=sensitivity))


def proved(of: Problem) -> Bound:
    found = minimum_time(of)
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= REGULAR
    return found


def pitch(residual: str) -> Bound:
    return proved(posed(PITCH, {"zero[1]": ("0.1", residual)}, "0.2", "0.3"))


# The minimum time.


@pytest.mark.parametrize("residual", ["0.02", "0.05", "0.06"])
@pytest.mark.parametrize("gain", ["1", "-2.5"])
def test_closed_form_at_a_real_zero(residual: str, gain: str) -> None:
    """gain (s + 1)/s², |u| ≤ 1, by Δ = gain: G'(-1) = gain, so |c| ≤ residual/0.1 = γ; from ∫u = 0, ∫tu = -1, T = √(2γ² - 4γ + 4) - γ."""
    k = exact(gain)
    found = proved(posed(LinearPlant.from_transfer([k, k], [1, 0, 0]), {"zero[1]": ("0.1", residual)}, gain, "1"))
    bound = float(residual) / 0.1
    assert found.upper is not None
    time = sqrt(2 * bound**2 - 4 * bound + 4) - bound
    assert found.lower * (1 - 1e-15) <= time <= found.upper * (1 + 1e-15)  # rounding of the closed form


def test_a_slack_limit_changes_nothing() -> None:
    free = proved(posed(PITCH, {}, "0.2", "0.3"))
    for residual in ("100", "0.1"):
        assert (pitch(residual).lower, pitch(residual).upper) == (free.lower, free.upper)


def test_less_residual_takes_longer_and_none_takes_the_zero_away() -> None:
    found = [pitch(residual) for residual in ("0.1", "0.05", "0.01", "1e-6", "0")]
    for looser, tighter in itertools.pairwise(found):
        assert looser.upper is not None
        assert looser.upper < tighter.lower
    state = proved(posed(PITCH, {}, "0.2", "0.3", tail=False))
    assert (found[-1].lower, found[-1].upper) == (state.lower, state.upper)
    assert found[-2].lower == pytest.approx(state.lower, rel=1e-4)


def test_without_a_residual_a_double_zero_is_a_simple_one() -> None:
    """Of c_0 e^{-r} + c_1 r e^{-r} the first is left: the limit of ever smaller residuals."""
    plant = LinearPlant.from_zeros_poles(*ROOTS["double"][:3])
    none, little = (proved(posed(plant, {"zero[1]": ("0.1", residual)})) for residual in ("0", "1e-7"))
    assert none.lower == pytest.approx(little.lower, rel=1e-6)
    assert little.lower < none.lower
    assert none.command is not None
    assert [term.power for term in none.command.tail.terms] == [0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["real", "pair", pytest.param("double_pair", marks=pytest.mark.slow)])
def test_repair_respects_the_limit_too(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing can be refined the grid's staircase is repaired, tail included, and both sides are proven by the checker."""
    of = posed(LinearPlant.from_zeros_poles(*ROOTS[name][:3]), {"zero[1]": ("0.1", "0.02")})
    regular = proved(of)
    monkeypatch.setattr(bounds, "refine", lambda *_: Failure("not today"))
    monkeypatch.setattr(proofs, "polish", lambda *_: None)
    monkeypatch.setattr(sides, "FINER", (1, 4))
    found = minimum_time(of)
    assert found.status is Status.PROVED, found.reason
    assert found.switches is None
    assert found.upper is not None
    assert regular.upper is not None
    assert found.lower <= regular.upper
    assert regular.lower <= found.upper
    assert found.gap is not None
    assert found.gap <= 1e-5  # of 25 · 4 intervals an equation; 1e-7 and less on finer grids


# The zero moves.


def residual(plant: LinearPlant, move: Command, displacement: float) -> float:
    """Largest distance of the output from its rest value after the move, over the displacement: by an independent integration."""
    slowest = min(-term.rate.real for term in move.tail.terms)
    times = move.end + np.concatenate([np.linspace(1e-9, 6.0 / slowest, 50), [40.0 / slowest]])
    output = StateSpace.of(plant).integrate(move, times)
    return float(np.abs(output[:-1] - output[-1]).max() / abs(displacement))


def same(root: Any, value: complex) -> bool:
    """Whether a root as written is this one, or its conjugate."""
    written = complex(*map(float, root)) if isinstance(root, tuple) else complex(float(root))
    return min(abs(written - value), abs(written - value.conjugate())) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", first(2, ROOTS))
def test_a_moved_zero_moves_the_output_by_no_more(name: str) -> None:
    """By a thousandth of the shift asked for, in whatever direction: at worst a thousandth of the residual, and in some direction that."""
    zeros, poles, gain, which = ROOTS[name]
    plant = LinearPlant.from_zeros_poles(zeros, poles, gain)
    found = proved(posed(plant, {f"zero[{which}]": ("0.1", "0.02")}))
    assert found.command is not None
    zero = plant.zeros[which - 1]
    others = [root for root in zeros if not same(root, zero.value)]
    seen = []
    for turn in np.linspace(0.0, 2 * np.pi, 8, endpoint=False) if zero.is_flexible else (0.0, np.pi):
        place = zero.value + 1e-4 * abs(zero.value) * np.exp(1j * turn)
        moved = [(Fraction(place.real), Fraction(sign * place.imag) if zero.is_flexible else Fraction(0)) for sign in (1, -1)]
        moved = moved[: 1 + zero.is_flexible] * zero.multiplicity
        seen.append(residual(LinearPlant.from_zeros_poles([*others, *moved], poles, gain), found.command, 0.5) / 1e-3)
    assert max(seen) <= 0.02 * 1.01  # what is not of first order is a thousandth of that
    assert max(seen) >= 0.02 * 0.9  # of 8 directions the nearest is at most 22.5° from the worst


# What is refused.


@pytest.mark.parametrize(
    ("asked", "tail", "said"),
    [
        ({"zero[1]": ("0.1", "0.1")}, False, "tail = true"),
        ({"zero[2]": ("0.1", "0.1")}, True, "along zero[1] (-0.154127) of this plant, not along zero[2]"),
        ({"zero[1]": ("0", "0.1")}, True, "more than 0"),
        ({"zero[1]": ("0.1", "-0.1")}, True, "0 or more"),
    ],
)
def test_what_makes_no_sense_is_refused(asked: Asked, tail: bool, said: str) -> None:
    with pytest.raises(ManeuverError) as refused:
        posed(PITCH, asked, "0.2", "0.3", tail)
    assert said in str(refused.value)


def test_a_zero_right_of_the_axis_has_no_tail() -> None:
    plant = LinearPlant.from_zeros_poles([-1, 2], [0, 0, -3, -4], 1)
    with pytest.raises(ManeuverError, match=r"along zero\[1\] \(-1\) of this plant, not along zero\[2\]"):
        posed(plant, {"zero[2]": ("0.1", "0.1")})


# The certificate (the checker's side: test_checking_sensitivity.py).


def test_the_sensitivity_stands_in_the_certificate_as_it_was_asked() -> None:
    content = pitch("0.05").certificate
    assert content is not None
    assert opened(content)["task"]["limits"]["zero_sensitivity"] == {"zero[1]": {"shift": "0.1", "residual": "0.05"}}
