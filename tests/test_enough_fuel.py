"""Too little fuel: `bound` says what every command needs, proven; closed forms, tails, starts, and tasks of which nothing is said."""

from __future__ import annotations

import json
from fractions import Fraction
from math import hypot
from pathlib import Path

import pytest
from click.testing import CliRunner
from made_fmus import linear_fmu

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
        (asked(LAG, 3, "2.9"), 3.0),
        (asked(LinearPlant.from_transfer([1, 1], [1, 2, 0]), 1, "1"), 2.0),
        (asked(PENDULUM, 0, "0.1", start=SWING), hypot(1.7, 0.3)),  # what a swing has of momentum
        (asked(LinearPlant.from_transfer([1, 2], [1, 1, 0]), 2, "0.2", tail=True), 1.0),
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
