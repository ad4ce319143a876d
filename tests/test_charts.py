"""Charts: the same bytes every time, labels taken literally, colours left to the page, and nothing that two charts could share."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from reports.charts import Limit, command_and_response, costs, sensitivity, sweep
from reports.errors import RecordError

SVG = "{http://www.w3.org/2000/svg}"
NASTY = "<script>alert(1)</script> & \"$x_1$\" 'µ'"


def run_chart(name: str = "nominal", **changes: Any) -> str:
    times = np.linspace(0.0, 10.0, 401)
    given: dict[str, Any] = {
        "start": 0.0,
        "end": 4.0,
        "target": 5.0,
        "displacement": 5.0,
        "command_label": "force [N]",
        "output_label": "position_2 [m]",
        "input_limits": (-1.0, 1.0),
        "linear": 5.0 * np.minimum(times / 4.0, 1.0),
        "tolerance": 0.05,
    }
    return command_and_response(name, times, np.sign(2.0 - times), 5.0 * np.minimum(times / 4.0, 1.0), **(given | changes))


def sweep_chart(name: str = "sweep", **changes: Any) -> str:
    given: dict[str, Any] = {
        "parameter_label": "stiffness [N/m]",
        "quantity_label": "residual vibration [%]",
        "nominal": 1.0,
        "limits": [Limit(5.0, "SLEW-001")],
    }
    return sweep(name, [1.3, 0.7, 1.0], [3.0, 4.0, 0.0], **(given | changes))


def sensitivity_chart(name: str = "sensitivity", **changes: Any) -> str:
    factors = np.linspace(0.7, 1.3, 61)
    return sensitivity(name, factors, {"ZV": 50 * abs(factors - 1), "ZVD": 50 * (factors - 1) ** 2}, limits=[Limit(5.0, "5 %")], **changes)


def cost_chart(name: str = "costs") -> str:
    return costs(name, [10, 20, 40], {"search": [0.1, 0.5, 3.0], "check": [0.01, 0.1, np.nan]}, size_label="poles")


CHARTS = {"run": run_chart, "sweep": sweep_chart, "sensitivity": sensitivity_chart, "costs": cost_chart}


def texts(svg: str) -> set[str]:
    return {"".join(t.itertext()) for t in ElementTree.fromstring(svg).iter(f"{SVG}text")}


@pytest.mark.parametrize("kind", CHARTS)
def test_the_same_data_gives_the_same_text(kind: str) -> None:
    assert CHARTS[kind]() == CHARTS[kind]()


@pytest.mark.parametrize("kind", CHARTS)
def test_a_chart_stands_alone(kind: str) -> None:
    svg = CHARTS[kind]()
    root = ElementTree.fromstring(svg)
    assert root.tag == f"{SVG}svg"
    assert root.get("viewBox")
    assert (root.get("width"), root.get("height")) == (None, None)  # the page decides
    assert not [e for e in root.iter() if e.tag in (f"{SVG}script", f"{SVG}image", f"{SVG}metadata")]
    assert re.findall(r"https?://[^\"]+", svg.split(">", 1)[1]) == []
    assert not re.search(r"20\d\d-\d\d-\d\d", svg)
    assert len(svg) < 100_000  # characters; a page holds a dozen


@pytest.mark.parametrize("kind", CHARTS)
def test_colours_and_fonts_are_the_pages(kind: str) -> None:
    svg = CHARTS[kind]()
    assert "DejaVu" not in svg
    plain = re.findall(r"(?:fill|stroke): (?!none|var\()[^;\"]+", svg)
    assert plain == []
    assert "var(--chart-line, #1f5fa8)" in svg


def test_ids_are_referred_to_and_never_shared() -> None:
    charts = [run_chart("Nominal run"), run_chart("Worst run: 0001"), sweep_chart(), sensitivity_chart()]
    ids = [re.findall(r' id="([^"]+)"', svg) for svg in charts]
    everything = [i for group in ids for i in group]
    assert len(set(everything)) == len(everything) > 0
    for svg, group in zip(charts, ids, strict=True):
        assert set(re.findall(r"url\(#([^)]+)\)", svg)) | set(re.findall(r'href="#([^"]+)"', svg)) == set(group)


@pytest.mark.parametrize(
    "svg",
    [
        run_chart(NASTY, command_label=NASTY, output_label=NASTY),
        sweep_chart(NASTY, parameter_label=NASTY, limits=[Limit(1.0, NASTY)]),
        sensitivity_chart(NASTY, factor_label=NASTY),
    ],
)
def test_labels_are_text_and_no_formula(svg: str) -> None:
    assert NASTY in texts(svg)
    root = ElementTree.fromstring(svg)
    assert root.get("aria-label") == NASTY
    assert "<script" not in svg


def test_every_run_has_its_mark() -> None:
    values = np.linspace(0.7, 1.3, 11)
    results = 40.0 * abs(values - 1.0)
    results[3] = np.nan
    verdicts = ["fail", "fail", *["pass"] * 8, "undecided"]
    svg = sweep("s", values, results, parameter_label="k", quantity_label="v", verdicts=verdicts, errors=np.full(11, 1e-3))
    assert {"pass", "FAIL", "UNDECIDED", "no result"} <= texts(svg)
    marks = [e.get("style", "") for e in ElementTree.fromstring(svg).iter(f"{SVG}use")]
    # Two runs failed and one is without result, each kind with one more mark in the legend.
    assert sum("chart-bad" in m for m in marks) == 2 + 1 + 1 + 1
    assert sum("chart-unsure" in m for m in marks) == 1 + 1


def test_the_command_is_drawn_in_steps() -> None:
    svg = run_chart()
    path = next(e.get("d", "") for e in ElementTree.fromstring(svg).iter(f"{SVG}path") if "chart-line" in e.get("style", ""))
    points = [tuple(map(float, p)) for p in re.findall(r"[ML] (\S+) (\S+)", path)]
    assert len(points) > 3
    # svg: each piece is horizontal or vertical, never a ramp from one level to the next
    assert all(a[0] == b[0] or a[1] == b[1] for a, b in pairwise(points))


def test_data_that_do_not_fit() -> None:
    with pytest.raises(RecordError, match=r"times \(401,\), linear \(3,\)"):
        run_chart(linear=[0.0, 1.0, 2.0])
    with pytest.raises(RecordError, match="displacement"):
        run_chart(displacement=0.0)
    with pytest.raises(RecordError, match="3 values but 1 verdicts"):
        sweep_chart(verdicts=["pass"])


def test_powers_of_ten_are_numbers() -> None:
    svg = costs("cost", [2, 20], {"one": [0.001, 10.0]}, size_label="poles")
    assert "mathdefault" not in svg
    assert ">0.01<" in svg
