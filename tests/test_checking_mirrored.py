"""Commands that are their own mirror image about the middle of the move, by hand: known ones, their moments, and what is none."""

from __future__ import annotations

import random
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from flint import arb, fmpq
from forgery import certificate, posed, task
from scipy.linalg import expm

from relaxations.checking import upper
from relaxations.checking.claims import Outcome, check
from relaxations.checking.mirrored import Half
from relaxations.checking.reading import UPPER, Malformed, shaped

MASSES, THREE = ["1", "0", "2", "0", "0"], ["1", "0", "1", "0"]
TWO = [("0", "1"), ("2.2507908", "0"), ("4.4428829", "-1")]
FREE = [["time", 0, 0], ["start", 1, 0]]


def witness(time: str, segments: list[tuple[str, str]], free: list[list[Any]], radius: str = "1/1000000") -> dict[str, Any]:
    arcs = [{"start": start, "level": level} for start, level in segments]
    return {"maneuver_time": time, "segments": arcs, "tail": [], "free": free, "radius": radius, "mirrored": True}


def verdict(
    denominator: list[str],
    displacement: str,
    time: str,
    segments: list[tuple[str, str]],
    free: list[list[Any]],
    claimed: str,
    **others: Any,
) -> Outcome:
    of = task(["1"], denominator, displacement, **others)
    return check(certificate(of, upper=claimed, witnesses=(None, witness(time, segments, free)))).outcome


def test_two_pulses_one_period_apart() -> None:
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373") is Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367372") is not Outcome.PROVED
    assert verdict(MASSES, "5.1", "6.6936737", TWO, FREE, "6.8") is not Outcome.PROVED
    assert verdict(MASSES, "-5", "6.6936737", TWO, FREE, "6.8") is not Outcome.PROVED
    other = [(start, {"1": "-1", "0": "0", "-1": "1"}[level]) for start, level in TWO]
    assert verdict(MASSES, "-5", "6.6936737", other, FREE, "6.69367373") is Outcome.PROVED


def test_what_is_written_of_the_second_half_counts_for_nothing() -> None:
    for start in ("3", "4.4428829", "6", "1/3"):
        segments = [*TWO[:2], (start, "-1")]
        assert verdict(MASSES, "5", "6.6936737", segments, FREE, "6.69367373") is Outcome.PROVED


def test_an_image_of_the_same_sign() -> None:
    """1/(s³ + s): two pulses of 0.5 s half a period apart; u(T - t) = u(t)."""
    segments = [("0", "1"), ("0.5", "0"), ("3.1415927", "1")]
    assert verdict(THREE, "1", "3.6415927", segments, FREE, "3.64159266") is Outcome.PROVED
    assert verdict(THREE, "1", "3.6415927", segments, FREE, "3.64159265") is not Outcome.PROVED
    opposite = [("0", "1"), ("0.5", "0"), ("3.1415927", "-1")]
    assert verdict(THREE, "1", "3.6415927", opposite, FREE, "3.65") is Outcome.MALFORMED


def test_a_body_alone_whose_switch_is_in_the_middle() -> None:
    """Forth and back, 1 s each: the middle is no unknown."""
    assert verdict(["1", "0", "0"], "1", "2", [("0", "1"), ("1", "-1")], [["time", 0, 0]], "2.0000000001") is Outcome.PROVED
    assert verdict(["1", "0", "0"], "1", "2", [("0", "1"), ("1", "-1")], [["time", 0, 0]], "1.9999999") is not Outcome.PROVED
    assert verdict(["1", "0", "0"], "1", "2", [("0", "1"), ("1", "-1")], [["start", 1, 0]], "2.1") is Outcome.MALFORMED
    assert verdict(["1", "0"], "2", "2", [("0", "1")], [["time", 0, 0]], "2.0000000001") is Outcome.PROVED
    assert verdict(["1", "0"], "2", "2", [("0", "-1")], [["time", 0, 0]], "2.1") is not Outcome.PROVED


@pytest.mark.parametrize(
    ("denominator", "segments", "free"),
    [
        (["1", "1/1000000", "2", "0", "0"], TWO, FREE),  # the mode decays
        (["1", "0", "3", "0", "2", "1/1000000", "0", "0"], TWO, FREE),  # one of two
        (["1", "0", "1", "0", "0", "0", "0"], TWO, [*FREE, ["start", 2, 0]]),  # an unknown of the second half
        (MASSES, [("0", "1"), ("2.25", "0"), ("4.44", "-0.5")], FREE),
        (MASSES, [("0", "1"), ("2.25", "0"), ("4.44", "1")], FREE),
        (MASSES, [("0", "1"), ("2.25", "0.1"), ("4.44", "-1")], FREE),  # the middle of an odd command is 0
        (["1", "0", "2"], TWO, FREE),  # no pole at the origin
        (MASSES, TWO, [["time", 0, 0]]),
        (MASSES, TWO, [["time", 0, 0], ["level", 1, 0]]),
        (MASSES, TWO, [*FREE, ["level", 0, 0]]),
        (["1", "0", "-2", "0", "0"], TWO, FREE),  # a pair of real poles
        (["1", "0", "-1", "0", "-2", "0", "0"], TWO, FREE),  # beside one that does not decay
        (["1", "1", "2", "2", "0", "0"], TWO, FREE),  # a lag beside one
    ],
)
def test_what_is_no_mirrored_command(denominator: list[str], segments: list[tuple[str, str]], free: list[list[Any]]) -> None:
    assert verdict(denominator, "0.5", "6.6936737", segments, free, "7") is Outcome.MALFORMED


@pytest.mark.parametrize(
    "others",
    [
        {"initial_state": ["0", "0", "0", "0"]},
        {"sample_time": "1/100"},
        {"rate": ["-100", "100"]},
        {"rest": "output"},
    ],
)
def test_what_no_mirrored_command_goes_with(others: dict[str, Any]) -> None:
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "7", **others) is Outcome.MALFORMED


def test_mirrored_is_true_or_false() -> None:
    of = task(["1"], MASSES, "5")
    for value in (1, 0, None, "true"):
        own = {**witness("6.6936737", TWO, FREE), "mirrored": value}
        assert check(certificate(of, upper="7", witnesses=(None, own))).outcome is Outcome.MALFORMED
    own = {**witness("6.6936737", TWO, FREE), "mirrored": False}  # four equations, two unknowns
    assert check(certificate(of, upper="7", witnesses=(None, own))).outcome is Outcome.MALFORMED


def test_limits_hold_for_both_halves() -> None:
    """Of the input, of pulses and of fuel: 2 (T - 2π/ω) = 4.5016 of it."""
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", limits=("-0.99", "1")) is not Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", pulse_width="2.25") is Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", pulse_width="2.251") is not Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", pulses=2) is Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", pulses=1) is not Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", fuel="4.5016") is Outcome.PROVED
    assert verdict(MASSES, "5", "6.6936737", TWO, FREE, "6.69367373", fuel="4.5015") is not Outcome.PROVED
    crossed = [("0", "1"), ("4", "0"), ("4.4428829", "-1")]  # begins of the second half that come before the end of the first
    assert verdict(MASSES, "5", "6.6936737", crossed, FREE, "7") is not Outcome.PROVED


# Any mirrored command, against the flow of the plant.


PLANTS = {
    "body": ["1", "0", "0"],
    "integrator": ["1", "0"],
    "masses": MASSES,
    "odd": THREE,
    "two modes": ["1", "0", "5", "0", "4", "0", "0"],
    "a mode twice": ["1", "0", "2", "0", "1", "0", "0"],
    "four integrators": ["1", "0", "1", "0", "0", "0", "0"],
}


def odd(of: list[str]) -> int:
    return -1 if next(k for k, c in enumerate(reversed(of)) if c != "0") % 2 == 0 else 1


def drawn(rng: random.Random, n: int, sign: int) -> list[Fraction]:
    """Duration, the starts of the first half in order, levels that are their own image."""
    at = sorted(Fraction(rng.randint(1, 99), 40) for _ in range(n - 1))
    half: list[Fraction] = [Fraction(rng.randint(-4, 4), 3) for _ in range((n + 1) // 2)]
    levels = [*half, *(sign * x for x in half[: n // 2][::-1])]
    if n % 2 and sign < 0:
        levels[n // 2] = Fraction(0)
    return [Fraction(5), Fraction(0), *at, *levels]


@pytest.mark.parametrize("of", PLANTS)
@pytest.mark.parametrize("n", [2, 3, 5, 6])
def test_the_plant_ends_where_the_equations_that_are_left_say(of: str, n: int) -> None:
    """What they miss and what the plant's state misses: both vanish together; so state = linear map of the moments about the middle."""
    rng, denominator = random.Random(f"{of} {n}"), PLANTS[of]
    numbers = [float(Fraction(c)) for c in denominator]
    size = len(numbers) - 1
    A, states, missed = np.zeros((size + 1, size + 1)), [], []
    A[: size - 1, 1:size] = np.eye(size - 1)
    A[size - 1, :size], A[size - 1, size] = [-c for c in numbers[:0:-1]], 1.0
    half = None
    for _ in range(12):
        drawing = drawn(rng, n, odd(denominator))
        command = [fmpq(x.numerator, x.denominator) for x in drawing]
        with posed(task(["1"], denominator)) as own:
            half = Half.of(own, n, command, [])
            whole = [Fraction(int(x.p), int(x.q)) for x in half.whole(command)]
            residual = [float(x.mid()) for x in half.residual(command).entries()]
        instants, state = [*whole[1 : n + 1], whole[0]], np.zeros(size)
        assert all(a + b == whole[0] for a, b in zip(instants, instants[::-1], strict=True))
        for (begin, after), level in zip(pairwise(instants), whole[n + 1 : 2 * n + 1], strict=True):
            state = (expm(A * float(after - begin)) @ np.append(state, float(level)))[:size]
        states.append(state - np.eye(size)[0])
        missed.append(residual)
    assert half is not None
    assert len(half.places) == (size + 1) // 2 if odd(denominator) > 0 else len(half.places) * 2 == size
    # a linear map from as few equations gives the whole state
    found, *_ = np.linalg.lstsq(np.array(missed), np.array(states), rcond=None)
    assert np.abs(np.array(missed) @ found - np.array(states)).max() < 1e-8
    assert np.linalg.matrix_rank(np.array(missed), tol=1e-9) == np.linalg.matrix_rank(np.array(states), tol=1e-9)


@pytest.mark.parametrize("of", PLANTS)
@pytest.mark.parametrize("n", [2, 3, 6])
def test_derivatives_are_those_of_the_equations(of: str, n: int) -> None:
    rng, denominator, tiny = random.Random(f"{of} {n}"), PLANTS[of], fmpq(1, 10**12)
    drawing = drawn(rng, n, odd(denominator))
    command = [fmpq(x.numerator, x.denominator) for x in drawing]
    with posed(task(["1"], denominator)) as own:
        half = Half.of(own, n, command, [])
        for place in [0, *range(2, 1 + (n + 1) // 2)]:
            sides = [half.residual([x + side * tiny if i == place else x for i, x in enumerate(command)]) for side in (1, -1)]
            steep = (sides[0] - sides[1]) / arb(2 * tiny)
            for one, other in zip(steep.entries(), half.derivative(command, place).entries(), strict=True):
                assert abs(one - other) < 1e-15


def test_krawczyk_takes_the_half_for_the_whole() -> None:
    """The instants of the command that is found lie about its middle, in balls."""
    with posed(task(["1"], MASSES, "5")) as own:
        named = shaped(witness("6.6936737", TWO, FREE), UPPER, "upper")
        command: list[Any] = upper.solve(own, 3, named)
    period = 2**0.5 * np.pi
    exact = [10 / period + period, 0.0, 10 / period, period]
    assert [float(arb(x).mid()) for x in command[:4]] == pytest.approx(exact, abs=1e-14)
    assert all(arb(x).rad() < 1e-10 for x in command[:4])
    with posed(task(["1"], MASSES, "5")) as own, pytest.raises(Malformed, match="its unknowns the duration"):
        Half.of(own, 3, [*command[:4], fmpq(1), fmpq(0), fmpq(-1)], [("start", 2, 0)])
