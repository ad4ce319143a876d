"""The command line `slewcert`: one thin layer over the library; what is heavy is imported where it is used."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from decimal import Decimal, InvalidOperation
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import click

P = ParamSpec("P")
R = TypeVar("R")

USAGE, INCONCLUSIVE, FAILED, INTERRUPTED = 2, 3, 1, 130
"""Exit codes other than 0: bad input; undecided, in error or incomplete; fail, differs or impossible; Ctrl-C."""

POSITIVE = click.FloatRange(0.0, 1e150, min_open=True)
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Write one JSON object to standard output and nothing else there.")


def _choose_sandbox(context: click.Context, option: click.Parameter, value: Literal["none", "auto", "bwrap"]) -> None:
    from fmus.confinement import choose_sandbox

    with _user_errors():
        choose_sandbox(value)


SANDBOX = click.option(
    "--sandbox",
    type=click.Choice(("none", "auto", "bwrap")),
    default="none",
    expose_value=False,
    callback=_choose_sandbox,
    help="Run the FMU's code in a sandbox (bubblewrap): none, the default; auto: where that works; bwrap: or not at all.",
)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="slewcert", prog_name="slewcert")
def main() -> None:
    """Move flexible machines fast, and say how fast that can be: design, co-simulate, judge, leave evidence."""
    for stream in (sys.stdout, sys.stderr):  # a sign that the terminal lacks becomes "?", not a traceback
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextmanager
def _user_errors() -> Iterator[None]:
    """A user's mistake becomes a message and exit code 2, never a traceback."""
    from fmus.errors import FmuError
    from relaxations.errors import ImpossibleShaperError, RelaxationsError
    from reports.errors import ReportError
    from suite.errors import SuiteError

    try:
        yield
    except ImpossibleShaperError as problem:
        click.echo(f"impossible: {problem}", err=True)
        sys.exit(FAILED)
    except (SuiteError, FmuError, RelaxationsError, ReportError) as problem:
        click.echo(f"error: {problem}", err=True)
        sys.exit(USAGE)
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        click.echo(f"error: {where}{problem.strerror or problem}", err=True)
        sys.exit(USAGE)
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        sys.exit(INTERRUPTED)


def _guarded(function: Callable[P, R]) -> Callable[P, R]:
    @wraps(function)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
        with _user_errors():
            return function(*args, **kwargs)

    return guarded


@main.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Evidence folder; default: NAME-evidence in the current folder.")
@click.option("--jobs", type=click.IntRange(1, 256), default=lambda: os.cpu_count() or 1, show_default="cores", help="Runs at a time.")
@click.option("--resume", is_flag=True, help="Go on with a campaign that was cut short.")
@click.option("--force", is_flag=True, help="Replace an evidence folder that exists.")
@SANDBOX
@AS_JSON
@_guarded
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
        _print_json(console.verification_record(done))
    else:
        console.show_verification(done)
    sys.exit({Verdict.PASS: 0, Verdict.FAIL: FAILED}.get(done.verdict, INCONCLUSIVE))


@main.command()
@click.argument("studies", nargs=-1, required=True, metavar="STUDY...", type=click.Path(path_type=Path))
@click.option("--certificate", type=click.Path(path_type=Path), help="Write the proof to this file; of several studies, into this folder.")
@SANDBOX
@AS_JSON
@_guarded
def bound(studies: tuple[Path, ...], certificate: Path | None, as_json: bool) -> None:
    """Bracket the minimum time of each STUDY (or of every study in a folder) from both sides, with a proof; nothing is co-simulated.

    Exit code 0: proved or bracketed; 1: no command can do it; 2: bad input.
    """
    from suite import console
    from suite.collection import bracket, collect

    files = collect(studies)
    if len(files) == 1 and not studies[0].is_dir():
        done = bracket(files[0], certificate)
        if as_json:
            _print_json(done.to_dict())
        else:
            console.show_bound(done)
        sys.exit(FAILED if done.impossible else 0)
    table = []
    with console.progress("bracketing", len(files)) as shown:
        for file in files:
            table.append(bracket(file, None if certificate is None else certificate / f"{file.stem}.certificate.json"))
            shown.advance()
    if as_json:
        _print_json({"studies": [{"study": str(done.study.file), **done.to_dict()} for done in table]})
    else:
        console.show_collection(table)


@main.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--study", type=click.Path(path_type=Path), help="Confirm that the certificates are about this study.")
@AS_JSON
@_guarded
def check(files: tuple[Path, ...], study: Path | None, as_json: bool) -> None:
    """Verify certificates, or those of evidence folders, independently of the solver, and print what they claim.

    Exit code 0: proved; 1: refuted, or about another study; 2: malformed; 3: inconclusive.
    Of several files the worst counts, in the order 2, 1, 3, 0.
    """
    from suite.checks import ORDER, check_path

    done = [check_path(path, study) for path in files]
    if as_json:
        records = [checked.to_dict() for checked in done]
        _print_json(
            records[0] if len(records) == 1 else {"files": [{"file": str(c.path), **r} for c, r in zip(done, records, strict=True)]}
        )
    else:
        click.echo("\n\n".join("\n".join(checked.lines()) for checked in done))
    sys.exit(min((checked.exit_code for checked in done), key=ORDER.index))


@main.command()
@click.argument("fmu")
@click.argument("command", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--input", "driven", required=True, metavar="NAME", help="The FMU's input that the command drives.")
@click.option("--output", "moved", required=True, metavar="NAME", help="The FMU's output that is measured.")
@click.option("--log", type=click.Path(path_type=Path, dir_okay=False), metavar="RUN.mcap", help="Write the run's log to this file.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=VALUE", help="Start value of a parameter; may be repeated.")
@click.option("--stop", type=POSITIVE, help="When the run ends [s]; default: when the slowest mode has shown itself, or decayed.")
@click.option("--step", type=POSITIVE, help="Communication step [s]; default: a fiftieth of the fastest period.")
@click.option("--interface", type=click.Choice(["co-simulation", "model-exchange"]), help="Default: co-simulation, if the FMU offers it.")
@click.option("--timeout", type=POSITIVE, default=60.0, show_default=True, help="Wall-clock time that a run may take [s].")
@click.option("--convergence", is_flag=True, help="Refine the run four times and show how its output changes.")
@AS_JSON
@_guarded
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
        _print_json(done.to_dict())
    else:
        console.show_simulated(done, moved)
    sys.exit(0 if done.status.complete else INCONCLUSIVE)


def _assignment(text: str) -> tuple[str, Decimal]:
    name, equals, value = text.rpartition("=")
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not (equals and name and number.is_finite()):
        raise click.UsageError(f"--parameter {text}: must be NAME=VALUE with a finite number, such as stiffness=1.2")
    return name, number


@main.command()
@click.argument("path", type=click.Path(path_type=Path))
@AS_JSON
@_guarded
def review(path: Path, as_json: bool) -> None:
    """Compute every quantity again from a log RUN.mcap or an evidence folder, and compare with what was recorded.

    Exit code 0: confirmed; 1: it differs, or was tampered with; 2: bad input; 3: incomplete.
    """
    from suite import console
    from suite.review import ReviewStatus
    from suite.review import review as run

    done = run(path)
    if as_json:
        _print_json(done.to_dict())
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
@click.option("--step", type=click.FloatRange(0.0, min_open=True), help="Communication step [s]; default: the FMU's.")
@AS_JSON
@_guarded
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
        click.echo(f"error: {problem}", err=True)
        sys.exit(USAGE if problem.status is None else INCONCLUSIVE)
    if as_json:
        _print_json(found.to_dict())
    else:
        console.show_linear(found)


@main.command()
@click.argument("kind")
@click.option("--mode", "modes", multiple=True, metavar="FREQUENCY(Hz|rad/s):DAMPING", help="A mode, such as 1.0Hz:0.05; one or several.")
@click.option("--tolerance", type=float, default=0.05, show_default=True, help="Residual vibration allowed, a fraction of the unshaped.")
@click.option("--band", metavar="LOW:HIGH", default="0.8:1.2", show_default=True, help="Frequencies, as factors of the mode's.")
@click.option("--damping", metavar="LOW:HIGH", help="Damping ratios of the worst case; default: the mode's.")
@click.option("--negative", type=float, help="Size of the negative amplitude (sna-zv).")
@click.option("--sums", metavar="LOW:HIGH", help="Bounds of the partial sums (sums-zv).")
@click.option("--sample-time", type=float, help="Seconds: impulses at its multiples only (zv-d:N).")
@click.option("--simultaneous", is_flag=True, help="One solution for all modes, not one shaper after the other.")
@click.option("--plot", type=click.Path(path_type=Path), help="Draw sensitivity and step response to this file (SVG).")
@click.option("--export", "exports", multiple=True, type=click.Path(path_type=Path),
              help="Write it for others: .cfg (Klipper), .g (RepRapFirmware), .h (C).")  # fmt: skip
@click.option("--save", type=click.Path(path_type=Path), help="Write a shaper file, for `slewcert fmus export`.")
@AS_JSON
@_guarded
def shaper(as_json: bool, plot: Path | None, exports: tuple[Path, ...], save: Path | None, **words: Any) -> None:
    """Make a shaper of KIND for one or several modes, and prove its worst residual vibration over a box of frequency and damping.

    Exit code 0: done; 1: there is no such shaper; 2: bad input.
    """
    from suite import console, shaping

    shaping.known(exports)
    done = shaping.design(shaping.Asked(**words))
    for path in exports:
        shaping.export(done, path)
    if save:
        shaping.save(done, save)
    if plot:
        shaping.draw(done, plot)
    if as_json:
        _print_json(done.to_dict())
    else:
        console.show_shaper(done)


@main.group()
def fmus() -> None:
    """Plants shipped here, and FMUs in general."""


@fmus.command("list")
@AS_JSON
@_guarded
def fmus_list(as_json: bool) -> None:
    """List the plants shipped here: domain, input and output, poles and zeros."""
    from fmus.catalogue import catalogue
    from suite import console

    plants = catalogue()
    if as_json:
        _print_json(console.catalogue_record(plants))
    else:
        console.show_catalogue(plants)


@fmus.command("build")
@click.argument("names", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the FMUs; default: the cache that studies use.")
@AS_JSON
@_guarded
def fmus_build(names: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """Build the FMUs (FMI 2.0 and 3.0) of the plants NAMES, or of all that are shipped; chain_6 is the chain with six masses."""
    from concurrent.futures import ThreadPoolExecutor

    from fmus.build import build, is_shipped, shipped
    from fmus.compiling import FmiVersion

    unknown = sorted(name for name in names if "." in name or not is_shipped(name))
    if unknown:
        raise click.UsageError(f"no such plant: {', '.join(unknown)}; there are {', '.join(shipped())}")
    versions: tuple[FmiVersion, ...] = ("2.0", "3.0")
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # the work is the compiler's, in processes of its own
        wanted = [(name, version) for name in names or shipped() for version in versions]
        built = list(pool.map(lambda each: build(each[0], each[1], out), wanted))
    if as_json:
        _print_json({"fmus": [str(path) for path in built]})
    else:
        click.echo("\n".join(map(str, built)))


@fmus.command("export")
@click.argument("source", metavar="COMMAND_OR_SHAPER", type=click.Path(path_type=Path))
@click.option("--fmi", type=click.Choice(["2", "3", "both"]), help="FMI version; default: both, with --ssp the plant's.")
@click.option("--out", type=click.Path(path_type=Path), help="File (.fmu, .ssp) or folder; default: the current folder.")
@click.option("--name", help="The model's name; default: the file's.")
@click.option("--output", metavar="NAME", help="Its output; default: u of a command, shaped of a shaper.")
@click.option("--unit", help="Unit of input and output; default: none, with --ssp the plant's.")
@click.option("--rest", type=float, help="Where the input rests before; default: 0, with --ssp the start value of the plant's input.")
@click.option("--linear", is_flag=True, help="A shaper reads its reference as a line over each step, not as held (its parameter `linear`).")
@click.option("--history", type=int, help="How many changes of its reference a shaper remembers; default: 8192.")
@click.option("--platform", "platforms", multiple=True, type=click.Choice(["linux64", "win64", "darwin64", "all"]),
              help="What to compile for; default: all with ziglang, else this machine.")  # fmt: skip
@click.option("--ssp", "plant", metavar="PLANT", help="Write an .ssp with this plant: an .fmu or one that is shipped here.")
@click.option("--input", metavar="NAME", help="The plant's input, for --ssp; default: its only one.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
@AS_JSON
@_guarded
def fmus_export(source: Path, as_json: bool, **options: Any) -> None:
    """Write a command or shaper file as a co-simulation FMU with sources and libraries, to run it anywhere."""
    from suite.taking_away import Wanted, take_away

    if options["input"] and not options["plant"]:
        raise click.UsageError("--input is an input of the plant: name that with --ssp")
    done = take_away(source, Wanted(**{key: value for key, value in options.items() if value is not None}))
    if as_json:
        _print_json(done.to_dict())
    else:
        for path, made in done.files:
            click.echo(f"{path}: FMI {made.fmi_version} for {', '.join(made.platforms)}")
        if done.note:
            click.echo(done.note, err=True)


@fmus.command("inspect")
@click.argument("file", type=click.Path(path_type=Path))
@AS_JSON
@_guarded
def fmus_inspect(file: Path, as_json: bool) -> None:
    """Tell what the FMU in FILE holds, and what would prevent a run of it here; none of its code is loaded.

    Exit code 0: it can be run here; 1: something prevents that; 2: bad input, an FMU that is refused everywhere.
    """
    from fmus.inspection import inspect
    from suite import console
    from suite.inspecting import inspection_record

    found = inspect(file)
    if as_json:
        _print_json(inspection_record(found))
    else:
        console.show_inspection(found)
    sys.exit(FAILED if found.obstacles else 0)


def _print_json(record: Mapping[str, Any]) -> None:
    click.echo(json.dumps(record, allow_nan=False))  # in ASCII, which holds paths of any bytes and passes through any terminal
