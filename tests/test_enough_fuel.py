"""Too little fuel: `bound` says what every command needs, proven; closed forms, tails, starts, and tasks of which nothing is said."""

from __future__ import annotations

import json
from fractions import Fraction
from math import hypot
from pathlib import Path

import numpy as np
import pytest
from box_tasks import forged
from click.testing import CliRunner
from made_fmus import linear_fmu
from marks import slow
from scipy.linalg import expm
from scipy.optimize import linprog

from relaxations.checking.claims import Outcome, check
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.onoff.enough import too_little
from relaxations.plants import LinearPlant
from suite.cli import main

LAG = LinearPlant.from_transfer([1], [1, 1, 0])
PENDULUM = LinearPlant.from_transfer([1], [1, 0, 1])
MASS = LinearPlant.from_transfer([1], [1, 0, 0])
SWING = (Fraction("1.7"), Fraction("0.3"))
REQUIRED = '[[requirement]]\nid = "TIME"\nquantity = "maneuver_time"\nmax = 8\nunit = "s"\n'
STUDY = "[plant]\nnumerator = [1]\ndenominator = [1, 1, 0]\n[maneuver]\ndisplacement = 3\n[limits]\ninput = [-1, 1]\nfuel = "


def asked(
    plant: LinearPlant, displacement: int, fuel: str | None, *, tail: bool = False, start: tuple[Fraction, ...] | None = None
) -> Problem:
    return problem([plant], Maneuver(Fraction(displacement), Limits.of(-1, 1, fuel), tail=tail, initial=start))


@pytest.mark.parametrize(
    ("posed", "least"),
    [
        (asked(LAG, 3, "0.01"), 3.0),  # ∫u adds up to the displacement
        slow(asked(LAG, 3, "2.9"), 3.0),
        (asked(LinearPlant.from_transfer([1, 1], [1, 2, 0]), 1, "1"), 2.0),
        (asked(PENDULUM, 0, "0.1", start=SWING), hypot(1.7, 0.3)),  # what a swing has of momentum
        slow(asked(LinearPlant.from_transfer([1, 2], [1, 1, 0]), 2, "0.2", tail=True), 1.0),
    ],
)
def test_the_most_that_is_too_little_is_proven_and_sharp(posed: Problem, least: float) -> None:
    found = too_little(posed)
    assert found is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    assert json.loads(found.certificate)["claim"]["impossible"] == "fuel"
    assert found.below <= least * (1 + 1e-15)
    assert found.below >= least * (1 - 1e-6)  # how far beyond the largest costate its price is: 1e-7, rounded


def test_a_mass_that_moves_needs_its_momentum() -> None:
    found = too_little(asked(MASS, 1, "0.3", start=(Fraction(0), Fraction(1))))
    assert found is not None
    assert 1 - 1e-6 <= found.below <= 1.0


def needed(denominator: list[float], numerator: list[float], displacement: float, start: tuple[Fraction, ...], zeros: list[float]) -> float:
    """By an independent program: the least Σ|impulse| at 200 instants of some time, in phase variables, and tails c e^{zr}, |c| ≤ 1.

    What a tail burns does not count, so the best time may be a short one.
    """
    return min(needed_in(time, denominator, numerator, displacement, start, zeros) for time in (*np.geomspace(0.05, 4.0, 7), 30.0))


def needed_in(
    time: float, denominator: list[float], numerator: list[float], displacement: float, start: tuple[Fraction, ...], zeros: list[float]
) -> float:
    """The same in that time; infinite where it is not possible."""
    n, count = len(denominator) - 1, 200
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -np.array(denominator[:0:-1])
    step = expm(A * time / count)
    columns, at = [], np.eye(n)[:, -1]
    for _ in range(count + 1):
        columns.append(at)
        at = step @ at
    rest = np.zeros(n)
    rest[0] = displacement / numerator[-1]  # an integrator: no input is needed
    free = np.linalg.matrix_power(step, count) @ np.array([float(x) for x in start])
    ways = [np.linalg.solve(z * np.eye(n) - A, np.eye(n)[:, -1]) for z in zeros]
    table = np.hstack([np.array(columns).T, -np.array(columns).T, *(-way[:, None] for way in ways)])
    cost = np.concatenate([np.ones(2 * len(columns)), np.zeros(len(ways))])
    bounds = [(0, None)] * (2 * len(columns)) + [(-1, 1)] * len(ways)
    found = linprog(cost, A_eq=table, b_eq=rest - free, bounds=bounds, method="highs")
    return float(found.fun) if found.status == 0 else np.inf


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "tail"),
    [
        (("-0.3", "1.5"), True),
        *(
            pytest.param(start, tail, marks=pytest.mark.slow)
            for start in (("1", "0"), ("-0.5", "0"), ("0.2", "-0.7"), ("0", "0"))
            for tail in (True, False)
        ),
    ],
)
def test_a_start_and_a_tail_together(start: tuple[str, str], tail: bool) -> None:
    """(s + 2)/(s (s + 1)): proven, and as much as another program finds that it needs."""
    begins = tuple(Fraction(x) for x in start)
    least = needed([1, 1, 0], [1, 2], 4.0, begins, [-2.0] if tail else [])
    found = too_little(asked(LinearPlant.from_transfer([1, 2], [1, 1, 0]), 4, "0.01", tail=tail, start=begins))
    assert found is not None
    assert check(found.certificate).outcome is Outcome.PROVED
    sharp = not tail or start[1] != "-0.7"  # there a costate that is one for all times, short ones too, loses some
    assert (1 - 2e-3 if sharp else 0.85) * least <= found.below <= least * (1 + 1e-9)  # of the other one's instants


@pytest.mark.slow
def test_a_start_that_helps_is_not_forgotten() -> None:
    """Must and must not: what is refuted of one start is no claim about another one, nor about a larger budget."""
    plant = LinearPlant.from_transfer([1, 2], [1, 1, 0])
    found = too_little(asked(plant, 4, "0.01", tail=True, start=(Fraction(-1, 2), Fraction(0))))
    assert found is not None
    for change in (
        lambda d: d["task"].update(initial_state=["1", "0"]),
        lambda d: d["task"].update(initial_state=["-0.4999", "0"]),
        lambda d: d["task"].update(initial_state=["-0.5", "0.001"]),
        lambda d: d["task"]["limits"].update(fuel=str(found.below * (1 + 1e-5))),
        lambda d: d["lower"].update(fuel="0.5"),
        lambda d: d["lower"].update(costate=[]),
    ):
        assert forged(found.certificate, change) is not Outcome.PROVED
    for change in (lambda d: d["task"].update(initial_state=["-0.5001", "0"]), lambda d: d["task"]["limits"].update(fuel="1")):
        assert forged(found.certificate, change) is Outcome.PROVED


@pytest.mark.parametrize("posed", [asked(LAG, 3, None), asked(LAG, 3, "3.5"), asked(MASS, 1, "0.001")])
def test_of_other_tasks_nothing_is_said(posed: Problem) -> None:
    assert too_little(posed) is None


def test_bound_says_it(tmp_path: Path) -> None:
    file, proof = tmp_path / "s.toml", tmp_path / "s.json"
    file.write_text(f"{STUDY}2\n")
    done = CliRunner().invoke(main, ["bound", str(file), "--json", "--certificate", str(proof)], catch_exceptions=False)
    assert done.exit_code == 1
    record = json.loads(done.stdout)
    assert 3 - 3e-6 <= record["least_fuel"]["lower"] <= 3.0
    told = check(Path(record["least_fuel"]["certificate"]).read_bytes())
    assert told.outcome is Outcome.PROVED
    text = CliRunner().invoke(main, ["bound", str(file)], catch_exceptions=False).stdout
    assert "least fuel: every command needs 2.99999" in text
    assert "input·s or more, however long it takes (proved)" in text


def test_bound_says_nothing_of_it_where_there_is_enough(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(f"{STUDY}3.5\n")
    done = CliRunner().invoke(main, ["bound", str(file), "--json"], catch_exceptions=False)
    assert "least_fuel" not in json.loads(done.stdout)


def test_verify_says_it_and_keeps_the_certificate(tmp_path: Path) -> None:
    fmu = linear_fmu("lagging", [[0.0, 1.0], [0.0, -1.0]], [0.0, 1.0], [1.0, 0.0])
    file, folder = tmp_path / "s.toml", tmp_path / "out"
    limited = STUDY[STUDY.index("[maneuver]") :]
    file.write_text(f'[plant]\nfmu = "{fmu}"\ninput = "u"\noutput = "y"\n{limited}2\n{REQUIRED}')
    done = CliRunner().invoke(main, ["verify", str(file), "--out", str(folder)], catch_exceptions=False)
    assert done.exit_code == 1
    assert "every command needs 2.99999" in done.stdout
    found = json.loads((folder / "results.json").read_text())
    assert 3 - 3e-6 <= found["bound"]["least_fuel"]["lower"] <= 3.0
    assert "every command needs 2.99999" in found["requirements"][0]["reason"]
    assert "every command needs 2.99999" in (folder / "report.html").read_text()
    told = check((folder / found["bound"]["least_fuel"]["certificate"]).read_bytes())
    assert told.outcome is Outcome.PROVED
