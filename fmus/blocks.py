"""A command or a shaper as the source of an FMU: its variables, and its numbers as tables for the C files in `sources/`.

A block is described like a plant without states. What it has beyond a plant: it jumps by itself (`events`), and a shaper remembers its
input (`memory`) and shows what is just before a communication point (`outputs_before`).
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from fmus.errors import BuildError
from fmus.plant_files import IDENTIFIER, RESERVED, PlantFile, PlantVariable
from relaxations.cancelling.prefilters import Prefilter
from relaxations.commands import Command
from relaxations.shaping.shapers import Shaper

HISTORY = 8192
"""How many changes of the reference a shaper remembers, unless it is said otherwise: 200 kB."""

FIELDS = ("before", "memory")  # of the C struct, beside the variables


@dataclass(frozen=True, slots=True)
class Signal:
    """What a block writes: the variable `name`, its unit with the exponents of the SI base units (None: not known), and its value at
    rest (in that unit), where it has been for all time before the start."""

    name: str
    unit: str = ""
    exponents: Mapping[str, float] | None = None
    rest: float = 0.0


@dataclass(frozen=True, slots=True)
class Block:
    """An FMU that is no plant: the C file `main` of `sources/` works on `constants`, the text of constants.h."""

    plant: PlantFile
    main: str
    constants: str
    headers: tuple[str, ...] = ()


def command_block(command: Command, name: str, signal: Signal) -> Block:
    """The FMU `name` that plays the command; parameters: `delay` [s], `scale` of its distance from rest, `rest`.

    Raises `BuildError` for a name or unit that is none.
    """
    variables = [
        PlantVariable(0, "delay", "parameter", "s", "How much later the command begins", start=0.0),
        PlantVariable(0, "scale", "parameter", "", "Factor of the command's distance from rest", start=1.0),
        PlantVariable(0, "rest", "parameter", signal.unit, "Output before the command begins", start=signal.rest),
        PlantVariable(0, signal.name, "output", signal.unit, "The command", is_output=True, depends=()),
    ]
    lasting = max((-10.0 / term.rate.real for term in command.tail.terms), default=0.0)
    stop = 1.5 * command.end + lasting or 1.0
    description = f"Plays a command of {len(command.segments)} segments in {command.maneuver_time:.9g} s, then its tail."
    numbers = {"END": command.end, "STEADY": command.tail.steady, "SEGMENTS": len(command.segments), "TERMS": len(command.tail.terms)}
    segments = [(s.start, s.level, s.slope) for s in command.segments]
    terms = [(t.rate.real, t.rate.imag, t.coefficient.real, t.coefficient.imag, t.power) for t in command.tail.terms]
    tables = [
        _table("struct { double start, level, slope; }", "SEGMENT", segments),
        _table("struct { double rate, frequency, real, imaginary; int power; }", "TERM", terms),
    ]
    plant = _plant(name, description, variables, signal, stop=stop, step=stop / 1000)
    return Block(plant, "command.c", _header(numbers, tables))


def shaper_block(
    shaper: Shaper | Prefilter, name: str, signal: Signal, *, reference: str = "reference", linear: bool = False, history: int = HISTORY
) -> Block:
    """The FMU `name` that shapes its input `reference` in real time; parameters: `rest`, and `linear`, which starts as given here.

    Between communication points the reference is held, or, if `linear`, a straight line over each step. `history` is how many
    changes of it within the shaper's duration are remembered. Of a pole-zero cancelling filter the reference has no unit here: its gains
    turn that of a plant's output into the signal's. Raises `BuildError` for a name, unit or history that is none.
    """
    if not 2 <= history <= 10**7:
        raise BuildError(f"a shaper remembers from 2 to 10000000 changes of its reference, not {history}")
    reading = "Between communication points the reference is a line over each step (true) or held (false)"
    is_filter = isinstance(shaper, Prefilter)
    unit = "" if is_filter else signal.unit
    variables = [
        PlantVariable(0, "rest", "parameter", unit, "Reference before the start", start=signal.rest),
        PlantVariable(0, "linear", "parameter", "", reading, boolean=True, start=float(linear)),
        PlantVariable(0, reference, "input", unit, "What is to be shaped", start=signal.rest),
        PlantVariable(0, signal.name, "output", signal.unit, "The reference, shaped", is_output=True),
    ]
    # Terms that begin together and decay alike are one filter; its states are their powers, from 0 up.
    powers: defaultdict[tuple[float, complex], dict[int, complex]] = defaultdict(lambda: defaultdict(complex))
    for term in shaper.terms:
        powers[term.start, term.rate][term.power] += term.coefficient
    filters: list[tuple[float, ...]] = []
    coefficients: list[tuple[float, ...]] = []
    for (start, rate), by_power in powers.items():
        count = max(by_power) + 1
        filters.append((start, rate.real, rate.imag, len(coefficients), count))
        coefficients += [(by_power[j].real, by_power[j].imag) for j in range(count)]
    numbers = {
        "DURATION": shaper.duration,
        "GAIN": shaper.gain if isinstance(shaper, Prefilter) else 1.0,
        "HISTORY": history,
        "IMPULSES": len(shaper.times),
        "PULSES": len(shaper.pulses),
        "FILTERS": len(filters),
        "FILTER_STATES": len(coefficients),
        "FILTER_POWERS": max((int(count) for *_, count in filters), default=1),
    }
    tables = [
        _table("struct { double time, amplitude; }", "IMPULSE", list(zip(shaper.times, shaper.amplitudes, strict=True))),
        _table("struct { double start, width, height; }", "PULSE", [(pulse.start, pulse.width, pulse.height) for pulse in shaper.pulses]),
        "typedef struct {\n    double start, rate, frequency;\n    int first, count; /* of its states */\n} Filter;",
        _table("Filter", "FILTER", filters),
        _table("struct { double real, imaginary; }", "COEFFICIENT", coefficients),
    ]
    length = float(shaper.duration) or 1.0
    parts = f"{len(shaper.pulses)} pulses" if shaper.pulses else f"{len(shaper.times)} impulses and {len(shaper.terms)} decaying terms"
    what = "Cancels a plant's poles and zeros in any reference" if is_filter else "Shapes any reference"
    description = f"{what} by {parts} within {shaper.duration:.9g} s."
    plant = _plant(name, description, variables, signal, stop=10.0 * length, step=length / 200)
    plant = replace(plant, interfaces=("CoSimulation",), step_hook=True, outputs_before=True, memory="shaper.h", input_derivatives=1)
    return Block(plant, "shaper.c", _header(numbers, tables), ("shaper.h",))


def model_name(text: str) -> str:
    """A model identifier made of any text, such as the name of a file."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if IDENTIFIER.fullmatch(name) else f"block_{name}"


def _plant(name: str, description: str, variables: Sequence[PlantVariable], signal: Signal, *, stop: float, step: float) -> PlantFile:
    if not IDENTIFIER.fullmatch(name):
        raise BuildError(f"{name!r} is no model identifier (a letter, then letters, digits and underscores)")
    names = [v.name for v in variables]
    for wrong in {n for n in names if not IDENTIFIER.fullmatch(n) or RESERVED.fullmatch(n) or n in FIELDS or names.count(n) > 1}:
        taken = ", ".join(["time", *FIELDS, *(v.name for v in variables if v.kind == "parameter")])
        raise BuildError(f"{wrong!r} is no name for a signal: it is a C identifier, no word of C, and none of {taken}")
    if not math.isfinite(signal.rest):
        raise BuildError(f"a signal rests at a finite value, not at {signal.rest!r}")
    if not signal.unit.isprintable() or "*/" in signal.unit:
        raise BuildError(f"{signal.unit!r} is no unit")
    clock = PlantVariable(0, "time", "time", "s", "Simulated time")
    units = {"s": {"s": 1.0}} | ({signal.unit: signal.exponents} if signal.unit else {})
    return PlantFile(
        name=name,
        title=name,
        description=description,
        version="1.0.0",
        tangent=False,
        step_hook=False,
        variable_step=True,
        stop=stop,
        step=step,
        units=units,
        variables=tuple(replace(v, reference=r) for r, v in enumerate([clock, *variables])),
        events=True,
    )


def _header(numbers: Mapping[str, float], tables: Sequence[str]) -> str:
    lines = ["/* Generated: the numbers of a command or shaper, in SI units. */", "#ifndef CONSTANTS_H", "#define CONSTANTS_H", ""]
    lines += [f"#define {name} {_literal(value)}" for name, value in numbers.items()]
    return "\n".join([*lines, "", *tables, "", "#endif", ""])


def _literal(value: float) -> str:
    """A number for C, which takes Python's shortest form but none of the names that other libraries print."""
    return repr(value if isinstance(value, int) else float(value))


def _table(kind: str, name: str, rows: Iterable[Sequence[float]]) -> str:
    # C knows no empty tables: one that is never looked at stands for none.
    entries = ["    {" + ", ".join(map(_literal, row)) + "}," for row in rows] or ["    {0},"]
    return "\n".join([f"static const {kind} {name}[] = {{", *entries, "};"])
