"""Plants that vary, with starts, samples, limited slopes and outputs: lies about every new number of a certificate."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from forgery import RECORDED, changed, number, opened, written
from varying_plants import STEP, certified

from relaxations.checking.claims import Outcome, check, claim

SLOW = () if RECORDED.exists() else (pytest.mark.slow,)  # some seconds to solve


def tightened(*path: str) -> Callable[[Any], None]:
    def change(data: Any) -> None:
        node = data["task"]["limits"]
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = written(number(node[path[-1]]) * Fraction(1, 2))
        data["claim"]["lower"] = None

    return change


def steeper(data: Any) -> None:
    data["task"]["limits"]["rate"] = ["-1", "1"]
    data["claim"]["lower"] = None


@pytest.mark.parametrize(
    ("which", "change"),
    [
        ("sampled", steeper),
        ("sampled", tightened("deflection", "speed")),
        ("sloping", steeper),
        pytest.param("coasting", tightened("deflection", "output_rate"), marks=SLOW),
    ],
)
def test_a_command_beyond_a_limit_is_refuted(which: str, change: Callable[[Any], None]) -> None:
    certificate = certified(which)
    assert check(certificate).outcome is Outcome.PROVED
    assert check(changed(certificate, change)).outcome is Outcome.REFUTED


@pytest.mark.parametrize("which", ["sampled", "sloping", pytest.param("coasting", marks=SLOW)])
def test_a_later_lower_side_is_not_proven(which: str) -> None:
    certificate = certified(which)

    def later(data: Any) -> None:
        data["claim"].update(lower=written(number(data["claim"]["upper"]) + STEP), upper=None)

    def narrower(data: Any) -> None:  # the lower side's multipliers are about other limits
        for name, limit in data["task"]["limits"]["deflection"].items():
            data["task"]["limits"]["deflection"][name] = written(number(limit) * 2)
        if data["task"]["limits"]["rate"]:
            data["task"]["limits"]["rate"] = ["-40", "50"]
        data["claim"].update(upper=None)

    for change in (later, narrower):
        assert check(changed(certificate, change)).outcome in {Outcome.REFUTED, Outcome.INCONCLUSIVE}


def other_start(data: Any) -> None:
    state = data["task"]["initial_state"]
    state[0] = written(number(state[0]) + Fraction(1, 50))
    data["claim"]["lower"] = None


def test_a_command_is_about_its_own_start() -> None:
    for which in ("sampled", "sloping"):
        assert check(changed(certified(which), other_start)).outcome is Outcome.REFUTED
    said = claim(check(certified("sampled")))
    assert "x begins at [0, 0, 0.1, 0]" in said
    assert "the output 'speed' is at these instants the row [0, 1, 0, 0], [0, 1, 0, 0], " in said


MALFORMED: dict[str, Callable[[Any], Any]] = {
    "begins at as many numbers": lambda d: d["task"]["initial_state"].append("0"),
    "the outputs of a schedule are those": lambda d: d["task"]["schedule"]["outputs"].pop("speed"),
    "it has n numbers at every instant": lambda d: d["task"]["schedule"]["outputs"]["speed"].pop(),
    "begins beyond its limit": lambda d: d["task"]["limits"]["deflection"].update(swing="0.09"),
    "rests beyond its limit": lambda d: d["task"]["schedule"]["outputs"].update(speed=[["1", "0", "0", "0"]] * 5),
    "at its final rest already": lambda d: d["task"].update(initial_state=["1", "0", "0", "0"]),
    "exact multiples": lambda d: d["upper"]["segments"][1].update(start="0.123"),
    "which is not limited": lambda d: d["lower"]["deflection"][0].update(output="other"),
    "multipliers of steps belong to limits of the slope": lambda d: d["task"]["limits"].update(rate=None),
    "room on either side of 0": lambda d: d["task"]["limits"].update(rate=["0", "1"]),
}


@pytest.mark.parametrize("said", MALFORMED)
def test_malformed_tasks_say_what_is_wrong(said: str) -> None:
    found = check(changed(certified("sampled"), MALFORMED[said]))
    assert (found.outcome, said in found.reason) == (Outcome.MALFORMED, True), found.reason


@pytest.mark.slow
@pytest.mark.parametrize("which", ["sampled", "sloping", "coasting"])
@pytest.mark.parametrize("seed", range(150))
def test_random_corruption_never_proves_a_falsehood(which: str, seed: int) -> None:
    """One number of the witness is changed: what still proves says no more than the untouched certificate did."""
    rng, content = np.random.default_rng([11, seed]), certified(which)
    upper = number(opened(content)["claim"]["upper"])

    def one(data: Any) -> None:
        places: list[tuple[Any, Any]] = []

        def walk(node: Any) -> None:
            items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
            for key, value in items:
                if key != "output" and isinstance(value, str):
                    places.append((node, key))
                else:
                    walk(value)

        walk(data["lower"])
        node, key = places[int(rng.integers(len(places)))]
        node[key] = written(number(node[key]) * Fraction(str(round(rng.uniform(0.5, 1.5), 3))) + Fraction(int(rng.integers(-1, 2)), 50))
        data["claim"]["lower"] = written(upper * Fraction(101, 100))
        data["claim"]["upper"] = None

    assert check(changed(content, one)).outcome is not Outcome.PROVED
