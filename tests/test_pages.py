"""The page: nothing but a pass is green, nothing bracketed is called proved, nothing is loaded, and all text is text."""

from __future__ import annotations

import colorsys
import re
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from sample_results import KINDS, results

from reports.errors import RecordError
from reports.pages import MOST_RUNS, MOST_SEGMENTS, render, write_page

VOID = {"meta", "br", "link", "img", "input", "hr"}
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"><title>x</title><path d="M 0 0"/></svg>'


class Page(HTMLParser):
    """Collects tags, attributes and text, and checks that every tag is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text.append(data)

    def classes(self, name: str) -> list[str]:
        return [c or "" for c in (a.get("class") for _, a in self.tags) if name in (c or "").split()]

    def values(self, attribute: str) -> list[str]:
        return [v for v in (a.get(attribute) for _, a in self.tags) if v is not None]


def page(kind: str) -> Page:
    return Page(render(results(kind), {"Nominal run": SVG}))


@pytest.mark.parametrize("kind", KINDS)
def test_the_verdict_stands_on_top_in_its_own_colour(kind: str) -> None:
    found = page(kind)
    shown = {"impossible": "fail"}.get(kind, kind)
    assert found.classes("verdict") == [f"verdict is-{shown}"]
    text = " ".join("".join(found.text).split())
    assert text.index(shown.upper()) < text.index("Requirements")
    if kind != "pass":
        # As many green badges as verdicts that are a pass, and not one more.
        data = results(kind)
        passed = sum(r["verdict"] == "pass" for r in data["requirements"] + data["run_table"])
        assert len(found.classes("is-pass")) == passed


@pytest.mark.parametrize("verdict", ["undecided", "error", "perhaps"])
def test_only_a_pass_is_green(verdict: str) -> None:
    data: dict[str, Any] = results("pass") | {"verdict": verdict}
    for item in data["requirements"] + data["run_table"]:
        item["verdict"] = verdict
    found = Page(render(data, {}))
    assert found.classes("is-pass") == []
    assert "✓" not in "".join(found.text)
    assert "All 4" not in "".join(found.text)


def test_results_that_contradict_themselves_are_refused() -> None:
    data = results("undecided") | {"verdict": "pass"}
    with pytest.raises(RecordError, match="contradict"):
        render(data, {})
    with pytest.raises(RecordError, match="slewcert-results/9"):
        render(results() | {"format": "slewcert-results/9"}, {})


@pytest.mark.parametrize("status", ["bracketed", "somehow"])
def test_bracketed_is_never_called_proved(status: str) -> None:
    data = results("fail")
    data["bound"] |= {"status": status, "reason": "the switch times were repaired, not refined"}
    html = render(data, {})
    section = html[html.index("<h2>Minimum time") : html.index("<h2>Task")]
    assert not re.search(r"\b(proved|proven)\b", section, re.IGNORECASE)
    assert "is-proved" not in html.split("</style>")[1]
    assert "is-bracketed" in section
    assert "repaired, not refined" in html
    header = html[html.index("<header>") : html.index("</header>")]
    assert f"minimum {status}" in header


def test_half_a_bracket() -> None:
    data: dict[str, Any] = results("fail") | {"command": None}
    data["bound"] |= {"maneuver_time": {"lower": 9.1, "upper": None}, "command": None, "switches": None, "fuel": None}
    text = "".join(Page(render(data, {})).text)
    assert "9.1" in text
    assert "None" not in text


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_loaded_and_every_link_leads_somewhere(kind: str) -> None:
    html = render(results(kind), {"Nominal run": SVG})
    found = Page(html)
    assert {t for t, _ in found.tags} & {"script", "link", "img", "iframe", "object", "form", "base"} == set()
    assert "default-src 'none'" in html
    assert not re.search(r"url\(|@import|https?:", html.replace("http://www.w3.org/2000/svg", ""))
    ids = found.values("id")
    assert len(set(ids)) == len(ids)
    for link in found.values("href"):
        assert link.startswith("./") or link.removeprefix("#") in ids
    assert "None" not in "".join(found.text)


def test_everything_a_study_says_is_text() -> None:
    nasty = "<script>alert(1)</script><img src=x onerror=alert(1)>\"'&{{7*7}}"

    def spoil(data: Any, keep: bool = False) -> Any:
        match data:
            case str() if not keep:
                return data + nasty
            case list():
                return [spoil(item) for item in data]
            case dict():
                # Words that steer the page stay; everything else, keys that are names included, is spoiled.
                words = {"format", "verdict", "status", "rest", "robustness"}
                named = {"parameters", "quantities", "environment"}
                return {
                    key: {k + nasty: v for k, v in item.items()} if key in named else spoil(item, key in words)
                    for key, item in data.items()
                }
            case _:
                return data

    data = spoil(results("fail"))
    found = Page(render(data, {nasty: SVG}))
    assert {t for t, _ in found.tags} & {"script", "img"} == set()
    assert not any(name.startswith("on") for _, attributes in found.tags for name in attributes)
    assert "".join(found.text).count("{{7*7}}") > 40
    assert all(link.startswith(("./", "#")) for link in found.values("href"))


@pytest.mark.parametrize("path", ["javascript:alert(1)", "//evil.example/x", "http://evil.example", "data:text/html,x"])
def test_a_log_is_a_file_of_the_folder(path: str) -> None:
    data = results()
    data["run_table"][0]["log"] = path
    link = Page(render(data, {})).values("href")
    assert not [x for x in link if ":" in x]
    assert all(x.startswith(("./", "#")) for x in link)


def test_many_runs_are_cut_but_the_bad_ones_stay() -> None:
    data = results("fail")
    template = data["run_table"][4]
    data["run_table"] += [template | {"run": f"{i:04d}-more", "verdict": "pass"} for i in range(100, 100 + 2 * MOST_RUNS)]
    data["run_table"].append(template | {"run": "9999-bad", "verdict": "error"})
    data["command"]["segments"] = [{"start": i / 10, "level": 0.0, "slope": 0.0} for i in range(MOST_SEGMENTS + 5)]
    found = Page(render(data, {}))
    rows = [i for i in found.values("id") if i.startswith("run-")]
    assert len(rows) == MOST_RUNS
    assert {"run-9999-bad", "run-0000-nominal", "run-0001-stiffness-0.7"} <= set(rows)
    text = "".join(found.text)
    assert f"{MOST_RUNS} of {len(data['run_table'])} runs" in text
    assert "5 more segments" in text


def test_a_value_at_its_limit_shows_on_which_side_it_is() -> None:
    data = results("fail")
    data["requirements"][0].update(value=0.0500000001, margin=-1e-10)
    assert "0.0500000001" in "".join(Page(render(data, {})).text)


def test_missing_members_are_mistakes_and_not_blanks() -> None:
    data = results()
    del data["plant"]["input"]
    with pytest.raises(KeyError, match="input"):
        render(data, {})


def test_the_same_results_give_the_same_page(tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", results(), {"a": SVG})
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == render(results(), {"a": SVG})


# --- colours


def palettes() -> dict[str, dict[str, str]]:
    css = (files("reports") / "page.css").read_text(encoding="utf-8")
    blocks = [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", b)) for b in re.findall(r":root \{(.*?)\}", css, re.DOTALL)]
    return dict(zip(("light", "dark", "print"), blocks, strict=True))


def luminance(colour: str) -> float:
    channels = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark", "print"])
def test_text_can_be_read(scheme: str) -> None:
    palette = palettes()[scheme]
    pairs = [(name, "paper") for name in ("ink", "soft", "link", "chart-ink", "pass", "fail", "undecided", "error")]
    pairs += [(name, f"{name}-tint") for name in ("pass", "fail", "undecided", "error")]
    too_low = {pair: contrast(palette[pair[0]], palette[pair[1]]) for pair in pairs if contrast(palette[pair[0]], palette[pair[1]]) < 4.5}
    assert too_low == {}  # 4.5: WCAG 2.2, level AA, for text of any size


@pytest.mark.parametrize("scheme", ["light", "dark", "print"])
def test_green_means_pass_and_nothing_else(scheme: str) -> None:
    for name, colour in palettes()[scheme].items():
        red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
        hue, _, saturation = colorsys.rgb_to_hls(red, green, blue)
        looks_green = 75 / 360 < hue < 165 / 360 and saturation > 0.1 and max(red, green, blue) - min(red, green, blue) > 0.02
        assert looks_green == name.startswith("pass"), name
