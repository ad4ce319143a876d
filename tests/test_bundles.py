"""Every plant of a range on one picture: what it shows, and that a choice of runs is never shown as the whole."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_studies import small_study

from reports.bundle_charts import Bundle, Run, every_run
from suite.cli import main

TIMES = np.linspace(0.0, 40.0, 401)


def bundle(label: str, failed: bool) -> Bundle:
    runs = [Run(TIMES, 1.0 + gain * np.exp(-TIMES), gain == 0.0, failed and gain > 0.5) for gain in (-0.5, 0.0, 1.0)]
    return Bundle(label, runs, 2.0)


def test_both_charts_and_what_they_say():
    drawn = every_run(
        [bundle("one", False), bundle("other", True)], target=1.0, displacement=2.0, output_label="pitch [rad]", until=6.0, tolerance=0.05
    )
    whole, after = drawn
    assert whole == "Every plant of the range: one, other"
    assert after == "Every plant of the range after the move: one, other"
    words = {title: set(re.findall(r"<text[^>]*>([^<]*)</text>", svg)) for title, svg in drawn.items()}
    for said in words.values():
        assert {"one", "other", "nominal plant", "another plant of the range", "fails a requirement", "end of the move"} <= said
    assert "allowed" in words[after] - words[whole]
    assert "pitch [rad]" in words[whole]
    assert "from target [% of move]" in words[after]
    assert not {"10", "20", "40"} & words[whole]  # three times the longest move, not the whole run


@pytest.mark.slow
def test_reports_and_comparisons_show_campaigns_of_which_every_log_was_kept(tmp_path: Path):
    for name, logs in (("one", "all"), ("other", "worst")):
        small_study(tmp_path, "[keep]", f'logs = "{logs}"', limit=0.2, name=f"{name}.toml")
    words = ["compare", str(tmp_path / "one.toml"), str(tmp_path / "other.toml"), "--out", str(tmp_path / "out"), "--jobs", "1"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    for page, shown in (("comparison.html", True), ("one/report.html", True), ("other/report.html", False)):
        page_text = (tmp_path / "out" / page).read_text()
        assert ("Every plant of the range: one<" in page_text) is shown, page
        assert "Every plant of the range: other" not in page_text
