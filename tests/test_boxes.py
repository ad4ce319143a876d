"""Robust tasks: one command for every plant of a box, with a proof that covers the whole box."""

from __future__ import annotations

import hashlib
import json
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import rfc8785
from independent import StateSpace
from scipy.optimize import linprog

from fmus.twins import linear_plant, read_twin, twin_family
from relaxations.bounds import Bound, Status
from relaxations.boxes import Axis, Box, Family, Listed
from relaxations.checking.claims import Outcome, check, claim
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response

TWIN = """
input = "force"
states = ["x1", "v1", "x2", "v2"]
A = [
    ["0", "1", "0", "0"],
    ["-stiffness / mass_1", "-damping / mass_1", "stiffness / mass_1", "damping / mass_1"],
    ["0", "0", "0", "1"],
    ["stiffness / mass_2", "damping / mass_2", "-stiffness / mass_2", "-damping / mass_2"],
]
B = ["0", "1 / mass_1", "0", "0"]

[parameters]
mass_1 = "1"
mass_2 = "1"
stiffness = "1"
damping = "0"

[outputs]
x2 = { C = ["0", "0", "1", "0"], D = "0" }
"""


def axis(name: str, width: str, nominal: str = "1") -> Axis:
    middle = Fraction(nominal)
    return Axis(name, middle, middle * (1 - Fraction(width)), middle * (1 + Fraction(width)))


@cache
def robust(displacement: str, tolerance: str, *axes: Axis, damping: str = "0") -> Bound:
    family = twin_family(TWIN, "x2", [a.name for a in axes], {"damping": damping})
    maneuver = Maneuver(Fraction(displacement), Limits.of(-1, 1), box=Box(axes, family, Fraction(tolerance)))
    return minimum_time(problem([family.member([a.nominal for a in axes])], maneuver))


def residual(bound: Bound, displacement: float, **parameters: float) -> float:
    """By simulation in closed form, which shares nothing with the proof: the peak of |y - y(∞)| over 40 s after the move."""
    plant = linear_plant(read_twin(TWIN, {name: repr(value) for name, value in parameters.items()}), "x2")
    assert bound.command is not None
    times = bound.command.maneuver_time + np.linspace(0.0, 40.0, 8001)
    course = response(plant, bound.command, times)
    resting = (course.max() + course.min()) / 2  # undamped: the middle of the oscillation
    return float(np.abs(course - resting).max()) / displacement


def transfer(names: list[str], numerator: list[dict[tuple[int, ...], Any]], denominator: list[dict[tuple[int, ...], Any]]) -> Family:
    """A family from its coefficients, highest power of s first, as factors by the powers of the parameters."""
    assert all(len(powers) == len(names) for terms in (*numerator, *denominator) for powers in terms)
    upper, lower = (tuple(tuple((Fraction(c), p) for p, c in terms.items()) for terms in which) for which in (numerator, denominator))
    return Family(upper, lower)


ONE, K = {(0,): 1}, {(1,): 1}
SPRING = transfer(["k"], [ONE], [ONE, {}, K])  # 1/(s² + k)
SERVO = transfer(["k"], [K], [ONE, {}, K])  # k/(s² + k): its static gain is 1 everywhere
LAG = transfer(["k"], [K], [ONE, K])
MASS = transfer(["m"], [ONE], [{(1,): 1}, {}, {}])
TOW = transfer(["k"], [ONE], [ONE, {(0,): "0.2"}, K])


def fastest(family: Family | Listed, *axes: Axis, displacement: str = "0.5", tolerance: str = "0.05", final: str | None = None) -> Bound:
    box = Box(axes, family, Fraction(tolerance), final_tolerance=None if final is None else Fraction(final))
    plant = family.member([a.nominal for a in axes])
    return minimum_time(problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1), box=box)))


def upper_of(bound: Bound) -> float:
    assert bound.upper is not None
    return bound.upper


def left(bound: Bound, plant: LinearPlant, displacement: float, window: float = 60.0) -> tuple[float, float]:
    """By state space and matrix exponentials alone: the peak of |y - y(∞)| after the move, and |y(∞) - Δ|, both over |Δ|."""
    assert bound.command is not None
    space = StateSpace.of(plant)
    hold = float(bound.command(bound.command.end + 1.0))
    rest = float(space.C @ np.linalg.solve(-space.A, space.B)) * hold + space.D * hold
    starts = np.array([segment.start for segment in bound.command.segments])
    state = np.zeros(len(space.B))
    for segment, width in zip(bound.command.segments, np.diff([*starts, bound.command.end]), strict=True):
        transition, constant, _ = space.step(width)
        state = transition @ state + constant * segment.level
    transition, constant, _ = space.step(window / 1500)
    course = []
    for _ in range(1501):
        course.append(space.C @ state + space.D * hold)
        state = transition @ state + constant * hold
    return float(np.abs(np.array(course) - rest).max()) / displacement, abs(rest - displacement) / displacement


@pytest.mark.parametrize(("displacement", "width", "known"), [("1", "0.2", (5.396953, 5.397080)), ("5", "0.3", (7.269718, 7.269796))])
def test_the_two_mass_spring_over_its_stiffness(displacement: str, width: str, known: tuple[float, float]):
    """The first are the ends that an independent prototype found on a grid of 300 for 21 plants, the second those of a grid four times as
    fine (for 21 plants alone, nothing asked between them, it is 7.2696)."""
    found = robust(displacement, "0.05", axis("stiffness", width))
    assert found.status is Status.PROVED
    assert found.upper is not None
    assert found.gap is not None
    assert found.gap <= 1e-4
    assert found.upper >= known[0]
    assert found.lower <= known[1]
    assert check(found.certificate or b"").outcome is Outcome.PROVED
    worst = max(residual(found, float(displacement), stiffness=float(k)) for k in np.linspace(1 - float(width), 1 + float(width), 41))
    assert 0.0499 <= worst <= 0.05 * (1 + 1e-9)  # as much as is allowed is used


def test_a_box_without_width_lies_below_rest_and_comes_to_it():
    times = [robust("1", tolerance, axis("stiffness", "0")) for tolerance in ("0.05", "0.001", "0.00001")]
    assert [found.status for found in times] == [Status.PROVED] * 3
    nominal = 4.2178665104510
    lengths = [found.upper or 0.0 for found in times]
    assert lengths[0] < lengths[1] < lengths[2] <= nominal * (1 + 1e-4)
    assert times[2].lower >= nominal * (1 - 1e-3)


def test_a_larger_box_takes_no_less_and_a_larger_tolerance_no_more():
    widths = [robust("1", "0.05", axis("stiffness", width)) for width in ("0", "0.2")]
    tolerances = [robust("1", tolerance, axis("stiffness", "0.2")) for tolerance in ("0.2", "0.05")]
    for smaller, larger in [*pairwise(widths), tuple(tolerances)]:
        assert larger.upper is not None
        assert smaller.lower <= larger.upper


def test_a_damped_mode_needs_no_circle():
    """One mode with ζ = 0.14 and 5 %: bounding its envelope would cost 4.1174 s, its peak 4.1126 s."""
    damping = "0.19798989873223331"  # 2 ζ ω m_1 m_2 / (m_1 + m_2), ω² = 2
    found = robust("1", "0.05", axis("stiffness", "0"), damping=damping)
    assert found.upper is not None
    assert found.lower == pytest.approx(4.1126, abs=6e-4)


@pytest.mark.slow
def test_two_parameters():
    axes = axis("stiffness", "0.1"), axis("mass_2", "0.1")
    found = robust("1", "0.05", *axes)
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 2e-4
    rng = np.random.default_rng(5)
    for _ in range(60):
        k, m = 1 + 0.1 * rng.uniform(-1, 1, 2)
        assert residual(found, 1.0, stiffness=float(k), mass_2=float(m)) <= 0.05 * (1 + 1e-9)


def test_a_family_is_the_plant_at_every_place():
    family = twin_family(TWIN, "x2", ["stiffness", "mass_1", "damping"])
    for place in [("1.3", "0.7", "0.1"), ("0.2", "3", "0"), ("7/3", "1/9", "2")]:
        numbers = [Fraction(x) for x in place]
        own = family.member(numbers)
        twin = linear_plant(read_twin(TWIN, dict(zip(("stiffness", "mass_1", "damping"), numbers, strict=True))), "x2")
        assert own.denominator == twin.denominator
        assert own.numerators[own.output] == twin.numerators["x2"]


def forged(content: bytes, change: Any) -> Outcome:
    data = json.loads(content)
    change(data)
    data.pop("digest")
    return check(rfc8785.dumps({**data, "digest": hashlib.sha256(rfc8785.dumps(data)).hexdigest()})).outcome


@pytest.mark.parametrize(
    ("change", "outcomes"),
    [
        (lambda d: d["task"]["box"].update(tolerance="0.0499"), {Outcome.INCONCLUSIVE, Outcome.REFUTED}),
        (lambda d: d["task"]["box"]["parameters"][0].update(high="1.21"), {Outcome.INCONCLUSIVE, Outcome.REFUTED}),
        (lambda d: d["task"]["box"]["parameters"][0].update(low="0.85"), {Outcome.MALFORMED}),  # samples lie outside then
        (lambda d: d["task"]["box"]["parameters"][0].update(nominal="1.1"), {Outcome.MALFORMED}),
        (lambda d: d["task"]["box"].update(tolerance="-0.05"), {Outcome.MALFORMED}),
        (lambda d: d["task"].update(box=None), {Outcome.MALFORMED, Outcome.REFUTED, Outcome.INCONCLUSIVE}),
        (lambda d: d["task"]["box"]["denominator"][2][0].__setitem__(0, "2.5"), {Outcome.MALFORMED}),
        (lambda d: d["lower"]["samples"][0]["residual"][0].update(upper="-1"), {Outcome.MALFORMED}),
        (lambda d: d["lower"].update(samples=[]), {Outcome.REFUTED, Outcome.INCONCLUSIVE}),
        (lambda d: d["claim"].update(lower=str(5.41)), {Outcome.REFUTED, Outcome.INCONCLUSIVE}),
        (lambda d: d["upper"].update(segments=d["upper"]["segments"][:-1]), {Outcome.MALFORMED, Outcome.REFUTED, Outcome.INCONCLUSIVE}),
    ],
)
def test_no_false_claim_is_proven(change: Any, outcomes: set[Outcome]):
    content = robust("1", "0.05", axis("stiffness", "0.2")).certificate
    assert content is not None
    assert forged(content, change) in outcomes


@pytest.mark.parametrize("family", [SPRING, SERVO, LAG, TOW], ids=["spring", "servo", "lag", "tow"])
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
    """The least time by HiGHS in state space: a staircase of 100 levels, residuals at 24 instants of each plant, by bisection."""
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
            look, *_ = space.step(2 * np.pi / slow / 24)
            row = space.C
            for _ in range(25):
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


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 40))])
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
            lambda d: d["task"]["box"].update(plants=[{"place": ["1"], "numerator": ["1"], "denominator": ["1", "0", "1"]}]),
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
    between = {"place": ["0.8"], "numerator": ["1"], "denominator": ["1", "0", "0.8"]}
    assert forged(content, lambda d: d["task"]["box"]["plants"].append(between)) in {Outcome.REFUTED, Outcome.INCONCLUSIVE}
    assert forged(content, lambda d: d["task"]["box"]["plants"].pop(0)) is Outcome.MALFORMED  # the nominal one
    assert forged(content, lambda d: d["task"]["box"]["plants"].append(d["task"]["box"]["plants"][0])) is Outcome.MALFORMED


def test_what_cannot_be_asked():
    family = twin_family(TWIN, "x2", ["stiffness"])
    with pytest.raises(ManeuverError, match="stiffness"):
        Box((Axis("stiffness", Fraction(2), Fraction(0), Fraction(1)),), family, Fraction(1, 20))
    with pytest.raises(ManeuverError, match="more than 0"):
        Box((axis("stiffness", "0.1"),), family, Fraction(0))
    unstable = twin_family(TWIN, "x2", ["damping"])
    with pytest.raises(ManeuverError, match="unstable"):
        problem(
            [unstable.member([Fraction(1)])],
            Maneuver(
                Fraction(1),
                Limits.of(-1, 1),
                box=Box((Axis("damping", Fraction(1), Fraction(-1), Fraction(1)),), unstable, Fraction(1, 20), ((Fraction(-1),),)),
            ),
        )
    with pytest.raises(ManeuverError, match="final tolerance"):
        Box((axis("k", "0.1"),), SPRING, Fraction(1, 20), final_tolerance=Fraction(-1))
    with pytest.raises(ManeuverError, match="poles at the origin"):
        fastest(transfer(["k"], [ONE], [ONE, {}, {(1,): 1, (0,): "-0.8"}]), axis("k", "0.2"), displacement="1")
    with pytest.raises(ManeuverError, match="repeated pole"):
        fastest(transfer(["k"], [ONE], [ONE, {(0,): 2}, K]), axis("k", "0"))
