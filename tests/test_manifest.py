"""The manifest: nothing can be missing, changed or added unnoticed, and a hostile manifest does not lead out of its folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from reports.errors import ManifestError
from reports.manifest import FileState, check_manifest, read_manifest, write_manifest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    evidence = tmp_path / "evidence"
    (evidence / "runs").mkdir(parents=True)
    (evidence / "results.json").write_text("{}\n")
    (evidence / "runs" / "0000-nominal.mcap").write_bytes(b"\x89MCAP0\r\n")
    write_manifest(evidence, {"version": "0.1.0", "seed": 0})
    return evidence


def states(folder: Path) -> dict[str, str]:
    return {s.path: str(s.status) for s in check_manifest(folder)}


def test_an_untouched_folder(folder: Path) -> None:
    assert states(folder) == {"results.json": "ok", "runs/0000-nominal.mcap": "ok"}
    manifest = read_manifest(folder)
    assert (manifest["format"], manifest["version"], manifest["seed"]) == ("slewcert-manifest/1", "0.1.0", 0)
    # SHA-256 of "{}\n", from sha256sum
    entry = {"path": "results.json", "sha256": "ca3d163bab055381827226140568f3bef7eaac187cebd76878e0b63e9e442356", "size": 3}
    assert manifest["files"][0] == entry  # type: ignore[index]


def test_missing_changed_and_added_files(folder: Path) -> None:
    (folder / "results.json").write_text("[]\n")  # as long as before
    (folder / "runs" / "0000-nominal.mcap").unlink()
    (folder / "plant").mkdir()
    (folder / "plant" / "extra.xml").write_text("")
    assert states(folder) == {"plant/extra.xml": "unlisted", "results.json": "changed", "runs/0000-nominal.mcap": "missing"}
    assert [s.status for s in check_manifest(folder)] == [FileState.UNLISTED, FileState.CHANGED, FileState.MISSING]


def test_writing_again_gives_the_same_bytes(folder: Path) -> None:
    before = (folder / "manifest.json").read_bytes()
    write_manifest(folder, {"version": "0.1.0", "seed": 0})
    assert (folder / "manifest.json").read_bytes() == before


def test_the_attestation_lies_outside(folder: Path) -> None:
    (folder / "attestation.json").write_text("{}")
    assert "attestation.json" not in states(folder)


def test_links_are_no_evidence(folder: Path) -> None:
    target = folder.parent / "elsewhere.json"
    target.write_text("{}\n")
    (folder / "results.json").unlink()
    (folder / "results.json").symlink_to(target)
    (folder / "more").symlink_to(folder.parent, target_is_directory=True)
    assert states(folder) == {"more": "unlisted", "results.json": "changed", "runs/0000-nominal.mcap": "ok"}
    with pytest.raises(ManifestError, match="link"):
        write_manifest(folder, {})


@pytest.mark.parametrize("path", ["../secret", "/etc/hostname", "runs/../../secret", "a//b", "./a", "", ".", "a\\b"])
def test_paths_stay_inside(folder: Path, path: str) -> None:
    manifest = {"format": "slewcert-manifest/1", "files": [{"path": path, "sha256": "0" * 64, "size": 0}]}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ManifestError, match="within the folder"):
        check_manifest(folder)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        ("[]", "this one has 'list'"),
        ('{"format": "slewcert-manifest/9", "files": []}', "slewcert-manifest/9"),
        ('{"format": "slewcert-manifest/1", "files": [], "files": []}', "twice"),
        ('{"format": "slewcert-manifest/1"}', "list of files"),
        ('{"format": "slewcert-manifest/1", "files": [{"path": "a"}]}', "its sha256"),
    ],
)
def test_malformed_manifests(folder: Path, text: str, complaint: str) -> None:
    (folder / "manifest.json").write_text(text)
    with pytest.raises(ManifestError, match=complaint):
        check_manifest(folder)


def test_no_manifest_and_taken_names(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="missing"):
        check_manifest(tmp_path)
    with pytest.raises(ManifestError, match="files"):
        write_manifest(tmp_path, {"files": []})
