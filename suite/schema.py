"""The shape of a study file: every section, every key, the type and range of each value. The only module that knows pydantic.

Sections here hold what is *written*; `suite.study_meaning` turns them into what is *meant*. Each section (and each item of an array of
tables) is validated by itself, so that a mistake in one hides none in another.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, StrictBool, TypeAdapter, ValidationError

from suite import values
from suite.errors import ABSENT, Mistake
from suite.suggestions import did_you_mean, nearest

Number = Annotated[Decimal, BeforeValidator(values.number)]
Nonzero = Annotated[Number, AfterValidator(values.nonzero)]
Positive = Annotated[Number, AfterValidator(values.positive)]
NonNegative = Annotated[Number, AfterValidator(values.non_negative)]
Fraction = Annotated[Number, AfterValidator(values.fraction)]
Whole = Annotated[int, BeforeValidator(values.whole)]
Natural = Annotated[Whole, AfterValidator(values.natural)]
Count = Annotated[Whole, AfterValidator(values.count)]
ProfileType = Annotated[Whole, AfterValidator(values.profile_type)]
Samples = Annotated[Count, AfterValidator(values.samples)]
Text = Annotated[str, BeforeValidator(values.text)]
Interval = Annotated[tuple[Number, Number], BeforeValidator(values.pair), AfterValidator(values.ascending)]
Numbers = Annotated[tuple[Number, ...], BeforeValidator(values.items)]
Roots = Annotated[tuple[Annotated[tuple[Decimal, Decimal], BeforeValidator(values.root)], ...], BeforeValidator(values.items)]
State = Annotated[tuple[Decimal, ...] | dict[str, Decimal], BeforeValidator(values.state)]
Named = BeforeValidator(values.table)


class Section(BaseModel):
    """A table of the study file: unknown keys are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)


class Mode(Section):
    """`gain/(s² + 2ζωs + ω²)`."""

    frequency: Positive  # ω [rad/s]
    damping: Number = Decimal(0)  # ζ
    gain: Nonzero


class Initial(Section):
    """The operating point."""

    state: State | None = None
    input: Number | None = None
    settle: Annotated[bool | Decimal, BeforeValidator(values.settle)] | None = None  # [s], or until at rest


class Identification(Section):
    """What of an identification is not chosen automatically."""

    step: Positive | None = None
    samples: Annotated[Count, AfterValidator(values.response_samples)] | None = None
    amplitude: Positive | None = None
    order: Natural | None = None


class Schedule(Section):
    """How the plant varies while it moves: instants, and for a plant given as numbers its matrices there."""

    times: Numbers  # [s] after the start of the move, ascending from more than 0
    A: Annotated[tuple[Annotated[tuple[Numbers, ...], BeforeValidator(values.items)], ...], BeforeValidator(values.items)] | None = None
    B: Annotated[tuple[Numbers, ...], BeforeValidator(values.items)] | None = None
    C: Annotated[tuple[Numbers, ...], BeforeValidator(values.items)] | None = None


class Plant(Section):
    """An FMU, or the linear plant itself in one of four forms."""

    fmu: Text | None = None
    numerator: Numbers | None = None
    denominator: Numbers | None = None
    zeros: Roots | None = None
    poles: Roots | None = None
    gain: Nonzero | None = None
    A: Annotated[tuple[Numbers, ...], BeforeValidator(values.items)] | None = None
    B: Numbers | None = None
    C: Numbers | None = None
    D: Number | None = None
    modes: Annotated[tuple[Mode, ...], BeforeValidator(values.items)] | None = None
    rigid: Number | None = None
    input: Text | None = None
    output: Text | None = None
    outputs: Annotated[dict[Text, Numbers], Named] | None = None
    parameters: Annotated[dict[Text, Annotated[Any, BeforeValidator(values.setting)]], Named] | None = None
    initial: Initial | None = None
    linearization: Literal["auto", "twin", "derivatives", "differences", "identified"] | None = None
    identification: Identification | None = None
    schedule: Schedule | None = None


class Maneuver(Section):
    """The move."""

    displacement: Number
    initial_state: State | None = None
    scale: Positive | None = None


class TailLength(Section):
    """How soon the tail must be near the final rest input."""

    time: Positive  # [s] after T
    within: Fraction


class ZeroSensitivity(Section):
    """How much the tail may move the output if a zero is not where it should be."""

    shift: Positive  # of the zero's magnitude
    residual: NonNegative  # of the displacement


class Limits(Section):
    """What the command must respect."""

    input: Interval
    fuel: Positive | None = None
    rate: Interval | None = None
    deflection: Annotated[dict[Text, Positive], Named] | None = None
    sample_time: Positive | None = None
    tail_length: TailLength | None = None
    zero_sensitivity: Annotated[dict[Annotated[Text, AfterValidator(values.zero_name)], ZeroSensitivity], Named] | None = None
    pulse_width: Positive | None = None
    pulses: Count | None = None


class Follow(Section):
    """A mode that varies while the machine moves: the values of a parameter at some instants."""

    parameter: Text
    times: Numbers  # [s] after the start of the move, ascending
    values: Numbers


class Command(Section):
    """What kind of command is asked for."""

    kind: Literal["time-optimal", "fuel-efficient", "shaper", "pole-zero", "file"] = "time-optimal"
    robustness: Annotated[int | Literal["box"] | dict[str, int], BeforeValidator(values.robustness)] | None = None
    tolerance: Fraction | None = None
    final_tolerance: Positive | None = None
    tail: StrictBool | None = None
    shaper: Text | None = None
    modes: Annotated[tuple[Annotated[Text, AfterValidator(values.mode_text)], ...], BeforeValidator(values.items)] | None = None
    reference: Text | None = None
    band: Annotated[Interval, AfterValidator(values.factors)] | None = None
    bands: Annotated[tuple[Text, ...], BeforeValidator(values.items)] | None = None
    damping: Annotated[Interval, AfterValidator(values.dampings)] | None = None
    negative: Positive | None = None
    sums: Interval | None = None
    sample_time: Positive | None = None
    simultaneous: StrictBool | None = None
    pulse: Positive | None = None
    height: Positive | None = None
    impulses: Text | None = None
    deflection: Positive | None = None
    follow: Follow | None = None
    delays: Count | None = None
    form: Text | None = None
    gains: Interval | None = None
    monotone: StrictBool | None = None
    instants: Numbers | None = None
    zeros: Annotated[tuple[Annotated[Text, AfterValidator(values.zero_listed)], ...], BeforeValidator(values.items)] | None = None
    type: ProfileType | None = None
    alpha: NonNegative | None = None
    file: Text | None = None
    start: NonNegative | None = None


class Simulation(Section):
    """How the runs are simulated."""

    step: Positive | None = None
    observe: Positive | None = None
    timeout: Positive | None = None
    step_timeout: Positive | None = None
    memory: Annotated[Count, AfterValidator(values.mebibytes)] | None = None
    seed: Natural | None = None
    interface: Literal["co-simulation", "model-exchange"] | None = None


class Distribution(Section):
    """How an uncertain parameter is distributed."""

    kind: Literal["uniform", "normal"]
    lower: Number | None = None
    upper: Number | None = None
    mean: Number | None = None
    deviation: Positive | None = None


class Uncertainty(Section):
    """One axis of the box."""

    parameter: Text
    range: Interval | None = None
    distribution: Distribution | None = None
    samples: Samples | None = None
    sampling: Literal["grid", "sobol", "random"] | None = None


class Requirement(Section):
    """One requirement."""

    id: Annotated[Text, AfterValidator(values.identifier)]
    text: Text | None = None
    quantity: Text
    min: Number | None = None
    max: Number | None = None
    unit: Text | None = None
    scope: Literal["nominal", "box"] | None = None


class Keep(Section):
    """Which logs stay in the evidence."""

    logs: Literal["worst", "all"] = "worst"


class Cluster(Section):
    """Where the runs are computed."""

    address: Text | None = None
    workers: Count | None = None


TABLES: dict[str, type[Section]] = {
    "plant": Plant,
    "maneuver": Maneuver,
    "limits": Limits,
    "command": Command,
    "simulation": Simulation,
    "keep": Keep,
    "cluster": Cluster,
}
ARRAYS: dict[str, type[Section]] = {"uncertainty": Uncertainty, "requirement": Requirement}
REQUIRED = ("plant", "maneuver", "limits")
KEYS: dict[str, tuple[str, ...]] = {name: tuple(section.model_fields) for name, section in {**TABLES, **ARRAYS}.items()}
"""Every section's keys, in the order of the reference."""


@dataclass(frozen=True, slots=True)
class Written:
    """A study as written: None stands for a section or item whose shape is wrong; one that is absent has its defaults."""

    title: str | None
    plant: Plant | None
    maneuver: Maneuver | None
    limits: Limits | None
    command: Command | None
    simulation: Simulation | None
    keep: Keep | None
    cluster: Cluster | None
    uncertainty: tuple[Uncertainty | None, ...]
    requirement: tuple[Requirement | None, ...]


def read_sections(data: Mapping[str, Any]) -> tuple[Written, list[Mistake]]:
    """The sections of a parsed study file, and everything that is wrong with the shape of any of them."""
    mistakes = [Mistake(name, value, _unknown_section(name)) for name, value in data.items() if name not in {"title", *KEYS}]
    title = _validate(TypeAdapter(Text), data["title"], "title", mistakes) if "title" in data else None
    tables: dict[str, Any] = {}
    for name, section in TABLES.items():
        if name not in data and name in REQUIRED:
            mistakes.append(Mistake(name, ABSENT, f"the section [{name}] is missing"))
        value = data.get(name, {})
        if not isinstance(value, dict):
            mistakes.append(Mistake(name, value, f"must be a section, [{name}]"))
        usable = isinstance(value, dict) and (name in data or name not in REQUIRED)
        tables[name] = _validate(TypeAdapter(section), value, name, mistakes) if usable else None
    arrays: dict[str, Any] = {}
    for name, section in ARRAYS.items():
        value = data.get(name, [])
        if not (isinstance(value, list) and all(isinstance(item, dict) for item in value)):
            mistakes.append(Mistake(name, value, f"must be written with double brackets, [[{name}]], once for each item"))
            value = []
        adapter = TypeAdapter(section)
        arrays[name] = tuple(_validate(adapter, item, f"{name}[{i}]", mistakes) for i, item in enumerate(value, 1))
    return Written(title=title, **tables, **arrays), mistakes


Shape = TypeVar("Shape")


def _validate(adapter: TypeAdapter[Shape], value: object, path: str, mistakes: list[Mistake]) -> Shape | None:
    try:
        return adapter.validate_python(value)
    except ValidationError as invalid:
        mistakes.extend(_mistakes(invalid, path))
        return None


def _mistakes(invalid: ValidationError, path: str) -> Iterator[Mistake]:
    for detail in invalid.errors(include_url=False):
        *parents, last = detail["loc"] or ("",)
        place = _join(path, detail["loc"])
        context = detail.get("ctx", {})
        match detail["type"]:
            case "value_error":
                yield Mistake(place, detail["input"], str(context["error"]))
            case "missing":
                yield Mistake(place, ABSENT, "is missing")
            case "extra_forbidden":
                yield Mistake(place, detail["input"], _unknown_key(str(last), path, tuple(parents)))
            case "literal_error":
                valid = str(context["expected"])
                names = re.findall(r"'([^']*)'", valid)
                wrong = detail["input"]
                hint = did_you_mean(wrong, names) if isinstance(wrong, str) else ""
                yield Mistake(place, wrong, f"must be {valid.replace(chr(39), chr(34))}{hint}")
            case "bool_type":
                yield Mistake(place, detail["input"], "must be true or false")
            case "model_type" | "dict_type":
                yield Mistake(place, detail["input"], "must be a table in braces")
            case _:
                yield Mistake(place, detail["input"], f"is not valid: {detail['msg']}")


def _join(path: str, location: tuple[int | str, ...]) -> str:
    """A dotted path as the user counts: items from 1."""
    for part in location:
        if isinstance(part, int):
            path += f"[{part + 1}]"
        elif part != "[key]":  # pydantic's mark of a mistake in a table's key
            path += f".{part}"
    return path


def _unknown_section(name: str) -> str:
    near = nearest(name, {"title", *KEYS, *(key for keys in KEYS.values() for key in keys)})
    homes = [] if near in KEYS else [f"[{section}]" for section, keys in KEYS.items() if near in keys]
    hint = f' (did you mean "{near}"{" in " + " or ".join(homes) if homes else ""}?)' if near else ""
    return f"no such section or key{hint}; valid are title, {', '.join(KEYS)}"


NESTED: dict[str, type[Section]] = {
    "modes": Mode,
    "initial": Initial,
    "identification": Identification,
    "tail_length": TailLength,
    "zero_sensitivity": ZeroSensitivity,
    "distribution": Distribution,
    "follow": Follow,
    "schedule": Schedule,
}


def _unknown_key(key: str, path: str, parents: tuple[int | str, ...]) -> str:
    section = path.split("[")[0]
    inner = next((part for part in reversed(parents) if part in NESTED), None)
    valid = KEYS[section] if inner is None else tuple(NESTED[str(inner)].model_fields)
    hint = did_you_mean(key, valid)
    if not hint:
        homes = [name for name, keys in KEYS.items() if key in keys and name != section]
        hint = f" ({' or '.join(f'[{name}]' for name in homes)} has one)" if homes else ""
    return f"no such key{hint}; valid here: {', '.join(valid)}"
