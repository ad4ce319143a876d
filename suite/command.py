"""What every command of the command line shares: exit codes, `--json`, and a user's mistakes as messages."""

from __future__ import annotations

import json
import sys
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any, Literal, ParamSpec, TypeVar

import click

from suite.outputs import refuse_overwriting, refuse_unwritable

P = ParamSpec("P")
R = TypeVar("R")

USAGE, INCONCLUSIVE, FAILED, INTERRUPTED = 2, 3, 1, 130
"""Exit codes other than 0: bad input; undecided, in error or incomplete; fail, differs or impossible; Ctrl-C."""

AS_JSON = click.option("--json", "as_json", is_flag=True, help="Write one JSON object to standard output and nothing else there.")


def harmless(text: str) -> str:
    """Text of a stranger's file for a terminal: control characters, which may move its cursor or worse, become replacement characters."""
    return "".join("\ufffd" if character not in "\n\t" and unicodedata.category(character)[0] == "C" else character for character in text)


@contextmanager
def search_errors() -> Iterator[None]:
    """What was asked for rightly and not found: a message and exit code 1, as for what is impossible; nothing is claimed of it."""
    from relaxations.errors import SolverError

    try:
        yield
    except SolverError as problem:
        click.echo(harmless(f"not found: {problem}"), err=True)
        sys.exit(FAILED)


@contextmanager
def user_errors() -> Iterator[None]:
    """A user's mistake becomes a message and exit code 2, never a traceback."""
    from fmus.errors import FmuError
    from relaxations.errors import ImpossibleShaperError, RelaxationsError
    from reports.errors import ReportError
    from suite.errors import SuiteError

    try:
        yield
    except ImpossibleShaperError as problem:
        click.echo(harmless(f"impossible: {problem}"), err=True)
        sys.exit(FAILED)
    except (SuiteError, FmuError, RelaxationsError, ReportError) as problem:
        click.echo(harmless(f"error: {problem}"), err=True)
        sys.exit(USAGE)
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        click.echo(f"error: {where}{problem.strerror or problem}", err=True)
        sys.exit(USAGE)
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        sys.exit(INTERRUPTED)


def guarded(function: Callable[P, R]) -> Callable[P, R]:
    """A command whose user's mistakes are told in words, and that overwrites nothing it reads and looks first where it will write."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        context = click.get_current_context()
        refuse_overwriting(context)
        refuse_unwritable(context)
        with user_errors():
            return function(*args, **kwargs)

    return run


def _choose_sandbox(context: click.Context, option: click.Parameter, value: Literal["none", "auto", "bwrap"]) -> None:
    from fmus.confinement import choose_sandbox

    with user_errors():
        choose_sandbox(value)


SANDBOX = click.option(
    "--sandbox",
    type=click.Choice(("none", "auto", "bwrap")),
    default="none",
    expose_value=False,
    callback=_choose_sandbox,
    help="Run the FMU's code in a sandbox (bubblewrap): none, the default; auto: where that works; bwrap: or not at all.",
)


def print_json(record: Mapping[str, Any]) -> None:
    """Write one JSON object to standard output."""
    click.echo(json.dumps(record, allow_nan=False))  # in ASCII, which holds paths of any bytes and passes through any terminal
