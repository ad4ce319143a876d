"""Mutation testing of the checker: `make mutants`, or `python tests/mutants.py [FOLDER]`, some twenty minutes on two cores.

Everything is copied into a folder of its own, the certificates that the tests ask for are made there first (by the checker as it is: a
mutant must not hinder their making), then mutmut changes the checker's copy in every way that it knows and runs the tests of the checker.
Survivors are printed as docs/checker-mutations.md lists them; the exit code says whether that document argues all of them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
ARGUED = ROOT / "docs" / "checker-mutations.md"
HELPERS = ("forgery", "independent", "problems", "random_maneuvers")
SETTINGS = """
[tool.pytest]
testpaths = ["tests"]
pythonpath = ["tests"]
addopts = ["-m", "not slow", "-x", "-q"]
markers = ["slow: left out here"]

[tool.mutmut]
source_paths = ["relaxations/checking"]
do_not_mutate = ["*/boxes.py", "*/durations.py", "*/worst.py"]
also_copy = ["relaxations", "fmus", "reports", "suite", "tests"]
"""
RECORD = """
import forgery
for names, make, prefix in ((forgery.BY_NAME, forgery.proven, ""), (forgery.TAILS, forgery.proven_tail, "tail_")):
    for name in names:
        (forgery.RECORDED / f"{prefix}{name}.json").write_bytes(make(name))
"""


def prepare(folder: Path) -> None:
    """The sources, the checker's tests and their certificates."""
    tests, unneeded = folder / "tests", shutil.ignore_patterns("__pycache__")
    for package in ("relaxations", "fmus", "reports", "suite"):
        shutil.copytree(ROOT / package, folder / package, ignore=unneeded)
    (tests / "recorded").mkdir(parents=True)
    for file in [*(ROOT / "tests").glob("test_checking*.py"), *(ROOT / "tests" / f"{name}.py" for name in HELPERS)]:
        shutil.copy(file, tests)
    (folder / "pyproject.toml").write_text(SETTINGS)
    subprocess.run([sys.executable, "-c", RECORD], cwd=tests, env={"PYTHONPATH": f"{folder}:{tests}"}, check=True)


def mutmut(folder: Path, *words: str) -> str:
    """What mutmut prints; it sees to the path of imports itself."""
    program, surroundings = Path(sys.executable).with_name("mutmut"), {**os.environ, "PYTHONPATH": ""}
    return subprocess.run([program, *words], cwd=folder, env=surroundings, stdout=subprocess.PIPE, text=True, check=True).stdout


def survivors(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Function, line before and line after of each mutant that no test notices."""
    for name in re.findall(r"(?m)^\s*(\S+): (?:survived|no tests|suspicious)", mutmut(folder, "results")):
        lines = [line for line in mutmut(folder, "show", name).splitlines() if re.match(r"[-+](?![-+])", line)]
        before, after = (" ".join(line[1:].strip() for line in lines if line[0] == sign) for sign in "-+")
        function = re.sub(r"relaxations\.checking\.|x_(?=\w+__)|xǁ|__mutmut_\d+", "", name).replace("ǁ", ".")
        yield function, before, after


def main(folder: Path) -> int:
    prepare(folder)
    print(mutmut(folder, "run", "--max-children", "2").splitlines()[-1])
    for function, before, after in survivors(folder):
        print(f"{function}: {before} → {after}")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="mutants"))))
