"""Moves for bands of different tolerances as one task: another program's least time, every plant simulated, corrupted certificates."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from forgery import forged
from scipy.optimize import linprog

from relaxations.bounds import Status
from relaxations.checking.claims import Outcome, check
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.bands import Band
from relaxations.shaping.listed_moves import OfPlants, within_all
from relaxations.shaping.modes import Mode
from relaxations.shaping.moves import Move, within_bands
from suite.cli import main

MOVE = Move(0.1, -2.0, 2.0)
HERTZ = 2 * math.pi
CELLS, CORNERS = 300, 48  # the grid costs less than two cells, the polygon 1 - cos(π/48) = 0.2 % of the tolerances
GRID = 0.006
CASES = {
    "one within the other": [Band(Mode(HERTZ), 0.95, 1.05, 0.02), Band(Mode(HERTZ), 0.8, 1.2, 0.1)],
    "overlapping": [Band(Mode(HERTZ, 0.05), 0.8, 1.1, 0.05), Band(Mode(HERTZ, 0.05), 0.9, 1.3, 0.1)],
    "apart": [Band(Mode(HERTZ, 0.05), 0.9, 1.1, 0.02), Band(Mode(HERTZ, 0.05), 1.8, 2.2, 0.1)],
    "two modes": [Band(Mode(HERTZ), 0.9, 1.1, 0.02), Band(Mode(2.7 * HERTZ), 0.9, 1.1, 0.1)],
}


def solved(bands: list[Band]) -> OfPlants:
    found = within_all(MOVE, bands)
    assert found is not None
    return found


def least_time(bands: list[Band]) -> float:
    """Of staircases of `CELLS` equal steps whose undamped vibrations stay in polygons at 15 frequencies of each band: HiGHS, bisection."""
    turns = np.exp(2j * np.pi * np.arange(CORNERS) / CORNERS)[:, None]

    def reaches(time: float) -> bool:
        edges = np.linspace(0.0, time, CELLS + 1)
        rows, limits = [], []
        for band in bands:
            for omega in np.linspace(*band.ends, 15):
                swing = np.diff(np.exp(1j * omega * edges)) / (1j * omega**2)
                rows.append(np.real(turns * swing))
                limits.append(np.full(CORNERS, band.tolerance * MOVE.displacement))
        equal = np.vstack([np.diff(edges), np.diff((time - edges) ** 2) / -2.0])
        found = linprog(np.zeros(CELLS), np.vstack(rows), np.concatenate(limits), equal, [0.0, MOVE.displacement],
                        bounds=(MOVE.lower, MOVE.upper), method="highs")  # fmt: skip
        return found.status == 0

    low, high = 0.4, 3.0
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one within the other", "two modes"])
def test_another_program_needs_as_long(name: str):
    found = solved(CASES[name]).bound
    assert found.upper is not None
    assert found.lower * (1 - 2e-3) <= least_time(CASES[name]) <= found.upper * (1 + GRID)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_plant_of_every_band_keeps_its_tolerance_and_both_sides_are_proven(name: str):
    bands = CASES[name]
    found = solved(bands)
    bound = found.bound
    assert bound.command is not None
    assert bound.upper is not None
    assert bound.certificate is not None
    assert bound.status is Status.PROVED
    assert bound.lower <= bound.upper <= bound.lower * (1 + 3e-4)
    assert check(bound.certificate).outcome is Outcome.PROVED
    assert found.plants == len(json.loads(bound.certificate)["task"]["box"]["plants"])
    largest = []
    for band in bands:
        sizes = []
        for factor in np.linspace(band.low, band.high, 33):
            omega = band.mode.frequency * float(factor)
            plant = LinearPlant.from_transfer([str(omega**2)], ["1", str(2 * band.mode.damping * omega), str(omega**2), "0", "0"])
            after = response(plant, bound.command, bound.upper + np.linspace(0.0, 2.0, 400))
            sizes.append(float(np.abs(after - MOVE.displacement).max()) / MOVE.displacement)
        largest.append(max(sizes) / band.tolerance)
    assert 0.999 < max(largest) <= 1 + 1e-9
    alone = max(within_bands(MOVE, [band]).lower for band in bands if band.low <= 1.0 <= band.high)
    if name == "overlapping":  # there one band asks for all of the time, and both lower sides are its
        assert bound.lower == pytest.approx(alone, rel=1e-4)
    else:
        assert min(largest) > 0.99, "each band asks for time"
        assert bound.lower > alone * (1 + 1e-3)


@pytest.mark.slow
def test_corrupted_certificates_are_not_proven():
    found = solved(CASES["one within the other"]).bound
    assert found.certificate is not None
    data = json.loads(found.certificate)
    data["claim"]["lower"] = repr(found.lower * 1.001)
    assert check(forged(data)).outcome is not Outcome.PROVED, "a longer least time"
    data = json.loads(found.certificate)
    data["task"]["box"]["tolerance"] = "0.0199"
    assert check(forged(data)).outcome is not Outcome.PROVED, "the command does not keep less"
    data = json.loads(found.certificate)
    seen = data["lower"]["samples"][0]["place"]
    data["task"]["box"]["plants"] = [plant for plant in data["task"]["box"]["plants"] if plant["place"] != seen]
    assert check(forged(data)).outcome is not Outcome.PROVED, "a plant that is none of the list"


@pytest.mark.slow
def test_the_command_line_says_what_the_certificate_is_about():
    words = ("si", "--mode", "1.0Hz:0.05", "--band", "0.9:1.1", "--band", "1.8:2.2", "--move", "0.1", "--input", "-2:2")
    done = CliRunner().invoke(main, ["shaper", *words, "--json"], catch_exceptions=False)
    move = json.loads(done.stdout)["move"]["together"]
    assert move["status"] == "proved"
    assert move["kept"] == [0.05, 0.05]
    assert move["plants"] >= 14
    assert move["between"] == [], "what lies between bands that are apart may swing"
    told = CliRunner().invoke(main, ["shaper", *words], catch_exceptions=False).stdout
    assert f"the certificate is about {move['plants']} plants of the bands" in told


@pytest.mark.parametrize("kept", [True, False])
def test_a_move_that_cannot_be_braked_is_no_bracket(kept: bool):
    bands = [Band(Mode(HERTZ), 1.0, 1.0, 0.5), Band(Mode(HERTZ), 1.0, 1.0, 0.4)]
    found = within_all(MOVE if kept else Move(0.1, 0.0, 2.0), bands)
    assert (found is not None) == kept
