"""What a study may not say although every key is valid by itself: keys that exclude each other, and keys this version cannot honour."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from suite import schema
from suite.errors import ABSENT, Mistake
from suite.study_form import form_mistakes, price_mistakes


def _given(_: object) -> bool:
    return True


def _one_of(*refused: str) -> Callable[[object], bool]:
    return lambda value: value in refused


UNSUPPORTED: dict[str, tuple[Callable[[Any], bool], str]] = {
    # Path: for which values it is refused, and what is possible instead. A key leaves this table when this version honours it.
    "uncertainty.distribution": (_given, "range is supported"),
    "uncertainty.sampling": (_one_of("sobol", "random"), '"grid" is supported'),
    "cluster": (bool, "all runs are computed on this machine"),
}

BELONGS: dict[str, tuple[str, ...]] = {
    # Keys of [command] that mean something for some kinds only.
    "shaper": ("shaper",),
    "modes": ("shaper",),
    "reference": ("shaper",),
    "band": ("shaper",),
    "bands": ("shaper",),
    "damping": ("shaper",),
    "negative": ("shaper",),
    "sums": ("shaper",),
    "sample_time": ("shaper", "pole-zero"),
    "simultaneous": ("shaper",),
    "pulse": ("shaper",),
    "height": ("shaper",),
    "impulses": ("shaper",),
    "deflection": ("shaper",),
    "follow": ("shaper",),
    "delays": ("pole-zero",),
    "form": ("pole-zero",),
    "gains": ("pole-zero",),
    "monotone": ("pole-zero",),
    "instants": ("pole-zero",),
    "zeros": ("pole-zero",),
    "file": ("file",),
    "type": ("time-optimal", "fuel-efficient"),
    "alpha": ("time-optimal", "fuel-efficient"),
    "robustness": ("time-optimal", "fuel-efficient", "pole-zero"),
    "tolerance": ("time-optimal", "fuel-efficient", "shaper"),
    "final_tolerance": ("time-optimal", "fuel-efficient"),
    "tail": ("time-optimal", "fuel-efficient", "pole-zero"),
}
NEEDS = {"shaper": ("shaper",), "file": ("file",), "pole-zero": ("delays",)}
"""Keys of [command] that a kind cannot do without."""


def unsupported(data: Mapping[str, Any]) -> Iterator[Mistake]:
    """A mistake for every key that is valid, but whose meaning this version does not know."""
    for path, (refused, instead) in UNSUPPORTED.items():
        for place, value in _lookup(data, path.split("."), ""):
            if refused(value):
                yield Mistake(place, value, f"is not supported by this version; {instead}")


def _lookup(table: object, keys: list[str], place: str) -> Iterator[tuple[str, Any]]:
    if not keys:
        yield place, table
    elif isinstance(table, list):
        for i, item in enumerate(table, 1):
            yield from _lookup(item, keys, f"{place}[{i}]")
    elif isinstance(table, dict) and keys[0] in table:
        yield from _lookup(table[keys[0]], keys[1:], f"{place}.{keys[0]}".lstrip("."))


def contradictions(study: schema.Written) -> Iterator[Mistake]:
    """Mistakes between keys that need neither the plant nor a file to be seen."""
    if study.maneuver:
        yield from _maneuver(study.maneuver)
    if study.limits and (study.limits.pulse_width is not None or study.limits.pulses is not None):
        yield from _thrusters(study.limits, study.command)
    if study.maneuver and study.maneuver.initial_state is not None and study.command:
        yield from _started(study.command)
    if study.plant and study.plant.schedule is not None:
        yield from _varying(study)
    if study.limits and study.limits.rate and not study.limits.rate[0] <= 0 <= study.limits.rate[1]:
        yield Mistake("limits.rate", study.limits.rate, "must contain 0: at rest the input stands still")
    if study.command:
        yield from _command(study.command)
        yield from form_mistakes(study)
        yield from price_mistakes(study)
        if study.command.tail and study.limits and study.limits.sample_time is not None:
            why = "contradicts limits.sample_time: a tail decays after the move, and is not constant over a sample"
            yield Mistake("command.tail", True, why)
        if study.command.robustness == "box" and not study.uncertainty:
            yield Mistake("command.robustness", "box", "needs a box: at least one [[uncertainty]]")
        if study.command.robustness == "box" and study.command.tolerance is None:
            yield Mistake(
                "command.tolerance", ABSENT, 'is missing; robustness = "box" needs the residual that every plant of the box may keep'
            )
        if study.command.robustness == "box" and study.command.tail:
            yield Mistake("command.tail", True, 'contradicts robustness = "box": a tail hides in the zeros of one plant only')
        if study.command.kind == "pole-zero":
            yield from _cancelling(study.command, study.limits)
    for i, axis in enumerate(study.uncertainty, 1):
        if axis:
            yield from _axis(axis, f"uncertainty[{i}]")
    yield from _repeated("uncertainty", "parameter", [axis.parameter if axis else None for axis in study.uncertainty])
    for i, requirement in enumerate(study.requirement, 1):
        if requirement:
            yield from _requirement(requirement, f"requirement[{i}]", bool(study.uncertainty))
    # Some file systems do not tell capitals from small letters, and identifiers become file names.
    yield from _repeated("requirement", "id", [requirement.id if requirement else None for requirement in study.requirement])


def _maneuver(maneuver: schema.Maneuver) -> Iterator[Mistake]:
    if maneuver.displacement == 0 and maneuver.initial_state is None:
        yield Mistake("maneuver.displacement", maneuver.displacement, "must not be 0: there is nothing to move")
    if maneuver.displacement == 0 and maneuver.initial_state is not None and maneuver.scale is None:
        yield Mistake("maneuver.scale", ABSENT, "is missing; with displacement = 0 relative quantities are divided by it")
    if maneuver.displacement != 0 and maneuver.scale is not None:
        yield Mistake("maneuver.scale", maneuver.scale, "has a meaning with displacement = 0 only; else |displacement| is the scale")


def _thrusters(limits: schema.Limits, command: schema.Command | None) -> Iterator[Mistake]:
    key = "limits.pulse_width" if limits.pulse_width is not None else "limits.pulses"
    if limits.sample_time is not None:
        why = "which of the finitely many commands of three levels on samples rest is an integer program, which is not there"
        yield Mistake("limits.sample_time", limits.sample_time, f"contradicts {key}: pulses begin and end at any instant; {why}")
    if limits.rate is not None:
        yield Mistake("limits.rate", limits.rate, f"contradicts {key}: thrusters are on or off, and the slope of a jump has no limit")
    if command and command.tail:
        yield Mistake("command.tail", True, f"contradicts {key}: thrusters are on or off, and a tail decays")


def _started(command: schema.Command) -> Iterator[Mistake]:
    why = "contradicts maneuver.initial_state"
    if command.robustness:
        yield Mistake("command.robustness", command.robustness, f"{why}: further zeros and boxes are about moves that begin at rest")
    if command.start:
        yield Mistake("command.start", command.start, f"{why}: until the command begins, the plant would move on")
    if command.kind not in ("time-optimal", "file"):
        yield Mistake("command.kind", command.kind, f'{why}: only "time-optimal" and "file" commands begin elsewhere than at rest')


def _varying(study: schema.Written) -> Iterator[Mistake]:
    why, command = "contradicts plant.schedule", study.command or schema.Command()
    if command.kind not in ("time-optimal", "file"):
        hint = "; command.follow, without a schedule, is what shapers have for plants that vary" if command.kind == "shaper" else ""
        yield Mistake("command.kind", command.kind, f'{why}: "time-optimal" and "file" are supported{hint}')
    if command.robustness:
        reason = "it has no frequency in which a residual could be flat; a box, which needs a schedule for each plant, is in Python only"
        yield Mistake(
            "command.robustness", command.robustness, f"{why}: further zeros and boxes are about plants that do not vary; {reason}"
        )
    if command.tail:
        yield Mistake("command.tail", True, f"{why}: a tail hides in the zeros of a plant that does not vary")
    if command.start:
        yield Mistake("command.start", command.start, f"{why}: the plant varies from the beginning of the move on")
    for key in ("tail_length", "zero_sensitivity") if study.limits else ():
        if getattr(study.limits, key) is not None:
            yield Mistake(f"limits.{key}", ABSENT, f"{why}: a tail hides in the zeros of a plant that does not vary")


def _command(command: schema.Command) -> Iterator[Mistake]:
    for key in sorted(command.model_fields_set & BELONGS.keys()):
        if command.kind not in BELONGS[key]:
            kinds = " or ".join(f'"{kind}"' for kind in BELONGS[key])
            yield Mistake(f"command.{key}", getattr(command, key), f'means nothing for kind = "{command.kind}"; it belongs to {kinds}')
    if command.band is not None and command.bands is not None:
        yield Mistake("command.bands", list(command.bands), "contradicts band; give one of them")
    for key in NEEDS.get(command.kind, ()):
        if getattr(command, key) is None:
            yield Mistake(f"command.{key}", ABSENT, f'is missing; kind = "{command.kind}" needs it')


def _cancelling(command: schema.Command, limits: schema.Limits | None) -> Iterator[Mistake]:
    why = 'contradicts kind = "pole-zero"'
    if command.robustness == "box":
        yield Mistake("command.robustness", "box", f"{why}: valid are further zeros, 0, 1, 2 … or a table of them by mode")
    if command.tail is False and command.zeros:
        yield Mistake("command.zeros", list(command.zeros), "contradicts tail = false: without a tail no zero is cancelled")
    if command.instants is not None and command.sample_time is not None:
        yield Mistake("command.sample_time", command.sample_time, "contradicts instants: the delays are given, or chosen from samples")
    if command.instants is not None and command.delays not in (None, len(command.instants)):
        yield Mistake("command.instants", list(command.instants), f"must be as many as the delays, {command.delays}")
    if command.instants is not None and any(b <= a for a, b in itertools.pairwise((0, *command.instants))):
        yield Mistake("command.instants", list(command.instants), "must ascend from more than 0 [s]")
    if limits is not None and limits.rate is not None:
        yield Mistake("limits.rate", list(limits.rate), f"{why}: its steps are no slopes")
    if limits is not None and (limits.pulse_width is not None or limits.pulses is not None):
        key = "pulse_width" if limits.pulse_width is not None else "pulses"
        yield Mistake(f"limits.{key}", getattr(limits, key), f"{why}: its steps have any height")


def _axis(axis: schema.Uncertainty, place: str) -> Iterator[Mistake]:
    if axis.range is None and axis.distribution is None:
        yield Mistake(f"{place}.range", ABSENT, f'is missing; "{axis.parameter}" needs a range = [lower, upper] or a distribution')
    if axis.range is not None and axis.distribution is not None:
        yield Mistake(f"{place}.distribution", ABSENT, "contradicts range; give one of them")
    if axis.range is not None and axis.sampling in (None, "grid") and axis.samples == 1:
        yield Mistake(f"{place}.samples", 1, "must be at least 2: a grid has both ends of the range")
    if axis.distribution is not None:
        kind = axis.distribution.kind
        right = {"uniform": {"lower", "upper"}, "normal": {"mean", "deviation"}}[kind]
        if axis.distribution.model_fields_set - {"kind"} != right:
            wrong = ", ".join(sorted(axis.distribution.model_fields_set - {"kind"})) or "nothing"
            yield Mistake(f"{place}.distribution", ABSENT, f'has {wrong}; kind = "{kind}" has {" and ".join(sorted(right))}')
        if axis.sampling == "grid":
            yield Mistake(f"{place}.sampling", "grid", 'contradicts distribution; valid are "sobol" and "random"')


def _requirement(requirement: schema.Requirement, place: str, has_box: bool) -> Iterator[Mistake]:
    if requirement.min is None and requirement.max is None:
        yield Mistake(place, ABSENT, f'"{requirement.id}" has no limit; give min, max or both')
    elif requirement.min is not None and requirement.max is not None and requirement.min > requirement.max:
        yield Mistake(f"{place}.min", requirement.min, f"is greater than max = {requirement.max}: nothing could meet it")
    if requirement.scope == "box" and not has_box:
        yield Mistake(f"{place}.scope", "box", 'needs a box: at least one [[uncertainty]]; without, scope is "nominal"')


def _repeated(array: str, key: str, values: list[str | None]) -> Iterator[Mistake]:
    fold = str.casefold if key == "id" else str
    first: dict[str, int] = {}
    for i, value in enumerate(values, 1):
        if value is None:
            continue
        if fold(value) in first:
            yield Mistake(f"{array}[{i}].{key}", value, f"is the {key} of {array}[{first[fold(value)]}] already")
        first.setdefault(fold(value), i)
