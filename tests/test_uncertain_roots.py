"""Boxes whose parameters move modes and zeros of a plant that is given as numbers."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_tasks import (
    BLOCK,
    CART,
    DAMPING,
    FREQUENCY,
    ONE,
    PLANTS,
    TWO_MASS,
    ZERO,
    Ranges,
    axis,
    fastest,
    forged,
    left,
    robust,
    tolerant,
    transfer,
    upper_of,
)
from marks import slow

from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError
from relaxations.plants import LinearPlant
from relaxations.robust import moved
from relaxations.robust.boxes import Axis, Family, Listed
from suite.design import design
from suite.errors import StudyError
from suite.loading import load_study
from suite.verification import verify


def agree(one: Bound, other: Bound) -> None:
    """Two proven brackets of one number, each to 1e-4: they overlap, and both are proven."""
    for found in (one, other):
        assert found.status is Status.PROVED, found.reason
        assert found.gap is not None
        assert found.gap <= 1e-4
    assert one.lower <= upper_of(other)
    assert other.lower <= upper_of(one)


@pytest.mark.slow
def test_a_frequency_is_the_root_of_a_stiffness():
    """The spring's gain keeps its value at rest, and k grows with ω²: [0.9, 1.1] of the one is [0.81, 1.21] of the other."""
    agree(tolerant("spring", FREQUENCY, "1"), robust("1", "0.05", Axis("stiffness", Fraction(1), Fraction(81, 100), Fraction(121, 100))))


@pytest.mark.slow
def test_a_damping_ratio_is_a_coefficient():
    """1/(s² + 2ζ s + 1), from no damping at all on."""
    family = transfer(["z"], [ONE], [ONE, {(1,): 2}, ONE])
    agree(tolerant("block", DAMPING, "0.5"), fastest(family, Axis("z", Fraction(1, 10), Fraction(0), Fraction(1, 5))))


@pytest.mark.slow
def test_a_zero_is_moved_at_a_constant_static_gain():
    """(s + 2g)/g."""
    family = transfer(["g"], [ONE, {(1,): 2}], [{(1,): 1}, {(1,): "0.4"}, {(1,): 2}, {}])
    agree(tolerant("cart", ZERO, "1"), fastest(family, Axis("g", Fraction(1), Fraction(4, 5), Fraction(5, 4)), displacement="1"))


@pytest.mark.slow
def test_frequency_and_damping_together():
    """s² + 2 ζ f s + f², gain f²: two parameters in one coefficient."""
    f = {(2, 0): 1}
    family = transfer(["f", "z"], [f], [{(0, 0): 1}, {(1, 1): 2}, f])
    axes = axis("f", "0.1"), Axis("z", Fraction(1, 10), Fraction(1, 10), Fraction(1, 5))
    agree(tolerant("block", (*FREQUENCY, ("mode[1].damping", "0.1", "0.2")), "0.5"), fastest(family, *axes))


def member(plant: LinearPlant, changes: dict[str, float]) -> LinearPlant:
    """By NumPy alone: the plant with roots moved, its gain at rest kept."""
    N, D = ([float(c) for c in reversed(p.coeffs())] for p in (plant.numerators[plant.output], plant.denominator))

    def shifted(coefficients: list[float], kind: str) -> np.ndarray:
        roots = np.roots(coefficients)
        chosen = sorted({(abs(z), abs(z.imag)) for z in roots if kind == "zero" or abs(z.imag) > 1e-9})
        moving = []
        for z in roots:
            place = next((i for i, (size, _) in enumerate(chosen, 1) if abs(abs(z) - size) < 1e-9), 0)
            factor = changes.get(f"zero[{place}]" if kind == "zero" else f"mode[{place}].frequency", 1.0)
            damping = changes.get(f"mode[{place}].damping") if kind == "mode" else None
            size = abs(z)
            unit = z if damping is None else size * complex(-damping, np.sign(z.imag) * np.sqrt(1 - damping**2))
            moving.append(factor * unit)
        return np.atleast_1d(np.real(np.poly(moving))) * coefficients[0]

    above, below = shifted(N, "zero"), shifted(D, "mode")
    below[np.abs(below) < 1e-12 * np.abs(below).max()] = 0.0
    last = [next(c for c in reversed(list(p)) if c) for p in (N, D, above, below)]
    above = above * (last[0] / last[1]) / (last[2] / last[3])
    return LinearPlant.from_transfer([float(c) for c in above], [float(c) for c in below])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ranges"),
    [
        ("lagged", (("mode[1].frequency", "0.85", "1.2"),)),
        slow("lagged", (("mode[1].damping", "0.01", "0.1"), ("mode[1].frequency", "0.95", "1.05"))),
    ],
)
def test_plants_by_numpy_keep_the_tolerance(name: str, ranges: Ranges):
    """As much as is allowed is used, and no more."""
    found = tolerant(name, ranges, "0.5")
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= 1e-4
    sides = [np.linspace(float(low), float(high), 9) for _, low, high in ranges]
    names = [parameter for parameter, *_ in ranges]
    peaks, errors = zip(*(left(found, member(PLANTS[name], dict(zip(names, at, strict=True))), 0.5) for at in product(*sides)), strict=True)
    assert 0.049 <= max(peaks) <= 0.05 * (1 + 1e-6)
    assert max(errors) <= 1e-9


@pytest.mark.slow
def test_a_final_tolerance_is_always_kept():
    """The gain at rest stays what it is."""
    assert tolerant("block", FREQUENCY, "0.5", final="0.000001").status is Status.PROVED


@pytest.mark.slow
def test_boxes_without_width_are_the_one_plant():
    """Moved by nothing, written with a coefficient of no width, or one plant of a list: the same bracket; it lies below rest, and comes to
    rest as the tolerance goes to 0."""
    still: Ranges = (("mode[1].frequency", "1", "1"),)
    alone = Listed((((Fraction(1),), TWO_MASS),))
    one = tolerant("spring", still, "1")
    agree(one, robust("1", "0.05", axis("stiffness", "0")))
    listed = fastest(alone, axis("k", "0"), displacement="1")
    assert listed.lower <= upper_of(one)
    assert one.lower <= upper_of(listed)
    nominal = 4.217866510451
    times = [tolerant("spring", still, "1", tolerance) for tolerance in ("0.05", "0.001", "0.00001")]
    assert all(upper_of(found) <= nominal * (1 + 1e-4) for found in times)
    assert all(first.lower < upper_of(second) for first, second in pairwise(times))
    assert times[-1].lower >= nominal * (1 - 1e-3)


@pytest.mark.slow
def test_nested_boxes_are_ordered():
    widths = [tolerant("spring", (("mode[1].frequency", low, high),), "1") for low, high in (("1", "1"), ("0.95", "1.02"), ("0.9", "1.1"))]
    for smaller, larger in pairwise(widths):
        assert upper_of(smaller) < larger.lower  # strictly: these differ by far more than their gaps


def test_two_lasting_modes():
    """Modes without a common period meet at their worst, however late: only what is asked of them then closes the bracket."""
    found = tolerant("chain", (("mode[2].frequency", "0.95", "1.05"),), "2")
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= 1e-4


def certified() -> bytes:
    return tolerant("block", (*FREQUENCY, ("mode[1].damping", "0.05", "0.2")), "0.5").certificate or b""


def parameter(place: int, **changes: Any) -> Callable[[Any], None]:
    return lambda d: d["task"]["box"]["parameters"][place].update(changes)


UNPROVEN = {Outcome.REFUTED, Outcome.INCONCLUSIVE}


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        (lambda d: None, {Outcome.PROVED}),
        (lambda d: d["claim"].update(lower=None), {Outcome.PROVED}),
        (parameter(0, high="1.15"), UNPROVEN),
        slow(parameter(0, low="0.85"), UNPROVEN),
        slow(parameter(1, low="0.04"), UNPROVEN),
        (parameter(1, low="0"), UNPROVEN),
        (parameter(1, low="-0.01"), {Outcome.MALFORMED}),
        (parameter(1, high="1"), {Outcome.MALFORMED}),
        (parameter(0, low="0"), {Outcome.MALFORMED}),
        (parameter(0, low="-0.9"), {Outcome.MALFORMED}),
        (parameter(0, low="1.01"), {Outcome.MALFORMED}),
        (parameter(0, nominal="1.01"), {Outcome.MALFORMED}),
        (parameter(0, nominal=None), {Outcome.MALFORMED}),
        (parameter(1, nominal="0.1"), {Outcome.MALFORMED}),
        (parameter(0, name="mode[2].frequency"), {Outcome.MALFORMED}),
        (parameter(0, name="mode[1].stiffness"), {Outcome.MALFORMED}),
        (parameter(0, name="mode[1].frequency "), {Outcome.MALFORMED}),
        (parameter(0, name="zero[1]"), {Outcome.MALFORMED}),
        (parameter(0, name="mode[1].damping", nominal=None, low="0.05", high="0.2"), {Outcome.MALFORMED}),  # twice
        (lambda d: d["task"]["box"]["parameters"].pop(), {Outcome.MALFORMED}),  # places of samples have two numbers
        (lambda d: d["task"]["box"].update(tolerance="0.0495"), UNPROVEN),
        (lambda d: d["task"]["box"].update(numerator=[[["1", [0, 0]]]]), {Outcome.MALFORMED}),
        (lambda d: d["task"]["plants"][0].update(denominator=["1", "0.02", "1"]), UNPROVEN),  # a nominal plant outside its own box
        (lambda d: d["task"]["plants"][0].update(denominator=["1", "0.2", "1.1"]), UNPROVEN),
        (lambda d: d["task"]["plants"][0].update(denominator=["1", "2", "1"]), {Outcome.MALFORMED}),  # without a mode
        (lambda d: d["lower"]["samples"][0]["place"].__setitem__(0, "1.2"), {Outcome.MALFORMED}),
        (lambda d: d["lower"].update(samples=[]), UNPROVEN),
        (lambda d: d["claim"].update(lower="3.42", upper=None), UNPROVEN),
        (lambda d: d["claim"].update(lower=None, upper="3.41"), UNPROVEN),
    ],
)
def test_no_false_claim_is_proven(change: Any, outcomes: set[Outcome]):
    assert forged(certified(), change) in outcomes


def test_no_task_is_impossible_for_a_final_error_of_moved_roots():
    def lie(d: Any) -> None:
        d["task"]["box"]["final_tolerance"] = "0"
        d["claim"] = {"lower": None, "upper": None, "impossible": "final"}
        d["upper"], d["lower"]["samples"] = None, [{"place": ["1.1", "0.1"], "residual": [], "deflection": [], "after": []}]

    assert forged(certified(), lie) is Outcome.INCONCLUSIVE


def test_the_claim_says_what_is_moved():
    words = claim(check(certified()))
    assert "when these of its roots are moved: mode[1].frequency in [0.9, 1.1], mode[1].damping in [0.05, 0.2];" in words
    assert "damping: the damping ratio" in words
    assert "the static gain" in words


@pytest.mark.parametrize(
    ("name", "low", "high", "match"),
    [
        ("mode[2].frequency", "0.9", "1.1", r"no mode\[2\]; it has mode\[1\] \(-0.1 ± 0.994987 j\)"),
        ("zero[1]", "0.9", "1.1", r"no zero\[1\]"),
        ("mode[1].frequency", "0", "1.1", "more than 0"),
        ("mode[1].frequency", "1.1", "1.2", "the factor 1 of the nominal plant"),
        ("mode[1].damping", "-0.1", "0.2", "less is unstable"),
        ("mode[1].damping", "0.05", "1", "below 1"),
        ("mode[1].damping", "0.11", "0.2", "its damping ratio, 0.1, of the nominal plant"),
        ("stiffness", "0.9", "1.1", "names no root"),
    ],
)
def test_what_cannot_be_moved(name: str, low: str, high: str, match: str):
    with pytest.raises(ManeuverError, match=match):
        moved.axis(BLOCK, name, Fraction(low), Fraction(high))


def test_repeated_and_equally_fast_modes_are_refused():
    twice = LinearPlant.from_transfer([1], np.polymul([1, 0, 1], [1, 0, 1]).tolist())
    with pytest.raises(ManeuverError, match="repeated mode"):
        moved.axis(twice, "mode[1].frequency", Fraction(1), Fraction(1))
    alike = LinearPlant.from_transfer([1], ["1", "0.3", "2.02", "0.3", "1"])  # ω = 1 twice, ζ = 0.05 and 0.1
    with pytest.raises(ManeuverError, match="not defined"):
        moved.axis(alike, "mode[1].frequency", Fraction(1), Fraction(1))


def test_an_exact_damping_ratio_is_its_nominal_value():
    """A range may begin or end there: 0.1 is not less than 0.1."""
    assert moved.axis(BLOCK, "mode[1].damping", Fraction("0.1"), Fraction("0.1")).nominal == Fraction("0.1")
    assert moved.axis(TWO_MASS, "mode[1].damping", Fraction(0), Fraction("0.1")).nominal == 0


def test_a_family_is_the_plant_that_was_moved():
    ranges: Ranges = (("mode[1].frequency", "0.5", "2"), ("mode[1].damping", "0.01", "0.9"), ("zero[1]", "0.5", "2"))
    axes = [moved.axis(CART, name, Fraction(low), Fraction(high)) for name, low, high in ranges]
    family: Family = moved.moved(CART, axes)
    for at in ((1.2, 0.3, 0.7), (0.6, 0.02, 1.9)):
        own = family.member([Fraction(x) for x in at])
        other = member(CART, dict(zip((name for name, *_ in ranges), at, strict=True)))
        for mine, theirs in ((own.denominator, other.denominator), (own.numerators["output"], other.numerators["output"])):
            assert [float(c) for c in mine.coeffs()] == pytest.approx([float(c) for c in theirs.coeffs()], rel=1e-9, abs=1e-12)


STUDY = """
[plant]
{plant}
[maneuver]
displacement = 1.0
[limits]
input = [-1.0, 1.0]
[command]
robustness = {robustness}
[[uncertainty]]
parameter = "{parameter}"
range = {range}
"""
NUMBERS = "numerator = [1]\ndenominator = [1, 0, 2, 0, 0]"
FMU = 'fmu = "two_mass"\ninput = "force"\noutput = "position_2"'


def written(folder: Path, plant: str, parameter: str, limits: str, robustness: str = '"box"\ntolerance = 0.05') -> Path:
    file = folder / "study.toml"
    file.write_text(STUDY.format(plant=plant, parameter=parameter, range=limits, robustness=robustness))
    return file


@pytest.mark.slow
def test_a_study_of_numbers_and_one_of_an_fmu(tmp_path: Path):
    """The linear plant of the FMU is the same one: the same bracket. No FMU can be set to a mode, so it is not verified over one."""
    one = design(load_study(written(tmp_path, NUMBERS, "mode[1].frequency", '["90 %", 1.1]'))).bound
    study = load_study(written(tmp_path, FMU, "mode[1].frequency", "[0.9, 1.1]"))
    other = design(study).bound
    agree(one, other)
    agree(one, tolerant("spring", FREQUENCY, "1"))
    with pytest.raises(StudyError, match="no FMU can be set to it"):
        verify(study, tmp_path / "evidence")


def test_mistakes_of_studies(tmp_path: Path):
    for plant in (NUMBERS, FMU):
        for parameter, limits, match in (
            ("mode[2].frequency", "[0.9, 1.1]", r"uncertainty\[1\]: the plant has no mode\[2\]"),
            ("mode[1].frequency", "[1.1, 1.2]", "the factor 1 of the nominal plant"),
            ("mode[1].damping", "[-0.1, 0.1]", "unstable"),
            ("zero[1]", "[0.9, 1.1]", r"no zero\[1\]"),
        ):
            with pytest.raises(StudyError, match=match):
                load_study(written(tmp_path, plant, parameter, limits))
    mixed = written(tmp_path, FMU, "mode[1].frequency", "[0.9, 1.1]")
    mixed.write_text(mixed.read_text() + '[[uncertainty]]\nparameter = "stiffness"\nrange = [0.9, 1.1]\n')
    with pytest.raises(StudyError, match="a box is of one kind"):
        load_study(mixed)


def test_roots_that_nothing_looks_at_are_told(tmp_path: Path):
    study = load_study(written(tmp_path, NUMBERS, "mode[1].frequency", "[0.9, 1.1]", robustness="1"))
    assert any("mode[1].frequency changes nothing here" in note for note in study.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ranges", "displacement"),
    [
        ("cart", (("zero[1]", "0.9", "1.1"), ("mode[1].frequency", "0.9", "1.1"), ("mode[1].damping", "0.1", "0.2")), "1"),
        ("chain of four", tuple((f"mode[{i}].frequency", "0.97", "1.03") for i in (1, 2, 3)), "2"),
    ],
)
def test_three_parameters(name: str, ranges: Ranges, displacement: str):
    """A zero, a frequency and a damping ratio; three modes that last."""
    found = tolerant(name, ranges, displacement)
    assert found.status is Status.PROVED, found.reason
    assert found.gap is not None
    assert found.gap <= 1e-4
