"""Mutation testing of the checker: `make mutants`, or `python tests/mutants.py [FOLDER [FUNCTION …]]`, an hour on two cores.

Everything is copied into a folder of its own, the certificates that the tests ask for are made there first (by the checker as it is: a
mutant must not hinder their making), then mutmut changes the checker's copy in every way that it knows and runs the tests of the checker,
but for a few that take seconds. FUNCTION (lower.prove, balls.Root.ramp, balls.*) runs those alone; `python tests/mutants.py --of FOLDER …`
runs nothing and tells what runs in these folders have found together, later ones counting.

Survivors that change nothing that matters, by `CLASSES`, are counted; the others are printed as docs/checker-mutations.md lists them, and
the exit code says whether that document argues all of them, and whether none is left to be run.
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
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from difflib import ndiff
from pathlib import Path

ROOT = Path(__file__).parents[1]
ARGUED = ROOT / "docs" / "checker-mutations.md"
HELPERS = (
    "conftest",
    "corruption",
    "forgery",
    "independent",
    "independent_limits",
    "problems",
    "proving",
    "random_maneuvers",
    "varying_plants",
)
CHECKER = Path("relaxations", "checking")
LENGTHY = ("many segments", "many contacts", "many segments and poles", "too many segments", "many names", "many oscillations")
SOLVING = ("test_checking_corruption_boxes.py",)
"""What solves tasks of its own; the parts of the checker that only these are about are not mutated."""
LEFT_OUT = [
    *(f"test_checking_corruption.py::test_tampered_certificates_{of}are_never_believed" for of in ("", "of_further_limits_")),
    "test_checking_hostile.py::test_the_checker_stands_alone",
    *(f"test_checking_hostile.py::test_a_hostile_certificate_is_given_up[{name}]" for name in LENGTHY),
]
"""What takes seconds for each of the mutants that nothing else notices."""
UNNOTICED = (0, 33, 34, 35)  # survived, no tests, skipped, suspicious
CLASSES = {
    "what a message says": (r'f?"[^"]*"|, \)', "None"),
    "how much work is counted": (r"spend\(.*\)$", "spend()"),
    "how often something is tried, or how long it may be": (r"[<>]=? (MOST|LARGEST|LONGEST)_\w+|range\(10[01]\)", "…"),
    "whether lists are as long as each other, which they are": (r", (strict=\w+)?\)", ")"),
    "how a sum's start is written": (r", ((a[rc]b|fmpq)\((0|None)?\))?\)", ")"),
    "how 0 is written": (r"\b(a[rc]b)\(None\b", r"\1(0"),
    "whether balls that are equal count as less": (r"([<>])=", r"\1"),
}
"""What a mutant changes where its line is the same as before but for such a pattern."""
BALLS = (
    *("balls.on_axis", "balls.stable", "courses.recedes", "courses.within", "lower.impossible", "lower.prove", "lower.support"),
    *("costs.least", "members.lands", "spent.by_costate", "spent.lasting", "upper.inside", "upper.settled"),
)
"""Where the last class is of balls: two compare as equal only where both are exact and the same."""
SEARCHES = ("balls.long", "balls.spend", "upper.far")
"""What begins searches, and ends them; what they find is proven by others."""
SETTINGS = """
[tool.pytest]
testpaths = ["tests"]
pythonpath = ["tests"]
addopts = ["-m", "not slow", "-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-p", "no:xdist", DESELECTED]
markers = ["slow: left out here"]

[tool.mutmut]
source_paths = ["relaxations/checking"]
do_not_mutate = [
    "*/boxes.py", "*/families.py", "*/motions.py", "*/excursions.py", "*/durations.py", "*/worst.py",
    "*/*deflections.py", "*/pulse_widths.py", "*/varying_boxes.py",
]
also_copy = ["relaxations", "fmus", "reports", "suite", "tests"]
"""
RECORD = """
import forgery as of
import test_checking_costs
import varying_plants
(of.RECORDED / "cost.json").write_bytes(test_checking_costs.original())
for name in varying_plants.CERTIFIED:
    (of.RECORDED / f"varying_{name}.json").write_bytes(varying_plants.certified(name))
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


def verdicts(folder: Path) -> dict[str, int | None]:
    """What has become of every mutant in a folder; None: it was not run."""
    files = sorted((folder / "mutants" / CHECKER).glob("*.meta"))
    return {key: code for meta in files for key, code in json.loads(meta.read_text())["exit_code_by_key"].items()}


def survivors(folder: Path, keys: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """Function, line before and line after of mutants."""
    variants: dict[str, dict[str, list[str]]] = {}
    for key in keys:
        module, name = key.split(".")[-2:]
        if module not in variants:
            variants[module] = bodies((folder / "mutants" / CHECKER / f"{module}.py").read_text())
        before, after = variants[module][re.sub(r"\d+$", "orig", name)], variants[module][name]
        changes = [line for line in ndiff(before, after) if line[:2] in ("- ", "+ ")]
        before, after = (" ".join(line[2:] for line in changes if line[0] == sign) for sign in "-+")
        yield f"{module}.{re.sub(r'^xǁ|^x_|__mutmut_.*$', '', name).replace('ǁ', '.')}", before, after


def kind(function: str, before: str, after: str) -> str | None:
    """The class of a mutant, if it is of one."""
    if function in SEARCHES:
        return "where a search begins, and when it is given up"
    for name, (pattern, instead) in CLASSES.items():
        if re.sub(pattern, instead, before) == re.sub(pattern, instead, after) and (pattern != r"([<>])=" or function in BALLS):
            return name
    return None


def told(folders: Sequence[Path], every: bool) -> int:
    """Print what has become of the mutants, by the last folder that ran each; `every` one has to be run."""
    found = {key: (code, folders[0]) for key, code in verdicts(folders[0]).items()}
    for folder in folders[1:]:
        found |= {key: (code, folder) for key, code in verdicts(folder).items() if code is not None}
    alive = [key for key, (code, _) in found.items() if code in UNNOTICED]
    print("| part | mutants | run | noticed | not |", "|:--|--:|--:|--:|--:|", sep="\n")
    for part in (*sorted({key.split(".")[-2] for key in found}), ""):
        own = [code for key, (code, _) in found.items() if part in ("", key.split(".")[-2])]
        run = [code for code in own if code is not None]
        print(
            f"| {part or 'all'} | {len(own)} | {len(run)} | {sum(c not in UNNOTICED for c in run)} | {sum(c in UNNOTICED for c in run)} |"
        )
    open_ = sum(code is None for code, _ in found.values())
    lines, counts, argued = [], Counter[str](), ARGUED.read_text()
    for folder in folders:
        for function, before, after in survivors(folder, [key for key in alive if found[key][1] == folder]):
            if name := kind(function, before, after):
                counts[name] += 1
            else:
                lines.append(f"{function}: {before} → {after}")
    print(*(f"{count:4} change {name}" for name, count in counts.most_common()), sep="\n")
    unknown = [line for line in lines if line not in argued]
    print(f"{len(lines) - len(unknown):4} others are argued in {ARGUED.name}; {len(unknown)} are not:", *unknown, sep="\n")
    return bool(unknown or (every and open_))


def main(words: list[str]) -> int:
    if words[:1] == ["--of"]:
        return told([Path(word) for word in words[1:]], True)
    folder = Path(words[0] if words else tempfile.mkdtemp(prefix="mutants"))
    prepare(folder)
    print(mutmut(folder, "run", "--max-children", "2", *map(mutated, words[1:])).splitlines()[-1])
    return told([folder], not words[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
