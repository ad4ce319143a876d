"""Tables for controllers: every row is proven, all three files hold the same commands, and what stands between two rows lands too."""

from __future__ import annotations

import csv
import itertools
import json
import re
import subprocess
import tomllib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail, TailTerm
from relaxations.plants import LinearPlant
from relaxations.response import response
from suite import table_files, tables
from suite.cli import main
from suite.loading import load_study
from suite.tables import Table, TableError, displacements, tabulate

PITCH = [1, 0.739, 2.072, 0.1774]
STUDIES = {
    "spring": ('numerator = [1]\ndenominator = [2, 0, 4, 0, 0]', "input = [-1, 1]", "", "-4:4:9"),
    "one_sided": ("numerator = [1]\ndenominator = [1, 0.2, 1]", "input = [-0.5, 1]", "", "0.1:0.9:5"),
    "tail": (f"numerator = [1.151, 0.1774]\ndenominator = {PITCH}", "input = [-0.3, 0.3]", "[command]\ntail = true", "0.05:0.2:4"),
    "sampled": ("numerator = [1]\ndenominator = [2, 0, 4, 0, 0]", "input = [-1, 1]\nsample_time = 0.25", "", "1:5:3"),
    "held": ("numerator = [1]\ndenominator = [1, 0, 1]\ninitial = { input = 0.5 }", "input = [0, 2]", "", "0.1:1.2:5"),
}  # fmt: skip


def study_file(folder: Path, name: str) -> Path:
    plant, limits, more, _ = STUDIES[name]
    file = folder / f"{name}.toml"
    file.write_text(f'title = "{name} */ *)"\n[plant]\n{plant}\n[maneuver]\ndisplacement = 0.1\n[limits]\n{limits}\n{more}\n')
    return file


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Table, Path]]:
    """Every study's table, and the folder that it was written to in all forms."""
    found = {}
    for name, (*_, asked) in STUDIES.items():
        folder = tmp_path_factory.mktemp(name)
        table = tabulate(load_study(study_file(folder, name)), displacements(asked), folder / "proofs")
        for ending in table_files.EXPORTS:
            table_files.export(table, folder / f"{name}{ending}")
        found[name] = table, folder
    return found


def plant_of(name: str) -> LinearPlant:
    plant = tomllib.loads(STUDIES[name][0])
    return LinearPlant.from_transfer(*([Fraction(str(c)) for c in plant[key]] for key in ("numerator", "denominator")))


def commands(table: Table) -> dict[float, Command]:
    found = {float(row.displacement): row.bound.command for row in table.rows}
    assert None not in found.values()
    return found  # type: ignore[return-value]


@pytest.mark.parametrize("name", STUDIES)
def test_every_row_is_proven_and_its_certificate_says_so(name: str, made: dict[str, tuple[Table, Path]]) -> None:
    table, _ = made[name]
    assert table.proven == len(table.rows)
    assert [row.displacement for row in table.rows] == sorted(x for x in displacements(STUDIES[name][3]))
    for row in table.rows:
        assert row.certificate is not None
        checked = check(row.certificate.read_bytes())
        assert checked.outcome is Outcome.PROVED
        assert checked.certificate is not None
        assert Fraction(str(checked.certificate.task.displacement)) == row.displacement
        assert row.bound.gap is not None
        assert row.bound.gap < 1e-6
    for sign in (1, -1):  # larger moves take longer
        times = [row.bound.lower for row in sorted(table.rows, key=lambda row: abs(row.displacement)) if row.displacement * sign > 0]
        assert times == sorted(times)


def test_where_a_search_begins_changes_nothing(made: dict[str, tuple[Table, Path]], tmp_path: Path) -> None:
    table, _ = made["spring"]
    alone = tabulate(load_study(study_file(tmp_path, "spring")), (Fraction(3),)).rows[0].bound
    (row,) = [row for row in table.rows if row.displacement == 3]
    assert row.bound.lower == pytest.approx(alone.lower, rel=1e-14)
    assert row.bound.upper == pytest.approx(alone.upper, rel=1e-14)


# The files.


def places(table: Table) -> list[tuple[float, float]]:
    """Displacements on rows and between them, of both signs and beyond the table; times before, in, at the end of and after the move."""
    rows = [float(row.displacement) for row in table.rows]
    asked = [*rows, *(0.37 * a + 0.63 * b for a, b in itertools.pairwise(rows)), 0.0, 0.5 * min(map(abs, rows))]
    asked += [-x for x in asked] + [1.01 * max(rows), 1.01 * min(rows), 2.0 * max(map(abs, rows))]
    longest = max(row.bound.upper or 0.0 for row in table.rows)
    times = [-0.1, 0.0, *np.linspace(0.01, 1.3 * longest, 23), *(row.bound.upper or 0.0 for row in table.rows)]
    return [(x, float(t)) for x in asked for t in times]


def expected(table: Table, displacement: float, t: float) -> tuple[float, float]:
    """(duration, input) as the files should say it: the nearest row that is not smaller, scaled."""
    known = commands(table)
    fits = {x: displacement / x for x in known if 0.0 <= (abs(displacement / x) if table.mirrored else displacement / x) <= 1.0}
    if displacement == 0.0:
        return 0.0, table.rest
    if not fits:
        return -1.0, table.rest
    nearest = max(abs(ratio) for ratio in fits.values())
    row = next(x for x, ratio in fits.items() if abs(ratio) == nearest)
    command = known[row]
    u = float(command(t, table.rest)) if t >= 0.0 else table.rest
    return command.maneuver_time, table.rest + fits[row] * (u - table.rest)


@pytest.mark.parametrize("name", STUDIES)
def test_the_header_compiles_without_a_warning_and_says_the_commands(name: str, made: dict[str, tuple[Table, Path]]) -> None:
    table, folder = made[name]
    program = folder / "main.c"
    program.write_text(
        f'#include <stdio.h>\n#include "{name}.h"\n'
        "int main(void) {\n    double x, t;\n    while (scanf(\"%lf %lf\", &x, &t) == 2) {\n"
        f'        printf("%.17g %.17g\\n", {name}_time(x), {name}_input(x, t));\n    }}\n    return 0;\n}}\n'
    )  # fmt: skip
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off"]
    subprocess.run(["cc", *flags, "-o", folder / "main", program, "-lm"], check=True)
    asked = places(table)
    lines = "\n".join(f"{x!r} {t!r}" for x, t in asked)
    done = subprocess.run([folder / "main"], input=lines, capture_output=True, text=True, check=True)
    got = np.array([[float(x) for x in line.split()] for line in done.stdout.splitlines()])
    want = np.array([expected(table, x, t) for x, t in asked])
    np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", STUDIES)
def test_structured_text_says_the_commands(name: str, made: dict[str, tuple[Table, Path]]) -> None:
    table, folder = made[name]
    block = translated((folder / f"{name}.st").read_text())
    for x, t in places(table)[::7]:
        out = block(x, t)
        duration, u = expected(table, x, t)
        assert out["valid"] is (duration >= 0.0)
        assert out["duration"] == max(duration, 0.0)
        assert out["u"] == pytest.approx(u, rel=1e-13, abs=1e-13)


def translated(text: str) -> Callable[[float, float], dict[str, Any]]:
    """A function block of the statements that tables use, as a Python function: an independent reading of the standard's grammar."""
    text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    assert text.count("VAR") % 2 == 0
    declared = re.findall(r"(\w+) : (ARRAY\[0\.\.(\d+)\] OF )?(LREAL|DINT|BOOL)( := (\[[^\]]*\]|[^;]+))?;", text)
    start: dict[str, Any] = {}
    for variable, array, last, kind, _, value in declared:
        if array:
            numbers = [float(x) if kind == "LREAL" else int(x) for x in value.strip("[]").split(",")]
            assert len(numbers) == int(last) + 1, variable
            start[variable] = numbers
        else:
            start[variable] = {"LREAL": float, "DINT": int, "BOOL": bool}[kind](value or 0)
    body = text[text.rindex("END_VAR") + len("END_VAR") : text.index("END_FUNCTION_BLOCK")]
    lines, depth = [], 0
    for statement in re.split(r";|(?<=THEN)|(?<=\bDO)", body):
        words = " ".join(statement.split())
        if not words:
            continue
        if words.startswith("END_"):
            depth -= 1
            continue
        code = words
        for old, new in (
            (r" AND ", " and "),
            (r"<>", "!="),
            (r"(?<![<>:!])=", "=="),
            (r":==|:=", "="),
            ("TRUE", "True"),
            ("FALSE", "False"),
        ):
            code = re.sub(old, new, code)
        if match := re.fullmatch(r"IF (.*) THEN", code):
            code = f"if {match[1]}:"
        elif match := re.fullmatch(r"WHILE (.*) DO", code):
            code = f"while {match[1]}:"
        elif match := re.fullmatch(r"FOR (\w+) = (.*) TO (.*) DO", code):
            code = f"for {match[1]} in range({match[2]}, {match[3]} + 1):"
        lines.append("    " * depth + code)
        depth += code.endswith(":")
    assert depth == 0
    program = compile("\n".join(lines), "block", "exec")

    def run(displacement: float, t: float) -> dict[str, Any]:
        known = {**start, "displacement": displacement, "t": t, "EXP": np.exp, "COS": np.cos, "SIN": np.sin}
        exec(program, known)  # noqa: S102 # a test's own translation of a file that the test has made
        return known

    return run


@pytest.mark.parametrize("name", STUDIES)
def test_the_csv_holds_the_commands_digit_by_digit(name: str, made: dict[str, tuple[Table, Path]]) -> None:
    table, folder = made[name]
    with (folder / f"{name}.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    for i, row in enumerate(table.rows):
        mine = [line for line in lines if int(line["row"]) == i]
        pieces = [line for line in mine if line["kind"] == "piece"]
        segments = tuple(Segment(*(float(line[key]) for key in ("start", "level", "slope"))) for line in pieces[:-1])
        terms = tuple(
            TailTerm(
                complex(float(line["rate_re"]), float(line["rate_im"])),
                int(line["power"]),
                complex(float(line["coefficient_re"]), float(line["coefficient_im"])),
            )
            for line in mine
            if line["kind"] == "term"
        )
        read = Command(float(pieces[-1]["start"]), segments, Tail(float(pieces[-1]["level"]), terms))
        assert read == row.bound.command
        assert {line["status"] for line in mine} == {"proved"}
        assert float(mine[0]["lower"]) == row.bound.lower
        assert float(mine[0]["upper"]) == row.bound.upper
        assert float(mine[0]["displacement"]) == float(row.displacement)


@pytest.mark.parametrize(("name", "displacement"), [("spring", -2.7), ("one_sided", 0.33), ("held", 0.71), ("sampled", 3.3)])
def test_between_two_rows_the_plant_lands_within_the_limits(name: str, displacement: float, made: dict[str, tuple[Table, Path]]) -> None:
    table, _ = made[name]
    larger = min((x for x in commands(table) if x / displacement >= 1.0), key=abs)
    command, scale = commands(table)[larger], displacement / larger
    segments = tuple(Segment(s.start, table.rest + scale * (s.level - table.rest)) for s in command.segments)
    scaled = Command(command.maneuver_time, segments, Tail(table.rest + scale * (command.tail.steady - table.rest)))
    low, high = tomllib.loads(f"[limits]\n{STUDIES[name][1]}")["limits"]["input"]
    assert all(low <= s.level <= high for s in scaled.segments)
    after = np.linspace(scaled.end, scaled.end + 20.0, 101)
    np.testing.assert_allclose(response(plant_of(name), scaled, after, rest=table.rest), displacement, rtol=0.0, atol=1e-8)


# The command line.


def run(*arguments: object) -> Any:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_the_command_line_writes_files_and_says_what_is_proven(tmp_path: Path) -> None:
    study = study_file(tmp_path, "one_sided")
    exports = [tmp_path / f"moves{ending}" for ending in (".h", ".st", ".csv")]
    done = run(
        "table",
        study,
        "--displacements",
        "0.1:0.5:3",
        *(x for path in exports for x in ("--export", path)),
        "--certificates",
        tmp_path / "p",
    )
    assert done.exit_code == 0, done.output
    assert "3 displacements, 3 proven on both sides" in done.output
    assert all(path.exists() for path in exports)
    assert "moves_input(double displacement" in exports[0].read_text()
    assert sorted(path.name for path in (tmp_path / "p").iterdir()) == [f"one_sided.{i}.certificate.json" for i in (1, 2, 3)]
    done = run("table", study, "--displacements", "0.1:0.5:3", "--json")
    record = json.loads(done.stdout)
    assert [row["status"] for row in record["rows"]] == ["proved"] * 3
    assert record["rows"][0]["displacement"] == 0.1
    assert record["files"] == []


@pytest.mark.parametrize("text", ["1:2", "1:2:1", "2:1:5", "1:1:3", "a:b:3", "1:2:3:4", "nan:1:3", "1:inf:3", "1:2:99999", "1:2:-3", ""])
def test_displacements_that_are_none(text: str, tmp_path: Path) -> None:
    with pytest.raises(TableError, match="displacements"):
        displacements(text)
    assert run("table", study_file(tmp_path, "spring"), "--displacements", text).exit_code == 2


def test_displacements_are_exact_and_leave_out_no_move() -> None:
    assert displacements("0.1:0.4:4") == tuple(Fraction(i, 10) for i in (1, 2, 3, 4))
    assert displacements("-1:1:3") == (Fraction(-1), Fraction(1))


def test_an_impossible_row_is_told_and_not_written(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text("[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [0, 1]\n")
    done = run("table", file, "--displacements", "1:2:2")
    assert done.exit_code == 1
    assert "impossible" in done.output
    done = run("table", file, "--displacements", "1:2:2", "--export", tmp_path / "x.h")
    assert done.exit_code == 2
    assert "no row of the table has a command" in done.output


def test_what_cannot_be_a_table_is_refused_in_words(tmp_path: Path) -> None:
    held = study_file(tmp_path, "held")
    done = run("table", held, "--displacements", "1:3:3")
    assert done.exit_code == 2
    assert "row 1 of the table" in done.output, "the largest move needs more than the limits hold"
    done = run("table", held, "--displacements", "0.1:1:3", "--export", tmp_path / "x.pas")
    assert done.exit_code == 2
    assert ".st for Structured Text" in done.output
    assert tables.MOST_ROWS >= 1000
