"""What a study's limits of the input do not allow of a command that was not designed within them: one that was given, or shaped."""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import Decimal
from typing import Protocol

from relaxations.commands import Command
from relaxations.response import jumps

ROUNDING = 1e-9  # of a limit, or of the distance between two


class Limited(Protocol):
    """Limits of the input besides its least and its largest value, as they are written or understood; None: not given."""

    @property
    def fuel(self) -> Decimal | None: ...
    @property
    def sample_time(self) -> Decimal | None: ...
    @property
    def rate(self) -> tuple[Decimal, Decimal] | None: ...
    @property
    def pulse_width(self) -> Decimal | None: ...
    @property
    def pulses(self) -> int | None: ...


def complaints(command: Command, limits: Limited, lower: float, upper: float, rest: float) -> Iterator[str]:
    """Each in words; `rest` is the input before the command begins. The least and the largest value of it are looked at elsewhere."""
    if limits.fuel is not None and (fuel := command.fuel(rest)) > float(limits.fuel) * (1.0 + ROUNDING):
        yield f"the command uses {fuel:.10g} of fuel, more than limits.fuel, {limits.fuel}"
    if limits.sample_time is not None:
        step = float(limits.sample_time)
        off = [at for at in command.breakpoints if abs(at - round(at / step) * step) > ROUNDING * step]
        if off or command.tail.terms or any(segment.slope for segment in command.segments):
            what = f"changes at {off[0]:.10g} s" if off else "is not constant between its instants"
            yield f"the command {what}, but limits.sample_time is {step:.10g} s"
    if limits.rate is not None:
        yield from _of_slopes(command, limits.rate, limits.sample_time, ROUNDING * (upper - lower), rest)
    if limits.pulse_width is not None or limits.pulses is not None:
        yield from _of_pulses(command, limits, (lower, upper, rest))


def _of_slopes(
    command: Command, rate: tuple[Decimal, Decimal], sample_time: Decimal | None, slack: float, rest: float
) -> Iterator[str]:  # fmt: skip
    low, high = float(rate[0]), float(rate[1])
    step = 0.0 if sample_time is None else float(sample_time)
    allowed = f"limits.rate is [{low:.10g}, {high:.10g}]"
    for at, level, *_ in jumps(command, rest):
        if not step * low - slack <= float(level) <= step * high + slack:
            yield f"the command jumps by {float(level):.10g} at {float(at):.10g} s, but {allowed}"
            return
    for segment in command.segments:
        if not low - ROUNDING * (high - low) <= segment.slope <= high + ROUNDING * (high - low):
            yield f"the command has a slope of {segment.slope:.10g} from {segment.start:.10g} s on, but {allowed}"
            return


def _of_pulses(command: Command, limits: Limited, full: tuple[float, float, float]) -> Iterator[str]:
    """What of it no thrusters with these limits can do: `full` are their levels, the last one that of rest."""
    starts, rest = [segment.start for segment in command.segments], full[-1]
    if command.tail.terms or any(segment.slope or segment.level not in full for segment in command.segments):
        yield f"the command has other levels than those that thrusters give, {', '.join(f'{level:.10g}' for level in full)}"
    pulses = [b - a for s, a, b in zip(command.segments, starts, [*starts[1:], command.end], strict=True) if s.level != rest]
    if limits.pulse_width is not None and min(pulses, default=math.inf) < (width := float(limits.pulse_width)) * (1.0 - ROUNDING):
        yield f"the command has a pulse of {min(pulses):.10g} s, but limits.pulse_width is {width:.10g} s"
    if limits.pulses is not None and len(pulses) > limits.pulses:
        yield f"the command has {len(pulses)} pulses, but limits.pulses is {limits.pulses}"
