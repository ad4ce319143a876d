"""The comparison in a real browser: every command with its verdicts, nothing asked of anybody, nothing beside the edge of a telephone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from browser import chromium, look_at

pytestmark = [pytest.mark.foreign, pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")]

COMMANDS = ("none", "zv", "zvd", "si")


@pytest.fixture(scope="module")
def seen(comparison: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the browser saw."""
    return look_at(comparison / "comparison.html", tmp_path_factory.mktemp("pictures"))


def test_asks_nobody_for_anything_and_complains_of_nothing(seen: dict) -> None:
    assert [address for address in seen["requests"] if not address.startswith("data:")] == [seen["address"]]
    assert seen["complaints"] == ()


def test_shows_every_command_with_its_verdicts(seen: dict, comparison: Path) -> None:
    record = json.loads((comparison / "comparison.json").read_text())
    assert [row["name"] for row in record["commands"]] == list(COMMANDS)
    lines = [line.split("\t")[0].strip() for line in seen["text"].splitlines()]
    assert all(lines.count(name) >= 2 for name in COMMANDS), "among the commands and among the shapers"
    verdicts = [verdict["verdict"] for row in record["commands"] for verdict in row["requirements"].values()]
    verdicts += [row["verdict"] for row in record["commands"]]
    assert seen["text"].count("FAIL") == verdicts.count("fail") > 0
    assert seen["text"].count("PASS") == verdicts.count("pass") > 0
    for requirement in record["requirements"]:
        assert requirement["id"] in seen["text"]


def test_proven_bounds_are_rounded_outward(seen: dict, comparison: Path) -> None:
    for row in json.loads((comparison / "comparison.json").read_text())["commands"]:
        (line,) = (line for line in seen["text"].splitlines() if line.split("\t")[:2] == [row["name"], row["shaper"]["kind"]])
        _, _, _, least, worst, _ = line.split("\t")
        low, high = map(float, worst.split(" to "))
        assert low <= row["shaper"]["worst_residual"][0]
        assert high >= row["shaper"]["worst_residual"][1]
        assert float(least) <= row["shaper"]["least_duration"]["lower"]


def test_plots_have_a_size_and_pictures_were_taken(seen: dict) -> None:
    assert len(seen["plots"]) == 4
    # Responses on one another; residual over the length; every plant of the command that fails, twice: all its logs are kept.
    assert all(width > 200 and height > 100 for width, height in seen["plots"])
    assert [picture.stat().st_size > 40_000 for picture in seen["pictures"]] == [True] * 4


def test_fits_a_narrow_window(seen: dict) -> None:
    assert seen["narrow_overflow"] <= 0, "the page scrolls sideways on a telephone"
