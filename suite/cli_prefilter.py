"""`slewcert prefilter`, on the command line."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from suite.command import AS_JSON, FAILED, SANDBOX, guarded, print_json

R = TypeVar("R")


def _parsed(read: Callable[[str], R]) -> Callable[[click.Context, click.Parameter, str | None], R | None]:
    def convert(context: click.Context, option: click.Parameter, text: str | None) -> R | None:
        try:
            return None if text is None else read(text)
        except ValueError as problem:
            raise click.BadParameter(f"{text!r}: {problem}", context, option) from None

    return convert


def _pair(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise ValueError("must be LOW:HIGH, such as -0.35:2") from None
    if not low < high:
        raise ValueError("must be LOW:HIGH with LOW < HIGH")
    return low, high


def _instants(text: str) -> tuple[float, ...]:
    try:
        instants = tuple(map(float, text.split(",")))
    except ValueError:
        raise ValueError("must be seconds, such as 1.5,4.2") from None
    if not all(a < b < float("inf") for a, b in zip((0.0, *instants), instants, strict=False)):
        raise ValueError("must be seconds that ascend from more than 0")
    return instants


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        raise ValueError("must be seconds, such as 0.05") from None
    if not 0.0 < seconds <= 1e6:
        raise ValueError("must be more than 0 s and at most 1000000 s")
    return seconds


def _zeros(text: str) -> tuple[int, ...]:
    if text == "none":
        return ()
    if not re.fullmatch(r"[1-9]\d{0,2}(,[1-9]\d{0,2})*", text):
        raise ValueError("must be numbers of the plant's zeros by ascending magnitude, such as 1 or 1,2, or none")
    return tuple(map(int, text.split(",")))


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--delays", type=click.IntRange(1, 40), help="How many delays the filter has; default: as the study says.")
@click.option("--form", help='Where its poles stand: last (the default), first, every or a delay\'s number, with "+step" and "+free".')
@click.option("--robustness", type=click.IntRange(0, 9), help="Further zeros at every flexible mode; default: as the study says.")
@click.option("--gains", callback=_parsed(_pair), metavar="LOW:HIGH", help="Bounds of its steps for the study's displacement.")
@click.option("--monotone", is_flag=True, help="The input never turns back.")
@click.option("--instants", callback=_parsed(_instants), metavar="SECONDS,…", help="The delays themselves.")
@click.option("--sample-time", callback=_parsed(_seconds), metavar="SECONDS", help="Seconds: the delays are multiples of it.")
@click.option("--zeros", callback=_parsed(_zeros), metavar="NUMBERS|none", help="Which zeros are cancelled; default: all that can be.")
@click.option("--unbounded", is_flag=True, help="Do not hold the input within the study's limits.")
@click.option(
    "--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw the input with its tail, and the output, to this file (.svg)."
)
@click.option("--sweep", metavar="NAME=FROM:TO:N",
              help="Filters against mode[i].frequency, mode[i].damping, zero[i] (factors; a ratio), or delay[k] (seconds).")  # fmt: skip
@click.option("--csv", type=click.Path(dir_okay=False, path_type=Path), help="Write the filters of --sweep to this file.")
@click.option("--compare", is_flag=True, help="Beside it filters of steps alone, concurrent and in cascade, and what each leaves.")
@click.option("--save", type=click.Path(dir_okay=False, path_type=Path), help="Write a filter file, for `slewcert fmus export`.")
@SANDBOX
@AS_JSON
@guarded
def prefilter(
    study: Path,
    plot: Path | None,
    save: Path | None,
    sweep: str | None,
    csv: Path | None,
    compare: bool,
    as_json: bool,
    **words: Any,
) -> None:
    """Design a filter for the plant of STUDY whose zeros cancel its poles and whose poles cancel its zeros.

    Exit code 0: done; 1: none was found, or there is none; 2: bad input.
    """
    from suite import console_prefilters, prefilters

    if plot is not None and plot.suffix != ".svg":
        raise click.UsageError(f"--plot {plot}: pictures are SVG; name a file that ends in .svg")
    if words["instants"] is not None and words["sample_time"] is not None:
        raise click.UsageError("--instants are the delays, --sample-time lets them be chosen: give one of them")
    if words["instants"] is not None and words["delays"] not in (None, len(words["instants"])):
        raise click.UsageError(f"--delays {words['delays']} contradicts --instants, which are {len(words['instants'])}")
    asked = prefilters.Asked(**words)
    if csv is not None and sweep is None:
        raise click.UsageError("--csv is the table of a sweep: give --sweep too")
    if save is not None and (sweep is not None or compare):
        raise click.UsageError("--save writes one filter, --sweep and --compare are about several: give one of them")
    if sweep is not None:
        if compare:
            raise click.UsageError("--sweep and --compare are two questions: give one of them")
        _swept(study, asked, sweep, plot, csv, as_json)
        return
    done = prefilters.designed(study, asked)
    if compare:
        from suite import prefilter_comparisons

        beside = prefilter_comparisons.compared(done)
        if plot is not None:
            prefilter_comparisons.draw(beside, plot)
        if as_json:
            print_json(beside.to_dict())
        else:
            console_prefilters.show_comparison(beside)
        return
    if plot is not None:
        prefilters.draw(done, plot)
    if save is not None:
        prefilters.save(done, save)
    if as_json:
        print_json(done.to_dict())
    else:
        console_prefilters.show_prefilter(done)


def _swept(study: Path, asked: Any, words: str, plot: Path | None, table: Path | None, as_json: bool) -> None:
    """`slewcert prefilter --sweep`."""
    from suite import console_prefilters, prefilter_sweeps

    try:
        over = prefilter_sweeps.parsed(words)
    except ValueError as problem:
        raise click.UsageError(f"--sweep {words}: {problem}") from None
    done = prefilter_sweeps.swept(study, asked, over)
    if plot is not None:
        prefilter_sweeps.draw(done, plot)
    if table is not None:
        prefilter_sweeps.write(done, table)
    if as_json:
        print_json(done.to_dict())
    else:
        console_prefilters.show_sweep(done)
    sys.exit(FAILED if all(one.prefilter is None for one in done.found) else 0)
