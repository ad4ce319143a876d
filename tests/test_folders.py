"""What may become of the folder that evidence is written to: nothing that is not ours is ever touched."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from small_studies import SHIPPED, digests, run_table, small_study

from suite.cli import main
from suite.folders import FolderError
from suite.loading import load_study
from suite.review import ReviewStatus, review
from suite.verification import verify


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)


@pytest.fixture
def begun(verified: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(verified, tmp_path / "out"))


def test_an_existing_folder_is_left_as_it_is(begun: Path) -> None:
    before = digests(begun)
    done = run("verify", SHIPPED / "two_mass.toml", "--out", begun)
    assert (done.exit_code, done.stdout) == (2, "")
    assert "--resume" in done.stderr
    assert "--force" in done.stderr
    assert digests(begun) == before


def test_force_replaces_it(begun: Path, tmp_path: Path) -> None:
    done = run("verify", small_study(tmp_path, samples=0), "--out", begun, "--force")
    assert done.exit_code == 0
    assert list(run_table(begun)) == ["0000-nominal"]
    assert review(begun).status is ReviewStatus.CONFIRMED, "nothing of the former campaign is left"


def test_resume_of_another_study_is_refused(begun: Path, tmp_path: Path) -> None:
    before = digests(begun)
    done = run("verify", small_study(tmp_path, samples=0), "--out", begun, "--resume")
    assert done.exit_code == 2
    assert "another study" in done.stderr
    assert digests(begun) == before


def precious(folder: Path) -> None:
    (folder / "precious.txt").write_text("irreplaceable")


def project(folder: Path) -> None:
    """What people have in a project's folder: names that evidence has, too."""
    (folder / "study.toml").write_text('title = "mine"')
    (folder / "manifest.json").write_text('{"name": "a web application"}')
    (folder / "runs").mkdir()
    (folder / "runs" / "0001.mcap").write_bytes(b"a recording of theirs")


@pytest.mark.parametrize("option", ["--force", "--resume"])
@pytest.mark.parametrize("fill", [precious, project])
def test_a_foreign_folder_is_never_touched(tmp_path: Path, fill: Callable[[Path], None], option: str) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    fill(folder)
    before = digests(folder)
    done = run("verify", small_study(tmp_path, samples=0), "--out", folder, option)
    assert done.exit_code == 2
    assert "no evidence of ours" in done.stderr
    assert digests(folder) == before


@pytest.mark.parametrize("place", ["notes.txt", "runs/extra/0001.mcap", "plant/model.fmu"])
def test_what_somebody_put_into_evidence_is_not_deleted(begun: Path, place: str) -> None:
    path = begun / place
    path.parent.mkdir(exist_ok=True)
    path.write_text("irreplaceable")
    before = digests(begun)
    done = run("verify", SHIPPED / "two_mass.toml", "--out", begun, "--force")
    assert done.exit_code == 2
    assert place in done.stderr
    assert digests(begun) == before


def test_the_studys_own_folder_can_not_be_the_evidences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = small_study(tmp_path, samples=0)
    precious(tmp_path)
    monkeypatch.chdir(tmp_path)
    for options in ((), ("--force",), ("--resume",)):
        assert run("verify", "study.toml", "--out", ".", *options).exit_code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["precious.txt", file.name]


def test_evidence_may_be_replaced_from_within_and_by_its_own_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    verify(load_study(small_study(tmp_path, samples=0)), tmp_path / "out")
    monkeypatch.chdir(tmp_path / "out")
    assert run("verify", "study.toml", "--out", ".", "--force").exit_code == 0
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED


@pytest.mark.slow
def test_a_link_is_followed_to_the_folder_and_its_target_stays(tmp_path: Path) -> None:
    verify(load_study(small_study(tmp_path, samples=0)), tmp_path / "out")
    (tmp_path / "link").symlink_to(tmp_path / "out")
    verify(load_study(small_study(tmp_path, samples=2)), tmp_path / "link", force=True)
    assert (tmp_path / "link").is_symlink()
    assert len(run_table(tmp_path / "out")) == 3


def test_the_folder_is_refused_before_anything_is_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from suite import verification

    (tmp_path / "out").mkdir()
    precious(tmp_path / "out")
    monkeypatch.setattr(verification, "design", lambda study: pytest.fail("the design takes its time"))
    with pytest.raises(FolderError):
        verify(load_study(small_study(tmp_path, samples=0)), tmp_path / "out", force=True)


@pytest.mark.parametrize("out", ["a file", "a file/sub"])
def test_a_file_in_the_way_is_refused(tmp_path: Path, out: str) -> None:
    (tmp_path / "a file").write_text("irreplaceable")
    done = run("verify", small_study(tmp_path, samples=0), "--out", tmp_path / out, "--force")
    assert done.exit_code == 2
    assert "a file" in done.stderr
    assert (tmp_path / "a file").read_text() == "irreplaceable"


def test_missing_parents_are_made_and_names_may_be_anything(tmp_path: Path) -> None:
    home = tmp_path / "Ünïcode and spaces 日本"
    home.mkdir()
    file = small_study(home, samples=0, name="meine Stüdie.toml")
    done = run("verify", file, "--out", home / "a" / "b c", "--json")
    assert done.exit_code == 0
    folder = Path(json.loads(done.stdout)["evidence"])
    assert folder == home / "a" / "b c"
    assert run("review", folder).exit_code == 0
