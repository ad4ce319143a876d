"""What is said of a shaper on a terminal, beside its table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR
from typing import TYPE_CHECKING, Any

from suite.rounding import outward

if TYPE_CHECKING:
    from suite.shaping import Shaping


def shaper_lines(done: Shaping) -> Iterator[str]:
    """Duration with its lower bound, insensitivity, and the proven worst case."""
    request = done.request
    yield f"duration: {done.shaper.duration!r} s"
    if done.least:
        yield f"least duration of {done.least.among}: {done.least.duration!r} s: proved"
    yield f"insensitivity at {100 * request.tolerance:g} %: {done.insensitivity:.6f} of the frequency (measured)"
    low, high = done.damping or (None, None)
    damping = "" if low is None else f", damping {low:g} to {high:g}"
    box = f"frequency × {request.band[0]:g} to {request.band[1]:g}{damping}"
    yield f"worst residual vibration, {box}: {_interval((done.worst.lower, done.worst.upper))}, mode {done.worst_mode}: proved"


def study_lines(shaper: Mapping[str, Any]) -> Iterator[str]:
    """The shaper of a study's command (`results.json`) in two lines."""
    least = shaper["least_duration"]
    proven = f", at least {least['lower']:.10g} s for {least['among']}: proved" if least else ""
    yield f"shaper {shaper['kind']}: {shaper['duration']:.10g} s{proven}"
    band = "{:g} to {:g}".format(*shaper["box"]["frequency"])
    yield f"its worst residual vibration, frequency × {band}: {_interval(shaper['worst_residual'])}: proved"


def _interval(sides: Sequence[float]) -> str:
    return f"[{outward(sides[0], ROUND_FLOOR)}, {outward(sides[1], ROUND_CEILING)}]"
