"""`command.type`, `kind = "fuel-efficient"` and `command.alpha`: what a form of pulses, or a price of fuel, does not go with."""

from __future__ import annotations

from collections.abc import Iterator

from suite import schema
from suite.errors import ABSENT, Mistake

HOLDS = {"fuel-efficient": 1}
"""The form that a kind holds if none is named."""


def profile(command: schema.Command) -> int:
    """1: pulses towards the target first, then pulses against it; 2: any order."""
    return command.type or HOLDS.get(command.kind, 2)


def form_mistakes(study: schema.Written) -> Iterator[Mistake]:
    """Mistakes between the form and other keys."""
    command, limits = study.command, study.limits
    if command is None:
        return
    if command.kind == "fuel-efficient" and command.type == 2:
        yield Mistake("command.type", 2, 'contradicts kind = "fuel-efficient", which is type 1: pulses one way, then the other')
    if command.kind == "fuel-efficient" and limits is not None and limits.fuel is not None:
        why = 'contradicts kind = "fuel-efficient": that is the fastest command of its form, without a budget'
        yield Mistake("limits.fuel", limits.fuel, f'{why}; kind = "time-optimal" with type = 1 holds the form within a budget')
    if profile(command) != 1:
        return
    key = "command.type" if command.type is not None else "command.kind"
    why = f"contradicts {key}: the form is held from rest to state rest of one plant, at any instants"
    yield from _beside_rest(study, ("sample_time", "rate", "deflection"), why)


def price_mistakes(study: schema.Written) -> Iterator[Mistake]:
    """Mistakes between a price of fuel and other keys."""
    command = study.command
    if command is None or not command.alpha:
        return
    why = "contradicts command.alpha: fuel is weighed against the time of moves from rest to state rest, within limits of the input alone"
    if profile(command) == 1:
        key, value = ("command.type", 1) if command.type == 1 else ("command.kind", command.kind)
        yield Mistake(key, value, "contradicts command.alpha: fuel is weighed against the time of commands of any form")
    yield from _beside_rest(study, ("fuel", "rate", "deflection", "sample_time", "pulse_width", "pulses"), why)


def _beside_rest(study: schema.Written, limited: tuple[str, ...], why: str) -> Iterator[Mistake]:
    """What does not go with moves of one plant from rest to state rest, and these limits."""
    command, limits = study.command, study.limits
    if command is not None and command.tail:
        yield Mistake("command.tail", True, why)
    if command is not None and command.robustness == "box":
        yield Mistake("command.robustness", "box", f"{why}; valid are further zeros, 0, 1, 2 …")
    if study.maneuver is not None and study.maneuver.initial_state is not None:
        yield Mistake("maneuver.initial_state", ABSENT, why)
    if study.plant is not None and study.plant.schedule is not None:
        yield Mistake("plant.schedule", ABSENT, why)
    for name in limited if limits is not None else ():
        if (value := getattr(limits, name)) is not None:
            yield Mistake(f"limits.{name}", ABSENT if name == "deflection" else value, why)
