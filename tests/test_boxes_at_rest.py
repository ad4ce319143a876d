"""Boxes of plants that stand on the ground, and where each plant of a box comes to rest."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_tasks import LAG, MASS, ONE, SERVO, SPRING, TOW, K, axis, fastest, forged, left, transfer, upper_of
from independent import StateSpace
from marks import first
from scipy.optimize import linprog

from relaxations.bounds import Status
from relaxations.checking.claims import Outcome, check, claim
from relaxations.plants import LinearPlant
from relaxations.robust.boxes import Axis, Family, Listed
from suite.design import design
from suite.loading import load_study


@pytest.mark.parametrize("family", first(2, [SPRING, LAG, SERVO, TOW]), ids=["spring", "lag", "servo", "tow"])
def test_plants_that_stand_on_the_ground(family: Family):
    """Nothing is to be reached exactly but the final input; each plant rests where it does, and keeps no more than is allowed."""
    found = fastest(family, axis("k", "0.2"))
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 1e-4
    assert check(found.certificate or b"").outcome is Outcome.PROVED
    peaks, errors = zip(*(left(found, family.member([Fraction(k) / 100]), 0.5) for k in range(80, 121, 5)), strict=True)
    assert 0.0495 <= max(peaks) <= 0.05 * (1 + 1e-9)
    assert max(errors) == pytest.approx(0.25 if family in (SPRING, TOW) else 0.0, abs=1e-12)


def test_one_lag_alone_against_its_closed_form():
    """1/(s + 1): full input until y = 0.475, which is 5 % of the move before its end, then what holds."""
    found = fastest(LAG, axis("k", "0"))
    assert found.lower <= -np.log(1 - 0.475) <= upper_of(found)


def test_what_holds_may_be_all_that_is_needed():
    """At a tolerance of 120 % the step to the final input, which leaves 100 %, is a command of no time at all."""
    found = fastest(SERVO, axis("k", "0.2"), tolerance="1.2")
    assert (found.status, found.lower, found.upper) == (Status.PROVED, 0.0, 0.0)


def test_damping_from_none_on():
    """At its one end the poles lie on the imaginary axis exactly, which balls alone cannot see."""
    family = transfer(["d"], [ONE], [ONE, {(1,): 1}, ONE])
    found = fastest(family, Axis("d", Fraction(1, 10), Fraction(0), Fraction(1, 5)))
    assert found.status is Status.PROVED
    assert max(left(found, family.member([Fraction(d, 100)]), 0.5)[0] for d in range(0, 21, 4)) <= 0.05 * (1 + 1e-9)


def test_bodies_alone_rest_together():
    found = fastest(MASS, axis("m", "0.1"), displacement="1")
    assert found.status is Status.PROVED
    assert found.lower == pytest.approx(2.0, abs=1e-14)
    assert found.gap is not None
    assert found.gap <= 1e-12


@pytest.mark.parametrize(("family", "axes", "error"), [(SPRING, axis("k", "0.2"), "0.25"), (MASS, axis("m", "0.2"), "0.25")])
def test_where_a_plant_rests_is_no_matter_of_the_command(family: Family, axes: Axis, error: str):
    """1/0.8 - 1 = 0.25 exactly: allowed at that tolerance, limits included; a hair less, and no command will do, ever."""
    allowed = fastest(family, axes, final=error)
    free = fastest(family, axes)
    assert allowed.status is Status.PROVED
    assert (allowed.lower, allowed.upper) == (free.lower, free.upper)
    refused = fastest(family, axes, final=str(Fraction(error) - Fraction(1, 10**9)))
    assert refused.status is Status.IMPOSSIBLE
    assert check(refused.certificate or b"").outcome is Outcome.PROVED


def test_a_final_error_that_is_largest_inside_the_box():
    """The gain 1 + k - k² is largest at k = 1/2, 1/4 beyond the nominal one at k = 0."""
    family = transfer(["k"], [{(0,): 1, (1,): 1, (2,): -1}], [ONE, ONE])
    axes = Axis("k", Fraction(0), Fraction(0), Fraction(1))
    assert fastest(family, axes, final="0.2501").status is Status.PROVED
    assert fastest(family, axes, final="0.2499").status is Status.IMPOSSIBLE


def listed(family: Family, *places: str) -> Listed:
    return Listed(tuple(((Fraction(k),), family.member([Fraction(k)])) for k in places))


def test_plants_of_a_list_are_no_box():
    """Nothing is asked between them, so the command is shorter than that of the box; its certificate names them all."""
    few = fastest(listed(SPRING, "1", "1.2"), axis("k", "0.2"))
    assert (few.status, check(few.certificate or b"").outcome) == (Status.BRACKETED, Outcome.PROVED)
    assert (few.reason or "").startswith("sampled: ")
    assert upper_of(few) < fastest(SPRING, axis("k", "0.2")).lower
    told = claim(check(few.certificate or b""))
    assert "these 2 plants" in told
    assert "every plant of the box" not in told
    peaks = [left(few, SPRING.member([Fraction(k)]), 0.5)[0] for k in ("1", "1.2", "0.8")]
    assert max(peaks[:2]) <= 0.05 * (1 + 1e-9) < peaks[2]


def independent(plants: list[LinearPlant], displacement: float, tolerance: float, near: float) -> float:
    """The least time by HiGHS in state space: a staircase of 100 levels, residuals at 72 instants of each plant, by bisection."""
    spaces = [StateSpace.of(plant) for plant in plants]
    rests = [space.rest(displacement) for space in spaces[:1]]
    hold = rests[0][1]

    def reaches(horizon: float, levels: int = 100) -> bool:
        rows, limits = [], []
        for space in spaces:
            step, constant, _ = space.step(horizon / levels)
            columns = [constant]
            for _ in range(levels - 1):
                columns.append(step @ columns[-1])
            table = np.array(columns[::-1]).T
            rest = np.linalg.solve(space.A, -space.B) * hold
            slow = min(np.abs(np.linalg.eigvals(space.A)))
            look, *_ = space.step(2 * np.pi / slow / 72)
            row = space.C
            for _ in range(73):
                rows += [row @ table, -row @ table]
                limits += [tolerance * displacement + row @ rest, tolerance * displacement - row @ rest]
                row = row @ look
        found = linprog(np.zeros(levels), A_ub=np.array(rows), b_ub=limits, bounds=(-1, 1), method="highs")
        return found.status == 0

    low, high = 0.9 * near, 1.1 * near
    while high / low > 1 + 3e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_boxes_against_an_independent_program(seed: int):
    """Theirs is a staircase of 100 levels, at 9 plants between which nothing is asked: longer and shorter than ours by some 1e-3."""
    rng = np.random.default_rng(seed)
    damping, width, tolerance = rng.choice([0.0, 0.1, 0.4]), rng.uniform(0.05, 0.3), rng.uniform(0.03, 0.2)
    shown = [str(round(float(x), 3)) for x in (damping, width, tolerance, rng.uniform(0.2, 0.8))]
    family = transfer(["k"], [{(0,): 1, (1,): str(seed % 2)}], [ONE, {(0,): shown[0]}, K])
    displacement = str(Fraction(shown[3]) * (1 + seed % 2))
    found = fastest(family, axis("k", shown[1]), displacement=displacement, tolerance=shown[2])
    assert found.status is Status.PROVED
    places = np.linspace(1 - float(shown[1]), 1 + float(shown[1]), 9)
    plants = [family.member([Fraction(repr(float(k)))]) for k in [1.0, *places]]
    other = independent(plants, float(Fraction(displacement)), float(shown[2]), upper_of(found))
    assert found.lower * (1 - 3e-3) <= other <= upper_of(found) * (1 + 3e-3)


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        (lambda d: d["task"]["box"].update(final_tolerance="0.2499"), {Outcome.REFUTED}),
        (lambda d: d["task"]["box"].update(final_tolerance="-0.1"), {Outcome.MALFORMED}),
        (lambda d: d["task"]["box"].update(final_tolerance="0.25"), {Outcome.PROVED}),
        (lambda d: d["task"]["box"].update(final_tolerance=None), {Outcome.PROVED}),  # weaker
        (lambda d: d["task"]["box"]["numerator"][0][0].__setitem__(0, "1.01"), {Outcome.MALFORMED}),
        (
            lambda d: d["task"]["box"].update(plants=[{"place": ["1"], "numerator": ["1"], "denominator": ["1", "0", "1"], "outputs": {}}]),
            {Outcome.MALFORMED},
        ),
        (lambda d: d["task"]["box"].update(numerator=[], denominator=[]), {Outcome.MALFORMED}),
        (lambda d: d["task"]["box"]["parameters"][0].update(low="-0.1"), {Outcome.INCONCLUSIVE, Outcome.REFUTED}),  # an unstable spring
        (lambda d: d["task"]["box"]["parameters"][0].update(low="0"), {Outcome.INCONCLUSIVE, Outcome.REFUTED}),  # none at all
    ],
)
def test_no_false_claim_about_rest_values_is_proven(change: Any, outcomes: set[Outcome]):
    content = fastest(SPRING, axis("k", "0.2"), final="0.25").certificate
    assert content is not None
    assert forged(content, change) in outcomes


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        (lambda d: d["lower"]["samples"][0].update(place=["1"]), {Outcome.INCONCLUSIVE}),
        (lambda d: d["lower"]["samples"][0].update(place=["0.7"]), {Outcome.MALFORMED}),
        (lambda d: d["lower"].update(samples=[]), {Outcome.MALFORMED}),
        (lambda d: d.update(lower=None), {Outcome.MALFORMED}),
        (lambda d: d["task"]["box"].update(final_tolerance="0.25"), {Outcome.INCONCLUSIVE}),
        (lambda d: d["task"]["box"].update(final_tolerance=None), {Outcome.MALFORMED}),
        (lambda d: d["task"].update(box=None), {Outcome.MALFORMED}),
    ],
)
def test_no_false_impossibility_is_proven(change: Any, outcomes: set[Outcome]):
    content = fastest(SPRING, axis("k", "0.2"), final="0.2").certificate
    assert content is not None
    assert forged(content, change) in outcomes


def test_a_list_of_other_plants_is_another_claim():
    content = fastest(listed(SPRING, "1", "1.2"), axis("k", "0.2")).certificate
    assert content is not None
    between = {"place": ["0.8"], "numerator": ["1"], "denominator": ["1", "0", "0.8"], "outputs": {}}
    assert forged(content, lambda d: d["task"]["box"]["plants"].append(between)) in {Outcome.REFUTED, Outcome.INCONCLUSIVE}
    assert forged(content, lambda d: d["task"]["box"]["plants"].pop(0)) is Outcome.MALFORMED  # the nominal one
    assert forged(content, lambda d: d["task"]["box"]["plants"].append(d["task"]["box"]["plants"][0])) is Outcome.MALFORMED


@pytest.mark.slow
def test_an_fmu_without_a_twin_is_known_at_its_samples_only(tmp_path: Path):
    """Linearised one by one in child processes: the same plants, but for rounding, as the twin's, and no claim about those between."""
    study = tmp_path / "study.toml"
    study.write_text(
        '[plant]\nfmu = "two_mass"\ninput = "force"\noutput = "position_2"\nlinearization = "derivatives"\n'
        "[maneuver]\ndisplacement = 1.0\n[limits]\ninput = [-1.0, 1.0]\n"
        '[command]\nrobustness = "box"\ntolerance = 0.05\n'
        '[[uncertainty]]\nparameter = "stiffness"\nrange = [0.8, 1.2]\nsamples = 5\n'
    )
    bound = design(load_study(study)).bound
    assert bound.status is Status.BRACKETED
    assert (bound.reason or "").startswith("sampled: both sides are proven for the 5 plants")
    assert bound.lower <= 5.397080
    assert upper_of(bound) >= 5.396953 * (1 - 1e-5)  # fewer plants than in the box: theirs may be shorter
    assert check(bound.certificate or b"").outcome is Outcome.PROVED
