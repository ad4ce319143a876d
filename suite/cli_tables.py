"""`slewcert table`, `slewcert tradeoff` and `slewcert fuel`: one study, many minimum times."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NoReturn

import click
from click.core import ParameterSource

from suite.command import AS_JSON, FAILED, SANDBOX, guarded, print_json


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--displacements", required=True, metavar="LO:HI:N", help="N equally spaced displacements, both ends included.")
@click.option("--export", "exports", multiple=True, type=click.Path(dir_okay=False, path_type=Path),
              help="Write it for a controller: .h (C), .st (IEC 61131-3 Structured Text), .csv.")  # fmt: skip
@click.option("--certificates", type=click.Path(path_type=Path, file_okay=False), help="Write every row's proof into this folder.")
@SANDBOX
@AS_JSON
@guarded
def table(study: Path, displacements: str, exports: tuple[Path, ...], certificates: Path | None, as_json: bool) -> None:
    """Bracket the minimum time of STUDY for many displacements, with proofs, and write the commands for a controller.

    Exit code 0: every row is proved or bracketed; 1: one is impossible; 2: bad input.
    """
    from suite import console, console_tables, table_files, tables
    from suite.loading import load_study

    table_files.known(exports)
    asked = tables.displacements(displacements)
    with console.progress("bracketing", len(asked)) as shown:
        done = tables.tabulate(load_study(study), asked, certificates, shown.advance)
    for path in exports:
        table_files.export(done, path)
    if as_json:
        print_json(done.to_dict() | {"files": [str(path) for path in exports]})
    else:
        console_tables.show_table(done, exports)
    sys.exit(FAILED if done.impossible else 0)


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--tolerances", metavar="LO:HI:N",
              help="N residuals allowed, fractions of the move, of equal ratio; default: round numbers around the study's.")  # fmt: skip
@click.option("--widths", metavar="LO:HI:N", help="N equally spaced widths, times the study's ranges; default: 0:1.5:7.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw both to this file (SVG).")
@click.option("--certificates", type=click.Path(path_type=Path, file_okay=False), help="Write every point's proof into this folder.")
@SANDBOX
@AS_JSON
@guarded
def tradeoff(study: Path, tolerances: str | None, widths: str | None, plot: Path | None, certificates: Path | None, as_json: bool) -> None:
    """Bracket the minimum time of STUDY for many tolerances of its residual, and for narrower and wider ranges of its parameters.

    The study's own tolerance and ranges are always among them. Exit code 0: every point is proved or bracketed; 1: one is impossible;
    2: bad input.
    """
    from suite import console, console_tables, tradeoff_text, tradeoffs
    from suite.loading import load_study

    if plot:
        tradeoff_text.drawable(plot)
    planned = tradeoffs.plan(load_study(study), tolerances, widths)
    with console.progress("bracketing", planned.count) as shown:
        done = tradeoffs.tradeoff(planned, certificates, shown.advance)
    if plot:
        tradeoff_text.draw(done, plot)
    if as_json:
        print_json(done.to_dict() | {"files": [] if plot is None else [str(plot)]})
    else:
        console_tables.show_tradeoff(done, plot)
    sys.exit(FAILED if done.impossible else 0)


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--from", "least", metavar="FUEL", help="Least budget [input unit · s]; default: a seventh of the most.")
@click.option("--to", "most", metavar="FUEL", help="Most; default: what the thirstiest kind burns when nothing limits it.")
@click.option(
    "--points", "count", type=int, default=200, show_default=True, help="Budgets, equally spaced; prudent choices and others join."
)
@click.option("--kind", "names", multiple=True, metavar="KIND",
              help="rb (rigid body), zv, zvd, zvdd …; several; default: rb, zv, zvd.")  # fmt: skip
@click.option(
    "--show", "shown", multiple=True, metavar="FUEL", help="Draw the sensitivity of these budgets; default: the first two nodes, or knees."
)
@click.option("--level", type=float, default=0.05, show_default=True, help="Residual at which insensitivity is measured, of a step.")
@click.option("--higher-mode", "higher", type=float, default=3.0, show_default=True,
              help="The mode that nobody modelled, times the highest frequency.")  # fmt: skip
@click.option("--held/--no-held", default=None,
              help="Commands held to pulses one way, then the other, and α_crit too; default: with one mode at most.")  # fmt: skip
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw the overview to this file (SVG).")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for every picture, a page, and the record; default: NAME-fuel, unless --json or --plot is given.")  # fmt: skip
@click.option("--certificates", type=click.Path(path_type=Path, file_okay=False), help="Write every point's proof into this folder.")
@click.option("--time", "seconds", type=float, metavar="SECONDS",
              help="No sweep: the least fuel of the study's move in at most that time; with --json and --certificates alone.")  # fmt: skip
@click.option("--alpha", metavar="PRICE",
              help="No sweep: the least ∫(1 + PRICE |u|) dt of the study's move; with --json and --certificates alone.")  # fmt: skip
@SANDBOX
@AS_JSON
@guarded
@click.pass_context
def fuel(
    context: click.Context,
    study: Path,
    least: str | None,
    most: str | None,
    count: int,
    names: tuple[str, ...],
    shown: tuple[str, ...],
    level: float,
    higher: float,
    held: bool | None,
    plot: Path | None,
    out: Path | None,
    certificates: Path | None,
    seconds: float | None,
    alpha: str | None,
    as_json: bool,
) -> None:
    """Bracket the minimum time of STUDY for many budgets of fuel, for several kinds of commands, and name the prudent budgets.

    A point becomes a study by limits.fuel and command.robustness. Exit code 0: every point is proved or bracketed; 1: a budget is too
    little, whatever the time, or --time too short, whatever the fuel; 2: bad input.
    """
    if seconds is not None:
        _alone(context, "--time", (*SWEEPING, "alpha"))
        _at_time(study, seconds, certificates, as_json)
    if alpha is not None:
        _alone(context, "--alpha", SWEEPING)
        _at_price(study, alpha, certificates, as_json)
    from suite import console, console_tables, fuel_pictures, fuel_plans, fuel_records, fuel_sweeps
    from suite.loading import load_study

    fuel_pictures.drawable(plot)
    if out is None and plot is None and not as_json:
        out = Path(f"{study.stem}-fuel")
    asked = fuel_records.Settings(level, higher)
    planned = fuel_plans.plan(
        load_study(study), least, most, count, names or fuel_plans.DEFAULT_KINDS, shown, asked, held=held, weights=held is not False
    )
    with console.progress("bracketing", planned.count) as bar:
        done = fuel_sweeps.sweep(planned, certificates, bar.advance)
    files = fuel_pictures.write(done, out) if out else []
    if plot:
        fuel_pictures.draw(done, plot)
        files.append(plot)
    if as_json:
        print_json(done.to_dict() | {"files": [str(file) for file in files]})
    else:
        console_tables.show_fuel(done, files)
    sys.exit(FAILED if done.impossible else 0)


SWEEPING = ("least", "most", "count", "names", "shown", "level", "higher", "held", "plot", "out")  # options of a sweep of budgets


def _alone(context: click.Context, own: str, others: tuple[str, ...]) -> None:
    """Refuse other options beside one that asks for one move."""
    given = {name for name in others if context.get_parameter_source(name) is not ParameterSource.DEFAULT}
    extra = sorted(option.opts[0] for option in context.command.params if option.name in given)
    if extra:
        raise click.UsageError(f"{own} asks for one move, {', '.join(extra)} for something else: give one of them")


def _at_time(study: Path, seconds: float, certificates: Path | None, as_json: bool) -> NoReturn:
    """`slewcert fuel --time`."""
    from suite import console_tables, fuel_times
    from suite.loading import load_study

    done = fuel_times.least_fuel_of(load_study(study), seconds, certificates)
    if as_json:
        print_json(done.to_dict())
    else:
        console_tables.show_fuel_at_time(done)
    sys.exit(FAILED if done.found is None else 0)


def _at_price(study: Path, alpha: str, certificates: Path | None, as_json: bool) -> NoReturn:
    """`slewcert fuel --alpha`."""
    from suite import console_tables, fuel_costs
    from suite.loading import load_study

    price = fuel_costs.price("--alpha", alpha)
    done = fuel_costs.least_cost_of(load_study(study), price, certificates)
    if as_json:
        print_json(done.to_dict())
    else:
        console_tables.show_fuel_cost(done)
    sys.exit(0)
