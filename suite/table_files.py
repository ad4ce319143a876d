"""A table of commands for controllers: as a C header, as IEC 61131-3 Structured Text, as CSV; by the file's ending.

All three hold the same numbers. A command is `level + slope (t - start)` from each start on, absolute; its last piece begins at the end of
the move and holds the plant there. Where the input decays after the move, terms `Re(c r^k e^{pr})` are added, r the time since its end.
C and Structured Text bring the functions too: the row for a displacement, how long it takes, and the input at a time.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from relaxations.commands import TailTerm
from reports.files import write_atomically
from suite.study_file import printable
from suite.tables import Table, TableError

WRAP = 6  # numbers in a line


@dataclass(frozen=True, slots=True)
class _Columns:
    """The table as arrays: of each row the displacement, the duration [s] and where its pieces (and terms) begin; of each piece three."""

    displacement: list[float]
    duration: list[float]
    first: list[int]
    start: list[float]
    level: list[float]
    slope: list[float]
    first_term: list[int]
    terms: list[TailTerm]


def _columns(table: Table) -> _Columns:
    found = _Columns([], [], [0], [], [], [], [0], [])
    for row in table.usable:
        command = row.bound.command
        assert command is not None
        found.displacement.append(float(row.displacement))
        found.duration.append(command.maneuver_time)
        for piece in command.pieces(table.rest):
            found.start.append(piece.start)
            found.level.append(piece.level)
            found.slope.append(piece.slope)
        found.first.append(len(found.start))
        found.terms.extend(command.tail.terms)
        found.first_term.append(len(found.terms))
    return found


def known(paths: Sequence[Path]) -> None:
    """Raises `TableError` for files whose ending says nothing of whom they are for."""
    if unknown := [str(path) for path in paths if path.suffix not in EXPORTS]:
        raise TableError(f"{', '.join(unknown)}: the ending says what a table is written as: .h for C, .st for Structured Text, .csv")


def export(table: Table, path: Path) -> None:
    """The table for a controller, by the file's ending (`known`); functions are named after the file."""
    if not table.usable:
        raise TableError(f"no row of the table has a command, so there is nothing to write to {path}")
    name = re.sub(r"[^A-Za-z0-9_]+", "_", path.stem).strip("_").lower() or "slew"
    name = name if name[0].isalpha() else f"slew_{name}"
    write_atomically(path, EXPORTS[path.suffix](table, name).encode())


def _told(table: Table) -> list[str]:
    """What stands at the head of every file."""
    study, count = table.study, len(table.usable)
    units = [f"in {unit}" if unit else "in the study's unit" for unit in (study.plant.output_unit, study.plant.input_unit)]
    ascii_title = study.title.encode("ascii", "replace").decode()
    lines = [
        f"{printable(ascii_title)}: commands for {count} displacements, by slewcert table.",
        f"Study {printable(study.file.name)}, SHA-256 {study.sha256}.",
        f"Proven on both sides, lower and upper: {table.proven} of {len(table.rows)}.",
        f"Displacement {units[0]}, input {units[1]} (absolute), times in s.",
        "Between two rows the larger one serves, scaled down: it moves the linear plant exactly, within the limits.",
    ]
    if table.mirrored:
        lines.append("The limits are as far above the input at rest as below: commands are turned around for the other sign.")
    return lines


def _lines(numbers: Iterable[str]) -> list[str]:
    items = list(numbers)
    return [", ".join(items[i : i + WRAP]) for i in range(0, len(items), WRAP)]


def _c_number(x: float) -> str:
    text = repr(float(x))
    return text if "." in text or "e" in text else f"{text}.0"


def _c_array(kind: str, name: str, numbers: Sequence[str]) -> str:
    body = ",\n    ".join(_lines(numbers or ["0"]))
    return f"static const {kind} {name}[{max(len(numbers), 1)}] = {{\n    {body}\n}};"


def _c(table: Table, name: str) -> str:
    columns, up = _columns(table), name.upper()
    doubles = {"displacement": columns.displacement, "duration": columns.duration, "start": columns.start, "level": columns.level}
    doubles |= {"slope": columns.slope} if any(columns.slope) else {}
    arrays = [_c_array("double", f"{name}_{key}", [_c_number(x) for x in values]) for key, values in doubles.items()]
    arrays.append(_c_array("unsigned long", f"{name}_first", [f"{i}UL" for i in columns.first]))
    slope = f" + {name}_slope[i] * (t - {name}_start[i])" if any(columns.slope) else ""
    include, tail = "", ""
    if columns.terms:
        include = "#include <math.h>\n\n"
        parts = [(t.rate.real, t.rate.imag, t.coefficient.real, t.coefficient.imag, float(t.power)) for t in columns.terms]
        arrays.append(_c_array("double", f"{name}_term", [_c_number(x) for part in parts for x in part]))
        arrays.append(_c_array("unsigned long", f"{name}_first_term", [f"{i}UL" for i in columns.first_term]))
        tail = f"""    if (t >= {name}_duration[row]) {{
        const double r = t - {name}_duration[row];
        for (i = {name}_first_term[row]; i < {name}_first_term[row + 1]; i++) {{
            const double *term = {name}_term + 5UL * i;
            u += pow(r, term[4]) * exp(term[0] * r) * (term[2] * cos(term[1] * r) - term[3] * sin(term[1] * r));
        }}
    }}
"""
    told = "\n".join(f" * {line}" for line in _told(table)).replace("*/", "* /")
    return f"""/*
{told}
 */
#ifndef {up}_H
#define {up}_H

{include}#define {up}_ROWS {len(columns.displacement)}
#define {up}_REST {_c_number(table.rest)}
#define {up}_MIRRORED {int(table.mirrored)}

{chr(10).join(arrays)}

/* The row that serves a displacement: the nearest of the same sign that is not smaller; -1: none. *scale is what to multiply by. */
static inline int {name}_row(double displacement, double *scale) {{
    int row, best = -1;
    *scale = 0.0;
    for (row = 0; row < {up}_ROWS; row++) {{
        const double ratio = displacement / {name}_displacement[row];
        const double size = ratio < 0.0 && {up}_MIRRORED ? -ratio : ratio;
        if (size >= 0.0 && size <= 1.0 && (best < 0 || size > (*scale < 0.0 ? -*scale : *scale))) {{
            best = row;
            *scale = ratio;
        }}
    }}
    return best;
}}

/* How long the move takes, s; -1 if the table does not reach so far. */
static inline double {name}_time(double displacement) {{
    double scale;
    const int row = {name}_row(displacement, &scale);
    return displacement == 0.0 ? 0.0 : row < 0 ? -1.0 : {name}_duration[row];
}}

/* The input t seconds after the beginning of the move; the input at rest before it, and if the table does not reach so far. */
static inline double {name}_input(double displacement, double t) {{
    double scale, u;
    unsigned long i;
    const int row = {name}_row(displacement, &scale);
    if (row < 0 || t < 0.0) {{
        return {up}_REST;
    }}
    for (i = {name}_first[row + 1] - 1UL; {name}_start[i] > t; i--) {{
    }}
    u = {name}_level[i]{slope};
{tail}    return {up}_REST + scale * (u - {up}_REST);
}}

#endif
"""


def _st_number(x: float) -> str:
    text = repr(float(x)).replace("e", "E").replace("E+", "E")
    mantissa, _, exponent = text.partition("E")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}E{int(exponent)}" if exponent else mantissa


def _st_array(kind: str, name: str, numbers: Sequence[str]) -> str:
    items = list(numbers) or ["0"]
    body = ",\n            ".join(_lines(items))
    return f"        {name} : ARRAY[0..{len(items) - 1}] OF {kind} := [\n            {body}];"


def _structured_text(table: Table, name: str) -> str:
    columns, block = _columns(table), name.upper()
    doubles = {"displacements": columns.displacement, "durations": columns.duration, "starts": columns.start, "levels": columns.level}
    doubles |= {"slopes": columns.slope} if any(columns.slope) else {}
    arrays = [_st_array("LREAL", key, [_st_number(x) for x in values]) for key, values in doubles.items()]
    arrays.append(_st_array("DINT", "first", [str(i) for i in columns.first]))
    slope = " + slopes[i] * (t - starts[i])" if any(columns.slope) else ""
    tail, more = "", ""
    if columns.terms:
        for key, values in {
            "rates_re": [t.rate.real for t in columns.terms],
            "rates_im": [t.rate.imag for t in columns.terms],
            "coefficients_re": [t.coefficient.real for t in columns.terms],
            "coefficients_im": [t.coefficient.imag for t in columns.terms],
        }.items():
            arrays.append(_st_array("LREAL", key, [_st_number(x) for x in values]))
        arrays.append(_st_array("DINT", "powers", [str(t.power) for t in columns.terms]))
        arrays.append(_st_array("DINT", "first_term", [str(i) for i in columns.first_term]))
        more = "\n        r : LREAL;\n        power : LREAL;\n        j : DINT;"
        tail = """
        IF t >= durations[row] THEN
            r := t - durations[row];
            FOR i := first_term[row] TO first_term[row + 1] - 1 DO
                power := 1.0;
                FOR j := 1 TO powers[i] DO
                    power := power * r;
                END_FOR;
                value := value + power * EXP(rates_re[i] * r)
                    * (coefficients_re[i] * COS(rates_im[i] * r) - coefficients_im[i] * SIN(rates_im[i] * r));
            END_FOR;
        END_IF;"""
    told = "\n".join(f"   {line}" for line in _told(table)).replace("*)", "* )").replace("(*", "( *")
    turned = "    IF size < 0.0 THEN\n        size := -size;\n    END_IF;\n" if table.mirrored else ""
    return f"""(*
{told}
   Call it once a cycle: u is the input t seconds after the beginning of the move, duration how long the move takes; valid is FALSE
   if the table does not reach so far, and u is then the input at rest.
*)
FUNCTION_BLOCK {block}
    VAR_INPUT
        displacement : LREAL;
        t : LREAL;
    END_VAR
    VAR_OUTPUT
        u : LREAL;
        duration : LREAL;
        valid : BOOL;
    END_VAR
    VAR CONSTANT
        rows : DINT := {len(columns.displacement)};
        rest : LREAL := {_st_number(table.rest)};
{chr(10).join(arrays)}
    END_VAR
    VAR
        row : DINT;
        i : DINT;
        best : LREAL;
        scale : LREAL;
        ratio : LREAL;
        size : LREAL;
        value : LREAL;{more}
    END_VAR

row := -1;
best := -1.0;
scale := 0.0;
u := rest;
duration := 0.0;
valid := displacement = 0.0;
FOR i := 0 TO rows - 1 DO
    ratio := displacement / displacements[i];
    size := ratio;
{turned}    IF size >= 0.0 AND size <= 1.0 AND size > best THEN
        row := i;
        best := size;
        scale := ratio;
    END_IF;
END_FOR;
IF row >= 0 AND displacement <> 0.0 THEN
    valid := TRUE;
    duration := durations[row];
    IF t >= 0.0 THEN
        i := first[row + 1] - 1;
        WHILE starts[i] > t DO
            i := i - 1;
        END_WHILE;
        value := levels[i]{slope};{tail}
        u := rest + scale * (value - rest);
    END_IF;
END_IF;
END_FUNCTION_BLOCK
"""


def _csv(table: Table, name: str) -> str:
    del name
    heads = ["row", "displacement", "status", "lower", "upper", "kind", "start", "level", "slope"]
    heads += ["power", "rate_re", "rate_im", "coefficient_re", "coefficient_im"]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(heads)
    for i, row in enumerate(table.usable):
        command, bound = row.bound.command, row.bound
        assert command is not None
        common = [i, repr(float(row.displacement)), bound.status.name.lower(), repr(bound.lower), repr(bound.upper)]
        for piece in command.pieces(table.rest):
            writer.writerow([*common, "piece", *(repr(float(x)) for x in (piece.start, piece.level, piece.slope)), "", "", "", "", ""])
        for term in command.tail.terms:
            parts = (term.rate.real, term.rate.imag, term.coefficient.real, term.coefficient.imag)
            writer.writerow([*common, "term", repr(command.maneuver_time), "", "", term.power, *(repr(float(x)) for x in parts)])
    return out.getvalue()


EXPORTS: dict[str, Callable[[Table, str], str]] = {".h": _c, ".st": _structured_text, ".csv": _csv}
