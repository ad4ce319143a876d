"""What is said of a shaper on a terminal, beside its table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from suite.rounding import interval

if TYPE_CHECKING:
    from relaxations.bounds import Bound
    from suite.shaper_moves import Moved
    from suite.shaping import Shaping


def shaper_lines(done: Shaping) -> Iterator[str]:
    """Duration with its lower bound, insensitivity, and the proven worst case."""
    request = done.request
    if done.decay is not None:
        found = done.decay
        left = f"rms {found.decay.rms:.3g} is left of {found.decay.samples} samples, {found.decay.share:.2g} of the signal's own"
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
        yield f"largest deflection from the shaped step: {interval(done.deflection)} of that under an unshaped one: proved"
    yield f"insensitivity at {100 * request.tolerance:g} %: {done.insensitivity:.6f} of the frequency (measured)"
    low, high = done.damping or (None, None)
    damping = "" if low is None else f", damping {low:g} to {high:g}"
    several = bool(done.request.bands[1:])
    for reach in done.reaches if several else [done.worst_reach]:
        box = f"frequency × {reach.band.low:g} to {reach.band.high:g}{damping}"
        sides = (reach.worst.lower, reach.worst.upper) if several else done.worst
        allowed = f" (tolerance {reach.band.tolerance:g})" if several else ""
        yield f"worst residual vibration, {box}: {interval(sides)}, mode {reach.mode}: proved{allowed}"
    for reach in done.ranges:
        box = f"frequency × {reach.band.low:.6f} to {reach.band.high:.6f}"
        sides = interval((reach.worst.lower, reach.worst.upper))
        yield f"worst residual vibration over mode {reach.mode}'s own range, {box}: {sides}: proved (tolerance {reach.band.tolerance:g})"
    yield from (f"note: {note}" for note in done.notes)
    if done.move is not None:
        yield from move_lines(done.move)
    if done.shaped is not None:
        made = done.shaped
        what = made.reference.kind if made.degree is None else f"{made.reference.kind}, pieces of degree {made.degree}"
        jumps = f"a derivative jumps at {made.communication_points} instants"
        yield f"shaped {what}: {made.begin:.10g} to {made.end:.10g} s, {jumps}: {made.file}"


def move_lines(done: Moved) -> Iterator[str]:
    """How long the move takes rigid, shaped, and designed together with the shaper, and what each leaves."""
    move = done.move
    yield f"move of {move.displacement:g}, input from {move.lower:g} to {move.upper:g}:"
    yield f"  rigid: {_sides(done.rigid)}{_left(done.left['rigid'])}"
    if done.shaped is None:
        yield "  then shaped: negative impulses take it beyond the limits of the input"
    else:
        yield f"  then shaped: {done.shaped.maneuver_time!r} s{_left(done.left['shaped'])}"
    several = isinstance(done.kept, tuple)
    most = " and ".join(f"{one:g}" for one in done.kept) if isinstance(done.kept, tuple) else f"{done.kept or 0.0:g}"
    kept = "" if done.kept is None else f"; swings by at most {most} of the move over the band{'s' if several else ''}: proved"
    yield f"  designed together: {_sides(done.together)}{kept}{_left(done.left['together'])}"
    if done.plants:
        yield (
            f"  note: the certificate is about {done.plants} plants of the bands, each weighted by what its tolerance allows; that the "
            "command keeps the whole of every band is proven besides"
        )
    elif done.box:
        boxes = " and ".join(f"{band.low:g}:{band.high:g}@{band.tolerance:g}" for band in done.box)
        yield f"  note: the least time is that of the band alone that asks for most; the command, and its certificate, is that of {boxes}"
    if done.between:
        gaps = " and ".join(f"{low:g} to {high:g}" for low, high in done.between)
        yield f"  note: the bands are kept as one: the bracket is that of a move that keeps the tolerance from {gaps} of the frequency, too"


def _sides(bound: Bound) -> str:
    upper = "–" if bound.upper is None else repr(bound.upper)
    return f"[{bound.lower!r}, {upper}] s: {bound.status.name.lower()}"


def _left(sides: tuple[float, float] | None) -> str:
    return "" if sides is None else f"; leaves an envelope over the band of {interval(sides)} of the move: proved"


def study_lines(shaper: Mapping[str, Any]) -> Iterator[str]:
    """The shaper of a study's command (`results.json`) in two lines."""
    least = shaper["least_duration"]
    proven = f", at least {least['lower']:.10g} s for {least['among']}: proved" if least else ""
    yield f"shaper {shaper['kind']}: {shaper['duration']:.10g} s{proven}"
    for band in shaper["bands"]:
        box = "frequency × {:g} to {:g}".format(*band["frequency"])
        yield f"its worst residual vibration, mode {band['mode']}, {box}: {interval(band['worst_residual'])}: proved"
