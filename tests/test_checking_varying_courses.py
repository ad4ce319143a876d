"""What the checker makes of limited outputs of a plant that varies, against Runge and Kutta's method, quadrature and closed forms."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import flint
import numpy as np
import pytest
from flint import arb, arb_mat, fmpq
from scipy.integrate import quad, solve_ivp

from relaxations.checking import transitions, varying_courses
from relaxations.checking.reading import Malformed, Refuted, Undecided

pytestmark = pytest.mark.usefixtures("enough_work")


def exact(x: Any) -> fmpq:
    return fmpq(Fraction(str(x)).numerator, Fraction(str(x)).denominator)


def rows(values: Any) -> Any:
    """Nested lists of exact numbers."""
    return [rows(x) for x in values] if isinstance(values, list | tuple | np.ndarray) else exact(values)


def posed(instants: list[Any], A: Any, B: Any, outputs: dict[str, Any], limits: dict[str, Any], start: Any = None) -> Any:
    """A task as the checker reads it, as far as outputs are concerned."""
    schedule = SimpleNamespace(instants=rows(instants), A=rows(A), B=rows(B), outputs={name: rows(c) for name, c in outputs.items()})
    found = {name: exact(x) for name, x in limits.items()}
    return SimpleNamespace(
        schedule=schedule, limits=SimpleNamespace(deflection=found), initial_state=None if start is None else rows(start)
    )


INSTANTS = [0.0, 0.75, 1.25, 2.5]


def random_task(seed: int, n: int = 3, scale: float = 1.5) -> tuple[Any, dict[str, Any]]:
    """Seeded matrices of two digits, and the same as arrays."""
    rng = np.random.default_rng([92, seed])

    def short(*shape: int) -> Any:
        return np.round(rng.uniform(-scale, scale, shape), 2)

    made = {"A": short(4, n, n), "B": short(4, n), "one": short(4, n), "two": short(4, n), "start": short(n), "state": short(n)}
    outputs = {"one": made["one"], "two": made["two"]}
    return posed(INSTANTS, made["A"], made["B"], outputs, {"one": "0.7", "two": "1.3"}, made["start"]), made


def table(values: Any, t: float) -> Any:
    """Linear between the instants, constant after the last."""
    return np.apply_along_axis(lambda column: np.interp(t, INSTANTS, column), 0, values)


def press(output: str, begin: Any, end: Any, weight: Any) -> Any:
    return SimpleNamespace(output=output, begin=exact(begin), end=exact(end), weight=exact(weight))


PRESSES = [
    press("two", "0.25", "1", "0.8"),
    press("one", "0.5", "0.5", "-1.5"),
    press("one", "0.75", "3", "2"),
    press("two", "2", "2.75", "-0.6"),
    press("one", "3", "3", "0.4"),
]


# Multipliers.


@pytest.mark.parametrize("seed", range(2))
def test_multipliers_drive_the_costate(seed: int) -> None:
    """`π' = -π A + ρ c`, p = π B, by Runge and Kutta's method from edge to edge; impulses add weight c."""
    task, made = random_task(seed)
    numbers = [0.5, -1.0, 0.75]
    schedule, start, kicks = varying_courses.driven(task, rows(numbers), PRESSES)
    assert start.ncols() == 5
    kicks.sort(key=lambda kick: kick[0])
    edges = [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 2.0, 2.5, 2.75, 3.0, 3.5]
    pi, truth = np.array(numbers), {}
    for s, t in pairwise(edges):
        for one in PRESSES:
            if one.begin == one.end == exact(s):
                pi = pi + float(Fraction(str(one.weight))) * table(made[one.output], s)
        density = {
            name: sum(
                float(Fraction(str(one.weight / (one.end - one.begin))))
                for one in PRESSES
                if one.output == name and one.begin != one.end and one.begin <= exact(s) < one.end
            )
            for name in ("one", "two")
        }

        def rates(at: float, y: Any, density: Any = density) -> Any:
            return -y @ table(made["A"], at) + sum(rho * table(made[name], at) for name, rho in density.items())

        seen = solve_ivp(rates, (s, t), pi, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
        truth[s], pi = seen.sol, seen.y[:, -1]
    looked = 0
    for step in transitions.steps(schedule, start, arb("3.5"), kicks):
        begin = float(Fraction(str(step.begin)))
        for share in (0.3, 0.9):
            tau = share * float(Fraction(str(step.length)))
            at = begin + tau
            if at > 3.5:
                continue
            looked += 1
            course = truth[max(edge for edge in edges[:-1] if edge <= at)]
            assert float(step.impulse(arb(tau))[0, 0].mid()) == pytest.approx(float(course(at) @ table(made["B"], at)), abs=1e-8)
            assert float(step.impulse(arb(tau))[0, 0].rad()) < 1e-25
    assert looked > 10


def test_without_multipliers_nothing_is_added() -> None:
    task, _ = random_task(0)
    schedule, start, kicks = varying_courses.driven(task, rows([1, 2, 3]), [])
    assert (schedule.A, schedule.B, kicks) == (task.schedule.A, task.schedule.B, [])
    assert [float(x) for x in start.entries()] == [1, 2, 3]


@pytest.mark.parametrize("seed", range(3))
def test_what_multipliers_gain(seed: int) -> None:
    """`∫ ρ c x_ss dt - Σ limit ∫ |ρ| dt` by quadrature."""
    task, made = random_task(seed)
    state = rows(made["state"])

    def rests(t: float, output: str) -> float:
        return float(table(made[output], t) @ made["state"])

    for some in ([one] for one in PRESSES):
        expected = 0.0
        for one in some:
            weight, begin, end = (float(Fraction(str(x))) for x in (one.weight, one.begin, one.end))
            expected -= abs(weight) * {"one": 0.7, "two": 1.3}[one.output]
            if begin == end:
                expected += weight * rests(begin, one.output)
            else:
                within = [t for t in INSTANTS if begin < t < end] or None
                expected += weight / (end - begin) * quad(rests, begin, end, args=(one.output,), points=within)[0]
        assert float(varying_courses.gained(task, state, some)) == pytest.approx(expected, abs=1e-12)
    whole = varying_courses.gained(task, state, PRESSES)
    assert whole.overlaps(sum((varying_courses.gained(task, state, [one]) for one in PRESSES), arb(0)))
    # An output whose rest is the same at all instants.
    task.schedule.outputs["one"] = [task.schedule.outputs["one"][0]] * 4
    same = float(made["one"][0] @ made["state"])
    assert float(varying_courses.gained(task, state, [press("one", "0.5", "2", "-3")])) == pytest.approx(-3 * same - 3 * 0.7, abs=1e-12)
    assert float(varying_courses.gained(task, state, [press("one", "2", "2", "3")])) == pytest.approx(3 * same - 3 * 0.7, abs=1e-12)
    # And one that rests at two places: c x_ss rises from 1 to 3 in [3/4, 5/4].
    task.schedule.outputs["one"] = rows([[1, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0, 0]])
    assert float(varying_courses.gained(task, rows([1, 5, 7]), [press("one", "1/2", "5/4", "3")])) == pytest.approx(
        3 * (0.25 * 1 + 0.5 * 2) / 0.75 - 3 * 0.7
    )


def test_a_row_at_an_instant() -> None:
    schedule = SimpleNamespace(instants=rows([0, 1, 3]))
    written = rows([[0, 10], [4, 20], [8, -20]])
    for instant, row in (
        ("0", [0, 10]),
        ("1/4", [1, "25/2"]),
        ("1", [4, 20]),
        ("2", [6, 0]),
        ("5/2", [7, -10]),
        ("3", [8, -20]),
        ("7", [8, -20]),
    ):
        assert varying_courses.at(schedule, written, exact(instant)) == rows(row)


def test_a_product_of_rows() -> None:
    assert varying_courses.inner(rows([1, 2, 3]), rows([4, 5, 6])) == 32
    assert varying_courses.inner(rows([1, 2, 3]), []) == 0  # a start at rest


# Tasks that make sense.


def test_outputs_within_their_limits_wherever_the_plant_may_rest() -> None:
    outputs = {"one": [[1, 0], [2, 0], [1, 1]]}

    def sensible(outputs: Any = outputs, limits: Any = None, start: Any = None, state: Any = (1, 2)) -> None:
        task = posed([0, 1, 2], [[[0, 1], [0, 0]]] * 3, [[0, 1]] * 3, outputs, limits or {"one": 3}, start)
        varying_courses.sensible(task, rows(state))

    sensible()  # it rests at 1, 2, and 3
    sensible(start=[3, 7])
    sensible(start=[-3, 7])
    sensible(state=(-1, -2))
    sensible(limits={"one": "1/2"}, state=("1/8", "1/4"))
    sensible(outputs={"one": outputs["one"], "two": [[0, 1]] * 3}, limits={"one": 3, "two": 2})
    for said, changes in {
        "rests beyond": {"limits": {"one": "2.999"}},
        "the output two rests": {"outputs": {"one": outputs["one"], "two": [[0, 1]] * 3}, "limits": {"one": 3, "two": "1.999"}},
        "the output one rests": {"state": (-1, "-2.001")},
        "begins beyond": {"start": ["3.001", 0]},
        "the output one begins": {"start": ["-3.001", 0]},
        "those whose deflection is limited": {"limits": {"one": 3, "two": 3}},
        "the outputs of a schedule": {"outputs": {**outputs, "two": outputs["one"]}},
        "is more than 0": {"limits": {"one": 0}, "state": (0, 0)},
        "the limit of the output one": {"limits": {"one": -1}},
        "n numbers at every": {"outputs": {"one": outputs["one"][:2]}},
        "it has n numbers": {"outputs": {"one": [[1, 0], [2], [1, 1]]}},
        "at every instant": {"outputs": {"one": [[1, 0], [2, 0], [1, 1, 1]]}},
        "n numbers": {"outputs": {"one": [*outputs["one"], [1, 0]]}},
    }.items():
        with pytest.raises(Malformed, match=said):
            sensible(**changes)


# Courses.


def course_of(
    made: dict[str, Any], name: str, start: Any, instants: list[float], levels: list[float], end: float | None
) -> tuple[float, float]:
    """The least and the largest value of an output during the move."""
    edges, x, seen = sorted({*instants, *(t for t in INSTANTS if t < instants[-1])}), np.array(start, float), []
    for s, t in pairwise(edges):
        i = int(np.searchsorted(instants, s, side="right")) - 1
        after = [*levels, end][i + 1] if end is not None else levels[i]
        slope = (after - levels[i]) / (instants[i + 1] - instants[i])

        def rates(at: float, y: Any, i: int = i, slope: float = slope) -> Any:
            return table(made["A"], at) @ y + table(made["B"], at) * (levels[i] + slope * (at - instants[i]))

        found = solve_ivp(rates, (s, t), x, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
        times = np.linspace(s, t, 20001)
        weights = np.array([np.interp(times, INSTANTS, column) for column in made[name].T])
        seen.append(np.sum(weights * found.sol(times), axis=0))
        x = found.y[:, -1]
    whole = np.concatenate(seen)
    return float(whole.min()), float(whole.max())


def outcome(task: Any, instants: list[Any], levels: list[Any], end: Any = None) -> str:
    given = [t if isinstance(t, arb) else exact(t) for t in instants]
    try:
        varying_courses.prove(
            task, given, [x if isinstance(x, arb) else arb(exact(x)) for x in levels], None if end is None else exact(end)
        )
    except (Refuted, Undecided) as problem:
        return type(problem).__name__
    return "proved"


@pytest.mark.parametrize("end", [None, 0.5])
@pytest.mark.parametrize("name", ["one", "two"])
@pytest.mark.parametrize("seed", range(3))
def test_an_output_leaves_its_limit_or_not(seed: int, name: str, end: float | None) -> None:
    task, made = random_task(seed, scale=1.0)
    instants, levels = [0.0, 0.5, 1.5, 3.0], [0.75, -1.0, 0.25] if end is None else [0.0, 1.0, -1.0]
    low, high = course_of(made, name, made["start"], instants, levels, end)
    largest = max(-low, high)
    other = {"one": "two", "two": "one"}[name]
    for share, expected in ((1 + 1e-5, "proved"), (1 - 1e-5, "Refuted")):
        task.limits.deflection = {other: exact(10**6), name: exact(largest * share)}
        assert outcome(task, instants, levels, end) == expected


LEAD = {"A": np.array([[[0, 1], [0, 0]]] * 4), "B": np.array([[0, 1], [0, 1.75], [0, 2.25], [0, 3.5]])}
"""x'' = (1 + t) u, until t = 5/2."""


def lead(limits: dict[str, Any], start: Any = None, speed: Any = (0, 1)) -> Any:
    outputs = {"speed": [[*speed]] * 4, "place": [[1, 0]] * 4}
    return posed(INSTANTS, LEAD["A"], LEAD["B"], {name: outputs[name] for name in limits}, limits, start)


def test_the_largest_speed_of_a_mass() -> None:
    """u = 1 until t = 1: the speed is then 1 + 1/2, and falls; exactly at the limit it is not told from it."""
    there = [0, 1, 2]
    assert outcome(lead({"speed": "1.5000001"}), there, [1, -1]) == "proved"
    assert outcome(lead({"speed": "1.4999999"}), there, [1, -1]) == "Refuted"
    assert outcome(lead({"speed": "1.4999999"}), there, [-1, 1]) == "Refuted"
    assert outcome(lead({"speed": "3/2"}), there, [1, -1]) == "Undecided"
    assert outcome(lead({"speed": "1.4999999"}, speed=(0, -1)), there, [1, -1]) == "Refuted"
    assert outcome(lead({"speed": "1.5000001"}, start=[0, "-1/4"]), there, [1, -1]) == "proved"
    assert outcome(lead({"speed": "1.7499999"}, start=[0, "1/4"]), there, [1, -1]) == "Refuted"
    assert outcome(lead({"speed": "1.7500001"}, start=[0, "1/4"]), there, [1, -1]) == "proved"
    assert outcome(lead({"speed": "2", "place": "1"}), there, [1, -1]) == "Refuted"  # 2/3 at t = 1, and 4/3 at the end
    assert outcome(lead({"speed": "2", "place": "2"}), there, [1, -1]) == "proved"
    assert outcome(lead({"place": "2", "speed": "1"}), there, [1, -1]) == "Refuted"


def test_only_the_move_counts() -> None:
    """Until t = 1 the speed is 3/2 at most, later it would be more; the last instant counts until the end of its ball."""
    assert outcome(lead({"speed": "1.5000001"}), [0, 1], [1]) == "proved"
    assert outcome(lead({"speed": "1.5000001"}), [0, "0.9"], [1]) == "proved"
    assert outcome(lead({"speed": "1.5000001"}), [0, "1.01"], [1]) == "Refuted"
    assert outcome(lead({"speed": "1.52"}), [0, arb(1, 0.001)], [1]) == "proved"
    assert outcome(lead({"speed": "1.5000001"}), [0, arb(1, 0.001)], [1]) != "proved"


def test_an_instant_that_is_not_known_exactly() -> None:
    """A switch within 1/1000 of t = 1: the speed is at most 1.5020005, whenever it is."""
    for levels in ([1, -1], [-1, 1]):
        assert outcome(lead({"speed": "1.5025"}), [0, arb(1, 0.001), 2], levels) == "proved"
        assert outcome(lead({"speed": "1.5015"}), [0, arb(1, 0.001), 2], levels) != "proved"
    # The level is one of both until the last of its instants: 1.504 where it were 1 until then.
    assert outcome(lead({"speed": "1.5015"}), [0, arb(1, 0.001), 2], [1, "0.5"]) != "proved"
    # And an early switch counts: from -3/4 on the speed is -7/4 at the end, -1.754 if the switch is at 0.999.
    for limit, proven in (("1.7535", False), ("1.7545", True)):
        early = lead({"speed": limit}, start=[0, "-3/4"])
        assert (outcome(early, [0, arb(1, 0.001), 2], [1, -1]) == "proved") == proven
    # A level in a ball.
    assert outcome(lead({"speed": "1.517"}), [0, 1, 2], [arb(1, 0.01), -1]) == "proved"
    assert outcome(lead({"speed": "1.512"}), [0, 1, 2], [arb(1, 0.01), -1]) != "proved"


def test_instants_are_followed_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    """A level begins at a fraction as it is; while an instant is in a ball it is both. Each step is followed to its end."""
    kicks: list[Any] = []
    monkeypatch.setattr(varying_courses, "steps", lambda _, start, end, given: kicks.extend([end, *given]) or ())
    ball, start = arb(1, 0.125), arb_mat(1, 4)
    assert outcome(lead({"speed": 2}), [0, "1/3", ball, arb(2, 0.25)], [1, -2, 4]) == "proved"
    end, *found = kicks
    assert end >= arb("2.25")
    instants = [at for at, _ in found]
    assert instants[:2] == [0, fmpq(1, 3)]
    assert [float(Fraction(str(at))) for at in instants[2:]] == pytest.approx([0.875, 1.125], abs=1e-8)
    assert instants[2] <= fmpq(7, 8)
    assert instants[3] >= fmpq(9, 8)
    levels = [change(start).entries() for _, change in found]
    assert [float(row[2]) for row in levels[:2] + levels[3:]] == [1, -2, 4]
    assert all(levels[2][2].contains(arb(x)) for x in (-2, 4))
    assert all(row[3] == 0 for row in levels)
    assert all(row[0] == row[1] == 0 for row in levels)
    monkeypatch.undo()
    ends: list[Any] = []
    monkeypatch.setattr(varying_courses.courses, "within", lambda course, end, *others: ends.append((end, others)))
    assert outcome(lead({"speed": 2}), [0, "1/3", "5/7"], [1, -2]) == "proved"
    with flint.ctx.workprec(256):
        total = sum((x for x, _ in ends), arb(0))
        assert total >= arb(fmpq(5, 7))
        assert total < arb(fmpq(5, 7)) + arb("1e-30")
    assert all(others == (2, "speed", ()) for _, others in ends)


def test_straight_pieces() -> None:
    """u = t until t = 1, then 2 - t until 3: the speed is t²/2 + t³/3, 5/6 at 1, then t + t²/2 - t³/3 + …, most at t = 2."""
    at_two = Fraction(5, 6) + sum(Fraction(2 * b + b * b / Fraction(2) - Fraction(b**3, 3)) * s for b, s in ((2, 1), (1, -1)))
    for share, expected in ((1 + Fraction(1, 10**6), "proved"), (1 - Fraction(1, 10**6), "Refuted")):
        assert outcome(lead({"speed": at_two * share}), [0, 1, "5/2"], [0, 1], "-1/2") == expected
        # From 1/4 on: u is the deviation, and begins wherever the first level is.
        more = Fraction(5, 6) + Fraction(3, 8)
        assert outcome(lead({"speed": more * share}), [0, 1], ["1/4"], "5/4") == expected
    wide = [arb(0), arb(1, 0.01)]
    assert outcome(lead({"speed": at_two + Fraction(1, 10)}), [0, 1, "5/2"], wide, "-1/2") == "proved"
    assert outcome(lead({"speed": at_two + Fraction(1, 10**4)}), [0, 1, "5/2"], wide, "-1/2") != "proved"


def test_rows_that_vary_are_followed() -> None:
    """c = (0, 1 - t/2) until t = 2, x = (0, t) for u = 1: t - t²/2, 1/2 at t = 1; at the ends it is 0."""
    task = posed([0, 2], [[[0, 0], [0, 0]]] * 2, [[0, 1]] * 2, {"one": [[0, 1], [0, 0]]}, {"one": "0.5000001"})
    assert outcome(task, [0, 2], [1]) == "proved"
    task.limits.deflection = {"one": exact("0.4999999")}
    assert outcome(task, [0, 2], [1]) == "Refuted"


def test_the_input_and_its_slope_from_an_instant_on() -> None:
    changed = varying_courses.moving(arb(7), arb(-2))(arb_mat([[1, 2, 3, 4]]))
    assert [float(x) for x in changed.entries()] == [1, 2, 7, -2]


def test_the_fraction_that_an_exact_number_is() -> None:
    for x in (fmpq(3, 8), fmpq(-5), fmpq(0), fmpq(7) * fmpq(2) ** 80):
        assert varying_courses.exactly(arb(x)) == x
