"""The review: it confirms what is right, and sees what was changed, by accident or on purpose."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from marks import first, slow
from small_studies import digests, results, small_study
from tampering import close, flip, run

from reports.files import json_bytes
from suite.loading import load_study
from suite.review import ReviewStatus, agree, review
from suite.verdicts import Verdict
from suite.verification import verify

CONFIRMED, DIFFERS, TAMPERED, INCOMPLETE = ReviewStatus.CONFIRMED, ReviewStatus.DIFFERS, ReviewStatus.TAMPERED, ReviewStatus.INCOMPLETE
WORST = "runs/0001.mcap"


@pytest.fixture
def folder(verified: Path, tmp_path: Path) -> Path:
    """A copy to be tampered with."""
    return Path(shutil.copytree(verified, tmp_path / "out"))


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
    assert nominal["requirements"][2]["recomputed"] == pytest.approx(7.27113, rel=1e-5)


def test_a_copy_elsewhere_is_confirmed(folder: Path) -> None:
    assert review(folder).status is CONFIRMED


def test_a_task_without_a_command_is_confirmed_as_what_it_is(tmp_path: Path) -> None:
    """A force that only pushes never stops what it has moved: the task is impossible, and no run is made."""
    file = small_study(tmp_path)
    file.write_text(file.read_text().replace("[-1.0, 1.0]", "[0.0, 1.0]"))
    done = verify(load_study(file), tmp_path / "out")
    assert done.verdict is Verdict.FAIL
    assert done.results["runs"]["total"] == 0
    found = review(tmp_path / "out")
    assert (found.status, found.findings) == (CONFIRMED, ())


# A byte of any file

KINDS = [
    *("study.toml", "results.json", "certificate.json", "report.html", "junit.xml", "ledger.sqlite", "manifest.json"),
    *("plant/modelDescription.xml", "plant/twin.toml", "plant/hashes.json", "runs/layout.json", "runs/0000-nominal.mcap", WORST),
]


def test_every_kind_of_file_is_tried_here(verified: Path) -> None:
    rest = {path for path in digests(verified) if path not in KINDS}
    assert rest == {f"runs/{i:04d}.mcap" for i in range(2, 11)}


@pytest.mark.parametrize("place", [slow(0.0), 0.37, slow(1.0)])
@pytest.mark.parametrize("path", first(6, KINDS))
def test_a_flipped_bit_in_any_file_is_tampering(folder: Path, path: str, place: float) -> None:
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
