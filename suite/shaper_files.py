"""What becomes of a shaper: its picture, its file, and what other programs read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from relaxations.shaping.sensitivity import residual, step_response
from reports.files import json_bytes, write_atomically
from suite.errors import SuiteError
from suite.shaping import Shaping

KLIPPER, REPRAP = ".cfg", ".g"
CURVE, STEPS = 601, 801  # samples of the two charts
DAMPINGS = 41  # dampings of a range at which the residual is looked at


def picture(done: Shaping) -> str:
    """The sensitivity curve and the shaped step as SVG text that needs no page around it."""
    from reports import charts

    return charts.standalone(chart(done))


def chart(done: Shaping) -> str:
    """The same for a page."""
    from reports import charts

    shaper, modes, bands = done.shaper, done.request.modes, [reach.band for reach in done.reaches]
    times, amplitudes, order = shaper.excitation
    low, high = min(band.low for band in bands), max(band.high for band in bands)
    margin = 0.5 * (high - low) + 0.1
    factors = np.linspace(max(low - margin, 0.01), high + margin, CURVE)
    slowest = max(mode.half_period for mode in modes)
    instants = np.linspace(-0.5 * slowest, shaper.duration + 4.0 * slowest, STEPS)
    labels = [f"{mode.frequency / (2 * math.pi):.4g} Hz, damping {mode.damping:.3g}" for mode in modes]
    passed = np.maximum(np.subtract.outer(instants, times), 0.0) if order else np.greater_equal.outer(instants, times)
    ranges = {}
    if done.damping is not None and done.damping[0] < done.damping[1]:
        for label, mode in zip(labels, modes, strict=True):
            over = [residual(times, amplitudes, factors * mode.frequency, float(z), order) for z in np.linspace(*done.damping, DAMPINGS)]
            what = f"{mode.frequency / (2 * math.pi):.4g} Hz, damping {done.damping[0]:.3g} to {done.damping[1]:.3g}"
            ranges[label] = (what, 100.0 * np.min(over, axis=0), 100.0 * np.max(over, axis=0))
    return charts.shaping(
        f"Shaper {done.kind}",
        factors.tolist(),
        {label: 100.0 * residual(times, amplitudes, factors * mode.frequency, mode.damping, order)
         for label, mode in zip(labels, modes, strict=True)},
        instants,
        passed @ np.array(amplitudes),
        {label: step_response(times, amplitudes, mode.frequency, mode.damping, instants, order)
         for label, mode in zip(labels, modes, strict=True)},
        bands=[(band.low, band.high, charts.Limit(100.0 * band.tolerance, f"tolerance, {100.0 * band.tolerance:g} %")) for band in bands],
        ranges=ranges,
    )  # fmt: skip


def write(
    done: Shaping, exports: Sequence[Path] = (), save: Path | None = None, command: Path | None = None, certificate: Path | None = None,
    plot: Path | None = None, further: Sequence[tuple[Path, bytes]] = (),
) -> None:  # fmt: skip
    """All files that are asked for, or none: `exports` by their endings, the shaper file (`slewcert-shaper/1`), the move's command and the
    proof of its time, the picture, and `further` ones. Raises `SuiteError` where there is nothing to write to one of them.
    """
    files = [*further, *((path, exported(done, path)) for path in exports)]
    if save is not None:
        files.append((save, json_bytes(done.shaper.to_dict())))
    if done.move is not None:
        found = done.move.command and json_bytes(done.move.command.to_dict())
        for path, content in ((command, found), (certificate, done.move.together.certificate)):
            if path is not None and content is None:
                raise SuiteError(f"{path}: there is nothing to write, the move is {done.move.together.status.name.lower()}")
            if path is not None and content is not None:
                files.append((path, content))
    if plot is not None:
        files.append((plot, picture(done).encode()))
    for path, content in files:
        write_atomically(path, content)


def mistakes(
    paths: Sequence[Path], of_a_move: Sequence[Path | None], move: float | None, pulses: bool, plot: Path | None = None
) -> Iterator[str]:
    """Files whose ending says nothing of whom they are for or something else, those of a move where there is none, exports of `pulses`."""
    if plot is not None and plot.suffix.lower() != ".svg":
        yield f"--plot {plot}: the picture is SVG and its file ends in .svg, such as {plot.with_suffix('.svg') if plot.name else 'p.svg'}"
    if move is None and any(of_a_move):
        yield f"{next(filter(None, of_a_move))}: it is a --move that has a command and a proof, and none is asked for"
    if unknown := [str(path) for path in paths if path.suffix not in EXPORTS]:
        endings = ".cfg for Klipper, .g for RepRapFirmware, .h for C"
        yield f"--export {', '.join(unknown)}: the ending says for whom a shaper is written: {endings}"
    if pulses and paths:
        yield f"--export {', '.join(map(str, paths))}: firmware takes impulses, and this shaper is made of pulses; --save writes them"


def exported(done: Shaping, path: Path) -> bytes:
    """The shaper for other programs, by the file's ending (`EXPORTS`). Raises `SuiteError` for what those do not take."""
    if done.shaper.pulses:
        raise SuiteError(f"{path}: firmware takes impulses, and this shaper is made of pulses; --save writes them")
    return EXPORTS[path.suffix](done).encode()


def firmware_notes(done: Shaping, exports: Sequence[Path]) -> Iterator[str]:
    """What firmware is known to refuse of a shaper that is written for it: the file is right, and useless there."""
    amplitudes, duration = done.shaper.amplitudes, done.shaper.duration
    for path in exports:
        refused = []
        if path.suffix == KLIPPER:
            if len(amplitudes) > 1 and not 0.001 <= duration <= 0.2:
                refused.append(f"a duration of 0.001 to 0.2 s; this is one of {duration:.4g} s")
            if min(map(abs, amplitudes)) < 0.001:
                refused.append(f"amplitudes of 0.001 and more; the smallest is {min(map(abs, amplitudes)):.3g}")
            if len(amplitudes) > 16:
                refused.append(f"up to 16 impulses; these are {len(amplitudes)}")
        elif path.suffix == REPRAP and len(amplitudes) > 5:
            refused.append(f"up to 5 impulses; these are {len(amplitudes)}")
        if refused:
            yield f"{path}: {'Klipper' if path.suffix == KLIPPER else 'RepRapFirmware'} takes {'; '.join(refused)}"


def _klipper(done: Shaping) -> str:
    """Klipper: amplitudes and instants [s] of a custom shaper, for both axes."""
    lines = ["[input_shaper]"]
    for axis in "xy":
        lines += [f"shaper_type_{axis}: custom", f"shaper_a_{axis}: {_list(done.shaper.amplitudes, ', ')}"]
        lines += [f"shaper_t_{axis}: {_list(done.shaper.times, ', ')}"]
    return "\n".join(lines) + "\n"


def _reprapfirmware(done: Shaping) -> str:
    """RepRapFirmware, 3.6 on: amplitudes but the last, which makes the sum 1, and delays [s] of the later impulses from the first one.

    Before 3.6 the same words meant partial sums, and durations: the file says whom it is for.
    """
    amplitudes = done.shaper.amplitudes
    if len(amplitudes) == 1:
        return 'M593 P"none"\n'
    if math.fsum(amplitudes[:-1]) >= 1.0:
        raise SuiteError(
            f"--export …{REPRAP}: RepRapFirmware takes a last impulse that is positive, and this one is {amplitudes[-1]!r}; others take any"
        )
    return f'; RepRapFirmware 3.6 and later\nM593 P"custom" H{_list(amplitudes[:-1], ":")} T{_list(done.shaper.times[1:], ":")}\n'


def _header(done: Shaping) -> str:
    """C: a header with the taps."""
    count = len(done.shaper.times)
    return "\n".join(
        [
            f"/* Shaper {done.kind}: amplitudes sum to 1, instants in seconds. */",
            "#ifndef SHAPER_TAPS_H",
            "#define SHAPER_TAPS_H",
            f"#define SHAPER_TAPS {count}",
            f"static const double shaper_times[SHAPER_TAPS] = {{{_list(done.shaper.times, ', ')}}};",
            f"static const double shaper_amplitudes[SHAPER_TAPS] = {{{_list(done.shaper.amplitudes, ', ')}}};",
            "#endif",
            "",
        ]
    )


def _list(numbers: Sequence[float], between: str) -> str:
    return between.join(f"{number:.17g}" for number in numbers)


EXPORTS: dict[str, Callable[[Shaping], str]] = {KLIPPER: _klipper, REPRAP: _reprapfirmware, ".h": _header}
