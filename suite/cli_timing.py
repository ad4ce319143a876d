"""`slewcert timing`: what a command leaves if its instants are not quite kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from suite.command import AS_JSON, SANDBOX, guarded, print_json


class _Seconds(click.FloatRange):
    """A finite number of seconds, 0 or more."""

    name = "SECONDS"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        number = super().convert(value, param, ctx)
        if not number < float("inf"):
            self.fail(f"{value!r} is no finite number of seconds", param, ctx)
        return number


SECONDS = _Seconds(0.0)


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--on-delay", type=SECONDS, default=0.0, help="Every thruster opens so much later than it should.")
@click.option("--off-delay", type=SECONDS, default=0.0, help="Every thruster closes so much later.")
@click.option("--jitter", type=SECONDS, default=0.0, help="Standard deviation of independent normal errors of every instant.")
@click.option("--within", type=SECONDS, default=0.0, help="No instant errs by more than this: what that leaves at worst, proven.")
@click.option("--reversals", type=click.Choice(["apart", "together"]), default="apart", show_default=True,
              help="apart: one thruster closes, another opens; together: one actuator makes every jump.")  # fmt: skip
@click.option("--samples", type=click.IntRange(2, 1_000_000), default=10_000, show_default=True, help="Draws of the jitter.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw it to this file (SVG).")
@SANDBOX
@AS_JSON
@guarded
def timing(
    study: Path,
    on_delay: float,
    off_delay: float,
    jitter: float,
    within: float,
    reversals: str,
    samples: int,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """What STUDY's command leaves of each mode, and of rest, if thrusters open and close late or not quite when they should.

    Times are in seconds. Without options: what each instant does, to first order. Exit code 0: done; 2: bad input, such as a command with
    slopes or a tail.
    """
    from suite import timing_text
    from suite.loading import load_study
    from suite.timings import Asked, study_timing

    if plot:
        timing_text.drawable(plot)
    done = study_timing(load_study(study), Asked(on_delay, off_delay, jitter, within, reversals == "together", samples, seed))
    if plot:
        timing_text.draw(done, plot)
    if as_json:
        print_json(done.to_dict() | {"files": [] if plot is None else [str(plot)]})
    else:
        timing_text.show(done, plot)
