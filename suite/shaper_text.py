"""What is said of a shaper on a terminal, beside its table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR
from typing import TYPE_CHECKING, Any

from suite.rounding import outward

if TYPE_CHECKING:
    from suite.shaping import Shaping


def shaper_lines(done: Shaping) -> Iterator[str]:
    """Duration with its lower bound, insensitivity, and the proven worst case."""
    request = done.request
    if done.decay is not None:
        found = done.decay
        left = f"rms {found.decay.rms:.3g} is left of {found.decay.samples} samples"
        yield f"decay of {found.signal}, {found.begin:g} to {found.end:g} s: {left}"
        for number, mode in enumerate(found.decay.modes, 1):
            frequency, error = mode.mode.frequency / (2 * math.pi), mode.frequency_error / (2 * math.pi)
            damped = f"damping {mode.mode.damping:.6g} ± {mode.damping_error:.1g}"
            yield f"  mode {number}: {frequency:.8g} ± {error:.1g} Hz, {damped}, amplitude {mode.amplitude:.4g} (measured)"
    yield f"duration: {done.shaper.duration!r} s"
    if done.least:
        yield f"least duration of {done.least.among}: {done.least.duration!r} s: proved"
    else:
        yield "least duration: none was proven"
    if done.deflection is not None:
        yield f"largest deflection from the shaped step: {_interval(done.deflection)} of that under an unshaped one: proved"
    yield f"insensitivity at {100 * request.tolerance:g} %: {done.insensitivity:.6f} of the frequency (measured)"
    low, high = done.damping or (None, None)
    damping = "" if low is None else f", damping {low:g} to {high:g}"
    several = bool(done.request.bands[1:])
    for reach in done.reaches if several else [done.worst_reach]:
        box = f"frequency × {reach.band.low:g} to {reach.band.high:g}{damping}"
        sides = (reach.worst.lower, reach.worst.upper) if several else done.worst
        allowed = f" (tolerance {reach.band.tolerance:g})" if several else ""
        yield f"worst residual vibration, {box}: {_interval(sides)}, mode {reach.mode}: proved{allowed}"


def study_lines(shaper: Mapping[str, Any]) -> Iterator[str]:
    """The shaper of a study's command (`results.json`) in two lines."""
    least = shaper["least_duration"]
    proven = f", at least {least['lower']:.10g} s for {least['among']}: proved" if least else ""
    yield f"shaper {shaper['kind']}: {shaper['duration']:.10g} s{proven}"
    for band in shaper["bands"]:
        box = "frequency × {:g} to {:g}".format(*band["frequency"])
        yield f"its worst residual vibration, mode {band['mode']}, {box}: {_interval(band['worst_residual'])}: proved"


def _interval(sides: Sequence[float]) -> str:
    return f"[{outward(sides[0], ROUND_FLOOR)}, {outward(sides[1], ROUND_CEILING)}]"
