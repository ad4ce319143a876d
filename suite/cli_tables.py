"""`slewcert table` and `slewcert tradeoff`: one study, many minimum times."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from suite.command import AS_JSON, FAILED, SANDBOX, guarded, print_json


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--displacements", required=True, metavar="LO:HI:N", help="N equally spaced displacements, both ends included.")
@click.option("--export", "exports", multiple=True, type=click.Path(path_type=Path),
              help="Write it for a controller: .h (C), .st (IEC 61131-3 Structured Text), .csv.")  # fmt: skip
@click.option("--certificates", type=click.Path(path_type=Path), help="Write every row's proof into this folder.")
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
@click.option("--plot", type=click.Path(path_type=Path), help="Draw both to this file (SVG).")
@click.option("--certificates", type=click.Path(path_type=Path), help="Write every point's proof into this folder.")
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
