"""The lower side of a plant that varies, term by term, against a costate that is integrated by a formula of one's own."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from forgery import certificate, task
from marks import slow
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from relaxations.checking.claims import Outcome, check

INSTANTS = [Fraction(0), Fraction(1, 2), Fraction(3, 2)]
STEPS = 6000  # of Runge and Kutta: an error of 1e-12
AWAY = 1e-4  # [m] from where a claim becomes false: far more than that, and than the sums over steps are wrong by (1e-7)


@dataclass(frozen=True)
class Case:
    """A seeded plant with two states: a mass (rest without input), or a spring (rest held by as much input as the target is away)."""

    seed: int
    spring: bool = False
    fuel: bool = False
    sample_time: Fraction | None = None
    rate: bool = False
    stay: bool = True  # the plant is at rest at first

    def made(self) -> dict[str, Any]:
        rng = np.random.default_rng([17, self.seed, self.spring, self.fuel, self.rate])

        def short(low: float, high: float, size: int | None = None) -> Any:
            return np.round(rng.uniform(low, high, size), 2)

        drive = short(0.5, 2.0, 3)
        stiff = drive if self.spring else np.zeros(3)
        damping = short(-0.3, 0.6, 3)
        return {
            "A": [[[0.0, 1.0], [-k, -d]] for k, d in zip(stiff, damping, strict=True)],
            "B": [[0.0, b] for b in drive],
            "costate": short(0.5, 2, 2) * [1, rng.choice([-1, 1])],
            "limits": (-short(1.0, 3.0), short(4.0, 6.0)),
            "initial_input": short(0.1, 0.4) if self.spring else 0.0,
            "fuel": short(0.5, 2.0) if self.fuel else None,
            "price": short(0.05, 0.3) if self.fuel else 0.0,
            "rate": (-short(2.0, 4.0), short(5.0, 7.0)),
            "time": short(1.1, 2.4),
            "start": [short(-0.3, 0.3), short(-0.3, 0.3)],
        }


@functools.cache
def followed(case: Case, end: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Instants, p = π B and its integral from 0, π' = -π A."""
    made = case.made()
    times = np.linspace(0.0, end, STEPS + 1)
    half = np.linspace(0.0, end, 2 * STEPS + 1)
    at = [float(x) for x in INSTANTS]
    A = np.stack([[np.interp(half, at, [a[i][j] for a in made["A"]]) for j in range(2)] for i in range(2)]).transpose(2, 0, 1)
    b = np.interp(half, at, [row[1] for row in made["B"]])
    pi, h, found = np.array(made["costate"], float), end / STEPS, []
    for k in range(STEPS):
        found.append(pi)
        k1 = -pi @ A[2 * k]
        k2 = -(pi + h / 2 * k1) @ A[2 * k + 1]
        k3 = -(pi + h / 2 * k2) @ A[2 * k + 1]
        k4 = -(pi + h * k3) @ A[2 * k + 2]
        pi = pi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    p = np.array([*found, pi])[:, 1] * b[::2]
    return times, p, np.concatenate([[0.0], np.cumsum((p[1:] + p[:-1]) / 2 * h)])


def area(times: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    return float(np.trapezoid(values, times))


def sigma(p: Any, low: float, high: float, price: float, fuel: bool) -> Any:
    """What an input does at most, each unit of it costing the price."""
    return np.maximum(high * (p - price), 0.0) + np.maximum(low * (p + price), 0.0) if fuel else np.maximum(low * p, high * p)


def margin(case: Case, made: dict[str, Any], displacement: float, ramps: list[dict[str, Any]], begin: float | None) -> float:
    """Left side less right side of the inequality."""
    held = displacement if case.spring else 0.0
    final = made["initial_input"] + held
    low, high = (x - final for x in made["limits"])
    start = [0.0, 0.0] if case.stay else made["start"]
    away = np.array([displacement, 0.0]) - start
    left = float(made["costate"] @ away) - made["price"] * (made["fuel"] or 0.0)
    end = float(made["time"])
    if case.sample_time:
        step = float(case.sample_time)
        count = math.ceil(Fraction(str(end)) / case.sample_time) - 1
        times, _, integral = followed(case, count * step)
        cells = np.diff(np.interp(np.arange(count + 1) * step, times, integral))
        return left - float(np.sum(sigma(cells, low, high, made["price"] * step, case.fuel)))
    times, p, integral = followed(case, end)
    total, rest, first = 0.0, np.ones(len(times), bool), 0.0
    for ramp in ramps:
        edges = [float(Fraction(x)) for x in ramp["edges"]]
        inside = np.linspace(edges[0], min(edges[-1], end), 20_001)
        own = np.interp(inside, times, p)
        place = np.minimum(np.searchsorted(edges, inside[:-1], "right") - 1, len(edges) - 2)
        level = np.array([float(Fraction(x)) for x in ramp["levels"]])[place]
        gains = np.interp(inside[1:], times, integral) - np.interp(inside[:-1], times, integral) - level * np.diff(inside)
        q = 0.0
        if edges[0] == 0.0:
            q = -gains.sum() if begin is None else begin
            first = q
        ends = edges[-1] <= end  # one that goes on beyond the move may end anywhere
        shift = (q + gains.sum()) / (edges[-1] - edges[0]) if ends else 0.0
        course = q + np.concatenate([[0.0], np.cumsum(gains - shift * np.diff(inside))])
        total += float(np.sum(sigma(level + shift, low, high, made["price"], case.fuel) * np.diff(inside)))
        total += area(inside, np.maximum(-made["rate"][1] * course, -made["rate"][0] * course))
        rest &= (times < edges[0]) | (times > edges[-1])
        total -= area(inside, sigma(own, low, high, made["price"], case.fuel))  # taken off what is added below for all of [0, T]
    total += area(times, sigma(p, low, high, made["price"], case.fuel))
    return left + first * (made["initial_input"] - final) - total


def written(value: Any) -> str:
    return str(Fraction(str(value)))


def scheduled(case: Case, made: dict[str, Any], outputs: dict[str, Any] | None = None) -> dict[str, Any]:
    """The members of a task that are about its plant, and where it begins."""
    schedule = {
        "instants": [str(x) for x in INSTANTS],
        "A": [[[written(x) for x in row] for row in a] for a in made["A"]],
        "B": [[written(x) for x in row] for row in made["B"]],
        "C": [["1", "0"]] * 3,
        "D": ["0"] * 3,
        "outputs": outputs or {},
        "members": [],
    }
    return {"plants": [], "initial_state": None if case.stay else [written(x) for x in made["start"]], "schedule": schedule}


def posed(case: Case, made: dict[str, Any], displacement: Fraction, ramps: list[dict[str, Any]], begin: str | None) -> bytes:
    """The certificate of the lower side alone."""
    of = task(
        ["1"], ["1", "0", "0"], str(displacement),
        limits=tuple(map(written, made["limits"])), initial_input=written(made["initial_input"]),
        fuel=None if made["fuel"] is None else written(made["fuel"]), sample_time=str(case.sample_time) if case.sample_time else None,
        rate=[written(x) for x in made["rate"]] if case.rate else None,
    )  # fmt: skip
    of |= scheduled(case, made)
    chain = {"near": ["0", "0"], "coefficients": [[written(x), "0"] for x in made["costate"]]}
    witness = {
        "costate": [[chain]], "tail": [], "fuel": written(made["price"]), "ramps": ramps, "deflection": [], "after": [],
        "steps": [] if begin is None else [begin], "samples": [], "changes": [], "pulses": [],
    }  # fmt: skip
    return certificate(of, written(made["time"]), witnesses=(witness, None))


def told(case: Case, ramps: list[dict[str, Any]] | None = None, begin: str | None = None) -> None:
    """Just where the inequality begins to hold the checker begins to believe."""
    made, ramps = case.made(), ramps or []
    if case.rate and not ramps:
        raise AssertionError("a case of a rate has ramps")

    def over(displacement: float, start: float) -> float:
        moved = made | {"start": [start, made["start"][1]]}
        return margin(case, moved, displacement, ramps, None if begin is None else float(Fraction(begin)))

    if case.stay:
        just, start = float(root_scalar(lambda displacement: over(displacement, 0.0), bracket=(0.05, 400.0), xtol=1e-13).root), 0.0
    else:  # what the start is away counts on the left side alone, and linearly
        just = 0.5
        start = float(over(just, 0.0) / made["costate"][0])
    for side, proved in ((AWAY, True), (-AWAY, False)):  # the costate's first number is positive
        begins = [Fraction(start - side * (not case.stay)).limit_denominator(10**12), made["start"][1]]
        found = check(posed(case, made | {"start": begins}, Fraction(just + side * case.stay).limit_denominator(10**12), ramps, begin))
        assert found.outcome is (Outcome.PROVED if proved else Outcome.REFUTED), (side, found.reason)


@pytest.mark.parametrize("case", [
    Case(0), Case(1), Case(2, stay=False), Case(3, spring=True, stay=False), Case(4, spring=True, stay=False), Case(5, fuel=True),
    Case(6, fuel=True, stay=False), Case(7, sample_time=Fraction(1, 5)), Case(8, sample_time=Fraction(3, 10), stay=False),
    Case(9, fuel=True, sample_time=Fraction(1, 4)), Case(10, spring=True, stay=False, sample_time=Fraction(1, 8)),
    Case(12, sample_time=Fraction(21, 20)),
], ids=str)  # fmt: skip
def test_inputs_within_their_limits(case: Case) -> None:
    told(case)


RAMPS = {
    "from 0, ended": [{"edges": ["0", "1/3", "4/5"], "levels": ["1/10", "-1/5"]}],
    "in between": [{"edges": ["1/4", "1/2", "1"], "levels": ["1/2", "3/10"]}],
    "two": [{"edges": ["0", "2/5"], "levels": ["1/5"]}, {"edges": ["3/5", "4/5", "1"], "levels": ["1/10", "2/5"]}],
    "beyond the end": [{"edges": ["1/2", "1", "4"], "levels": ["1/3", "1/10"]}],
    "to the end": [{"edges": ["1/2", "1", "T"], "levels": ["1/3", "1/10"]}],
    "all of it": [{"edges": ["0", "1", "4"], "levels": ["1/3", "-1/10"]}],
}


@pytest.mark.parametrize("name", RAMPS)
@pytest.mark.parametrize(("spring", "fuel"), [slow(False, False), (True, False), (False, True)])
def test_inputs_of_limited_slope(name: str, spring: bool, fuel: bool) -> None:
    ramps = json.loads(json.dumps(RAMPS[name]))
    case = Case(20 + len(name), spring=spring, fuel=fuel, rate=True, stay=not spring)
    if ramps[-1]["edges"][-1] == "T":
        ramps[-1]["edges"][-1] = written(case.made()["time"])
    told(case, ramps)
    if ramps[0]["edges"][0] == "0":
        told(case, ramps, "3/20")


def test_no_costate_refutes_nothing() -> None:
    """Both sides are 0, with a ramp too."""
    case = Case(20, rate=True)
    made = case.made() | {"costate": np.zeros(2)}
    for ramps in ([], [{"edges": ["0", "1"], "levels": ["0"]}], [{"edges": ["1/4", "1"], "levels": ["0"]}]):
        assert check(posed(case, made, Fraction(1), ramps, None)).outcome is not Outcome.PROVED
