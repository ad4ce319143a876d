"""The shape of the project, as far as a machine can see it: who imports whom, who owns which name, what is said where."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from suite import checks

ROOT = Path(__file__).parents[1]
PACKAGES = ("relaxations", "fmus", "reports", "suite")
HEAVY = ("cvxpy", "clarabel", "scipy.optimize", "fmpy", "sksundae", "mcap", "matplotlib", "jinja2", "pydantic", "flint", "pint")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


@cache
def project_files() -> tuple[Path, ...]:
    """What git tracks or would track; a source archive, which has no git, is looked at as it lies."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not a git checkout: build products and sources cannot be told apart")
    return tuple(path for line in listed.stdout.split("\0") if line and (path := ROOT / line).is_file())


def text_of(path: Path) -> str:
    """The file's text; nothing for a file that is not text."""
    content = path.read_bytes()
    return "" if b"\0" in content else content.decode("utf-8", "replace")


def test_import_contracts_hold() -> None:
    done = subprocess.run([Path(sys.executable).with_name("lint-imports"), "--no-cache"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_checker_is_all_that_a_check_imports() -> None:
    """The lines of code that `check` prints are those of what an interpreter loads for it; and it loads nothing else but python-flint."""
    show = "import sys, flint; before = set(sys.modules); import relaxations.checking.claims; print(*{*sys.modules} - before)"
    loaded = subprocess.run([sys.executable, "-c", show], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    ours = {module for module in loaded if module.partition(".")[0] == "relaxations"} - {"relaxations", "relaxations.checking"}
    assert ours == {f"relaxations.checking.{module}" for module in checks.modules()}
    assert {module.partition(".")[0] for module in loaded} <= {*sys.stdlib_module_names, "relaxations"}
    assert {*checks.modules()} >= checks.EVERY_TASK


@pytest.mark.parametrize("package", PACKAGES)
def test_no_other_distribution_owns_our_import_names(package: str) -> None:
    """The names are generic: a distribution that brings `reports` along would silently replace ours, or be replaced."""
    owners = {owner.lower() for owner in packages_distributions().get(package, ())}
    assert owners <= {"slewcert"}, f"{package} also belongs to {sorted(owners - {'slewcert'})}"
    found = importlib.import_module(package).__file__
    assert found is not None
    assert Path(found).parent == ROOT / package, "another package of this name comes first on the path"


def test_the_command_line_starts_without_the_heavy_modules() -> None:
    script = f"import sys, suite.cli; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]", "import these where they are used"


def test_a_command_starts_without_what_it_does_not_need() -> None:
    """`bound` and `shaper` draw, integrate and run nothing: what does would be most of their time."""
    uses = "suite.console, suite.collection, suite.console_shapers, suite.shaper_files, suite.shaping"
    needless = ("matplotlib", "scipy.integrate", "scipy.interpolate", "scipy.signal", "scipy.stats", "sksundae", "jinja2", "suite.campaign")
    script = f"import sys, {uses}; print([m for m in {needless!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]", "import these where they are used"


def test_every_module_says_what_it_is_for() -> None:
    silent = []
    for path in MODULES:
        tree = ast.parse(path.read_text())
        public = [node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")]
        silent += [f"{name(path)}: {getattr(node, 'name', 'the module')}" for node in (tree, *public) if not ast.get_docstring(node)]
    assert silent == []


def test_no_file_is_too_long_to_be_read_at_once() -> None:
    files = {*MODULES, *(ROOT / "tests").glob("**/[!.]*.py")} - set((ROOT / "tests/foreign/node_modules").rglob("*"))
    assert [name(path) for path in sorted(files) if len(path.read_text().splitlines()) > 400] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_must_never_reach_a_public_index() -> None:
    assert "Private :: Do Not Upload" in project()["project"]["classifiers"]


@pytest.mark.parametrize("path", [*ROOT.glob("*.lock"), ROOT / "tests/foreign/package-lock.json"], ids=name)
def test_locks_hold_names_versions_and_hashes_only(path: Path) -> None:
    text = path.read_text()
    assert "://" not in text
    assert not re.search(r"(?m)^\s*(-i|--index-url|--extra-index-url|-f|--find-links|--trusted-host)\b", text)
    if path.suffix == ".lock":
        pins = re.split(r"(?m)^(?=\S)", re.sub(r"(?m)^\s*#.*\n?", "", text))
        for pin in filter(str.strip, pins):
            assert re.match(r"[a-z0-9._-]+==\S+ ", pin), pin
            assert "--hash=sha256:" in pin, pin


def test_locks_name_every_dependency() -> None:
    def plain(requirement: str) -> str:
        return re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0].lower()

    table = project()["project"]
    extras = table["optional-dependencies"]
    locked = {
        file: {plain(line) for line in (ROOT / file).read_text().splitlines()}
        for file in ("requirements.lock", "requirements-compiler.lock")
    }
    assert {plain(line) for line in (*table["dependencies"], *extras["dev"])} <= locked["requirements.lock"]
    assert {plain(line) for line in extras["compiler"]} <= locked["requirements-compiler.lock"]
    assert "torch" not in locked["requirements.lock"]


def test_no_file_names_a_place_on_one_machine() -> None:
    """Absolute paths of the machine on which something was made do not exist elsewhere."""
    places = re.compile(r"(?<![\w.$}~/-])(/home/|/root/|/Users/|/work/|/tmp/|/var/folders/|[A-Z]:\\Users)(?!/)")
    found = [
        f"{name(path)}:{number}: {line.strip()[:100]}"
        for path in project_files()
        if path != Path(__file__)
        for number, line in enumerate(text_of(path).splitlines(), 1)
        if places.search(line)
    ]
    assert found == []
