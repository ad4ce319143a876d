"""Pole-zero cancelling filters on a terminal."""

from __future__ import annotations

from rich.table import Table

from suite.console import escape, out
from suite.prefilter_comparisons import Compared
from suite.prefilter_sweeps import PrefilterSweep
from suite.prefilters import Designed


def show_prefilter(done: Designed) -> None:
    """Steps and decaying terms at each delay, and what is proven and measured of the filter."""
    console, made = out(), done.prefilter
    table = Table(*map(escape, ("delay [s]", "step", "term of the impulse response, r after the delay")))
    for delay, gain in zip(made.delays, made.gains, strict=True):
        terms = [term for term in made.terms if term.start == delay]
        written = [_term(term.rate, term.power, term.coefficient) for term in terms]
        table.add_row(f"{delay:.10f}", f"{gain:.10f}", escape(" + ".join(written).replace("+ -", "- ") or "–"))
    console.print(table)
    for line in done.lines():
        console.print(escape(line), soft_wrap=True)


def show_sweep(done: PrefilterSweep) -> None:
    """A row for each value, and what is said where there is no filter."""
    console = out()
    table = Table(*map(escape, done.header))
    for row in done.rows():
        table.add_row(*("–" if cell is None else f"{cell:.6g}" for cell in row))
    console.print(table)
    for reason in dict.fromkeys(one.reason for one in done.found if one.reason is not None):
        where = [one.value for one in done.found if one.reason == reason]
        console.print(escape(f"none at {len(where)} of {len(done.found)} values, the first {where[0]:g}: {reason}"), soft_wrap=True)


def show_comparison(done: Compared) -> None:
    """A row for each design; what is said where there is none."""
    console = out()
    table = Table(*map(escape, done.headings))
    for row in done.rows():
        table.add_row(*map(escape, row))
    console.print(table)
    for one in done.found:
        if one.reason is not None:
            console.print(escape(f"{one.name}: {one.reason}"), soft_wrap=True)
    console.print("left: the largest deviation after the last delay if a root is 10 % elsewhere (measured); cascades keep to no limit")


def _term(rate: complex, power: int, coefficient: complex) -> str:
    grown = "" if power == 0 else " r" if power == 1 else f" r^{power}"
    decay = f"e^({rate.real:.6g} r)"
    if not rate.imag:
        return f"{coefficient.real:.10g}{grown} {decay}"
    angle = f"{rate.imag:.6g} r"
    return f"({coefficient.real:.10g} cos {angle} {-coefficient.imag:+.10g} sin {angle}){grown} {decay}"
