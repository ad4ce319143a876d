"""What people see in a terminal: tables on standard output, progress and messages on standard error.

With `suite.console_shapers` and `suite.console_tables` the only module that imports rich.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich import markup
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table

from fmus.markup import one_line
from suite.command import harmless
from suite.inspecting import summary, terminal_lines, variable_rows
from suite.progress import Progress
from suite.rounding import number
from suite.shaper_text import study_lines
from suite.table_text import BRACKET, bracket_cells

if TYPE_CHECKING:
    from fmus.catalogue import Entry
    from fmus.inspection import Inspection
    from relaxations.commands import Command, Tail
    from relaxations.modes import Mode
    from relaxations.plants import Pole
    from suite.campaign import RunResult
    from suite.collection import Bracketed
    from suite.linear import Linear
    from suite.review import Review
    from suite.simulation import Simulated
    from suite.verification import Verification

STYLES = {"pass": "bold green", "fail": "bold red", "undecided": "bold yellow", "error": "bold magenta"}
MOST_VARIABLES = 100  # rows of a table on a terminal; FMUs have up to 100,000
MOST_STATES = 12  # whose values are shown
MOST_LEVELS = 24  # of a staircase that is shown
WIDTH = 140  # of tables that are written to a file or a pipe, where no terminal says how wide it is


def escape(text: str) -> str:
    """Text as it is, for a console that takes markup: neither markup nor control characters of a stranger's file act."""
    return markup.escape(harmless(text))


def out() -> Console:
    """Standard output, without highlighting."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=WIDTH)


@contextmanager
def progress(title: str, total: int | None = None) -> Iterator[Progress]:
    """A bar on standard error while work is done; nothing where standard error is no terminal."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(escape(title), total=total)

        def planned(count: int) -> None:
            bar.update(task, total=count)

        def finished(result: RunResult) -> None:
            bar.advance(task)
            if not result.measured:
                bar.console.print(f"run {escape(result.name)}: {escape(result.detail)}", style="magenta")

        yield Progress(planned, finished, lambda: bar.advance(task))


def verification_record(done: Verification) -> dict[str, Any]:
    """The object of `verify --json` (docs/schemas.md)."""
    keys = ("id", "quantity", "value", "limit", "margin", "verdict", "worst_run")
    return {
        "verdict": done.verdict.value,
        "requirements": [{key: requirement[key] for key in keys} for requirement in done.results["requirements"]],
        "runs": done.results["runs"],
        "evidence": str(done.folder),
    }


def show_verification(done: Verification) -> None:
    """The verdict table, the bracket, the worst case, and where the report lies."""
    console, results = out(), done.results
    table = Table(title=escape(results["title"] or results["study"]["file"]), title_justify="left", title_style="bold")
    for heading in ("requirement", "quantity", "value", "± error", "limit", "margin", "worst run", "verdict"):
        table.add_column(heading, justify="right" if heading in ("value", "± error", "limit", "margin") else "left")
    for entry in results["requirements"]:
        table.add_row(
            escape(entry["id"]),
            escape(entry["quantity"] + (f" [{entry['unit']}]" if entry["unit"] else "")),
            short(entry["value"]),
            short(entry["error"], 2),
            _limits(entry),
            short(entry["margin"], 3),
            escape(entry["worst_run"] or "–"),
            coloured(entry["verdict"]),
        )
    console.print(table)
    for entry in results["requirements"]:
        if entry["verdict"] != "pass":
            console.print(f"{coloured(entry['verdict'])}  {escape(entry['id'])}: {escape(entry['reason'])}", soft_wrap=True)
    _show_bracket(console, results["bound"])
    if results["shaper"] is not None:
        for line in study_lines(results["shaper"]):
            console.print(escape(line), soft_wrap=True)
    runs = results["runs"]
    console.print(f"runs: {runs['total']} in all, {runs['passed']} passed, {runs['failed']} failed, {runs['errors']} in error")
    for line in _worst_case(results):
        console.print(line, soft_wrap=True)
    for entry in results["requirements"]:
        if entry["si"]:
            console.print(
                escape(f"in SI units: {entry['id']}: {short(entry['si']['value'])} {entry['si']['unit']}, {_limits(entry['si'])}")
            )
    for note in results["notes"]:
        console.print(f"note: {escape(note)}", soft_wrap=True)
    console.print(f"report: {escape(str(done.report))}", soft_wrap=True)
    console.print(f"verdict: {coloured(done.verdict.value)}")


def _worst_case(results: Mapping[str, Any]) -> Iterator[str]:
    """The largest residual vibration and model mismatch of all runs, and where."""
    for quantity in ("residual_vibration", "model_mismatch"):
        known = [(run["quantities"][quantity]["value"], run) for run in results["run_table"] if quantity in run["quantities"]]
        known = [(value, run) for value, run in known if value is not None]
        if known:
            value, run = max(known, key=lambda item: item[0])
            where = ", ".join(f"{name} = {number:.6g}" for name, number in run["parameters"].items())
            yield f"worst {quantity}: {value:.6g} in run {escape(run['run'])}" + (f" ({escape(where)})" if where else "")


def show_bound(done: Bracketed) -> None:
    """The bracket of the minimum time, the switch times and the tail of the command, and where the certificate lies."""
    study, made, console = done.study, done.design, out()
    console.print(escape(study.title or study.file.name), style="bold")
    _show_bracket(console, done.to_dict())
    for line in done.told:
        console.print(escape(line), soft_wrap=True)
    command = made.bound.command
    if command is not None and (made.bound.switches is not None or _short(command)):
        console.print(command_table(command, study.plant.input_unit))
    for heading, one in (("at the least cost:", made.weighed), ("through the filter:", made.cancelled)):
        if one is not None:
            console.print(heading)
            console.print(command_table(one.command, study.plant.input_unit))
    own = made.notes if made.cancelled is not None or made.bound.free is not None else ()
    for note in dict.fromkeys((*study.notes, *own, *made.plant.notes, *made.problem.notes)):
        console.print(f"note: {escape(note)}", soft_wrap=True)
    for file in (done.certificate, done.proof):
        if file is not None:
            console.print(f"certificate: {escape(str(file))}", soft_wrap=True)


def command_table(command: Command, unit: str) -> Table:
    """The levels of a command, and its tail as a formula."""
    table = Table("from, s", f"input, {escape(unit or '–')}")
    for segment in command.segments:
        table.add_row(f"{segment.start:.10f}", f"{segment.level:.10g}")
    table.add_row(f"{command.end:.10f}", escape(_tail(command.tail)))
    return table


def _short(command: Command) -> bool:
    """Whether people want to see a staircase: a few constant levels."""
    return len(command.segments) <= MOST_LEVELS and not any(segment.slope for segment in command.segments)


def _tail(tail: Tail) -> str:
    """The input after the move as a formula in r, the time since its end."""
    terms = [f"{tail.steady:.10g}"]
    for term in tail.terms:
        power = "" if term.power == 0 else " r" if term.power == 1 else f" r^{term.power}"
        decay = f"e^({term.rate.real:.6g} r)"
        if term.rate.imag:
            angle = f"{term.rate.imag:.6g} r"
            terms.append(f"({term.coefficient.real:.10g} cos {angle} {-term.coefficient.imag:+.10g} sin {angle}){power} {decay}")
        else:
            terms.append(f"{term.coefficient.real:.10g}{power} {decay}")
    return " + ".join(terms).replace("+ -", "- ")


def show_collection(table: Sequence[Bracketed]) -> None:
    """One row a study: poles, zeros, switches, both sides, relative gap, status, milliseconds."""
    console = out()
    shown = Table()
    for heading in ("study", "poles", "zeros", *BRACKET):
        shown.add_column(escape(heading), justify="left" if heading in ("study", "status") else "right")
    for done in table:
        plant = done.design.plant
        zeros = sum(zero.multiplicity * (2 if zero.is_flexible else 1) for zero in plant.zeros)
        row = (done.study.file.stem, str(plant.order), str(zeros), *bracket_cells(done.design.bound))
        shown.add_row(*map(escape, row))
    console.print(shown)
    proved = sum(done.design.bound.status.name != "BRACKETED" for done in table)
    console.print(f"{len(table)} studies, {proved} proven")


def _show_bracket(console: Console, bound: Mapping[str, Any]) -> None:
    if bound["maneuver_time"] is None:
        console.print("minimum time: none: no command within the limits does this in any time (proved)")
        return
    lower, upper = bound["maneuver_time"]["lower"], bound["maneuver_time"]["upper"]
    sides = f"[{lower!r}, {'–' if upper is None else repr(upper)}] s"
    gap = "" if upper is None or lower == 0.0 else f", gap {upper / lower - 1.0:.1e}"
    reason = f" ({bound['reason']})" if bound.get("reason") else ""
    console.print(escape(f"minimum time: {sides}{gap}: {bound['status']}{reason}"), soft_wrap=True)


def show_simulated(done: Simulated, output: str) -> None:
    """How the run ended, what was measured, and the convergence study if there is one."""
    console = out()
    console.print(escape(f"{done.status.value}{f': {done.detail}' if done.detail else ''}"), soft_wrap=True)
    grid = f"{done.points} points until {done.stop:.9g} s, one every {done.step:.9g} s"
    console.print(f"{done.interface}, {grid}; {len(done.messages)} messages", soft_wrap=True)
    labels = {f"final({output})": f"final {output}", "residual_vibration": "residual after the end", "peak_input": "peak input"}
    for name, value in done.measured.items():
        unit = done.units[name != "peak_input"]
        console.print(escape(f"{labels[name]}: {value.value:.12g} ± {value.error:.2g} {unit}".rstrip()), soft_wrap=True)
    if done.convergence:
        table = Table()
        for heading in ("step, s", "tolerance", "change when refined", "order"):
            table.add_column(heading, justify="right")
        for row in done.convergence:
            order = "–" if row.order is None else f"{row.order:.2f}"
            table.add_row(f"{row.step:.6g}", short(row.tolerance, 2), f"{row.change:.3g}", order)
        console.print(table)
    if done.log is not None:
        console.print(f"log: {escape(str(done.log))}", soft_wrap=True)


def show_inspection(found: Inspection) -> None:
    """What the FMU is, its variables, its terminals, and what prevents or limits a run here."""
    console = out()
    for name, value in summary(found):
        console.print(f"{name:13} {escape(one_line(value))}", soft_wrap=True)
    rows = variable_rows(found)
    table = Table("variable", "causality", "variability", "type", "start", "unit")
    for row in rows[:MOST_VARIABLES]:
        table.add_row(*(escape(one_line(cell)) for cell in row))
    console.print(table)
    if len(rows) > MOST_VARIABLES:
        console.print(f"and {len(rows) - MOST_VARIABLES} more variables: --json lists all")
    if found.terminals:
        console.print("terminals:")
        for line in terminal_lines(found.terminals, "  "):
            console.print(escape(one_line(line)), soft_wrap=True)
    for note in found.notes:
        console.print(f"note: {escape(one_line(note))}", soft_wrap=True)
    for obstacle in found.obstacles:
        console.print(f"[bold red]prevents a run here:[/] {escape(one_line(obstacle))}", soft_wrap=True)
    if not found.obstacles:
        console.print("nothing prevents a run here")


def show_review(done: Review) -> None:
    """A row for each requirement, what does not agree, and the outcome."""
    console = out()
    table = Table("requirement", "recorded", "recomputed", "verdict")
    for row in done.rows:
        table.add_row(escape(row.id), short(number(row.recorded)), short(number(row.recomputed)), coloured(row.verdict))
    if done.rows:
        console.print(table)
    for finding in done.findings:
        console.print(escape(finding), soft_wrap=True)
    console.print(f"{len(done.files)} files; review: {done.status}")


def catalogue_record(plants: Sequence[Entry]) -> dict[str, Any]:
    """The object of `fmus list --json` (docs/schemas.md)."""

    def roots(those: Sequence[Pole]) -> list[list[float]]:
        return [
            [z.real, z.imag] for root in those for z in (root.value, root.value.conjugate())[: 1 + root.is_flexible] * root.multiplicity
        ]

    details = {
        plant.name: {
            "title": plant.title,
            "domain": plant.domain,
            "nonlinear": plant.nonlinear,
            "input": plant.input,
            "output": plant.output,
            "poles": roots(plant.poles),
            "zeros": roots(plant.zeros),
            "size": None if plant.size is None else {"name": plant.size.name, "range": [plant.size.least, plant.size.most]},
        }
        for plant in plants
    }
    return {"plants": list(details), "details": details}


def show_catalogue(plants: Sequence[Entry]) -> None:
    """One row a plant: domain, from which input to which output, poles and zeros."""
    console = out()
    table = Table()
    for heading in ("plant", "domain", "input", "output", "poles [rad/s]", "zeros [rad/s]"):
        table.add_column(escape(heading))
    for plant in plants:
        domain = f"{plant.domain}, nonlinear" if plant.nonlinear else plant.domain
        ends = (f"{plant.input} [{plant.input_unit}]", f"{plant.output} [{plant.output_unit}]")
        row = (plant.name, domain, *ends, _roots(plant.poles), _roots(plant.zeros))
        table.add_row(*map(escape, row))
    console.print(table)
    for plant in plants:
        if plant.size is not None:
            example = f"{plant.name}_{min(2 * plant.size.value, plant.size.most)}"
            choice = f"{plant.size.least} to {plant.size.most} {plant.size.name}, {plant.size.value} unless the name says otherwise"
            console.print(escape(f"{plant.name}: {choice}, as in {example}"))


def _roots(roots: Sequence[Pole]) -> str:
    """Poles or zeros with their multiplicity, a conjugate pair written once."""

    def one(root: Pole) -> str:
        real, imaginary = root.value.real, root.value.imag
        parts = [f"{real:.4g}"] * bool(real or not imaginary) + [f"±{abs(imaginary):.4g}j"] * bool(imaginary)
        return "".join(parts) + (f" (×{root.multiplicity})" if root.multiplicity > 1 else "")

    return ", ".join(map(one, roots)) or "–"


def show_linear(done: Linear) -> None:
    """The operating point, poles and modes, zeros, how it was found and how far the FMU is from it."""
    found, request, how = done.found, done.request, done.found.identification
    entry, output = (f" {escape(done.unit(name))}".rstrip() for name in (request.input, request.output))
    console = out()
    console.print(escape(f"{done.fmu.path.name}: {request.input} → {request.output}"), style="bold", soft_wrap=True)
    console.print(escape(f"found: {found.summary}"), soft_wrap=True)
    places = [(request.input, f"{found.u:.10g}{entry}"), (request.output, f"{found.y:.10g}{output}")]
    if how is None:
        places += [(name, f"{value:.10g}") for name, value in zip(found.states, found.x.tolist(), strict=True) if value][:MOST_STATES]
    console.print(f"operating point: {', '.join(f'{escape(name)} = {value}' for name, value in places)}", soft_wrap=True)
    table = Table("mode", "pole, rad/s", "±", "Hz", "rad/s", "damping", "time constant, s", f"in a step,{output or ' –'}", "states")
    for name, mode in zip(_numbered(done.modes), done.modes, strict=True):
        table.add_row(escape(name), *map(escape, _mode_cells(mode)), escape(_shares(found.states, mode.participation)))
    if done.modes:
        console.print(table)
    zeros = ", ".join(_root(zero.value) + (f" ×{zero.multiplicity}" if zero.multiplicity > 1 else "") for zero in done.plant.zeros)
    console.print(f"zeros, rad/s: {zeros or 'none'}; gain {done.gain:.10g}", soft_wrap=True)
    if how is not None:
        console.print(f"singular values: {', '.join(f'{value:.1g}' for value in how.singular_values)}", soft_wrap=True)
        tried = ", ".join(f"{order}: {short(error, 2)}" for order, error in how.orders)
        console.print(f"error of each order on another input: {tried}; chosen: {how.order}", soft_wrap=True)
    for amplitude, error, duration, step in done.checks:
        moves = f"the response to moves of ±{amplitude:.4g}{entry} over {duration:.4g} s in steps of {step:.3g} s"
        console.print(f"distance from the FMU: {error:.2g} of {moves}", soft_wrap=True)
    for note in done.notes:
        console.print(f"note: {escape(one_line(note))}", soft_wrap=True)


def _numbered(modes: Sequence[Mode]) -> list[str]:
    """The names that studies use: mode[1] …, real[1] …, in the order of their frequencies."""
    names, count = [], {"flexible": 0, "real": 0, "rigid": 0}
    for mode in modes:
        count[mode.kind] += 1
        name = {"flexible": "mode", "real": "real"}.get(mode.kind)
        names.append((f"{name}[{count[mode.kind]}]" if name else "rigid") + (f" ×{n}" if (n := mode.pole.multiplicity) > 1 else ""))
    return names


def _mode_cells(mode: Mode) -> list[str]:
    pole, order = mode.pole, mode.pole.multiplicity
    flexible = (pole.natural_frequency / (2 * math.pi), pole.natural_frequency, pole.damping_ratio) if pole.is_flexible else (None,) * 3
    moved = short(mode.step_amplitude, 4)
    if pole.is_rigid:  # after a unit step r/s^(k+1), that is r t^k/k!
        moved = f"{mode.residues[-1].real / math.factorial(order):.4g} t{f'^{order}' if order > 1 else ''}"
    return [_root(pole.value), short(mode.uncertainty, 1), *(short(x) for x in flexible), short(mode.time_constant, 4), moved]


def _root(value: complex) -> str:
    imaginary = f" ± {value.imag:.8g}i" if value.imag else ""
    return f"{value.real:.8g}{imaginary}" if value.real or not imaginary else imaginary.strip()


def _shares(states: Sequence[str], participation: Sequence[float]) -> str:
    """The states that make up most of a mode."""
    shares = sorted(zip(participation, states, strict=False), key=lambda share: -share[0])[:3]
    return ", ".join(f"{name} {share:.0%}" for share, name in shares if share >= 0.05)


def coloured(verdict: str) -> str:
    """A verdict in capitals and in its colour."""
    return f"[{STYLES.get(verdict, 'bold')}]{escape(verdict.upper())}[/]"


def short(value: float | None, digits: int = 6) -> str:
    """A number in so many digits, a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def _limits(entry: Mapping[str, Any]) -> str:
    least = "" if entry["min"] is None else f"≥ {entry['min']:.6g}"
    most = "" if entry["max"] is None else f"≤ {entry['max']:.6g}"
    return " ".join(filter(None, (least, most)))
