"""Brackets as cells of text, for tables."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR
from typing import TYPE_CHECKING

from relaxations.bounds import Bound, Status
from suite.rounding import outward

if TYPE_CHECKING:
    from suite.tables import Table

BRACKET = ("switches", "lower [s]", "upper [s]", "gap", "status", "ms")


def bracket_cells(bound: Bound) -> tuple[str, ...]:
    """Switches, both sides rounded outward, relative gap, status, milliseconds."""
    impossible = bound.status is Status.IMPOSSIBLE
    sides = ("–", "–") if impossible else (outward(bound.lower, ROUND_FLOOR), outward(bound.upper, ROUND_CEILING))
    gap = "–" if impossible or bound.gap is None else f"{bound.gap:.1e}"
    switches = "–" if bound.switches is None else str(bound.switches)
    return switches, *sides, gap, bound.status.name.lower(), f"{1000 * bound.seconds:.0f}"


def table_cells(done: Table) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings, and a row a displacement."""
    headings = (f"displacement [{done.study.plant.output_unit or '–'}]", *BRACKET)
    return headings, [(f"{float(row.displacement):.10g}", *bracket_cells(row.bound)) for row in done.rows]
