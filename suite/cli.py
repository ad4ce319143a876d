"""The command line `slewcert`: one thin layer over the library; what is heavy is imported where it is used."""

from __future__ import annotations

import io
import os
import sys
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import click

from suite.cli_fmus import fmus
from suite.cli_prefilter import prefilter
from suite.cli_tables import fuel, table, tradeoff
from suite.cli_timing import timing
from suite.command import AS_JSON, FAILED, INCONCLUSIVE, SANDBOX, USAGE, guarded, harmless, print_json, search_errors


class _Positive(click.FloatRange):
    """A finite number above 0; a range of numbers alone lets nan pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{value!r} is no number; valid are numbers above 0 and at most {self.max:g}", param, ctx)
        return number


POSITIVE = _Positive(0.0, 1e150, min_open=True)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="slewcert", prog_name="slewcert")
def main() -> None:
    """Move flexible machines fast, and say how fast that can be: design, co-simulate, judge, leave evidence."""
    for stream in (sys.stdout, sys.stderr):  # a sign that the terminal lacks becomes "?", not a traceback
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


@main.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Evidence folder; default: NAME-evidence in the current folder."
)
@click.option("--jobs", type=click.IntRange(1, 256), default=lambda: os.cpu_count() or 1, show_default="cores", help="Runs at a time.")
@click.option("--resume", is_flag=True, help="Go on with a campaign that was cut short.")
@click.option("--force", is_flag=True, help="Replace an evidence folder that exists.")
@SANDBOX
@AS_JSON
@guarded
def verify(study: Path, out: Path | None, jobs: int, resume: bool, force: bool, as_json: bool) -> None:
    """Design the command of STUDY, run it on the plant's FMU over the parameter range, judge every requirement, leave evidence.

    Exit code 0: all requirements pass; 1: one fails; 2: bad input; 3: undecided or in error.
    """
    from suite import console
    from suite.loading import load_study
    from suite.verdicts import Verdict
    from suite.verification import verify as run

    if resume and force:
        raise click.UsageError("--resume goes on with what --force would replace: give one of them")
    asked = load_study(study)
    folder = out or Path(f"{study.stem}-evidence")
    with console.progress(f"co-simulating {asked.file.name}") as shown:
        done = run(asked, folder, jobs=jobs, resume=resume, force=force, progress=shown)
    if as_json:
        print_json(console.verification_record(done))
    else:
        console.show_verification(done)
    sys.exit({Verdict.PASS: 0, Verdict.FAIL: FAILED}.get(done.verdict, INCONCLUSIVE))


@main.command()
@click.argument("paths", nargs=-1, required=True, metavar="STUDY|FOLDER...", type=click.Path(exists=True, path_type=Path))
@click.option("--shaper", "kinds", multiple=True, metavar="KIND", help="Compare the study with these shapers; one or several.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the page, and for the evidence of studies."
)
@click.option("--jobs", type=click.IntRange(1, 256), default=lambda: os.cpu_count() or 1, show_default="cores", help="Runs at a time.")
@click.option("--force", is_flag=True, help="Replace evidence folders that exist.")
@SANDBOX
@AS_JSON
@guarded
def compare(paths: tuple[Path, ...], kinds: tuple[str, ...], out: Path, jobs: int, force: bool, as_json: bool) -> None:
    """Compare commands for one machine in one report: evidence folders as they are, studies once they are verified.

    Exit code 0: compared, whatever the verdicts; 2: bad input.
    """
    from suite import comparison, console, console_shapers

    with console.progress("comparing") as shown:
        done = comparison.compare(paths, kinds, out, jobs=jobs, force=force, about=lambda name: shown.advance())
    if as_json:
        print_json(done.record)
    else:
        console_shapers.show_comparison(done)


@main.command()
@click.argument("studies", nargs=-1, required=True, metavar="STUDY...", type=click.Path(path_type=Path))
@click.option("--certificate", type=click.Path(path_type=Path), help="Write the proof to this file; of several studies, into this folder.")
@SANDBOX
@AS_JSON
@guarded
def bound(studies: tuple[Path, ...], certificate: Path | None, as_json: bool) -> None:
    """Bracket the minimum time of each STUDY (or of every study in a folder) from both sides, with a proof; nothing is co-simulated.

    Exit code 0: proved or bracketed; 1: no command can do it; 2: bad input.
    """
    from suite import console
    from suite.collection import bracket, collect

    files = collect(studies)
    single = len(files) == 1 and not studies[0].is_dir()
    if certificate is not None and certificate.exists() and certificate.is_dir() == single:
        what = "is a folder; name a file" if single else "is a file; the proofs of several studies go into a folder"
        raise click.UsageError(f"--certificate {certificate}: {what}")
    if single:
        done = bracket(files[0], certificate)
        if as_json:
            print_json(done.to_dict())
        else:
            console.show_bound(done)
        sys.exit(FAILED if done.impossible else 0)
    table = []
    with console.progress("bracketing", len(files)) as shown:
        for file in files:
            table.append(bracket(file, None if certificate is None else certificate / f"{file.stem}.certificate.json"))
            shown.advance()
    if as_json:
        print_json({"studies": [{"study": str(done.study.file), **done.to_dict()} for done in table]})
    else:
        console.show_collection(table)


@main.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--study", type=click.Path(exists=True, path_type=Path), help="Confirm that the certificates are about this study.")
@AS_JSON
@guarded
def check(files: tuple[Path, ...], study: Path | None, as_json: bool) -> None:
    """Verify certificates, or those of evidence folders, independently of the solver, and print what they claim.

    Exit code 0: proved; 1: refuted, or about another study; 2: malformed; 3: inconclusive.
    Of several files the worst counts, in the order 2, 1, 3, 0.
    """
    from suite.checks import ORDER, check_path

    done = [check_path(path, study) for path in files]
    if as_json:
        records = [checked.to_dict() for checked in done]
        print_json(records[0] if len(records) == 1 else {"files": [{"file": str(c.path), **r} for c, r in zip(done, records, strict=True)]})
    else:
        click.echo("\n\n".join("\n".join(checked.lines()) for checked in done))
    sys.exit(min((checked.exit_code for checked in done), key=ORDER.index))


@main.command()
@click.argument("fmu")
@click.argument("command", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--input", "driven", required=True, metavar="NAME", help="The FMU's input that the command drives.")
@click.option("--output", "moved", required=True, metavar="NAME", help="The FMU's output that is measured.")
@click.option("--log", type=click.Path(path_type=Path, dir_okay=False), metavar="RUN.mcap", help="Write the run's log to this file.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=VALUE", help="Start value of a parameter, with a unit if you like.")
@click.option("--stop", type=POSITIVE, help="When the run ends [s]; default: when the slowest mode has shown itself, or decayed.")
@click.option("--step", type=POSITIVE, help="Communication step [s]; default: a fiftieth of the fastest period.")
@click.option("--interface", type=click.Choice(["co-simulation", "model-exchange"]), help="Default: co-simulation, if the FMU offers it.")
@click.option("--timeout", type=POSITIVE, default=60.0, show_default=True, help="Wall-clock time that a run may take [s].")
@click.option("--convergence", is_flag=True, help="Refine the run four times and show how its output changes.")
@SANDBOX
@AS_JSON
@guarded
def simulate(
    fmu: str,
    command: Path,
    driven: str,
    moved: str,
    log: Path | None,
    parameters: tuple[str, ...],
    stop: float | None,
    step: float | None,
    interface: Any,
    timeout: float,
    convergence: bool,
    as_json: bool,
) -> None:
    """Run the command file COMMAND on FMU (a file, or a shipped plant) in a process of its own.

    Exit code 0: it ran; 2: bad input; 3: the FMU failed.
    """
    from suite import console
    from suite.simulation import Request
    from suite.simulation import simulate as run

    given = dict(map(_assignment, parameters))
    request = Request(fmu, command, driven, moved, given, stop, step, interface, timeout)
    done = run(request, log, convergence)
    if as_json:
        print_json(done.to_dict())
    else:
        console.show_simulated(done, moved)
    sys.exit(0 if done.status.complete else INCONCLUSIVE)


def _assignment(text: str) -> tuple[str, Decimal | str]:
    name, equals, value = text.rpartition("=")
    from suite.study_units import is_with_unit

    if equals and name and is_with_unit(value):
        return name, value
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not (equals and name and number.is_finite()):
        raise click.UsageError(
            f'--parameter {text}: must be NAME=VALUE with a finite number, such as stiffness=1.2, or one with a unit: "stiffness=1.2 N/mm"'
        )
    return name, number


@main.command()
@click.argument("path", type=click.Path(path_type=Path))
@AS_JSON
@guarded
def review(path: Path, as_json: bool) -> None:
    """Compute every quantity again from a log RUN.mcap or an evidence folder, and compare with what was recorded.

    Exit code 0: confirmed; 1: it differs, or was tampered with; 2: bad input; 3: incomplete.
    """
    from suite import console
    from suite.review import ReviewStatus
    from suite.review import review as run

    done = run(path)
    if as_json:
        print_json(done.to_dict())
        for finding in done.findings:
            click.echo(finding, err=True)
    else:
        console.show_review(done)
    sys.exit({ReviewStatus.CONFIRMED: 0, ReviewStatus.INCOMPLETE: INCONCLUSIVE}.get(done.status, FAILED))


class _Settling(click.ParamType[float]):
    """A time in seconds, or `rest`."""

    name = "SECONDS|rest"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Seconds; infinite for `rest`."""
        if value == "rest":
            return float("inf")
        try:
            time = float(str(value))
        except ValueError:
            time = -1.0
        if not 0.0 <= time < float("inf"):
            self.fail(f"{value!r} is neither a time in seconds nor 'rest'", param, ctx)
        return time


@main.command()
@click.argument("fmu")
@click.option("--input", "entry", required=True, metavar="NAME", help="The input that is moved.")
@click.option("--output", required=True, metavar="NAME", help="The output that is looked at.")
@click.option(
    "--method", type=click.Choice(["auto", "derivatives", "differences", "identified"]), default="auto", show_default=True, help="How."
)
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter, a state's start value, or the input at rest.")
@click.option("--at", type=_Settling(), default=0.0, help="Let it settle for so long, or until it rests; default: where it starts.")
@click.option("--step", type=POSITIVE, help="Communication step [s]; default: the FMU's.")
@SANDBOX
@AS_JSON
@guarded
def linearize(
    fmu: str, entry: str, output: str, method: str, settings: tuple[str, ...], at: float, step: float | None, as_json: bool
) -> None:
    """The linear plant of FMU (a file, or a plant shipped here) about where it rests: poles, zeros, modes, and how far to trust them.

    Exit code 0: done; 2: bad input, or the FMU does not rest there; 3: the FMU fails.
    """
    from fmus.errors import LinearizationError
    from suite import console
    from suite.linear import Request, linear

    try:
        found = linear(Request(fmu, entry, output, settings, method, at, step))  # type: ignore[arg-type] # click has checked the method
    except LinearizationError as problem:
        click.echo(harmless(f"error: {problem}"), err=True)
        sys.exit(USAGE if problem.status is None else INCONCLUSIVE)
    if as_json:
        print_json(found.to_dict())
    else:
        console.show_linear(found)


@main.command()
@click.argument("kind")
@click.option("--mode", "modes", multiple=True, metavar="FREQUENCY(Hz|rad/s):DAMPING", help="A mode, such as 1.0Hz:0.05; one or several.")
@click.option(
    "--decay",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Take the modes from a measured decay: a table (CSV; times first) or a log (MCAP).",
)
@click.option("--signal", metavar="NAME", help="Which column, variable, or /topic.field of JSON messages of the decay.")
@click.option("--from", "begin", type=float, help="Seconds: where the decay begins; default: the start, or where a log's command ends.")
@click.option("--until", type=float, help="Seconds: where it ends.")
@click.option("--tolerance", type=float, default=0.05, show_default=True, help="Residual vibration allowed, a fraction of the unshaped.")
@click.option(
    "--band",
    multiple=True,
    metavar="LOW:HIGH[@TOLERANCE]",
    help="Frequencies, as factors of the mode's; one, or one for each mode, or several for one mode; default: 0.8:1.2.",
)
@click.option(
    "--damping", metavar="LOW:HIGH", help="Damping ratios of the worst case, and those that si is designed for; default: the mode's."
)
@click.option("--negative", type=float, help="Size of the negative amplitude (sna-zv).")
@click.option("--sums", metavar="LOW:HIGH", help="Bounds of the partial sums (sums-zv).")
@click.option("--sample-time", type=float, help="Seconds: impulses, or pulses of one height, begin at its multiples only.")
@click.option("--pulse", type=float, help="Seconds: draw every impulse out to a pulse of this width.")
@click.option("--height", type=float, help="1/s: height of the pulses (pulses-zv).")
@click.option("--impulses", metavar="INSTANT:AMPLITUDE,…|FILE.json", help="The impulses of a custom shaper.")
@click.option("--deflection", type=float, help="How far a mode may stray from the shaped step, of an unshaped one's (dl-zv).")
@click.option("--simultaneous", is_flag=True, help="One solution for all modes, not one shaper after the other.")
@click.option("--move", type=float, help="Design a move by this much together with the shaper; the rest is in the same unit.")
@click.option("--input", metavar="LOW:HIGH", help="Limits of the move's input: its acceleration, or speed with --order 1.")
@click.option("--order", type=click.IntRange(1, 2), default=2, show_default=True, help="Of the body: 2, accelerated; 1, driven by speed.")
@click.option("--command", "command", type=click.Path(dir_okay=False, path_type=Path), help="Write that move's command to this file.")
@click.option("--certificate", type=click.Path(dir_okay=False, path_type=Path), help="Write the proof of its time to this file.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw sensitivity and step response to this file (.svg).")
@click.option("--export", "exports", multiple=True, type=click.Path(dir_okay=False, path_type=Path),
              help="Write it for others: .cfg (Klipper), .g (RepRapFirmware), .h (C).")  # fmt: skip
@click.option("--save", type=click.Path(dir_okay=False, path_type=Path), help="Write a shaper file, for `slewcert fmus export`.")
@click.option(
    "--reference",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Shape this: a command or spline file (JSON), or a table of samples (CSV; times first).",
)
@click.option(
    "--shaped", type=click.Path(dir_okay=False, path_type=Path), help="Write what becomes of it: .json, or .csv of a spline or samples."
)
@AS_JSON
@guarded
def shaper(
    as_json: bool,
    plot: Path | None,
    exports: tuple[Path, ...],
    save: Path | None,
    command: Path | None,
    certificate: Path | None,
    reference: Path | None,
    shaped: Path | None,
    **words: Any,
) -> None:
    """Make a shaper of KIND for one or several modes, and prove its worst residual vibration over a box of frequency and damping.

    Exit code 0: done; 1: there is no such shaper, or none was found; 2: bad input.
    """
    from suite import console_shapers, shaper_files, shaper_references, shaping

    pulses = words["pulse"] is not None or words["height"] is not None
    wrong = [
        *shaper_files.mistakes(exports, (command, certificate), words["move"], pulses, plot),
        *shaper_references.mistakes(reference, shaped),
    ]
    given = shaper_references.reference_of(reference, wrong)
    with search_errors(), console_shapers.searching(f"{words['kind']}: searching for it, proving it"):
        done = shaping.design(shaping.Asked(**words), wrong)
    further = []
    if given is not None and shaped is not None:
        found, content = shaper_references.shaped_file(given, done.shaper, shaped)
        done, further = replace(done, shaped=found), [(shaped, content)]
    done = replace(done, notes=(*done.notes, *shaper_files.firmware_notes(done, exports)))
    shaper_files.write(done, exports, save, command, certificate, plot, further)
    if as_json:
        print_json(done.to_dict())
    else:
        console_shapers.show_shaper(done)


main.add_command(fmus)
main.add_command(prefilter)
main.add_command(table)
main.add_command(tradeoff)
main.add_command(fuel)
main.add_command(timing)
