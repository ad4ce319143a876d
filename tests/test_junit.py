"""JUnit results: one case a requirement, and nothing but a pass looks green."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from sample_results import KINDS, results

from reports.junit import junit_bytes, write_junit


def parse(kind: str) -> ElementTree.Element:
    return ElementTree.fromstring(junit_bytes(results(kind)))


def outcomes(root: ElementTree.Element) -> list[str]:
    found = []
    for case in root.iter("testcase"):
        kinds = [child.tag for child in case if child.tag in ("failure", "error", "skipped")]
        assert len(kinds) <= 1
        found.append(kinds[0] if kinds else "passed")
    return found


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("pass", ["passed"] * 4),
        ("fail", ["failure", "passed", "passed", "passed"]),
        ("undecided", ["error", "passed", "passed", "passed"]),
        ("error", ["error", "passed", "error", "error"]),
        ("impossible", ["failure"]),
    ],
)
def test_outcomes(kind: str, expected: list[str]) -> None:
    root = parse(kind)
    assert outcomes(root) == expected
    suite = root.find("testsuite")
    assert suite is not None
    counts = [int(suite.get(name, "-1")) for name in ("tests", "failures", "errors", "skipped")]
    assert counts == [len(expected), expected.count("failure"), expected.count("error"), 0]


def test_a_case_says_what_was_measured() -> None:
    root = parse("fail")
    case = root.find(".//testcase")
    assert case is not None
    assert (case.get("name"), case.get("classname")) == ("SLEW-001", "slewcert.two_mass")
    failure = case.find("failure")
    assert failure is not None
    assert failure.get("message") == "FAIL: 0.1812 is above 0.05"
    assert failure.text is not None
    assert "worst run: 0001-stiffness-0.7" in failure.text
    properties = {p.get("name"): p.get("value") for p in case.iter("property")}
    assert (properties["quantity"], properties["max"], properties["value"]) == ("residual_vibration", "0.05", "0.18120000031")


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "pass"])
def test_without_requirements_only_a_pass_is_green(kind: str) -> None:
    data = results(kind) | {"requirements": []}
    assert outcomes(ElementTree.fromstring(junit_bytes(data))) == ["failure" if data["verdict"] == "fail" else "error"]


def test_any_text_is_well_formed(tmp_path: Path) -> None:
    data = results("fail")
    data["title"] = "<b>&\"'</b> \x00\x1b ]]> \ud800 Δ"
    data["requirements"][0]["text"] = "</failure><testcase/>"
    data["requirements"][0]["reason"] = ""
    write_junit(tmp_path / "junit.xml", data)
    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert len(outcomes(root)) == 4
    suite = root.find("testsuite")
    assert suite is not None
    assert suite.get("name") == "<b>&\"'</b> \ufffd\ufffd ]]> \ufffd Δ"


def test_the_same_results_give_the_same_bytes() -> None:
    first = junit_bytes(results("error"))
    assert first == junit_bytes(results("error"))
    assert b"timestamp" not in first
    assert b"hostname" not in first


def test_an_unknown_verdict_is_an_error() -> None:
    data = results("pass")
    data["requirements"][0]["verdict"] = "perhaps"
    assert outcomes(ElementTree.fromstring(junit_bytes(data)))[0] == "error"
