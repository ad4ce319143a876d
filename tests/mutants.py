"""Mutation testing of the checker: `make mutants`, or `python tests/mutants.py [FOLDER [FUNCTION …]]`, an hour on two cores.

Everything is copied into a folder of its own, the certificates that the tests ask for are made there first (by the checker as it is: a
mutant must not hinder their making), then mutmut changes the checker's copy in every way that it knows and runs the tests of the checker,
but for a few that take seconds. Mutants of messages alone are counted; the other survivors are printed as docs/checker-mutations.md lists
them, and the exit code says whether that document argues all of them. FUNCTION (lower.prove, balls.Root.ramp, balls.*) runs those alone.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from difflib import ndiff
from pathlib import Path

ROOT = Path(__file__).parents[1]
ARGUED = ROOT / "docs" / "checker-mutations.md"
HELPERS = ("corruption", "forgery", "independent", "independent_limits", "problems", "random_maneuvers")
CHECKER = Path("relaxations", "checking")
LENGTHY = ("many segments", "many contacts", "many segments and poles", "too many segments", "many names", "many oscillations")
SOLVING = ("test_checking_corruption_boxes.py", "test_checking_varying.py")
"""What solves tasks of its own; the parts of the checker that only these are about are not mutated."""
LEFT_OUT = [
    *(f"test_checking_corruption.py::test_tampered_certificates_{of}are_never_believed" for of in ("", "of_further_limits_")),
    "test_checking_hostile.py::test_the_checker_stands_alone",
    *(f"test_checking_hostile.py::test_a_hostile_certificate_is_given_up[{name}]" for name in LENGTHY),
]
"""What takes seconds for each of the mutants that nothing else notices."""
UNNOTICED = (0, 33, 34, 35)  # survived, no tests, skipped, suspicious
SETTINGS = """
[tool.pytest]
testpaths = ["tests"]
pythonpath = ["tests"]
addopts = ["-m", "not slow", "-x", "-q", DESELECTED]
markers = ["slow: left out here"]

[tool.mutmut]
source_paths = ["relaxations/checking"]
do_not_mutate = [
    "*/boxes.py", "*/families.py", "*/motions.py", "*/excursions.py", "*/varying.py", "*/durations.py", "*/worst.py",
    "*/*deflections.py", "*/pulse_widths.py",
]
also_copy = ["relaxations", "fmus", "reports", "suite", "tests"]
"""
RECORD = """
import forgery as of
for names, make, prefix in ((of.BY_NAME, of.proven, ""), (of.TAILS, of.proven_tail, "tail_"), (of.LIMITED, of.proven_limited, "limited_")):
    for name in names:
        (of.RECORDED / f"{prefix}{name}.json").write_bytes(make(name))
"""


def prepare(folder: Path) -> None:
    """The sources, the checker's tests and their certificates."""
    tests, unneeded = folder / "tests", shutil.ignore_patterns("__pycache__")
    for package in ("relaxations", "fmus", "reports", "suite"):
        shutil.copytree(ROOT / package, folder / package, ignore=unneeded)
    (tests / "recorded").mkdir(parents=True)
    for file in [*(ROOT / "tests").glob("test_checking*.py"), *(ROOT / "tests" / f"{name}.py" for name in HELPERS)]:
        if file.name not in SOLVING:
            shutil.copy(file, tests)
    left_out = ", ".join(f'"--deselect=tests/{name}"' for name in LEFT_OUT)
    (folder / "pyproject.toml").write_text(SETTINGS.replace("DESELECTED", left_out))
    subprocess.run([sys.executable, "-c", RECORD], cwd=tests, env={"PYTHONPATH": f"{folder}:{tests}"}, check=True)


def mutmut(folder: Path, *words: str) -> str:
    """What mutmut prints; it sees to the path of imports itself."""
    program, surroundings = Path(sys.executable).with_name("mutmut"), {**os.environ, "PYTHONPATH": ""}
    return subprocess.run([program, *words], cwd=folder, env=surroundings, stdout=subprocess.PIPE, text=True, check=True).stdout


def bodies(source: str) -> dict[str, list[str]]:
    """The lines of every variant of every function in a file of mutants, by the variant's name."""
    lines, functions = source.splitlines(), (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef))
    return {node.name: [line.strip() for line in lines[node.lineno : node.end_lineno]] for node in functions if "__mutmut_" in node.name}


def mutated(function: str) -> str:
    """mutmut's pattern for a function of the checker."""
    module, *names = function.split(".")
    name = names[-1] if len(names) == 1 else "ǁ".join(("", *names))
    return f"relaxations.checking.{module}.x{'' if len(names) > 1 else '_'}{name}*" if name != "*" else f"relaxations.checking.{module}.*"


def survivors(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Function, line before and line after of each mutant that no test notices."""
    for meta in sorted((folder / "mutants" / CHECKER).glob("*.meta")):
        variants = bodies(meta.with_suffix("").read_text())
        for key, code in json.loads(meta.read_text())["exit_code_by_key"].items():
            if code not in UNNOTICED:
                continue
            module, name = key.split(".")[-2:]
            changes = [line for line in ndiff(variants[re.sub(r"\d+$", "orig", name)], variants[name]) if line[:2] in ("- ", "+ ")]
            before, after = (" ".join(line[2:] for line in changes if line[0] == sign) for sign in "-+")
            yield f"{module}.{re.sub(r'^xǁ|^x_|__mutmut_.*$', '', name).replace('ǁ', '.')}", before, after


def wordless(line: str) -> str:
    """A line without what its strings say."""
    return re.sub(r'f?"[^"]*"', "None", line)


def main(folder: Path, functions: list[str]) -> int:
    prepare(folder)
    print(mutmut(folder, "run", "--max-children", "2", *map(mutated, functions)).splitlines()[-1])
    found, argued = list(survivors(folder)), ARGUED.read_text()
    lines = [f"{function}: {before} → {after}" for function, before, after in found if wordless(before) != wordless(after)]
    print(f"{len(found) - len(lines)} survivors change what a message says and nothing else; not argued in {ARGUED.name}:")
    unknown = [line for line in lines if line not in argued]
    print(*unknown or ["none"], sep="\n")
    return bool(unknown)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="mutants")), sys.argv[2:]))
