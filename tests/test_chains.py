"""Long chains: both sides proven to the last bit of a double, against Newton's method on the antisymmetric command alone."""

from __future__ import annotations

import itertools
from fractions import Fraction

import pytest
from flint import arb, arb_mat
from problems import chain

from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import precision
from relaxations.proofs import minimum_time

DISPLACEMENT = 5
BITS = 600
TIMES = {
    # [s], by `antisymmetric`.
    22: "27.07837246156423861499",
    40: "48.57368287495344624734",
    60: "72.67301575114851916549",
    80: "96.84779209313845885047",
    100: "121.0575881404620138333",
}


def proven(poles: int) -> Bound:
    return minimum_time(problem([chain(poles // 2)], Maneuver(Fraction(DISPLACEMENT), Limits.of(-1, 1))))


def antisymmetric(masses: int, command: Command, digits: int = 8) -> arb:
    """The duration of the chain's rest-to-rest command with 2n - 1 switches, antisymmetric about its middle, near a given one.

    With d_0 > d_1 > … > d_n = 0, half the duration and how long before the middle the switches are, the modes ω_k = 2 sin(kπ/2n) rest if
    `Σ (-1)^i (cos ω_k d_i - cos ω_k d_{i+1}) = 0`, and n masses move by Δ if `Σ (-1)^i (d_i² - d_{i+1}²) = n Δ`. The start is rounded to
    `digits` digits; no line of this is shared with the search.
    """
    n = masses
    with precision(BITS):
        half = command.maneuver_time / 2
        starts = [half, *(half - segment.start for segment in command.segments[1:n])]
        d = [arb(f"{start:.{digits}g}") for start in starts]
        frequencies = [2 * (arb.pi() * k / (2 * n)).sin() for k in range(1, n)]
        missed: list[arb] = []
        for _ in range(12):
            jumps = [1, *(2 * (-1) ** i for i in range(1, n))]
            middle = (-1) ** n
            missed = [sum((j * (w * x).cos() for j, x in zip(jumps, d, strict=True)), arb(middle)) for w in frequencies]
            missed.append(sum((j * x * x for j, x in zip(jumps, d, strict=True)), arb(-n * DISPLACEMENT)))
            slopes = [[-j * w * (w * x).sin() for j, x in zip(jumps, d, strict=True)] for w in frequencies]
            slopes.append([2 * j * x for j, x in zip(jumps, d, strict=True)])
            step = arb_mat(slopes).mid().solve(arb_mat(n, 1, missed).mid(), algorithm="approx")
            d = [(x - step[i, 0]).mid() for i, x in enumerate(d)]
        assert all(after < before for before, after in itertools.pairwise(d))
        assert max(float(abs(x)) for x in missed) < 1e-100
        return 2 * d[0]


def check_chain(poles: int) -> None:
    found = proven(poles)
    assert found.status is Status.PROVED, found.reason
    assert found.switches == poles - 1
    assert found.upper is not None
    assert found.gap is not None
    assert found.gap <= 1e-15  # neighbours of one double
    assert found.command is not None
    with precision(BITS):
        time = antisymmetric(poles // 2, found.command)
        assert arb(found.lower) <= time <= arb(found.upper)
        assert abs(time - arb(TIMES[poles])) < arb("1e-18")  # the digits given


@pytest.mark.parametrize("poles", [22, 40])
def test_long_chains(poles: int) -> None:
    check_chain(poles)


@pytest.mark.slow
@pytest.mark.parametrize("poles", [60, 80, 100])
def test_longer_chains(poles: int) -> None:
    check_chain(poles)
