"""`slewcert check`: certificates and evidence folders, verified by a checker that shares nothing with the solver."""

from __future__ import annotations

import ast
import importlib.metadata
import platform
import tokenize
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from relaxations import checking
from relaxations.checking.claims import Check, Outcome, check, claim

CERTIFICATE = "certificate.json"
COST = "certificate.cost.json"
"""Of fuel weighed against time, where the study has a price of it."""
LEAST_FUEL = "certificate.least-fuel.json"
"""Of the most fuel that is too little, where the study's budget is."""
ON_GRID = "certificate.grid.json"
"""Of the commands that an FMU with one step size can follow, where the study speaks of all commands."""
EXIT = {Outcome.PROVED: 0, Outcome.REFUTED: 1, Outcome.MALFORMED: 2, Outcome.INCONCLUSIVE: 3}
CODE = {tokenize.NAME, tokenize.NUMBER, tokenize.STRING, tokenize.OP}
EVERY_TASK = {"balls", "claims", "lower", "reading", "upper"}
"""The checker's modules that every certificate goes through; what else it imports serves tasks of one kind."""
ORDER = (2, 1, 3, 0)
"""Exit codes from worst to best."""


@dataclass(frozen=True, slots=True)
class Checked:
    """One file: what the checker says, and whether it is about a study ("matches", "differs", or None if none was named; `why` not)."""

    path: Path
    check: Check
    study: str | None = None
    why: str = ""

    @property
    def exit_code(self) -> int:
        """By docs/schemas.md: a true claim about another study counts as refuted."""
        return 1 if self.check.outcome is Outcome.PROVED and self.study == "differs" else EXIT[self.check.outcome]

    def to_dict(self) -> dict[str, Any]:
        """The object of `check --json`."""
        record = self.check.to_dict()
        if self.study is not None:
            record["study"] = self.study
        return record

    def lines(self) -> list[str]:
        """For people: the claim, what it rests on, the outcome."""
        found = self.check
        lines = [f"{self.path}", *claim(found).splitlines()]
        versions = f"python-flint {importlib.metadata.version('python-flint')}, CPython {platform.python_version()}"
        lines.append(f"Trust base: {versions}, {trusted()} in the checker.")
        if self.study is not None:
            lines.append(f"Study: {self.study}" + (f" ({self.why})" if self.why else ""))
        reason = f": {found.reason}" if found.reason else ""
        at = f" at {found.bits} bits" if found.bits else ""
        return [*lines, f"{found.outcome.value.upper()}{reason} ({found.seconds:.3f} s{at})"]


def modules(start: str = "claims") -> tuple[str, ...]:
    """The checker's modules that a check imports, by the import statements in their sources: `start`, and what these name in turn."""
    folder, found, waiting = Path(checking.__file__).parent, [], [start]
    while waiting:
        module = waiting.pop()
        if module in found or not (folder / f"{module}.py").is_file():
            continue
        found.append(module)
        for node in ast.walk(ast.parse((folder / f"{module}.py").read_bytes())):
            if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(f"{checking.__name__}."):
                below = str(node.module).removeprefix(checking.__name__).removeprefix(".")
                waiting += [below] if below else [name.name for name in node.names]
    return tuple(sorted(found))


def sizes() -> dict[str, int]:
    """Lines of code of each module that `slewcert check` imports. Comments, docstrings and blank lines are no code."""
    found = {}
    for module in modules():
        with tokenize.open(Path(checking.__file__).with_name(f"{module}.py")) as file:
            code = [token for token in tokenize.generate_tokens(file.readline) if token.type in CODE and token.line.strip()[:3] != '"""']
        found[module] = len({line for token in code for line in range(token.start[0], token.end[0] + 1)})
    return found


@cache
def trusted() -> str:
    """What a reader has to trust: lines of code in all, and those that only tasks of one kind need; counted once, for it takes a while."""
    lines = sizes()
    special = ", ".join(f"{count} for {module}" for module, count in lines.items() if module not in EVERY_TASK)
    return f"{sum(lines.values())} lines of code" + (f" ({special})" if special else "")


def check_path(path: Path, study: Path | None = None) -> Checked:
    """Check a certificate, or the one of an evidence folder (which is then compared with the folder's own study).

    Raises `OSError` for a file that cannot be read, `StudyError` for a study that cannot.
    """
    if path.is_dir():
        file, asked = path / CERTIFICATE, study or path / "study.toml"
    else:
        file, asked = path, study
    found = check(file.read_bytes())
    if asked is None or found.certificate is None:
        return Checked(file, found)
    why = _difference(found, asked, path if path.is_dir() else None)
    return Checked(file, found, "differs" if why else "matches", why)


def _difference(found: Check, study: Path, folder: Path | None) -> str:
    """What the certificate's task has that the study's has not, in words; empty if they are the same."""
    from relaxations.certificates import task
    from suite.design import pose
    from suite.loading import load_study
    from suite.plants import nominal_plant

    asked = load_study(study)
    expected = task(pose(asked, nominal_plant(asked)))
    assert found.certificate is not None
    written = found.certificate.written["task"]
    other = [name for name in expected if expected[name] != written.get(name)]
    price = found.certificate.price
    if price is not None and Fraction(asked.command.alpha or 0) != Fraction(int(price.p), int(price.q)):
        other.append("price of fuel")
    if folder is not None and asked.plant.fmu is not None:
        import json

        recorded = json.loads((folder / "plant" / "hashes.json").read_bytes())
        if recorded["sha256"] != asked.plant.fmu.archive.sha256:
            other.append(f"FMU ({recorded['fmu']})")
    return f"another {', '.join(other)}" if other else ""
