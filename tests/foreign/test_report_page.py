"""The report in a real browser: it shows the verdict, asks nobody for anything, and complains of nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from browser import chromium, look_at, page

pytestmark = [pytest.mark.foreign, pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")]

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def results(evidence: Path) -> dict:
    return json.loads((evidence / "results.json").read_text())


@pytest.fixture(scope="module")
def seen(evidence: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the browser saw."""
    return look_at(evidence / "report.html", tmp_path_factory.mktemp("pictures"))


def test_the_browser_notices_requests_and_complaints(tmp_path: Path) -> None:
    """The two tests below can fail: a page that does both is caught at both."""
    other = tmp_path / "other.js"
    other.write_text("console.error('told you')")
    guilty = tmp_path / "guilty.html"
    guilty.write_text("<title>guilty</title><body>here<script src='other.js'></script><script>nothing.there</script></body>")
    with page() as tab:
        tab.open(guilty.as_uri())
        assert tab.text() == "here"
        assert other.as_uri() in tab.requests
        assert any("told you" in said for said in tab.complaints)
        assert any("Uncaught" in said for said in tab.complaints)


def test_asks_nobody_for_anything(seen: dict) -> None:
    assert [address for address in seen["requests"] if not address.startswith("data:")] == [seen["address"]]


def test_console_is_silent(seen: dict) -> None:
    assert seen["complaints"] == ()


def test_shows_verdict_and_every_requirement(seen: dict, results: dict) -> None:
    assert results["verdict"] == "pass"
    assert "PASS" in seen["text"]
    assert seen["title"].strip()
    for requirement in results["requirements"]:
        assert requirement["id"] in seen["text"]


def test_the_bracket_is_shown_with_what_is_known_of_it(seen: dict, results: dict) -> None:
    assert results["bound"]["status"] == "proved"
    assert "Proved" in seen["text"]
    lower, upper = (repr(results["bound"]["maneuver_time"][side]) for side in ("lower", "upper"))
    shown = seen["text"].replace("\n", "").replace(" ", "")
    assert lower in shown
    assert upper in shown


def test_plots_have_a_size(seen: dict) -> None:
    assert len(seen["plots"]) >= 2  # command and response; residual against the uncertain parameter
    assert all(width > 200 and height > 100 for width, height in seen["plots"])


def test_pictures_were_taken(seen: dict) -> None:
    for picture in seen["pictures"]:
        content = picture.read_bytes()
        assert content.startswith(PNG)
        assert len(content) > 20_000, f"{picture.name} is nearly empty"  # an empty page of this size takes 5 kB


def test_fits_a_narrow_window(seen: dict) -> None:
    assert seen["narrow_overflow"] <= 0, "the page scrolls sideways on a telephone"
