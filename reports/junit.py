"""JUnit results, which every continuous-integration service reads: one test case a requirement. The only module that imports junitparser.

A requirement that fails is a failure; one that is undecided or in error is an error, so that it can never look green.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping
from typing import Any

from junitparser import Error, Failure, JUnitXml, Properties, Property, TestCase, TestSuite

from reports.files import write_atomically

_ILLEGAL = re.compile(r"[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(path: str | os.PathLike[str], results: Mapping[str, Any]) -> None:
    """Write `junit_bytes(results)` atomically. Raises `OSError`."""
    write_atomically(path, junit_bytes(results))


def junit_bytes(results: Mapping[str, Any]) -> bytes:
    """The JUnit XML of `results` (slewcert-results/1), without clock or host name: the same results give the same bytes."""
    study = _text(results["study"]["file"]).removesuffix(".toml")
    suite = TestSuite(_text(results["title"]))
    suite.add_property("version", _text(results["version"]))
    suite.add_property("verdict", _text(results["verdict"]))
    suite.add_property("study.sha256", _text(results["study"]["sha256"]))
    cases = [_case(study, requirement) for requirement in results["requirements"]]
    if results["verdict"] != "pass" and all(case.is_passed for case in cases):
        # Without a verdict on any requirement (an impossible task, no runs) the file must not look green either.
        case = TestCase("task", f"slewcert.{study}", 0.0)
        reason = results["bound"].get("reason") or "see the report"
        _judge(case, results["verdict"], f"{results['verdict'].upper()}: {reason}", "")
        cases.append(case)
    suite.add_testcases(cases)
    xml = JUnitXml("slewcert")
    xml.add_testsuite(suite)
    out = io.BytesIO()
    xml.write(out, pretty=True)
    return out.getvalue()


def _case(study: str, requirement: Mapping[str, Any]) -> TestCase:
    case = TestCase(_text(requirement["id"]), f"slewcert.{study}", 0.0)
    properties = Properties()
    for key in ("text", "quantity", "scope", "min", "max", "unit", "value", "error", "margin", "worst_run"):
        if requirement.get(key) not in (None, ""):
            properties.add_property(Property(key, _text(requirement[key])))
    case.append(properties)
    value = "no value" if requirement["value"] is None else f"{requirement['value']!r} ± {requirement['error']!r}"
    bounds = [f"{name} {requirement[name]!r}" for name in ("min", "max") if requirement[name] is not None]
    summary = f"{requirement['quantity']} is {value} {requirement['unit']} ({', '.join(bounds)})"
    message = f"{requirement['verdict'].upper()}: {requirement['reason'] or summary}"
    _judge(case, requirement["verdict"], message, f"{requirement['text']}\n{summary}\nworst run: {requirement['worst_run']}")
    return case


def _judge(case: TestCase, verdict: str, message: str, detail: str) -> None:
    """Anything but a plain pass or fail is an error, verdicts this version does not know included."""
    if verdict == "pass":
        return
    result = Failure(_text(message), "fail") if verdict == "fail" else Error(_text(message), _text(verdict))
    result.text = _text(detail)
    case.result = [result]


def _text(value: object) -> str:
    """XML has no way to write some control characters."""
    return _ILLEGAL.sub("\ufffd", str(value))
