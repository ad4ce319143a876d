"""Thousands of certificates that somebody tampered with, the digest forged right: whatever is printed as proved is true.

Truth comes from the floating-point bracket of the very task that stands in the file, which neither asks nor believes the checker.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import independent
import numpy as np
import pytest
from corruption import limited_originals, originals, tampered
from flint import fmpq, fmpq_poly
from forgery import number, opened, written
from independent_limits import Limited

from relaxations.bounds import bracket
from relaxations.checking.claims import Outcome, check
from relaxations.errors import SolverError
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import LinearPlant
from relaxations.sampling import sampled_bracket

FINEST = Fraction(1, 10_000)  # [s]
SLACK, LIMITED = 1e-7, 1e-5
"""Relative: what a floating-point bracket may be off by; with limits whose optimum is known from grids only. Smaller lies are told in
test_checking.py, about facts known to 1e-12."""

# Truth.


def posed(data: dict[str, Any]) -> Problem:
    """The problem that a certificate's task is."""
    of = data["task"]
    (plant,), (low, high), length = of["plants"], of["limits"]["input"], of["limits"]["tail_length"]
    linear = LinearPlant.from_transfer(*([number(c) for c in plant[name]] for name in ("numerator", "denominator")))
    outputs = {
        name: fmpq_poly([fmpq(c.numerator, c.denominator) for c in map(number, written[::-1])])
        for name, written in plant["outputs"].items()
    }
    linear = LinearPlant(linear.denominator, {**linear.numerators, **outputs}, linear.output, linear.notes)
    limits, rate = of["limits"], of["limits"]["rate"]
    maneuver = Maneuver(
        number(of["displacement"]),
        Limits(
            number(low),
            number(high),
            None if limits["fuel"] is None else number(limits["fuel"]),
            deflection={name: number(limit) for name, limit in limits["deflection"].items()},
            rate=rate and (number(rate[0]), number(rate[1])),
        ),
        number(of["initial_input"]),
        {name: count for name, count in plant["zeros"].items() if count},
        tail=of["rest"] == "output",
        tail_length=(number(length["time"]), number(length["within"])) if length else None,
        sample_time=None if of["limits"]["sample_time"] is None else number(of["limits"]["sample_time"]),
        zero_sensitivity={name: (number(p["shift"]), number(p["residual"])) for name, p in of["limits"]["zero_sensitivity"].items()},
        initial=None if of["initial_state"] is None else tuple(map(number, of["initial_state"])),
    )
    return problem([linear], maneuver)


@cache
def truth(text: str) -> tuple[float, float]:
    """The bracket of a task in floating point; infinite above if there is no upper side."""
    asked = posed({"task": json.loads(text)})
    step = asked.maneuver.sample_time
    if step is not None and step < FINEST:  # samples that nobody could count are as good as none
        asked = replace(asked, maneuver=replace(asked.maneuver, sample_time=None))
    found = (bracket if asked.maneuver.sample_time is None else sampled_bracket)(asked)
    return found.lower, float("inf") if found.upper is None else found.upper


def judged_otherwise(data: dict[str, Any]) -> bool:
    """Where the bracket gives up (rests on a limit or far away): by monotony, continuity, or what HiGHS reaches in the time claimed."""
    claim, of, (plant,) = data["claim"], posed(data), data["task"]["plants"]
    if plant["zeros"] and claim["upper"] is None:
        return is_true({**data, "task": {**data["task"], "plants": [{**plant, "zeros": {}}]}})  # takes no longer
    without_dust = [c if abs(number(c)) > 1e-15 else "0" for c in plant["denominator"]]
    if without_dust != plant["denominator"]:  # the grid sees decades of decay; the move does not
        return is_true({**data, "task": {**data["task"], "plants": [{**plant, "denominator": without_dust}]}})
    assert not of.maneuver.tail
    model, displacement = independent.StateSpace.of(of.plants[0]), float(of.maneuver.displacement)

    def reach(time: float) -> float:
        if of.fuel is not None or of.rate or of.courses or of.begin is not None:
            step, deflections = of.maneuver.sample_time, {course.name: course.limit for course in of.courses}
            count = round(time / float(step)) if step else 100
            limits, start = (of.fuel, of.rate, deflections), [float(x) for x in of.maneuver.initial or ()]
            other = Limited(of.plants[0], displacement, of.lower, of.upper, *limits, start, None if step is None else float(step), looks=2)
            return other.fraction(time, max(count, 1))
        return independent.reachable_fraction(model, displacement, of.lower, of.upper, time, 200)

    if claim["impossible"]:
        return reach(40.0) < 0.99
    fine = claim["lower"] is None or reach(float(number(claim["lower"]))) < 0.99
    return fine and (claim["upper"] is None or reach(float(number(claim["upper"])) * 1.001) > 0.999)


def one_sided(data: dict[str, Any]) -> bool:
    """Whether inputs on one side of the initial rest alone cannot do it: at a real pole a the weight e^{as} has one sign, and what is asked
    for has the other, or is nothing. (A grid cannot see it: what has decayed for long is at rest to every digit.)"""
    of, (plant,) = data["task"], data["task"]["plants"]
    low, high = (number(limit) - number(of["initial_input"]) for limit in of["limits"]["input"])
    if low * high != 0:
        return False
    numerator, denominator = ([float(number(c)) for c in plant[name]] for name in ("numerator", "denominator"))
    integrators = next(k for k, c in enumerate(reversed(denominator)) if c)
    final = float(number(of["displacement"])) * denominator[-1 - integrators] / numerator[-1]
    slowest = max((zero.real for zero in np.roots(numerator) if zero.real < 0 and of["rest"] == "output"), default=-np.inf)
    for pole in {0.0} if integrators else {root.real for root in np.roots(denominator) if abs(root.imag) < 1e-12 * abs(root)}:
        asked = (final if integrators == 1 else 0.0) if integrators else final / -pole
        if pole > slowest and asked * float(low + high) <= 0.0:
            return True
    fading = [root.real for root in np.roots(denominator) if root and abs(root.imag) < 1e-12 * abs(root)] if integrators else []
    return any(pole > slowest for pole in fading)


def is_true(data: dict[str, Any]) -> bool:
    """Whether a claim is: every side within the bracket of its task."""
    lower, upper = (data["claim"][side] for side in ("lower", "upper"))
    if (lower == "0" and upper is None) or (data["claim"]["impossible"] and one_sided(data)):
        return True
    try:
        below, above = truth(json.dumps(data["task"], sort_keys=True))
    except SolverError:
        return judged_otherwise(data)
    if data["claim"]["impossible"]:
        return above == float("inf")
    limits = data["task"]["limits"]
    slack = SLACK if limits["fuel"] is None and limits["rate"] is None and not limits["deflection"] else LIMITED
    fine = lower is None or float(number(lower)) <= above * (1 + slack)
    return fine and (upper is None or float(number(upper)) >= below * (1 - slack))


def judge(seeds: range, limited: bool = False) -> Counter[str]:
    """Check certificates; count outcomes, and the true claims about tasks that no original is about."""
    counts: Counter[str] = Counter()
    known = limited_originals() if limited else originals()
    tasks = {json.dumps(opened(content)["task"], sort_keys=True) for content in known}
    for seed in seeds:
        how, content = tampered(seed, limited)
        found = check(content)
        counts[found.outcome.value] += 1
        if found.outcome is Outcome.PROVED:
            data = json.loads(content)
            assert is_true(data), f"seed {seed} ({how}): a printed claim is false: {data['claim']} of {data['task']}"
            counts["elsewhere"] += json.dumps(data["task"], sort_keys=True) not in tasks
    return counts


def test_tampered_certificates_are_never_believed() -> None:
    counts = judge(range(500))
    assert all(counts[outcome.value] >= 20 for outcome in Outcome), counts  # the lies are of every kind
    assert counts["elsewhere"] >= 5, counts


@pytest.mark.slow
def test_tampered_certificates_of_further_limits_are_never_believed() -> None:
    counts = judge(range(80), limited=True)
    assert all(counts[outcome.value] for outcome in Outcome), counts


@pytest.mark.slow
def test_thousands_of_tampered_certificates_of_further_limits_are_never_believed() -> None:
    counts = judge(range(1000, 5000), limited=True)
    assert all(counts[outcome.value] >= 100 for outcome in Outcome), counts


@pytest.mark.slow
def test_ten_thousand_tampered_certificates_are_never_believed() -> None:
    counts = judge(range(1000, 11_000))
    assert all(counts[outcome.value] >= 400 for outcome in Outcome), counts


@pytest.mark.slow
def test_two_hundred_tampered_certificates_through_the_command(tmp_path: Path) -> None:
    """The exit code and the JSON say what the checker says; nothing but a sentence goes wrong."""
    exit_codes = {Outcome.PROVED: 0, Outcome.REFUTED: 1, Outcome.MALFORMED: 2, Outcome.INCONCLUSIVE: 3}
    command, path = Path(sys.executable).with_name("slewcert"), tmp_path / "certificate.json"
    for seed in range(200):
        content = tampered(20_000 + seed)[1]
        path.write_bytes(content)
        done = subprocess.run([command, "check", path, "--json"], capture_output=True, text=True, timeout=60)
        expected = check(content)
        assert done.returncode == exit_codes[expected.outcome], (seed, done)
        assert json.loads(done.stdout) == expected.to_dict()
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("certificates", [originals, pytest.param(limited_originals, marks=pytest.mark.slow)])
def test_the_originals_are_true_and_their_lies_are_not(certificates: Callable[[], tuple[bytes, ...]]) -> None:
    """The judge can tell: a side moved by 1e-4 of itself is called false."""
    for content in certificates():
        data = opened(content)
        assert is_true(data)
        sampled = data["task"]["limits"]["sample_time"] is not None or certificates is limited_originals
        grown = Fraction(1, 10 if sampled else 10_000)  # by a sample, or more than the grid leaves open
        for side, factor in (("lower", 1 + grown), ("upper", 1 - grown)):
            if data["claim"][side] not in (None, "0"):
                lie = {
                    **data,
                    "claim": {"lower": None, "upper": None, "impossible": None, side: written(number(data["claim"][side]) * factor)},
                }
                assert not is_true(lie)


def test_impossible_tasks_are_unreachable_for_a_linear_program() -> None:
    """The two criteria, seen by HiGHS: no staircase of 200 steps gets there, the second one comes as close as e^-T."""
    for denominator, limits, horizon in (([1, 0, 0], (0.0, 1.0), 30.0), ([1, 1], (-1.0, 1.0), 6.0)):
        plant = independent.StateSpace.of(LinearPlant.from_transfer([1], denominator))
        assert independent.reachable_fraction(plant, 1.0, *limits, horizon, 200) < 1.0
