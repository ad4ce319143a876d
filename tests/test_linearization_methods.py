"""Directional derivatives, differences, identification and the linear twin give the same plant: poles, zeros and gain to 1e-6, relative.

Of every plant shipped, from its input to each of its outputs, with FMI 2.0 and 3.0. Identification sees nothing but the output: what the
output does not show (a pole with a zero on it, of the twin's whole state) is left out on both sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from made_fmus import steps_only
from marks import in_turn

from fmus.archives import open_archive
from fmus.build import FmiVersion, build, shipped
from fmus.catalogue import catalogue
from fmus.linearization import Method, linearize
from fmus.twins import linear_plant, read_twin
from fmus.workers import Worker
from relaxations.plants import LinearPlant
from suite.linear import every_root

EQUAL = 1e-6
SAME = 1e-9  # of a pole and the zero on it, relative: they cancel
MAIN = {entry.name: entry.output for entry in catalogue()}
Roots = list[complex]


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def seen(plant: LinearPlant, output: str) -> tuple[Roots, Roots, float]:
    """Poles and zeros that the output shows, and the gain."""
    poles, zeros = ([complex(*root) for root in every_root(roots)] for roots in (plant.poles, plant.zeros))
    for zero in list(zeros):
        near = min(poles, key=lambda pole: abs(pole - zero), default=None)
        if near is not None and abs(near - zero) <= SAME * max(abs(near), abs(zero)):
            poles.remove(near)
            zeros.remove(zero)
    return poles, zeros, float(plant.numerators[output].coeffs()[-1])


def farthest(found: Roots, exact: Roots) -> float:
    """The largest distance of a root from its own counterpart, relative; a root at 0 has to be at 0 exactly."""
    assert len(found) == len(exact)
    left, worst = list(exact), 0.0
    for root in found:
        near = min(left, key=lambda other: abs(other - root))
        left.remove(near)
        worst = max(worst, abs(root - near) / abs(near) if near else abs(root) / EQUAL)
    return worst


def compare(name: str, version: FmiVersion, output: str, method: Method, worker: Worker, folder: Path) -> float:
    """The largest relative distance of poles, zeros and gain from the twin's."""
    path = build(name, version)
    twin = read_twin(open_archive(path).twin or "")
    fmu = open_archive(steps_only(path, folder / "silent.fmu") if method == "identified" else path)
    found = linearize(fmu, twin.input, output, method=method, worker=worker)
    expected = {"derivatives": "directional derivatives", "differences": "finite differences", "identified": "identified"}
    assert found.method == expected[method]
    (poles, zeros, gain), exact = seen(found.plant(output).plant, output), seen(linear_plant(twin, output), output)
    return max(farthest(poles, exact[0]), farthest(zeros, exact[1]), abs(gain / exact[2] - 1.0))


def outputs(name: str) -> tuple[str, ...]:
    return tuple(read_twin(open_archive(build(name)).twin or "").outputs)


@pytest.mark.parametrize(("name", "version"), in_turn(shipped(), quick=5))
def test_derivatives_and_differences_are_the_twin(name: str, version: FmiVersion, worker: Worker, tmp_path: Path) -> None:
    for output in outputs(name):
        for method in ("derivatives", "differences"):
            assert compare(name, version, output, method, worker, tmp_path) < EQUAL, (output, method)


@pytest.mark.parametrize(("name", "version"), [("two_mass", "2.0"), ("stirred_tanks", "3.0")])
def test_what_is_identified_is_the_twin(name: str, version: FmiVersion, worker: Worker, tmp_path: Path) -> None:
    """One version each, to be quick; both below."""
    assert compare(name, version, MAIN[name], "identified", worker, tmp_path) < EQUAL


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", shipped())
def test_what_is_identified_from_any_output_is_the_twin(name: str, version: FmiVersion, worker: Worker, tmp_path: Path) -> None:
    for output in outputs(name):
        assert compare(name, version, output, "identified", worker, tmp_path) < EQUAL, output


def test_another_plant_is_told_apart(worker: Worker, tmp_path: Path) -> None:
    """A stiffness that is off by a hundred-thousandth moves the pole by half of that."""
    path = build("two_mass")
    exact = seen(linear_plant(read_twin(open_archive(path).twin or ""), "position_2"), "position_2")
    found = linearize(open_archive(path), "force", "position_2", {"stiffness": 1.00001}, worker=worker)
    assert farthest(seen(found.plant("position_2").plant, "position_2")[0], exact[0]) == pytest.approx(5e-6, rel=1e-3)
