"""Evidence that was changed on purpose, hashes and all, and nonsense in its place: the review confirms neither, and survives both."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from marks import slow
from small_studies import results, run_table
from tampering import close, relog, rewrite, run

from reports import logs
from reports.files import json_bytes, sha256
from reports.records import RunLog
from suite.review import ReviewStatus, review

CONFIRMED, DIFFERS, TAMPERED, INCOMPLETE = ReviewStatus.CONFIRMED, ReviewStatus.DIFFERS, ReviewStatus.TAMPERED, ReviewStatus.INCOMPLETE
WORST = "runs/0001.mcap"


@pytest.fixture
def folder(verified: Path, tmp_path: Path) -> Path:
    """A copy to be tampered with."""
    return Path(shutil.copytree(verified, tmp_path / "out"))


# Changed on purpose, hashes and all


def recorded(log: RunLog, quantity: str, value: float) -> RunLog:
    assert log.verdict is not None
    told = json.loads(log.verdict["quantities"])
    told[quantity]["value"] = value
    return replace(log, verdict={**log.verdict, "quantities": json.dumps(told)})


def test_a_value_changed_everywhere_differs_from_the_signals(folder: Path) -> None:
    quantities = run_table(folder)["0001"]["quantities"]
    quantities["residual_vibration"]["value"] = 0.01
    relog(folder, "0001", lambda log: recorded(log, "residual_vibration", 0.01), {"quantities": quantities})

    def better(found: dict[str, Any]) -> None:
        found["requirements"][0].update(value=0.01, margin=0.04)

    rewrite(folder, better)
    done = run(folder, "--json")
    assert done.exit_code == 1
    record = json.loads(done.stdout)
    assert record["status"] == "differs"
    assert {entry["status"] for entry in record["files"]} == {"ok"}
    first = record["requirements"][0]
    assert (first["recorded"], first["recomputed"]) == (0.01, pytest.approx(0.0498997, rel=1e-5))
    assert "0001: residual_vibration is recorded as 0.01" in done.stderr
    single = review(folder / WORST)
    assert single.status is DIFFERS


def verdict_of(name: str) -> Callable[[dict[str, Any]], None]:
    def change(found: dict[str, Any]) -> None:
        next(entry for entry in found["requirements"] if entry["id"] == name)["verdict"] = "fail"

    return change


def overall(found: dict[str, Any]) -> None:
    found["verdict"] = "fail"


def wider_limit(found: dict[str, Any]) -> None:
    found["requirements"][0].update(max=0.5, limit=0.5)


def narrower_scope(found: dict[str, Any]) -> None:
    found["requirements"][0].update(scope="nominal")


def dropped_requirement(found: dict[str, Any]) -> None:
    del found["requirements"][0]


def other_quantity(found: dict[str, Any]) -> None:
    found["requirements"][0].update(quantity="final_error", value=found["requirements"][1]["value"])


def dropped_run(found: dict[str, Any]) -> None:
    found["run_table"] = [row for row in found["run_table"] if row["run"] != "0001"]
    found["runs"].update(total=10, passed=10)


def miscounted(found: dict[str, Any]) -> None:
    found["runs"]["errors"] = 1


def other_sample(found: dict[str, Any]) -> None:
    found["run_table"][1]["parameters"]["stiffness"] = 0.71


def other_command(found: dict[str, Any]) -> None:
    found["command"]["segments"][0]["level"] = 0.5


def other_bracket(found: dict[str, Any]) -> None:
    found["bound"]["maneuver_time"]["lower"] = 7.6


def other_fmu(found: dict[str, Any]) -> None:
    found["plant"]["sha256"] = "0" * 64


def another_log(found: dict[str, Any]) -> None:
    found["run_table"][1]["log"] = "runs/0002.mcap"


@pytest.mark.parametrize(
    "change",
    [
        *(verdict_of("SLEW-001"), verdict_of("SLEW-003"), overall, wider_limit, narrower_scope, dropped_requirement, other_quantity),
        *map(slow, (dropped_run, miscounted, other_sample, other_command, other_bracket, another_log)),
    ],
    ids=lambda change: change.__qualname__.replace(".<locals>.change", ""),
)
def test_results_that_the_logs_do_not_bear_out_differ(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    rewrite(folder, change)
    done = review(folder)
    assert (done.status, bool(done.findings)) == (DIFFERS, True)


def test_the_hash_of_another_fmu_is_seen(folder: Path) -> None:
    rewrite(folder, other_fmu)
    assert review(folder).status in (DIFFERS, TAMPERED)


def test_one_runs_log_in_anothers_place_differs(folder: Path) -> None:
    """The nominal run's good log in place of the worst run's, with everything else told accordingly."""
    nominal = run_table(folder)["0000-nominal"]
    (folder / WORST).write_bytes((folder / "runs" / "0002.mcap").read_bytes())
    relog(folder, "0001", lambda log: log, {"quantities": run_table(folder)["0002"]["quantities"]})
    assert nominal["quantities"]
    done = review(folder)
    assert done.status is DIFFERS
    assert "0001: the log is about another run" in done.findings
    assert "0001: the log is about another sample" in done.findings


def test_a_softer_study_with_the_old_logs_differs(folder: Path) -> None:
    text = (folder / "study.toml").read_text().replace("max = 0.05", "max = 0.06")
    (folder / "study.toml").write_text(text)

    def softer(found: dict[str, Any]) -> None:
        found["requirements"][0].update(max=0.06, limit=0.06)
        found["study"]["sha256"] = sha256(folder / "study.toml")

    rewrite(folder, softer)
    done = review(folder)
    assert done.status is DIFFERS
    assert any("another study" in finding for finding in done.findings)


@pytest.mark.parametrize(
    ("topics", "status"), [(("/plant/output", "/plant/state"), DIFFERS), (("/plant/output",), TAMPERED), (("/linear/output",), DIFFERS)]
)
def test_signals_that_were_changed_do_not_give_the_recorded_values(folder: Path, topics: tuple[str, ...], status: ReviewStatus) -> None:
    def disturbed(log: RunLog) -> RunLog:
        signals = []
        for signal in log.signals:
            values = signal.values.copy()
            if signal.topic in topics:
                values[len(values) // 2] += 1.0
            signals.append(replace(signal, values=values))
        return replace(log, signals=tuple(signals))

    relog(folder, "0004", disturbed)
    assert review(folder).status is status


def test_a_log_judged_by_other_requirements_than_its_study_has_differs(verified: Path, tmp_path: Path) -> None:
    log = logs.read_log(verified / WORST)
    asked = json.loads(log.run["requirements"])
    for softer in (asked[1:], [{**asked[0], "maximum": 0.5}, *asked[1:]]):
        path = tmp_path / "0001.mcap"
        logs.write_log(path, replace(log, run={**log.run, "requirements": json.dumps(softer)}))
        assert review(path).status is DIFFERS


# Nonsense is no traceback

JUNK: list[Any] = [None, [], {}, "", 0, -1, 1e300, "nan", [[]], {"a": 1}, True]


def paths(value: Any, depth: int = 3) -> list[tuple[Any, ...]]:
    """Places in a JSON value, the first two items of lists only."""
    found: list[tuple[Any, ...]] = [()]
    items = list(value.items()) if isinstance(value, dict) else list(enumerate(value))[:2] if isinstance(value, list) else []
    for key, inner in items if depth else []:
        found += [(key, *rest) for rest in paths(inner, depth - 1)]
    return found


@pytest.mark.slow
def test_results_of_any_shape_are_reviewed_without_a_traceback(verified: Path, tmp_path: Path) -> None:
    """On a folder with one log, for speed; whatever stands in results.json, the manifest is right."""
    folder = tmp_path / "small"
    shutil.copytree(verified, folder, ignore=lambda where, names: [n for n in names if n.endswith(".mcap") and n != "0000-nominal.mcap"])
    whole = results(folder)
    whole["run_table"] = whole["run_table"][:1]
    places = paths(whole)
    seen = set()
    for i, place in enumerate(places):
        found = json.loads(json.dumps(whole))
        junk = JUNK[i % len(JUNK)]
        if place:
            inner = found
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = junk
        else:
            found = junk
        (folder / "results.json").write_bytes(json_bytes(found))
        close(folder)
        seen.add(review(folder).status)
    assert seen <= {DIFFERS, TAMPERED, INCOMPLETE}


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(places=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 255)), min_size=1, max_size=3, unique_by=lambda item: item[0]))
@example(places=[(0.0, 1)])
@example(places=[(1.0, 1)])
def test_a_damaged_log_is_never_confirmed(verified: Path, tmp_path: Path, places: list[tuple[float, int]]) -> None:
    content = bytearray((verified / WORST).read_bytes())
    original = bytes(content)
    for place, bits in places:
        content[int(place * (len(content) - 1))] ^= bits
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    done = review(damaged)
    assert (done.status is CONFIRMED) == (bytes(content) == original)


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000, b'{"run_table": []}', b"NaN"])
def test_results_that_are_no_results_are_tampering(folder: Path, content: bytes) -> None:
    (folder / "results.json").write_bytes(content)
    close(folder)
    assert review(folder).status is TAMPERED


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b'{"format": "slewcert-manifest/1", "files": [{"path": "../x"}]}'])
def test_a_manifest_that_is_none_is_tampering(folder: Path, content: bytes) -> None:
    (folder / "manifest.json").write_bytes(content)
    assert review(folder).status is TAMPERED


@pytest.mark.parametrize("content", [b"", b"\xff", b"[[requirement]]\nid = 1", b"requirement = 3", b"[[uncertainty]]\nrange = [1, 2]"])
def test_a_study_that_is_none_is_tampering_or_differs(folder: Path, content: bytes) -> None:
    (folder / "study.toml").write_bytes(content)
    close(folder)
    assert review(folder).status in (TAMPERED, DIFFERS)


@pytest.mark.parametrize("key", ["facts", "requirements", "nominal", "output", "parameters", "status", "study_sha256"])
@pytest.mark.parametrize("value", ["", "[]", "null", "{}", '{"modes": 3}'])
def test_a_log_with_nonsense_in_its_metadata_is_not_confirmed(verified: Path, tmp_path: Path, key: str, value: str) -> None:
    log = logs.read_log(verified / WORST)
    path = tmp_path / "0001.mcap"
    logs.write_log(path, replace(log, run={**log.run, key: value}))
    done = review(path)
    if key not in ("parameters", "status", "study_sha256"):  # nothing that a log by itself is judged by
        assert done.status in (TAMPERED, DIFFERS)


def test_a_file_of_another_kind_is_no_log(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("not a log")
    assert run(file).exit_code == 1
