"""Benchmarks of robust brackets: processor time and gap, each in one run. Times are never judged."""

from __future__ import annotations

import time
from collections.abc import Callable
from fractions import Fraction

import pytest
from box_tasks import TWIN, axis

from fmus.twins import twin_family
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import check
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.robust import moved
from relaxations.robust.boxes import Axis, Box

pytestmark = pytest.mark.benchmark

MODES = {"undamped": ("0", "0"), "damped": ("0.02", "0.02"), "lightly damped": ("0.002", "0.005")}


def one_parameter() -> Bound:
    """The two-mass spring, 5 m, stiffness within 30 %, 5 %."""
    family, axes = twin_family(TWIN, "x2", ["stiffness"]), (axis("stiffness", "0.3"),)
    maneuver = Maneuver(Fraction(5), Limits.of(-1, 1), box=Box(axes, family, Fraction(1, 20)))
    return minimum_time(problem([family.member([Fraction(1)])], maneuver))


def two_stiffnesses() -> Bound:
    """The two-mass spring, 1 m, stiffness and second mass within 10 %, 5 %: two parameters of one mode."""
    family, axes = twin_family(TWIN, "x2", ["stiffness", "mass_2"]), (axis("stiffness", "0.1"), axis("mass_2", "0.1"))
    maneuver = Maneuver(Fraction(1), Limits.of(-1, 1), box=Box(axes, family, Fraction(1, 20)))
    return minimum_time(problem([family.member([Fraction(1), Fraction(1)])], maneuver))


def two_modes(damping: str) -> Bound:
    """A body and two modes (1 and 2.7 rad/s), each frequency within 10 %, 2 m, 5 %: two parameters and two modes."""
    first, second = MODES[damping]
    plant = LinearPlant.from_modes(1, [(1, first, 1), ("2.7", second, "0.3")])
    return _moved(plant, Fraction(2))


def chain_of_three() -> Bound:
    """Three unit masses and two springs, whose modes' frequencies are no fractions, each within 10 %, 2 m, 5 %."""
    rows = [[0, 1, 0, 0, 0, 0], [-1, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [1, 0, -2, 0, 1, 0], [0, 0, 0, 0, 0, 1], [0, 0, 1, 0, -1, 0]]
    return _moved(LinearPlant.from_state_space(rows, [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0]), Fraction(2))


def _moved(plant: LinearPlant, displacement: Fraction) -> Bound:
    low, high = Fraction(9, 10), Fraction(11, 10)
    axes: tuple[Axis, ...] = tuple(moved.axis(plant, f"mode[{i}].frequency", low, high) for i in (1, 2))
    box = Box(axes, moved.moved(plant, axes), Fraction(1, 20))
    return minimum_time(problem([plant], Maneuver(displacement, Limits.of(-1, 1), box=box)))


@pytest.mark.parametrize(
    ("name", "solve"),
    [
        ("one parameter, one mode (at most 5 s, 1e-4)", one_parameter),
        ("two parameters, one mode", two_stiffnesses),
        *((f"two parameters, two modes, {damping} (at most 60 s)", lambda damping=damping: two_modes(damping)) for damping in MODES),
        ("two parameters, two modes of three masses (at most 60 s)", chain_of_three),
    ],
)
def test_box(name: str, solve: Callable[[], Bound], capsys: pytest.CaptureFixture[str]) -> None:
    begun = time.process_time()
    found = solve()
    taken = time.process_time() - begun
    assert found.status is Status.PROVED, found.reason
    begun = time.process_time()
    check(found.certificate or b"")
    checked = time.process_time() - begun
    with capsys.disabled():
        print(f"\n{name}: [{found.lower:.7f}, {found.upper:.7f}] s, gap {found.gap:.1e}, {taken:.2f} s of processor time;", end="")
        print(f" its check {checked:.2f} s", end="")
