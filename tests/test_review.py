"""The review: it confirms what is right, and sees what was changed, by accident or on purpose."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from small_studies import digests, results, run_table

from reports import logs, manifest
from reports.files import json_bytes, sha256
from reports.records import RunLog
from suite.cli import main
from suite.review import ReviewStatus, agree, review

CONFIRMED, DIFFERS, TAMPERED, INCOMPLETE = ReviewStatus.CONFIRMED, ReviewStatus.DIFFERS, ReviewStatus.TAMPERED, ReviewStatus.INCOMPLETE
WORST = "runs/0001.mcap"


@pytest.fixture
def folder(verified: Path, tmp_path: Path) -> Path:
    """A copy to be tampered with."""
    return Path(shutil.copytree(verified, tmp_path / "out"))


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["review", *map(str, arguments)], catch_exceptions=False)


def flip(path: Path, place: float = 0.5) -> None:
    """One bit of the byte at this fraction of the file."""
    content = bytearray(path.read_bytes())
    content[int(place * (len(content) - 1))] ^= 1
    path.write_bytes(content)


def close(folder: Path) -> None:
    """Write the manifest anew, as somebody does who knows how."""
    extra = {name: value for name, value in manifest.read_manifest(folder).items() if name not in ("format", "files")}
    manifest.write_manifest(folder, extra)


def rewrite(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change the results, and the manifest with them."""
    found = results(folder)
    change(found)
    (folder / "results.json").write_bytes(json_bytes(found))
    close(folder)


def relog(folder: Path, name: str, change: Callable[[RunLog], RunLog], row: Mapping[str, Any] | None = None) -> None:
    """Change a log, its hash in the results (and what else `row` says of it there), and the manifest."""
    logs.write_log(folder / "runs" / f"{name}.mcap", change(logs.read_log(folder / "runs" / f"{name}.mcap")))

    def retell(found: dict[str, Any]) -> None:
        entry = next(entry for entry in found["run_table"] if entry["run"] == name)
        entry.update(row or {}, sha256=sha256(folder / "runs" / f"{name}.mcap"))

    rewrite(folder, retell)


# Right


def test_untouched_evidence_is_confirmed(verified: Path) -> None:
    before = digests(verified)
    done = review(verified)
    assert (done.status, done.findings) == (CONFIRMED, ())
    assert [row.id for row in done.rows] == [entry["id"] for entry in results(verified)["requirements"]]
    assert {row.verdict for row in done.rows} == {"pass"}
    assert all(row.recorded == row.recomputed for row in done.rows), "the same code on the same numbers"
    assert digests(verified) == before, "a review writes nothing"


def test_the_json_object_is_the_one_of_the_contract(verified: Path) -> None:
    done = run(verified, "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    record = json.loads(done.stdout)
    assert record.keys() == {"status", "requirements", "files"}
    assert record["status"] == "confirmed"
    assert [entry.keys() for entry in record["requirements"]] == [{"id", "recorded", "recomputed", "verdict"}] * 7
    assert record["requirements"][0]["recorded"] == results(verified)["requirements"][0]["value"]
    assert {entry["path"] for entry in record["files"]} == set(digests(verified)) - {"manifest.json"}
    assert {entry["status"] for entry in record["files"]} == {"ok"}


def test_the_table_for_people_names_every_requirement(verified: Path) -> None:
    done = run(verified)
    assert done.exit_code == 0
    assert "SLEW-007" in done.stdout
    assert "review: confirmed" in done.stdout


def test_a_single_log_is_reviewed_from_itself_alone(verified: Path, tmp_path: Path) -> None:
    alone = Path(shutil.copy(verified / WORST, tmp_path / "from a colleague.mcap"))
    done = run(alone, "--json")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert record["status"] == "confirmed"
    assert record["files"] == [{"path": alone.name, "status": "ok"}]
    identifiers = [entry["id"] for entry in record["requirements"]]
    assert identifiers == ["SLEW-001", "SLEW-002", "SLEW-005", "SLEW-006", "SLEW-007"], "those of nominal scope do not look at this run"
    nominal = json.loads(run(verified / "runs" / "0000-nominal.mcap", "--json").stdout)
    assert len(nominal["requirements"]) == 7
    assert nominal["requirements"][2]["recomputed"] == pytest.approx(7.66539, rel=1e-5)


def test_a_copy_elsewhere_is_confirmed(folder: Path) -> None:
    assert review(folder).status is CONFIRMED


# A byte of any file

KINDS = [
    *("study.toml", "results.json", "report.html", "junit.xml", "ledger.sqlite", "manifest.json"),
    *("plant/modelDescription.xml", "plant/twin.toml", "plant/hashes.json", "runs/layout.json", "runs/0000-nominal.mcap", WORST),
]


def test_every_kind_of_file_is_tried_here(verified: Path) -> None:
    rest = {path for path in digests(verified) if path not in KINDS and not path.startswith("certificate")}
    assert rest == {f"runs/{i:04d}.mcap" for i in range(2, 11)}


@pytest.mark.parametrize("path", KINDS)
def test_a_flipped_bit_in_any_file_is_tampering(folder: Path, path: str) -> None:
    for place in (0.0, 0.37, 1.0):
        before = (folder / path).read_bytes()
        flip(folder / path, place)
        done = run(folder, "--json")
        assert done.exit_code == 1
        record = json.loads(done.stdout)
        assert record["status"] == "tampered"
        changed = [entry["path"] for entry in record["files"] if entry["status"] != "ok"]
        if path != "manifest.json":  # which may tell of another file by mistake
            assert changed in ([path], []), "nothing else"
            assert path in done.stderr
        (folder / path).write_bytes(before)
    assert review(folder).status is CONFIRMED


@pytest.mark.parametrize("place", ["seed", "environment", "slewcert", "fmu_sha256"])
def test_what_the_manifest_itself_tells_is_compared_with_the_results(folder: Path, place: str) -> None:
    told = json.loads((folder / "manifest.json").read_bytes())
    told[place] = 7
    (folder / "manifest.json").write_bytes(json_bytes(told))
    assert review(folder).status is TAMPERED


@pytest.mark.parametrize("path", ["report.html", "runs/0003.mcap", "study.toml", "results.json", "ledger.sqlite"])
def test_a_file_that_is_gone_is_tampering(folder: Path, path: str) -> None:
    (folder / path).unlink()
    done = run(folder, "--json")
    assert done.exit_code == 1
    record = json.loads(done.stdout)
    assert record["status"] == "tampered"
    assert {"path": path, "status": "missing"} in record["files"]


def test_a_file_that_was_added_is_tampering(folder: Path) -> None:
    (folder / "runs" / "0011.mcap").write_bytes((folder / WORST).read_bytes())
    done = review(folder)
    assert done.status is TAMPERED
    assert ("runs/0011.mcap", "unlisted") in done.files


def test_a_link_to_the_right_bytes_is_tampering(folder: Path, tmp_path: Path) -> None:
    (folder / WORST).rename(tmp_path / "elsewhere.mcap")
    (folder / WORST).symlink_to(tmp_path / "elsewhere.mcap")
    assert review(folder).status is TAMPERED


# Incomplete


def test_without_a_manifest_evidence_is_incomplete(folder: Path, tmp_path: Path) -> None:
    (folder / "manifest.json").unlink()
    done = run(folder)
    assert done.exit_code == 3
    assert "manifest.json is missing" in done.stdout
    assert run(tmp_path).exit_code == 3, "so is a folder that never was evidence"


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_log_that_ends_early_is_incomplete(verified: Path, tmp_path: Path, share: float) -> None:
    content = (verified / WORST).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(share * len(content))])
    done = run(cut, "--json")
    assert done.exit_code == 3
    assert json.loads(done.stdout)["status"] == "incomplete"


def test_a_log_cut_short_is_tampering_if_the_manifest_had_the_whole(folder: Path) -> None:
    (folder / WORST).write_bytes((folder / WORST).read_bytes()[:10000])
    assert review(folder).status is TAMPERED
    close(folder)
    assert review(folder).status is INCOMPLETE, "where the manifest lists the part, a run is missing its end"


def test_nothing_there_is_bad_input(tmp_path: Path) -> None:
    done = run(tmp_path / "nothing")
    assert (done.exit_code, done.stdout) == (2, "")
    assert "nothing" in done.stderr


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
    assert (first["recorded"], first["recomputed"]) == (0.01, pytest.approx(0.04633, rel=1e-4))
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
        *(dropped_run, miscounted, other_sample, other_command, other_bracket, another_log),
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


# Numbers


@pytest.mark.parametrize(
    ("recorded", "recomputed", "equal"),
    [
        (1.0, 1.0 + 0.9e-9, True),
        (1.0, 1.0 + 1.1e-9, False),
        (0.0, 1e-16, True),
        (0.0, 1e-12, False),
        (float("inf"), float("inf"), True),
        (float("inf"), -float("inf"), False),
        (float("inf"), 1.0, False),
        (float("nan"), float("nan"), True),
        (float("nan"), 1.0, False),
    ],
)
def test_values_agree_to_nine_digits(recorded: float, recomputed: float, equal: bool) -> None:
    assert agree(recorded, recomputed) is equal
    assert agree(recomputed, recorded) is equal
