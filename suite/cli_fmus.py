"""`slewcert fmus`: the plants shipped here, and what can be done with any FMU file."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from suite.command import AS_JSON, FAILED, guarded, print_json


@click.group()
def fmus() -> None:
    """Plants shipped here, and FMUs in general."""


@fmus.command("list")
@AS_JSON
@guarded
def fmus_list(as_json: bool) -> None:
    """List the plants shipped here: domain, input and output, poles and zeros."""
    from fmus.catalogue import catalogue
    from suite import console

    plants = catalogue()
    if as_json:
        print_json(console.catalogue_record(plants))
    else:
        console.show_catalogue(plants)


@fmus.command("build")
@click.argument("names", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the FMUs; default: the cache that studies use.")
@AS_JSON
@guarded
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
        print_json({"fmus": [str(path) for path in built]})
    else:
        click.echo("\n".join(map(str, built)))


@fmus.command("export")
@click.argument("source", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--fmi", type=click.Choice(["2", "3", "both"]), help="FMI version; default: both, with --ssp the plant's.")
@click.option("--out", type=click.Path(path_type=Path), help="File (.fmu, .ssp) or folder; default: the current folder.")
@click.option("--name", help="The model's name; default: the file's.")
@click.option("--output", metavar="NAME", help="Its output; default: u of a command, else shaped.")
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
@guarded
def fmus_export(source: Path, as_json: bool, **options: Any) -> None:
    """Write FILE, a command, shaper or pole-zero cancelling filter, as a co-simulation FMU with sources and libraries."""
    from suite.taking_away import Wanted, take_away

    if options["input"] and not options["plant"]:
        raise click.UsageError("--input is an input of the plant: name that with --ssp")
    done = take_away(source, Wanted(**{key: value for key, value in options.items() if value is not None}))
    if as_json:
        print_json(done.to_dict())
    else:
        for path, made in done.files:
            click.echo(f"{path}: FMI {made.fmi_version} for {', '.join(made.platforms)}")
        if done.note:
            click.echo(done.note, err=True)


@fmus.command("inspect")
@click.argument("file")
@AS_JSON
@guarded
def fmus_inspect(file: str, as_json: bool) -> None:
    """Tell what the FMU in FILE (or a plant shipped here) holds, and what would prevent a run of it here; none of its code is loaded.

    Exit code 0: it can be run here; 1: something prevents that; 2: bad input, an FMU that is refused everywhere.
    """
    from fmus.inspection import inspect
    from suite import console
    from suite.inspecting import inspection_record
    from suite.taking_away import plant_path

    found = inspect(plant_path(file))
    if as_json:
        print_json(inspection_record(found))
    else:
        console.show_inspection(found)
    sys.exit(FAILED if found.obstacles else 0)
